"""Rows of studies."""

import csv
import tempfile
from collections.abc import Callable
from contextlib import chdir
from dataclasses import replace
from functools import partial
from itertools import product
from math import nan
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
from golden.circuits import Rows
from golden.estimates import simulated
from golden.numerics import point
from golden.outputs import command, drawn_row, refusal, stored

import lampest as lp
from lampest.apps.studies import bench, common, extreme_scenes, extremes, tradeoff
from lampest.apps.studies.bench import Bench, BenchFile, BenchFrame, run_bench
from lampest.apps.studies.certified import (
    correct_digits,
    exact_cost,
    exact_residual,
    exact_scale,
    fifty_digits,
)
from lampest.apps.studies.common import StudyMethod
from lampest.apps.studies.study import Study, read_settings
from lampest.runs import config


def timed(made: type[Any], **known: Any) -> list[Any]:
    """Frames that took some time, of two solvers, two methods and four panels."""
    frames = []
    for side, method, solver, frame in product(
        (32, 48, 64, 8), ("LSM", "LSR-CR"), ("reduced", "nodal"), (0, 1, 2)
    ):
        seconds = (
            1e-3
            * side**1.5
            * (1 + frame / 10)
            * (3 if solver == "nodal" else 1)
            * (1.2 if method == "LSM" else 1)
        )
        about = {
            "rows": side,
            "columns": side,
            "recording": "0",
            "method": method,
            "solver": solver,
            "frame": frame,
            "seconds": seconds,
        }
        about |= {
            "objective": 1.0,
            "gap": 1e-7 * frame * (solver == "nodal"),
            "iterations": 4 + frame,
            "status": "local optimum verified",
        }
        frames.append(
            made(
                **about,
                solved=frame < 2 or solver == "reduced",
                **{name: value(side, frame) for name, value in known.items()},
            )
        )
    return frames


def timed_bench() -> Bench:
    """A benchmark in which frames failed or have no gap."""
    frames = timed(
        BenchFrame,
        kind=lambda side, frame: "later" if frame else "first",
        inverse_s=lambda side, frame: 1e-6 * side**2,
    )
    pair = replace(frames[0], rows=9, kind="pair")
    frames += [pair, replace(frames[0], rows=9), replace(frames[1], rows=9, gap=nan)]
    settings = BenchFile(schema=1, sizes=(8, 16, (30, 20)), frames=2)
    return Bench(settings, tuple(frames))


def timed_tradeoff() -> list[tradeoff.TradeoffFrame]:
    """Frames of formulations, with a failed frame and a panel whose errors are unknown."""
    frames = timed(
        tradeoff.TradeoffFrame,
        baseline_s=lambda side, frame: 0.1,
        cell_error=lambda side, frame: side / 9 + frame,
        changed_error=lambda side, frame: side / 5,
    )
    bare = [
        replace(frame, rows=3, changed_error=nan, cell_error=nan, gap=0.0, seconds=0.1)
        for frame in frames[:6]
    ]
    return [
        *frames,
        *bare,
        replace(frames[1], recording="1", gap=nan, cell_error=nan, solved=False),
    ]


def judged_solves() -> list[extremes.Solve]:
    """Solves that are verified, doubtful, worse than the truth, refused and crashed."""
    known = {
        "case": extreme_scenes.GRID,
        "rows": 3,
        "columns": 4,
        "decades": 6.0,
        "noise": 0.01,
        "seed": 0,
        "part": "frame",
        "method": "LSM",
        "formulation": "reduced",
        "solved": True,
        "status": "local optimum verified",
        "iterations": 4,
        "residual": 1e-9,
        "audited": 2e-9,
        "excess": -1.0,
        "model_digits": 11.0,
        "forward_digits": 12.0,
    }
    changes: tuple[dict[str, Any], ...] = (
        {},
        {"audited": 1e-3, "residual": 1e-10, "excess": 1e-3, "model_digits": 9.5, "iterations": 10},
        {
            "solved": False,
            "status": "stopped",
            "model_digits": nan,
            "forward_digits": 9.0,
            "iterations": 7,
        },
        {"solved": False, "status": f"{extremes.CRASHED}KeyError: no", "residual": 1.0},
        {"solved": False, "status": f"{extremes.REFUSED}a number: 3"},
        {"decades": 7.0},
        {"case": "open cell", "decades": 0.0},
        {"case": "open cell", "decades": 0.0, "noise": 0.1},
    )
    return [extremes.Solve(**known | change) for change in changes]


