"""Random boards, calibrated: good calibrations refused, bad ones accepted, and intervals.

Run it with: python -m docs.studies.calibrations --draws 200 --bad 25
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from lampest import (
    GroundedReadout,
    InputError,
    LoadedColumnsReadout,
    Panel,
    Readout,
    Recording,
    Scene,
    TwoPointReadout,
    VirtualGroundReadout,
)
from lampest.apps.calibration.resistors import ResistorCalibration, calibrate_resistors
from lampest.panel.panel import Array
from lampest.panel.readouts.tolerances import off_by, simulated
from lampest.recording.simulation.measure import Unmodelled, sums_of_codes

OPEN = 1e12
VALUES = np.array([220, 470, 1000, 2200, 4700.0])
NOMINAL = {"loaded_columns": (1000.0, 10_000.0), "grounded": (1000.0,), "virtual_ground": (300.0,)}
KINDS = ("two_point", *NOMINAL)
SECOND = {"loaded_columns": "load_ohm", "grounded": "load_ohm", "virtual_ground": "feedback_ohm"}


@dataclass(frozen=True, eq=False)
class Draw:
    """A board as its user knows it and as it is, resistors as they are printed and as they are."""

    specified: Scene
    actual: Readout
    truth: tuple[Array, Array]
    printed: Array
    cells: Array
    frames: int
    tolerance: float
    placed: str

    def recorded(self, cells: Array, seed: int) -> Recording:
        """Frames through the true board; cells (rows, columns), or one set for each frame."""
        frames = cells if cells.ndim == 3 else np.repeat(cells[None], self.frames, axis=0)
        series = (
            self.truth
            if self.specified.circuit.unit == "ohm"
            else [np.zeros(n) for n in self.specified.panel.shape]
        )
        volt = self.actual.volt_from_recorded(
            simulated(self.actual, frames, self.specified, *series)
        )
        sums = sums_of_codes(self.actual, volt, Unmodelled(outlier_probability=1e-4), seed)
        values = self.specified.circuit.recorded_from_volt(
            self.specified.circuit.volt_from_code(sums / self.actual.readings)
        )
        time = np.arange(float(len(sums)))
        return Recording(self.specified, values, time, np.ones(len(sums), dtype=np.uint8), name="r")


def draw(kind: str, rng: np.random.Generator) -> Draw:
    """3 × 3 to 8 × 8, 10 and 12 bits, noise up to 2 LSB, 3 to 14 frames.

    Channels are of 25 to 155 ohm, with 1 and 5 % loads.
    """
    rows, columns = (int(size) for size in rng.integers(3, 9, 2))
    converter = {
        "supply_volt": 5.0,
        "adc_bits": int(rng.choice([10, 12])),
        "readings": int(rng.choice([1, 4, 20])),
        "noise_lsb": float(rng.uniform(0.3, 2)),
    }
    tolerance = float(rng.choice([0.001, 0.01]))
    apart = float(rng.choice([0.01, 0.05]))
    level = float(rng.uniform(60, 110))

    def channels(lines: int) -> Array:
        return level + rng.uniform(-1, 1, lines) * rng.uniform(2, min(level - 25, 45))

    if kind == "two_point":
        readout: Readout = TwoPointReadout(
            **converter, measured_across=str(rng.choice(["reference", "sensor"]))
        )
        truth = (channels(rows), channels(columns))
        actual = off_by(readout, tolerance * rng.uniform(-1, 1))
        driven = "rows"
    else:
        driven = str(rng.choice(["rows", "columns"]))
        lines, sensed_lines = (rows, columns) if driven == "rows" else (columns, rows)
        nominal = float(rng.choice(NOMINAL[kind]))
        extra = 0.0
        options = {"driven": driven, SECOND[kind]: nominal}
        if kind == "loaded_columns":
            extra = float(rng.choice([0.0, 1000.0]))
            options |= {"polarity": str(rng.choice(["up", "down"])), "drive_ohm": extra}
        elif kind == "grounded":
            options["sense"] = str(rng.choice(["one", "all"]))
        else:
            options["sense_ohm"] = 70.0
        makes = {
            "loaded_columns": LoadedColumnsReadout,
            "grounded": GroundedReadout,
            "virtual_ground": VirtualGroundReadout,
        }
        readout = makes[kind](**converter, **options)
        drive = channels(lines) + extra * (1 + apart * rng.uniform(-1, 1, lines))
        truth = (drive, nominal * (1 + apart * rng.uniform(-1, 1, sensed_lines)))
        ohm = {"drive_ohm": tuple(truth[0].tolist()), SECOND[kind]: tuple(truth[1].tolist())}
        actual = replace(readout, **ohm)
    placed = str(
        rng.choice(
            [
                "shorted" if kind == "two_point" else "two values",
                "everywhere",
                "here and there",
                "three",
            ]
        )
    )
    printed = resistors(kind, placed, (rows, columns), driven, rng)
    true = printed * (1 + tolerance * rng.uniform(-1, 1, printed.shape))
    cells = np.where(np.isinf(printed), OPEN, np.maximum(true, 1e-3))
    stated = Scene(Panel(rows, columns), readout)
    return Draw(stated, actual, truth, printed, cells, int(rng.integers(3, 15)), tolerance, placed)


def resistors(
    kind: str, placed: str, shape: tuple[int, int], driven: str, rng: np.random.Generator
) -> Array:
    """(rows, columns) ohm as printed, inf where there is none."""
    if placed == "shorted":
        return np.zeros(shape)
    if placed == "everywhere":
        return rng.choice(VALUES, shape)
    if placed == "two values":
        return np.where(rng.random(shape) < 0.5, 470.0, 2200.0)
    if placed == "here and there":
        some = np.where(rng.random(shape) < 0.6, rng.choice(VALUES, shape), np.inf)
        some[0, 0] = 1000.0
        return some
    three = np.full(shape, np.inf)
    if kind == "virtual_ground":
        three[range(3), range(3)] = 470.0, 1500.0, 4700.0
    elif kind == "two_point":
        three[0, :3] = 220.0, 470.0, 1000.0
    elif driven == "rows":
        three[0, :3] = 470.0, 1500.0, 4700.0
    else:
        three[:3, 0] = 470.0, 1500.0, 4700.0
    return three


def errors(
    results: ResistorCalibration, truth: tuple[Array, Array]
) -> tuple[list[float], list[float]]:
    """Return (estimated − true)/σ of means and of the deviations of single lines."""
    means = []
    single = []
    sides = iter(truth)
    for record in results.numbers:
        mean = 0.0
        for lines in record.lines:
            measured = np.isfinite(lines.off_ohm)
            true = next(sides)
            mean += true[measured].mean()
            off = (lines.off_ohm - (true - true[measured].mean()))[measured]
            single += (off / lines.sigma_ohm[measured]).tolist() if measured.sum() > 1 else []
        means.append((record.value - mean) / record.sigma)
    return means, single


def foam(record: Draw, rng: np.random.Generator) -> Array:
    """A panel of some 3 kΩ in place of the resistors."""
    return np.exp(rng.normal(np.log(3050), 0.3, record.cells.shape))


def pressed(record: Draw, rng: np.random.Generator) -> Array:
    """The same, a third of its cells pressed ever more."""
    touched = rng.random(record.cells.shape) < 0.3
    cells = foam(record, rng)
    return cells * np.exp(-0.05 * np.arange(max(record.frames, 6))[:, None, None] * touched)


Bad = Callable[[Draw, np.random.Generator], tuple[Array, Array]]
BAD: dict[str, Bad] = {
    "panel, said to be the resistors": lambda record, rng: (foam(record, rng), record.printed),
    "panel, said to be shorted": lambda record, rng: (
        foam(record, rng),
        np.zeros(record.cells.shape),
    ),
    "panel pressed, said to be 3050 ohm": lambda record, rng: (
        pressed(record, rng),
        np.full(record.cells.shape, 3050.0),
    ),
    "table turned by 180 degrees": lambda record, rng: (record.cells, record.printed[::-1, ::-1]),
    "values off by 35 %, either way": lambda record, rng: (
        record.cells,
        record.printed * np.exp(rng.choice([-0.3, 0.3], record.cells.shape)),
    ),
}


def good(kind: str, draws: int) -> None:
    """Rates and coverage of calibrations that are some."""
    means: list[float] = []
    single: list[float] = []
    refused = 0
    for seed in range(draws):
        record = draw(kind, np.random.default_rng([seed, KINDS.index(kind)]))
        try:
            results = calibrate_resistors(
                [record.recorded(record.cells, seed)], [record.printed], record.tolerance
            )
        except InputError as error:
            refused += 1
            print(f"  {seed}, {record.placed}: {error}")
            continue
        of_means, of_lines = errors(results, record.truth)
        means += of_means
        single += of_lines
    held, of_single = (100 * np.mean(np.abs(part) < 1.96) for part in (means, single))
    print(
        f"{kind}: {refused} of {draws} good ones refused; 95 % intervals hold {held:.1f} %, of "
        f"lines {of_single:.1f} %"
    )
    print(f"  errors are {np.std(means):.2f} σ, of lines {np.std(single):.2f} σ", flush=True)


def bad(kind: str, draws: int) -> None:
    """Rates of calibrations that are none."""
    for name, spoil in BAD.items():
        count = 0
        accepted = []
        for seed in range(5000, 5000 + draws):
            rng = np.random.default_rng([seed, KINDS.index(kind)])
            record = draw(kind, rng)
            if name.startswith(("table", "values")) and record.placed in ("three", "shorted"):
                # Three resistors turned or off are another good calibration, or next to one.
                continue
            cells, known = spoil(record, rng)
            count += 1
            try:
                calibrate_resistors([record.recorded(cells, seed)], [known], record.tolerance)
                accepted.append(f"{seed} ({record.placed})")
            except InputError:
                pass
        print(
            f"{kind}, {name}: {count - len(accepted)} of {count} refused {' '.join(accepted)}",
            flush=True,
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--bad", type=int, default=25)
    parser.add_argument("--kinds", nargs="*", default=KINDS)
    asked = parser.parse_args()
    for kind in asked.kinds:
        good(kind, asked.draws)
        bad(kind, asked.bad)
