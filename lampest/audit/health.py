"""Health of a panel and of its recording, in one table.

The table is on lines, cells, noise, readings, frames, times and order. All checks read the
recording and its scene alone, none an estimate, so that the table is there right after an import.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np

from lampest.audit.finding import Finding
from lampest.files.errors import BROKEN, InputError, first_and_more
from lampest.files.levels import MAD_TO_SIGMA, NOISE_REACH, OUTLIER_THRESHOLD, SIGNIFICANCE
from lampest.inference.readings.garbled import GarbledLines, garbled_lines, middle, readings_of
from lampest.inference.readings.order import order_of_lines
from lampest.inference.readings.repeated import frozen_readings, repeat_each_other, repeated_frames
from lampest.inference.readings.unloaded import loaded_frames
from lampest.panel.faults import Faults
from lampest.panel.panel import Array, Mask, Numbers
from lampest.panel.readouts.converter import mean_sigma
from lampest.panel.readouts.starts import several_panels
from lampest.panel.scene import Scene
from lampest.posterior.interval import chi_square_median, chi_square_tail
from lampest.recording.readings import (
    Readings,
    equal_rows,
    median,
)
from lampest.recording.recording import UNLOADED, Recording

ROOMS = ("lines", "cells", "noise", "readings", "frames", "times", "order")
WELL = {  # what the table says of a room without a finding
    "lines": "none dead, none shorted",
    "cells": "none shorted, none stuck",
    "noise": "alike in all lines and cells",
    "readings": "none missing, none at a rail",
    "frames": "none garbled, none repeated",
    "times": "evenly spaced",
    "order": "neighbours change alike",
}
OPEN_OHM = 1e9
SHORT_OHM = 1e-3
# Of the way from the voltage of a short to that of a usual cell: no load is there in every frame.
MAX_ASIDE = 0.12
# Times the noise: how far the readings of living lines lie from those of dead ones.
MIN_DISTANCE = 2.0
# Least shift in ln y that two touching lines have over single ones on a uniform panel, so that it
# shows; share of it that is observed. Loads in the middle make two rows of a uniform film equal in
# every reading, and shift none.
MIN_SHIFT = 0.1
MIN_SHIFT_SHARE = 0.5
MIN_NOISE_FRAMES = 4  # unloaded frames that show whose noise is larger
# Of a line's or a cell's standard deviation to the usual one.
MAX_NOISE_RATIO = {"line": 2.0, "cell": 4.0}
MAX_NOISY_SHARE = 1 / 3  # of the lines of a side
MAX_SHORTED = 3  # cells that are examined for a short, those with the most unusual readings
MIN_LIVING_SHARE = 0.9  # of the readings of living lines: far from those of dead ones
MAX_GAP = 2.5  # median intervals between frames: beyond it frames are missing
MAX_NAMED = 6  # places in one sentence


@dataclass(frozen=True, eq=False)
class Health:
    """Health of a panel and of its recording.

    Attributes
    ----------
    findings : tuple of Finding
    """

    findings: tuple[Finding, ...]

    @classmethod
    def of(cls, recording: Recording) -> "Health":
        """Return the health that a recording shows.

        Raises InputError where readings contradict the scene.
        """
        view = _View(recording)
        checks = (_dead_lines, _equal_lines, _cells, _noise, _readings, _frames, _times, _order)
        return cls(tuple(chain.from_iterable(check(view) for check in checks)))

    @property
    def well(self) -> bool:
        """Whether nothing was found."""
        return not self.findings

    @property
    def table(self) -> tuple[tuple[str, str], ...]:
        """The rows of the table: room and state in words."""
        rows = list[tuple[str, str]]()
        for room in ROOMS:
            texts = [finding.text for finding in self.findings if finding.room == room]
            first, *further = texts or [WELL[room]]
            rows.append((room, first))
            rows += [("", text) for text in further]
        return tuple(rows)

    @property
    def lines(self) -> tuple[str, ...]:
        """The table as lines of text."""
        return tuple(f"{room:9} {state}" for room, state in self.table)


@dataclass(frozen=True, eq=False)
class _View:
    """Quantities of a recording that the checks share."""

    recording: Recording

    @property
    def scene(self) -> Scene:
        return self.recording.scene

    @cached_property
    def garbled_lines(self) -> tuple[GarbledLines, ...]:
        return garbled_lines(self.recording)

    @cached_property
    def garbled(self) -> Mask:
        """Readings that arrived garbled, (frames, rows, columns)."""
        return readings_of(self.garbled_lines, self.recording)

    @cached_property
    def readings(self) -> Readings:
        return self.recording.readings()

    @cached_property
    def usable(self) -> Readings:
        """Readings that arrived as they were taken."""
        return self.readings.without(self.garbled)

    @cached_property
    def volts(self) -> Array:
        """Voltages at the converter, (frames, rows, columns).

        The value is NaN where missing, garbled or not requested.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            volts = self.scene.circuit.volt_from_recorded(self.recording.recorded)
        usable = ~np.isnan(self.recording.recorded) & ~self.garbled & self.scene.requested
        return np.where(usable, volts, np.nan)

    @cached_property
    def resting(self) -> Array:
        """Median voltages of the unloaded frames, or of all without any, (rows, columns)."""
        unloaded = self.recording.role == UNLOADED
        return np.asarray(median(self.volts[unloaded] if unloaded.any() else self.volts)[0])

    @cached_property
    def noise(self) -> float:
        """Deviation of a voltage that noise and rounding never exceed, volt."""
        circuit = self.scene.circuit
        return circuit.lsb_volt + OUTLIER_THRESHOLD * float(np.mean(mean_sigma(circuit)))

    def volts_of(self, cells: Array, faults: Faults | None = None) -> Array:
        """Return the voltages of cells (…, rows, columns) ohm under the scene's circuit.

        The circuit is taken with other faults if given.
        """
        scene = self.scene if faults is None else replace(self.scene, faults=faults)
        circuit = scene.circuit
        exact = circuit.exact_reading(cells, scene.wiring)
        volts = circuit.volt_from_recorded(circuit.to_recorded(exact, scene))
        return np.clip(volts, *circuit.range_volt)

    @cached_property
    def usual_ohm(self) -> float:
        """Cell resistance of a uniform panel with the unloaded panel's median voltage, ohm."""
        target = middle(self.resting)
        ohms = np.geomspace(1e1, 1e6, 26)
        panels = np.broadcast_to(ohms[:, None, None], (len(ohms), *self.scene.panel.shape))
        volts = np.median(self.volts_of(panels), axis=(1, 2))
        return float(ohms[np.argmin(np.nan_to_num(np.abs(volts - target), nan=np.inf))])

    @property
    def modelled(self) -> bool:
        """Whether the scene has the voltages of a single network."""
        return (
            self.scene.readout is not None
            and self.scene.panel.modules is None
            and self.scene.panel.cells is None
        )


