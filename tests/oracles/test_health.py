"""The health of a panel: faults are named with the line of the scene that says so.

Clean recordings have none.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from promises import promise
from ruamel.yaml import YAML

from lampest import Faults, Panel, Recording
from lampest.audit.health import ROOMS, WELL, Health
from lampest.inference.prepared import Prepared
from lampest.runs.starter import RECORDING, TEMPLATES, write_starter
from tests.panels import Plan, recorded

# All circuits, with loads that stand, sway, move, tap, jump and arrive
CLEAN_SEEDS = [range(100), pytest.param(range(100, 500), marks=pytest.mark.slow)]
PLANS = range(60)
CIRCUITS = YAML(typ="safe").load(TEMPLATES / "circuits.yaml")
MIN_UNEVEN = 20  # of 120 films
# of loaded recordings
MIN_CUT_NOTICED = 0.6
MIN_ORDER_NOTICED = 0.75


def health(plan: Plan, codes: np.ndarray | None = None) -> Health:
    """The health of a plan's recording, or of other codes."""
    return Health.of(recorded(plan.scene, plan.codes() if codes is None else codes, plan.unloaded))


def faulty(recording: Health) -> list[str]:
    """Return findings other than the shares of missing readings and of readings at a rail."""
    return [finding.text for finding in recording.findings if finding.room != "readings"]


@promise("theory/model_check: 500 clean simulated recordings of all circuits raise no alarm")
@pytest.mark.parametrize("seeds", CLEAN_SEEDS, ids="{0.start}".format)
def test_clean_recordings_of_all_circuits_raise_no_alarm(seeds: range) -> None:
    alarms = {seed: faults for seed in seeds if (faults := faulty(health(Plan.drawn(seed))))}
    assert not alarms


@pytest.mark.parametrize("circuit", ["two_mux", "pull_ups", "grounded", "amplifiers"])
def test_examples_of_init_raise_no_alarm(circuit: str, tmp_path: Path) -> None:
    write_starter(tmp_path, circuit)
    table = Health.of(Recording.load(tmp_path / RECORDING)).table
    assert table == tuple((room, WELL[room]) for room in ROOMS)


@pytest.mark.parametrize("circuit", CIRCUITS)
def test_the_circuit_of_each_starter_explains_its_readings(circuit: str, tmp_path: Path) -> None:
    write_starter(tmp_path, circuit)
    check = Prepared(Recording.load(tmp_path / RECORDING)).check
    assert check.explains, check.sentence


def dead_row(plan: Plan) -> tuple[str, Health]:
    cells = plan.cells.copy()
    cells[2] = 1e10
    return "faults: {dead_rows: [2]}", health(plan, replace(plan, cells=cells).codes())


def dead_column(plan: Plan) -> tuple[str, Health]:
    cells = plan.cells.copy()
    cells[:, 1] = 1e10
    return "faults: {dead_columns: [1]}", health(plan, replace(plan, cells=cells).codes())


def joined_rows(plan: Plan) -> tuple[str, Health]:
    scene = replace(plan.scene, faults=Faults(joined_rows=((1, 2),)))
    return "faults: {joined_rows: [[1, 2]]}", health(plan, plan.codes(plan.volts(scene)))


def joined_columns(plan: Plan) -> tuple[str, Health]:
    scene = replace(plan.scene, faults=Faults(joined_columns=((3, 4),)))
    return "faults: {joined_columns: [[3, 4]]}", health(plan, plan.codes(plan.volts(scene)))


def shorted_cell(plan: Plan) -> tuple[str, Health]:
    cells = plan.cells.copy()
    cells[3, 2] = 0.5
    return "faults: {shorted: [[3, 2]]}", health(plan, replace(plan, cells=cells).codes())


@pytest.mark.parametrize(
    ("fault", "share"),
    [
        (dead_row, 0.95),
        (dead_column, 0.95),
        (joined_rows, 0.7),
        (joined_columns, 0.7),
        (shorted_cell, 0.8),
    ],
)
def test_faults_of_lines_and_cells_are_reported_with_their_line(
    fault: Callable[[Plan], tuple[str, Health]], share: float
) -> None:
    """The films are uneven: on even ones, touching lines may read as single ones."""
    uneven = [plan for plan in map(Plan.drawn, range(120)) if np.std(np.log(plan.cells)) > 0.1]
    lines = [
        (line in [finding.line for finding in report.findings])
        for line, report in map(fault, uneven)
    ]
    assert len(lines) > MIN_UNEVEN and np.mean(lines) > share


def test_a_noisy_row_and_a_noisy_cell_are_named() -> None:
    for plan in map(Plan.drawn, PLANS):
        if plan.unloaded < 6:
            continue
        rng = np.random.default_rng(plan.seed)
        codes = plan.codes()
        row = codes.copy()
        cell = codes.copy()
        row[:, 3] += np.rint(6 * plan.noise_lsb * rng.standard_normal(row[:, 3].shape)).astype(int)
        cell[:, 4, 1] += np.rint(15 * plan.noise_lsb * rng.standard_normal(len(cell))).astype(int)
        assert any(
            "row 3" in text and "noisy" in text for text in faulty(health(plan, np.maximum(row, 0)))
        )
        assert any(
            "[4, 1]" in text and "noisy" in text
            for text in faulty(health(plan, np.maximum(cell, 0)))
        )


def test_a_repeated_frame_and_a_gap_in_time_are_named() -> None:
    for plan in map(Plan.drawn, PLANS):
        codes = plan.codes()
        place = plan.unloaded + 3
        texts = faulty(health(plan, np.insert(codes, place, codes[place - 1], axis=0)))
        assert [f"frames {place} equal the one before" in text for text in texts] == [True]
        time = np.arange(len(codes)) * 0.1
        time[place:] += 1.0
        late = Health.of(recorded(plan.scene, codes, plan.unloaded, time))
        assert [f"gaps before frames {place}" in text for text in faulty(late)] == [True]


def test_rows_of_the_wrong_length_and_lines_in_another_order_are_noticed() -> None:
    cut = list[bool]()
    odd = list[bool]()
    for plan in map(Plan.drawn, PLANS):
        codes = plan.codes()
        frames, rows, columns = codes.shape
        if plan.load == "none" or rows == columns:
            continue
        turned = replace(plan.scene, panel=Panel(columns, rows))
        exchanged = Health.of(recorded(turned, codes.reshape(frames, columns, rows), plan.unloaded))
        cut.append(any(f"--rows {rows} --columns {columns}" in text for text in faulty(exchanged)))
        apart = np.concatenate([codes[:, :, ::2], codes[:, :, 1::2]], axis=2)
        odd.append(any("another order: columns" in text for text in faulty(health(plan, apart))))
    assert np.mean(cut) > MIN_CUT_NOTICED and np.mean(odd) > MIN_ORDER_NOTICED


def test_shares_of_missing_and_saturated_readings_are_reported() -> None:
    plan = Plan.drawn(0)
    recording = plan.recording()
    values = recording.recorded.copy()
    values[:, 0, :2] = np.nan
    report = Health.of(replace(recording, recorded=values))
    assert (
        report.missing == pytest.approx(2 / values[0].size)
        and "missing" in dict(report.table)["readings"]
    )
