"""`weight: auto` on arrays of more than 400 cells.

What counts is its error over that of the best weight in hindsight.

Run it with: python -m docs.studies.large_arrays [--arrays 19] [--seed 9000]; prints the table of
the page.

Arrays of 20 to 39 rows and 16 to 39 columns, cells that differ at random by 5 or 30 %, one to three
smooth loads. Dividers with and without loaded columns, converters of 10, 12 or 16 bits. Each array
is read twice: with its noise alone, and with static errors of five times the noise, which the scene
does not name.
"""

import argparse
from collections.abc import Iterator

import numpy as np

import lampest
from lampest.panel.panel import Array

WEIGHTS = 10.0 ** np.arange(-2, 3.1, 0.5)
STATIC = (0.0, 5.0)  # static errors of the readings, in standard deviations of the noise


def scene_of(rng: np.random.Generator, kind: int) -> tuple[lampest.Scene, float]:
    """An array with a readout, and the resistance of its cells in ohm."""
    panel = lampest.Panel(int(rng.integers(20, 40)), int(rng.integers(16, 40)), 5.0)
    ohm = float(10 ** rng.uniform(3, 5))
    bits = int(rng.choice([10, 12, 16]))
    noise = float(rng.uniform(0.3, 3))
    readings = int(rng.choice([1, 4]))
    converter = {"supply_volt": 3.3, "adc_bits": bits, "readings": readings, "noise_lsb": noise}
    if kind % 2 == 0:
        return lampest.Scene(
            panel, lampest.TwoPointReadout(**converter, reference_ohm=ohm / 8)
        ), ohm
    driven, polarity = (("rows", "up"), ("columns", "down"))[kind // 2]
    readout = lampest.LoadedColumnsReadout(
        **converter, driven=driven, polarity=polarity, load_ohm=ohm / 4, drive_ohm=50
    )
    return lampest.Scene(panel, readout), ohm


def recording_of(seed: int, static: float) -> tuple[lampest.Recording, Array]:
    """A recording, and its true cells (frames, rows, columns) ohm."""
    rng = np.random.default_rng(seed)
    scene, ohm = scene_of(rng, seed % 4)
    rows, columns = scene.panel.shape
    readout = scene.readout
    assert readout is not None
    unloaded = int(rng.choice([0, 3]))
    frames = int(rng.choice([3, 8]))
    logarithm = np.log(ohm) + float(rng.choice([0.05, 0.3])) * rng.standard_normal((rows, columns))
    logarithm = np.repeat(logarithm[None], unloaded + frames, axis=0)
    row, column = np.indices((rows, columns))
    for _ in range(int(rng.integers(1, 4))):
        distance = np.hypot(row - rng.uniform(3, rows - 4), column - rng.uniform(3, columns - 4))
        load = rng.uniform(0.3, 3) * np.exp(-((distance / rng.uniform(1.5, 5)) ** 4))
        logarithm[unloaded:] -= load * np.linspace(0.6, 1, frames)[:, None, None]
    cells = np.exp(logarithm)
    size = float(readout.noise_lsb) / np.sqrt(readout.readings)
    volt = readout.volt_from_recorded(
        scene.circuit.to_recorded(scene.circuit.exact_reading(cells), scene)
    )
    codes = volt / readout.lsb_volt + size * rng.standard_normal(volt.shape)
    codes = np.round(codes + static * size * rng.standard_normal((rows, columns)))
    recorded = readout.recorded_from_volt(
        np.clip(codes, 0, 2**readout.adc_bits - 1) * readout.lsb_volt
    )
    time = np.arange(float(unloaded + frames))
    return lampest.Recording(scene, recorded, time, (time >= unloaded).astype(np.uint8)), cells[
        unloaded:
    ]


def error(recording: lampest.Recording, cells: Array, weight: float | str) -> float:
    """Rms error of ln r with a weight of `log_gradient`."""
    terms = [lampest.Misfit(weighting="noise"), lampest.LogGradient(weight=weight)]
    results = lampest.reconstruct(recording, terms, error_bars=False)
    return float(np.sqrt(np.nanmean(np.log(results.cell_resistance / cells) ** 2)))


def table(arrays: int, seed: int) -> Iterator[str]:
    """The lines of the page's table: error over the best one, median, ninth decile and largest."""
    yield "| static errors | chosen weight | fixed weight 1 | fixed weight 100 |"
    yield "|---" * 4 + "|"
    for static in STATIC:
        ratios = []
        for number in range(arrays):
            drawn = recording_of(seed + number, static)
            errors = {weight: error(*drawn, float(weight)) for weight in WEIGHTS}
            chosen = [error(*drawn, "auto"), *(errors[weight] for weight in WEIGHTS[[4, 8]])]
            ratios.append(np.array(chosen) / min(*errors.values(), chosen[0]))
        figures = (
            f"{np.median(own):.2f} / {np.quantile(own, 0.9):.2f} / {own.max():.2f}"
            for own in np.array(ratios).T
        )
        yield f"| {f'{static:g} × the noise' if static else 'none'} | {' | '.join(figures)} |"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--arrays", type=int, default=19)
    parser.add_argument("--seed", type=int, default=9000)
    given = parser.parse_args()
    for line in table(given.arrays, given.seed):
        print(line, flush=True)
