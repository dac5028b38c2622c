"""Choice among panels that read alike, by an unloaded and a loaded frame together.

Where idle lines are held harder than the driven one, several panels give the readings of a frame
(`lampest.panel.readouts.branches`). A load changes some cells, and the others stand still: this
holds for the pair of panels that is meant. In any other pair nearly all cells change, because the
potential of a driven line is another one beyond its fold. With a Student-like density of changes,
a pair costs

    Σ ln(1 + (Δ ln r/CHANGE)²)

and another pair is ruled out where it costs more by CLEAR.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.recording.readings import Readings

CHANGE = 0.03  # of ln r: cells that change by less stand still within the noise of exact fits
CLEAR = 10.0  # in the cost of a pair: odds of e^10, the more careful as changes share their noise
STILL = 2 * CHANGE  # median change of ln r in a pair of which most cells stand still
NOISE_RANGE = 3.0  # standard deviations of a reading: panels that fit to less are compared


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
        Whether the next best pair is ruled out.
    """

    resting: Array
    loaded: Array
    other: Array | None
    clear: bool

    @classmethod
    def of(cls, circuit: Readout, resting: Readings, loaded: Readings) -> Self | None:
        """Return the choice for two frames; None where one has bounds, or no panel is found."""
        if not (circuit.several_panels and resting.plain.all() and loaded.plain.all()):
            return None
        tolerance = max(noise_share(resting), noise_share(loaded))
        unloaded = circuit.every_panel(resting.value, tolerance)
        of_load = circuit.every_panel(loaded.value, tolerance, unloaded)
        # Panels of a load are starts of the unloaded one that uniform panels may miss
        unloaded = circuit.every_panel(resting.value, tolerance, [*unloaded, *of_load])
        pairs = sorted(
            (
                (change_cost(after, before), number, before, after)
                for number, (before, after) in enumerate(
                    (before, after) for before in unloaded for after in of_load
                )
            ),
            key=lambda pair: pair[:2],
        )
        if not pairs:
            return None
        least, _, before, after = pairs[0]
        if len(pairs) == 1:
            return cls(before, after, None, clear=_mostly_still(before, after))
        second, _, *cells = pairs[1]
        other = cells[0] if cells[0] is not before else cells[1]
        clear = second - least > CLEAR and _mostly_still(before, after)
        return cls(before, after, other, clear)

    @property
    def sentence(self) -> str:
        """The doubt that other cells are meant; '' where there is none."""
        if self.clear:
            return ""
        cure = "with a smaller drive_ohm they differ"
        if self.other is None:
            return (
                "between the unloaded and the loaded readings most cells have changed: "
                f"other cells may give these readings; {cure}"
            )
        chosen, other = (float(np.median(cells)) for cells in (self.resting, self.other))
        return (
            f"cells of about {chosen:.2g} ohm and "
            f"of about {other:.2g} ohm give these readings alike, and the former are taken: {cure}"
        )


def change_cost(cells: Array, baseline: Array) -> float:
    """Return Σ ln(1 + (Δ ln r/CHANGE)²) of two panels."""
    return float(np.log1p((np.log(cells / baseline) / CHANGE) ** 2).sum())


def nearest_panel(panels: Sequence[Array], baseline: Array) -> Array:
    """Return the panel in which the fewest cells differ from the unloaded ones."""
    return min(panels, key=lambda cells: change_cost(cells, baseline))


def _mostly_still(before: Array, after: Array) -> bool:
    """Return whether most cells of a pair stand still."""
    return bool(np.median(np.abs(np.log(after / before))) < STILL)


def noise_share(readings: Readings) -> float:
    """Return the reach of readings' noise over their median; 0 where it is unknown."""
    if readings.sigma is None:
        return 0.0
    return NOISE_RANGE * float(np.median(readings.sigma) / np.median(readings.value))
