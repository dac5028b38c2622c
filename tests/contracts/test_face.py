"""The public face: every name is there, typed, and cheap until it is used."""

import ast
import doctest
import inspect
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from promises import promise
from support import invented_case

import lampest
from lampest import (
    CellResistance,
    Gradient,
    InputError,
    Misfit,
    Reconstruction,
    Recording,
    Scene,
    TotalVariation,
)

ROOT = Path(__file__).parents[2]
CLEARLY_BETTER = 0.3  # error by the automatic weight over that by the published one
MISFIT = [Misfit()]
# Names whose examples run files, in processes of their own, draw, or compare circuits.
WHOLE_RUNS = (
    "CaseResult",
    "Column",
    "Reconstruction",
    "Results",
    "comparison",
    "export_results",
    "plot_results",
    "read_results",
    "write_results",
)
NO_DATA = "gradient needs the term misfit: without it nothing reads what was measured"
NO_RECORDING = "recording must be a Recording, such as Recording.load('mine.h5'), not "
# What `reconstruct` is given, and what it says of it.
WRONG_CALLS: tuple[tuple[dict[str, Any], str], ...] = (
    (
        {"formulation": "fast"},
        "formulation: there is no 'fast'; there are per_pixel, nodal, reduced, auto, naive, ",
    ),
    (
        {"formulation": lampest.TruncatedMethod},
        "formulation must be a word or a method such as TruncatedMethod(), not the class "
        "TruncatedMethod",
    ),
    ({"solver": {"tolerance": 1e-3}}, "solver must be Settings(...), not a dict"),
    ({"bounds": {}}, "bounds must be Bounds(...), not a dict"),
    ({"auto_weight": "risk"}, "auto_weight must be AutoWeight(...), not 'risk'"),
    ({"error_bars": "yes"}, "error_bars must be 'auto', True or False, not 'yes'"),
    ({"terms": ["misfit"]}, "terms must hold objects such as Misfit(), not 'misfit'"),
    ({"terms": [Misfit]}, "terms must hold objects such as Misfit(), not the class Misfit"),
    ({"terms": Misfit()}, "terms must be a list such as [Misfit(), Gradient()], not a Misfit"),
    ({"terms": []}, "an estimator needs at least one term"),
    ({"terms": [Gradient()]}, NO_DATA),
    ({"terms": [Gradient(weight="auto")]}, NO_DATA),
    ({"recording": "data/ring.h5"}, f"{NO_RECORDING}'data/ring.h5'"),
    ({"recording": np.ones((3, 4, 5))}, f"{NO_RECORDING}a ndarray"),
)


@pytest.fixture(scope="module")
def lamprey() -> Recording:
    """The first seven frames, three of them unloaded."""
    return replace(Recording.load(ROOT / "data" / "lamprey_35mm.h5", slice(7)), raw_sums=None)


@pytest.fixture(scope="module")
def estimate(lamprey: Recording) -> Reconstruction:
    return lampest.reconstruct(
        lamprey, [Misfit(), Gradient(weight=np.float64(1e-3))], formulation="reduced"
    )


def test_every_public_name_exists_and_is_listed() -> None:
    assert set(lampest.__all__) <= set(dir(lampest))
    assert len(set(lampest.__all__)) == len(lampest.__all__)
    for name in (*lampest.__all__, "__version__"):
        assert getattr(lampest, name) is not None, name
    for kind in lampest.term_types().values():
        assert getattr(lampest, kind.__name__) is kind
    assert lampest.Estimator([Misfit()]) == lampest.Estimator((Misfit(),))
    with pytest.raises(AttributeError, match="no attribute 'reconstrcut'"):
        lampest.reconstrcut  # noqa: B018


