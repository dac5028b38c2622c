"""The C library of the estimate against the optimum of lampest."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from apps.board.estimated import (
    CIRCUITS,
    pressed_cells,
    scene_of,
    solved_case,
    sums_of,
    unchecked_case,
)
from promises import promise
from typer.testing import CliRunner

import lampest
from lampest.apps.microcontroller.constants import MISSING, Budget, CircuitLines, Constants
from lampest.apps.microcontroller.header import header
from lampest.apps.microcontroller.host import HOST, compiled
from lampest.apps.microcontroller.library import library_folder, sources
from lampest.apps.microcontroller.sketch import export_sketch
from lampest.apps.microcontroller.trade import (
    MAX_TOUCH,
    Trade,
    chosen_budget,
    instructions,
    table_of,
    trades,
)
from lampest.cli.program import app

FIRMWARE = Path(__file__).resolve().parents[3] / "firmware"
NOISY = lampest.Misfit(weighting="noise")
EXACT = Budget(8, 60, 0.01)
OVAL = tuple(
    (i, k, 10.0 * k, 10.0 * i)
    for i in range(6)
    for k in range(5)
    if (i - 2.5) ** 2 + (k - 2) ** 2 < 8
)
FINE, BAD_CONSTANTS, TOO_FEW = range(3)
MEGA_HERTZ = 16e6
# Instructions, bytes of memory and flash, and seconds, as the names of the tests state them.
MAX_INSTRUCTIONS_OF_LAMPREY = 1.5e6
MAX_BYTES_OF_LAMPREY = 12_000
MAX_INSTRUCTIONS_OF_16_BY_16 = 6e6
MAX_BYTES_OF_16_BY_16 = 32_000
MAX_SECONDS_OF_MEGA = 2.5
MAX_BYTES_OF_8_BY_8 = 6000
MAX_FLASH = 24_000
TWENTIETH = 0.05  # of the standard deviation of a cell: how far a budget may leave it
MAX_RECKONED = 0.15  # relative: the reckoned number of instructions against the counted one
SINGLE_PRECISION = 0.01  # of log r, after all steps in single precision
ITERATED = 0.02  # relative, after 60 conjugate gradients


def deviations(case, changes):
    """Return the rms deviation of each frame from the optimum, in standard deviations."""
    optimum = np.log(case.cell_resistance / case.baseline_resistance)
    square = ((changes - optimum) / case.sigma_own) ** 2
    return np.sqrt(np.nanmean(square, axis=(1, 2)))


def mostly_slow(*variants):
    """Return variants of which only the first is fast."""
    return [
        variants[0],
        *(pytest.param(variant, marks=pytest.mark.slow) for variant in variants[1:]),
    ]


def assert_same_optimum(scene, terms, tolerance=0.01):
    sums, case = solved_case(scene, terms)
    with compiled(Constants.of(case)) as host:
        estimates = host.frames(sums, EXACT)
    assert estimates.settled.all() and not estimates.outcome.any()
    assert deviations(case, estimates.log_change).max() < tolerance
    np.testing.assert_array_equal(Constants.of(case).sums_of(case), sums)


@pytest.mark.parametrize(
    "circuit", mostly_slow("grounded_one", *(name for name in CIRCUITS if name != "grounded_one"))
)
def test_every_circuit_reaches_the_optimum_of_lampest(circuit):
    assert_same_optimum(scene_of(circuit), [NOISY, lampest.LogGradient()])


@pytest.mark.slow
@pytest.mark.parametrize(
    "terms",
    mostly_slow(
        [
            NOISY,
            lampest.LogGradient(weight=0.5),
            lampest.LogRatio(loss=lampest.Huber(corner=5.0), weight=1e-4),
        ],
        [NOISY],
        [lampest.Misfit(), lampest.LogGradient()],
        [NOISY, lampest.Gradient()],
        [NOISY, lampest.CellResistance()],
        [NOISY, lampest.LogRatio(loss=lampest.Huber(corner=5.0))],
        [
            NOISY,
            lampest.LogRatio(weight=0.01, loss=lampest.Student(corner=5.0), reference="previous"),
        ],
        [NOISY, lampest.RelativeChange(weight=0.01)],
        [NOISY, lampest.GradientOfRelativeChange(weight=0.01)],
        [
            lampest.Misfit(weighting="noise", loss=lampest.Huber(corner=2.0)),
            lampest.LogGradient(weight=1.0),
        ],
        [
            lampest.Misfit(weighting="noise", loss=lampest.Student(corner=3.0)),
            lampest.LogGradient(weight=1.0),
        ],
    ),
    ids=lambda terms: " + ".join(f"{term.kind}-{term.loss.kind}" for term in terms),
)
def test_every_term_and_loss_reaches_the_optimum_of_lampest(terms):
    assert_same_optimum(scene_of("two_point"), terms)


@pytest.mark.slow
@pytest.mark.parametrize(
    "scene",
    mostly_slow(
        scene_of(
            "two_point", 5, 6, cells=tuple((k, i, y, x) for i, k, x, y in OVAL), series_ohm=140.0
        ),
        scene_of("two_point", 4, 7, series_ohm=140.0),
        scene_of("driven_columns", 4, 7),
        scene_of("grounded_one", 5, 6),
        scene_of("loaded_columns", 1, 6),
        scene_of("loaded_columns", 6, 1),
        scene_of("two_point", cells=OVAL),
        scene_of("grounded_all", cells=OVAL),
    ),
    ids=[
        "wide oval",
        "wide with channels",
        "wide",
        "wide grounded",
        "row",
        "column",
        "oval",
        "oval grounded",
    ],
)
def test_every_panel_shape_reaches_the_optimum_of_lampest(scene):
    assert_same_optimum(scene, [NOISY, lampest.LogGradient(weight=1.0)])


@pytest.fixture(scope="module")
def lamprey(tmp_path_factory):
    """The shipped lamprey with its default estimator, as results."""
    recording = lampest.datasets.load("lamprey_35mm")
    estimate = lampest.reconstruct(recording, [NOISY, lampest.LogGradient()], formulation="reduced")
    path = tmp_path_factory.mktemp("lamprey") / "results.h5"
    case = unchecked_case(estimate, "smooth")
    lampest.write_results(path, [case])
    return path, case


def made(target, *variables):
    """Return the lines that a target of the firmware's Makefile prints."""
    words = ["make", "-s", "-C", str(FIRMWARE), *variables, target]
    return subprocess.run(words, capture_output=True, text=True, check=True).stdout.splitlines()


