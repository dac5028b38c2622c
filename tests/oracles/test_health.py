"""The health of a panel: faults are named with the line of the scene that says so."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from promises import promise
from ruamel.yaml import YAML

from docs.studies.model_check import sound
from docs.studies.wrong_readings import drawn, of_load
from lampest import Faults, Panel, Recording, Scene
from lampest.audit.health import ROOMS, WELL, Health
from lampest.inference.prepared import Prepared
from lampest.inference.readings.order import (
    LENGTHS,
    Order,
    _smooth_modes,
    cell_changes,
    exchanged_lines,
    load_images,
    orders,
    scores,
    smoother_order,
)
from lampest.inference.readings.unloaded import loaded_frames
from lampest.recording.recording import UNLOADED
from lampest.runs.starter import RECORDING, TEMPLATES, write_starter
from tests.panels import READOUTS, Plan, recorded

# All circuits, with loads that stand, sway, move, tap, jump and arrive
CLEAN_SEEDS = [
    range(100),
    pytest.param(range(100, 500), marks=pytest.mark.slow),
    # small loads whose edges are rough, and an even film whose lines differ by their means
    range(166, 167),
    range(276, 277),
    range(300, 301),
    range(466, 467),
]
PLANS = range(60)
CIRCUITS = YAML(typ="safe").load(TEMPLATES / "circuits.yaml")
MIN_UNEVEN = 20  # of 120 films
# of loaded recordings
MIN_CUT_FOUND = 0.85
MIN_ORDER_FOUND = 0.65
MIN_REPEATED_FOUND = 0.9
MIN_PLACES = 4  # of the load, far enough apart to be distinct


def health(plan: Plan, codes: np.ndarray | None = None) -> Health:
    """The health of a plan's recording, or of other codes."""
    return Health.of(recorded(plan.scene, plan.codes() if codes is None else codes, plan.unloaded))


def faulty(recording: Health) -> list[str]:
    """Return findings other than the shares of missing readings and of readings at a rail."""
    return [finding.text for finding in recording.findings if finding.room != "readings"]


@pytest.mark.slow
@promise("theory/model_check: 500 clean simulated recordings of all circuits raise no alarm")
@pytest.mark.parametrize("seeds", CLEAN_SEEDS, ids="{0.start}".format)
def test_clean_recordings_of_all_circuits_raise_no_alarm(seeds: range) -> None:
    alarms = {seed: faults for seed in seeds if (faults := faulty(health(Plan.drawn(seed))))}
    assert not alarms


@pytest.mark.slow
@pytest.mark.parametrize("circuit", CIRCUITS)
def test_the_circuit_of_each_starter_explains_its_readings(circuit: str, tmp_path: Path) -> None:
    write_starter(tmp_path, circuit)
    recording = Recording.load(tmp_path / RECORDING)
    assert Health.of(recording).table == tuple((room, WELL[room]) for room in ROOMS)
    check = Prepared(recording).check
    assert check.explains, check.sentence


# Line of the scene → the cells that the fault makes of so many ohm, or the lines that it joins.
BROKEN_CELLS = {
    "faults: {dead_rows: [2]}": (np.s_[2], 1e10),
    "faults: {dead_columns: [1]}": (np.s_[:, 1], 1e10),
    "faults: {shorted: [[3, 2]]}": (np.s_[3, 2], 0.5),
}
JOINED_LINES = {
    "faults: {joined_rows: [[1, 2]]}": Faults(joined_rows=((1, 2),)),
    "faults: {joined_columns: [[3, 4]]}": Faults(joined_columns=((3, 4),)),
}


