"""Frames that a circuit has to explain, and the cells that it needs, with their evidence.

The frames are the unloaded panel and the most strongly loaded ones. Of the frames with the
strongest change, those that are equal within their noise are averaged. Outliers and readings whose
noise is not Gaussian do not count. `broken_law` tests the circuit's inequalities on all frames.

Explanations of a pair of frames are compared by evidence, which decreases with the number of cells
that must have moved between the unloaded panel and the loaded frame.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import BROKEN, InputError
from lampest.files.levels import SIGNIFICANCE
from lampest.inference.cells_fit import CellsFit, fitted
from lampest.inference.circuits.alike import PanelChoice
from lampest.inference.circuits.alternatives import Alternative, standing_frames
from lampest.inference.circuits.loaded_density import LoadedDensity
from lampest.inference.pair import FittedPair
from lampest.inference.readings.free_tests import free_tests
from lampest.inference.unloaded_cells import unloaded_costs
from lampest.inference.variance_components import noted_excess
from lampest.panel.effects.line_effect import LineEffect
from lampest.panel.panel import Array, Mask, Numbers
from lampest.panel.readouts.starts import several_panels
from lampest.posterior.interval import largest_of
from lampest.recording.readings import Readings, strongest_frame
from lampest.recording.recording import MEASURED, UNLOADED, Recording

NO_ERROR = np.zeros(1)  # of each reading, beside its noise
FAR = 100.0  # in scores, beyond what channels and the selection of moved cells change


@dataclass(frozen=True, eq=False)
class ComparedFrames:
    """Frames that a circuit has to explain.

    Attributes
    ----------
    specified : Alternative
        The scene's circuit, with a saturated stage where the readings show one; outliers are
        missing.
    role : array, shape (frames,)
    resting, standing : integer array
        Numbers of the unloaded frames, and of measured frames that are equal within their noise.
    widening : float
        Factor on every σ.
    named : integer array, shape (frames,)
        Numbers of all frames as sentences state them.
    named_errors : array, shape (frames, rows, columns), or None
        Standard deviations of the errors that the scene names beside noise: of each reading, of
        motion. The errors of n unloaded frames are √n times the error of their mean.
    """

    specified: Alternative
    role: NDArray[np.uint8]
    resting: Numbers
    standing: Numbers
    widening: float
    named: Numbers
    named_errors: Array | None = None

    @classmethod
    def of(cls, recording: Recording, outliers: Mask) -> Self:
        """Return the frames of a recording whose noise is known.

        A recording without an unloaded frame has its first frame instead.
        """
        role = recording.role
        specified = Alternative(
            recording.scene, np.where(outliers, np.nan, recording.recorded), recording.sigma
        )
        readings = specified.readings
        named = np.arange(len(role)) if recording.number is None else recording.number
        resting = np.flatnonzero(role == UNLOADED) if np.any(role == UNLOADED) else np.array([0])
        standing = np.setdiff1d(np.flatnonzero(role == MEASURED), resting)
        # The most strongly loaded frame, averaged with those that are equal to it within their
        # noise.
        used = replace(readings, seen=readings.seen * specified.nearly_gaussian(1))
        noise = noise_factor(used[resting])
        if len(standing):
            frame = strongest_frame(readings.plain_values, readings[resting].mean().value, standing)
            standing = standing_frames(used, frame, standing, noise)
        return cls(specified, role, resting, standing, noise, named)

    @cached_property
    def others(self) -> Self | None:
        """Every second unloaded frame, and the strongest loaded frame that is not compared.

        The value is None without such a frame.
        """
        loaded = np.setdiff1d(np.flatnonzero(self.role == MEASURED), self.standing)
        loaded = loaded[(self._usable[loaded] > 0).any(axis=(1, 2))]
        if not len(loaded):
            return None
        readings = self.specified.readings
        resting = self.resting[1::2] if len(self.resting) > 1 else self.resting
        unloaded = readings[resting].mean().value
        strongest = strongest_frame(readings.plain_values, unloaded, loaded)
        return replace(self, resting=resting, standing=np.array([strongest]))

    @property
    def loaded(self) -> str:
        """The loaded frames in words: 'frame 3', or 'frames 3 to 9'."""
        first, last = self.named[self.standing[[0, -1]]]
        return f"frame {first}" if first == last else f"frames {first} to {last}"

    def readings(self, alternative: Alternative) -> tuple[Readings, ...]:
        """Return the mean of the unloaded frames, and of the standing ones.

        Raises InputError as `Alternative.readings`.
        """
        chosen = np.concatenate([self.resting, self.standing])
        count = len(self.resting)
        read = alternative.readings[chosen]
        usable = alternative.ordered(self._usable[chosen])
        read = replace(read, sigma=self.widening * read.known_sigma, seen=read.seen * usable)
        means = [read[:count].mean()]
        if len(self.standing):
            means.append(read[count:].mean())
        if self.named_errors is None:
            return tuple(means)
        # Errors that frames share do not average out.
        errors = alternative.ordered(self.named_errors) ** 2
        return tuple(
            replace(
                mean, sigma=np.hypot(mean.known_sigma, np.sqrt(np.mean(errors[frames], axis=0)))
            )
            for mean, frames in zip(means, (self.resting, self.standing), strict=False)
        )

    @cached_property
    def panels(self) -> PanelChoice | None:
        """Panels of the frames under the scene's circuit, where several give their readings.

        The value is None where only one panel does, and without a loaded frame.
        """
        scene = self.specified.scene
        several = several_panels(scene.circuit, *scene.panel.shape)
        if not several or scene.wiring is not None or not len(self.standing):
            return None
        resting, loaded = self.readings(self.specified)
        return PanelChoice.of(scene, resting, loaded)

    @cached_property
    def _usable(self) -> Array:
        """Weights, 1 or 0, of the readings that every circuit has to explain.

        Shape (frames, rows, columns).
        """
        return self.specified.nearly_gaussian(max(len(self.resting), len(self.standing)))


def noise_factor(resting: Readings) -> float:
    """Return √(χ²/degrees) of unloaded frames (frames, rows, columns) about their mean.

    See `noted_excess`.
    """
    plain = np.all(resting.plain, axis=0)
    if resting.sigma is None:
        return 1.0
    squares = ((resting.value - resting.value.mean(axis=0)) / resting.sigma)[:, plain] ** 2
    return noted_excess(float(squares.sum()), (len(resting.value) - 1) * int(plain.sum()))


def broken_law(alternative: Alternative, frames: ComparedFrames) -> str:
    """Return the circuit's inequality that the readings violate significantly, in words.

    The text is '' where none is violated.
    """
    readings = alternative.readings
    sigma = replace(
        readings, seen=readings.seen * frames.specified.nearly_gaussian(1)
    ).sigma_of_values
    assert sigma is not None
    for test in free_tests(alternative.scene.circuit, readings.value, frames.widening * sigma):
        frame = int(np.argmax(test.excess))
        if largest_of(test.excess[frame], test.count * len(test.excess)) < SIGNIFICANCE:
            beyond = f"{test.excess[frame]:.3g} times its noise"
            return (
                f"readings of frame {frames.named[frame]} break a law "
                f"of the circuit by {beyond}: {test.law}"
            )
    return below_series(alternative, frames)


def below_series(alternative: Alternative, frames: ComparedFrames) -> str:
    """Return a sentence on the reading that lies significantly below its series resistance.

    The sentence is '' where no reading does.
    """
    scene = alternative.scene
    readings = alternative.readings
    if scene.circuit.unit != "ohm" or readings.sigma is None:
        return ""
    remaining = scene.circuit.from_recorded(alternative.recorded, scene)
    read = (readings.seen > 0) & np.isfinite(remaining)
    excess = np.where(read, -remaining / readings.sigma, -np.inf)
    if largest_of(excess.max(), excess.size) >= SIGNIFICANCE:
        return ""
    place = np.unravel_index(np.argmax(excess), excess.shape)
    frame, row, column = place
    return (
        f"the reading of row {row}, column {column} in frame {frames.named[frame]} "
        f"lies {-remaining[place]:.3g} ohm below its series resistance, "
        f"{excess[place]:.3g} times its noise"
    )


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
