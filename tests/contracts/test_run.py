"""A run from end to end: what is skipped, resumed, overridden and kept, in this process and in others."""

import dataclasses
import fcntl
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from lampest import CaseResult, InputError, read_results, read_run, term_types

ROOT = Path(__file__).parents[2]
COMMAND = Path(sys.executable).with_name("lampest")
Command = Callable[..., SimpleNamespace]
TIMES = ("solve_time", "baseline_solve_time", "error_bar_time")


def same(one: CaseResult, other: CaseResult) -> None:
    """Equal in everything but time."""
    for field in dataclasses.fields(CaseResult):
        if field.name not in TIMES:
            ours, theirs = getattr(one, field.name), getattr(other, field.name)
            np.testing.assert_equal(ours, theirs, err_msg=field.name)


def cases(folder: Path) -> tuple[CaseResult, ...]:
    return read_results(folder / "results.h5").cases


def test_run_writes_what_it_found(disk: SimpleNamespace, lampest: Command) -> None:
    out = disk.folder / "out"
    ended = lampest("run", disk.folder / "run.yaml", "--out", out, "--jobs", "1")
    assert (ended.code, ended.err) == (0, "")
    assert "3 cases solved, 0 were done before, 0 failed" in ended.out
    found = cases(out)
    assert [(case.recording, case.estimator) for case in found] == [
        ("small", name) for name in ("LSM", "LSR-CR", "LSR-dCR")
    ]
    for case in found:
        assert case.status == ("optimum verified",) * 2
        assert case.frame.tolist() == [1, 2]
        assert case.time.tolist() == [1.0, 2.0]
        assert case.scene.series_resistance_ohm == 140
        assert np.all(case.solve_time > 0)
        assert np.all(case.kkt_residual < 1e-6)
        assert case.objective == pytest.approx(sum(case.costs.values()))
        np.testing.assert_allclose(disk.exact(case.cell_resistance), case.reading_model, rtol=1e-9)
        np.testing.assert_allclose(
            case.relative_change, 100 * (case.cell_resistance / case.baseline_resistance - 1), rtol=1e-9
        )
        assert case.case_id in {path.stem for path in (out / "cases").iterdir()}
        assert "recording_sha256" in case.case_yaml
    np.testing.assert_allclose(found[0].cell_resistance, found[0].truth, rtol=1e-6)
    assert [set(case.costs) for case in found] == [
        {"misfit"},
        {"misfit", "cell_resistance"},
        {"misfit", "relative_change"},
    ]
    assert [case.joint_start for case in found] == [False, False, False]


def test_an_estimator_named_like_a_group_of_the_file_is_refused_before_any_solve(
    disk: SimpleNamespace, lampest: Command
) -> None:
    terms = "{terms: {misfit: {}}}"
    path = disk.run(f"schema: 1\nrecordings: [small.h5]\nestimators: {{recording: {terms}, LSM: {terms}}}\n")
    done = lampest("run", path, "--out", disk.folder / "out")
    assert done.code == 2 and "an estimator cannot be called 'recording'" in done.err
    assert not (disk.folder / "out").exists()


def test_second_run_does_nothing_and_fresh_solves_again(disk: SimpleNamespace, lampest: Command) -> None:
    run, out = disk.folder / "run.yaml", disk.folder / "out"
    lampest("run", run, "--out", out, "--jobs", "1")
    before = {path: path.stat().st_mtime_ns for path in (out / "cases").iterdir()}
    assert "0 cases solved, 3 were done before" in lampest("run", run, "--out", out, "--jobs", "1").out
    assert {path: path.stat().st_mtime_ns for path in (out / "cases").iterdir()} == before
    assert "3 cases solved, 0 were done before" in lampest("run", run, "--out", out, "--jobs", "1", "--fresh").out
    after = {path: path.stat().st_mtime_ns for path in (out / "cases").iterdir()}
    assert after.keys() == before.keys()
    assert all(after[path] > before[path] for path in before)


@pytest.mark.slow
def test_what_changed_is_solved_again(disk: SimpleNamespace, lampest: Command) -> None:
    """Another weight: one case. Another recording of the same name: all. A damaged result: that one."""
    out = disk.folder / "out"
    lampest("run", disk.folder / "run.yaml", "--out", out, "--jobs", "1")
    path = disk.run(disk.text.replace("weight: 1e-3", "weight: 2e-3"))
    assert "1 case solved, 2 were done before" in lampest("run", path, "--out", out, "--jobs", "1").out
    assert len(cases(out)) == 3
    disk.recording(disk.folder / "small.h5", time=np.array([0.0, 1.0, 5.0]))
    assert "3 cases solved, 0 were done before" in lampest("run", path, "--out", out, "--jobs", "1").out
    damaged = out / "cases" / f"{cases(out)[1].case_id}.h5"
    damaged.write_bytes(damaged.read_bytes()[:2000])
    assert "1 case solved, 2 were done before" in lampest("run", path, "--out", out, "--jobs", "1").out