def with_vector(folder, constants, sums):
    """Return a folder with constants and the frames of a test vector."""
    folder.mkdir()
    (folder / "panel_constants.h").write_text(header(constants, "panel", ()))
    rows = ", ".join("{" + ", ".join(map(str, frame.ravel())) + "}" for frame in sums)
    vector = f"static const uint32_t vector_sums[{len(sums)}][{sums[0].size}] = {{{rows}}};"
    (folder / "test_vector.h").write_text(f"#define VECTOR_FRAMES {len(sums)}\n{vector}\n")
    return folder


def emulated(folder, build):
    """Return (instructions, log changes) of the frames of a sketch on the emulated Cortex-M4F."""
    begin, *lines = made("emulated", f"PANEL={folder}", f"BUILD={build}")
    assert begin == f"begin {FINE}"
    fields = [line.split() for line in lines]
    bits = np.array([[int(number, 16) for number in frame[4:]] for frame in fields], np.uint32)
    return np.array([int(frame[0]) for frame in fields]), bits.view(np.float32)


@pytest.mark.slow
def test_a_lamprey_takes_1_5_million_instructions_and_deviates_by_a_twentieth_of_its_error(
    lamprey, tmp_path
):
    path, case = lamprey
    sketch = export_sketch(path, tmp_path / "mat")
    constants = Constants.of(case).within(sketch.budget)
    with compiled(constants) as host:
        estimates = host.frames(constants.sums_of(case), sketch.budget)
        assert host.bytes < MAX_BYTES_OF_LAMPREY
    errors = deviations(case, estimates.log_change)
    assert np.median(errors) <= TWENTIETH
    assert errors[1] < 1  # a first touch, after two frames
    counted, changes = emulated(tmp_path / "mat", tmp_path / "build")
    assert counted[1:].mean() < MAX_INSTRUCTIONS_OF_LAMPREY
    # The same bits: single precision of the computer, kept in double
    np.testing.assert_array_equal(changes.reshape(-1, 10, 10), estimates.log_change[: len(changes)])
    reckoned = instructions(constants, estimates.products - estimates.steps, estimates.steps)[
        : len(counted)
    ]
    np.testing.assert_allclose(reckoned, counted, rtol=MAX_RECKONED)


