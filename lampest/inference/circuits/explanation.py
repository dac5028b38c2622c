"""Explanation of frames by a circuit: the cells that it needs, and their evidence.

Explanations of a pair of frames are compared by evidence, which decreases with the number of cells
that must have moved between the unloaded panel and the loaded frame.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lampest.files.errors import BROKEN, InputError
from lampest.inference.cells_fit import CellsFit, fitted
from lampest.inference.circuits.alternatives import Alternative
from lampest.inference.circuits.compared_frames import ComparedFrames
from lampest.inference.circuits.loaded_density import LoadedDensity
from lampest.inference.pair import FittedPair
from lampest.inference.unloaded_cells import unloaded_costs
from lampest.panel.effects.line_effect import LineEffect
from lampest.panel.readouts.starts import several_panels

NO_ERROR = np.zeros(1)  # of each reading, beside its noise
FAR = 100.0  # in scores, beyond what channels and the selection of moved cells change


@dataclass(frozen=True, eq=False)
class Explanation:
    """Cells that explain the readings under a circuit.

    Attributes
    ----------
    alternative : Alternative
        The circuit.
    fits : tuple of CellsFit
        Fits of the unloaded panel and, if there is one, of the loaded frame.
    pair : FittedPair or None
        The pair of both; None without a loaded frame, or on a panel of more than MAX_CELLS.
    """

    alternative: Alternative
    fits: tuple[CellsFit, ...]
    pair: FittedPair | None

    @classmethod
    def of(
        cls,
        alternative: Alternative,
        frames: ComparedFrames,
        near: "Explanation | None" = None,
        *,
        patient: bool = False,
    ) -> "Explanation | None":
        """Return a circuit's explanation of the frames; None where no fit is found.

        Parameters
        ----------
        alternative : Alternative
        frames : ComparedFrames
        near : Explanation or None
            Explanation by a similar circuit: the fits begin at its cells, and `like` applies.
        patient : bool
            See `fits_of`.
        """
        fits = fits_of(alternative, frames, near.fits if near else (), patient=patient)
        return cls.by(fits, alternative, frames, near)

    @classmethod
    def by(
        cls,
        fits: tuple[CellsFit, ...],
        alternative: Alternative,
        frames: ComparedFrames,
        near: "Explanation | None" = None,
        specified: "Explanation | None" = None,
    ) -> "Explanation | None":
        """Return a circuit's explanation by fits; None where they lack a frame.

        Parameters
        ----------
        fits : tuple of CellsFit
            Those of `fits_of`.
        alternative : Alternative
        frames : ComparedFrames
        near : Explanation or None
            Explanation by a similar circuit, to which `like` applies.
        specified : Explanation or None
            Explanation by the scene's circuit, for an alternative of it. An alternative whose score
            is larger by FAR with the channels and moved cells of that explanation keeps them.
        """
        if len(fits) < (2 if len(frames.standing) else 1):
            return None
        with suppress(InputError, *BROKEN):
            pair = None
            if len(fits) == 2 and fits[0].jacobian.size:
                pair = FittedPair(fits)
            explanation = cls(alternative, fits, pair)
            if near is not None:
                explanation = explanation.like(near)
            elif specified is not None and alternative.order is None:
                coarse = explanation.like(specified)
                explanation = coarse if coarse.score > specified.score + FAR else explanation
            return explanation if np.isfinite(explanation.score) else None
        return None

    def like(self, near: "Explanation") -> "Explanation":
        """Return the explanation with the channels and about the moved cells of a similar one.

        Such a score costs less; see `final`.
        """
        if self.pair is None or near.pair is None:
            return self
        pair = replace(self.pair, known_channels=near.pair.channels, start=near.pair.evidence.moved)
        return replace(self, pair=pair)

    def with_effects(self, effects: tuple[LineEffect, ...]) -> "Explanation":
        """Return the explanation with effects beside the circuit; the same where no cells fit.

        Sizes of effects since the unloaded frames are those of the loaded frame.
        """
        pair = None if self.pair is None else self.pair.with_effects(effects)
        if pair is not None and any(effect.since for effect in effects):
            pair = pair.settled(effects)
        return self if pair is None else replace(self, fits=pair.frames, pair=pair)

    @cached_property
    def final(self) -> "Explanation":
        """The explanation with nothing taken over from a similar one."""
        if self.pair is None or self.pair.known_channels is None:
            return self
        return replace(self, pair=FittedPair(self.pair.frames))

    @cached_property
    def score(self) -> float:
        """−2 ln density of the loaded frame, and the costs of parameters."""
        return 0.0 if self.pair is None else self.pair.density + self.pair.misfits

    @cached_property
    def linear_evidence(self) -> float:
        """−2 ln evidence of both frames by linear theory about the fits, with costs of parameters.

        Cells of the unloaded panel are alike, and changes are single ones, loads, or a field. The
        value is infinite where arithmetic breaks down.
        """
        if self.pair is None:
            return 0.0
        with suppress(*BROKEN):
            return self._density_at_rest + self.pair.density_of_loads + self.pair.misfits
        return np.inf

    @cached_property
    def evidence(self) -> float:
        """The same about the most probable cells, which costs solves of the network."""
        if self.pair is None:
            return 0.0
        with suppress(*BROKEN):
            loaded = LoadedDensity(self.pair).cost + self.pair.cost_of_effects
            return self._density_at_rest + loaded + self.pair.cost_of_bounds
        return np.inf

    @cached_property
    def _density_at_rest(self) -> float:
        """−2 ln density of the unloaded readings in units of their noise."""
        resting = self.fits[0]
        readings = resting.readings
        costs = unloaded_costs(resting.scene, readings, resting, NO_ERROR)
        return float(costs[0, 0]) - 2 * float(np.log(readings.known_sigma[readings.plain]).sum())

    @cached_property
    def beyond_noise(self) -> float:
        """−2 ln evidence of the changes beyond that of noise alone, and the costs of parameters."""
        return 0.0 if self.pair is None else self.pair.beyond_noise + self.pair.misfits


def fits_of(
    alternative: Alternative,
    frames: ComparedFrames,
    near: Sequence[CellsFit] = (),
    *,
    patient: bool = False,
) -> tuple[CellsFit, ...]:
    """Return the fits of the frames under a circuit, up to the first frame without a fit.

    Parameters
    ----------
    alternative : Alternative
    frames : ComparedFrames
    near : sequence of CellsFit
        Fits of the first frames under a similar circuit, at whose cells the fits begin.
    patient : bool
        Whether a fit is searched for from every start and accepted with any misfit. Otherwise the
        fit of the loaded frame begins at the cells of the unloaded panel, and a frame has a fit
        only if the circuit explains it.
    """
    fits: list[CellsFit] = []
    with suppress(InputError, *BROKEN):
        chosen = frames.panels if alternative is frames.specified else None
        for number, frame in enumerate(frames.readings(alternative)):
            start = near[number].cells if number < len(near) else None
            if start is None and chosen is not None:
                start = (chosen.resting, chosen.loaded)[number]
            if start is None and fits and not patient:
                start = fits[0].cells
            fit = fitted(alternative.scene, frame, start, patient=patient)
            # of two panels that read alike the one that continues the unloaded panel is meant
            elsewhere = chosen is None and fit is not None and bool(fits)
            if elsewhere and fit and fit.network.branch != fits[0].network.branch:
                fit = fitted(alternative.scene, frame, fits[0].cells, patient=patient)
            if fit is None or not (patient or fit.within_noise):
                break
            fits.append(fit)
    return tuple(fits)


def alternative_fits(
    alternative: Alternative,
    frames: ComparedFrames,
    near: tuple[CellsFit, ...] = (),
    specified: Explanation | None = None,
) -> tuple[CellsFit, ...]:
    """Return the fits under an alternative, from the scene's cells where these suffice.

    Where several panels read alike, the readout's start determines which one is meant.

    Parameters
    ----------
    alternative : Alternative
    frames : ComparedFrames
    near : tuple of CellsFit
        Fits under a circuit that is nearer; () without any.
    specified : Explanation or None
        Explanation by the scene's circuit.
    """
    if near or specified is None or alternative.order is not None:
        return fits_of(alternative, frames, near)
    if several_panels(alternative.scene.circuit, *alternative.scene.panel.shape):
        return fits_of(alternative, frames)
    return fits_of(alternative, frames, specified.fits[:1]) or fits_of(alternative, frames)
