"""Rows of run files, of faults in documents, and of executors."""

import logging
import os
import shutil
import tempfile
import warnings
from collections.abc import Callable
from contextlib import chdir
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import h5py
import numpy as np
from attack.attack import called, everything
from contracts.test_studies import BENCH, EXTREMES
from golden.circuits import Rows
from small_files import RUN, SCENE, SIMULATION, TRADEOFF, on_disk
from support import invented_case

import lampest as lp
from lampest.files.document import plain_content
from lampest.files.errors import InputError
from lampest.files.process import (
    ALLOWED,
    check_memory,
    in_bytes,
    interrupted,
    libraries_to_the_log,
    logged_reason,
    memory_limit,
)
from lampest.files.typed import check_range
from lampest.files.whole import check_output, sparing
from lampest.recording import simulation
from lampest.runs.executors import Dask, Serial, Tls, each_of, local

SERIES = "  series_resistance_ohm: 140\n"
# Command → its file in order, and by what each part is replaced; '' is the line before the first
# one.
FAULTS: dict[str, tuple[str, dict[str, tuple[str, ...]]]] = {
    "run": (
        RUN,
        {
            "recordings: [": ("recordigns: [", "recordings: [[", "\trecordings: ["),
            "LSM: {terms:": ("LSM: {term:",),
            "weight: 1e-3": (
                "wieght: 1e-3",
                "weight: 1e-3, weight: 2",
                "weight: '1e-3'",
                "weight: -1e-3",
                "weight: .nan",
                "loss: {kind: hubert, corner: 1}",
                "loss: {kind: huber}",
                "loss: {kind: huber, corner: 1, cornr: 2}",
            ),
            "  LSR-dCR": ("  LSM",),
            "[small.h5]": ("small.h5", "[5]", "[]", "!!python/object:os.system [small.h5]"),
            "schema: 1": ("schema: 2", ""),
            "{terms: {misfit: {}}}": ("{terms: {}}",),
            "small.h5": ("smal*.hdf",),
            "LSM:": ("a/b:", "recording:"),
            "estimators:": ("estimatros:",),
            "{misfit: {}}": ("{gradient: {}}",),
            "": (
                "formulation: nodel",
                "formulation: {kind: truncated, stps: 4}",
                "formulation: {kind: truncated, steps: soon}",
                "solver: soon\nbounds: {lower: often}",
                "solver: {tolerance: 0}",
                "solver: {max_iterations: 2.5}",
                "solver: {time_limit_s: 0}",
                "solver: {time_limit_s: -1}",
                "solver: {time_limit_s: .nan}",
                "solver: {time_limit_s: .inf}",
                "solver: {time_limit_s: soon}",
                "bounds: {lower: -5}",
                "bounds: {upper: resolved}",
                "bounds: {upper: 10}",
                "error_bars: often",
                "sweep: {solver.tolernace: [1e-8]}",
                "sweep: {solver.tolerance: 1e-8}",
                "tare: {frames: 5, frame: 2}",
                "sweep: {solver.tolerance: [1e-8, -1]}",
                "sweep: {bounds.lower: [1, 9], bounds.upper: [5, 20]}",
                "sweep: {estimators: [{LSM: {terms: {misfit: {}}}}]}",
                "sweep: {estimators.CR.terms.misfit.weight: [1, 2]}",
                "sweep: {executor.workers: [1, 2]}",
                "executor: {kind: procesess}",
                "executor: {workers: 2}",
                "executor: {kind: processes, workers: 0}",
                "executor: {kind: serial, workers: 2}",
                "executor: {kind: dask, address: 'tcp://a:1', workers: 2}",
                "auto_weight: {rule: best}",
                "executor: {kind: dask, scheduler_file: /dev/zero}",
                "published: {LSM: {all: {time: 3}}}",
            ),
        },
    ),
    "simulate": (
        SIMULATION,
        {
            "rim_width_mm: 4": ("rim_width_mm: 4, tlit: 0.1", "rim_width_mm: 14"),
            "kind: rod": ("kind: rodd",),
            "mass_g: 50": (
                "mass_g: 50, weight: 3",
                "mass_g: -50",
                "mass_g: {uniform: [5]}",
                "mass_g: {uniform: [9, 5]}",
            ),
            "pressure_kpa: -10": ("pressure_kpa: 10",),
            "seed: 4": (
                "seed: -4",
                "seed: -4\nframe_period_s: {uniform: [1, 2]}",
                "seed: soon\nframe_period_s: {uniform: [1, 2]}",
            ),
            SERIES: (
                f"{SERIES}  film: {{hysteresis: 0.2, creep: 0.06}}\n",
                f"{SERIES}  film: {{hysteresis: 0.9}}\n",
                f"{SERIES}  film: {{creep_per_decade: often}}\n",
                f"{SERIES}  subject: {{length_mm: 0}}\n",
                f"{SERIES}  experiment: {{water_temperature_celsius: 290}}\n",
            ),
            "": (
                "unmodelled: {outliers: 0.1}",
                "unmodelled: {channel_spread_ohm: 10000}",
                "course: {breathing_depth: 2}",
                "course: {start_s: -1}",
                "sweep: {sede: [1, 2]}",
                "sweep: {cells.spraed: [1, 2]}",
                "sweep: [5]",
                "sweep: {loads.2.mass_g: [1, 2]}",
                "sweep: {loads.1.mass_g: [1, -2]}",
                "output: 'a_{sede}.h5'",
                "output: same.h5\nsweep: {seed: [1, 2]}",
                "output: 'a_{seed.__class__}.h5'",
                "output: a.txt",
                "response: {kind: table, pressure_kpa: [0, 5], resistance_ohm: [1, 2]}",
                "response: {kind: spline}",
                "response: {kind: power, exponent: 1, scale_kpa: 2, gain: [[1, 1]]}",
            ),
        },
    ),
    "study bench": (
        BENCH,
        {
            "sizes: [3]": ("sizes: []", "sizes: [1]", "sizes: [3, [3, 3]]"),
            "frames: 1": ("frames: 0",),
            "repeats: 1": ("recordings: 0", "estimators: {A: {terms: {}}}"),
            "nodal: 3": ("noddal: 3",),
            BENCH.split("1\n", 1)[1]: ("sizes: [3, [3, 30]]\nlimits: {reduced: 20}\n",),
        },
    ),
    "study extremes": (
        EXTREMES,
        {
            "[[2, 3]]": ("[]", "[99]"),
            "decades: [1]": ("decades: [99]",),
            "noise: [0]": ("noise: [-1]", "seeds: -1"),
            "": ("estimators: {}",),
        },
    ),
    "study tradeoff": (
        TRADEOFF,
        {
            " reduced,": (" redcued,", ""),
            "steps: 2": ("steps: 0",),
            "scaled,": ("naive,",),
            "frames: 3": ("frames: 1",),
            "sizes: [8,": ("sizes: [3,",),
            "  scenes: {clean: {}": ("  scenes: {a/b: {}",),
        },
    ),
}
READERS: dict[str, Callable[[Path], Any]] = {
    "run": lp.read_run,
    "simulate": lambda path: simulation.run(path, None),
}


