"""Commands as a newcomer meets them."""

import re
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from support import invented_case
from typer.main import get_command

from lampest import (
    Estimator,
    InputError,
    Misfit,
    Panel,
    Recording,
    Scene,
    TwoPointReadout,
    export_results,
    read_results,
    read_run,
    read_scene,
    write_results,
)
from lampest.apps.board.record import Progress, Recorded
from lampest.apps.board.sample import (
    CLOCK_JUMPED,
    CLOCK_STOPPED,
    HOST_CLOCK_SET,
    OTHER_BOARD,
    Listening,
)
from lampest.apps.live.engine import Engine
from lampest.apps.live.run import from_recording
from lampest.apps.recognition.detect.answer import Detected
from lampest.apps.recognition.detect.detection import Unchecked
from lampest.apps.recognition.detect.output import with_checks
from lampest.apps.studies.study import Row, Study
from lampest.cli import screen
from lampest.cli.program import app
from lampest.files.whole import sparing, write_whole
from lampest.report.compare import compare
from lampest.runs.batch import run_batch
from lampest.runs.executors import Serial

Command = Callable[..., SimpleNamespace]
GROUPS = ("show", "study")
USEFUL = 0.7  # error with a penalty over that without
TOP_COMMANDS = get_command(app).commands
COMMANDS = {
    name: command
    for name, command in TOP_COMMANDS.items()
    if not command.hidden and name not in GROUPS
}
COMMANDS |= {
    f"{group} {name}": command
    for group in GROUPS
    for name, command in TOP_COMMANDS[group].commands.items()
}
FIGURES = re.compile(r"such as|with|\d|else", re.IGNORECASE)
KILLED = """
import os, signal, sys
from pathlib import Path
from lampest.files.whole import whole_file
with whole_file(Path(sys.argv[1])) as unfinished:
    unfinished.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""
RECORDED = Recorded(
    path=Path("r.h5"),
    scene=Scene(Panel(3, 4), TwoPointReadout(), 140.0),
    frames=7,
    lost=2,
    restarts=1,
    count=Counter(),
    ended_by="",
    noise_lsb=0.704,
    silent=0.0,
    unestimated=Counter(),
)
# What a recording ended with, and the warning that follows.
ENDS_WITH_WARNINGS: tuple[tuple[dict[str, Any], str], ...] = (
    ({}, ""),
    ({"count": Counter({CLOCK_JUMPED: 1})}, "1 jump of the board's clock; "),
    ({"count": Counter({CLOCK_JUMPED: 12})}, "12 jumps of the board's clock; "),
    ({"count": Counter({OTHER_BOARD: 1})}, "another board sends on the same line; "),
    ({"count": Counter({HOST_CLOCK_SET: 1})}, "this computer's clock was set 1 time; "),
    ({"count": Counter({CLOCK_STOPPED: 1})}, "the board's clock stood still; "),
    ({"count": Counter(parted=3)}, "3 of the 7 frames lack a module; "),
    (
        {"unestimated": Counter({"its arithmetic broke down": 2})},
        "the board did not estimate 2 of the 7 frames: its arithmetic",
    ),
    ({"silent": 1.26}, "no frame came in the last 1.3 s"),
    ({"scene": Scene(Panel(3, 4), TwoPointReadout())}, "no series resistance is assumed, "),
    ({"ended_by": "SIGINT"}, "SIGINT ended the recording; no frame was still in the port then"),
    (
        {"ended_by": "SIGHUP", "count": Counter(behind=4)},
        "SIGHUP ended the recording; 4 of the 7 frames were still in the port then",
    ),
)


def test_every_option_has_help_and_every_command_an_example() -> None:
    for name, command in COMMANDS.items():
        assert command.help and command.epilog.startswith(f"Example: lampest {name}")
        study = name.startswith("study")
        configured = study or name in ("run", "simulate", "live")
        assert not configured or any("--set" in parameter.opts for parameter in command.params)
        for parameter in command.params:
            assert parameter.help, f"{name}: {parameter.name}"
            kind = str(
                getattr(parameter, "type_descriptor", None) or getattr(parameter, "type", "")
            ).lower()
            if ("float" in kind or "int" in kind) and parameter.default is None:
                assert FIGURES.search(parameter.help), f"{name}: {parameter.name} shows no value"


def test_a_study_creates_its_folder(
    tmp_path: Path, lampest: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    folders: list[object] = []
    monkeypatch.setattr(
        "lampest.apps.studies.commands.run_study",
        lambda study, config, out, assign: folders.append(out),
    )
    for name in (studies := [name for name in COMMANDS if name.startswith("study ")]):
        completed = lampest(*name.split(), "--out", str(tmp_path / "new"))
        assert completed.code == 0, completed.err
    assert folders == [tmp_path / "new"] * len(studies) and studies


def test_no_help_contains_an_emoji(lampest: Command) -> None:
    """The renderer of the help turns known words between two colons into a picture."""
    for name in ("compare", "plot", "export", "detect", "tare"):
        completed = lampest(name, "--help")
        assert completed.code == 0 and not re.search(
            "[\u2600-\u27bf\U0001f000-\U0001faff]", completed.out
        ), name


@pytest.mark.slow
def test_init_of_a_mat_writes_a_scene_of_contacts_with_a_useful_penalty(
    tmp_path: Path, lampest: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert lampest("init", "--readout", "pull_ups", "--purpose", "mat").code == 0
    scene = (tmp_path / "scene.yaml").read_text()
    assert "\npurpose: mat " in scene and "docs/" not in scene
    assert lampest("run", "run.yaml", "--jobs", "1").code == 0
    rows = {
        row["estimator"]: row["cell error median [%]"]
        for row in compare(read_results("results/run/results.h5"))
    }
    assert rows["smooth"] < USEFUL * rows["no_penalty"]
    completed = lampest("compare", "results/run/results.h5", "--report", "page.html")
    assert completed.code == 0
    headline = re.search(r'class="headline">([^<]*)', (tmp_path / "page.html").read_text())
    assert headline is not None and "no_penalty" not in headline[1]
    wrong = lampest("init", "other", "--purpose", "lamprey")
    assert (
        wrong.code == 2
        and "there is no 'lamprey'; there is mat" in wrong.err
        and not (tmp_path / "other").exists()
    )


@pytest.mark.slow
def test_detect_writes_into_results_and_leaves_the_recordings_folder_alone(
    tmp_path: Path, lampest: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "data").mkdir()
    monkeypatch.chdir(tmp_path)
    assert lampest("init", "start", "--purpose", "mat").code == 0
    shutil.move("start/example.h5", "data/mine.h5")
    completed = lampest("detect", "data/mine.h5")
    assert completed.code == 0 and completed.out.startswith("contact since ")
    assert [path.name for path in (tmp_path / "data").iterdir()] == ["mine.h5"]
    written = sorted(path.name for path in (tmp_path / "results" / "mine").iterdir())
    assert written == ["detections.h5", "timeline_mine.png", "visits.csv"]


@pytest.mark.slow
def test_detect_names_no_visits_and_animals_where_all_panels_are_mats(
    tmp_path: Path, lampest: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """File names are those of the contract; sentences, tables and folders have contacts."""
    monkeypatch.chdir(tmp_path)
    assert lampest("init", "s", "--purpose", "mat", "--rows", "5", "--columns", "5").code == 0
    shutil.copy("s/example.h5", "s/next.h5")
    completed = lampest("detect", "s/example.h5", "s/next.h5", "--all")
    assert completed.code == 0
    assert completed.out.startswith("2 recordings: 2 contacts\n")
    printed = completed.out.replace("results/contacts/visits.csv", "")
    assert not re.search("visit|attach|lamprey|suck|breath|pump", printed, re.IGNORECASE)


def test_groups_of_commands_alone_are_hidden() -> None:
    assert {name for name, command in TOP_COMMANDS.items() if command.hidden} == set(GROUPS)


def test_version_is_printed_and_mistyped_commands_are_refused(lampest: Command) -> None:
    completed = lampest("--version")
    assert completed.code == 0 and re.fullmatch(r"lampest \d+\.\d+\.\d+\S*\n", completed.out)
    completed = lampest("plto")
    assert completed.code == 2 and "Did you mean 'plot'?" in completed.err
    assert "--set" in lampest("run", "x.yaml", "--ste", "a=1").err


def test_progress_on_a_terminal_shows_the_count_and_the_remaining_time(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for terminal, counted in ((False, False), (True, False), (True, True)):
        monkeypatch.setattr(sys.stderr, "isatty", lambda terminal=terminal: terminal)
        monkeypatch.setenv("TERM", "xterm")
        monkeypatch.setenv("COLUMNS", "100")
        with screen.progress("frames", counted=counted) as on_frame:
            on_frame(3, 9)
        drawn = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", capsys.readouterr().err)
        assert terminal or drawn == ""
        assert (
            all(word in drawn for word in ("frames", "33%", "left")) == terminal
            and ("3/9" in drawn) == counted
        )


def test_the_remaining_time_follows_from_what_is_left(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two checks begin after the frames; the time until the first frame is none of frames."""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    alone = {  # clock in s, step, done, total → remaining time of both steps
        (0, "checks", 0, 2): ("-:--:--", "-:--:--"),
        (0, "frames", 4, 10): ("-:--:--", "-:--:--"),
        (60, "frames", 4, 10): ("-:--:--", "-:--:--"),
        (90, "frames", 6, 10): ("-:--:--", "-:--:--"),
        (120, "frames", 6, 10): ("-:--:--", "-:--:--"),
        (150, "frames", 8, 10): ("0:01:00", "-:--:--"),  # 2 frames in 60 s, 2 are left
        (180, "frames", 9, 10): ("0:00:30", "-:--:--"),
        (200, "frames", 10, 10): ("0:00:00", "-:--:--"),
        (201, "frames", 10, 10): ("0:00:00", "-:--:--"),
        (225, "checks", 1, 2): ("0:00:00", "0:00:25"),
        (230, "checks", 2, 2): ("0:00:00", "0:00:00"),
    }
    in_two_processes = {  # one checks while the other solves the last frames
        (0, "checks", 0, 4): ("-:--:--", "-:--:--"),
        (0, "frames", 0, 10): ("-:--:--", "-:--:--"),
        (1, "frames", 0, 10): ("-:--:--", "-:--:--"),
        (20, "frames", 1, 10): ("-:--:--", "-:--:--"),
        (100, "frames", 9, 10): ("0:00:10", "-:--:--"),
        (120, "checks", 1, 4): ("0:00:10", "-:--:--"),  # 120 s were those of frames
        (130, "checks", 2, 4): ("0:00:10", "0:00:20"),
        (150, "frames", 10, 10): ("0:00:00", "0:00:20"),
        (155, "checks", 3, 4): ("0:00:00", "0:00:05"),
    }
    one_by_one = {  # a picture, a recording: the clock runs from the beginning
        (0, "frames", 0, 3): ("-:--:--", "-:--:--"),
        (30, "frames", 1, 3): ("0:01:00", "-:--:--"),
    }
    for calls in (alone, in_two_processes, one_by_one):
        for number, expected in enumerate(calls.values(), 1):
            with screen.progress("frames", counted=True) as show:
                for clock, step, done, total in list(calls)[:number]:
                    monkeypatch.setattr(screen, "monotonic", lambda clock=clock: float(clock))
                    show(done, total, step=step)
            drawn = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", capsys.readouterr().err)
            last = {line.split()[0]: line for line in drawn.replace("\r", "\n").split("\n") if line}
            remaining = tuple(
                re.findall(r"(\S+) left", last[step])[-1] if step in last else "-:--:--"
                for step in ("frames", "checks")
            )
            assert remaining == expected


