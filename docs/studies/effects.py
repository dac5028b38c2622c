"""Recordings with one effect each, under six loads: unnamed in the scene, estimated, and stated.

Results are coverages of the own part, and its size over the error.

Run it with: python -m docs.studies.effects [--recordings 2] [--seed 100] [ROW]...
"""

import argparse
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
LSB_VOLT = 5 / 1024
SWAYING_RATE = 1.7  # radians a frame
TREMBLING_RATE = 23.0
NO_KEYS: Mapping[str, Any] = {}


class Load(NamedTuple):
    """Shape of a load, share by which its force changes, and whether this happens in a scan."""

    kinds: tuple[str, ...]
    strength: float = 1.0
    swaying: float = 0.0
    scanned: bool = False


LOADS = {
    "still": Load(("rod", "rock")),
    "palm": Load(("palm",), swaying=0.1),
    "swaying": Load(("hand", "cup"), swaying=0.1),
    "jitter": Load(("rock", "rod"), swaying=0.1, scanned=True),
    "small": Load(("rock", "dot"), strength=0.3, swaying=0.05),
    "mouth": Load(("mouth", "ring"), swaying=0.05),
}


class Row(NamedTuple):
    """Effect in the data, with the keys that state it and that call it `estimated`.

    Attributes
    ----------
    static : float
        Standard deviation of the logarithm of a factor on each reading.
    channel_ohm : float
        Standard deviation of the resistance of each line's channel.
    series_ohm : float
        Resistance in series with all lines, in addition to the scene's.
    gain : float
        Standard deviation of the logarithm of a factor on each frame's voltages.
    ripple_lsb : float
        Amplitude of a wave along a line.
    memory : float
        Share of the voltage of the channel before.
    creep : float
        Change of the logarithm of all cells since the unloaded frames.
    speed : float
        Pitches a frame.
    contact_ohm : float
        Additional resistance of the contact of one column.
    stated, estimated : mapping
        Keys of the scene.
    """

    static: float = 0.0
    channel_ohm: float = 0.0
    series_ohm: float = 0.0
    gain: float = 0.0
    ripple_lsb: float = 0.0
    memory: float = 0.0
    creep: float = 0.0
    speed: float = 0.0
    contact_ohm: float = 0.0
    stated: Mapping[str, Any] = NO_KEYS
    estimated: Mapping[str, Any] = NO_KEYS


def systematic(name: str, size: float) -> dict[str, Mapping[str, Any]]:
    """Return the keys that state an error that all frames share, and that estimate it."""
    return {
        "stated": {"systematic": Systematic(**{name: size})},
        "estimated": {"systematic": Systematic(**{name: "estimated"})},
    }


def key(name: str, size: float) -> dict[str, Mapping[str, Any]]:
    """Return the keys that state an effect, and that estimate it."""
    return {"stated": {name: size}, "estimated": {name: "estimated"}}


ROWS = {
    "nothing": Row(estimated={"systematic": Systematic(reading_error="estimated")}),
    "readings off by 0.5 %": Row(static=0.005, **systematic("reading_error", 0.005)),
    "readings off by 1 %": Row(static=0.01, **systematic("reading_error", 0.01)),
    "readings off by 2 %": Row(static=0.02, **systematic("reading_error", 0.02)),
    "readings off by 5 %": Row(static=0.05, **systematic("reading_error", 0.05)),
    "channels of 2 ohm": Row(channel_ohm=2.0, **systematic("channel_spread_ohm", 2.0)),
    "channels of 5 ohm": Row(channel_ohm=5.0, **systematic("channel_spread_ohm", 5.0)),
    "channels of 10 ohm": Row(channel_ohm=10.0, **systematic("channel_spread_ohm", 10.0)),
    "series +20 ohm": Row(series_ohm=20.0, **systematic("series_tolerance_ohm", 20.0)),
    "gain of 1 %": Row(gain=0.01, **key("gain", 0.01)),
    "ripple of 1 LSB": Row(ripple_lsb=1.0, **key("ripple", np.sqrt(0.5))),
    "memory of 3 %": Row(memory=0.03, **key("converter_memory", 0.03)),
    "creep of 3 %": Row(creep=0.03, **key("creep", 0.03)),
    "0.2 pitches a frame": Row(speed=0.2, **key("motion", 1.0)),
}


def fall(kind: str, down: float, across: float) -> Array:
    """Fall of log r under a load at a place, (rows, columns)."""
    row, column = np.indices(SHAPE) - 4.5
    far = np.hypot(row - down, column - across)
    return {
        "mouth": 1.6 * np.exp(-(((far - 1.9) / 0.6) ** 2)) - 0.25 * (far < 1.2),
        "rod": 1.2 / (1 + np.exp((far - 2.0) / 0.15)),
        "palm": 0.6 * np.exp(-(((row - down) / 4.5) ** 2) - ((column - across) / 4.5) ** 2)
        + 0.6 * np.exp(-((far / 2.5) ** 2)),
        "hand": np.exp(-(((row - down) / 3) ** 2) - ((column - across) / 2.2) ** 2)
        + 0.5 * np.exp(-(((row - down - 2) / 0.8) ** 2) - ((column - across - 1) / 0.8) ** 2),
        "ring": 1.4 * np.exp(-(((far - 2.6) / 0.45) ** 2)),
        "cup": np.exp(-(((far - 1.6) / 0.7) ** 2)),
        "rock": 2 * np.exp(-((far / 1.1) ** 2))
        + 0.8 * np.exp(-((np.hypot(row - down + 2, column - across - 1) / 0.8) ** 2)),
        "dot": 2 * np.exp(-((far / 0.7) ** 2)),
    }[kind]


