"""`lampest export --to c`: a folder with a sketch that estimates on the board."""

from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from lampest.apps.microcontroller.constants import Budget, Constants, Sums
from lampest.apps.microcontroller.header import header, number
from lampest.apps.microcontroller.host import compiled, compiler
from lampest.apps.microcontroller.library import library_version, sources
from lampest.apps.microcontroller.trade import PROCESSORS, Trades, chosen_budget, trades
from lampest.files.errors import InputError
from lampest.files.typed import typed
from lampest.files.whole import output_folder, refuse_inputs, sparing, whole_file
from lampest.panel.panel import Array
from lampest.runs.case import CaseResult
from lampest.runs.results import read_results

Notes = tuple[str, ...]
VECTOR_FRAMES = 6  # of the test vector: 600 bytes of flash each at 10 × 10
SAME = 1e-5  # ln r: largest difference of the same arithmetic on two processors
SKETCH = """\
/* Estimates the cells of a resistive matrix on the board; written by `lampest export --to c`.
 *
 * The test vector shows that the board computes what the computer did. Then each frame's strongest change is printed.
 * Put your own scan into `read_sums`; as it stands it repeats the frames of the test vector.
 */
#include "panel_constants.h"
#include "test_vector.h"

static lampest_panel panel = {&panel_constants};
static float memory[PANEL_MEMORY];
static float change[PANEL_ROWS * PANEL_COLUMNS];
static uint32_t sums[PANEL_ROWS * PANEL_COLUMNS];

/* Sums of codes, row by row: PANEL_READINGS conversions of each cell. LAMPEST_MISSING where there is none. */
static void read_sums() {
    static uint8_t frame = 0;
    for (uint16_t cell = 0; cell < PANEL_ROWS * PANEL_COLUMNS; ++cell) sums[cell] = vector_sums[frame][cell];
    frame = (frame + 1) % VECTOR_FRAMES;
}

static void check() {
    float largest = 0;
    for (uint8_t frame = 0; frame < VECTOR_FRAMES; ++frame) {
        const unsigned long start = micros();
        const lampest_status status = lampest_frame(&panel, vector_sums[frame], change);
        const unsigned long spent = micros() - start;
        for (uint16_t cell = 0; cell < PANEL_ROWS * PANEL_COLUMNS; ++cell) {
            const float off = fabs(change[cell] - vector_log_change[frame][cell]);
            if (!(off <= largest)) largest = off;
        }
        Serial.print("frame ");
        Serial.print(frame);
        Serial.print(status.settled ? ": settled, " : ": not settled, ");
        Serial.print(spent);
        Serial.println(" us");
    }
    Serial.print("largest difference from the computer, ln r: ");
    Serial.println(largest, 7);
    Serial.println(largest <= VECTOR_TOLERANCE ? "as computed" : "NOT as computed");
}

void setup() {
    Serial.begin(115200);
    if (lampest_begin(&panel, memory) != LAMPEST_FINE) Serial.println("the constants are not sound");
    check();
    lampest_begin(&panel, memory);
    /* With nothing on the panel: read_sums(); lampest_baseline(&panel, sums); as often as you like. */
}

void loop() {
    read_sums();
    const lampest_status status = lampest_frame(&panel, sums, change);
    if (status.outcome != LAMPEST_FINE) return;
    uint16_t strongest = 0;
    for (uint16_t cell = 1; cell < PANEL_ROWS * PANEL_COLUMNS; ++cell) {
        if (change[cell] < change[strongest]) strongest = cell;
    }
    Serial.print("row ");
    Serial.print(strongest / PANEL_COLUMNS);
    Serial.print(", column ");
    Serial.print(strongest % PANEL_COLUMNS);
    Serial.print(": ");
    Serial.print(100 * (exp(change[strongest]) - 1), 1);
    Serial.println(" %");
}
"""  # noqa: E501


@dataclass(frozen=True)
class Sketch:
    """A folder that was written.

    Attributes
    ----------
    files : tuple of Path
    about : tuple of str
        Sentences on the estimator and its effort.
    table : tuple of Trade
        Accuracy of each budget; empty without a C compiler or error bars.
    budget : Budget
        The chosen one.
    notes : tuple of str
    """

    files: tuple[Path, ...]
    about: Notes
    table: Trades
    budget: Budget
    notes: Notes


@dataclass(frozen=True)
class Wishes:
    """A user's requests for the budget, see `trade.chosen_budget`.

    Raises InputError for an unknown processor.
    """

    within: float | None = None
    milliseconds: float | None = None
    processor: str | None = None

    def __post_init__(self) -> None:
        if self.processor is not None and self.processor not in PROCESSORS:
            raise InputError(f"--processor: {self.processor!r} is none of {', '.join(PROCESSORS)}")
        if self.processor is not None and self.milliseconds is None:
            raise InputError(
                "--processor belongs to --milliseconds, the longest time of a frame on it"
            )


