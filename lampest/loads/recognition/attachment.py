"""Attachments: loads over time, with place, size, and the probabilities that they suck, breathe and pump."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from math import exp, hypot, inf
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.special import logit

from lampest.files.levels import NOISE_REACH, SIGNIFICANT
from lampest.loads.recognition.breathing import MAX_LOG_ODDS, Breathing, Patterns
from lampest.loads.recognition.candidates import UNIFORM, under
from lampest.loads.recognition.fit import RARE_LOG_ODDS, Verdict
from lampest.loads.recognition.observation import Observation
from lampest.loads.recognition.pumping import Pumping
from lampest.panel.panel import Array, Panel

Pair = tuple[float, float]


@dataclass(frozen=True)
class Attachment:
    """A load from its arrival until it left.

    Attributes
    ----------
    sucks : float
        Probability that it sucks.
    since_s, until_s : float, float or None
        Times of arrival and departure, s; `until_s` is None while it is present.
    x_mm, y_mm, diameter_mm, suction_kpa, area_mm2 : (float, float) or None
        Value and standard deviation; None where unknown.
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
    suction_kpa: Pair | None = None
    cells: int = 0
    area_mm2: Pair | None = None
    conductance_s: Pair | None = None
    until_s: float | None = None
    breath: Breathing = Breathing()
    sucks_s: float | None = None
    moved_s: tuple[float, ...] = ()
    clear: float = 0.0
    track: Pumping | None = None
    patterns: Patterns | None = field(default=None, repr=False, compare=False)

    @property
    def breathes(self) -> float:
        """Probability that its suction oscillates like breathing, given that it sucks; 1/2 before any observation."""
        return self.breath.probability

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
        """Probability that its suction is pumped up after a decay, given that it sucks; 1/2 before any observation."""
        return 1 / (1 + exp(-self._pumping))

    @property
    def lives(self) -> float:
        """Probability that it is a mouth, given that it sucks: the product of the odds of breath and of pumps."""
        # ln odds of breath, at least −ln 20, because one mouth in twenty never shows its breath; ln odds of pumps add
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

    def continued(self, later: "Attachment") -> "Attachment":
        """Return the later state of the same load, with its history.

        The earlier state is kept if the load sucked and is now less clear, because leaking suction has no clear shape.
        """
        if self.sucks > 0.5 > later.sucks and later.clear < self.clear:
            return self
        # a move: farther than three standard deviations of the distance, and than 3 mm
        far = NOISE_REACH * max(1.0, hypot(self.x_mm[1], self.y_mm[1], later.x_mm[1], later.y_mm[1]))
        moved = (*self.moved_s, later.since_s) if self.distance(later.place) > far else self.moved_s
        began = later.since_s if self.sucks_s is None and later.sucks > 0.5 else self.sucks_s
        earlier = replace(later, since_s=self.since_s, breath=self.breath, track=self.track)
        return replace(earlier, sucks_s=began, moved_s=moved)


