"""Rows of whole pages, of long recordings and of large panels, under lowered limits."""

import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, chdir, contextmanager
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any
from unittest.mock import patch

import h5py
import numpy as np
from golden.circuits import PANEL, Rows, cells_of
from golden.content import of_kind
from golden.estimates import simulated
from golden.numerics import COSTS, TINY, certificate_row, point, solver_row
from golden.outputs import invented
from golden.runs import reason
from support import invented_case
from typer.main import get_command

import lampest as lp
from lampest.apps.page import compared, page
from lampest.cli import program
from lampest.cost import problem
from lampest.cost.cost import Cost
from lampest.cost.given import Background
from lampest.estimate.estimator import Estimator
from lampest.files import hdf5
from lampest.files.checksums import lookup3
from lampest.files.errors import InputError
from lampest.recording import simulation
from lampest.report.info import checked_sentence, describe
from lampest.runs.case import ATTRIBUTES, REQUIRED, all_columns
from lampest.runs.columns import FRAMES, Column
from lampest.solvers import interior_point, projected_newton
from lampest.solvers.bounds import bounds_matter
from lampest.solvers.certificate import certificate
from lampest.solvers.hessian import Hessian, Smoothing

# Large panels and long recordings


@contextmanager
def limits(**values: int) -> Iterator[None]:
    """Other limits, `module__NAME` for each, so that small examples count as large ones."""
    with ExitStack() as stack:
        for name, value in values.items():
            module, _, constant = name.rpartition("__")
            stack.enter_context(patch(f"lampest.{module.replace('__', '.')}.{constant}", value))
        yield


@contextmanager
def large() -> Iterator[None]:
    """No matrices over the cells."""
    point.cache_clear()
    with limits(
        solvers__hessian__DENSE_CELLS=2,
        solvers__hessian__MATRIX_CELLS=2,
        solvers__certificate__DENSE_CELLS=2,
        solvers__certificate__MAX_DENSE=2,
        posterior__track__MAX_DENSE=2,
        posterior__linear__MAX_DENSE=2,
    ):
        yield
    point.cache_clear()


def as_large(row: Callable[..., Any], *known: Any) -> Any:
    with large():
        return row(*known)


def exact_row() -> Any:
    """Certificates where all readings are met exactly, and where bounds prevent this."""
    known = point("plain")
    partly = point("penalty")
    near = known.elsewhere(known.cell_resistance)
    met = replace(
        near, data=replace(near.data, given=replace(near.data.given, measured=near.reading))
    )
    proof = certificate(
        Hessian(met.elsewhere(near.cell_resistance), Smoothing(1.0, near.nonsmooth))
    )
    held = []
    slope = np.full(partly.cell_resistance.shape, 1e9)
    for place, share in product(((1, 3), (0, 0), (2, 1)), (0.8, 1.2)):
        lower = np.ones(slope.shape)
        lower[0][place] = partly.cell_resistance[0][place]
        given = replace(partly.data.given, measured=share * partly.data.measured)
        trial = replace(partly, data=replace(partly.data, given=given, lower=lower)).elsewhere(
            partly.cell_resistance
        )
        held += [
            bounds_matter(trial, sign * slope, np.zeros(len(trial.nonsmooth)))
            for sign in (1.0, -1.0)
        ]
    return [proof.definiteness, bool(np.abs(proof.step).max() < 1e-9), held]


def noisy_start(seed: int) -> problem.Evaluation:
    """The readings' own start where their noise is three times their size.

    The noise is so large that most cells stand at a bound.
    """
    scene = TINY["whole"]
    rng = np.random.default_rng(seed)
    exact = scene.circuit.exact_reading(cells_of(PANEL.shape))
    value = np.maximum(exact * (1 + 3 * rng.standard_normal(PANEL.shape)), 10.0)[None]
    estimator = Estimator((lp.Misfit(),), "reduced")
    data = estimator.data(lp.Readings.of(scene, value, 3 * exact[None]), Background(scene))
    return problem.Evaluation.at(estimator.cost(scene, 1, partial=data.partial), data, data.start())