def _dead_lines(view: _View) -> Iterator[Finding]:
    """Find lines without a contact.

    No reading of theirs ever differs from that of a panel without cells.
    """
    if not view.modelled:
        return
    with suppress(*BROKEN, InputError), np.errstate(all="ignore"):
        without = view.volts_of(np.full(view.scene.panel.shape, OPEN_OHM))
        distance = np.abs(view.volts - without)
        bare = np.where(np.isnan(distance), 0.0, distance).max(axis=0) < view.noise
        bare &= ~np.isnan(distance).all(axis=0)
        away = median(distance)[0] > MIN_DISTANCE * view.noise
        for name, axis in (("row", 1), ("column", 0)):
            dead = np.flatnonzero(bare.all(axis=axis))
            living = np.delete(away, dead, axis=1 - axis)
            few = 0 < len(dead) < view.scene.panel.shape[1 - axis] / 2
            if few and living.mean() > MIN_LIVING_SHARE:
                plural = "s are" if len(dead) > 1 else " is"
                numbers = first_and_more(dead.tolist(), MAX_NAMED)
                yield Finding(
                    "lines",
                    f"{name}{plural} dead: {numbers}",
                    "no reading of theirs shows a current in any frame, all others do",
                    {"faults": {f"dead_{name}s": dead.tolist()}},
                )