NUMBERS = "--rows 3 --columns 4"
LAMPREY = str(Path(lp.__file__).parents[1] / "data" / "lamprey_25mm.h5")
# What no command takes, in a folder with files of every kind.
COMMANDS = (
    "run .",
    "run latin.yaml",
    "run empty.yaml",
    "run twice.yaml --out out",
    "run none.yaml",
    *(
        f"run run.yaml --out out --set {word}"
        for word in (
            "solver.tolerance",
            "solver.tolernace=1e-6",
            "recordings.0.x=1",
            "solver.tolerance=[1",
            "=1",
        )
    ),
    *(f"run run.yaml --out {place}" for place in ("small.h5", "small.h5/below", "/proc/none")),
    *(
        f"{command} {file}"
        for command in ("info", "compare", "plot", "check", "detect", "export --to csv")
        for file in ("none.h5", "run.yaml")
    ),
    "compare small.h5",
    "plot small.h5",
    "export small.h5 --to csv",
    "import m.csv --out m.h5",
    "import m.csv --out m.h5 --rows 3",
    *(
        f"import m.csv --out m.h5 {NUMBERS} {more}"
        for more in (
            "--period 0",
            "--unit farad",
            "--missing drop",
            "--variable R",
            "--scene none.yaml",
            "--baseline 9",
        )
    ),
    *(
        f"export results.h5 --to {more}"
        for more in (
            "xlsx",
            "nwb",
            "nwb --recording other",
            "nwb --recording other --start 2026-05-04T09:30",
            "csv --start yesterday",
            "csv --start 2026-05-05",
            "csv --recording third",
            "csv --out results.h5",
        )
    ),
    *(f"tare small.h5 --out t.h5 --frames {frames}" for frames in ("5", "60:70", "1:1", "0:3")),
    *(f"detect small.h5 --patch {patch}" for patch in ("0", "-6", "nan", "inf")),
    *(
        f"record --out made --port {port}"
        for port in (
            "/nowhere/port",
            "loop:// --count 1 --seconds 1",
            "loop:// --seconds nan",
            "loop:// --period -1",
            "loop:// --scene nowhere.yaml",
        )
    ),
    f"record --out {LAMPREY} --port loop://",
    "check none.h5 --repair",
    "calibrate none.h5",
    *(
        f"calibrate {LAMPREY} --out made --known {known}"
        for known in (
            "nothing.csv",
            "known.csv",
            "ragged.csv",
            "1e9",
            "-5",
        )
    ),
    *(
        f"live --recording {LAMPREY} {more}"
        for more in (
            "--speed 0",
            "--speed nan",
            "--estimator best",
            "--http here",
        )
    ),
)


