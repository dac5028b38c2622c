"""Terms, bounds and readings as one problem: the cost of the terms, and the data of one solve."""

from dataclasses import dataclass, replace
from math import isfinite
from typing import Literal

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.given import Background, Given
from lampest.cost.problem import Data
from lampest.cost.terms import Term
from lampest.files.errors import InputError
from lampest.files.typed import Configuration
from lampest.panel.panel import Array, Mask
from lampest.panel.readouts import Readout
from lampest.panel.readouts.starts import least_cells, nearly_shorted, resolution
from lampest.panel.readouts.wiring import Wiring
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings, Sidedness, stand_in_spread

# of the apparent resistance: beyond, double precision has no difference
OPEN_FACTOR = 1e9
SHORT_FACTOR = 1e-6
# Lower bound of a cell whose reading contradicts its bounds, over its upper bound.
CONTRADICTED_FACTOR = 1e-3
MAX_CONTRADICTED = 0.5  # of the readings: if more contradict the bounds, the bounds are the mistake
UNKNOWN_NOISE = 0.01  # of a reading, where the noise is not specified: that of a 10-bit divider
MAX_STAND_IN_WEIGHT = 0.99  # of a substitute: `seen` = 1 denotes a reading that was measured


@dataclass(frozen=True)
class Bounds(Configuration):
    """Bounds of cell resistances. Source: paper, equation (12).

    Attributes
    ----------
    lower : 'measured', float or 'none'
        'measured' is the least that the readout's theory allows, r ≥ R_m of two-point readings; a
        number is in ohm; 'none' is 10⁻⁶·R_a, a dead short, with R_a the readout's apparent
        resistance.
    upper : 'resolution', float or 'none'
        'resolution' is the value beyond which a cell reads like an open one, R²/σ of
        two-point readings and at least twice the cell of a uniform panel; where σ is unknown, as
        'none'. A number is in ohm. 'none' is 10⁹·R_a, where double precision sees no difference.

    Raises ValueError where a number is not positive and finite.

    >>> lampest.Bounds(lower=100.0, upper="none").lower
    100.0
    """

    lower: Literal["measured", "none"] | float = "measured"
    upper: Literal["resolution", "none"] | float = "resolution"

    def __post_init__(self) -> None:
        for name in ("lower", "upper"):
            value = getattr(self, name)
            if not isinstance(value, str) and not (isfinite(value) and value > 0):
                raise ValueError(f"{name} must be a word or a positive, finite number of ohm")

    def limits(
        self, readout: Readout, measured: Array, sigma: Array | None, wiring: Wiring | None = None
    ) -> tuple[Array, Array]:
        """Return the lower and the upper bounds of the cell resistances.

        A reading bounds the cell in series with its wires, which form the only path without another
        cell; all other paths are parallel to it and only lower the reading (Rayleigh monotonicity).
        A reading beyond the upper bound is wrong, and does not bound its cell from below.

        Parameters
        ----------
        readout : Readout
        measured, sigma : array, shape (..., rows, columns)
            Readings and their standard deviations in the readout's unit; sigma is None where
            unknown.
        wiring : Wiring or None
            Resistances of the lines.

        Returns
        -------
        lower, upper : array, shape (..., rows, columns)
            In ohm.

        Raises InputError where the upper bound is below the lower one for more than half of the
        readings.
        """
        shorts = nearly_shorted(readout, measured)
        lower = shorts
        upper = readout.apparent_resistance(measured) * OPEN_FACTOR
        if self.lower == "measured":
            least = least_cells(readout, measured, sigma)
            lower = least
            if wiring is not None:
                lower = np.maximum(least - wiring.path_ohm(measured.shape[-2:]), shorts)
        elif not isinstance(self.lower, str):
            lower = np.full_like(measured, self.lower)
        if self.upper == "resolution" and sigma is not None:
            upper = resolution(readout, measured, sigma)
        elif not isinstance(self.upper, str):
            upper = np.full_like(measured, self.upper)
        contradicted = upper <= lower
        if np.mean(contradicted) > MAX_CONTRADICTED:
            index = tuple(int(part) for part in np.argwhere(contradicted)[0])
            raise InputError(
                f"bounds leave no room for cell {index[-2:]}: "
                f"lower {lower[index]:.6g} ohm, upper {upper[index]:.6g} ohm"
            )
        shorted = np.minimum(shorts, upper * CONTRADICTED_FACTOR)
        return np.where(contradicted, shorted, lower), upper