def test_order_of_keys_and_comments_change_nothing(disk: SimpleNamespace) -> None:
    other = (
        disk.text.replace("  LSM: {terms: {misfit: {}}}\n", "") + "  LSM: # plain\n    terms: {misfit: {weight: 1}}\n"
    )
    first = {case.name: case.case_id for case in read_run(disk.folder / "run.yaml").cases}
    assert {case.name: case.case_id for case in read_run(disk.run(other, "other.yaml")).cases} == first
    assert len(set(first.values())) == 3


def test_frame_that_fails_is_no_number_and_stops_nothing(disk: SimpleNamespace, lampest: Command) -> None:
    """One iteration is too few: NaN and a sentence, in a finished case."""
    few = "  penalised: {solver: {max_iterations: 1}, terms: {misfit: {}, cell_resistance: {weight: 0.1}}}\n  LSM: {"
    path = disk.run(disk.text.replace("  LSM: {", few))
    ended = lampest("run", path, "--out", disk.folder / "out", "--jobs", "1")
    assert (ended.code, ended.err) == (0, "")
    failed, *fine = cases(disk.folder / "out")
    assert set(failed.status) == {"the iteration limit was reached before an optimum"}
    assert not np.any(failed.solved)
    for values in (failed.cell_resistance, failed.relative_change, failed.reading_model, failed.objective):
        assert np.all(np.isnan(values))
    assert not np.any(failed.open_cell)
    assert all(np.all(case.solved) for case in fine)


@pytest.mark.slow
def test_processes_find_what_one_finds(disk: SimpleNamespace) -> None:
    disk.recording(disk.folder / "wide.h5", disk.scene.replace("rows: 3, columns: 4", "rows: 2, columns: 5"), (3, 2, 5))
    path = disk.run(disk.text.replace("[small.h5]", '["*.h5"]'))
    outs = disk.folder / "one", disk.folder / "two"
    for out, jobs in zip(outs, (1, 2), strict=True):
        ended = disk.command("run", path, "--out", out, "--jobs", jobs)
        assert (ended.returncode, ended.stderr) == (0, "")
    assert len(cases(outs[0])) == 6
    for one, other in zip(*map(cases, outs), strict=True):
        same(one, other)


@pytest.fixture
def long(disk: SimpleNamespace) -> SimpleNamespace:
    """Forty-two cases of some tenths of a second."""
    shape = (9, 8, 8)
    disk.recording(disk.folder / "long.h5", disk.scene.replace("rows: 3, columns: 4", "rows: 8, columns: 8"), shape)
    weights = [float(f"{weight:.3g}") for weight in np.geomspace(1e-5, 1e-1, 40)]
    sweep = f"sweep: {{estimators.LSR-CR.terms.cell_resistance.weight: {json.dumps(weights)}}}\n"
    path = disk.run(disk.text.replace("small.h5", "long.h5") + sweep)
    return SimpleNamespace(path=path, out=disk.folder / "out", count=42)