def _equal_lines(view: _View) -> Iterator[Finding]:
    """Find rows and columns that touch, and those that are read twice.

    The readings of both are equal in every frame. Those of lines that touch are lower than those of
    others, too: two lines of cells are in parallel.
    """
    unloaded = view.recording.role == UNLOADED
    if not view.modelled or not unloaded.any():
        return
    with suppress(*BROKEN, InputError), np.errstate(all="ignore"):
        faults = view.scene.faults or Faults()
        for name, joined in (("row", faults.joined_rows), ("column", faults.joined_columns)):
            along = view.usable
            if name == "column":
                along = along.each(lambda part: part.swapaxes(-1, -2))
            groups = equal_rows(along)
            unknown = [
                group for group in groups if not any(set(group) <= set(lines) for lines in joined)
            ]
            structured = repeat_each_other(along, unloaded, groups)
            repeated = []
            for group in unknown:
                lower = _is_lower(view, name, group, groups)
                # Where many lines are nearly equal some groups of them are lower by chance.
                alone = len(unknown) == 1
                if (lower and (structured or alone)) or (lower is None and structured and alone):
                    yield Finding(
                        "lines",
                        f"{name}s {', '.join(map(str, group))} are shorted",
                        "they read the same in every frame",
                        {"faults": {f"joined_{name}s": [list(group)]}},
                    )
                elif structured:
                    repeated.append(" = ".join(map(str, group)))
            if repeated:
                yield Finding(
                    "lines",
                    f"{name}s repeat each other: {first_and_more(repeated)}",
                    "they read the same in every frame",
                    remedy=f"is an address line of the {name}s' multiplexer loose?",
                )


def _is_lower(
    view: _View, name: str, group: Sequence[int], groups: Sequence[Sequence[int]]
) -> bool | None:
    """Return whether the unloaded readings of lines are lower than others as by touching.

    The result is None where touching lines would not be.
    """
    cells = np.full(view.scene.panel.shape, view.usual_ohm)
    joined: dict[str, Any] = {f"joined_{name}s": (tuple(group),)}
    faults = replace(view.scene.faults or Faults(), **joined)
    axis = 1 if name == "row" else 0
    alike = [line for lines in groups for line in lines]

    def levels(volts: Array) -> Array:
        """Return the median of ln volt of every line, (lines,)."""
        return median(np.log(np.maximum(volts, view.scene.circuit.lsb_volt)), axis).ravel()

    def single(of_lines: Array) -> Array:
        """Return the levels of lines without an equal one, or else of those of other groups."""
        return np.delete(of_lines, alike if len(alike) < len(of_lines) - 1 else group)

    observed = levels(view.resting)
    modelled = levels(view.volts_of(cells, faults))
    expected = middle(modelled[list(group)]) - middle(np.delete(modelled, group))
    others = single(observed)
    others = others[np.isfinite(others)]
    if len(others) < 2 or abs(expected) < MIN_SHIFT:
        return None
    shift = middle(observed[list(group)]) - float(np.median(others))
    scatter = MAD_TO_SIGMA * float(np.median(np.abs(others - np.median(others))))
    least = max(MIN_SHIFT_SHARE * abs(expected), NOISE_REACH * scatter)
    return bool(shift * np.sign(expected) > least)


def _cells(view: _View) -> Iterator[Finding]:
    """Find cells that short their lines, and readings that never change."""
    if view.modelled:
        with suppress(*BROKEN, InputError), np.errstate(all="ignore"):
            yield from _shorted_cells(view)
    frozen = np.argwhere(frozen_readings(view.recording)).tolist()
    if frozen:
        places = first_and_more([list(place) for place in frozen], MAX_NAMED)
        yield Finding(
            "cells",
            f"readings at {places} are stuck",
            "they have one value in all frames, while noise changes the others; they are left out",
        )


