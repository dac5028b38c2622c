"""Choice among panels that read alike, by an unloaded and a loaded frame together.

Where idle lines hold the driven one harder than its driver does, several panels give the readings
of a frame (`lampest.panel.readouts.branches`). A load changes some cells, and the others stand
still: this holds for the pair of panels that is meant. In any other pair nearly all cells change,
because the potential of a driven line is another one beyond its fold. Pairs are compared as
circuits are, by the density of the loaded readings given the unloaded ones
(`FittedPair.density`): moved cells are selected, and the noise that cells have beside a fold
counts. Another pair is ruled out where −2 ln density is larger by CLEAR.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import product
from operator import itemgetter
from typing import Self

import numpy as np

from lampest.files.errors import BROKEN
from lampest.inference.cells_fit import CellsFit, data_of_cells, fitted, well_determined
from lampest.inference.evidence import mostly_still
from lampest.inference.pair import FittedPair
from lampest.panel.panel import Array
from lampest.panel.readouts.starts import panels_beyond_folds
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings

CLEAR = 20.0  # in −2 ln evidence: odds of e^10
CHANGE = 0.03  # of ln r: panels of which no cell differs by more than this and noise are one
STILL = 2 * CHANGE  # median change of ln r by which a solve ends at another panel
NOISE_RANGE = 3.0  # standard deviations of a reading, and of a cell: panels within noise


@dataclass(frozen=True, eq=False)
class PanelChoice:
    """Panels of an unloaded and of a loaded frame, of all that give their readings.

    Attributes
    ----------
    resting, loaded : array, shape (rows, columns)
        Cells in ohm.
    other : array, shape (rows, columns), or None
        Cells of one of the two frames in the next best pair, ohm; None where no other pair is
        known.
    clear : bool
        Whether the next best pair is ruled out, and the readings determine the cells.
    """

    resting: Array
    loaded: Array
    other: Array | None
    clear: bool

    @classmethod
    def of(cls, scene: Scene, resting: Readings, loaded: Readings) -> Self | None:
        """Return the choice for two frames.

        The result is None where no panel explains a frame.
        """
        if not (resting.plain.any() and loaded.plain.any()):
            return None
        tolerance = max(noise_share(resting), noise_share(loaded))
        # Panels of one frame are starts of the other one that uniform panels may miss
        starts = [
            *_every_panel(scene, resting, tolerance),
            *_every_panel(scene, loaded, tolerance),
        ]
        before = _distinct_fits(scene, resting, starts)
        after = _distinct_fits(scene, loaded, starts)
        before += _continued(scene, resting, after, before)
        after += _continued(scene, loaded, before, after)
        pairs = []
        for frames in product(before, after):
            with suppress(*BROKEN):
                pair = FittedPair(frames)
                pairs.append((pair.density + pair.misfits, pair))
        if not pairs:
            return None
        pairs.sort(key=itemgetter(0))
        (cost, best), *others = pairs
        # Beside a fold readings hardly depend on some cells, so that still other ones give them.
        determined = all(well_determined([frame]) for frame in best.frames)
        clear = mostly_still(best.moved) and determined
        other = None
        if others:
            second_cost, second = others[0]
            both = zip(second.frames, best.frames, strict=True)
            other = next(frame.cells for frame, taken in both if frame is not taken)
            clear = clear and second_cost - cost > CLEAR
        resting_cells, loaded_cells = (frame.cells for frame in best.frames)
        return cls(resting_cells, loaded_cells, other, clear)

    @property
    def sentence(self) -> str:
        """The doubt that other cells are meant; '' where there is none."""
        if self.clear:
            return ""
        cure = "with a smaller drive_ohm they differ"
        if self.other is None:
            return (
                "other cells may give these readings, too: the readings hardly determine them, or "
                f"most have changed since the unloaded frames; {cure}"
            )
        chosen, other = (float(np.median(cells)) for cells in (self.resting, self.other))
        return (
            f"cells of about {chosen:.2g} ohm and "
            f"of about {other:.2g} ohm give these readings alike, and the former are taken: {cure}"
        )


def nearest_panel(panels: Sequence[Array], baseline: Array) -> Array:
    """Return the panel in which the fewest cells differ from the unloaded ones.

    It has the least Σ ln(1 + (Δ ln r/CHANGE)²).
    """
    changes = (np.log(cells / baseline) / CHANGE for cells in panels)
    return panels[int(np.argmin([np.log1p(change**2).sum() for change in changes]))]


def _every_panel(scene: Scene, readings: Readings, tolerance: float) -> list[Array]:
    """Return the panels that give a frame's readings, with cells within the bounds of estimates.

    Bounds and readings of broken cells do not count.
    """
    data = data_of_cells(scene, readings)
    limits = (data.lower[0], data.upper[0])
    return panels_beyond_folds(scene.circuit, readings.plain_values, limits, tolerance)


def _distinct_fits(scene: Scene, readings: Readings, panels: Sequence[Array]) -> list[CellsFit]:
    """Return the fits of a frame that begin at panels and explain it, each once."""
    distinct: list[CellsFit] = []
    for panel in panels:
        fit = fitted(scene, readings, panel)
        if fit is not None and all(_differ(fit, known) for known in distinct):
            distinct.append(fit)
    return distinct


def _continued(
    scene: Scene, readings: Readings, others: Sequence[CellsFit], known: Sequence[CellsFit]
) -> list[CellsFit]:
    """Return fits of a frame on sides of a fold where only the other frame has one.

    The search begins at the other frame's cells, and takes as long as it needs.
    """
    found = {float(fit.network.branch) for fit in known}
    continued = list[CellsFit]()
    for other in others:
        side = float(other.network.branch)
        if side in found:
            continue
        fit = fitted(scene, readings, other.cells, patient=True)
        if fit is not None and fit.within_noise and float(fit.network.branch) == side:
            continued.append(fit)
            found.add(side)
    return continued


def _differ(fit: CellsFit, other: CellsFit) -> bool:
    """Return whether two fits lie on two sides of a fold, or a cell differs by more than noise."""
    if fit.network.branch != other.network.branch:
        return True
    variance = np.diag(fit.covariance) + np.diag(other.covariance)
    change = np.log(fit.cells / other.cells).ravel()
    return bool((np.abs(change) > np.hypot(CHANGE, NOISE_RANGE * np.sqrt(variance))).any())


def noise_share(readings: Readings) -> float:
    """Return the reach of readings' noise over their median; 0 where it is unknown."""
    if readings.sigma is None:
        return 0.0
    plain = readings.plain
    share = np.median(readings.sigma[plain]) / np.median(readings.value[plain])
    return NOISE_RANGE * float(share)
