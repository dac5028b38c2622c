"""`weight: auto` on pads whose single cells open by 15 to 80 times, as under suction.

The error with chosen weights is compared with that of the best weight for several draws of noise.
The error of one draw is that of a cell or two, and its best weight is that of their noise.

Run it with: python -m docs.studies.open_cells [--pads 12] [--seed 200] [--draws 4]
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

import lampest
from lampest.panel.panel import Array

SIDE = 9
FRAMES = 11
UNLOADED = 5
SERIES_OHM = 140.0
FACTORS = 10.0 ** np.arange(-5, 3.1, 0.5)
PENALTIES: dict[str, lampest.Term] = {
    "log_gradient": lampest.LogGradient(),
    "gradient": lampest.Gradient(),
}
LINES = {"drive_ohm": 150.0, "load_ohm": 4000.0, "adc_bits": 12, "readings": 1, "noise_lsb": 1.0}
CIRCUITS: tuple[lampest.Readout, ...] = (
    lampest.TwoPointReadout(adc_bits=10, readings=20, noise_lsb=0.7),
    lampest.GroundedReadout(sense="all", **LINES),
    lampest.VirtualGroundReadout(
        feedback_ohm=2000.0, drive_ohm=30.0, adc_bits=12, readings=1, noise_lsb=1.0
    ),
    lampest.LoadedColumnsReadout(**LINES),
)


def pad(seed: int, draw: int) -> lampest.Recording:
    """A pad with one to four open cells, read by one of CIRCUITS; `draw` is that of the noise."""
    rng = np.random.default_rng(seed)
    readout = CIRCUITS[seed % len(CIRCUITS)]
    film = 3000 * np.exp(0.1 * rng.standard_normal((1, SIDE, SIDE)))
    cells = np.repeat(film, FRAMES, axis=0)
    for _ in range(rng.integers(1, 5)):
        row, column = rng.integers(0, SIDE, 2)
        cells[UNLOADED:, row, column] *= rng.uniform(15, 80)
    noise = np.random.default_rng([seed, draw])
    series = SERIES_OHM if readout.in_series else 0.0
    scene = lampest.Scene(lampest.Panel(SIDE, SIDE), readout, series)
    exact = readout.to_recorded(readout.exact_reading(cells), scene)
    steps = readout.volt_from_recorded(exact) / readout.lsb_volt
    size = (readout.readings, *steps.shape)
    assert isinstance(readout.noise_lsb, float)
    codes = np.round(steps + readout.noise_lsb * noise.standard_normal(size))
    codes = codes.clip(0, 2**readout.adc_bits - 1).mean(axis=0)
    role = (np.arange(FRAMES) >= UNLOADED).astype(np.uint8)
    recorded = readout.recorded_from_volt(codes * readout.lsb_volt)
    return lampest.Recording(
        scene, recorded, np.arange(FRAMES) / 4, role, truth_cell_resistance=cells
    )


def excess(seed: int, draws: int, penalty: lampest.Term) -> float:
    """Rms error of ln r with chosen weights over that with the one best weight of all draws."""

    def square(recording: lampest.Recording, weight: float | str) -> tuple[float, float]:
        """The mean square of the last frame, and the weight."""
        terms = [lampest.Misfit(weighting="noise"), replace(penalty, weight=weight)]
        results = lampest.reconstruct(recording, terms, error_bars=False)
        truth = recording.truth_cell_resistance
        assert truth is not None
        error = np.log(results.cell_resistance[-1] / truth[-1])
        return float(np.mean(error**2)), float(results.steps[-1].weights[1])

    recordings = [pad(seed, draw) for draw in range(draws)]
    chosen: Array = np.array([square(recording, "auto") for recording in recordings])
    middle = float(np.exp(np.mean(np.log(chosen[:, 1]))))
    fixed = [
        np.mean([square(recording, middle * factor)[0] for recording in recordings])
        for factor in FACTORS
    ]
    own = float(np.mean(chosen[:, 0]))
    return float(np.sqrt(own / min(own, float(np.nanmin(fixed)))))


def table(pads: int, seed: int, draws: int) -> Iterator[str]:
    """The lines of the page's table."""
    yield "| penalty | median | ninth decile | worst |\n|---|---|---|---|"
    for name, penalty in PENALTIES.items():
        ratios = [excess(seed + number, draws, penalty) for number in range(pads)]
        middle, high = np.percentile(ratios, [50, 90])
        yield f"| `{name}` | {middle:.2f} | {high:.2f} | {max(ratios):.2f} |"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--pads", type=int, default=12)
    parser.add_argument("--seed", type=int, default=200)
    parser.add_argument("--draws", type=int, default=4)
    given = parser.parse_args()
    for line in table(given.pads, given.seed, given.draws):
        print(line, flush=True)
