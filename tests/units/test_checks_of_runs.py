"""A run checks the circuit of a recording once, after its estimates, and keeps the outcome."""

import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from promises import promise

import lampest
from lampest.apps.recognition.detect.detection import answer_recording, detect_recording
from lampest.audit.health import Health
from lampest.report.info import describe
from lampest.runs import batch, checks
from lampest.runs.batch import Report, run_batch
from lampest.runs.checks import BESIDE, NOT_CHECKED, CheckTask, RecordingCheck
from lampest.runs.config import read_run
from lampest.runs.executors import Serial
from lampest.runs.provenance import digest
from lampest.runs.results import read_results

RUN = """
schema: 1
recordings: [mine.h5]
estimators:
  LSM: {terms: {misfit: {}}}
  smooth: {terms: {misfit: {}, log_gradient: {weight: 1}}}
formulation: reduced
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a recording of 4 × 4 cells and its run file."""
    scene = lampest.Scene(lampest.Panel(4, 4, 10.0), lampest.TwoPointReadout())
    load = lampest.Rod(centre_mm=(15.0, 15.0), diameter_mm=15, mass_g=400)
    recording = lampest.simulate(lampest.Simulation(1, 2, scene, frames=3, loads=(load,)))
    recording.save(tmp_path / "mine.h5")
    (tmp_path / "run.yaml").write_text(RUN)
    return tmp_path