@pytest.mark.slow
def test_sixteen_by_sixteen_cells_take_six_million_instructions_and_32_kilobytes(tmp_path):
    scene = scene_of("grounded_one", 16, 16)
    _, case = solved_case(scene, [NOISY, lampest.LogGradient(weight=1.0)], error_bars=False)
    constants = Constants.of(case).within(Budget(2, 8, 0.0))
    sums = constants.sums_of(case)[:2]
    counted, changes = emulated(
        with_vector(tmp_path / "panel", constants, sums), tmp_path / "build"
    )
    assert counted.max() < MAX_INSTRUCTIONS_OF_16_BY_16
    with compiled(constants) as host:
        estimates = host.frames(sums, constants.budget)
        assert host.bytes < MAX_BYTES_OF_16_BY_16
    np.testing.assert_array_equal(changes.reshape(-1, 16, 16), estimates.log_change)
    reckoned = instructions(constants, estimates.products - estimates.steps, estimates.steps)
    np.testing.assert_allclose(reckoned, counted, rtol=MAX_RECKONED)


@pytest.mark.slow
def test_the_mega_estimates_eight_by_eight_cells_in_two_seconds(tmp_path):
    sums, case = solved_case(
        scene_of("two_point", 8, 8), [NOISY, lampest.LogGradient(weight=1.0)], error_bars=False
    )
    constants = Constants.of(case).within(Budget(2, 6, 0.05))
    with compiled(constants) as host:
        estimates = host.frames(sums[:2], constants.budget)
        assert host.bytes < MAX_BYTES_OF_8_BY_8
    folder = with_vector(tmp_path / "panel", constants, sums[:2])
    lines = made("mega", f"PANEL={folder}", f"BUILD={tmp_path}", "FRAMES=2", "CELLS=64")
    *cycles, changes = [line for line in lines if not line.startswith("Loaded")]
    assert max(map(int, cycles)) / MEGA_HERTZ < MAX_SECONDS_OF_MEGA
    np.testing.assert_allclose(
        np.array(changes.split(), float).reshape(8, 8),
        estimates.log_change[-1],
        atol=SINGLE_PRECISION,
    )


@pytest.mark.slow
def test_the_library_takes_24_kilobytes_of_flash(tmp_path):
    (size,) = made("estimate-size", f"BUILD={tmp_path}")
    assert int(size) < MAX_FLASH


@pytest.mark.slow
def test_standard_deviations_match_the_linear_system():
    sums, case = solved_case(scene_of("two_point"), [NOISY, lampest.LogGradient(weight=1.0)])
    constants = Constants.of(case)
    with compiled(constants) as host:
        assert host.deviation(0, 0, 30) < 0  # before the first frame nothing is known
        host.frames(sums[:4], EXACT)
        estimated = np.array(
            [[host.deviation(row, column, 60) for column in range(5)] for row in range(6)]
        )
    cells = case.cell_resistance[3]
    readout = case.scene.circuit
    network = readout.network(cells, readout.ties(case.measured[3]))
    response = network.sensitivity() / case.sigma[3].ravel()[:, None]
    first, second, _ = case.scene.panel.neighbours
    steps = np.zeros((len(first), cells.size))
    steps[np.arange(len(first)), first] = -1
    steps[np.arange(len(first)), second] = 1
    variance = np.linalg.inv(response.T @ response + steps.T @ steps).diagonal().reshape(6, 5)
    np.testing.assert_allclose(estimated, np.sqrt(variance), rtol=ITERATED)


