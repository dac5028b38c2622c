"""Classes that a user derives work through Python, and through YAML once a package names them."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest
from contracts.extensions import CONTRAST, Cushion, Divider, Ellipse, Even, Histogram, Leash
from numpy.testing import assert_allclose, assert_array_equal
from support import invented_case

import lampest
from lampest import Gradient, Misfit, Panel, Recording, Scene, Simulation, write_results

ELLIPSE = Ellipse(centre_mm=(25.0, 20.0), long_mm=40.0, short_mm=20.0, pressure_kpa=15.0)
MAX_ERROR = 0.05  # median error of cells by plain least squares, relative
GROUPS = {
    "terms": "Leash",
    "losses": "Cushion",
    "readouts": "Divider",
    "methods": "Even",
    "shapes": "Ellipse",
}
GROUPS |= {"columns": "CONTRAST", "plots": "HISTOGRAM"}
SIMULATION = """\
schema: 1
seed: 3
scene: {panel: {rows: 5, columns: 6}, readout: {kind: divider, load_ohm: 5000, readings: 100}}
frames: 2
loads: [{kind: ellipse, centre_mm: [25, 20], long_mm: 40, short_mm: 20, pressure_kpa: 15}]
output: ellipse.h5
"""
RUN = """\
schema: 1
recordings: [ellipse.h5]
formulation: reduced
estimators:
  leashed: {terms: {misfit: {weighting: noise}, leash: {weight: 1e3, length_ohm: 1234}}}
  soft: {terms: {misfit: {weighting: noise, loss: {kind: cushion, softness: 1e6}}}}
  plain: {terms: {misfit: {weighting: noise}}}
  even: {terms: {misfit: {}}, formulation: {kind: even, factor: 2}}
