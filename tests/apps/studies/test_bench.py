"""The benchmark, random mats and the solvers that judge ours: scipy's and published ones."""

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from docs.studies.bench import SolverLimits, SolversFile, Trf, _Point
from docs.studies.bench_pages import MARKED, PAGES, sections, with_tables
from docs.studies.command_times import STUDY as COMMANDS
from docs.studies.command_times import CommandTime
from docs.studies.mats import OURS, PUBLISHED, Mats, solved_mats, table
from lampest import Huber, InputError, Misfit, Panel, Settings
from lampest.apps.studies.bench import (
    STUDY,
    Bench,
    BenchFile,
    BenchFrame,
    BenchLimits,
    bench_remarks,
    bench_rows,
    run_bench,
    sheets,
)
from lampest.apps.studies.common import StudyMethod, paper_methods
from lampest.apps.studies.study import page, read_settings
from lampest.cost.cost import Cost
from lampest.estimate.sequence import first_stream
from lampest.report.compare import screen_table
from lampest.runs.config import Terms
from lampest.solvers.multistart import evaluated

ROOT = Path(__file__).parents[3]
# gap to the least cost, of own solvers and of any verified one
SAME_COST = 1e-6
NEAR_COST = 1e-3
ROUNDING = 1e-12  # relative
# error of cells and readings, where solvers end without noise
CONVERGED = 1e-5
STOPPED = 1e-2
OF_NOISE = 0.1  # error of cells by 1 % of noise
read_bench = read_settings(SolversFile)
SOLVERS = SolverLimits().solvers
Frames = list[BenchFrame]
REDUCED_ALONE = BenchLimits(nodal=0)  # the reduced solver
LSM = {"LSM": paper_methods()["LSM"]}


def quiet(*step: object) -> None:
    """No progress."""


def timed(
    side: int, times: list[float], method: str = "LSM", solver: str = "reduced", number: int = 0
) -> Frames:
    """Frames in sequence that took so many s."""
    return [
        BenchFrame(
            rows=side,
            columns=side,
            recording=str(number),
            method=method,
            solver=solver,
            frame=frame,
            seconds=seconds,
            kind="later" if frame else "first",
            status="local optimum verified",
            objective=1.0,
            gap=0.0,
            iterations=1,
            solved=True,
            inverse_s=1e-6,
        )
        for frame, seconds in enumerate(times)
    ]


@pytest.mark.slow
def test_all_solvers_agree_on_solved_frames() -> None:
    """Ours, IPOPT and those of SciPy, on squares and on a panel that is none."""
    limits = SolverLimits(nodal=3, joint=3, scipy_exact=4, scipy_difference=3, scipy_lbfgsb=3)
    file = SolversFile(1, (3, (2, 4)), recordings=2, frames=2, repeats=2, limits=limits)
    tiny = run_bench(file, quiet)
    solvers = {(3, 3): SOLVERS, (2, 4): ("reduced", "scipy_exact")}
    assert {(frame.shape, frame.solver, frame.recording, frame.frame) for frame in tiny.frames} == {
        (shape, name, number, frame)
        for shape, names in solvers.items()
        for name, number, frame in product(names, "01", range(3))
    }
    for frame in tiny.frames:
        paired = frame.method in ("LSR-dCR", "LSR-gdCR") and frame.shape == (3, 3)
        first = "pair" if paired else "first"
        assert frame.kind == ("later" if frame.frame else first)
        if frame.solver in ("reduced", "nodal"):
            assert frame.solved and (not frame.frame or frame.gap < SAME_COST), frame
        assert not frame.verified or 0 <= frame.gap < NEAR_COST, frame


@pytest.mark.slow
def test_the_gap_refers_to_the_lowest_objective_of_several_solvers(tmp_path: Path) -> None:
    file = BenchFile(1, (3,), LSM, frames=1, repeats=1)
    frames = run_bench(file, quiet).frames
    names = BenchLimits().solvers
    assert [(entry.solver, entry.frame) for entry in frames] == [
        (name, frame) for frame in (0, 1) for name in names
    ]
    for first, second in (frames[:2], frames[2:]):
        assert min(first.gap, second.gap) == 0 and (first.gap < second.gap) == (
            first.objective < second.objective
        )
    hasty = BenchFile(
        1, (3,), frames=1, repeats=1, limits=REDUCED_ALONE, solver=Settings(max_iterations=1)
    )
    rows = bench_rows(run_bench(hasty, quiet).frames)
    assert {(row.solver, row.gap) for row in rows} == {("reduced", None)}
    assert any(row.solved < row.count for row in rows)
    with pytest.raises(InputError):
        read_bench(tmp_path / "missing.yaml")
    with pytest.raises(ValueError, match="only squared losses"):
        SolversFile(1, (3,), {"robust": StudyMethod(Terms(misfit=Misfit(loss=Huber(corner=1.0))))})