@pytest.mark.slow
def test_bad_frames_get_a_status_and_keep_the_estimate():
    scene = scene_of("loaded_columns")
    sums, case = solved_case(scene, [NOISY, lampest.LogGradient(weight=1.0)])
    full = 4 * 4095
    with compiled(Constants.of(case)) as host:
        host.begin(EXACT)
        previous, _ = host.frame(sums[0])
        for bad in (0, full, full + 1, MISSING):
            change, status = host.frame(np.full((6, 5), bad))
            assert status[0] == TOO_FEW
            np.testing.assert_array_equal(change, previous)
        dead = sums[1].copy()
        dead[:, 2] = 0
        change, status = host.frame(dead)
        assert (status[0], status[4], status[6]) == (FINE, 6, 6 + 2 + 1)
        missing = sums[1].copy()
        missing[1, 1] = MISSING
        change, status = host.frame(missing)
        assert (status[0], status[5]) == (FINE, 1) and np.isfinite(change).all()


@pytest.mark.slow
def test_missing_readings_and_bounds_reach_the_optimum_of_lampest():
    scene = scene_of("two_point")
    sums = sums_of(scene, pressed_cells(scene))
    sums[4, 2, 2] = 4 * 4095
    recorded = sums.astype(float)
    case = solved_case(
        scene, [NOISY, lampest.LogGradient(weight=30.0)], sums=recorded.astype(np.uint32)
    )[1]
    with compiled(Constants.of(case)) as host:
        estimates = host.frames(Constants.of(case).sums_of(case), Budget(12, 60, 1e-3))
    assert deviations(case, estimates.log_change).max() < TWENTIETH


@pytest.mark.slow
@pytest.mark.parametrize(
    "field",
    ["reference_ohm", "sigma_volt[1]", "weight", "baseline[30]", "largest_ohm", "supply_volt"],
)
def test_constants_that_are_not_numbers_are_refused(field, tmp_path):
    _, case = solved_case(scene_of("two_point"), [NOISY, lampest.LogGradient(weight=1.0)])
    text = header(Constants.of(case), "panel", ())
    if field == "weight":
        text = text.replace("1.0f, 1.0f}", "1.0f, NAN}")
    elif "[" in field:
        head, start, tail = text.partition(f"panel_{field} = {{\n    ")
        text = head + start + "NAN" + tail[tail.index("f") + 1 :]
    else:
        head, start, tail = text.partition(f".{field} = ")
        text = head + start + "NAN" + tail[tail.index("f") + 1 :]
    assert text.count("NAN") == 1
    (tmp_path / "panel_constants.h").write_text("#include <math.h>\n" + text)
    (tmp_path / "host.c").write_text(HOST)
    library = ctypes.CDLL(str(built(tmp_path, "host.c")))
    assert library.host_begin(2, 8, ctypes.c_float(0.05)) == BAD_CONSTANTS


def built(folder, *files, name="host.so", flags=("-O2", "-Wall", "-Wextra", "-Werror", "-shared")):
    """Build C files of a folder with the library, and return the result."""
    parts = [folder / file for file in files] + [path for path in sources() if path.suffix == ".c"]
    words = ["gcc", "-std=c99", "-fPIC", *flags, f"-I{folder}", f"-I{library_folder()}"]
    subprocess.run([*words, *map(str, parts), "-lm", "-o", str(folder / name)], check=True)
    return folder / name


FUZZ = """
#include <stdio.h>
#include <stdlib.h>
#include <math.h>
#include "panel_constants.h"
#include "lampest_estimate.h"
static lampest_panel panel = {.constants = &panel_constants};
int main(void) {
    const unsigned cells = PANEL_ROWS * PANEL_COLUMNS;
    float *memory = malloc(sizeof(float) * PANEL_MEMORY), change[PANEL_ROWS * PANEL_COLUMNS];
    uint32_t sums[PANEL_ROWS * PANEL_COLUMNS];
    if (lampest_begin(&panel, memory)) return 1;
    srand(1);
    for (int frame = 0; frame < 1500; frame++) {
        const int kind = rand() % 5, top = panel_constants.top_sum;
        const int common = rand() % (top + 1);
        for (unsigned cell = 0; cell < cells; cell++) {
            int sum = kind == 0 ? rand() % 65536 : kind == 1 ? rand() % (top + 1) : common;
            if (kind == 2) sum += rand() % 200 - 100;
            if (kind == 3 && rand() % 4 == 0) sum = rand() % 2 ? 0 : top;
            if (kind == 4 && rand() % 8 == 0) sum = rand() % (top + 1);
            sums[cell] = sum < 0 ? 0 : sum > 65535 ? 65535 : sum;
        }
        lampest_status s = rand() % 10 ? lampest_frame(&panel, sums, change)
                                       : lampest_baseline(&panel, sums);
        if (rand() % 4 == 0) lampest_follow(&panel);
        if (s.steps > panel_constants.steps) return 2;
        if (s.products > panel_constants.steps * (panel_constants.products + 4)) return 3;
        if (!isfinite(s.left)) return 4;
        for (unsigned cell = 0; cell < cells && frame; cell++)
            if (!isfinite(change[cell])) return 5;
        if (isnan(lampest_deviation(&panel, rand() % 256, rand() % 256, 5))) return 6;
        if (!(lampest_cell(&panel, 0, 0) > 0)) return 7;
    }
    free(memory);
    return 0;
}
"""


