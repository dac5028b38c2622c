"""What a frame that follows another asks of its network: second derivatives once, and no point twice."""

import numpy as np
import pytest

from lampest.cost.problem import Evaluation
from lampest.estimate.sequence import first_stream
from lampest.panel.panel import Array
from lampest.solvers.hessian import Hessian
from lampest.solvers.multistart import best_solution
from lampest.solvers.preconditioners import Cholesky
from lampest.studies.bench import BenchFile


def counted(monkeypatch: pytest.MonkeyPatch, method: str, number: int) -> dict[str, int]:
    """How often the third frame of a recording evaluates the cost, multiplies by ∇²φ, and factors it."""
    bench = BenchFile(schema=1, sizes=(8,))
    recording = bench.recording((8, 8), number)
    readings, estimator = recording.readings(), bench.estimator(method, "reduced", (8, 8))
    stream = first_stream(recording, readings, estimator)
    first, second, third = recording.measured_frames()[:3]
    for frame in (first, second):
        stream, step = stream.push(readings[frame])
        assert step.solution.strict
    data, previous = stream.given(readings[third])
    solver = estimator.problem(stream.scene, len(data.measured), 1.0, partial=data.partial)
    solver.prepare()
    counts: dict[str, int] = {}
    watch(monkeypatch, counts)
    solution = best_solution(solver, data, previous, stream.prepared)
    assert solution.strict and solution.at is not None
    again = Evaluation(solution.at.cost, data, *evaluated(solution.at))
    assert np.isclose(again.objective, solution.objective, rtol=1e-13, atol=0)
    return counts


def evaluated(at: Evaluation) -> tuple[Array, Array, None]:
    networks = [at.data.network(frame, cells) for frame, cells in enumerate(at.cell_resistance)]
    return at.cell_resistance, np.stack([network.reading() for network in networks]), None


def watch(monkeypatch: pytest.MonkeyPatch, counts: dict[str, int]) -> None:
    for owner, name in ((Evaluation, "elsewhere"), (Hessian, "product"), (Cholesky, "of")):
        counts[name], usual = 0, getattr(owner, name)

        def called(*args: object, name: str = name, usual: object = usual) -> object:
            counts[name] += 1
            return usual(*args)  # type: ignore[operator]

        monkeypatch.setattr(owner, name, called)


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 1])
def test_second_derivatives_are_factored_once_and_serve(monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    counts = counted(monkeypatch, "LSR-gdCR", number)
    assert counts["of"] == 1
    assert counts["product"] <= 7  # 8 where ∇²φ is factored at the end alone
    assert counts["elsewhere"] <= 4  # 5 where the last point is evaluated again
