"""Loads on panels with one effect each: unnamed in the scene, and estimated.

Results are errors, own parts of bars, coverage.

Run it with: python -m docs.studies.effects [ROW]...
"""

import sys
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

import lampest
from lampest import Panel, Recording, Scene, Systematic, TwoPointReadout, two_point_resistance
from lampest.files.levels import MAD_TO_SIGMA, TWO_SIDED
from lampest.panel.panel import Array

SHAPE = (10, 10)
UNLOADED = 5
FRAMES = 6
SERIES_OHM = 140.0
READING_ERROR = {"systematic": Systematic(reading_error="estimated")}


class Row(NamedTuple):
    """Effect in the data, and keys that ask for it. swaying : share by which the load changes."""

    static: float = 0.0
    channel_ohm: float = 0.0
    series_ohm: float = 0.0
    ripple_lsb: float = 0.0
    strength: float = 1.0
    swaying: float = 0.1
    keys: Mapping[str, Any] = READING_ERROR


ROWS = {
    "nothing": Row(),
    "nothing, weak loads": Row(strength=0.3),
    "nothing, loads that stand": Row(swaying=0.0),
    "readings off by 0.5 %": Row(static=0.005),
    "readings off by 1 %": Row(static=0.01),
    "readings off by 2 %": Row(static=0.02),
    "readings off by 5 %": Row(static=0.05),
    "channels of 5 ohm": Row(
        channel_ohm=5.0, keys={"systematic": Systematic(channel_spread_ohm="estimated")}
    ),
    "series +20 ohm": Row(
        series_ohm=20.0, keys={"systematic": Systematic(series_tolerance_ohm="estimated")}
    ),
    "ripple of 1 LSB": Row(ripple_lsb=1.0, keys={"gain": "estimated", "ripple": "estimated"}),
}
LOADS = ("mouth", "rod", "hand", "ring", "cup", "rock")


def load(kind: str, rng: np.random.Generator) -> Array:
    """Fall of log r under a load, (rows, columns)."""
    row, column = np.indices(SHAPE) - 4.5
    down, across = rng.uniform(-1, 1, 2)
    far = np.hypot(row - down, column - across)
    return {
        "mouth": 1.6 * np.exp(-(((far - 1.9) / 0.6) ** 2)) - 0.25 * (far < 1.2),
        "rod": 1.2 * (far < 2.0),
        "hand": np.exp(-(((row - down) / 3) ** 2) - ((column - across) / 2.2) ** 2)
        + 0.5 * np.exp(-(((row - down - 2) / 0.8) ** 2) - ((column - across - 1) / 0.8) ** 2),
        "ring": 1.4 * np.exp(-(((far - 2.6) / 0.45) ** 2)),
        "cup": np.exp(-(((far - 1.6) / 0.7) ** 2)),
        "rock": 2 * np.exp(-((far / 1.1) ** 2))
        + 0.8 * np.exp(-((np.hypot(row - down + 2, column - across - 1) / 0.8) ** 2)),
    }[kind]


def recording(seed: int, kind: str, row: Row, keys: Mapping[str, Any]) -> Recording:
    """A load on films that scatter by a tenth.

    The readings are means of 20 readings of 10 bits of a divider across 1000 ohm.
    """
    rng = np.random.default_rng(seed)
    lsb = 5 / 1024
    cells = np.repeat(
        3000 * np.exp(0.1 * rng.standard_normal((1, *SHAPE))), UNLOADED + FRAMES, axis=0
    )
    strength = row.strength * (1 + row.swaying * np.sin(1.3 * np.arange(FRAMES) + 0.5))
    cells[UNLOADED:] *= np.exp(-strength[:, None, None] * load(kind, rng))
    channels = row.channel_ohm * rng.standard_normal((2, SHAPE[0]))
    exact = (
        two_point_resistance(cells)
        + channels[0][:, None]
        + channels[1]
        + SERIES_OHM
        + row.series_ohm
    )
    exact = exact * np.exp(row.static * rng.standard_normal(SHAPE))
    phase = rng.uniform(0, 6, (len(cells), 1, 1))
    volt = 5000 / (1000 + exact) + row.ripple_lsb * lsb * np.sin(
        2 * np.pi * np.arange(SHAPE[1]) / 3 + phase
    )
    codes = (
        np.round(volt / lsb + 0.7 * rng.standard_normal((20, *volt.shape)))
        .clip(0, 1023)
        .mean(axis=0)
    )
    scene = Scene(Panel(*SHAPE), TwoPointReadout(readings=20, noise_lsb=0.7), SERIES_OHM, **keys)
    role = (np.arange(len(cells)) >= UNLOADED).astype(np.uint8)
    recorded = 1000 * (5 - codes * lsb) / (codes * lsb)
    return Recording(scene, recorded, np.arange(len(cells)) / 4, role, truth_cell_resistance=cells)


def figures(made: Recording, *, advised: bool = True) -> tuple[float, ...]:
    """Rms error of ln r; coverages of the own part, of cells and of changes; %.

    With the coverage of the own part stands its size over the error. `advised` states whether
    advice is searched for, which takes longer than the estimate.
    """
    estimate = lampest.reconstruct(made)
    truth = made.truth_cell_resistance
    assert truth is not None and estimate.sigma_own is not None
    assert estimate.cell_resistance_lower is not None and estimate.cell_resistance_upper is not None
    assert estimate.relative_change_lower is not None and estimate.relative_change_upper is not None
    cells = truth[estimate.frame]
    change = 100 * (truth[estimate.frame] / truth[0] - 1)
    error = np.log(estimate.cell_resistance / cells)
    own = error - np.median(error, axis=(1, 2), keepdims=True)
    size = MAD_TO_SIGMA * np.median(np.abs(own))
    held = (estimate.cell_resistance_lower <= cells) & (cells <= estimate.cell_resistance_upper)
    held_changes = (estimate.relative_change_lower <= change) & (
        change <= estimate.relative_change_upper
    )
    within = np.abs(own) < TWO_SIDED * estimate.sigma_own
    advice = float(advised and bool(estimate.advice))
    rms = float(np.sqrt(np.mean(error**2)))
    shares = (100 * float(np.mean(part)) for part in (within, held, held_changes))
    own_share, cell_share, change_share = shares
    return (
        100 * rms,
        own_share,
        float(np.median(estimate.sigma_own) / size),
        cell_share,
        change_share,
        advice,
    )


def main(names: list[str]) -> None:
    """Print a line for each row, unnamed and estimated: means over the loads."""
    print(
        "| effect | scene | error, % | own | cells | changes | advised "
        "|\n|---|---|---|---|---|---|---|"
    )
    for name in names or ROWS:
        row = ROWS[name]
        for words, keys in (("unnamed", {}), ("estimated", row.keys)):
            every = [figures(recording(100 + at, kind, row, keys)) for at, kind in enumerate(LOADS)]
            error, own, ratio, cells, changes, advised = np.mean(every, axis=0)
            bars = f"{own:.0f} × {ratio:.2f} | {cells:.0f} | {changes:.0f}"
            print(
                f"| {name} | {words} | {error:.2f} | {bars} | {advised * len(LOADS):.0f} of "
                f"{len(LOADS)} |",
                flush=True,
            )


if __name__ == "__main__":
    main(sys.argv[1:])