def attachments_of(
    frame: Observation, verdict: Verdict, since: float, patterns: Sequence[Patterns | None] = ()
) -> list[Attachment]:
    """Return the loads of the most probable candidate; without a shape, one load for each group of changed cells.

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
    best, shape, attachments, first = verdict.best, frame.measured.shape, list[Attachment](), 0
    cells = frame.cells(np.zeros(shape), np.eye(frame.measured.size))
    change, sd = cells.state.reshape(shape), np.sqrt(np.diag(cells.covariance)).reshape(shape)
    moved = np.abs(change) > NOISE_REACH * np.hypot(sd, frame.baseline.model_errors.resting_sd(frame.seconds))
    # Δg = g₀ (e^−x − 1) and σ = g₀ e^−x σ_x of x = ln r/r₀
    resting = np.exp(-frame.baseline.logarithm)
    more, errors = resting * np.expm1(-change), resting * np.exp(-change) * sd
    clear = best.evidence - max(fit.evidence for fit in verdict.fits if fit.candidate in UNIFORM)
    for (candidate, parameters), effects in zip_longest(best.loads, patterns):
        disc, after = candidate.disc(parameters), first + len(parameters)
        covariance, first = best.covariance[first:after, first:after], after
        known: dict[str, Any] = {"sucks": verdict.sucks_at(disc), "since_s": since, "clear": clear, "patterns": effects}
        if disc is None:
            groups = _groups(frame.panel, moved, more, errors)
        else:
            groups, half_pitch = [moved & under(frame.panel, disc)], frame.panel.pitch_mm / 2
            known |= {"x_mm": (disc.x_mm, half_pitch), "y_mm": (disc.y_mm, half_pitch)}
            known["sucks_s"] = since if known["sucks"] > 0.5 else None
            for name, (value, slopes) in candidate.report(parameters).items():
                # σ² = sᵀ C s, with s the derivative of the quantity by φ
                known[name] = value, float(np.sqrt(slopes @ covariance @ slopes))
        for group in groups:
            conductance = float(more[group].sum()), float(np.hypot.reduce(errors[group]))
            touched = _touched(frame.panel, group, change)
            attachments.append(Attachment(**touched | known, conductance_s=conductance))
    return attachments


def _groups(panel: Panel, moved: NDArray[np.bool_], more: Array, errors: Array) -> list[NDArray[np.bool_]]:
    """Return the groups of neighbouring changed cells with a significant conductance; all of them if none is."""
    first, second, _ = panel.neighbours
    # connected components of the changed cells; a group counts if |Σ Δg| > SIGNIFICANT · √Σ σ²
    linked = moved.flat[first] & moved.flat[second]
    pairs = coo_array((linked[linked], (first[linked], second[linked])), shape=2 * (moved.size,))
    _, labels = connected_components(pairs)
    groups = [labels.reshape(moved.shape) == label for label in dict.fromkeys(labels[moved.ravel()])]
    sure = [group for group in groups if abs(more[group].sum()) > SIGNIFICANT * np.hypot.reduce(errors[group])]
    return sure or [moved]


def _touched(panel: Panel, group: NDArray[np.bool_], change: Array) -> dict[str, Any]:
    """Return the centre, number and area of a group of cells that changed by ln r/r0, by their names."""
    # centre of the cells weighted by |ln r/r₀|, to half a pitch
    weight, half_pitch = np.abs(change) * (group if group.any() else 1.0), panel.pitch_mm / 2
    x, y = (float(np.nansum(weight * line) / weight.sum()) for line in panel.places_mm)
    count, square = int(group.sum()), panel.pitch_mm**2
    area = count * square, square * (max(count, 1) / 3) ** 0.5
    return {"x_mm": (x, half_pitch), "y_mm": (y, half_pitch), "cells": count, "area_mm2": area}


def continued_by(
    before: Sequence[Attachment], loads: Sequence[Attachment], time: float, *, again: bool = False
) -> tuple[Attachment, ...]:
    """Return all attachments after a recognition; each load continues the nearest attachment that is present.

    Parameters
    ----------
    before : sequence of Attachment
    loads : sequence of Attachment
        Loads that were recognised.
    time : float
        Time of the last step, s; attachments without a load left then.
    again : bool
        Whether it is a repeated recognition since that step. Attachments without a load then stay, because nothing
        leaves without a step, except those that arrived with the step, which were parts of another load.
    """
    attachments, left = list(before), [number for number, load in enumerate(before) if load.present]
    # Greedy matching: the load with the nearest attachment first, within the larger diameter of both.
    distances = [min((attachments[number].distance(load.place) for number in left), default=inf) for load in loads]
    for load in (loads[number] for number in np.argsort(distances, kind="stable")):
        near = min(left, key=lambda number: attachments[number].distance(load.place), default=None)
        if near is not None and attachments[near].distance(load.place) < max(attachments[near].size, load.size):
            attachments[near] = attachments[near].continued(load)
            left.remove(near)
        else:
            attachments.append(load)
    if again:
        return tuple(load for number, load in enumerate(attachments) if number not in left or load.since_s < time)
    for number in left:
        attachments[number] = replace(attachments[number], until_s=time)
    return tuple(attachments)