def recording(seed: int, load: Load, row: Row, keys: Mapping[str, Any]) -> Recording:
    """A load on films that scatter by a tenth.

    The readings are means of 20 readings of 10 bits of a divider across 1000 ohm. The truth is that
    of the middle of each scan.
    """
    rng = np.random.default_rng(seed)
    resting = 3000 * np.exp(0.1 * rng.standard_normal(SHAPE))
    kind = load.kinds[seed % len(load.kinds)]
    down, across = rng.uniform(-1, 1, 2)
    angle = rng.uniform(0, 2 * np.pi)
    phase = rng.uniform(0, 6)
    rate = (TREMBLING_RATE if load.scanned else SWAYING_RATE) * rng.uniform(0.7, 1.3)
    strength = load.strength * rng.uniform(0.8, 1.2)

    def cells(frame: float, scan: float = 0.0) -> Array:
        way = row.speed * (frame + scan - (FRAMES - 1) / 2)
        place = down + way * np.cos(angle), across + way * np.sin(angle)
        moment = frame + scan * load.scanned
        force = strength * (1 + load.swaying * np.sin(rate * moment + phase))
        return np.asarray(resting * np.exp(row.creep - force * fall(kind, *place)))

    truth = np.stack([*[resting] * UNLOADED, *map(cells, range(FRAMES))])
    exact = two_point_resistance(truth)
    size = resting.size
    if load.scanned or row.speed:
        late = (np.arange(size) + 0.5) / size - 0.5
        for frame in range(FRAMES):
            scanned = two_point_resistance(np.stack([cells(frame, scan) for scan in late]))
            exact[UNLOADED + frame].flat = scanned.reshape(size, size).diagonal()
    channels = row.channel_ohm * rng.standard_normal((2, SHAPE[0]))
    exact = exact + channels[0][:, None] + channels[1] + SERIES_OHM + row.series_ohm
    exact[:, :, seed % SHAPE[1]] += row.contact_ohm
    exact = exact * np.exp(row.static * rng.standard_normal(SHAPE))
    volt = 5000 / (1000 + exact)
    before = np.roll(volt.reshape(len(volt), -1), 1, axis=1).reshape(volt.shape)
    volt = (1 - row.memory) * volt + row.memory * before
    volt = volt * np.exp(row.gain * rng.standard_normal((len(volt), 1, 1)))
    wave = 2 * np.pi * np.arange(SHAPE[1]) / 3 + rng.uniform(0, 6, (len(volt), 1, 1))
    volt = volt + row.ripple_lsb * LSB_VOLT * np.sin(wave)
    noise = 0.7 * rng.standard_normal((20, *volt.shape))
    codes = np.round(volt / LSB_VOLT + noise).clip(0, 1023).mean(axis=0)
    recorded = 1000 * (5 - codes * LSB_VOLT) / (codes * LSB_VOLT)
    scene = Scene(Panel(*SHAPE), TwoPointReadout(readings=20, noise_lsb=0.7), SERIES_OHM, **keys)
    role = (np.arange(len(truth)) >= UNLOADED).astype(np.uint8)
    return Recording(scene, recorded, np.arange(len(truth)) / 4, role, truth_cell_resistance=truth)


class Figures(NamedTuple):
    """Results of a recording.

    Attributes
    ----------
    error : float
        Rms error of ln r, %.
    own, cells, changes : float
        Coverages of the own part, of cells and of changes, %.
    ratio : float
        Median of `sigma_own` over the robust size of the own error.
    advised : float
        1 with advice, else 0.
    """

    error: float
    own: float
    ratio: float
    cells: float
    changes: float
    advised: float


def figures(made: Recording, *, advised: bool = True) -> Figures:
    """Return the results of a recording with its truth.

    `advised` states whether advice is searched for, which takes longer than the estimate.
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
    return Figures(
        error=100 * float(np.sqrt(np.mean(error**2))),
        own=100 * float(np.mean(within)),
        ratio=float(np.median(estimate.sigma_own) / size),
        cells=100 * float(np.mean(held)),
        changes=100 * float(np.mean(held_changes)),
        advised=float(advised and bool(estimate.advice)),
    )


def scenes(row: Row, load: Load) -> dict[str, Mapping[str, Any]]:
    """Return the keys of each scene of a row; a load that jitters in a scan is named, too."""
    every = {"unnamed": NO_KEYS}
    for name, keys, motion in (
        ("estimated", row.estimated, "estimated"),
        ("stated", row.stated, 1.0),
    ):
        if keys or load.scanned:
            every[name] = {**({"motion": motion} if load.scanned else {}), **keys}
    return every


def main() -> None:
    """Print a line for each row and scene: means over the recordings of each load."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("rows", nargs="*", default=list(ROWS))
    parser.add_argument("--recordings", type=int, default=2)
    parser.add_argument("--seed", type=int, default=100)
    given = parser.parse_args()
    print(f"| effect | scene | {' | '.join(LOADS)} |\n|---|---|{'---|' * len(LOADS)}")
    for name in given.rows:
        row = ROWS[name]
        for scene in ("unnamed", "estimated", "stated"):
            entries = []
            for load in LOADS.values():
                keys = scenes(row, load).get(scene)
                if keys is None:
                    entries.append("")
                    continue
                every = [
                    figures(recording(given.seed + at, load, row, keys), advised=False)
                    for at in range(given.recordings)
                ]
                own = np.mean([of.own for of in every])
                entries.append(f"{own:.0f} × {np.median([of.ratio for of in every]):.2f}")
            if any(entries):
                print(f"| {name} | {scene} | {' | '.join(entries)} |", flush=True)


if __name__ == "__main__":
    main()