SCRIPT = """\
import numpy as np

import lampest
from contracts.extensions import CONTRAST, Ellipse, Even, Histogram, Leash

scene = lampest.Scene(lampest.Panel(4, 5), lampest.TwoPointReadout(), series_resistance_ohm=140.0)
load = Ellipse(centre_mm=(20.0, 15.0), long_mm=30.0, short_mm=20.0, pressure_kpa=10.0)
rod = lampest.Rod(centre_mm=(10.0, 10.0), diameter_mm=20.0, mass_g=100.0)
recording = lampest.simulate(lampest.Simulation(schema=1, seed=1, scene=scene, loads=(load, rod)))
estimate = lampest.reconstruct(
    recording,
    [lampest.Misfit(), lampest.Gradient(weight="auto"), Leash(loss=lampest.Huber(corner=3.0))],
    formulation=Even(),
    solver=lampest.Settings(max_iterations=50),
    bounds=lampest.Bounds(upper="none"),
)
estimate.save("out.h5", columns=[CONTRAST])
estimate.plot(Histogram(), frame=4)
for case in lampest.read_results("out.h5").cases:
    reveal_type(case.cell_resistance)
reveal_type(estimate.cell_resistance_errors)
reveal_type(estimate.status)
reveal_type(estimate.to_xarray())
stream = lampest.Stream.begin(estimate.estimator, scene, 1.0, recording.readings()[0])
reveal_type(stream.push(recording.readings()[3]))
"""
REVEALED = (
    "numpy.ndarray[tuple[Any, ...], numpy.dtype[numpy.floating[Any]]]",
    "numpy.ndarray[tuple[Any, ...], numpy.dtype[numpy.floating[Any]]] | None",
    "tuple[str, ...]",
    "xarray.core.dataset.Dataset",
    "tuple[lampest.estimate.stream.Stream, lampest.estimate.state.Step]",
)
MISTAKES = (
    ("lampest.Recordign", 'has no attribute "Recordign"'),
    ("lampest.reconstruct(recording, lampest.Misfit())", 'incompatible type "Misfit"'),
    (
        'lampest.reconstruct(recording, [lampest.Misfit()], formulation="fast")',
        'incompatible type "Literal[',
    ),
    ("lampest.reconstruct(recording, [lampest.Misfit()], solver={})", "incompatible type"),
    (
        "lampest.reconstruct(recording, [lampest.Misfit()], tolerance=1)",
        'Unexpected keyword argument "tolerance"',
    ),
)