def _shorted_cells(view: _View) -> Iterator[Finding]:
    """Find cells whose readings are those of a short circuit in every frame.

    A finding requires readings that are far from all others. Where readings rise and fall with the
    conductance, those of a small resistance may be those of a short, and there is none.
    """
    if several_panels(view.scene.circuit, *view.scene.panel.shape):
        return
    cells = np.full(view.scene.panel.shape, view.usual_ohm)
    usual = middle(view.resting)
    distance = np.abs(np.nan_to_num(view.resting, nan=usual) - usual)
    extreme = np.argsort(-distance, axis=None)[:MAX_SHORTED]
    shorted = list[list[int]]()
    for number in extreme.tolist():
        row, column = np.unravel_index(number, cells.shape)
        short = cells.copy()
        short[row, column] = SHORT_OHM
        expected = float(view.volts_of(short)[row, column])
        volts = view.volts[:, row, column]
        volts = volts[np.isfinite(volts)]
        aside = MAX_ASIDE * abs(expected - usual)
        if aside > view.noise and len(volts) and np.abs(volts - expected).max() < aside:
            shorted.append([int(row), int(column)])
    shorted = [place for place in shorted if not view.scene.shorted_cells[*place]]
    if shorted:
        yield Finding(
            "cells",
            f"shorted cells: {', '.join(map(str, shorted))}",
            "the readings are those of a short circuit in every frame",
            {"faults": {"shorted": shorted}},
        )


def _noise(view: _View) -> Iterator[Finding]:
    """Find lines and cells whose unloaded readings scatter more than the others."""
    unloaded = view.volts[view.recording.role == UNLOADED]
    if len(unloaded) < MIN_NOISE_FRAMES:
        return
    # successive differences: a slow drift is no noise; n − 1 of them hold some 2/3 of the degrees
    # of freedom of n − 1
    steps = np.diff(unloaded, axis=0)
    square = (steps**2).mean(axis=0) / 2
    lsb = 0.0 if view.scene.readout is None else view.scene.readout.lsb_volt
    degrees = 2 / 3 * len(steps)
    # of few frames the median variance is below the mean one: by 30 % with two degrees of freedom
    usual = max(middle(square) / chi_square_median(degrees) * degrees, lsb**2 / 12)
    if not usual > 0:
        return
    ratio = np.nan_to_num(square / usual)
    read = np.isfinite(square)
    in_noisy_line = np.zeros(square.shape, dtype=bool)
    sides = (ratio, read, in_noisy_line), (ratio.T, read.T, in_noisy_line.T)
    for name, (of_side, of_read, of_noisy) in zip(("row", "column"), sides, strict=True):
        lines = _noisy_lines(of_side, of_read)
        of_noisy[lines] = True
        if len(lines):
            size = float(np.sqrt(np.mean(of_side[lines])))
            numbers = first_and_more(lines.tolist(), MAX_NAMED)
            subject = f"{name}s {numbers} are" if len(lines) > 1 else f"{name} {numbers} is"
            yield Finding(
                "noise",
                f"{subject} noisy",
                f"unloaded readings scatter {size:.2g} times as much as the others: "
                "is a contact loose?",
            )
    tails = chi_square_tail(degrees * ratio, np.full(ratio.shape, degrees))
    noisy = (ratio > MAX_NOISE_RATIO["cell"] ** 2) & (tails < SIGNIFICANCE / square.size)
    single = noisy & ~in_noisy_line
    if single.any():
        places = first_and_more(np.argwhere(single).tolist(), MAX_NAMED)
        size = float(np.sqrt(ratio[single].max()))
        yield Finding(
            "noise",
            f"readings at {places} are noisy",
            f"they scatter up to {size:.2g} times as much as usual",
        )


def _noisy_lines(ratio: Array, read: Mask) -> Numbers:
    """Return the numbers of lines whose readings scatter more than the others.

    A line counts without its noisiest cell. If more than MAX_NOISY_SHARE of the lines are noisy,
    none is another one.

    Parameters
    ----------
    ratio : array, shape (lines, cells of a line)
        Variance of each reading over the usual one.
    read : boolean array, same shape
        Whether there is a reading.
    """
    others = np.maximum(read.sum(axis=1) - 1, 1)
    scatter = np.sqrt((ratio.sum(axis=1) - ratio.max(axis=1)) / others)
    noisy = np.flatnonzero(scatter > MAX_NOISE_RATIO["line"])
    return noisy if len(noisy) <= MAX_NOISY_SHARE * len(ratio) else noisy[:0]