@typed
def export_sketch(
    results: str | Path,
    out: str | Path | None = None,
    recording: str | None = None,
    estimator: str | None = None,
    wishes: Wishes | None = None,
) -> Sketch:
    """Write the estimator of a results file as a sketch for a microcontroller.

    Parameters
    ----------
    results : path
        The results file.
    out : path, optional
        The folder, which also names the sketch; by default `panel_sketch` beside the results.
    recording, estimator : str, optional
        The case; by default the first one.
    wishes : Wishes, optional
        Criteria for the choice of the budget.

    Raises
    ------
    InputError
        For an unknown case, a term, loss or circuit that C does not have, or wishes that no budget
        meets.
    """
    source = Path(results)
    wishes = wishes or Wishes()
    folder = source.with_name("panel_sketch") if out is None else Path(out)
    with sparing((source,)), ExitStack() as files:
        case = _case_of(source, recording, estimator)
        table, constants, vector, notes = _measured(Constants.of(case), case, wishes)
        budget = constants.budget
        about = (
            f"{case.recording} × {case.estimator}: {constants.scene.circuit.description()}",
            f"budget of a frame: {budget.steps} steps × {budget.products} products, "
            f"ends within {budget.within:g} σ",
        )
        # The sketch is the last one that gets its name, and an old one goes before the first does:
        # a folder with a sketch is whole, also where the command is killed meanwhile.
        sketch = f"{folder.name}.ino"
        contents = {
            sketch: SKETCH,
            "panel_constants.h": _panel_header(constants, about),
            "test_vector.h": vector,
        } | {path.name: path.read_text(encoding="utf-8") for path in sources()}
        output_folder(folder)
        written = tuple(folder / name for name in contents)
        refuse_inputs(written)
        for path, content in zip(written, contents.values(), strict=True):
            files.enter_context(whole_file(path)).write_text(content, encoding="utf-8")
        (folder / sketch).unlink(missing_ok=True)
    return Sketch(written, about, table, budget, notes)


def _panel_header(constants: Constants, about: Notes) -> str:
    """Return the constants as a header in C, with the number of readings in each sum."""
    head = (
        "Constants of an estimator, "
        f"written by `lampest export --to c` of lampest {version('lampest')}",
        f"for version {library_version()} of lampest_estimate.",
        *about,
    )
    readings = f"#define PANEL_READINGS {constants.scene.circuit.readings}\n\nstatic const"
    return header(constants, "panel", head).replace("static const", readings, 1)


def _case_of(source: Path, recording: str | None, estimator: str | None) -> CaseResult:
    """Return the case of these names, or the first. Raises InputError where there is none."""
    read = read_results(source)
    cases = read.cases if recording is None else read.of(recording)
    if estimator is not None:
        cases = tuple(case for case in cases if case.estimator == estimator)
    if not cases:
        estimators = ", ".join(read.estimators())
        raise InputError(
            f"{source}: holds no case of the estimator {estimator!r}; there are {estimators}"
        )
    return cases[0]


def _measured(
    constants: Constants, case: CaseResult, wishes: Wishes
) -> tuple[Trades, Constants, str, Notes]:
    """Measure the budgets on the first frames of a case, and choose one.

    Without a C compiler the budget is the usual one, and the vector holds the optimum.

    Returns
    -------
    table : tuple of Trade
        Accuracy of each budget; empty without a C compiler or error bars.
    constants : Constants
        Constants with the chosen budget.
    vector : str
        Test vector as a header.
    notes : tuple of str
    """
    sums = constants.sums_of(case)[:VECTOR_FRAMES]
    any_wish = wishes != Wishes()
    if compiler() is None:
        if any_wish:
            raise InputError(
                "--within and --milliseconds need a C compiler here "
                "(cc, gcc or clang), to measure budgets"
            )
        with np.errstate(invalid="ignore", divide="ignore"):
            optimum = np.nan_to_num(
                np.log(case.cell_resistance / case.baseline_resistance)[:VECTOR_FRAMES]
            )
        note = (
            "no C compiler here (cc, gcc or clang): "
            "budgets are not measured, the usual one is taken"
        )
        return (), constants, _vector(sums, optimum, 0.1), (note,)
    table: Trades = ()
    with compiled(constants) as host:
        notes: Notes = (f"working memory {host.bytes / 1000:.1f} kB",)
        if case.sigma_own is None and not any_wish:
            note = (
                "these results have no error bars, the unit of deviations: "
                "the usual budget is taken"
            )
            notes = (note, *notes)
        else:
            table = trades(host, constants, case)
            trade, aim = chosen_budget(table, wishes.within, wishes.milliseconds, wishes.processor)
            constants = constants.within(replace(trade.budget, within=aim))
        answers = host.frames(sums, constants.budget).log_change
    return table, constants, _vector(sums, answers, SAME), notes


def _vector(sums: Sums, changes: Array, tolerance: float) -> str:
    """Return the test vector as a header."""

    def rows(values: Iterable[Iterable[str]]) -> str:
        return ",\n".join("    {" + ", ".join(line) + "}" for line in values)

    cells = sums[0].size
    codes = rows(map(str, frame.ravel()) for frame in sums)
    answers = rows((number(float(value)) for value in frame.ravel()) for frame in changes)
    return (
        "/* Frames of the recording, and the log changes that the computer found for them, "
        "from the baseline on. */\n"
        "#ifndef TEST_VECTOR_H\n#define TEST_VECTOR_H\n\n#include <stdint.h>\n\n"
        f"#define VECTOR_FRAMES {len(sums)}\n"
        f"#define VECTOR_TOLERANCE {number(tolerance)} /* ln r */\n\n"
        f"static const uint32_t vector_sums[{len(sums)}][{cells}] = {{\n{codes}}};\n\n"
        f"static const float vector_log_change[{len(sums)}][{cells}] = {{\n{answers}}};\n\n#endif\n"
    )
