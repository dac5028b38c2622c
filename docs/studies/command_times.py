"""Processor time of whole commands in fresh processes, and that of importing their libraries.

Run it with: python -m docs.studies.command_times [CONFIG] [--out DIR] [--set PATH=VALUE]

The benchmark times solvers. A user waits for commands, which load libraries, prepare recordings,
check circuits, write files and draw pictures, too.
"""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryDirectory, TemporaryFile

import numpy as np

from docs.studies import script
from lampest.apps.studies import common, study
from lampest.apps.studies.bench import BenchFile
from lampest.apps.studies.study import OnStep, column
from lampest.files.errors import InputError
from lampest.files.typed import check_range
from lampest.panel.scene import scene_text
from lampest.recording.recording import UNLOADED, Recording
from lampest.report.compare import Columns
from lampest.runs.checks import BESIDE
from lampest.runs.results import read_results

STEMS = ("first", "second")
RUN = f"""
schema: 1
recordings: [{STEMS[0]}.h5, {STEMS[1]}.h5]
formulation: reduced
estimators:
  log_gradient: {{terms: {{misfit: {{weighting: noise}}, log_gradient: {{}}}}}}
  LSM: {{terms: {{misfit: {{}}}}}}
  LSR-CR: {{terms: {{misfit: {{}}, cell_resistance: {{weight: 1e-3}}}}}}
"""
WITHOUT_BYTECODE = "PYTHONDONTWRITEBYTECODE"  # with it a process compiles every module anew
BY_RUN = ("run", "run.yaml", "--out", "out", "--jobs", "1")
CHECKED = ", circuit checked"  # by the command before; the others find no kept check
# Name → arguments, in a folder with two recordings, a run file, a scene and a table of readings.
COMMANDS: Mapping[str, tuple[str, ...]] = {
    "run": (*BY_RUN, "--fresh"),
    f"run{CHECKED}": ("run", "run.yaml", "--out", "again", "--jobs", "1"),
    "run, all cases done": BY_RUN,
    "info": ("info", "first.h5"),
    f"info{CHECKED}": ("info", "first.h5"),
    f"detect{CHECKED}": ("detect", "first.h5", "--out", "detected"),
    "detect": ("detect", "first.h5", "--out", "detected"),
    "import": ("import", "table.csv", "--scene", "scene.yaml", "--out", "imported.h5"),
    "plot": ("plot", "out/results.h5", "--out", "pictures"),
    "compare --report": ("compare", "out/results.h5", "--report", "page.html"),
}
COMMAND = "from lampest.cli import main; main()"
# What a program of these libraries spends before it begins: the unit of `ratio`.
LIBRARIES = (
    "import casadi, h5py, matplotlib.backends.backend_agg, matplotlib.figure, numpy, pydantic, "
    "ruamel.yaml, scipy.linalg, scipy.optimize, scipy.sparse.linalg, typer"
)
# (arguments, folder in which they run) → processor time in s
Runner = Callable[[tuple[str, ...], Path], float]


@dataclass(frozen=True)
class CommandTime:
    """Processor time of a command on recordings of a panel.

    Attributes
    ----------
    command : str
    rows, columns : int
        Shape of the panel.
    seconds : float
        User and system time of the process and of those it started, in s.
    solves_s : float
        Sum of `solve_time`, with those of the baselines, over all cases of `run`, in s.
    libraries_s : float
        Processor time of a process that imports the libraries alone, in s.
    """

    command: str = column("1", "name of the command")
    rows: int = column("1", "rows of the panel")
    columns: int = column("1", "columns of the panel")
    seconds: float = column("s", "processor time of the process and of those it started")
    solves_s: float = column("s", "sum of the solve times of the run")
    libraries_s: float = column("s", "processor time of importing the libraries alone")

    @property
    def ratio(self) -> float:
        """Processor time over that of importing the libraries."""
        return self.seconds / self.libraries_s


def libraries_seconds(folder: Path) -> float:
    """Return the processor time of importing the libraries in a fresh process, in s."""
    return processor_seconds((), folder, LIBRARIES)


def processor_seconds(arguments: tuple[str, ...], folder: Path, program: str = COMMAND) -> float:
    """Return the processor time of a command, or another program, in a fresh process, in s.

    The process keeps the bytecode of the modules that it compiles, so that a second one loads it,
    as every command of an installed package does. Raises InputError with its last line if it fails.
    """
    called = [sys.executable, "-c", program, *arguments]
    environment = {name: os.environ[name] for name in os.environ if name != WITHOUT_BYTECODE}
    with TemporaryFile() as output:
        process = subprocess.Popen(
            called, cwd=folder, stdout=output, stderr=output, env=environment
        )
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            output.seek(0)
            lines = output.read().decode("utf-8", "replace").strip().splitlines()
            reason = lines[-1] if lines else f"exit code {process.returncode}"
            raise InputError(f"lampest {' '.join(arguments)} failed: {reason}")
    return usage.ru_utime + usage.ru_stime