def started(long: SimpleNamespace) -> subprocess.Popen[str]:
    """The run in its own process, after it has finished two of its cases."""
    run = subprocess.Popen(
        [COMMAND, "run", str(long.path), "--out", str(long.out), "--jobs", "1"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # Shells start background jobs with Ctrl-C ignored, and children inherit that.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    deadline = time.monotonic() + 60
    while len(list((long.out / "cases").glob("[!.]*.h5"))) < 2:
        assert run.poll() is None, run.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return run


@pytest.mark.slow
def test_killed_run_resumes(long: SimpleNamespace, lampest: Command) -> None:
    run = started(long)
    run.kill()
    run.communicate()
    finished = len(list((long.out / "cases").glob("[!.]*.h5")))
    assert 2 <= finished < long.count
    ended = lampest("run", long.path, "--out", long.out, "--jobs", "1")
    assert ended.code == 0
    assert f"{long.count - finished} cases solved, {finished} were done before, 0 failed" in ended.out
    assert len(cases(long.out)) == long.count


def test_interrupted_run_keeps_what_is_finished(long: SimpleNamespace) -> None:
    run = started(long)
    run.send_signal(signal.SIGINT)
    out, err = run.communicate(timeout=60)
    assert run.returncode == 130
    assert err.endswith("lampest: interrupted; what was finished is kept\n")
    assert all(line.startswith("lampest: ") for line in err.splitlines()) and out == ""
    finished = cases(long.out)
    assert 2 <= len(finished) < long.count
    assert all(np.all(case.solved) for case in finished)
    assert {case.case_id for case in finished} == {path.stem for path in (long.out / "cases").glob("[!.]*.h5")}


@pytest.mark.slow
@pytest.mark.parametrize("executor", ["serial", "processes, workers: 1"])
def test_a_case_that_is_broken_off_keeps_its_finished_frames(
    executor: str, disk: SimpleNamespace, lampest: Command
) -> None:
    shape, out = (1502, 8, 8), disk.folder / "out"
    disk.recording(disk.folder / "small.h5", disk.scene.replace("rows: 3, columns: 4", "rows: 8, columns: 8"), shape)
    text = disk.text[: disk.text.index("  LSR-CR")] + f"formulation: nodal\nexecutor: {{kind: {executor}}}\n"
    run = subprocess.Popen(
        [COMMAND, "run", str(disk.run(text)), "--out", str(out)],
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    deadline = time.monotonic() + 60
    while not list((out / "cases").glob(".*_unfinished.h5")):
        assert run.poll() is None and time.monotonic() < deadline
        time.sleep(0.01)
    run.send_signal(signal.SIGINT)
    run.communicate(timeout=60)
    assert run.returncode == 130
    (case,) = cases(out)
    count = int(case.solved.sum())
    assert 0 < count < len(case.solved) and case.solved[:count].all()
    assert np.isnan(case.cell_resistance[count:]).all() and np.isfinite(case.cell_resistance[:count]).all()
    assert set(case.status[count:]) == {"the run was broken off before this frame"}
    assert not list((out / "cases").iterdir()), "an unfinished case is solved anew"


def test_one_run_at_a_time_in_a_folder(disk: SimpleNamespace, lampest: Command) -> None:
    out = disk.folder / "out"
    out.mkdir()
    with (out / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        busy = lampest("run", disk.folder / "run.yaml", "--out", out, "--jobs", "1")
        assert (busy.code, busy.out) == (2, "")
        assert busy.err == f"lampest: {out}: another run is using this folder\n"
        assert [path.name for path in out.iterdir()] == [".lock"]
    assert lampest("run", disk.folder / "run.yaml", "--out", out, "--jobs", "1").code == 0


@pytest.mark.slow
def test_two_runs_into_one_folder_at_once(disk: SimpleNamespace) -> None:
    """Either one waits for none and refuses, or it comes late and finds all done; the results are whole."""
    command = [COMMAND, "run", str(disk.folder / "run.yaml"), "--out", str(disk.folder / "out"), "--jobs", "2"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    both = [subprocess.Popen(command, **pipes) for _ in range(2)]
    written = [run.communicate(timeout=120) for run in both]
    for run, (out, err) in zip(both, written, strict=True):
        if run.returncode:
            assert (run.returncode, out) == (2, "")
            assert err == f"lampest: {disk.folder / 'out'}: another run is using this folder\n"
    assert 0 in [run.returncode for run in both]
    assert [case.estimator for case in cases(disk.folder / "out")] == ["LSM", "LSR-CR", "LSR-dCR"]


def test_sweep_varies_an_estimator_over_its_own_keys_and_all_over_the_others(disk: SimpleNamespace) -> None:
    sweep = "sweep: {estimators.LSR-CR.terms.cell_resistance.weight: [1e-4, 1e-2], bounds.lower: [measured, 1]}\n"
    run = read_run(disk.run(disk.text + sweep))
    lower = [{"bounds.lower": bound} for bound in ("measured", 1)]
    weights = [{"cell_resistance.weight": weight} for weight in (1e-4, 1e-2)]
    assert [case.swept for case in run.cases] == [
        *lower,
        *(weight | bound for weight in weights for bound in lower),
        *lower,
    ]
    assert [case.name for case in run.cases][1:4] == [
        "LSM@bounds.lower=1",
        "LSR-CR@cell_resistance.weight=0.0001,bounds.lower=measured",
        "LSR-CR@cell_resistance.weight=0.0001,bounds.lower=1",
    ]
    varied = run.cases[2:6]
    found = [(case.estimator.terms[1].weight, case.estimator.bounds.lower) for case in varied]
    assert found == [(1e-4, "measured"), (1e-4, 1), (1e-2, "measured"), (1e-2, 1)]
    assert len({case.case_id for case in run.cases}) == 8


def test_sweep_of_single_estimators_keeps_the_others_once(disk: SimpleNamespace) -> None:
    weights, changes = [1e-4, 1e-3, 1e-2], [1, 10]
    keys = {
        "estimators.LSR-CR.terms.cell_resistance.weight": weights,
        "estimators.LSR-dCR.terms.relative_change.weight": changes,
    }
    run = read_run(disk.run(disk.text + f"sweep: {json.dumps(keys)}\n"))
    assert [(case.name.partition("@")[0], list(case.swept.values())) for case in run.cases] == [
        ("LSM", []),
        *(("LSR-CR", [weight]) for weight in weights),
        *(("LSR-dCR", [weight]) for weight in changes),
    ]
    with pytest.raises(InputError, match="a sweep varies keys below, or beside, this one"):
        read_run(disk.run(disk.text + "sweep: {estimators: [{LSM: {terms: {misfit: {}}}}]}\n"))
    with pytest.raises(InputError, match="LSR-XX"):
        read_run(disk.run(disk.text + "sweep: {estimators.LSR-XX.terms.misfit.weight: [1, 2]}\n"))


def test_sweep_of_what_all_share_varies_all(disk: SimpleNamespace) -> None:
    run = read_run(disk.run(disk.text + "sweep: {formulation: [nodal, per_pixel]}\n"))
    names = ("LSM", "LSR-CR", "LSR-dCR")
    forms = ("nodal", "per_pixel")
    assert [case.name for case in run.cases] == [f"{name}@formulation={form}" for name in names for form in forms]
    assert [case.estimator.formulation for case in run.cases] == [form for _ in names for form in forms]


def test_estimators_override_the_run_key_by_key(disk: SimpleNamespace) -> None:
    shared = "formulation: per_pixel\nsolver: {tolerance: 1e-9, max_iterations: 77}\nbounds: {upper: none}\n"
    own = "  LSM: {formulation: nodal, solver: {max_iterations: 5}, bounds: {lower: 2}, "
    run = read_run(disk.run(disk.text.replace("  LSM: {", own) + shared))
    first, second, _ = (case.estimator for case in run.cases)
    assert (first.formulation, second.formulation) == ("nodal", "per_pixel")
    assert (first.solver.tolerance, first.solver.max_iterations) == (1e-9, 5)
    assert (second.solver.tolerance, second.solver.max_iterations) == (1e-9, 77)
    assert (first.bounds.lower, first.bounds.upper) == (2, "none")
    assert (second.bounds.lower, second.bounds.upper) == ("measured", "none")


def test_settings_override_the_file(disk: SimpleNamespace, lampest: Command) -> None:
    path = disk.folder / "run.yaml"
    run = read_run(path, ("solver.max_iterations=9", "estimators.LSR-CR.terms.cell_resistance.weight=5e-2"))
    assert {case.estimator.solver.max_iterations for case in run.cases} == {9}
    assert run.cases[1].estimator.terms[1].weight == 0.05
    out = disk.folder / "out"
    arguments = ("--set", "formulation=per_pixel", "--set", "estimators.LSM.terms.misfit.weight=3")
    assert lampest("run", path, "--out", out, "--jobs", "1", *arguments).code == 0
    assert "formulation: per_pixel" in cases(out)[1].case_yaml
    assert "weight: 3" in cases(out)[0].case_yaml


def test_recordings_are_found_relative_to_the_file(
    disk: SimpleNamespace, lampest: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And the results where the command is called, in results/<name of the file>."""
    (disk.folder / "configs").mkdir()
    (disk.folder / "configs" / "mine.yaml").write_text(disk.text.replace("small.h5", "../small.h5"))
    monkeypatch.chdir(disk.folder)
    assert lampest("run", "configs/mine.yaml", "--jobs", "1").code == 0
    assert len(cases(disk.folder / "results" / "mine")) == 3


def test_published_figures_travel_along(disk: SimpleNamespace, lampest: Command) -> None:
    figures = "published: {LSM: {all: {time_s: 16.45, error_percent: 1.33}}, LSR-dCR: {initial: {time_s: 58.63}}}\n"
    ended = lampest("run", disk.run(disk.text + figures), "--out", disk.folder / "out", "--jobs", "1")
    assert (ended.code, ended.err) == (0, "")
    published = read_results(disk.folder / "out" / "results.h5").published
    assert published["LSM"].all.time_s == 16.45
    assert published["LSR-dCR"].initial.time_s == 58.63
    assert published["LSR-dCR"].following is None


def test_single_row_runs(disk: SimpleNamespace, lampest: Command) -> None:
    scene = disk.scene.replace("rows: 3", "rows: 1")
    disk.recording(disk.folder / "small.h5", scene, (3, 1, 4))
    out = disk.folder / "out"
    ended = lampest("run", disk.folder / "run.yaml", "--out", out, "--jobs", "1")
    assert (ended.code, ended.err) == (0, "")
    np.testing.assert_allclose(cases(out)[0].cell_resistance, cases(out)[0].truth, rtol=1e-6)
    assert lampest("info", disk.folder / "small.h5").code == 0


def test_help_is_quick_because_it_imports_little(tmp_path: Path) -> None:
    program = (
        "import sys\nfrom lampest import cli\nsys.argv = ['lampest', '--help']\n"
        "try:\n    cli.main()\nexcept SystemExit as end:\n    assert not end.code\n"
        "heavy = {'casadi', 'numpy', 'scipy', 'h5py', 'pydantic', 'ruamel', 'matplotlib', 'serial'}\n"
        "print('loaded:', sorted(heavy & set(sys.modules)))\n"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.splitlines()[-1] == "loaded: []"
    for command in ("run", "simulate", "import", "compare", "plot", "show", "info"):
        assert command in ended.stdout


def test_terms_lists_all(lampest: Command) -> None:
    ended = lampest("show", "terms")
    assert (ended.code, ended.err) == (0, "")
    for kind, term in term_types().items():
        (line,) = (line for line in ended.out.splitlines() if line.strip().startswith(f"{kind} "))
        assert term.unit in line
        assert f"weight: {term().weight}" in line


def test_schema_is_the_shipped_one(lampest: Command) -> None:
    ended = lampest("show", "schema")
    assert (ended.code, ended.err) == (0, "")
    shipped = (ROOT / "configs" / "lampest.schema.json").read_text(encoding="utf-8")
    assert ended.out == shipped, "lampest show schema > configs/lampest.schema.json"
    text = json.dumps(json.loads(shipped))
    for word in (*term_types(), "huber", "per_pixel", "resolution", "sweep", "published"):
        assert f'"{word}"' in text


@pytest.mark.parametrize("name", ["table1", "all_scenes"])
def test_shipped_runs_are_in_order(name: str) -> None:
    path = ROOT / "configs" / f"{name}.yaml"
    run = read_run(path)
    recordings = {case.recording for case in run.cases}
    assert len(run.cases) == 5 * len(recordings)
    assert len(recordings) == {"table1": 2, "all_scenes": 8}[name]
    assert path.read_text(encoding="utf-8").startswith("# yaml-language-server: $schema=lampest.schema.json\n")
    weights = {case.name: [(type(term).__name__, term.weight) for term in case.estimator.terms] for case in run.cases}
    assert weights == {
        "LSM": [("Misfit", 1)],
        "LSR-CR": [("Misfit", 1), ("CellResistance", 1e-3)],
        "LSR-dCR": [("Misfit", 1), ("RelativeChange", 10)],
        "LSR-gCR": [("Misfit", 1), ("Gradient", 1e-3)],
        "LSR-gdCR": [("Misfit", 1), ("GradientOfRelativeChange", 10)],
    }


def test_library_in_five_lines() -> None:
    import lampest

    recording = lampest.Recording.load(ROOT / "data" / "lamprey_35mm.h5")
    found = lampest.reconstruct(recording, terms=[lampest.Misfit(), lampest.Gradient(weight=1e-3)])
    assert found.cell_resistance.shape == found.relative_change.shape == (21, 10, 10)
    assert np.median(np.abs(found.cell_resistance / recording.truth_cell_resistance[3:] - 1)) < 0.25
    assert all(getattr(lampest, name) is not None for name in lampest.__all__)
    with pytest.raises(AttributeError, match="no attribute 'reconstrcut'"):
        lampest.reconstrcut  # noqa: B018


def test_results_are_plain_hdf5(disk: SimpleNamespace, lampest: Command) -> None:
    out = disk.folder / "out"
    lampest("run", disk.folder / "run.yaml", "--out", out, "--jobs", "1")
    with h5py.File(out / "results.h5") as file:
        group = file["entry/small/LSR-CR"]
        assert group.attrs["signal"] == b"cell_resistance"
        assert group["cell_resistance"].shape == (2, 3, 4)
        assert group["cell_resistance"].attrs["units"] == b"ohm"
        assert group["status"][0] == b"optimum verified"
        assert group["cost/cell_resistance"].shape == (2,)