def with_fault(plan: Plan, line: str) -> Health:
    if line in JOINED_LINES:
        return health(plan, plan.codes(plan.volts(replace(plan.scene, faults=JOINED_LINES[line]))))
    place, ohm = BROKEN_CELLS[line]
    cells = plan.cells.copy()
    cells[place] = ohm
    return health(plan, replace(plan, cells=cells).codes())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "share"),
    [*zip((*BROKEN_CELLS, *JOINED_LINES), (0.95, 0.95, 0.8, 0.7, 0.7), strict=True)],
)
def test_faults_of_lines_and_cells_are_reported_with_their_line(line: str, share: float) -> None:
    """The films are uneven: on even ones, touching lines may read as single ones."""
    uneven = [plan for plan in map(Plan.drawn, range(120)) if np.std(np.log(plan.cells)) > 0.1]
    reported = [
        line in {finding.line for finding in with_fault(plan, line).findings} for plan in uneven
    ]
    assert len(reported) > MIN_UNEVEN
    assert np.mean(reported) > share


@pytest.mark.slow
@promise(
    "theory/model_check: A frame that is called unloaded and has a load on a part of the panel"
)
def test_unloaded_frames_that_have_a_load_are_named() -> None:
    """They were noise: the scatter was 136 times as specified, and a gain was advised."""
    named = []
    for seed in range(12):
        recording = drawn(seed, of_load("sway")).recording()
        first = int(np.sum(recording.role == UNLOADED))
        readout = recording.scene.readout
        assert readout is not None
        role = recording.role.copy()
        role[first : first + 2] = UNLOADED
        wrong = Health.of(replace(recording, role=role)).findings
        texts = [finding.what for finding in wrong if "unloaded" in finding.what]
        expected = [f"unloaded frames have a load: {first}, {first + 1}"]
        if readout.adc_bits > 8:
            named.append(texts == expected)
        assert "unloaded" not in " ".join(faulty(Health.of(recording)))
    assert np.mean(named) > 0.9


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("missing", [[0], [1], [0, 1, 2], slice(None)])
def test_unloaded_frames_without_readings_hide_no_load(missing: Any) -> None:
    recording = drawn(2, of_load("sway")).recording()
    first = int(np.sum(recording.role == UNLOADED))
    role, recorded = recording.role.copy(), recording.recorded.copy()
    role[first : first + 2] = UNLOADED
    recorded[:first][missing] = np.nan
    called = replace(recording, role=role, recorded=recorded)
    unloaded = called.role == UNLOADED
    found = loaded_frames(called.scene, called.readings(), unloaded)
    whole = missing == slice(None)
    assert found.tolist() == ([] if whole else [first, first + 1])


@pytest.mark.parametrize("kind", ["noise", "gain", "drift", "creep", "rows"])
def test_what_moves_all_readings_of_unloaded_frames_is_no_load(kind: str) -> None:
    for seed in range(12):
        recording = drawn(seed, of_load("palm")).recording()
        readings = recording.readings()
        frames, rows, columns = readings.value.shape
        rng = np.random.default_rng(seed)
        each = np.arange(frames)[:, None, None]
        factor = {
            "noise": 1 + 0.02 * rng.standard_normal((frames, rows, columns)),
            "gain": 1 + 0.05 * rng.standard_normal((frames, 1, 1)),
            "drift": 1 + 0.02 * each,
            "creep": np.exp(-0.01 * each * (1 + 0.3 * rng.standard_normal((rows, columns)))),
            "rows": 1 + 0.03 * np.sin(rng.uniform(0, 6) * each + np.arange(rows)[:, None]),
        }
        moved = replace(readings, value=readings.value * factor[kind])
        assert not len(loaded_frames(recording.scene, moved, recording.role == UNLOADED))


