"""Frames that depend on no earlier one are solved in segments, which workers share."""

import dataclasses
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from promises import promise

import lampest
from lampest import CaseResult, read_results
from lampest.estimate.sequence import SEGMENT_FRAMES, begun, reconstruct, segments
from lampest.files.errors import InputError
from lampest.inference.prepared import Prepared
from lampest.runs import batch, config
from lampest.runs.batch import Report, run_batch
from lampest.runs.config import Run, read_run
from lampest.runs.executors import Dask, Executor, Processes, Serial
from lampest.runs.task import CaseSegment

FRAMES = 2 * SEGMENT_FRAMES + 11  # measured ones, of three segments
SMOOTH = "estimators: {smooth: {terms: {misfit: {weighting: noise}, log_gradient: {}}}}\n"
FEW_CHANGES = SMOOTH.replace("log_gradient", "log_ratio")
USUAL_SECONDS = config.MIN_DIVIDED_SECONDS
TIMES = ("solve_time", "baseline_solve_time", "error_bar_time")


@pytest.fixture
def long(disk: SimpleNamespace, monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Return a folder with a recording of three segments, of which each is worth a task."""
    monkeypatch.setattr(config, "MIN_DIVIDED_SECONDS", 0.0)
    rod = lampest.Rod(centre_mm=(10, 15), diameter_mm=15, mass_g=100)
    scene = lampest.Scene(lampest.Panel(3, 4), lampest.TwoPointReadout(), 140.0)
    simulation = lampest.Simulation(1, 1, scene, baseline_frames=4, frames=FRAMES, loads=(rod,))
    lampest.simulate(simulation, "long").save(disk.folder / "long.h5")
    return disk


def long_run(disk: SimpleNamespace, estimators: str = SMOOTH, further: str = "") -> Run:
    """Return the run of the long recording."""
    path = disk.folder / "long.yaml"
    path.write_text(
        f"schema: 1\nrecordings: [long.h5]\nformulation: reduced\n{estimators}{further}"
    )
    return read_run(path)


def differing(first: Report, second: Report) -> list[str]:
    """Return the fields in which the cases of two runs differ, besides times."""
    assert first.results is not None and second.results is not None
    pairs = zip(*(read_results(each.results).cases for each in (first, second)), strict=True)
    names = [part.name for part in dataclasses.fields(CaseResult) if part.name not in TIMES]
    return [name for one, other in pairs for name in names if not _equal(one, other, name)]


def _equal(one: CaseResult, other: CaseResult, name: str) -> bool:
    try:
        np.testing.assert_equal(getattr(one, name), getattr(other, name))
    except AssertionError:
        return False
    return True


@pytest.mark.slow
@pytest.mark.exact
@promise("howto/batches: Segments are solved by several workers")
@pytest.mark.parametrize(
    ("executor", "estimators"),
    [(Processes(2), SMOOTH), (Dask(workers=2), SMOOTH), (Processes(2), FEW_CHANGES)],
)
def test_workers_that_share_a_recording_change_no_number(
    executor: Executor, estimators: str, long: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = long_run(long, estimators)
    [case] = run.cases
    assert case.segments == 3 and run_batch(run, long.folder / "whole", Serial()).done == 1
    whole = Report(long.folder / "whole" / batch.RESULTS, 1, 0, ())
    shared: list[Any] = []
    results = type(executor).results

    def noted(self: Executor, function: Any, arguments: Sequence[Any]) -> Any:
        shared.extend(arguments)
        return results(self, function, arguments)

    monkeypatch.setattr(type(executor), "results", noted)
    report = run_batch(run, long.folder / "shared", executor)
    assert [task.number for task in shared if isinstance(task, CaseSegment)] == [0, 1, 2]
    assert differing(whole, report) == []
    assert not list((long.folder / "shared" / "cases").glob(".*")), "what counts frames is removed"


@pytest.mark.slow
def test_a_segment_depends_on_no_frame_before_it(long: SimpleNamespace) -> None:
    recording = lampest.Recording.load(long.folder / "long.h5")
    [case] = long_run(long).cases
    whole = reconstruct(recording, case.estimator)
    stream, frames = begun(Prepared(recording), case.estimator)
    first, second, third = segments(stream, FRAMES)
    assert (first.start, third.stop) == (0, FRAMES) and second.start == first.stop
    alone = [step.cell_resistance for _, step in frames.segment_steps(stream, second)]
    np.testing.assert_array_equal(alone, whole.cell_resistance[second.start : second.stop])


@pytest.mark.parametrize(
    ("estimators", "seconds", "count"),
    [
        (SMOOTH, 0.0, 3),
        (SMOOTH, 2.0, 1),
        (FEW_CHANGES, 0.0, 3),
        (SMOOTH.replace("log_gradient: {}", "log_ratio: {reference: previous}"), 0.0, 1),
        (SMOOTH.replace("terms:", "formulation: linearised, terms:"), 0.0, 1),
    ],
    ids=["long", "brief", "unloaded", "relative", "approximate"],
)
def test_a_case_is_divided_where_frames_are_independent_and_take_long(
    estimators: str,
    seconds: float,
    count: int,
    long: SimpleNamespace,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(config, "MIN_DIVIDED_SECONDS", seconds)
    [case] = long_run(long, estimators).cases
    assert case.segments == count


@pytest.mark.parametrize(("seconds", "count"), [(0.0, 6), (2.0, 1)])
def test_cases_that_end_before_processes_have_started_are_one_task(
    seconds: float, count: int, long: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(config, "MIN_DIVIDED_SECONDS", seconds)
    twice = SMOOTH.replace("}}}}", "}}}, again: {terms: {misfit: {}, log_gradient: {}}}}")
    assert long_run(long, twice).tasks == count


@promise("howto/batches: 100 frames of 10 × 10")
def test_100_frames_of_10_by_10_are_divided(long: SimpleNamespace) -> None:
    [case] = long_run(long).cases
    sizes = {frames: dataclasses.replace(case, frames=frames, cells=100) for frames in (99, 100)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(config, "MIN_DIVIDED_SECONDS", USUAL_SECONDS)
        assert {frames: sized.segments for frames, sized in sizes.items()} == {99: 1, 100: 2}


class Interrupted(Serial):
    """Is interrupted after two tasks, although it could do several at a time."""

    @property
    def concurrent(self) -> bool:
        """Whether several calls may go on at the same time."""
        return True

    def results(self, function: Any, arguments: Sequence[Any]) -> Any:
        """Yield two results, then raise."""
        yield from super().results(function, arguments[:2])
        raise KeyboardInterrupt


def test_an_interrupt_keeps_the_first_finished_segments(long: SimpleNamespace) -> None:
    with pytest.raises(KeyboardInterrupt):
        run_batch(long_run(long), long.folder / "out", Interrupted())
    [case] = read_results(long.folder / "out" / batch.RESULTS).cases
    count = 2 * FRAMES // 3
    assert case.solved[:count].all() and np.isnan(case.cell_resistance[count:]).all()
    assert set(case.status[count:]) == {"the run was broken off before this frame"}


@pytest.mark.slow
def test_a_segment_that_fails_fails_its_case_once(
    long: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    solve = batch.solve_task

    def failing(task: Any) -> Any:
        if isinstance(task, CaseSegment) and task.number == 1:
            raise InputError("no memory is left")
        return solve(task)

    class Several(Interrupted):
        def results(self, function: Any, arguments: Sequence[Any]) -> Any:
            yield from Serial().results(function, arguments)

    monkeypatch.setattr(batch, "solve_task", failing)
    report = run_batch(long_run(long), long.folder / "out", Several())
    assert report.failed == (("long × smooth", "no memory is left"),) and report.done == 0
