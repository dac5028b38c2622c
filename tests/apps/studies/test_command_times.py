"""Processor time of whole commands: its parts, and that every command works."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from docs.studies import command_times
from docs.studies.command_times import COMMANDS, CommandsFile, processor_seconds
from lampest import InputError, read_results
from lampest.apps.studies.bench import BenchFile

# A command whose child works for half a second of processor time.
BUSY = """
import subprocess, sys
subprocess.run([sys.executable, "-c", "import time\\nwhile time.process_time() < 0.5: pass"])
"""


def test_the_time_of_a_command_includes_the_processes_that_it_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = tmp_path / "lampest" / "cli.py"
    script.parent.mkdir()
    (script.parent / "__init__.py").touch()
    script.write_text(f"def main():\n    exec({BUSY!r})\n")
    monkeypatch.delenv("PYTHONPATH", raising=False)
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    assert processor_seconds((), tmp_path) >= 0.5
    assert list(script.parent.glob("__pycache__/cli.*.pyc")), "the next process compiles nothing"


def test_a_failed_command_is_no_measurement(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"lampest info absent\.h5 failed: .*no such file"):
        processor_seconds(("info", "absent.h5"), tmp_path)


@pytest.mark.slow
def test_the_libraries_alone_are_measured_without_the_package(tmp_path: Path) -> None:
    assert "lampest" not in command_times.LIBRARIES
    assert command_times.libraries_seconds(tmp_path) > 0.1


@pytest.mark.slow
def test_every_command_is_measured_next_to_the_solves_of_the_run(
    monkeypatch: pytest.MonkeyPatch, lampest: Callable[..., SimpleNamespace]
) -> None:
    text = command_times.RUN.replace("  LSR-CR:", "  # LSR-CR:").replace("  log_gr", "  # log_gr")
    monkeypatch.setattr(command_times, "RUN", text)
    solves = list[float]()

    def called(arguments: tuple[str, ...], folder: Path) -> float:
        monkeypatch.chdir(folder)
        completed = lampest(*arguments)
        assert completed.code == 0, completed.err
        if arguments[0] == "run":
            results = read_results(folder / "out" / "results.h5")
            assert [case.estimator for case in results.cases] == ["LSM", "LSM"]
            solves.append(sum(float(np.sum(case.solve_time)) for case in results.cases))
            solved = "--fresh" in arguments or "again" in arguments
            done = "2 cases solved" if solved else "2 were done before"
            assert done in completed.out
        return 10.0 + len(arguments)

    bench = BenchFile(1, (2,), frames=1)
    pair = bench.recording((2, 3), 0), bench.recording((2, 3), 1)
    times = list(command_times.command_times(pair, 1, called, lambda folder: 4.0))
    assert [time.command for time in times] == list(COMMANDS)
    assert {(time.rows, time.columns) for time in times} == {(2, 3)}
    assert times[0].seconds == 10.0 + len(COMMANDS["run"])
    for time in times:
        assert time.solves_s >= solves[0] > 0
        assert time.ratio == time.seconds / 4.0


def test_a_panel_of_commands_has_a_side() -> None:
    with pytest.raises(ValueError, match="a panel's side"):
        CommandsFile(1, (3,), commands=(1,))
