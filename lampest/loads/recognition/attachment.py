"""Attachments: loads over time, with place and size.

They also have the probabilities that they suck, breathe and pump.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from math import exp, hypot, inf
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logit

from lampest.files.levels import NOISE_REACH, SIGNIFICANT
from lampest.loads.recognition.breath import breath
from lampest.loads.recognition.breathing import MAX_LOG_ODDS, MIN_WINDOW_S, WINDOW_S, Breathing
from lampest.loads.recognition.candidates import UNIFORM, under
from lampest.loads.recognition.contacts import contacts_of
from lampest.loads.recognition.fit import RARE_LOG_ODDS, Verdict
from lampest.loads.recognition.observation import Observation
from lampest.loads.recognition.pumping import BLOCK_S, Pumping
from lampest.loads.recognition.steady_frames import SteadyFrames, changes_without_water
from lampest.loads.recognition.swings import Patterns
from lampest.panel.panel import Array, Panel

Pair = tuple[float, float]
JUDGED_S = 1.0  # between two judgements of breath
# Recognitions of an attachment whose suction is kept: four hours, and then every second one.
MAX_SUCTIONS = 256
MIN_SAMPLE_FRAMES = 3  # of a sample of suction, whose median is free of an outlier


@dataclass(frozen=True)
class Attachment:
    """A load from its arrival until it left.

    Attributes
    ----------
    sucks : float
        Probability that it sucks.
    since_s, until_s : float, float or None
        Times of arrival and departure, s; `until_s` is None while it is present.
    x_mm, y_mm, diameter_mm, area_mm2 : (float, float) or None
        Value and standard deviation; None where unknown.
    suctions : tuple of (float, float)
        Suction in kPa and its standard deviation at each recognition, thinned beyond MAX_SUCTIONS.
    cells : int
        Number of touched cells.
    conductance_s : (float, float) or None
        Increase of their conductance since rest, S, and its standard deviation.
    breath : Breathing
        Breath of its suction, from all windows.
    sucks_s : float or None
        Time at which it began to suck, s; None if it does not.
    moved_s : tuple of float
        Times at which it moved, s.
    placed_s : float
        Time since which it is in its place, s.
    clear : float
        ln evidence over that of an unloaded panel.
    track : Pumping or None
        Pumps of its suction; None before the first sample.
    patterns : Patterns or None
        Effects of swings of its suction on the readings; None where it does not suck.
    """

    sucks: float
    since_s: float
    x_mm: Pair
    y_mm: Pair
    diameter_mm: Pair | None = None
    suctions: tuple[Pair, ...] = ()
    cells: int = 0
    area_mm2: Pair | None = None
    conductance_s: Pair | None = None
    until_s: float | None = None
    breath: Breathing = Breathing()
    sucks_s: float | None = None
    moved_s: tuple[float, ...] = ()
    placed_s: float = -inf
    clear: float = 0.0
    track: Pumping | None = None
    patterns: Patterns | None = field(default=None, repr=False, compare=False)

    @property
    def breathes(self) -> float:
        """Probability that its suction oscillates like breathing, given that it sucks.

        1/2 before any observation.
        """
        return self.breath.probability

    @property
    def suction_kpa(self) -> Pair | None:
        """Typical suction, the median over all recognitions, kPa, and its standard deviation.

        The latter is the median of their standard deviations.
        """
        if not self.suctions:
            return None
        values, errors = np.array(self.suctions).T
        return float(np.median(values)), float(np.median(errors))

    @property
    def strongest_kpa(self) -> Pair | None:
        """Strongest suction, kPa, and its standard deviation.

        It is that which all but its error exceeds all others.
        """
        return min(self.suctions, key=lambda pair: pair[0] + pair[1], default=None)

    @property
    def breathing_hz(self) -> Pair | None:
        """Rate of the oscillation, Hz, and its standard deviation."""
        return self.breath.hertz

    @property
    def breathing_depth(self) -> Pair | None:
        """Relative amplitude of the oscillation, and its standard deviation."""
        return self.breath.depth

    @property
    def pumps(self) -> float:
        """Probability that its suction is pumped up after a decay, given that it sucks.

        1/2 before any observation.
        """
        return 1 / (1 + exp(-self._pumping))

    @property
    def pump_count(self) -> int | None:
        """Number of times that the suction was pumped up; None before the first sample."""
        return None if self.track is None else self.track.pumps[0]

    @property
    def pump_interval_s(self) -> float | None:
        """Mean time between pumps, s; None with less than two."""
        return None if self.track is None else self.track.interval_s

    @property
    def lives(self) -> float:
        """Probability that it is a mouth, given that it sucks.

        It is given by the product of the odds of breath and of pumps.
        """
        # ln odds of breath, at least −ln 20, because one mouth in twenty never shows its breath; ln
        # odds of pumps add
        breathes = max(float(logit(self.breathes)), -RARE_LOG_ODDS)
        return 1 / (1 + exp(-breathes - self._pumping))

    @property
    def _pumping(self) -> float:
        return 0.0 if self.track is None else min(self.track.odds, MAX_LOG_ODDS)

    @property
    def present(self) -> bool:
        """Whether it has not left."""
        return self.until_s is None

    @property
    def place(self) -> tuple[float, float]:
        """Centre, mm."""
        return self.x_mm[0], self.y_mm[0]

    @property
    def size(self) -> float:
        """Diameter, mm; infinite where it is unknown."""
        return inf if self.diameter_mm is None else self.diameter_mm[0]

    @property
    def width(self) -> float:
        """Diameter, mm; for a load without a diameter the edge of a square of its area."""
        return self.size if self.diameter_mm or self.area_mm2 is None else self.area_mm2[0] ** 0.5

    def distance(self, place: tuple[float, float]) -> float:
        """Return the distance to a place, mm."""
        return hypot(self.place[0] - place[0], self.place[1] - place[1])

    def contains(self, contact: "Attachment") -> bool:
        """Return whether a contact without a shape lies under the disc, to the error of its place.

        It is then a part of the rim.
        """
        reach = self.size / 2 + contact.x_mm[1]
        known = self.diameter_mm is not None and contact.diameter_mm is None
        return known and self.distance(contact.place) < reach

    def ended(self, time: float) -> "Attachment":
        """Return the attachment after it left at a time in s.

        It is without what only later frames need.
        """
        return replace(self, until_s=time, patterns=None)

    def continued(self, later: "Attachment") -> "Attachment":
        """Return the later state of the same load, with its history.

        The earlier state is kept if the load sucked and is now less clear, because leaking suction
        has no clear shape.
        """
        if self.sucks > 0.5 > later.sucks and later.clear < self.clear:
            return self
        # a move: farther than three standard deviations of the distance, and than 3 mm
        far = NOISE_REACH * max(
            1.0, hypot(self.x_mm[1], self.y_mm[1], later.x_mm[1], later.y_mm[1])
        )
        moves = self.distance(later.place) > far and later.since_s > self.placed_s
        moved, placed = (
            ((*self.moved_s, later.since_s), later.since_s)
            if moves
            else (self.moved_s, self.placed_s)
        )
        began = later.since_s if self.sucks_s is None and later.sucks > 0.5 else self.sucks_s
        earlier = replace(
            later, since_s=self.since_s, breath=self.breath, track=self.track, placed_s=placed
        )
        suctions = (*self.suctions, *later.suctions)
        thinned = suctions[::2] if len(suctions) > MAX_SUCTIONS else suctions
        return replace(earlier, sucks_s=began, moved_s=moved, suctions=thinned)

    def listened(
        self,
        frames: Sequence[tuple[float, Array]],
        steps: Sequence[float],
        whitening: Array,
        verdict: Verdict,
    ) -> "Attachment":
        """Return the attachment after its breath was judged.

        It is judged by the frames since the last full window in its place.

        Parameters
        ----------
        frames : sequence of (float, array)
            Times, s, and readings ln y, (cells,).
        steps : sequence of float
            Times of steps of the readings, s.
        whitening : array, shape (cells, cells)
        verdict : Verdict
            The last recognition.
        """
        before = self.breath.parted(steps)
        begin = max(before.full_s, self.placed_s)
        times = np.array([at for at, _ in frames if at > begin])
        if self.patterns is None or len(times) < 3:
            return replace(self, breath=before)
        last = float(times[-1])
        if last - times[0] < MIN_WINDOW_S or last - before.judged_s < JUDGED_S:
            return replace(self, breath=before)
        interval = SteadyFrames.of(
            times, np.array([logarithm for at, logarithm in frames if at > begin]), steps
        )
        if not len(interval.times):
            return replace(self, breath=before)
        full = float(np.ptp(interval.times)) > WINDOW_S - 2.5 * interval.period
        changes = changes_without_water(interval, verdict.frame, verdict.best) @ whitening.T
        return replace(
            self, breath=before.after(breath(interval, changes, self.patterns), last, full=full)
        )

    def sampled(
        self, frames: Sequence[tuple[float, Array]], whitening: Array, frame: Observation
    ) -> "Attachment":
        """Return the attachment after a sample of its suction, where the last one is BLOCK_S old.

        `frame` is the recognised one, `whitening` (cells, cells) whitens changes of ln y. A sample
        with too few frames waits.
        """
        if self.patterns is None or self.sucks <= 0.5:
            return self
        track = self.track
        moves = len(self.moved_s)
        time = frames[-1][0]
        begin = (
            max(self.placed_s, frames[0][0])
            if track is None or track.moves != moves
            else track.since_s
        )
        block = np.array([logarithm for at, logarithm in frames if at > begin])
        if time - begin < BLOCK_S or len(block) < MIN_SAMPLE_FRAMES:
            return self
        if track is None or track.moves != moves:
            weights = self.patterns.suction_weights(whitening)
            track = Pumping.begin(weights, np.log(frame.measured.ravel()), begin, moves, track)
        return replace(self, track=track.after(block, time))


def attachments_of(
    frame: Observation, verdict: Verdict, since: float, patterns: Sequence[Patterns | None] = ()
) -> list[Attachment]:
    """Return the loads of the most probable candidate; without a shape, one load for each contact.

    Parameters
    ----------
    frame : Observation
    verdict : Verdict
    since : float
        Time of arrival, s.
    patterns : sequence of Patterns or None
        Patterns of the most probable candidate's loads.
    """
    # ln r/r0 of the cells with the prior N(0, 1), independent of any candidate
    best = verdict.best
    attachments = list[Attachment]()
    first = 0
    change = frame.free_map
    sd = frame.free_sd
    moved = np.abs(change) > NOISE_REACH * np.hypot(
        sd, frame.baseline.model_errors.resting_sd(frame.seconds)
    )
    # Δg = g₀ (e^−x − 1) and σ = g₀ e^−x σ_x of x = ln r/r₀
    resting = np.exp(-frame.baseline.logarithm)
    more = resting * np.expm1(-change)
    errors = resting * np.exp(-change) * sd
    clear = best.evidence - max(fit.evidence for fit in verdict.fits if fit.candidate in UNIFORM)
    for (candidate, parameters), effects in zip_longest(best.loads, patterns):
        disc = candidate.disc(parameters)
        after = first + len(parameters)
        covariance = best.covariance[first:after, first:after]
        first = after
        known: dict[str, Any] = {
            "sucks": verdict.sucks_at(disc),
            "since_s": since,
            "placed_s": since,
            "clear": clear,
            "patterns": effects,
        }
        if disc is None:
            groups = _contacts(frame, more, errors)
        else:
            groups = [moved & under(frame.panel, disc)]
            half_pitch = frame.panel.pitch_mm / 2
            known |= {"x_mm": (disc.x_mm, half_pitch), "y_mm": (disc.y_mm, half_pitch)}
            known["sucks_s"] = since if known["sucks"] > 0.5 else None
            # σ² = sᵀ C s, with s the derivative of the quantity by φ
            reported = {
                name: (value, float(np.sqrt(slopes @ covariance @ slopes)))
                for name, (value, slopes) in candidate.report(parameters).items()
            }
            known["suctions"] = (reported.pop("suction_kpa"),) if "suction_kpa" in reported else ()
            known |= reported
        for group in groups:
            conductance = float(more[group].sum()), float(np.hypot.reduce(errors[group]))
            touched = _touched(frame.panel, group, change)
            attachments.append(Attachment(**touched | known, conductance_s=conductance))
    return attachments


def _contacts(frame: Observation, more: Array, errors: Array) -> list[NDArray[np.bool_]]:
    """Return the cells of the contacts whose conductance rose significantly.

    It rose by `more` siemens with the `errors`.
    """
    sd = np.hypot(frame.free_sd, frame.baseline.model_errors.resting_sd(frame.seconds))
    groups = contacts_of(frame.panel, frame.free_map, sd)
    return [
        group
        for group in groups
        if more[group].sum() > SIGNIFICANT * np.hypot.reduce(errors[group])
    ]


def _touched(panel: Panel, group: NDArray[np.bool_], change: Array) -> dict[str, Any]:
    """Return the centre, number and area of a group of cells, by their names.

    The cells changed by ln r/r0.
    """
    # centre of the cells weighted by |ln r/r₀|, to half a pitch
    weight = np.abs(change) * (group if group.any() else 1.0)
    half_pitch = panel.pitch_mm / 2
    x, y = (float(np.nansum(weight * line) / weight.sum()) for line in panel.places_mm)
    count = int(group.sum())
    square = panel.pitch_mm**2
    area = count * square, square * (max(count, 1) / 3) ** 0.5
    return {"x_mm": (x, half_pitch), "y_mm": (y, half_pitch), "cells": count, "area_mm2": area}


def continued_by(
    before: Sequence[Attachment], loads: Sequence[Attachment], time: float, *, again: bool = False
) -> tuple[Attachment, ...]:
    """Return all attachments after a recognition.

    Each load continues the nearest attachment that is present. Where a clearer earlier recognition
    is kept, contacts under its disc are parts of that load.

    Parameters
    ----------
    before : sequence of Attachment
    loads : sequence of Attachment
        Loads that were recognised.
    time : float
        Time of the last step, s; attachments without a load left then.
    again : bool
        Whether it is a repeated recognition since that step. Attachments without a load then stay,
        because nothing leaves without a step, except those that arrived with the step, which were
        parts of another load.
    """
    attachments = list(before)
    left = [number for number, load in enumerate(before) if load.present]
    kept = list[Attachment]()
    # Greedy matching: the load with the nearest attachment first, within the larger diameter of
    # both.
    distances = [
        min((attachments[number].distance(load.place) for number in left), default=inf)
        for load in loads
    ]
    for load in (loads[number] for number in np.argsort(distances, kind="stable")):
        near = min(left, key=lambda number: attachments[number].distance(load.place), default=None)
        if near is not None and attachments[near].distance(load.place) < max(
            attachments[near].size, load.size
        ):
            former = attachments[near]
            attachments[near] = former.continued(load)
            left.remove(near)
            kept += [former] if attachments[near] is former else []
        elif not any(clearer.contains(load) for clearer in kept):
            attachments.append(load)
    if again:
        return tuple(
            load
            for number, load in enumerate(attachments)
            if number not in left or load.since_s < time
        )
    for number in left:
        attachments[number] = attachments[number].ended(time)
    return tuple(attachments)
