"""Which readings are called wrong, on right recordings and on wrong ones.

Run it with: python -m docs.studies.wrong_readings [--recordings 60] [--seed 0] [--each 7]

Recordings have the circuits of `tests.panels`, films that scatter by 0 to 30 %, converters of 8, 10
and 12 bits, noise of 0.3 to 3 LSB, three to eight unloaded frames and six to nineteen measured
ones. Right recordings have taps, keys, sweeping bars, palms, feet and loads that sway. Wrong ones
have two random rows in some frames, two swapped rows in one frame, pairs of columns that repeat
each other, or pairs of swapped columns under loads in many places.
"""

import argparse
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from lampest import Panel
from lampest.audit.health import Health
from lampest.files.document import read_document, validated
from lampest.files.errors import InputError
from lampest.inference.readings.garbled import garbled_lines
from lampest.inference.readings.judge import Cleaned
from lampest.panel.panel import Array
from lampest.recording.simulation import Simulation
from lampest.runs.starter import SIMULATION, circuits, write_starter
from tests.panels import Plan, recorded

LOADS = ("tap", "keys", "sweep", "palm", "feet", "sway")
SAID = ("doubted", "with a reading left out", "refused")
COUNTS = (1, 2, 3, 4, 5)


@dataclass(frozen=True)
class Shown(Plan):
    """A plan whose load is a picture of every frame, (measured, rows, columns), in −ln r."""

    picture: Array | None = None

    def loaded(self) -> Array:
        """Return cells of every frame, (frames, rows, columns) ohm."""
        assert self.picture is not None
        at_rest = np.repeat(self.cells[None], self.unloaded, axis=0)
        return np.concatenate([at_rest, self.cells * np.exp(-self.picture)])


def drawn(seed: int, picture: Callable[[np.random.Generator, int, Array], Array]) -> Shown:
    """Return a plan with a load, its film, circuit and noise drawn at random."""
    rng = np.random.default_rng([seed, 97])
    plan = Plan.drawn(seed)
    shape = tuple(rng.integers(8, 17, size=2).tolist())
    film = float(rng.choice([0.0, 0.02, 0.05, 0.15, 0.3]))
    cells = 3000 * np.exp(rng.uniform(-0.5, 0.8) + film * rng.standard_normal(shape))
    bits, noise = int(rng.choice([8, 10, 12])), float(rng.choice([0.3, 1.0, 3.0]))
    readout = replace(plan.scene.circuit, adc_bits=bits, noise_lsb=noise)
    scene = replace(plan.scene, panel=Panel(*shape), readout=readout)
    shown = picture(rng, plan.measured, np.indices(shape).astype(float))
    parts = {**vars(plan), "scene": scene, "cells": cells, "picture": rng.uniform(0.5, 2.5) * shown}
    return Shown(**parts)