def data_of_solve(
    terms: tuple[Term, ...], bounds: Bounds, readings: Readings, background: Background
) -> Data:
    """Return the data of one solve.

    Parameters
    ----------
    terms : tuple of Term
    bounds : Bounds
    readings : Readings
        (frames, rows, columns): one frame, or two that are solved jointly.
    background : Background
        Scene, and what is known of the previous frame and the baseline.

    Raises InputError as `Bounds.limits`, and where a term needs the noise and it is unknown.
    """
    measured = readings.value
    sigma = readings.sigma
    scene = background.scene
    if sigma is None:
        if any(getattr(term, "weighting", "plain") == "noise" for term in terms):
            raise InputError(
                "misfit.weighting: noise needs a readout in the scene or sigma in the recording"
            )
        if any(term.weighs_previous for term in terms):
            raise InputError(
                "arrival needs the noise: a readout in the scene or sigma in the recording"
            )
    # Missing readings have substitutes where no penalty determines their cells.
    stood_in = np.full(len(measured), all(term.reads_measurement for term in terms))
    stood_in[:-1] = all(term.reads_measurement for term in terms if not term.needs_previous)
    readings = with_weights_of_missing(readings, scene, stood_in)
    # The bounds hold for measured values. One-sided and missing readings leave their cells free
    # on that side.
    lower, upper = bounds.limits(scene.circuit, measured, sigma, scene.wiring)
    apparent = scene.circuit.apparent_resistance(measured)
    shorts = nearly_shorted(scene.circuit, measured)
    lower = np.where((readings.side == Sidedness.AT_MOST) | (readings.seen < 1), shorts, lower)
    upper = np.where(readings.side != 0, apparent * OPEN_FACTOR, upper)
    if not scene.whole:
        # cells that the scene states to be open or shorted are fixed near 10⁹ or 10⁻⁶ of the
        # panel's geometric mean
        typical = np.exp(np.mean(np.log(apparent), axis=(-2, -1), keepdims=True))
        fixed = (scene.open_cells, OPEN_FACTOR), (scene.shorted_cells, SHORT_FACTOR)
        for cells, factor in fixed:
            lower = np.where(cells, typical * factor, lower)
            upper = np.where(cells, typical * factor, upper)
    given = Given.of(readings, background)
    noisy = sigma is not None
    return Data(given, lower, upper, scene.circuit, scene.wiring, noisy, parts=scene.parts)


def cost_of_solve(
    terms: tuple[Term, ...], scene: Scene, frames: int = 1, *, partial: bool = False
) -> Cost:
    """Return the terms over one frame, or jointly over two, without absent and broken cells.

    Parameters
    ----------
    terms : tuple of Term
    scene : Scene
    frames : int
        1 or 2.
    partial : bool
        Whether readings may be bounds or missing.
    """
    broken = () if scene.whole else tuple(np.flatnonzero(scene.broken).tolist())
    return Cost(scene.panel.bare, terms, frames, broken, partial)


def with_weights_of_missing(readings: Readings, scene: Scene, stand_ins: Mask) -> Readings:
    """Return the readings with weights `seen` for bounds and for substitutes of missing readings.

    The weight is the ratio of the frame's typical noise to the reading's own noise. A bound has its
    own noise: at a rail it is a thousand times that of a value, and in ohm one false infinity would
    otherwise outweigh all other readings. A missing reading has no weight, unless `stand_ins`
    requests a substitute: the prediction from its row and column, with the spread of that
    prediction as noise. With fewer readings than cells, the readings alone do not determine a cell
    whose own reading is missing; a penalty does, and without a penalty the substitute does.
    Readings that the scene's faults make blind keep no weight.

    Parameters
    ----------
    readings : Readings
        (frames, rows, columns).
    scene : Scene
    stand_ins : boolean array, shape (frames,)
        Frames whose missing readings have substitutes.
    """
    if not readings.partial:
        return readings
    known = readings.sigma is not None
    missing = readings.missing(scene) & stand_ins[:, None, None]
    replaced = missing | (readings.bounds & known)
    noise = readings.value * UNKNOWN_NOISE if readings.sigma is None else readings.sigma
    # own: noise of each bound and substitute; usual: geometric mean of σ over the frame's values
    wide = noise.copy()
    usual = np.ones((len(noise), 1, 1))
    for frame, plain in enumerate(readings.plain):
        if plain.any():
            usual[frame] = np.exp(np.log(noise[frame][plain]).mean())
        if missing[frame].any():
            spread = stand_in_spread(readings.value[frame], plain)
            wide[frame] = np.where(missing[frame], readings.value[frame] * spread, wide[frame])
    # weight usual/own, at most 1; σ · weight is the typical noise, so that weighted residuals keep
    # their scale
    most = np.where(missing, MAX_STAND_IN_WEIGHT, 1.0)
    share = np.where(replaced, np.minimum(usual / wide, most), 1.0)
    sigma = np.where(replaced, wide * share, noise) if known else None
    return replace(readings, sigma=sigma, seen=np.where(missing, share, readings.seen * share))