def commands_row() -> dict[str, Any]:
    """Refused commands: exit code, words and whether all files are as they were."""
    rows = {}
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        disk = on_disk(Path())
        started = {"start_time": "2026-05-04T09:30:00+02:00"}
        cases = [
            invented_case("LSM", "mouth", (3, 4, 5), **started),
            invented_case("LSM", "other", (2, 3, 6)),
        ]
        lp.write_results("results.h5", cases)
        disk.run(RUN.replace("[small.h5]", "[small.h5, other/small.h5]"), "twice.yaml")
        for name, text in (
            ("m.csv", "1,2,3,4\n" * 3),
            ("known.csv", "1,2\n3,4\n"),
            ("ragged.csv", "1,2\n3\n"),
        ):
            disk.run(text, name)
        Path("latin.yaml").write_bytes("schema: 1 # Größe".encode("latin-1"))
        Path("empty.yaml").touch()
        Path("other").mkdir()
        shutil.copy("small.h5", "other")
        original = everything(Path())
        for words in COMMANDS:
            completed = called(*words.split(), folder=Path())
            rows[words.replace(LAMPREY, "…")] = [
                completed.code,
                completed.out,
                completed.err.replace(LAMPREY, "…"),
            ]
            rows[words.replace(LAMPREY, "…")] += [everything(Path()) == original]
    return rows


def reason(function: Callable[[], Any]) -> Any:
    """Return a result, or why there is none."""
    try:
        return function()
    except ValueError as error:
        return str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"


def faults_row(command: str) -> dict[str, str]:
    """Return the sentence on every fault of a command's file."""
    text, faults = FAULTS[command]
    rows = {}
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        file = on_disk(Path())
        for old, new in ((old, new) for old, several in faults.items() for new in several):
            path = file.run(text.replace(old, new if old else f"{new}\n", 1))
            if command in READERS:
                rows[f"{old}: {new}"] = str(reason(lambda path=path: READERS[command](path)))
            else:
                rows[f"{old}: {new}"] = called(
                    *command.split(), str(path), "--out", "out", folder=Path()
                ).err
    return rows


