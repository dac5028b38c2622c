"""The benchmark: its rows, and scipy's solver as a judge of ours. No time is asserted."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from lampest.cost.cost import Cost
from lampest.cost.losses import Huber
from lampest.cost.terms.misfit import Misfit
from lampest.files.errors import InputError
from lampest.panel.panel import Panel
from lampest.solvers.search import evaluated
from lampest.solvers.solution import Settings
from lampest.studies.bench.problems import frame_data, resting_cells
from lampest.studies.bench.report import bench_rows, growth
from lampest.studies.bench.run import Bench, Timing, run_bench
from lampest.studies.bench.settings import SOLVERS, BenchFile, SquaredMethod, Terms, read_bench
from lampest.studies.bench.trf import Trf, _Point

ROOT = Path(__file__).parents[2]
Command = Callable[..., SimpleNamespace]
TINY = """\
schema: 1
sizes: [3, [2, 4]]
frames: 2
repeats: 2
limits: {nodal: 3, scipy_exact: 4, scipy_difference: 3, joint: 3}
"""


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    path = tmp_path_factory.mktemp("bench") / "tiny.yaml"
    path.write_text(TINY)
    return run_bench(read_bench(path))


def test_all_solvers_agree_where_they_say_they_solved(tiny: Bench) -> None:
    assert {(timing.shape, timing.solver) for timing in tiny.timings} == {
        *(((3, 3), solver) for solver in SOLVERS),
        *(((2, 4), solver) for solver in ("reduced", "scipy_exact")),
    }
    for timing in tiny.timings:
        assert timing.wall.shape == timing.cpu.shape == (3, 2)
        assert np.isnan(timing.wall[0, 1]) and np.isfinite(timing.wall[1:]).all()
        assert timing.times().shape == (3,) and np.all(timing.times() > 0)
        assert np.all(timing.gap >= 0)
        if timing.solver != "scipy_difference":
            assert timing.solved.all(), timing
        if timing.solver in ("reduced", "nodal"):
            assert np.all(timing.gap[1:] < 1e-6), timing
    assert all(seconds > 0 for seconds in tiny.inverse_s.values())


def test_rows_are_ratios_of_medians(tiny: Bench) -> None:
    found = {(row.rows, row.columns, row.method, row.solver): row for row in bench_rows(tiny)}
    assert len(found) == 6 * (4 + 2)
    for (high, wide, method, _), row in found.items():
        reduced = found[high, wide, method, "reduced"]
        assert row.ratio == pytest.approx(row.frame_ms / reduced.frame_ms)
        assert row.inverses == pytest.approx(row.frame_ms / 1e3 / tiny.inverse_s[high, wide])
        assert row.frames == (15 if method == "all" else 3)
    assert growth(tiny) == {}


def test_growth_is_the_slope_of_the_logarithms() -> None:
    def timing(side: int) -> Timing:
        wall = np.full((2, 1), 1e-6 * (2 * side) ** 3.3)
        one = np.ones(2)
        return Timing((side, side), "LSM", "reduced", wall, wall, one, 0 * one, one.astype(int), one > 0, ("", ""))

    sides = (16, 32, 64, 100)
    found = growth(Bench(tuple(timing(side) for side in sides), {(side, side): 1.0 for side in sides}, {}))
    assert found == {"all": pytest.approx(3.3), "LSM": pytest.approx(3.3)}


@pytest.mark.parametrize("method", BenchFile(1, (3,)).estimators)
@pytest.mark.parametrize("joint", [False, True], ids=["single", "joint"])
def test_jacobian_is_that_of_the_residuals_and_they_are_the_cost(method: str, joint: bool) -> None:
    bench = BenchFile(1, ((3, 4),))
    recording = bench.recording((3, 4))
    previous = None if joint else resting_cells(bench, recording, method)
    data = frame_data(bench, recording, method, 0, previous)()
    cost = Cost(Panel(3, 4), bench.estimators[method].parts, len(data.measured))
    point = _Point(Trf(cost, Settings(), "exact"), data, 1.0)
    position = np.log(1.3 * data.measured).ravel()
    here = evaluated(cost, data, np.exp(position).reshape(data.measured.shape))
    assert np.sum(point.residuals(position) ** 2) == pytest.approx(here.objective, rel=1e-12)
    step = 1e-6 * np.eye(len(position))
    differences = [(point.residuals(position + e) - point.residuals(position - e)) / 2e-6 for e in step]
    jacobian = point.jacobian(position)
    np.testing.assert_allclose(jacobian, np.transpose(differences), atol=1e-6 * np.abs(jacobian).max())


def test_least_squares_needs_squares() -> None:
    with pytest.raises(ValueError, match="only squared losses"):
        SquaredMethod(Terms(misfit=Misfit(loss=Huber(corner=1.0))))


@pytest.mark.parametrize("name", ["bench", "bench_large"])
def test_shipped_benchmarks_are_in_order(name: str) -> None:
    bench = read_bench(ROOT / "configs" / f"{name}.yaml")
    assert list(bench.estimators) == ["LSM", "LSR-CR", "LSR-dCR", "LSR-gCR", "LSR-gdCR"]
    assert {(10, 10), (32, 32), (100, 100)} <= set(bench.shapes)
    assert bench.solvers((10, 10)) == SOLVERS
    assert bench.solvers((100, 100)) == ("reduced",)
    assert replace(bench, readout=BenchFile(1, (3,)).readout) == bench


def test_unsolved_runs_are_told(tmp_path: Path) -> None:
    bench = BenchFile(1, (3,), frames=1, repeats=1, solver=Settings(max_iterations=1))
    found = bench_rows(run_bench(bench))
    assert any(row.failed for row in found)
    with pytest.raises(InputError):
        read_bench(tmp_path / "missing.yaml")