def test_pages_show_tables_that_the_bench_writes() -> None:
    two_sizes = Bench(
        read_bench(ROOT / "configs" / "bench.yaml"),
        (*timed(32, [1.0, 1.0]), *timed(64, [1.0, 1.0])),
    )
    commands = [CommandTime("run", 10, 10, 3.0, 1.5, 0.5)]
    tables = [
        (title, screen_table(rows, columns))
        for title, rows, columns in (*sheets(two_sizes), *COMMANDS.sheets(commands))
    ]
    written = sections(page(STUDY.name, tables, bench_remarks(two_sizes)))
    assert all(
        text.startswith("- " if name == "remarks" else "| ") for name, text in written.items()
    )
    marks = [mark for path in PAGES for mark in MARKED.findall(path.read_text(encoding="utf-8"))]
    assert marks and set(marks) <= set(written)
    assert "| run | 10 × 10 | 3.00 | 1.50 | 0.50 | 6 |" in written["commands"]
    text = (
        "before\n<!-- bench: methods -->\nold\n<!-- /bench -->\nafter <!-- bench: unknown "
        "-->\n<!-- /bench -->\n"
    )
    assert with_tables(text, {"methods": "| new |\n"}) == text.replace("old", "\n| new |\n")


@pytest.mark.parametrize("method", BenchFile(1, (3,)).estimators)
@pytest.mark.parametrize("joint", [False, True], ids=["single", "joint"])
def test_the_jacobian_is_that_of_the_residuals_of_the_cost(method: str, joint: bool) -> None:
    bench = BenchFile(1, ((3, 4),), limits=BenchLimits(joint=4 if joint else 0))
    recording = bench.recording((3, 4))
    readings = recording.readings()
    stream = first_stream(recording, readings, bench.estimator(method, "reduced", (3, 4)))
    data, _ = stream.data_and_start(readings[recording.measured_frames()[0]])
    cost = Cost(Panel(3, 4), bench.estimators[method].parts, len(data.measured))
    point = _Point(Trf(cost, Settings(), "exact"), data, 1.0)
    position = np.log(1.3 * data.measured).ravel()
    evaluation = evaluated(cost, data, np.exp(position).reshape(data.measured.shape))
    assert np.sum(point.residuals(position) ** 2) == pytest.approx(
        evaluation.objective, rel=ROUNDING
    )
    step = 1e-6 * np.eye(len(position))
    differences = [
        (point.residuals(position + e) - point.residuals(position - e)) / 2e-6 for e in step
    ]
    jacobian = point.jacobian(position)
    np.testing.assert_allclose(
        jacobian, np.transpose(differences), atol=1e-6 * np.abs(jacobian).max()
    )


@pytest.mark.parametrize("name", ["bench", "bench_large"])
def test_shipped_benchmarks_are_valid(name: str) -> None:
    bench = read_bench(ROOT / "configs" / f"{name}.yaml")
    assert list(bench.estimators) == ["LSM", "LSR-CR", "LSR-dCR", "LSR-gCR", "LSR-gdCR"]
    assert {(10, 10), (16, 16), (32, 32)} <= set(bench.shapes)
    assert bench.solvers((10, 10)) == SOLVERS
    assert bench.solvers((200, 200)) == ("reduced",)
    assert replace(bench, readout=BenchFile(1, (3,)).readout) == bench


def test_the_table_compares_both_packages_on_the_same_mats() -> None:
    solves = list(
        solved_mats(Mats(sides=(6,), draws=1, noise_percent=(0, 1)), seed=3, settings=Settings())
    )
    assert [(solve.noise_percent, solve.solver) for solve in solves] == [
        *product((0, 1), (*OURS, *PUBLISHED))
    ]
    for solve in solves:
        assert (
            solve.seconds > 0 and solve.inverse_s > 0 and solve.cell_error <= solve.worst_cell_error
        )
        assert (solve.evaluations is None) == (solve.solver in OURS)
        if solve.noise_percent == 0:
            assert solve.converged and solve.negative == 0 and solve.reading_error < STOPPED
            assert solve.cell_error < (STOPPED if solve.solver == "krylov" else CONVERGED), solve
    noisy = [solve.cell_error for solve in solves if solve.noise_percent]
    assert min(noisy) > OF_NOISE, "what noise leaves of the cells is the same for all that end"
    np.testing.assert_allclose(noisy, noisy[0], rtol=3 * OF_NOISE)
    lines = table(solves).splitlines()
    assert len(lines) == 2 + 2 * 6 and lines[2].startswith("| 6 × 6 | 0 % | reduced |")
