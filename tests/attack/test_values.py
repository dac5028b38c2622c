"""Numbers of no real panel, and panels with almost no readings left."""

from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest
from attack.attack import PASSED, SIMULATION, CompletedCommand, Outcomes, Rng, attack, called, drawn
from fuzz.batches import write_recording

pytestmark = pytest.mark.slow
EXTREME = (
    1e300,
    1e-300,
    5e-324,
    -1e300,
    1e160,
    1e29,
    1e-29,
    0.0,
    -0.0,
    1e12,
    np.inf,
    -np.inf,
    np.nan,
)
# Words of the libraries behind; a user's panel has none of them.
FOREIGN = (
    "LinAlgError",
    "eigenvalue",
    "SVD",
    "leading minor",
    "out of bounds",
    "division by zero",
    "singular matrix",
    "positive definite",
    "infs or NaNs",
    "broadcast",
    "index ",
    "bad_alloc",
    "NoneType",
    "math domain",
    "converge",
    "overflow encountered",
    "invalid value",
    "zero-size array",
    "empty sequence",
    "nan_policy",
    "array must",
    "axis",
)
ENTRIES = {
    "panel: {rows: 3, columns: 4": ("panel: {rows: 3, columns: 4, pitch_mm: VALUE",),
    "series_resistance_ohm: 140": (
        "series_resistance_ohm: VALUE",
        "water: {top_row_depth_mm: VALUE}",
        "lines: {row_ohm_per_cell: VALUE}",
        "systematic: {reference_tolerance: 0.01, channel_spread_ohm: VALUE}",
        "systematic: {series_tolerance_ohm: VALUE}",
        "systematic: {inl_lsb: VALUE}",
        "systematic: {reading_error: VALUE}",
        "systematic: {response_sd: VALUE}",
        "systematic: {wire_ohm_per_cell: VALUE}",
    ),
    "noise_lsb: 0.7": (
        "noise_lsb: VALUE",
        "noise_lsb: 0.7, input_ohm: VALUE",
        "noise_lsb: 0.7, reference_ohm: VALUE",
        "noise_lsb: 0.7, supply_volt: VALUE",
    ),
    "seed: 1": (
        "seed: 1\nframe_period_s: VALUE",
        "seed: 1\ncells: {resistance_ohm: VALUE}",
        "seed: 1\ncells: {patch_mm: VALUE}",
        "seed: 1\nloads: [{kind: rod, centre_mm: [VALUE, 10], diameter_mm: 20, mass_g: 100}]",
        "seed: 1\nloads: [{kind: rod, centre_mm: [10, 10], diameter_mm: VALUE, mass_g: 100}]",
        "seed: 1\nloads: [{kind: rod, centre_mm: [10, 10], diameter_mm: 20, mass_g: VALUE}]",
    ),
}
RUN = (
    "schema: 1\nrecordings: [small.h5]\nestimators:\n"
    "  LSM: {terms: {misfit: {}}}\n"
    "  LSR-CR: {terms: {misfit: {}, cell_resistance: {weight: 1e-3}}, formulation: reduced}\n"
    "  LSR-gdCR: {terms: {misfit: {}, gradient_of_relative_change: {weight: auto}}, formulation: "
    "auto}\n"
)


Commands = tuple[tuple[str, ...], ...]
RUNS: Commands = (("run", "run.yaml", "--jobs", "1", "--out", "out"), ("detect", "out/results.h5"))
LOOKS: Commands = (("info", "small.h5"), ("calibrate", "small.h5", "--known", "1000"))


def _tried(description: str, place: Path, commands: Commands) -> Iterator[str]:
    """Each of the commands; results are looked at where there are some."""
    (place / "run.yaml").write_text(RUN)
    for arguments in commands:
        if arguments[0] != "detect" or (place / arguments[1]).is_file():
            fault = sensible(called(*arguments, folder=place))
            yield f"{description}: {' '.join(arguments)}: {fault}" if fault else PASSED


@attack(4, 60)
def test_scenes_with_impossible_numbers_give_one_sentence(
    rng: Rng, folder: Path, count: int
) -> Outcomes:
    tries = [
        (old, new, value)
        for old, several in ENTRIES.items()
        for new in several
        for value in EXTREME
    ]
    for number, (old, new, value) in drawn(rng, tries, count):
        place = folder / f"scene{number}"
        place.mkdir()
        written = repr(value).replace("inf", ".inf").replace("nan", ".nan")  # as YAML has them
        text = SIMULATION.replace(old, new.replace("VALUE", written))
        (place / "small.yaml").write_text(text)
        simulate = (("simulate", "small.yaml", "--out", "small.h5"),)
        description = f"{new.splitlines()[-1]} of {value}"
        yield from _tried(description, place, simulate)
        yield from _tried(
            description, place, RUNS + LOOKS if (place / "small.h5").is_file() else ()
        )


@attack(1, 6)
def test_panels_with_few_readings_give_one_sentence(rng: Rng, folder: Path, count: int) -> Outcomes:
    everywhere = [[row, column] for row in range(6) for column in range(7)]
    faults = {
        "one cell": {"open": everywhere[:-1]},
        "one row": {"dead_rows": [0, 1, 2, 3, 4]},
        "one column": {"dead_columns": [0, 1, 2, 3, 4, 5]},
        "one reading": {"dead_rows": [0, 1, 2, 3, 4], "dead_columns": [0, 1, 2, 3, 4, 5]},
        "all rows joined": {"joined_rows": [[0, 1, 2, 3, 4, 5]]},
        "shorts": {"shorted": everywhere[:-1]},
    }
    for number, (name, fault) in enumerate(list(faults.items())[:count]):
        place = folder / f"fault{number}"
        place.mkdir()
        write_recording(place / "small.h5", 2, 1)
        with h5py.File(place / "small.h5", "a") as file:
            text = file["entry/scene"][()].decode()
            del file["entry/scene"]
            file["entry/scene"] = np.bytes_(f"{text}faults: {fault}\n".replace("'", ""))
        yield from _tried(name, place, LOOKS[:1] + RUNS)


def sensible(completed: CompletedCommand) -> str:
    """Return PASSED where a command did its work, or refused in words of the panel."""
    foreign = [word for word in FOREIGN if word in completed.err]
    return completed.survived() or (
        f"speaks of {foreign}: {completed.err[-300:]}" if foreign else PASSED
    )