def sanitized(folder, case, program):
    """Run a program on the library with the constants of a case, under sanitizers."""
    (folder / "panel_constants.h").write_text(header(Constants.of(case), "panel", ()))
    (folder / "fuzz.c").write_text(program)
    flags = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    fuzz = built(folder, "fuzz.c", name="fuzz", flags=flags)
    return subprocess.run([str(fuzz)], capture_output=True, text=True)


@promise(
    "apps/microcontroller/microcontroller: No frame takes more work than its budget, and no "
    "output is NaN, whatever the codes are."
)
@pytest.mark.slow
@pytest.mark.parametrize(
    ("circuit", "cells"), [("two_point", None), ("grounded_one", None), ("loaded_columns", OVAL)]
)
def test_random_codes_never_give_nan_overruns_or_more_work_than_budgeted(circuit, cells, tmp_path):
    term = (
        lampest.RelativeChange(weight=0.01)
        if circuit == "grounded_one"
        else lampest.LogGradient(weight=1.0)
    )
    _, case = solved_case(scene_of(circuit, cells=cells), [NOISY, term])
    completed = sanitized(tmp_path, case, FUZZ)
    assert completed.returncode == 0, completed.stderr[:2000]


CONSTANTS_FUZZ = """
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "panel_constants.h"
#include "lampest_estimate.h"
enum { CELLS = PANEL_ROWS * PANEL_COLUMNS, LINES = PANEL_ROWS + PANEL_COLUMNS, CALLS = 12 };
static float arrays[8][CELLS + LINES];
/* A writable copy of an array of the constants, with one bad number if it is this array's turn. */
static const float *copied(int number, const float *values, int count, int turn, float bad) {
    if (!values) return NULL;
    memcpy(arrays[number], values, count * sizeof(float));
    if (number == turn) arrays[number][rand() % count] = bad;
    return arrays[number];
}
int main(void) {
    const float bads[] = {NAN,    INFINITY, -INFINITY, 0,    -1,   1e38f,
                          -1e38f, 1e-38f,   1e-45f,    1e9f, 1e-9f};
    static float memory[PANEL_MEMORY], change[CELLS];
    srand(7);
    for (int trial = 0; trial < 2000; trial++) {
        lampest_constants c = panel_constants;
        lampest_term term = c.terms[0];
        const int turn = rand() % 24;
        const int driven = c.rows_driven ? c.rows : c.columns, sensed = LINES - driven;
        const float bad = bads[rand() % (sizeof bads / sizeof *bads)];
        c.tie = copied(0, c.tie, LINES, turn, bad);
        c.series = copied(1, c.series, LINES, turn, bad);
        c.drive = copied(2, c.drive, driven, turn, bad);
        c.release = copied(3, c.release, driven, turn, bad);
        c.load = copied(4, c.load, sensed, turn, bad);
        c.gain = copied(5, c.gain, sensed, turn, bad);
        c.sigma_volt = copied(6, c.sigma_volt, c.sigma_count, turn, bad);
        c.baseline = copied(7, c.baseline, CELLS, turn, bad);
        c.follow = turn == 23 ? bad : c.follow;
        float *fields[] = {&c.volt_per_sum,  &c.volt_at_zero,  &c.supply_volt, &c.reference_ohm,
                           &c.ohm_scale,     &c.shunt_siemens, &c.plain_sigma, &c.data_corner,
                           &c.least_ohm,     &c.largest_ohm,   &c.loaded_limit, &c.within,
                           &term.weight,     &term.corner};
        if (turn >= 8 && turn < 22) *fields[turn - 8] = bad;
        if (turn == 22) {
            c.low_sum = rand() % 65536;
            c.high_sum = rand() % 65536;
            c.top_sum = rand() % 65536;
        }
        c.terms = &term;
        lampest_panel panel = {.constants = &c};
        memset(change, 0, sizeof change);
        lampest_begin(&panel, memory);
        for (int call = 0; call < CALLS; call++) {
            uint32_t sums[CELLS];
            for (int cell = 0; cell < CELLS; cell++)
                sums[cell] = rand() % (panel_constants.top_sum + 1);
            lampest_status s = call % 4 == 1 ? lampest_baseline(&panel, sums)
                                             : lampest_frame(&panel, sums, change);
            if (rand() % 2) lampest_follow(&panel);
            if (!isfinite(s.left)) return 2;
            if (s.products > c.steps * (c.products + 4)) return 3;
            for (int cell = 0; cell < CELLS; cell++)
                if (!isfinite(change[cell])) return 4;
            const unsigned row = rand() % PANEL_ROWS, column = rand() % PANEL_COLUMNS;
            if (isnan(lampest_deviation(&panel, row, column, 5))) return 5;
        }
    }
    return 0;
}
"""