def command_times(
    recordings: tuple[Recording, Recording],
    repeats: int,
    run: Runner = processor_seconds,
    libraries: Callable[[Path], float] = libraries_seconds,
) -> Iterator[CommandTime]:
    """Yield the processor time of every command on two recordings, the least of some repeats.

    `libraries` returns the processor time of importing the libraries, in s.

    Raises InputError if a command fails.
    """
    with TemporaryDirectory() as name:
        folder = Path(name)
        for stem, recording in zip(STEMS, recordings, strict=True):
            recording.save(folder / f"{stem}.h5")
        (folder / "run.yaml").write_text(RUN, encoding="utf-8")
        scene = recordings[0].scene
        (folder / "scene.yaml").write_text(scene_text(scene), encoding="utf-8")
        (folder / "table.csv").write_text(_table_of(recordings[0]), encoding="utf-8")
        unloaded = str(int(np.sum(recordings[0].role == UNLOADED)))
        libraries_s = min(libraries(folder) for _ in range(repeats))
        seconds = dict[str, float]()
        for command, arguments in COMMANDS.items():
            further = ("--baseline", unloaded) if command == "import" else ()
            spent = list[float]()
            for _ in range(repeats):
                rmtree(folder / "again", ignore_errors=True)
                for kept in () if command.endswith(CHECKED) else folder.glob(f"*{BESIDE}"):
                    kept.unlink()
                spent.append(run((*arguments, *further), folder))
            seconds[command] = min(spent)
        solves_s = sum(
            float(np.nansum([*case.solve_time, case.baseline_solve_time]))
            for case in read_results(folder / "out" / "results.h5").cases
        )
    rows, columns = scene.panel.shape
    for command, least in seconds.items():
        yield CommandTime(command, rows, columns, least, solves_s, libraries_s)


def _table_of(recording: Recording) -> str:
    """Return readings as a table for `lampest import`: a line for each, in ohm."""
    lines = ["time_s,row,column,resistance_ohm"]
    for time, frame in zip(recording.time, recording.recorded, strict=True):
        lines += [
            f"{time:g},{row},{column},{value:.9g}" for (row, column), value in np.ndenumerate(frame)
        ]
    return "\n".join(lines) + "\n"


COMMANDS_CSV = ("command", "rows", "columns", "seconds", "solves_s", "libraries_s", "ratio")
COMMANDS_SCREEN: Columns = {
    "command": "{command}",
    "panel": "{rows} × {columns}",
    "processor s": "{seconds:.2f}",
    "solves s": "{solves_s:.2f}",
    "libraries s": "{libraries_s:.2f}",
    "ratio": "{ratio:.3g}",
}


@dataclass(frozen=True)
class CommandsFile(BenchFile):
    """Settings of the measurement: those of a benchmark, whose recordings the commands take.

    Attributes
    ----------
    commands
        Sides of square panels.
    """

    commands: tuple[int, ...] = (10,)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.commands:
            raise ValueError("commands must hold at least one")
        check_range("a panel's side", self.commands, 2, common.MAX_SIDE)


def measured(file: CommandsFile, on_step: OnStep) -> list[CommandTime]:
    """Measure the commands on every panel; `on_step` as in `run_bench`."""
    times = list[CommandTime]()
    for number, side in enumerate(file.commands):
        on_step(number, len(file.commands), f"{side} × {side} commands")
        pair = file.recording((side, side), 0), file.recording((side, side), 1)
        times += command_times(pair, file.repeats)
    return times


def rows(times: Sequence[CommandTime]) -> list[study.Row]:
    """Return the rows of the table."""
    return [study.Row(**study.named_values(time, *COMMANDS_CSV)) for time in times]


STUDY: study.Study[CommandsFile, list[CommandTime]] = study.Study(
    "commands",
    "panels",
    "bench_commands.yaml",
    study.read_settings(CommandsFile),
    measured,
    rows=rows,
    sheets=lambda times: [("commands: whole, in fresh processes", rows(times), COMMANDS_SCREEN)],
    form="commands/1",
    records=lambda times: [study.RecordGroup("commands", times, "seconds")],
)

if __name__ == "__main__":
    script.main(lambda options: STUDY, script.parser_of(__doc__))