def numbers_of(path: Path) -> list[list[Any]]:
    """Lines of a table as text, numbers as numbers."""

    def field(text: str) -> Any:
        try:
            return float(text)
        except ValueError:
            return text

    with path.open(encoding="utf-8", newline="") as lines:
        return [[field(text) for text in line] for line in csv.reader(lines)]


MEASURED: dict[str, tuple[Study[Any, Any], Callable[[], Any]]] = {
    "bench": (bench.STUDY, timed_bench),
    "tradeoff": (tradeoff.STUDY, timed_tradeoff),
    "extremes": (extremes.STUDY, judged_solves),
}
METHODS = {
    "LSM": StudyMethod(config.Terms(misfit=lp.Misfit())),
    "LSR-dCR": StudyMethod(
        config.Terms(misfit=lp.Misfit(), relative_change=lp.RelativeChange(weight=10.0))
    ),
}


def study_files_row(name: str) -> dict[str, Any]:
    """Every file of a study of given measurements, and the words of its command."""
    study = MEASURED[name][0]
    measured = MEASURED[name][1]()
    known = replace(study, read=lambda *_: None, measure=lambda *_: measured, figures=lambda _: {})
    module = {"bench": bench, "tradeoff": tradeoff, "extremes": extremes}[name]
    with (
        tempfile.TemporaryDirectory() as folder,
        chdir(folder),
        patch.object(module, "STUDY", known),
    ):
        Path("file.yaml").touch()
        printed = command("study", name, "file.yaml")
        files = sorted(Path("results/file").iterdir())
        kinds = {".h5": stored, ".csv": numbers_of, ".md": Path.read_text}
        return {"printed": printed} | {path.name: kinds[path.suffix](path) for path in files}


def bench_row() -> dict[str, Any]:
    frames = timed_bench().frames
    settings = timed_bench().settings
    return {
        "rows": [vars(row) for row in bench.bench_rows(frames)],
        "solvers": settings.solvers((16, 16)),
        "wired": replace(settings, lines=lp.Lines(1.0)).solvers((16, 16)),
        "recorded": [settings.recording((4, 5), number).recorded for number in (0, 1)],
        "loads": [bench.loads(number, (9, 9)) for number in range(5)],
    }


def tradeoff_row() -> dict[str, Any]:
    frames = timed_tradeoff()
    recording = simulated()
    measured = recording.measured_frames()
    factors = 1 + np.arange(20.0).reshape(4, 5) / 100
    cells = factors * recording.truth_cell_resistance[measured]
    untared = replace(recording, role=np.ones_like(recording.role))
    known = [
        SimpleNamespace(recording=each, frame=measured, cell_resistance=cells)
        for each in (recording, untared, replace(recording, truth_cell_resistance=None))
    ]
    return {
        "figure": drawn_row(tradeoff.tradeoff_figure(tradeoff.ladder_rows(frames, "method"))),
        "pareto": tradeoff.front([(1.0, 3.0), (2.0, 1.0), (3.0, 2.0), (0.5, 9.0)]),
        "errors": [tradeoff.errors(each) for each in known],
    }


# The time of an inverse, whose measurement takes longer than small solves.
IN_NO_TIME = {"inverse_time": lambda matrix: 1e-6}


def runs_row() -> dict[str, Any]:
    """A tiny run of the study of solvers, without its times."""
    settings = {"LSM": METHODS["LSM"]}
    file = BenchFile(schema=1, sizes=(3,), frames=2, repeats=1, estimators=settings)
    steps: list[tuple[int, int]] = []
    with patch.multiple(bench, **IN_NO_TIME):
        measured = run_bench(file, lambda done, total, *_: steps.append((done, total)))
    names = ("frame", "solver", "kind", "objective", "gap", "solved")
    return {
        "frames": [
            {name: getattr(each, name) for name in names if hasattr(each, name)}
            for each in measured.frames
        ],
        "steps": steps,
    }