@pytest.mark.slow
@pytest.mark.parametrize("circuit", ["two_point", "grounded_one"])
def test_wrong_constants_never_give_nan_overruns_or_more_work(circuit, tmp_path):
    loss = lampest.Student(corner=5.0)
    _, case = solved_case(
        scene_of(circuit), [NOISY, lampest.LogRatio(loss=loss, weight=1e-3)], error_bars=False
    )
    assert sanitized(tmp_path, case, CONSTANTS_FUZZ).returncode == 0


@pytest.mark.slow
def test_the_command_writes_a_sketch_and_prints_its_accuracy(lamprey, tmp_path):
    folder = tmp_path / "mat"
    words = ["export", str(lamprey[0]), "--to", "c", "--out", str(folder), "--milliseconds", "20"]
    completed = CliRunner().invoke(app, [*words, "--processor", "cortex-m4f"])
    assert completed.exit_code == 0, completed.output
    assert (folder / "mat.ino").is_file() and (folder / "lampest_estimate.h").is_file()
    assert "ends within 0.05 σ" in completed.output


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--within", "1e-9"], "no budget ends within"),
        (["--milliseconds", "0.1", "--processor", "esp32"], "the smallest takes"),
        (["--milliseconds", "1"], "--milliseconds needs --processor"),
        (["--milliseconds", "1", "--processor", "z80"], "'z80' is none of"),
        (["--estimator", "nobody"], "there are smooth"),
    ],
)
def test_impossible_requests_get_a_sentence_and_write_nothing(lamprey, tmp_path, options, sentence):
    words = ["export", str(lamprey[0]), "--to", "c", "--out", str(tmp_path / "mat"), *options]
    with pytest.raises(lampest.InputError, match=sentence):
        CliRunner().invoke(app, words, standalone_mode=False, catch_exceptions=False)
    assert not (tmp_path / "mat").exists()


@pytest.mark.parametrize(
    ("scene", "terms", "sentence"),
    [
        (
            scene_of("two_point"),
            [NOISY, lampest.TotalVariation(weight=1.0)],
            "no term 'total_variation'",
        ),
        (scene_of("two_point"), [NOISY, lampest.LogRatio(weight=1.0)], "no loss 'absolute'"),
        (
            scene_of("loaded_columns", diode=lampest.Diode()),
            [NOISY, lampest.LogGradient(weight=1.0)],
            "no diodes",
        ),
    ],
)
def test_methods_without_a_c_version_are_refused(scene, terms, sentence):
    _, case = solved_case(scene, terms)
    with pytest.raises(lampest.InputError, match=sentence):
        Constants.of(case)


