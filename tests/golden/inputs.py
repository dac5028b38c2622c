"""Rows of inputs: arrays in Python, and the ranges of all public configurations."""

import re
import tempfile
from dataclasses import fields, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from golden.circuits import CONTACTS, FILM, MODULES, PER_LINE, RESPONSES, SHAPES, Rows, scenes
from golden.estimates import COURSE

import lampest as lp
from lampest.apps.studies import bench, extreme_scenes, tradeoff
from lampest.files.errors import InputError
from lampest.runs import executors

# Arrays

VALUES = np.random.default_rng(7).uniform(250, 600, (4, 2, 3)).round(1)


def python_row() -> dict[str, Any]:
    """Arrays in Python in every unit, and why others are none."""
    rows: dict[str, Any] = {}
    scenes_of = {"none": None, "ohm": lp.TwoPointReadout(), "volt": lp.LoadedColumnsReadout()}
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "scene.yaml").write_text(
            "panel: {rows: 2, columns: 3}\nreadout: {kind: two_point}\n"
        )
        for (name, readout), (unit, scale), (way, options) in product(
            scenes_of.items(), SCALES.items(), HOW.items()
        ):
            scene = readout and lp.Scene(lp.Panel(2, 3), readout)
            known = {"values": scale * VALUES.round(), "unit": unit, "scene": scene} | options
            known["scene"] = (
                Path(folder) / "scene.yaml" if known["scene"] == "file" else known["scene"]
            )
            try:
                result = lp.Recording.from_array(**known)
                rows[f"{name} {unit} {way}"] = [
                    result.recorded[0],
                    result.time,
                    result.role,
                    result.scene.panel.rows,
                ]
            except InputError as error:
                rows[f"{name} {unit} {way}"] = str(error)
    return rows


SCALES = {"ohm": 1.0, "kohm": 1e-3, "volt": 5e-3, "mV": 5.0, "code": 1.0, "V": 1.0}
HOW: dict[str, dict[str, Any]] = {
    "alone": {},
    "two unloaded": {"baseline": 2},
    "five unloaded": {"baseline": 5},
    "times": {"time": [0, 1, 2, 4]},
    "two times": {"time": [0, 1]},
    "one frame": {"values": VALUES[0]},
    "one row": {"values": VALUES[:, :1]},
    "a word": {"values": "m.csv"},
    "a list": {"values": VALUES.tolist()},
    "scene of a file": {"scene": "file"},
}

# Ranges

DECADES = 10.0 ** np.arange(-12, 14)
PROBES = (*-DECADES[::-1], 0.0, *DECADES, np.nan, np.inf)


def configurations() -> dict[str, Any]:
    """One of every public configuration with numbers, by name."""
    public = {name: getattr(lp, name) for name in lp.__all__}
    known: dict[str, Any] = {}
    for name, kind in public.items():
        if hasattr(kind, "__pydantic_config__"):
            try:
                known[name] = kind()
            except (TypeError, ValueError):  # what has no default stands below
                continue
    examples = (
        lp.Huber(corner=3.0),
        lp.Student(corner=3.0),
        lp.Panel(3, 4),
        *SHAPES.values(),
        *RESPONSES.values(),
        FILM,
        lp.Temperature(-0.003, 20.0, 8.0),
        lp.Water(9.0),
        COURSE,
        CONTACTS,
        PER_LINE,
        MODULES.modules,
        lp.Simulation(1, 2, scenes()["noisy"]),
        lp.Scene(lp.Panel(2, 3)),
        executors.Processes(),
        executors.Dask(),
        bench.BenchFile(1, (3,)),
        extreme_scenes.Grid((3,)),
        tradeoff.TradeoffFile(1, ("a.h5",)),
    )
    return known | {type(example).__name__: example for example in examples}


def ranges_row(owner: Any) -> dict[str, Any]:
    """Which powers of ten each number of a configuration may be, and why not others."""
    rows = {}
    for field in fields(owner):
        if field.name == "own":  # keys of installed packages
            continue
        if field.init:
            signs = ""
            reasons = list[str]()
            for value in PROBES:
                number = int(value) if np.isfinite(value) and value == round(value) else value
                given = getattr(owner, field.name)
                try:
                    replace(
                        owner,
                        **{
                            field.name: (number, *given[1:]) if isinstance(given, tuple) else number
                        },
                    )
                    signs += "+"
                except (TypeError, ValueError, InputError, OverflowError) as error:
                    signs += "-"
                    reasons.append(re.sub(r"[^ ]*\d[^ ]*", "#", str(error)).split("\n")[0])
            rows[field.name] = [signs, list(dict.fromkeys(reasons))]
    return rows


def of_inputs() -> Rows:
    return {
        f"range {name}": partial(ranges_row, owner) for name, owner in configurations().items()
    } | {"arrays in Python": python_row}