def barrier_row() -> Any:
    """The interior-point method from starts with most cells at a bound."""
    with large():
        begin = point("plain")
        data = replace(
            begin.data,
            lower=np.full(begin.data.lower.shape, 1200.0),
            upper=np.full(begin.data.upper.shape, 4500.0),
        )
        cells = np.where(np.indices(PANEL.shape).sum(axis=0) % 5 > 0, 1200.0, 4000.0)[None]
        start = replace(begin, data=data).elsewhere(cells)
        barrier = interior_point.Barrier.of(start)
        ahead = [barrier := barrier.advanced() or barrier for _ in range(3)]
        end, steps = interior_point.central_path(start)
        noisy = interior_point.Barrier.of(noisy_start(6))
        path = []
        while len(path) < 21:
            noisy = noisy.advanced() or noisy
            path.append((noisy.mean, noisy.length, noisy.added))
        own = barrier.hessian.own.reshape(barrier.conductance.shape) / barrier.conductance**2
        pressed = (
            np.where(np.indices((2, *barrier.conductance.shape)).sum(axis=0) % 4 > 0, 0.9, 1.1)
            * own
            * barrier.distances
        )
        steep = [
            np.where(np.arange(20).reshape(cells.shape) < count, 1200.0, 2000.0)
            for count in (9, 10)
        ]
        open_end = replace(data, upper=np.full(cells.shape, np.inf))
        points = [start.elsewhere(each) for each in steep] + [replace(start, data=open_end), end]
        points += [
            problem.Evaluation.at(point(cost).cost, data, cells) for cost in ("ohm", "absolute")
        ]
        points += [
            problem.Evaluation.at(
                Cost(PANEL, (lp.Misfit(loss=lp.Huber(corner=30.0)),)), data, cells
            )
        ]
        return {
            "crowded": [projected_newton.crowds_bounds(at) for at in (begin, start, *points)],
            "steps": steps,
            "cells": end.cell_resistance,
            "objective": end.objective,
            "mean": [each.mean for each in ahead],
            "multipliers": [each.multipliers for each in ahead],
            "length": [each.length for each in ahead],
            "merit": [each.merit(0.1) for each in ahead],
            "added": [each.added for each in ahead],
            "bounds": [
                at.put_at_bounds().cell_resistance
                for at in (barrier, replace(barrier, multipliers=pressed))
            ],
            "noisy": path,
            "of noise": interior_point.central_path(noisy_start(4))[0].cell_resistance,
        }


# Pages and figures


def report_row() -> dict[str, Any]:
    """The page of a comparison, with the content of every picture in its place."""
    recordings = {
        name: {case.estimator: case for case in lp.Results(invented()).of(name)}
        for name in ("mouth", "second")
    }
    batches = {
        "two": compared.Batch(("a.h5",) * 6, recordings),
        "one": compared.Batch(("b.h5",), {"a0": {"LSM": invented_case("LSM", "a0", (3, 4, 5))}}),
        "many": compared.Batch.of(
            ("c.h5",), [invented_case(*of, (2, 2, 2)) for of in product("AB", "abcdefgh")]
        ),
    }
    drawn: list[Any] = []

    def noted(plot: Any, cases: Any) -> str:
        drawn.append([plot.kind, getattr(plot, "frame", None), [case.estimator for case in cases]])
        return ""

    pages = {}
    with ExitStack() as stack:
        for kind in (page.ContourPlot, page.CertaintyPlot, page.ResidualPlot):
            stack.enter_context(patch.object(kind, "draw", noted))
        stack.enter_context(patch.object(page, "data_uri", lambda _: "data:"))
        for name, batch in batches.items():
            text = page.report(batch)
            pages[name] = re.sub(r'href="data:[^"]*|<style>.*?</style>', "…", text, flags=re.S)
    return {"pages": pages, "drawn": drawn}


# Simulation files