"""
EXTENSIONS = Path(__file__).with_name("extensions.py").read_text(encoding="utf-8")
# A group of entry points, what a package names in it, and how the sentence begins; "terms" are
# asked for by a run.
WRONG_NAMES = (
    ("terms", "addon:Even", "lampest.terms: Even of an installed package is no Term"),
    ("methods", "addon:Leash", "lampest.methods: Leash of an installed package is no Method"),
    (
        "terms",
        "addon:contrast",
        "lampest.terms: extra = addon:contrast of an installed package is no type",
    ),
    (
        "terms",
        "lampest:Misfit",
        "lampest.terms: Misfit of an installed package needs kind: Literal['...'] with",
    ),
    (
        "columns",
        "addon:MOST",
        "lampest.columns: extra = addon:MOST of an installed package cannot be loaded",
    ),
    ("columns", "math:pi", "lampest.columns: extra = math:pi of an installed package is no Column"),
    ("plots", "addon:TWICE", "there are two plots 'contours'"),
)


def simulated(readout: lampest.Readout) -> Recording:
    scene = Scene(Panel(5, 6), readout)
    return lampest.simulate(
        Simulation(schema=1, seed=3, scene=scene, frames=2, loads=(ELLIPSE,)), "ellipse"
    )


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulated(lampest.TwoPointReadout())


def test_a_term_joins_with_one_file_and_one_name(recording: Recording) -> None:
    terms = [Misfit(weighting="noise"), Leash(weight=1e6, length_ohm=1234.0)]
    for formulation in ("nodal", "reduced"):
        estimate = lampest.reconstruct(
            recording, terms, formulation=formulation, bounds=lampest.Bounds("none", "none")
        )
        assert estimate.status == ("local optimum verified",) * 2
        assert_allclose(estimate.cell_resistance, 1234, rtol=1e-3)
    weak = lampest.reconstruct(
        recording, [Misfit(weighting="noise"), Leash(weight="auto")], formulation="reduced"
    )
    assert weak.solved.all() and "misfit + leash" in repr(weak)


@pytest.mark.slow
def test_a_loss_joins_with_one_file_and_one_name(recording: Recording) -> None:
    """A very soft cushion is a square, and a hard one has the cost of its formula."""
    penalty = Gradient(weight=1e-3)
    plain, soft, hard = (
        lampest.reconstruct(
            recording, [Misfit(weighting="noise", loss=loss), penalty], formulation="reduced"
        )
        for loss in (lampest.Squared(), Cushion(softness=1e6), Cushion(softness=0.5))
    )
    assert soft.status == hard.status == ("local optimum verified",) * 2
    assert_allclose(soft.cell_resistance, plain.cell_resistance, rtol=1e-5)
    model = np.stack([lampest.two_point_resistance(cells) for cells in hard.cell_resistance])
    residual = (model - hard.measured) / hard.sigma
    costs = 0.5 * (np.sqrt(1 + 4 * residual**2) - 1).sum(axis=(1, 2))
    assert_allclose(hard.result().costs["misfit"], costs, rtol=1e-6)
    misfit = Misfit(weighting="noise", loss=Cushion(softness=100.0))
    nodal, reduced = (
        lampest.reconstruct(recording, [misfit, penalty], formulation=formulation)
        for formulation in ("nodal", "reduced")
    )
    assert_allclose(nodal.cell_resistance, reduced.cell_resistance, rtol=1e-5)

    class Forgetful(Cushion):
        def cost(self, residual: Any) -> Any:
            return residual**2

    with pytest.raises(
        lampest.InputError,
        match=r"loss Forgetful: cost gives 30×1 numbers; it must give one, the sum",
    ):
        lampest.reconstruct(recording, [Misfit(loss=Forgetful())], formulation="reduced")


@pytest.mark.slow
def test_a_readout_joins_with_one_file_and_one_name() -> None:
    readout = Divider(load_ohm=5000.0, readings=100)
    recording = simulated(readout)
    truth = recording.truth_cell_resistance
    estimate = lampest.reconstruct(recording, [Misfit(weighting="noise")], formulation="reduced")
    assert np.median(np.abs(estimate.cell_resistance / truth[3:] - 1)) < MAX_ERROR
    assert estimate.model_check.mark == "yes"
    given = lampest.LoadedColumnsReadout(load_ohm=5000.0, drive_ohm=100.0, readings=100)
    assert_allclose(simulated(given).recorded, recording.recorded, rtol=1e-12)
    nodal = lampest.reconstruct(recording, [Misfit(weighting="noise")])
    assert_allclose(nodal.cell_resistance, estimate.cell_resistance, rtol=1e-4)


def test_a_method_joins_with_one_file_and_one_name(recording: Recording) -> None:
    free = lampest.Bounds("none", "none")
    single, double = (
        lampest.reconstruct(recording, [Misfit()], formulation=Even(f), bounds=free)
        for f in (1.0, 2.0)
    )
    assert_allclose(double.cell_resistance, 2 * single.cell_resistance)
    assert np.ptp(single.cell_resistance[0]) == 0 and single.cell_resistance_errors is None
    assert set(single.status) == {"approximate, as the formulation asks; not an optimum"}


@pytest.mark.slow
def test_a_column_joins_with_one_file_and_one_name(recording: Recording, tmp_path: Path) -> None:
    estimate = lampest.reconstruct(recording, [Misfit()], formulation="reduced")
    estimate.save(tmp_path / "r.h5", "mine", columns=[CONTRAST])
    contrast = estimate.cell_resistance.max(axis=(1, 2)) / estimate.cell_resistance.min(axis=(1, 2))
    (case,) = lampest.read_results(tmp_path / "r.h5", [CONTRAST]).cases
    (bare,) = lampest.read_results(tmp_path / "r.h5").cases
    assert not bare.extra, "without its column it has no meaning"
    with h5py.File(tmp_path / "r.h5") as file:
        assert file["entry/ellipse/mine/contrast"].attrs["units"] == b"1"
    assert_array_equal(case.extra["contrast"], contrast)
    for dataset in (estimate.to_xarray([CONTRAST]), case.to_xarray([CONTRAST])):
        assert_array_equal(dataset["contrast"], contrast)
        assert dataset["contrast"].attrs["units"] == "1"
    assert_array_equal(estimate.to_dataframe([CONTRAST])["contrast"], np.repeat(contrast, 30))
    with pytest.raises(lampest.InputError, match="no column says what the extra 'contrast' is"):
        case.to_xarray()


def test_a_plot_joins_with_one_file_and_one_name(recording: Recording, tmp_path: Path) -> None:
    estimate = lampest.reconstruct(recording, [Misfit()], formulation="reduced")
    for figure in (estimate.plot(Histogram()), estimate.plot(Histogram(), frame=3)):
        assert len(figure.axes[0].patches) == 10
    estimate.save(tmp_path / "r.h5")
    (file,) = lampest.plot_results(tmp_path / "r.h5", show=Histogram())
    assert file.name == "histogram_ellipse.png"


@pytest.mark.slow
def test_an_installed_package_adds_its_names_to_yaml(
    tmp_path: Path, package: Callable[..., None], lampest: Callable[..., SimpleNamespace]
) -> None:
    package(EXTENSIONS, **{group: f"addon:{name}" for group, name in GROUPS.items()})

    def command(*arguments: str | Path) -> str:
        completed = lampest(*arguments)
        assert (completed.code, completed.err) == (0, ""), arguments
        return str(completed.out)

    (tmp_path / "simulation.yaml").write_text(SIMULATION)
    (tmp_path / "run.yaml").write_text(RUN)
    out = tmp_path / "out"
    command("simulate", tmp_path / "simulation.yaml", "--out", tmp_path / "ellipse.h5")
    command("run", tmp_path / "run.yaml", "--out", out, "--jobs", "1")
    command("plot", out / "results.h5", "--show", "histogram", "--out", out)
    assert (out / "histogram_ellipse.png").is_file()
    assert "leash" in command("show", "terms")
    schema = command("show", "schema")
    assert '"leash"' in schema and '"even"' in schema
    with h5py.File(out / "results.h5") as file:
        case = file["entry/ellipse/leashed"]
        free = ~case["at_lower_bound"][()].astype(bool)
        assert_allclose(case["cell_resistance"][()][free], 1234, rtol=0.05)
        assert_allclose(file["entry/ellipse/even/contrast"], 1)
        soft, plain = (file[f"entry/ellipse/{name}/cell_resistance"] for name in ("soft", "plain"))
        assert_allclose(soft, plain, rtol=1e-4)


@pytest.mark.parametrize(("group", "name", "sentence"), WRONG_NAMES)
def test_a_wrong_entry_point_gives_one_sentence(
    tmp_path: Path,
    package: Callable[..., None],
    lampest: Callable[..., SimpleNamespace],
    group: str,
    name: str,
    sentence: str,
) -> None:
    write_results(tmp_path / "r.h5", [invented_case()])
    package(
        EXTENSIONS + 'TWICE = type("Twice", (Histogram,), {"kind": "contours"})()\n',
        **{group: name},
    )
    (tmp_path / "run.yaml").write_text(RUN)
    words = (
        ("run", tmp_path / "run.yaml")
        if group in ("terms", "methods")
        else ("plot", tmp_path / "r.h5")
    )
    completed = lampest(*words, *(("--show", "contours") if group == "plots" else ()))
    assert completed.code == 2 and completed.err.startswith(f"lampest: {sentence}"), completed.err
    assert completed.err.count("\n") == 1
