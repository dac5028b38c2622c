"""Cells of random circuits whose idle lines are held without any resistance, and the verdicts.

Run it with: python -m docs.studies.held_lines [--circuits 200] [--seed 0] [--list]. Readings are
those of nodal analysis with numbers of its own. The scene is the right one; the question is whether
the cells are, and whether the verdict says so where they are not.
"""

from argparse import ArgumentParser
from dataclasses import dataclass
from math import inf
from typing import Any, cast

import numpy as np

import lampest
from lampest import Array, DrivenReadout, Panel, Recording, Scene

NOISE_LSB = 0.7
WRONG = 0.1  # median deviation of the pressed cells beyond which an answer is wrong
RESTING_FRAMES = 6
LOADED_FRAMES = 3


@dataclass(frozen=True)
class Trial:
    """One circuit and its answer.

    Attributes
    ----------
    readout : DrivenReadout
    shape : tuple of int
        Rows and columns.
    error, resting_error : float
        Median relative deviation of the pressed cells, and of the unloaded ones.
    mark : {'yes', 'doubtful', 'no'}
        The verdict.
    sentence : str
        The verdict in words.
    """

    readout: DrivenReadout
    shape: tuple[int, int]
    error: float
    resting_error: float
    mark: str
    sentence: str

    @property
    def wrong(self) -> bool:
        """Whether pressed cells are off by more than WRONG."""
        return not self.error <= WRONG


def nodal_volts(cells: Array, readout: DrivenReadout) -> Array:
    """Return the voltages of all readings, (rows, columns), by nodal analysis for each address."""
    matrix = cells.T if readout.driven == "columns" else cells
    sensed = matrix.shape[1]
    supply = readout.supply_volt
    drive, load = cast(float, readout.drive_ohm), cast(float, readout.load_ohm)
    channel = cast(float, readout.sense_ohm)
    idle_load = readout.idle_load_ohm
    volts = np.empty(matrix.shape)
    for line, sense in np.ndindex(matrix.shape):
        # Driven lines but one are at ground: nodes are this one and the sensed lines
        admittance = np.zeros((1 + sensed, 1 + sensed))
        admittance[0, 0] = 1 / drive + np.sum(1 / matrix[line])
        admittance[0, 1:] = admittance[1:, 0] = -1 / matrix[line]
        ties = np.full(sensed, 1 / (load + channel))
        held = np.zeros(1 + sensed, dtype=bool)
        if idle_load is not None:
            idle = np.arange(sensed) != sense
            held[1:] = idle & (idle_load == 0)
            ties[idle] = 0.0 if idle_load in (0, inf) else 1 / cast(float, idle_load)
        admittance[range(1, 1 + sensed), range(1, 1 + sensed)] = (1 / matrix).sum(axis=0) + ties
        current = np.zeros(1 + sensed)
        current[0] = supply / drive
        free = ~held
        node = np.zeros(1 + sensed)
        node[free] = np.linalg.solve(admittance[np.ix_(free, free)], current[free])
        volts[line, sense] = node[1 + sense] * load / (load + channel)
    return volts.T if readout.driven == "columns" else volts


def random_readout(rng: np.random.Generator) -> DrivenReadout:
    """Return a circuit whose idle driven lines are held without resistance."""
    load = float(np.exp(rng.uniform(np.log(300.0), np.log(3e4))))
    idle_loads: tuple[Any, ...] = (None, 0.0, inf, 2200.0)
    return DrivenReadout(
        driven=rng.choice(["rows", "columns"]),
        drive_ohm=float(np.exp(rng.uniform(np.log(20.0), np.log(2000.0)))),
        idle_ohm=0.0,
        load_ohm=load,
        idle_load_ohm=idle_loads[rng.integers(4)],
        sense_ohm=float(rng.choice([0.0, 70.0])),
        supply_volt=5.0,
        adc_bits=12,
        readings=4,
        noise_lsb=NOISE_LSB,
    )


def trial(seed: int) -> Trial:
    """Return one circuit with its answer."""
    rng = np.random.default_rng(seed)
    readout = random_readout(rng)
    rows, columns = shape = (int(rng.integers(4, 9)), int(rng.integers(4, 9)))
    typical = float(np.exp(rng.uniform(np.log(1e3), np.log(2e4))))
    resting = typical * np.exp(0.2 * rng.standard_normal(shape))
    loaded = resting.copy()
    row, column = int(rng.integers(rows - 1)), int(rng.integers(columns - 1))
    pressed = np.zeros(shape, dtype=bool)
    pressed[row : row + 2, column : column + 2] = True
    loaded[pressed] *= rng.uniform(0.1, 0.6, 4)
    exact = [nodal_volts(cells, readout) for cells in (resting, loaded)]
    frames = np.repeat(exact, (RESTING_FRAMES, LOADED_FRAMES), axis=0)
    step = readout.supply_volt / 2**readout.adc_bits
    draws = rng.normal(size=(readout.readings, *frames.shape))
    codes = np.clip(np.rint(frames / step + NOISE_LSB * draws), 0, 2**readout.adc_bits - 1)
    scene = Scene(Panel(*shape), readout)
    recording = Recording.from_array(
        codes.mean(axis=0), unit="code", scene=scene, baseline=RESTING_FRAMES
    )
    estimate = lampest.reconstruct(recording)
    cells = np.median(estimate.cell_resistance, axis=0)
    check = estimate.model_check
    return Trial(
        readout,
        shape,
        float(np.median(np.abs(cells / loaded - 1)[pressed])),
        float(np.median(np.abs(estimate.baseline_resistance / resting - 1))),
        check.mark,
        check.sentence,
    )


def main() -> None:
    """Print how many answers are wrong under each verdict."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--circuits", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--list", action="store_true", help="print each wrong answer")
    options = parser.parse_args()
    trials = [trial(options.seed + number) for number in range(options.circuits)]
    print("| verdict | circuits | pressed cells more than 10 % off |")
    print("|---|---|---|")
    for mark in ("yes", "doubtful", "no"):
        chosen = [record for record in trials if record.mark == mark]
        print(f"| {mark} | {len(chosen)} | {sum(record.wrong for record in chosen)} |")
    for number, record in enumerate(trials):
        if options.list and (record.wrong or record.mark != "yes"):
            print(options.seed + number, record)


if __name__ == "__main__":
    main()