# Datasets of a recording that are replaced, or left out; '' is its scene.
RECORDINGS: tuple[dict[str, Any], ...] = (
    {"resistance": np.empty((0, 3, 4)), "time": np.empty(0), "role": np.empty(0, np.uint8)},
    {"resistance": None},
    {"role": np.zeros(3, np.uint8)},
    {"resistance": np.full((3, 4, 3), 1500.0)},
    {"time": np.arange(4.0)},
    {"resistance": np.full((3, 3, 4), b"many")},
    {"role": np.array([0, 1, 2], np.uint8)},
    {"": ("140", "-140")},
    {"sigma": np.zeros((3, 4))},
    {"sigma": np.ones((2, 3, 4))},
    {"time": np.array([0, 2, 1.0])},
    {"": (SCENE, "")},
    {"": ("pitch_mm", "pich_mm")},
    {"": ("panel", "panels")},
    {"": ("rows: 3", "rows: 0")},
)
MAPS = np.zeros((4, 5, 7))
LARGE = (10**6, 5, 7)
# Paths in results, with other values or nothing, and attributes: path@name.
RESULTS: tuple[tuple[str, Any], ...] = (
    ("/@lampest_format", b"recording/1"),
    ("entry", None),
    ("/entry/a/recording/scene", None),
    ("/entry/a/LSM", None),
    *(
        (f"/entry/a/LSM/{name}", value)
        for name, value in (
            ("cell_resistance", None),
            ("cell_resistance", -MAPS - 1),
            ("cell_resistance", MAPS[:, 1:]),
            ("status", None),
            ("status", np.zeros(4)),
            ("objective", np.zeros(3)),
            ("open_cell", MAPS),
            ("two_point_model", MAPS - 1),
            ("solve_time", b"text"),
            ("cost/misfit", np.zeros((4, 2))),
            ("solved", np.zeros(4, np.uint8)),
            ("time", None),
            ("relative_change", MAPS + np.inf),
            ("frame", np.zeros(4)),
            ("cost/bad", h5py.SoftLink("/no")),
        )
    ),
    *(
        (f"/entry/a/recording/{name}", value)
        for name, value in (
            ("resistance", MAPS),
            ("resistance", LARGE),
            ("time", np.full(4, np.nan)),
            ("baseline", None),
            ("scene", b"panel: {rows: 5, colums: 7}"),
            ("scene", b"panel: {rows: 5, columns: 5}"),
        )
    ),
    ("/entry/a/LSM@joint_start", b"x"),
    ("/entry/a/LSM@order", b"x"),
    ("/entry@published", b'{"LSM": 3}'),
)


def damaged_row() -> dict[str, Any]:
    """Sentences on recordings and results with other content."""
    rows: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        disk = on_disk(Path())
        for number, changes in enumerate(RECORDINGS):
            scene = SCENE.replace(*changes.get("", ("", "")))
            disk.recording(
                Path("small.h5"), scene, **{name: part for name, part in changes.items() if name}
            )
            completed = called("run", "run.yaml", "--jobs", "1", "--out", "out", folder=Path())
            rows[f"recording {number}"] = [
                completed.code,
                completed.out,
                completed.err,
                Path("out").exists(),
            ]
        cases = [
            invented_case(name, recording, (4, 5, 7))
            for recording in "ba"
            for name in ("LSM", "LSR-CR")
        ]
        lp.write_results("good.h5", cases)
        for path, value in RESULTS:
            shutil.copy("good.h5", "results.h5")
            node, _, attribute = path.partition("@")
            with h5py.File("results.h5", "r+") as file:
                if attribute:
                    file[node].attrs[attribute] = value
                elif node in file:
                    del file[node]
                if value is LARGE:
                    file.create_dataset(node, LARGE, "f8", chunks=(1, 5, 7))
                elif not attribute and value is not None:
                    file[node] = value
            cause = reason(lambda: lp.read_results("results.h5").recordings())
            rows[f"{path} {np.shape(value)} {str(value)[:30]}"] = str(cause)
    return rows