SCENE = "seed: 4\nbaseline_frames: 1\nframes: 1\nscene: {panel: {rows: 2, columns: 3}}\n"
LOAD = "loads: [{{kind: rod, centre_mm: [9, 5], diameter_mm: {}, mass_g: {}}}]\n"
SIMULATIONS = {
    "plain": "",
    "named": "output: n{seed}_{case:02d}.h5\n",
    "swept": "output: s{case:03d}_{frames}.h5\nsweep: {frames: [1, 2]}\n",
    "drawn": "cells: {resistance_ohm: {uniform: [1000, 3000]}, spread: 0.1}\n",
    "drawn twice": LOAD.format("{uniform: [8, 15]}", "{uniform: [1, 50]}"),
    "swept load": (
        LOAD.format(9, 1)
        + "output: '../made/s{seed:03d}_{mass_g}.h5'\nsweep: {seed: [1, 2], loads.0.mass_g: [50, "
        "60]}\n"
    ),
    "several without names": "sweep: {frames: [1, 2], cells.resistance_ohm: [900, 1000.0]}\n",
    "in folders": "output: '{frames}/s.h5'\nsweep: {frames: [1, 2]}\n",
    "swept badly": "sweep: {frames: 2}\n",
    "swept by nothing": "sweep: {frames: []}\n",
}


def simulation_files_row(text: str) -> dict[str, Any]:
    """Recordings of a simulation file, by default, to one file and to a folder."""
    rows: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        for name in ("here", "files"):
            Path(name).mkdir()
        file = Path("files/sim.yaml")
        file.write_text(SCENE + text + "schema: 1\n")
        for out in (None, "one.h5", "here"):
            try:
                written = [
                    (path, lp.Recording.load(path))
                    for path in simulation.run(file, out and Path(out))
                ]
                rows[str(out)] = [
                    (
                        str(path).replace(folder, ""),
                        made.recorded,
                        is_made_again(made),
                        re.findall(r".*\d\.\d{3}.*", str(made.simulation)),
                    )
                    for path, made in written
                ]
            except InputError as error:
                rows[str(out)] = str(error)
    return rows


def is_made_again(recording: lp.Recording) -> bool:
    """Return whether the simulation that a recording's file holds makes the same recording."""
    Path("again.yaml").write_text(str(recording.simulation))
    ((_, repeated),) = lp.read_simulations(Path("again.yaml"))
    return np.array_equal(lp.simulate(repeated).recorded, recording.recorded)


# Declarations


PROBED = (1.0, 0.0, -1.0, np.nan, np.inf, 1e300)


def columns_row() -> dict[str, Any]:
    """Every column of results, and how figures and attributes are stored."""
    rows: dict[str, Any] = {"required": REQUIRED, "attributes": str(ATTRIBUTES), "refused": []}
    for name, axes, flag in product(
        ("mine", "my own", "größe", "time", "", "scene", "row", "cost", "a/b"),
        (FRAMES, ("time", "row"), ("column", "row")),
        ("yes", "not so", "größer"),
    ):
        try:
            Column(name, axes, "1", "a value", flags=((1, flag),))
        except InputError as error:
            rows["refused"].append(str(error))
    rows["twice"] = reason(
        lambda: all_columns((Column("cell_resistance", FRAMES, "1", "a value"),))
    )
    for column in all_columns():
        tried = [
            (np.array([value]), np.array([solved]))
            for value, solved in product(PROBED, (True, False))
        ]
        checks = [
            [check(*values) for check in column.checks]
            for values in tried
            if np.dtype(column.dtype).kind == "f"
        ]
        rows[column.name] = (
            checks,
            {
                key: re.sub(" at 0x[^>]*", "", str(value))
                for key, value in vars(column).items()
                if key != "values"  # which no declaration has
            },
        )
    return rows


PARTS = ("opts", "default", "required", "is_flag", "multiple", "nargs", "help", "hidden")


def command_line_row(command: Any) -> Any:
    """Every command with its arguments, their defaults and limits."""
    if hasattr(command, "commands"):
        return {name: command_line_row(each) for name, each in command.commands.items()}
    return command.help, {
        parameter.name: [
            *(str(getattr(parameter, part, "")) for part in PARTS),
            *(str(getattr(parameter, part, "")) for part in ("min", "max", "type")),
        ]
        for parameter in command.params
    }