@pytest.mark.slow
@promise("theory/model_check: Lines that repeat each other are named.")
@pytest.mark.parametrize("pairs", [1, 2, 3, 4])
def test_lines_that_repeat_each_other_are_named(pairs: int) -> None:
    """Of two and more pairs none was: equal pairs hid each other."""
    named = []
    for plan in map(Plan.drawn, range(60)):
        columns = plan.cells.shape[1]
        if np.std(np.log(plan.cells)) < 0.1 or columns < 2 * pairs + 2:
            continue
        volts = plan.volts()
        firsts = np.random.default_rng(plan.seed).choice(columns // 2, pairs, replace=False) * 2
        volts[:, :, firsts + 1] = volts[:, :, firsts]
        text = " ".join(faulty(health(plan, plan.codes(volts))))
        named.append(all(re.search(rf"\b{f}( =|,) {f + 1}\b", text) for f in firsts))
    assert len(named) > 12 and np.mean(named) >= MIN_REPEATED_FOUND


def test_columns_that_few_codes_make_alike_are_not_shorted() -> None:
    """Readings of 11 to 16 codes leave nine of 16 columns equal within their noise."""
    plan = sound(662045, drifts=False)
    assert plan is not None
    assert Health.of(plan[1]).findings == ()


@promise("theory/model_check: A bar that lies on all lines alike tells nothing of their order.")
@pytest.mark.parametrize("seed", [1, 42, 138])
def test_a_bar_that_sweeps_tells_no_order_of_the_lines_that_it_crosses(seed: int) -> None:
    """Rows had odds of 10⁵ and 10⁶ by the film, which the bar shows in every place."""
    recording = drawn(seed, of_load("sweep")).recording()
    assert "order" not in {finding.room for finding in Health.of(recording).findings}


@pytest.mark.parametrize("length", LENGTHS)
def test_smooth_parts_of_lines_are_without_their_mean(length: float) -> None:
    """Modes of long lengths have variances of rounding, as the mean has, and are none of it."""
    for count in (4, 16, 40):
        _, modes = _smooth_modes(count, length, 1)
        together = np.column_stack([np.full(count, count**-0.5), modes])
        np.testing.assert_allclose(together.T @ together, np.eye(count), atol=1e-12)


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_repeated_frame_and_a_gap_in_time_are_named() -> None:
    for plan in map(Plan.drawn, PLANS):
        codes = plan.codes()
        place = plan.unloaded + 3
        codes = np.insert(codes, place, codes[place - 1], axis=0)
        time = np.arange(len(codes)) * 0.1
        time[place + 1 :] += 1.0
        texts = faulty(Health.of(recorded(plan.scene, codes, plan.unloaded, time)))
        assert len(texts) == 2
        assert any(f"frames {place} equal the one before" in text for text in texts)
        assert any(f"gaps before frames {place + 1}" in text for text in texts)


def images(plan: Plan) -> np.ndarray:
    """Return the images of a plan's loads in their places, in the order of its scene."""
    recording = recorded(plan.scene, plan.codes(), plan.unloaded)
    unloaded = recording.role == UNLOADED
    return load_images(cell_changes(plan.scene, recording.readings(), unloaded))


def in_wrong_order(shown: np.ndarray, order: Order) -> np.ndarray:
    """Patterns as a program delivers them whose order this is."""
    delivered = np.empty((len(shown), shown[0].size))
    delivered[:, order.image.ravel()] = shown.reshape(len(shown), -1)
    return delivered.reshape(shown.shape)


@pytest.mark.slow
@promise("theory/model_check: Lines in another order are found where loads are smooth.")
def test_lines_in_another_order_are_found_and_the_right_one_is_not_doubted() -> None:
    named: dict[str, list[bool]] = {}
    for seed in range(25):
        plan = Plan.drawn(seed)
        shown = images(replace(plan, load="jumps", measured=20))
        if len(shown) < MIN_PLACES:
            continue
        rows, columns = shown.shape[1:]
        assert smoother_order(shown) is None
        exchanged = {words for count in (rows, columns) for words, _ in exchanged_lines(count)}
        for order in orders(rows, columns):
            words = order.words.removeprefix("rows ").removeprefix("columns ")
            if words in exchanged:
                continue
            wrong = shown.reshape(len(shown), columns, rows)
            if order.image.shape == (rows, columns):
                wrong = in_wrong_order(shown, order)
            better = smoother_order(wrong)
            cut = "rows of" in words or "column after" in words
            # a cut and an exchange of sides are mirror images
            right = better is not None and (cut or better[0].words == order.words)
            named.setdefault("cut" if cut else words, []).append(right)
    shares = {words: np.mean(rights) for words, rights in named.items()}
    assert shares.pop("cut") > MIN_CUT_FOUND
    assert len(shares) == 5 and min(shares.values()) > MIN_ORDER_FOUND, shares


@promise("theory/model_check: Two neighbours that are swapped are tried, too")
def test_two_swapped_lines_and_two_exchanged_bits_are_named_by_loads_in_several_places() -> None:
    """Swapped lines are found on slopes of the load, and a load in one place shows none."""
    side = 16
    rng = np.random.default_rng(79)
    row, column = np.indices((side, side))
    shown = []
    for down, across in ((0.45, 0.55), (0.2, 0.3), (0.6, 0.15), (0.5, 0.9)):
        far = np.hypot(row - down * side, column - across * side)
        shown.append(np.exp(-((far / (0.3 * side)) ** 2)))
    image = np.array(shown) + 0.001 * rng.standard_normal((4, side, side))
    assert smoother_order(image) is None
    slopes = [f"rows {line} and {line + 1} swapped" for line in (5, 6, 9)]
    bits = [
        f"columns with bits {pair} of their addresses exchanged" for pair in ("0 and 1", "2 and 3")
    ]
    tried = {order.words: order for order in orders(side, side)}
    for words in (*slopes, *bits):
        wrong = in_wrong_order(image, tried[words])
        better = smoother_order(wrong)
        assert better is not None and better.order.words == words
        assert smoother_order(wrong[:1]) is None


@promise("theory/model_check: Two feet on a right mat are no columns in another order.")
def test_two_feet_half_a_panel_apart_are_no_interleaved_lines() -> None:
    """They were, with odds of 10^11 to one in four of six circuits."""
    down, across = np.mgrid[:14, :14]
    for seed in range(12):
        plan = Plan.drawn(seed, list(READOUTS)[seed % len(READOUTS)])
        rng = np.random.default_rng(seed)
        film = 3000 * np.exp(0.15 * rng.standard_normal(down.shape))
        feet = [np.exp(-(((down - 7) / 3.5) ** 2 + ((across - at) / 1.6) ** 2)) for at in (3, 10)]
        sway = 0.2 * np.sin(np.arange(8))
        loaded = [
            film * np.exp(-2 * ((1 + lean) * feet[0] + (1 - lean) * feet[1])) for lean in sway
        ]
        mat = Plan(
            scene=Scene(Panel(14, 14), plan.scene.readout),
            cells=film,
            load="stands",
            unloaded=plan.unloaded,
            measured=len(loaded),
            seed=seed,
        )
        of_every_frame = np.array([film] * plan.unloaded + loaded)
        codes = mat.codes(mat.volts(cells=of_every_frame))
        assert not [text for text in faulty(health(mat, codes)) if "order" in text]


@promise("theory/model_check: the finding says that the recording cannot tell the order")
def test_loads_on_every_second_line_leave_the_order_open() -> None:
    """They were taken for interleaved lines."""
    rng = np.random.default_rng(8)
    told = 0
    for side in (8, 10, 12, 16):
        row, column = np.indices((side, side))
        for name, line in (("row", row), ("column", column)):
            places = rng.uniform(0.2 * side, 0.8 * side, (6, 2))
            shown = []
            for down, across in places:
                far = np.hypot(row - down, column - across)
                comb = np.where(line % 2, np.exp(-((far / (0.35 * side)) ** 2)), 0.0)
                shown.append(comb + 0.003 * rng.standard_normal(comb.shape))
            smoother = smoother_order(np.array(shown))
            told += smoother is not None
            assert smoother is None or smoother.every_second == name
    assert told > 4


class Comb(Plan):
    """A plan whose load lies on every second column."""

    def loaded(self) -> np.ndarray:
        every_second = np.arange(self.cells.shape[1]) % 2 == 1
        return np.where(every_second, super().loaded(), self.cells)


def test_a_comb_is_questioned_with_what_to_record() -> None:
    plan = Plan.drawn(4)
    comb = Comb(**vars(replace(plan, load="jumps", measured=20)))
    assert len(images(comb)) >= MIN_PLACES
    (sentence,) = [text for text in faulty(health(comb)) if "order" in text]
    assert "the order of lines cannot be told from this recording" in sentence
    assert "loads lie on every second column" in sentence and "press a spot" in sentence


@pytest.mark.slow
def test_the_order_of_isolated_cells_is_not_doubted() -> None:
    """Single cells far larger than the others stand side by side in another order by chance."""
    rng = np.random.default_rng(5)
    doubted = 0
    for _ in range(60):
        shape = tuple(rng.integers(6, 15, size=2))
        image = 0.01 * rng.standard_normal(shape)
        for _ in range(rng.integers(1, 6)):
            image[rng.integers(shape[0]), rng.integers(shape[1])] += rng.uniform(0.3, 3)
        doubted += smoother_order(scores(image, np.full(shape, 0.01))[None]) is not None
    assert doubted <= 1


def test_rows_of_a_rim_that_keep_their_mean_tell_no_length_of_the_rows() -> None:
    """Beside suction a rim lowers cells as much as suction raises them, on each row by chance."""
    image = np.zeros((6, 12))
    image[2:5, 6:10] = [
        [-0.88, 0.85, 0.71, -0.73],
        [-0.75, 0.87, 0.85, -0.94],
        [-0.89, 0.87, 0.76, -0.76],
    ]
    assert smoother_order(image[None]) is None


def test_a_bar_across_the_panel_tells_no_length_of_the_rows() -> None:
    """Three full rows of four readings are one of twelve."""
    image = np.zeros((12, 4))
    image[6:9] = 0.9
    across, beside = (
        scores(np.roll(image, shift, axis=0), np.full(image.shape, 0.01))[None] for shift in (0, 1)
    )
    assert across.any() and smoother_order(across) is None and smoother_order(beside) is None
    # cut from four rows of twelve, whose load is round
    row, column = np.indices((4, 12))
    load = np.exp(-((row - 1.5) ** 2) / 2 - (column - 5) ** 2 / 4)
    cut = smoother_order(scores(load.reshape(12, 4), np.full(image.shape, 0.01))[None])
    assert cut is not None and cut.order.words == "4 rows of 12 readings, not 12 of 4"


def test_rows_of_the_wrong_length_are_named_with_their_remedy() -> None:
    plan = next(
        replace(plan, load="jumps", measured=20)
        for plan in map(Plan.drawn, PLANS)
        if plan.load == "moves" and plan.cells.shape[0] != plan.cells.shape[1]
    )
    codes = plan.codes()
    frames, rows, columns = codes.shape
    turned = replace(plan.scene, panel=Panel(columns, rows))
    exchanged = Health.of(recorded(turned, codes.reshape(frames, columns, rows), plan.unloaded))
    assert any(f"--rows {rows} --columns {columns}" in text for text in faulty(exchanged))
    apart = np.concatenate([codes[:, :, ::2], codes[:, :, 1::2]], axis=2)
    assert any("another order: columns" in text for text in faulty(health(plan, apart)))


def test_shares_of_missing_and_saturated_readings_are_reported() -> None:
    plan = Plan.drawn(0)
    recording = plan.recording()
    values = recording.recorded.copy()
    values[:, 0, :2] = np.nan
    report = Health.of(replace(recording, recorded=values))
    share = f"{100 * 2 / values[0].size:.2g} % missing"
    assert dict(report.table)["readings"].startswith(share)