def test_idle_lines_held_behind_a_drive_resistor_are_refused():
    with pytest.raises(lampest.InputError, match="hold at ground while they are idle"):
        CircuitLines.of(lampest.DrivenReadout(idle_ohm=0.0), (4, 4))


def test_inputs_without_a_resistor_are_refused():
    inputs = lampest.DrivenReadout(drive_ohm=45.0, idle_ohm=45.0, load_ohm=np.inf)
    with pytest.raises(lampest.InputError, match="prior of scales that no reading shows"):
        CircuitLines.of(inputs, (4, 4))


def test_milliseconds_are_a_range_of_cycles_of_the_manual():
    trade = Trade(Budget(2, 8, 0.0), 0.1, 0.1, 0.1, 1e6, 1.2e6)
    np.testing.assert_allclose(trade.milliseconds("cortex-m4f"), [16.0, 18.0])
    (row,) = table_of((trade,)).cells
    assert "16 to 18" in row


@pytest.mark.slow
def test_the_smallest_sufficient_budget_is_chosen(lamprey):
    _, case = lamprey
    constants = Constants.of(case)
    with compiled(constants) as host:
        table = trades(host, constants, case)
    most = 0.02
    exact, _ = chosen_budget(table, most, None, None)
    assert exact.median <= most
    assert all(
        trade.median > most for trade in table if trade.most_instructions < exact.most_instructions
    )
    limit_ms = 20.0
    fast, _ = chosen_budget(table, None, limit_ms, "cortex-m4f")
    assert fast.milliseconds("cortex-m4f")[1] <= limit_ms
    assert fast.median == min(
        trade.median for trade in table if trade.milliseconds("cortex-m4f")[1] <= limit_ms
    )


@pytest.mark.slow
def test_a_first_touch_is_within_a_standard_deviation_after_two_frames():
    """A rod that touches from one frame to the next."""
    estimate = lampest.reconstruct(lampest.datasets.load("rod"), formulation="reduced")
    case = unchecked_case(estimate, "smooth")
    constants = Constants.of(case)
    with compiled(constants) as host:
        table = trades(host, constants, case)
        trade, _ = chosen_budget(table, None, None, None)
        assert trade.median <= TWENTIETH
        sufficient = [trade for trade in table if trade.median <= TWENTIETH]
        cheapest = min(sufficient, key=lambda trade: trade.most_instructions)
        assert trade.touch <= MAX_TOUCH
        assert cheapest.touch > MAX_TOUCH
        sums = constants.sums_of(case)
        errors = []
        for frame in range(len(sums)):
            touched = host.frames(sums[[frame, frame]], trade.budget).log_change[1]
            optimum = np.log(case.cell_resistance[frame] / case.baseline_resistance)
            errors.append(np.sqrt(np.nanmean(((touched - optimum) / case.sigma_own[frame]) ** 2)))
    assert max(errors) < 1


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("g++") is None, reason="no C++ compiler")
def test_the_sketch_compiles_and_runs_on_the_computer(lamprey, tmp_path):
    folder = tmp_path / "mat"
    export_sketch(lamprey[0], folder)
    core = """
#include <cmath>
#include <cstdint>
#include <iostream>
#include <iomanip>
struct { void begin(long) {} template <class T> void print(T v, int = 0) { std::cout << v; }
         template <class T> void println(T v, int = 0) { std::cout << v << std::endl; } } Serial;
unsigned long micros() { return 0; }
"""
    (tmp_path / "main.cpp").write_text(
        f'{core}#include "{folder}/mat.ino"\nint main() {{ setup(); loop(); }}\n'
    )
    objects = []
    for path in folder.glob("*.c"):
        objects.append(str(tmp_path / f"{path.stem}.o"))
        subprocess.run(["gcc", "-std=c99", "-O2", "-c", str(path), "-o", objects[-1]], check=True)
    words = ["g++", "-std=c++11", "-O1", f"-I{folder}", str(tmp_path / "main.cpp"), *objects, "-lm"]
    subprocess.run([*words, "-o", str(tmp_path / "mat.out")], check=True)
    output = subprocess.run(
        [str(tmp_path / "mat.out")], capture_output=True, text=True, check=True
    ).stdout
    assert "as computed" in output and "NOT" not in output and "row " in output