def of_load(name: str) -> Callable[[np.random.Generator, int, Array], Array]:
    """Return the picture of a load by its name, one of `LOADS`, or 'places'."""

    def picture(rng: np.random.Generator, measured: int, places: Array) -> Array:
        down, across = places
        rows, columns = down.shape

        def blob(row: float, column: float, height: float, width: float) -> Array:
            return np.exp(-(((down - row) / height) ** 2) - ((across - column) / width) ** 2)

        row, column = rng.integers(rows), rng.integers(columns)
        frames = np.arange(measured)
        swing = 0.3 * np.sin(1.3 * frames)[:, None, None]
        if name == "tap":
            return ((frames == measured // 2)[:, None, None] & (down == row)) * (across == column)
        if name == "keys":
            keys = rng.integers([rows, columns], size=(measured, 2))
            return np.array([(down == one) & (across == other) for one, other in keys], dtype=float)
        if name == "sweep":
            return (
                np.array([np.abs(across - frame / measured * columns) < 1 for frame in frames])
                * 1.0
            )
        if name == "palm":
            return (1 + swing) * np.ones(down.shape)
        if name == "feet":
            feet = [blob(rows / 2, at * columns, rows / 4, columns / 9) for at in (0.25, 0.75)]
            return (1 + swing) * feet[0] + (1 - swing) * feet[1]
        if name == "places":
            spots = rng.uniform(0, [rows - 1, columns - 1], size=(measured, 2))
            return np.array([blob(row, column, 2.0, 2.0) for row, column in spots])
        return (1 + swing) * blob(float(row), float(column), 2.0, 2.0)

    return picture


def with_starter(plan: Shown, word: str) -> Shown:
    """Return the plan with a circuit of `lampest init`, and its own converter."""
    with TemporaryDirectory() as folder:
        write_starter(Path(folder), word, *plan.cells.shape)
        simulation: Simulation = validated(read_document(Path(folder) / SIMULATION), Simulation)
    converter = {key: getattr(plan.scene.circuit, key) for key in ("adc_bits", "noise_lsb")}
    readout = simulation.scene.readout
    assert readout is not None
    return replace(plan, scene=replace(simulation.scene, readout=replace(readout, **converter)))


def right(plan: Shown) -> Counter[str]:
    """Return what is said of a right recording: 'doubted', 'with a reading left out', 'refused'."""
    try:
        recording = plan.recording()
    except InputError:
        return Counter({"refused": 1})
    found = [finding for finding in Health.of(recording).findings if finding.room != "readings"]
    missing = (Cleaned.of(recording).readings.seen == 0).any()
    return Counter({"doubted": bool(found), "with a reading left out": bool(missing)})


def print_right(name: str, plans: Sequence[Shown]) -> None:
    """Print how many right recordings are doubted, lose a reading, or are refused."""
    said = sum(map(right, plans), Counter[str]())
    counts = ", ".join(f"{said[word]} {word}" for word in SAID)
    print(f"right, {name:6} of {len(plans)}: {counts}", flush=True)


def garbled(seed: int, count: int) -> bool:
    """Return whether frames with two random rows each are named, and no others."""
    plan = replace(drawn(seed, of_load("sway")), unloaded=6)
    plan = replace(plan, measured=18, picture=np.resize(plan.picture, (18, *plan.cells.shape)))
    codes = plan.codes()
    rng = np.random.default_rng([seed, 98])
    frames = np.sort(rng.choice(np.arange(1, 23), count, replace=False))
    for frame in frames:
        rows = rng.choice(codes.shape[1], 2, replace=False)
        codes[frame, rows] = rng.integers(0, 2**plan.scene.circuit.adc_bits, (2, codes.shape[2]))
    lines = Cleaned.of(recorded(plan.scene, codes, plan.unloaded)).garbled
    return [line.frame for line in lines] == frames.tolist()


def of_columns(seed: int, count: int, *, swapped: bool) -> bool:
    """Return whether pairs of columns that are swapped or repeat each other are named."""
    plan = drawn(seed, of_load("places"))
    plan = replace(
        plan,
        cells=3000 * np.exp(0.15 * np.random.default_rng(seed).standard_normal(plan.cells.shape)),
    )
    volts = plan.volts()
    most = min(count, plan.cells.shape[1] // 2 - 1)
    firsts = 2 * np.random.default_rng(seed).choice(plan.cells.shape[1] // 2, most, replace=False)
    before = volts.copy()
    volts[:, :, firsts + 1] = before[:, :, firsts]
    if swapped:
        volts[:, :, firsts] = before[:, :, firsts + 1]
    rooms = {finding.room for finding in Health.of(plan.recording(volts)).findings}
    return ("order" if swapped else "lines") in rooms


def with_swapped_rows(rng: np.random.Generator, frame: Array) -> tuple[int, ...]:
    """Swap two neighbouring rows of a frame, and return their numbers."""
    row = int(rng.integers(len(frame) - 1))
    frame[[row, row + 1]] = frame[[row + 1, row]]
    return row, row + 1


def with_lost_reading(rng: np.random.Generator, frame: Array) -> tuple[int, ...]:
    """Lose one reading, after which all others move up, and return the rows of those."""
    lost = int(rng.integers(frame.size // 2))
    frame[:] = np.delete(np.append(frame.ravel(), frame[0, 0]), lost).reshape(frame.shape)
    return tuple(range(-(-lost // frame.shape[1]), len(frame)))


def of_frame(
    seed: int, load: str, disturbed: Callable[[np.random.Generator, Array], tuple[int, ...]]
) -> bool:
    """Return whether the rows that are disturbed in one frame are named, but for a part of one."""
    plan = drawn(seed, of_load(load))
    rng = np.random.default_rng([seed, 99])
    plan = replace(plan, cells=3000 * np.exp(0.15 * rng.standard_normal(plan.cells.shape)))
    codes = plan.codes()
    frame = int(rng.integers(len(codes)))
    rows = disturbed(rng, codes[frame])
    lines = garbled_lines(recorded(plan.scene, codes, plan.unloaded))
    if [(line.frame, line.name) for line in lines] != [(frame, "row")]:
        return False
    return set(rows) <= set(lines[0].numbers) <= {rows[0] - 1, *rows}


def main() -> None:
    """Print the shares that are found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--each", type=int, default=7, help="of each load and circuit of init")
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.recordings)
    for load in LOADS:
        print_right(load, [drawn(seed, of_load(load)) for seed in seeds])
    for word in circuits():
        plans = [drawn(seed, of_load(load)) for load in LOADS for seed in seeds[: options.each]]
        print_right(word, [with_starter(plan, word) for plan in plans])
    for count in COUNTS:
        print(
            f"{count} garbled frames: {sum(garbled(seed, count) for seed in seeds)} of {len(seeds)}"
        )
    for disturbed in (with_swapped_rows, with_lost_reading):
        for load in LOADS:
            named = sum(of_frame(seed, load, disturbed) for seed in seeds)
            print(f"{disturbed.__name__}, {load:6} {named} of {len(seeds)}")
    for count in COUNTS[:-1]:
        for words, swapped in (("repeated", False), ("swapped", True)):
            named = sum(of_columns(seed, count, swapped=swapped) for seed in seeds)
            print(f"{count} pairs of columns {words}: {named} of {len(seeds)}")


if __name__ == "__main__":
    main()