def extremes_row(case: str) -> dict[str, Any]:
    shape = (extreme_scenes.CASES[case].shapes or ((3, 4),))[0]
    sample = extreme_scenes.AtlasSample(
        case, *shape, 5.0 * extreme_scenes.CASES[case].contrasted, 0.01, 3
    )
    recording, cells = extreme_scenes.recording_of(sample)
    if shape[0] * shape[1] > 20:
        return {"recorded": recording.recorded, "cells": cells}
    method = {
        "mine": StudyMethod(config.Terms(misfit=lp.Misfit(), gradient=lp.Gradient(weight=1e-3)))
    }
    atlas = extremes.AtlasFile(
        1, extreme_scenes.Grid((3,)), extreme_scenes.Grid(()), estimators=method
    )
    solves = extremes.solves_of(atlas, sample)
    outcomes = [
        (
            each.part,
            each.status,
            each.verified,
            each.forward_digits > 9,
            each.excess < 1e-6,
            extremes.mild(each),
        )
        for each in solves
    ]
    return {
        "recorded": recording.recorded,
        "sigma": recording.sigma,
        "cells": cells,
        "solves": outcomes,
        "remarks": extremes.atlas_remarks(solves),
    }


SIDES = ((10, 9), (11, 3), (3, 16), (16, 16), (17, 3), (4, 17), (1000, 1000), (1001, 1))


def settings_row() -> dict[str, Any]:
    """Panels, methods and scenes that files of studies name, and files that are refused."""
    file = tradeoff.TradeoffFile(1, ("a.h5",))
    atlas = extremes.AtlasFile(
        1,
        extreme_scenes.Grid((2, (3, 4)), (1.0, 9.0), (0.0, 10.0), seeds=2),
        extreme_scenes.Grid((3,), (6.0,), (1.0,)),
        nodal=extreme_scenes.Grid((2, 3), (1.0,), (0.0, 1.0)),
    )
    scenes = tradeoff.Simulated(sizes=(8, (9, 10)), diameter_mm=28.0, seed=5).simulations(2)
    return {
        "rungs": [[*file.rungs(shape)] for shape in SIDES],
        "methods": [file.methods(shape) for shape in SIDES],
        "scenes": [
            (name, each.scene.panel.shape, each.loads, each.seed, each.frames)
            for name, each in scenes
        ],
        "first": [common.first_frames(simulated(), number).time for number in (2, 3)],
        "too few": refusal(common.first_frames, simulated(), 1),
        "shipped": len(read_settings(extremes.AtlasFile)(common.CONFIGS / "extremes.yaml").samples),
        "atlas": [(*vars(each).values(), *atlas.formulations(each)) for each in atlas.samples],
    }


def digits_row() -> dict[str, Any]:
    """Numbers of fifty digits, and how many digits others have in common with them."""
    cells = np.array([[1.0, 2.0], [3.0, np.inf]])
    points = [
        (at.cost, at.data, at.cell_resistance)
        for at in (point("plain"), point("ohm"), point("change", frames=2))
    ]
    pairs = (
        (1.0, 1.0),
        (1.0, 1 + 1e-6),
        (1.0, 3.0),
        (np.inf, np.inf),
        (0.0, 0.0),
        (np.nan, 1.0),
        (1.0, np.nan),
    )
    return {
        "costs": [
            [each(*at) for at in points] for each in (exact_cost, exact_scale, exact_residual)
        ],
        "readings": [
            fifty_digits(each)
            for each in (cells, np.where(cells == 2, 0.0, cells), np.diag([1.0, np.nan]))
        ],
        "digits": [
            correct_digits(np.array([1.0, value]), np.array([1.0, known])) for known, value in pairs
        ],
    }


def of_studies() -> Rows:
    rows: Rows = {f"extremes {case}": partial(extremes_row, case) for case in extreme_scenes.CASES}
    rows |= {f"files of {name}": partial(study_files_row, name) for name in MEASURED}
    rows |= {
        "bench": bench_row,
        "tradeoff": tradeoff_row,
        "settings": settings_row,
    }
    return rows | {
        "runs": runs_row,
        "digits": digits_row,
    }