@pytest.fixture
def checked(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the list of recordings that are checked from now on."""
    names: list[str] = []
    of = RecordingCheck.of

    def counted(audit: Any) -> RecordingCheck:
        names.append(audit.prepared.recording.name)
        return of(audit)

    monkeypatch.setattr(RecordingCheck, "of", counted)
    return names


@pytest.fixture
def looks(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return the list of recordings at whose health is looked from now on."""
    recordings: list[Any] = []
    of = Health.of
    monkeypatch.setattr(
        Health, "of", lambda recording: recordings.append(recording) or of(recording)
    )
    return recordings


@pytest.fixture
def unchecked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a check fail when it is reached."""

    def refused(prepared: Any) -> None:
        raise AssertionError("checked")

    monkeypatch.setattr(lampest.inference.prepared.Prepared, "check", property(refused))


def run(folder: Path, text: str = RUN, **options: Any) -> Report:
    """Run the file of a folder with this text."""
    (folder / "run.yaml").write_text(text)
    return run_batch(read_run(folder / "run.yaml"), folder / "out", Serial(), **options)


@pytest.mark.slow
def test_all_estimators_share_one_check_which_is_that_of_reconstruct(
    folder: Path, checked: list[str]
) -> None:
    run(folder)
    assert checked == ["mine"]
    estimate = lampest.reconstruct(lampest.Recording.load(folder / "mine.h5"), [lampest.Misfit()])
    for case in read_results(folder / "out" / "results.h5").cases:
        assert case.model_mark == estimate.model_check.mark
        assert case.model_sentence == estimate.model_check.sentence
        assert case.advice == "\n".join(estimate.advice)
        assert sorted(filter(None, case.warnings.split("\n"))) == sorted(estimate.checks)


@pytest.mark.slow
def test_a_recording_that_has_not_changed_is_not_checked_again(
    folder: Path, checked: list[str]
) -> None:
    run(folder)
    before = read_results(folder / "out" / "results.h5").cases[0]
    run(folder, RUN.replace("weight: 1", "weight: 2"))
    assert checked == ["mine"]
    after = read_results(folder / "out" / "results.h5").cases
    assert {case.model_sentence for case in after} == {before.model_sentence}
    assert {case.warnings for case in after} == {before.warnings}
    run(folder, fresh=True)
    assert checked == ["mine", "mine"]


def test_checks_come_after_all_estimates_and_count_as_a_step_of_their_own(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    order: list[str] = []
    solve = batch.solve_task

    def noted(task: Any) -> Any:
        order.append(type(task).__name__)
        return solve(task)

    monkeypatch.setattr(batch, "solve_task", noted)
    frames: list[tuple[int, int]] = []
    steps: list[tuple[int, int]] = []
    run(
        folder,
        on_frames=lambda *numbers, left_s: frames.append(numbers),
        on_checks=lambda *numbers: steps.append(numbers),
    )
    assert order == ["Task", "Task", "CheckTask"]
    measured = len(lampest.Recording.load(folder / "mine.h5").measured_frames())
    assert frames[0] == (0, 2 * measured) and frames[-1] == (2 * measured, 2 * measured)
    assert steps == [(0, 1), (1, 1)]  # what is left shows from the beginning


def test_a_run_without_checks_says_so_and_computes_none(folder: Path, unchecked: None) -> None:
    report = run(folder, f"{RUN}check: none\n")
    assert [line for line in report.warnings if "not checked" in line] == [
        "mine: the circuit was not checked: the run leaves it out"
    ]
    for case in read_results(folder / "out" / "results.h5").cases:
        assert case.model_mark == NOT_CHECKED
        assert "not checked" in case.model_sentence
        assert not case.advice


@pytest.fixture
def described(folder: Path, monkeypatch: pytest.MonkeyPatch, unchecked: None) -> Iterator[str]:
    """Return the lines of `info`."""
    monkeypatch.chdir(folder)
    return describe("mine.h5")


@promise("theory/model_check: their answer comes first")
def test_info_prints_its_answer_before_the_verdict(described: Iterator[str]) -> None:
    lines: list[str] = []
    with pytest.raises(AssertionError, match="checked"):
        for line in described:
            lines.append(line)
    heads = {line.split(" ")[0] for line in lines}
    assert {"frames", "readout", "health", "noise", "readings", "besides", "falls"} <= heads
    assert "model" not in heads


def test_info_and_detect_read_the_check_that_a_run_has_kept(
    folder: Path, monkeypatch: pytest.MonkeyPatch, described: Iterator[str]
) -> None:
    warned = "a warning of the check"
    stored = RecordingCheck(
        "no",
        "the circuit is another one",
        "advised",
        warned,
        "",
        "wide",
        "lines: none dead\ncells: none shorted",
        "as stated",
        "gain: 0.1",
    )
    task = CheckTask(
        folder / "mine.h5", digest(folder / "mine.h5"), "mine", folder / "results" / "run" / "cases"
    )
    task.folder.mkdir(parents=True)
    task.keep(stored)
    task.beside.unlink()  # as where that place cannot be written
    monkeypatch.setattr(Health, "of", lambda recording: pytest.fail("health is kept, too"))
    lines = list(described)
    assert "width      wide" in lines
    health = lines.index("health     lines: none dead")
    assert lines[health + 1 : health + 3] == [
        "           cells: none shorted",
        "noise      as stated",
    ]
    assert "estimated  gain: 0.1" in lines
    assert "model      no: the circuit is another one" in lines
    assert "warning    a warning of the check" in lines and "advice     advised" in lines
    assert detect_recording(folder / "mine.h5").warnings == (warned,)


def test_detect_answers_before_the_check(folder: Path, described: Iterator[str]) -> None:
    answered = answer_recording(folder / "mine.h5")
    assert answered.answer.sentence
    with pytest.raises(AssertionError, match="checked"):
        answered.checked()


def test_a_check_that_fails_costs_no_estimate(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(audit: Any) -> RecordingCheck:
        raise ArithmeticError("a bug")

    monkeypatch.setattr(RecordingCheck, "of", broken)
    report = run(folder)
    assert (report.done, report.failed) == (2, ())
    assert any("the circuit was not checked" in line for line in report.warnings)
    assert len(read_results(folder / "out" / "results.h5").cases) == 2


def test_a_result_and_a_report_look_at_the_health_of_a_panel_once(
    folder: Path, looks: list[Any]
) -> None:
    estimates = lampest.reconstruct(lampest.Recording.load(folder / "mine.h5"), [lampest.Misfit()])
    case = estimates.result()
    assert (case.model_mark, len(looks)) == ("yes", 1)
    estimates.fit_report()
    assert len(looks) == 2
    assert estimates.model_check.mark == estimates.model_check.mark == "yes"
    assert len(looks) == 3


@pytest.mark.slow
@promise("howto/batches: A file beside the recording")
def test_a_check_beside_the_recording_serves_info_run_and_detect(
    folder: Path, checked: list[str]
) -> None:
    recording = folder / "mine.h5"
    beside = recording.with_suffix(BESIDE)
    lines = list(describe(recording))
    assert beside.is_file() and list(describe(recording)) == lines
    run(folder)
    assert answer_recording(recording).doubts is None
    assert checked == ["mine"]
    shutil.rmtree(folder / "out")
    beside.write_text(beside.read_text()[:100])
    assert list(describe(recording)) == lines and checked == ["mine"] * 2, "damaged, made again"
    assert list(describe(recording)) == lines and checked == ["mine"] * 2


@pytest.mark.slow
def test_a_kept_check_is_described_without_the_libraries_of_estimates(folder: Path) -> None:
    code = "import sys; from lampest.report.info import describe; print(*describe('mine.h5')); "
    absent = "assert not {'casadi', 'scipy.linalg', 'lampest.inference.prepared'} & {*sys.modules}"
    for expected in ("", absent):  # the first one writes the check
        subprocess.run([sys.executable, "-c", code + expected], cwd=folder, check=True)


@pytest.mark.slow
def test_info_looks_at_the_health_of_a_panel_once(folder: Path, looks: list[Any]) -> None:
    list(describe(folder / "mine.h5"))
    assert len(looks) == 1


@pytest.mark.slow
def test_a_check_by_other_code_or_of_other_readings_is_not_kept(
    folder: Path, checked: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = folder / "mine.h5"
    list(describe(recording))
    monkeypatch.setattr(checks, "code_digest", lambda: "other code")
    list(describe(recording))
    assert checked == ["mine"] * 2
    replace(lampest.Recording.load(recording), start_time="2026-01-01T00:00:00Z").save(recording)
    list(describe(recording))
    assert checked == ["mine"] * 3


@pytest.mark.slow
def test_a_folder_that_cannot_be_written_gets_no_check(
    folder: Path, checked: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    (folder / f"mine{BESIDE}").mkdir()  # as root may write into folders without permission
    (folder / f"mine{BESIDE}" / "theirs").touch()
    list(describe(folder / "mine.h5"))
    list(describe(folder / "mine.h5"))
    assert checked == ["mine"] * 2 and capfd.readouterr().err == ""
    assert [file.name for file in (folder / f"mine{BESIDE}").iterdir()] == ["theirs"]