def test_detect_counts_the_checks_that_are_left_to_make(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither results nor a recording without its check, or with a kept one, have any to make."""
    calls = list[Any]()

    def shown(label: str) -> Any:
        calls.append(label)
        return nullcontext(lambda done, total: calls.append((done, total)))

    monkeypatch.setattr(screen, "progress", shown)
    answer = Detected("mine", "nothing", 1.0)
    ready = Unchecked(answer)
    waiting = Unchecked(answer, lambda: ("doubtful",))
    checked = with_checks([answer] * 3, [waiting, ready, waiting])
    assert [each.warnings for each in checked] == [("doubtful",), (), ("doubtful",)]
    assert calls == ["checks", (0, 2), (1, 2), (1, 2), (2, 2)]
    calls.clear()
    assert len(with_checks([answer], [ready])) == 1 and calls == []


def test_exhausted_memory_gives_one_sentence(
    lampest: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    for error, words in (
        (MemoryError(), "no details"),
        (MemoryError(" 3 GiB\n  for a matrix"), "3 GiB for a matrix"),
    ):

        def failing(error: MemoryError = error) -> None:
            raise error

        monkeypatch.setattr("lampest.cli.program.program", lambda failing=failing: failing)
        completed = lampest("info")
        assert (completed.code, completed.out, completed.err) == (
            2,
            "",
            f"lampest: not enough memory ({words})\n",
        )


def test_a_recording_ends_with_a_line_and_its_warnings(
    lampest: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    requested: dict[str, Any] = {}
    options = "--count 7 --baseline 2 --period 0.5 --lines --baud 115200 --unit kohm"
    words = f"record --port p --out r.h5 {options}".split()
    for ending, warning in ENDS_WITH_WARNINGS:

        def record(
            *places: object, on_progress: Any, keys: Any, fields: Any = ending, **options: Any
        ) -> Recorded:
            requested.update(options, places=places, keys=keys())
            on_progress(Progress(None, 0, 0, "the board is gone"))
            return replace(RECORDED, **fields)

        monkeypatch.setattr("lampest.apps.board.record.record", record)
        completed = lampest(*words)
        boards = Listening(("p",), None, 2, 0.5, lines=True, baud=115200, unit="kohm")
        assert requested.pop("places") == (boards, Path("r.h5"))
        assert requested == {"frames": 7, "seconds": None, "keys": ""}
        assert (
            completed.out
            == "7 frames, 2 lost, 1 restarts of the board, noise of one reading 0.70 LSB: r.h5\n"
        )
        warnings = [line for line in completed.err.splitlines() if "interrupted" not in line]
        assert len(warnings) == bool(warning) and all(
            line.startswith(f"lampest: {warning}") for line in warnings
        )
        assert completed.code == (130 if "ended_by" in ending else 0)


@pytest.mark.slow
def test_a_simulation_takes_overrides_and_checks_its_space_first(
    tmp_path: Path, lampest: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert lampest("init", tmp_path).code == 0
    bars = list[Any]()
    simulation = tmp_path / "simulation.yaml"

    def shown(label: str, *, counted: bool = False) -> Any:
        bars.append((label, counted))
        return nullcontext(lambda done, total: bars.append((done, total)))

    monkeypatch.setattr("lampest.cli.screen.progress", shown)
    completed = lampest("simulate", simulation, "--set", "frames=2", "--out", tmp_path / "two.h5")
    assert completed.code == 0 and bars[0] == ("frames", True) and bars[-1][0] == bars[-1][1] > 2
    assert completed.out == f"{tmp_path / 'two.h5'}\n"
    assert "2 measured" in lampest("info", tmp_path / "two.h5").out
    assert lampest("simulate", simulation, "--set", "frames").code == 2
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=999))
    completed = lampest("simulate", simulation, "--out", tmp_path / "deep" / "new.h5")
    assert completed.code == 2 and re.search(
        r"new\.h5: .* may be needed on the disk, and 999 bytes are free", completed.err
    )
    assert not (tmp_path / "deep").exists()


@pytest.mark.slow
def test_results_of_other_cases_are_renamed_and_never_replace_a_recording(
    disk: SimpleNamespace, lampest: Command
) -> None:
    out = disk.folder / "out"

    def run(*words: str) -> SimpleNamespace:
        return lampest("run", disk.folder / "run.yaml", "--out", out, "--jobs", "1", *words)

    assert run().err == ""
    repeated = run()
    assert repeated.err == "" and len(list(out.glob("*.h5"))) == 1
    assert (
        repeated.out.splitlines()[0]
        == f"0 cases solved, 3 were done before, 0 failed: {out / 'results.h5'}"
    )
    original = (out / "results.h5").read_bytes()
    completed = run("--set", "solver.tolerance=1e-7")
    assert (
        "existing results of other cases were renamed: " in completed.err
        and str(out / "results_1.h5") in completed.err
    )
    assert (out / "results_1.h5").read_bytes() == original != (out / "results.h5").read_bytes()
    shutil.copy(disk.folder / "small.h5", out / "results.h5")
    completed = run("--set", "recordings=[out/results.h5]")
    assert completed.code == 2 and "is an input; give the output another name" in completed.err
    with pytest.raises(InputError, match="is an input"):
        run_batch(
            read_run(disk.folder / "run.yaml", ("recordings=[out/results.h5]",)), out, Serial()
        )
    assert (out / "results.h5").read_bytes() == (disk.folder / "small.h5").read_bytes()


@pytest.mark.slow
def test_plot_draws_a_given_frame_and_estimator(tmp_path: Path, lampest: Command) -> None:
    results = tmp_path / "results.h5"
    new = tmp_path / "new"
    write_results(results, [invented_case(name, "small", (2, 3, 4)) for name in ("LSM", "LSR-CR")])
    for words, place, begin in (
        (("--out", new), new / "contours_small_frame5.png", b"\x89PNG"),
        (("--out", new / "x.svg"), new / "x.svg", b"<?xml"),
        (("--out", new / "x.pdf"), new / "x.pdf", b"%PDF"),
    ):
        completed = lampest("plot", results, *words, "--frame", "5", "--estimator", "LSM")
        assert completed.out.split() == [str(place)] and place.read_bytes().startswith(begin)
    shutil.rmtree(new)
    for wrong in (("--out", new / "x.jpg"), ("--frame", "999"), ("--estimator", "LSMx")):
        completed = lampest("plot", results, *wrong)
        assert completed.code == 2 and not new.exists(), wrong
    assert "did you mean LSM?" in completed.err


@pytest.mark.slow
def test_every_command_prints_the_same_warnings(disk: SimpleNamespace, lampest: Command) -> None:
    out = disk.folder / "out"
    warning = "only one frame is unloaded, so that nothing shows the noise"
    for command in (
        ("run", disk.folder / "run.yaml", "--out", out, "--jobs", "1"),
        ("compare", out / "results.h5"),
        ("info", out / "results.h5"),
        ("info", disk.folder / "small.h5"),
        ("detect", disk.folder / "small.h5", "--out", out),
        ("detect", out / "results.h5", "--json"),
    ):
        assert lampest(*command).out.count(warning) == 1, command
    recording = Recording.load(disk.folder / "small.h5")
    estimator = Estimator((Misfit(),), "reduced")
    with Engine("test", "test", estimator, 1) as engine:
        from_recording(engine, recording, 1e6, None)
        engine.finish()
        assert warning in engine.shown.item.model


def one_row(subject: object) -> list[Row]:
    return [Row(value=1.0)]


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_a_study_with_an_input_named_like_an_output_writes_nothing(tmp_path: Path) -> None:
    taken = tmp_path / "own.h5"
    taken.write_bytes(b"")
    study: Study[Any, Any] = Study(
        "own", "things", "x.yaml", lambda *_: 0, lambda *_: 0, one_row, form="own/1"
    )
    with sparing((taken,)), pytest.raises(InputError, match="is an input"):
        study.run(tmp_path / "x.yaml", tmp_path, (), lambda *_: None)
    assert names(tmp_path) == {"own.h5"}


def test_invalid_paths_are_refused(disk: SimpleNamespace) -> None:
    for text in (None, 3, b"r.h5"):
        with pytest.raises(InputError, match="path"):
            Recording.load(text)
    with pytest.raises(InputError, match="names no file that could be written"):
        Recording.load(disk.folder / "small.h5").save("")
    with pytest.raises(InputError, match="no such file"):
        read_scene("\0")


def test_the_next_export_removes_fragments_of_a_killed_writer(tmp_path: Path) -> None:
    write_results(tmp_path / "r.h5", [invented_case("LSM", "mouth", (2, 3, 4))])
    assert (
        subprocess.run([sys.executable, "-c", KILLED, tmp_path / "r.mat"], check=False).returncode
        == -9
    )
    assert len([name for name in names(tmp_path) if name.endswith(".part")]) == 1
    foreign = tmp_path / ".r.mat.99999999-zzzz0000.part"  # of another computer
    foreign.touch()
    export_results(tmp_path / "r.h5", "mat")
    assert names(tmp_path) == {"r.h5", "r.mat", foreign.name}
    write_whole(tmp_path / "other.txt", "x")
    assert foreign.exists()
