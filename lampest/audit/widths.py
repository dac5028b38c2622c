"""Widths of error bars by their causes.

The errors of a cell's estimate without a penalty are K(U z + ε) to first order, with the gain K of
the fit, errors z that all frames share and the noise ε. Each has a part of the variance. The errors
of a change ln(r/r0) are K_f(U_f z + ε_f) − K_b(U_b z + ε_b), of the frame f and the unloaded panel
b.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from lampest.files.errors import BROKEN
from lampest.inference.cells_fit import CellsFit, data_of_cells
from lampest.inference.prepared import Prepared
from lampest.panel.effects import sized_effects, systematic_of
from lampest.panel.panel import Array, Mask
from lampest.panel.sizes import Systematic
from lampest.recording.recording import Recording

NOISE = "noise"
MIN_SHARE = 0.005  # smaller shares round to 0 %
MIN_CHANGE = 0.05  # of the logarithm of a cell: a load, not drift


@dataclass(frozen=True)
class Width:
    """Standard deviation of a logarithm, and its causes.

    Attributes
    ----------
    what : str
        'cells' or 'changes'.
    deviation : float
        Standard deviation of ln r, or of ln(r/r0) of cells that changed; the median over cells.
    shares : mapping
        Key of `systematic`, or 'noise' → its share of the variance, the median over cells.
    """

    what: str
    deviation: float
    shares: Mapping[str, float]

    def share(self, name: str) -> str:
        """Return a share in words, such as '12 %' or '< 1 %'."""
        share = self.shares[name]
        return f"{100 * share:.0f} %" if share >= MIN_SHARE else "< 1 %"

    @property
    def sentence(self) -> str:
        """The width in words, such as 'cells 3.4 %: reference_tolerance 90 %, noise 10 %'."""
        ranked = sorted(self.shares.items(), key=lambda item: -item[1])
        shown = [f"{name} {self.share(name)}" for name, share in ranked if share >= MIN_SHARE]
        return f"{self.what} {100 * self.deviation:.2g} %: {', '.join(shown)}"


def widths_of(prepared: Prepared) -> tuple[Width, ...]:
    """Return the widths of cells and of changes, as the strongest frame shows them.

    The result is empty where the scene names no errors, or no fit has explained the frames, for
    modules, and for panels too large for dense matrices.

    Parameters
    ----------
    prepared : Prepared
        Preparation of the recording.
    """
    if prepared.layout is not None or prepared.cleaned.readings.sigma is None:
        return ()
    with suppress(*BROKEN), np.errstate(all="ignore"):
        explanation = prepared.question.explanation
        pair = None if explanation is None else explanation.pair
        possible = prepared.noise.possible_errors
        sizes = systematic_of(prepared.recording.scene) if possible is None else possible.sizes
        if pair is not None and sizes is not None:
            return widths_at(*pair.frames, sizes, pair.moved)
    return ()


def simulated_widths(recording: Recording) -> tuple[Width, ...]:
    """Return the widths of a simulated recording, at its true cells in the first and last frame.

    The result is empty without true cells, and for panels too large for dense matrices.
    """
    scene = recording.scene
    cells = recording.truth_cell_resistance
    if cells is None:
        return ()
    readings = recording.readings()
    fits = []
    for frame in (0, -1):
        measured = readings[frame]
        data = data_of_cells(scene, measured)
        fits.append(CellsFit.at(scene, data, measured, cells[frame]))
    moved = np.abs(np.log(cells[-1] / cells[0])) > MIN_CHANGE
    resting, loaded = fits
    return widths_at(resting, loaded, systematic_of(scene) or Systematic(), moved)


def widths_at(
    resting: CellsFit, loaded: CellsFit, sizes: Systematic, moved: Mask
) -> tuple[Width, ...]:
    """Return the widths of cells and of changes by the fits of two frames.

    Parameters
    ----------
    resting, loaded : CellsFit
        Fits of the unloaded panel and of a frame.
    sizes : Systematic
        Standard deviations of the errors that they share.
    moved : boolean array, shape (rows, columns)
        Cells whose changes count; all where none is True.
    """
    if not resting.jacobian.size:
        return ()
    of_cells = {NOISE: np.diag(loaded.covariance)}
    of_changes = {NOISE: np.diag(resting.covariance) + np.diag(loaded.covariance)}
    for error in sized_effects(sizes):
        if not sizes.size(error.setting):
            continue
        before, after = (fit.response_to((error,), sizes) for fit in (resting, loaded))
        of_cells[error.setting] = np.sum(after**2, axis=1)
        of_changes[error.setting] = np.sum((after - before) ** 2, axis=1)
    counted = moved.ravel() if moved.any() else np.ones(moved.size, dtype=bool)
    of_changes = {name: variance[counted] for name, variance in of_changes.items()}
    return _width("cells", of_cells), _width("changes", of_changes)


def _width(what: str, variances: Mapping[str, Array]) -> Width:
    """Return the width by the variances of all causes, each (cells,)."""
    medians = {name: float(np.median(variance)) for name, variance in variances.items()}
    total = sum(medians.values())
    deviation = float(np.sqrt(np.median(np.sum([*variances.values()], axis=0))))
    return Width(what, deviation, {name: median / total for name, median in medians.items()})
