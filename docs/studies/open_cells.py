"""`weight: auto` on pads whose single cells open by 15 to 80 times, as under suction.

The error with chosen weights is compared with that of the best weight for several draws of noise,
over all cells and over those that do not open. The error of one draw is that of a cell or two, and
its best weight is that of their noise. With --losses, the error with other losses of the penalty is
compared with that of the squared loss, each with its own chosen weight.

Run it with: python -m docs.studies.open_cells [--pads 12] [--seed 200] [--draws 4] [--losses]
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

import lampest
from lampest.cost.losses import Huber, Student
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
LOSSES = {"student": Student, "huber": Huber}
CORNERS = {"log_gradient": 0.3, "gradient": 600.0}  # three times the steps of the film
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
    series = SERIES_OHM if readout.unit == "ohm" else 0.0
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


def squares(recording: lampest.Recording, penalty: lampest.Term) -> tuple[Array, float]:
    """Return mean squares of the error of ln r in the last frame, and the penalty's weight.

    The mean squares (2,) are those of all cells and of the cells that do not open.
    """
    terms = [lampest.Misfit(weighting="noise"), penalty]
    results = lampest.reconstruct(recording, terms, error_bars=False)
    truth = recording.truth_cell_resistance
    assert truth is not None
    square = np.log(results.cell_resistance[-1] / truth[-1]) ** 2
    closed = truth[-1] == truth[0]
    return np.array([square.mean(), square[closed].mean()]), float(results.steps[-1].weights[1])


def excess(seed: int, draws: int, penalty: lampest.Term) -> Array:
    """Return the rms error with chosen weights over that with the one best weight of all draws.

    The two ratios (2,) are those of all cells and of the cells that do not open, each with a best
    weight of its own.
    """
    recordings = [pad(seed, draw) for draw in range(draws)]
    chosen = [squares(recording, replace(penalty, weight="auto")) for recording in recordings]
    middle = float(np.exp(np.mean([np.log(weight) for _, weight in chosen])))
    own = np.mean([square for square, _ in chosen], axis=0)
    fixed = [
        np.mean(
            [
                squares(recording, replace(penalty, weight=middle * factor))[0]
                for recording in recordings
            ],
            axis=0,
        )
        for factor in FACTORS
    ]
    return np.asarray(np.sqrt(own / np.minimum(own, np.nanmin(fixed, axis=0))))


def loss_ratios(seed: int, name: str) -> Array:
    """Return the rms error of ln r with each of LOSSES over that with the squared loss.

    Weights are chosen for every loss; one draw of noise.
    """
    recording = pad(seed, 0)
    open_weight = replace(PENALTIES[name], weight="auto")
    squared = squares(recording, open_weight)[0][0]
    of_losses = [
        squares(recording, replace(open_weight, loss=loss(corner=CORNERS[name])))[0][0]
        for loss in LOSSES.values()
    ]
    return np.asarray(np.sqrt(np.array(of_losses) / squared))


def table(pads: int, seed: int, draws: int) -> Iterator[str]:
    """The lines of the page's first table."""
    yield "| penalty | all cells | cells that do not open |\n|---|---|---|"
    for name, penalty in PENALTIES.items():
        ratios = np.array([excess(seed + number, draws, penalty) for number in range(pads)])
        yield f"| `{name}` | {_spread(ratios[:, 0])} | {_spread(ratios[:, 1])} |"


def loss_table(pads: int, seed: int) -> Iterator[str]:
    """The lines of the page's second table."""
    yield f"| penalty | {' | '.join(LOSSES)} |\n|---|{'---|' * len(LOSSES)}"
    for name in PENALTIES:
        ratios = np.array([loss_ratios(seed + number, name) for number in range(pads)])
        yield f"| `{name}` | {' | '.join(_spread(own) for own in ratios.T)} |"


def _spread(ratios: Array) -> str:
    """First decile, median, ninth decile and largest of ratios."""
    low, middle, high = np.percentile(ratios, [10, 50, 90])
    return f"{low:.2f} / {middle:.2f} / {high:.2f} / {ratios.max():.2f}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--pads", type=int, default=12)
    parser.add_argument("--seed", type=int, default=200)
    parser.add_argument("--draws", type=int, default=4)
    parser.add_argument("--losses", action="store_true", help="compare losses of the penalty")
    given = parser.parse_args()
    lines = loss_table(given.pads, given.seed) if given.losses else None
    for line in lines or table(given.pads, given.seed, given.draws):
        print(line, flush=True)