@pytest.mark.slow
def test_a_strict_type_checker_infers_the_types_of_a_script(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    wrong = tmp_path / "wrong.py"
    script.write_text(SCRIPT)
    wrong.write_text(
        "\n".join(["import lampest", "recording = lampest.Recording.load('x.h5')", *dict(MISTAKES)])
    )
    options = (
        "--strict",
        "--no-error-summary",
        "--hide-error-context",
        "--follow-imports=silent",
        "--no-pretty",
    )
    command = [sys.executable, "-m", "mypy", *options, script.name, wrong.name]
    variables = os.environ | {"MYPYPATH": os.pathsep.join((str(ROOT), str(ROOT / "tests")))}
    completed = subprocess.run(
        command, capture_output=True, text=True, timeout=300, cwd=tmp_path, env=variables
    )
    assert completed.stderr == ""
    diagnostics = [line.split(": ", 2) for line in completed.stdout.splitlines()]
    revealed = [
        text for place, kind, text in diagnostics if place.startswith("script") and kind == "note"
    ]
    assert [text.removeprefix('Revealed type is "').removesuffix('"') for text in revealed] == list(
        REVEALED
    )
    assert not [line for line in diagnostics if line[0].startswith("script") and line[1] == "error"]
    errors = {
        int(place.split(":")[1]) - 3: text for place, kind, text in diagnostics if kind == "error"
    }
    assert [
        number for number, (_, text) in enumerate(MISTAKES) if text not in errors.get(number, "")
    ] == []


@pytest.mark.parametrize(("given", "sentence"), WRONG_CALLS)
def test_wrong_use_gives_one_sentence(
    lamprey: Recording, given: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(InputError) as raised:
        lampest.reconstruct(**{"recording": lamprey, "terms": MISFIT} | given)
    assert isinstance(raised.value, ValueError) and str(raised.value).startswith(sentence)


def test_wrong_frames_weights_and_files_give_one_sentence(lamprey: Recording) -> None:
    estimator = lampest.Estimator((Misfit(),), "reduced")
    readings = lamprey.readings()
    stream = lampest.Stream.begin(estimator, lamprey.scene, 1.0, readings[:3].mean())
    for wrong, sentence in {
        lambda: Gradient(weight=-1): "Gradient: weight must be zero or positive, and finite",
        lambda: Gradient(
            weight="autos"
        ): "Gradient: weight: Input should be a valid number or 'auto', not 'autos'; did",
        lambda: Recording.load(
            "mine.csv"
        ): "mine.csv: is no recording; lampest.import_file (lampest import) makes one",
        lambda: stream.push(
            lamprey.resistance[3]
        ): "a stream takes Readings.of(scene, values), not a ndarray",
        lambda: stream.push(
            readings[3:5]
        ): "a stream takes one frame of 10 × 10 readings, not 2 × 10 × 10; of several,",
    }.items():
        with pytest.raises(InputError, match=f"^{re.escape(sentence)}"):
            wrong()
    with pytest.raises(InputError, match=r"less than the 140 ohm in series; are these kohm\?"):
        replace(lamprey, recorded=lamprey.recorded / 1000)


@pytest.mark.slow
def test_a_recording_and_a_reconstruction_print_one_line_each(
    lamprey: Recording, estimate: Reconstruction
) -> None:
    assert len(repr(lamprey).splitlines()) == len(repr(estimate).splitlines()) == 1
    assert estimate.weights.keys() == {"gradient"} and np.all(estimate.weights["gradient"] == 1e-3)
    shown = estimate._repr_html_()
    assert (
        "gradient: 0.001" in shown
        and "[[Cells in frame 6 at 6 s]]" in shown
        and 'src="data:image/' in shown
    )
    assert not {"ast", "annotations", "import_module", "Path"} & set(dir(lampest))
    assert not {"of", "asked", "tared"} & set(dir(estimate)) and {
        "cell_resistance",
        "fit_report",
    } <= set(dir(estimate))


@pytest.mark.slow
def test_saved_results_equal_the_arrays(estimate: Reconstruction, tmp_path: Path) -> None:
    estimate.save(tmp_path / "r.h5", name="mine")
    (case,) = lampest.read_results(tmp_path / "r.h5").cases
    assert (case.recording, case.estimator) == ("lamprey_35mm", "mine")
    assert "weight: 0.001" in case.case_yaml and len(case.case_id) == 24
    arrays = [
        "time",
        "status",
        "solved",
        "cell_resistance",
        "relative_change",
        "open_cell",
        "at_lower_bound",
    ]
    for name in ("cell_resistance", "relative_change", "pressure"):
        arrays += [f"{name}_errors", f"{name}_lower", f"{name}_upper"]
    for name in (
        *arrays,
        "pressure",
        "saturated",
        "resolution",
        "data_share",
        "baseline_resistance_errors",
        "reading_model",
        "solve_time",
    ):
        assert_array_equal(getattr(estimate, name), getattr(case, name), name)
    shape = (4, 10, 10)
    assert (
        estimate.pressure is not None
        and estimate.cell_resistance.shape == estimate.pressure.shape == shape
    )
    restored = estimate.result("mine")
    assert (restored.case_id, restored.case_yaml) == (case.case_id, case.case_yaml)


@promise("faq: Without noise there are no error bars.")
def test_estimates_without_noise_have_no_error_bars(lamprey: Recording) -> None:
    silent = replace(lamprey, scene=replace(lamprey.scene, readout=None))
    bare = lampest.reconstruct(
        silent, MISFIT, formulation="reduced", bounds=lampest.Bounds(upper="none")
    )
    for name in (
        "cell_resistance_errors",
        "relative_change_upper",
        "pressure",
        "saturated",
        "resolution",
    ):
        assert getattr(bare, name) is None
    assert "pressure" not in bare.to_xarray()
    assert "chi-square" not in bare.fit_report() and "[[Weights]]" not in bare.fit_report()
    hint = (
        r"holds no pressure to draw, which needs pressure.*; add .* to the scene, such as "
        r"response: \{kind: published\}"
    )
    with pytest.raises(InputError, match=hint):
        bare.plot("pressure")


@pytest.mark.slow
def test_labelled_arrays_agree_with_results_files(estimate: Reconstruction, tmp_path: Path) -> None:
    estimate.save(tmp_path / "r.h5")
    dataset = estimate.to_xarray()
    assert dict(dataset.sizes) == {"time": 4, "row": 10, "column": 10}
    assert_array_equal(dataset.time, estimate.time)
    table = estimate.to_dataframe()
    assert list(table.columns[:4]) == ["time", "frame", "row", "column"] and len(table) == 400
    assert_array_equal(table.cell_resistance, estimate.cell_resistance.ravel())
    units = table.attrs["units"]
    assert (units["cell_resistance"], units["pressure"], units["time"]) == ("ohm", "kPa", "s")
    assert_array_equal(dataset.x, 10.0 * np.arange(10))
    assert (
        dataset.x.dims == ("column",)
        and dataset.y.dims == ("row",)
        and dataset.x.attrs["units"] == "mm"
    )
    with h5py.File(tmp_path / "r.h5") as file:
        group = file["entry/lamprey_35mm/misfit + gradient"]
        for name in (
            "cell_resistance",
            "relative_change",
            "pressure",
            "status",
            "solved",
            "baseline_resistance",
        ):
            stored = group[name]
            variable = dataset[name]
            for attribute in ("units", "long_name"):
                assert variable.attrs[attribute] == stored.attrs[attribute].decode()
            if name != "status":
                assert_array_equal(variable, stored)
        assert_array_equal(dataset.cost_gradient, group["cost/gradient"])
    read = lampest.read_results(tmp_path / "r.h5").cases[0].to_xarray()
    assert read.identical(dataset)
    dataset.to_netcdf(tmp_path / "r.nc", engine="h5netcdf")
    assert (
        float(dataset.sel(time=5.0, row=3, column=4).cell_resistance)
        == estimate.cell_resistance[2, 3, 4]
    )


def test_errors_name_the_kind_of_a_file_and_a_missing_library(
    estimate: Reconstruction, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lampest.write_results(tmp_path / "r.h5", [invented_case()])
    with pytest.raises(InputError, match=r"r\.h5: holds results; lampest\.read_results reads them"):
        Recording.load(tmp_path / "r.h5")
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(
        InputError, match=r"^xarray is not installed; pip install 'lampest\[xarray\]' brings it$"
    ):
        estimate.to_xarray()


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] * (name in WHOLE_RUNS))
        for name in lampest.__all__
        if name not in ("Array", "Weight", "UNLOADED", "MEASURED")
    ],
)
def test_an_example_in_a_docstring_runs_after_import_lampest_alone(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each in a namespace of its own, as it is pasted, methods included."""
    monkeypatch.chdir(tmp_path)
    public = getattr(lampest, name)
    examples = doctest.DocTestFinder(recurse=inspect.isclass(public)).find(public, name)
    whole = next(example for example in examples if example.name == name)
    assert whole.examples, f"{name} has no example"
    for example in examples:
        example.globs = {"lampest": lampest}
        assert doctest.DocTestRunner(verbose=False).run(example).failed == 0


def test_progress_counts_all_frames() -> None:
    scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    recording = lampest.simulate(lampest.Simulation(schema=1, seed=1, scene=scene, frames=2))
    progress: list[tuple[int, int]] = []
    estimate = lampest.reconstruct(
        recording, [Misfit()], progress=lambda *frames: progress.append(frames)
    )
    assert progress == [(1, 2), (2, 2)] and estimate.solved.all()
    assert lampest.reconstruct(recording, [Misfit()], progress=True).solved.all()


@pytest.fixture(scope="module")
def few_frames() -> Recording:
    """The lamprey's unloaded frames and two later ones."""
    recording = lampest.datasets.load("lamprey_35mm")
    chosen = [0, 1, 2, 14, 15]
    parts = ("recorded", "time", "role", "truth_cell_resistance", "truth_pressure")
    return replace(
        recording, raw_sums=None, **{part: getattr(recording, part)[chosen] for part in parts}
    )


@promise("overview: Their weights are `auto` by default: the data choose them.")
def test_the_automatic_weight_is_better_than_the_papers_weight(few_frames: Recording) -> None:
    errors = {}
    for name, penalty in (("default", Gradient()), ("paper", Gradient(weight=1e-3))):
        estimate = lampest.reconstruct(few_frames, [Misfit(), penalty])
        errors[name] = np.median(
            np.abs(estimate.cell_resistance / few_frames.truth_cell_resistance[3:] - 1)
        )
    assert errors["default"] < CLEARLY_BETTER * errors["paper"]


@pytest.mark.slow
def test_unknown_noise_takes_the_same_rule(few_frames: Recording) -> None:
    silent = replace(
        few_frames,
        scene=Scene(few_frames.scene.panel, None, few_frames.scene.series_resistance_ohm),
    )
    estimate = lampest.reconstruct(silent, [Misfit(), Gradient()])
    explicit = lampest.reconstruct(
        silent, [Misfit(), Gradient()], auto_weight=lampest.AutoWeight(rule="risk")
    )
    assert estimate.solved.all() and np.array_equal(
        estimate.cell_resistance, explicit.cell_resistance
    )
    open_ended = lampest.reconstruct(
        silent, [Misfit(), Gradient()], bounds=lampest.Bounds(upper="none")
    )
    assert np.array_equal(estimate.cell_resistance, open_ended.cell_resistance)
    assert lampest.reconstruct(silent, [Misfit(), CellResistance(), TotalVariation()]).solved.all()


def test_the_stub_and_the_function_have_one_signature() -> None:
    """`reconstruct` stands in the package itself, and once more in the stub that editors read."""
    stub, face = (
        ast.parse((ROOT / "lampest" / f"__init__.{end}").read_text(encoding="utf-8"))
        for end in ("pyi", "py")
    )
    signatures = [
        ast.unparse(node.args).replace("typing.", "").replace("collections.abc.", "")
        + ast.unparse(node.returns)
        for tree in (stub, face)
        for node in tree.body
        if isinstance(node, ast.FunctionDef) and node.name == "reconstruct"
    ]
    assert len(signatures) == 2 and signatures[0] == signatures[1]