def _readings(view: _View) -> Iterator[Finding]:
    """Yield the shares of missing readings and of those at rails."""
    scene = view.scene
    missing = view.readings.missing(view.scene)
    bounds = view.readings.bounds
    total = max(int(scene.requested.sum()) * len(missing), 1)
    kinds = (
        (missing, "missing"),
        (bounds & scene.requested, "at a rail, zero or below the series resistance"),
    )
    for affected, words in kinds:
        if affected.any():
            frames = int(affected.any(axis=(1, 2)).sum())
            share = float(f"{100 * affected.sum() / total:.2g}")
            yield Finding(
                "readings",
                f"{share:g} % {words}",
                f"{int(affected.sum())} in {frames} of {len(affected)} frames",
            )


def _frames(view: _View) -> Iterator[Finding]:
    """Find garbled frames, and frames that repeat the one before."""
    if view.garbled_lines:
        names = [lines.name_in_words for lines in view.garbled_lines]
        places = first_and_more(names, MAX_NAMED)
        yield Finding(
            "frames", f"garbled: {places}", "left out; they are no readings of this panel"
        )
    unloaded = view.recording.role == UNLOADED
    loaded = loaded_frames(view.scene, view.usable, unloaded)
    if len(loaded):
        numbers = first_and_more(loaded.tolist(), MAX_NAMED)
        plural = "s have a load" if len(loaded) > 1 else " has a load"
        yield Finding(
            "frames",
            f"unloaded frame{plural}: {numbers}",
            "some cells change there, and most do not",
            remedy="choose the unloaded frames with lampest tare",
        )
    repeated = repeated_frames(view.recording)
    if len(repeated):
        count = f"{len(repeated)} of {len(view.recording.role)}"
        numbers = first_and_more(repeated.tolist(), MAX_NAMED)
        evidence = f"frames {numbers} equal the one before in every reading, noise included"
        yield Finding("frames", f"{count} are repeated", evidence, remedy="record each frame once")


def _times(view: _View) -> Iterator[Finding]:
    """Find equal times and gaps."""
    steps = np.diff(view.recording.time)
    if not len(steps):
        return
    equal = int(np.sum(steps <= 0))
    if equal:
        yield Finding(
            "times",
            f"{equal} of {len(steps) + 1} frames are not later than the one before",
            "see their times",
        )
    usual = float(np.median(steps))
    gaps = np.flatnonzero(steps > MAX_GAP * usual) if usual > 0 else np.zeros(0, dtype=int)
    if len(gaps):
        longest = float(steps.max())
        numbers = first_and_more((gaps + 1).tolist(), MAX_NAMED)
        evidence = f"{longest:.3g} s at most, where {usual:.3g} s are usual: were frames lost?"
        yield Finding("times", f"gaps before frames {numbers}", evidence)


def _order(view: _View) -> Iterator[Finding]:
    """Find rows and columns in another order than the scene says."""
    unloaded = view.recording.role == UNLOADED
    steps = order_of_lines(view.scene, view.usable, unloaded)
    if not steps:
        return
    orders = [step.order for step in steps]
    words = " and ".join(order.words for order in orders)
    line = steps[0].every_second
    if line:
        yield Finding(
            "order",
            "the order of lines cannot be told from this recording",
            f"loads lie on every second {line}, or they are smooth with {words}",
            remedy=f"press a spot that covers neighbouring {line}s at a known place",
        )
        return
    decades = sum(step.gain for step in steps) / (2 * np.log(10))
    yield Finding(
        "order",
        f"readings seem to come in another order: {words}",
        f"loads are smooth then, with odds of 10^{decades:.0f} to one",
        remedy="; then ".join(order.remedy for order in orders),
    )