OWN_SWEEP = '"estimators.LSR-CR.terms.cell_resistance.weight": [1e-4, 1e-3, 1e-2]'
RUNS: dict[str, tuple[str, tuple[str, ...]]] = {
    "plain": (RUN, ()),
    "sweep": (
        RUN + "sweep: {estimators.LSR-CR.terms.cell_resistance.weight: [1e-4, 1e-2], bounds.lower: "
        "[measured, 1]}\n",
        (),
    ),
    "own sweeps": (
        RUN + f"sweep: {{{OWN_SWEEP}, estimators.LSR-dCR.terms.relative_change.weight: [1, 10]}}\n",
        (),
    ),
    "swept twice": (
        RUN + "sweep: {estimators.LSR-CR.terms.cell_resistance.weight: [1e-3, 1e-2, 1e-3]}\n",
        (),
    ),
    "in another order": (
        RUN.replace("  LSM: {terms: {misfit: {}}}\n", "")
        + "  LSM: # plain\n    terms: {misfit: {weight: 1}}\n",
        (),
    ),
    "shared": (
        RUN.replace(
            "  LSM: {",
            "  LSM: {formulation: nodal, solver: {max_iterations: 5}, bounds: {lower: 2}, ",
        )
        + "formulation: per_pixel\nsolver: {tolerance: 1e-9, max_iterations: 77}\nbounds: {upper: "
        "none}\n",
        ("error_bars=false",),
    ),
    "settings": (
        RUN,
        ("solver.max_iterations=9", "estimators.LSR-CR.terms.cell_resistance.weight=5e-2"),
    ),
    "several files": (RUN.replace("[small.h5]", '["s*.h5", second/other.h5]'), ()),
    "published": (
        RUN + "published: {LSM: {all: {time_s: 16.45}}, LSR-dCR: {initial: {time_s: 58.63}}}\n",
        (),
    ),
}


def runs_row() -> dict[str, Any]:
    """Return the cases of run files; equal cases have the number of the first of them."""
    rows = {}
    numbers = dict[str, int]()
    with tempfile.TemporaryDirectory() as folder:
        disk = on_disk(Path(folder))
        (disk.folder / "second").mkdir()
        disk.recording(disk.folder / "second" / "other.h5", shape=(4, 3, 4))
        disk.recording(disk.folder / "s2.h5", shape=(4, 3, 4))
        for name, (text, settings) in RUNS.items():
            run = lp.read_run(disk.run(text), settings)
            first = run.cases[0]
            lines = [line for line in first.resolved.splitlines() if line[:1].isalpha()]
            keys = [line if "format" in line else line.partition(":")[0] for line in lines]
            rows[name] = [run.published, run.assumed, len(first.case_id), keys] + [
                (
                    numbers.setdefault(case.case_id, len(numbers)),
                    case.recording,
                    case.name,
                    case.swept,
                    case.frames,
                    plain_content(case.estimator),
                )
                for case in run.cases
            ]
        disk.folder.joinpath("small.h5").write_bytes(b"no recording")
        for recordings in ("[small.h5]", "[small.h5, second/other.h5]"):
            read = partial(lp.read_run, disk.run(RUN.replace("[small.h5]", recordings)))
            rows[recordings] = str(
                reason(lambda read=read: [case.name for case in read().cases])
            ).replace(folder, "")
    return rows


def executors_row() -> dict[str, Any]:
    """Executors of this machine, files of a cluster, and results of tasks of which one fails."""
    names = ("ca.pem", "me.pem", "me.key")
    tasks = ["1 + 1", "1 / 0", "2 + 2"]
    steps = list[tuple[int, int]]()
    tls = Tls(*names)
    clusters = (
        Dask(address="tls://a:1"),
        Dask(address="tcp://a:1", tls=tls),
        Dask(tls=tls),
        Dask(address="tls://a:1", tls=tls),
    )
    known: dict[str, Any] = {"executor": Serial(), "on_done": lambda *step: steps.append(step)}
    with tempfile.TemporaryDirectory() as folder:
        for name in (*names, "address.json"):
            (Path(folder) / name).touch()
        cluster = Dask(scheduler_file="address.json", tls=tls)
        sentences = [str(reason(partial(cluster.beside, Path(folder))))]
        (Path(folder) / "me.key").unlink()
        sentences += [
            str(reason(partial(cluster.beside, Path(folder) / part))) for part in ("", "me.pem")
        ]
    return {
        "beside": [text.replace(folder, "") for text in sentences],
        "ready": [reason(each.ready) for each in clusters],
        "local": [
            str(local(*counts, separate=apart))
            for counts in ((1, 9), (4, 9), (4, 3), (None, 1), (None, 0))
            for apart in (False, True)
        ],
        "results": [str(outcome) for _, outcome in Serial().results(eval, tasks)],
        "steps": steps,
        "each": each_of(eval, tasks, lost=lambda task, error: f"{task}: {error}", **known),
        "first error": [
            str(reason(partial(each_of, eval, chosen, **known))) for chosen in (tasks[::2], [])
        ],
    }