STORED = ("shape", "dtype", "chunks", "compression", "shuffle", "fletcher32", "maxshape")


def files_row() -> dict[str, Any]:
    """How recordings and results are stored: types, chunks, filters and attributes."""
    stored: dict[str, Any] = {"superblock": lookup3(bytes(range(48)))}

    def noted(path: str, node: Any) -> None:
        known = {
            key: str(value)
            for key, value in sorted(node.attrs.items())
            if not any(part in key for part in ("LIST", "crc", "sha256"))
        }
        scales = [[scale.name for scale in axis.values()] for axis in getattr(node, "dims", ())]
        places = node[()] if path[-2:] in ("/x", "/y") else None
        storage = [str(getattr(node, part, "")) for part in STORED]
        stored[node.file.filename + " " + path] = [*storage, known, scales, places]

    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        simulated(frames=30).save("recording.h5")
        lp.write_results(Path("results.h5"), invented()[:1])
        for name in ("recording.h5", "results.h5"):
            with h5py.File(name) as file:
                file.visititems(noted)
            stored[f"{name} checked"] = re.sub(r"\d+ bytes", "…", checked_sentence(Path(name)))
            shutil.copy(name, "changed.h5")
            with h5py.File(name, "a", libver=("v110", "v110")) as file:
                file["beside"] = "not by lampest"
            with h5py.File("changed.h5", "a") as file:
                file.create_group("beside")
            Path("longer.h5").write_bytes(Path("changed.h5").read_bytes() + b"x")
            stored[f"{name} longer"] = reason(partial(checked_sentence, Path("longer.h5")))
            stored[f"{name} changed"] = (
                checked_sentence(Path(name)),
                list(describe(name)),
                checked_sentence(Path("changed.h5")),
            )
    return stored


def chunks_row() -> dict[str, Any]:
    """Packing of few and many, smooth and noisy values: 128 values decide, spread over all."""
    rng = np.random.default_rng(1)
    noise = rng.standard_normal((9, 4, 8))
    halves = np.round(rng.standard_normal((9, 4, 8)), 1)
    halves[:, ::2] = 0.0
    values = {
        "few": np.zeros(64),
        "none": np.float64(3.0),
        "long": np.zeros(65),
        "frames": noise[:, :, :5],
        "noise": noise,
        "wide": np.ones((3, 100)),
        "halves": halves,
        "counts": rng.integers(0, 2**40, 100),
        "first frames": np.zeros((160, 7)),
        "first values": np.zeros((2, 2048)),
        "plain": np.ones((8000, 0)),
    }
    values["first frames"][:16] = noise[:4].reshape(-1, 8)[:16, :7]
    values["first values"][:, :512] = rng.standard_normal((2, 512))
    stored: dict[str, Any] = {}
    with (
        h5py.File("memory", "w", driver="core", backing_store=False) as file,
        limits(files__hdf5__CHUNK=70),
    ):
        for name, array in values.items():
            hdf5.write_dataset(file, name, array, "1", name, further="w" * 4000, more="w" * 4001)
            node = file[name]
            equal = np.array_equal(node, array)
            stored[name] = [
                equal,
                *(str(getattr(node, part)) for part in STORED),
                sorted(node.attrs),
            ]
    return stored


def of_whole() -> Rows:
    return (
        {
            f"solve large {cost}": partial(as_large, solver_row, cost, "whole", "newton")
            for cost in COSTS
        }
        | {
            f"point large {cost}": of_kind(
                "sampled", partial(as_large, certificate_row, cost, "whole", 0.0)
            )
            for cost in COSTS
        }
        | {
            f"simulation {name}": partial(simulation_files_row, text)
            for name, text in SIMULATIONS.items()
        }
        | {
            "exact readings": exact_row,
            "exact readings large": partial(as_large, exact_row),
            "files": files_row,
            "interior point": barrier_row,
            "report": report_row,
            "columns": columns_row,
            "chunks": chunks_row,
            "command line": lambda: command_line_row(get_command(program.app)),
        }
    )