RAISED: tuple[Callable[[], Any], ...] = (
    lambda: lp.Huber(corner=-1.0),
    lambda: check_range("share", 3.0, 0, 1),
    lambda: lp.Recording.load("none.h5"),
    lambda: np.linalg.inv(np.zeros((2, 2))),
    lambda: 1 / 0,
    lambda: float("no number"),
    lambda: {}["key"],
    lambda: Path("none").read_text(),
    lambda: interrupted_by(KeyboardInterrupt()),
    lambda: interrupted_by(OSError()),
)


def interrupted_by(cause: BaseException) -> None:
    raise SystemError("in compiled code") from cause


def process_row() -> dict[str, Any]:
    """Words on errors and sizes, errors in a log, and memory that may be taken."""
    rows: dict[str, Any] = {
        "sizes": [in_bytes(10.0**n) for n in range(14)],
        "reasons": [],
        "memory": [],
    }
    with (
        tempfile.TemporaryDirectory() as folder,
        chdir(folder),
        patch.dict(os.environ, {"LAMPEST_LOG": "log"}),
    ):
        with libraries_to_the_log():
            for function in RAISED:
                try:
                    function()
                except Exception as error:
                    rows["reasons"].append([logged_reason(error, "a case"), interrupted(error)])
            with warnings.catch_warnings():
                warnings.simplefilter("default")
                warnings.warn("of a library", stacklevel=1)
            rows["during"] = logging.getLogger("py.warnings").propagate
        log = Path("log").read_text().splitlines()
        rows["log"] = [line for line in log if "Error: " in line]
        rows["during"] = rows["during"], sum("of a library" in line for line in log)
        loggers = logging.getLogger("lampest"), logging.getLogger("py.warnings")
        rows["after"] = [(logger.propagate, len(logger.handlers)) for logger in loggers]
        for setting in ("8GB", "500", "1.5 MiB", "3t", "0", "x", "-1", "1 GB 2"):
            with patch.dict(os.environ, {ALLOWED: setting}):
                rows["memory"].append(
                    [reason(memory_limit), reason(partial(check_memory, 2e9, "all cells"))]
                )
        with (
            patch.dict(os.environ, clear=True),
            patch("psutil.virtual_memory", lambda: SimpleNamespace(available=9e4)),
        ):
            rows["memory"].append(memory_limit())
        scene = lp.Scene(lp.Panel(2, 3), lp.TwoPointReadout())
        for speed in (None, 9.0):
            moving = lp.Simulation(
                1, 2, scene, frames=2, unmodelled=lp.Unmodelled(load_speed_mm_s=speed)
            )
            with patch.dict(os.environ, {ALLOWED: "1"}):
                rows["memory"].append(reason(partial(lp.simulate, moving)))
        Path("mine").touch()
        with sparing([Path("gone"), Path("read"), Path("\0")]):
            Path("read").touch()
            rows["outputs"] = [
                reason(partial(check_output, Path(name)))
                for name in ("mine", "read", "new", "", "..")
            ]
    return rows


def of_runs() -> Rows:
    rows: Rows = {f"faults of {command}": partial(faults_row, command) for command in FAULTS}
    rows |= {
        "refused commands": commands_row,
        "processes": process_row,
        "damaged files": damaged_row,
    }
    return rows | {"run files": runs_row, "executors": executors_row}
