"""An effect of one file, and everything that follows from it: docs/howto/adding/effect.md."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from contracts.own_effect import Crosstalk
from numpy.testing import assert_allclose, assert_array_equal

import lampest
from lampest.inference.prepared import Prepared
from lampest.panel.effects import shared_effects, systematic_of
from lampest.recording.simulation.measure import random_stream

MODULE = (Path(__file__).parents[1] / "contracts" / "own_effect.py").read_text(encoding="utf-8")
KEY = "systematic.crosstalk"
SIZE = 0.02
TRUE = SIZE * random_stream(5, "crosstalk").standard_normal()
SIMULATION = """\
schema: 1
seed: 5
scene:
  panel: {rows: 6, columns: 7, pitch_mm: 10}
  readout: {kind: two_point, adc_bits: 12, readings: 50}
  series_resistance_ohm: 140
baseline_frames: 5
frames: 3
loads: [{kind: rod, centre_mm: [30, 20], diameter_mm: 15, mass_g: 2000}]
"""
IN_A_NOTEBOOK = """
from dataclasses import replace
from lampest.audit.advice import unnamed_effects
from lampest.inference.prepared import Prepared

[(_, simulation)] = lampest.read_simulations("simulation.yaml")
off = lampest.simulate(simulation)
(finding,) = unnamed_effects(Prepared(off))
assert finding.line == "systematic: {crosstalk: estimated}"
scene = replace(off.scene, systematic=lampest.Systematic(crosstalk="estimated"))
named = replace(off, scene=scene)
size, deviation = Prepared(named).noise.estimated["systematic.crosstalk"]
assert str(f"{size:.2g} +- {deviation:.1g}") in finding.what
bars = lampest.reconstruct(named, [lampest.Misfit(weighting="noise")]).sigma_common
assert np.median(bars) > 0, bars


class Crosstalk(Crosstalk.__base__):
    setting, name, limits, prior = "crosstalk", "another one", (0.0, 0.001), 0.001
    columns = Crosstalk.columns


try:
    lampest.Systematic(crosstalk=0.3)
except ValueError as error:
    print(error)
"""


@pytest.fixture
def installed(package: Callable[..., None]) -> None:
    """A package with the effect is installed."""
    package(MODULE, effects="addon:Crosstalk")


def simulated(folder: Path, crosstalk: float = 0.0) -> lampest.Recording:
    path = folder / "simulation.yaml"
    unmodelled = f"unmodelled: {{crosstalk: {crosstalk}}}\n" if crosstalk else ""
    path.write_text(SIMULATION + unmodelled)
    [(_, simulation)] = lampest.read_simulations(path)
    return lampest.simulate(simulation)


def naming(recording: lampest.Recording, size: float | str) -> lampest.Recording:
    systematic = lampest.Systematic(crosstalk=size)
    return replace(recording, scene=replace(recording.scene, systematic=systematic))


@pytest.mark.usefixtures("installed")
def test_its_setting_is_a_key_of_scenes(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    text = "panel: {rows: 3, columns: 4}\nsystematic: {inl_lsb: 1, crosstalk: 0.3}\n"
    path.write_text(text)
    scene = lampest.read_scene(path)
    assert scene.systematic.entry("crosstalk") == 0.3 and scene.systematic.inl_lsb == 1
    values = 500.0 + np.arange(36.0).reshape(3, 3, 4)
    lampest.Recording.from_array(values, "ohm", baseline=1, scene=scene).save(tmp_path / "r.h5")
    assert lampest.Recording.load(tmp_path / "r.h5").scene == scene
    path.write_text(text.replace("0.3", "3"))
    with pytest.raises(
        lampest.InputError,
        match=r":2:26: systematic.crosstalk must lie between 0 and 0.5",
    ):
        lampest.read_scene(path)
    path.write_text(text.replace("crosstalk", "crostalk"))
    with pytest.raises(lampest.InputError, match="crostalk"):
        lampest.read_scene(path)


@pytest.mark.usefixtures("installed")
def test_it_is_simulated_by_its_columns(tmp_path: Path) -> None:
    clean, off = simulated(tmp_path), simulated(tmp_path, SIZE)
    readings = clean.readings().value
    added = TRUE * np.roll(readings, 3, axis=-2)
    assert_allclose(off.readings().value - readings, added, atol=0.3)  # ohm, noise


@pytest.mark.usefixtures("installed")
def test_error_bars_carry_it(tmp_path: Path) -> None:
    recording = simulated(tmp_path)
    plain, wide, wider = (
        lampest.reconstruct(each, [lampest.Misfit(weighting="noise")], formulation="reduced")
        for each in (recording, naming(recording, 0.01), naming(recording, 0.02))
    )
    assert_array_equal(plain.sigma_common, 0.0)
    assert np.median(wide.sigma_common) > 0
    assert_allclose(wider.sigma_common, 2 * wide.sigma_common, rtol=1e-6)


@pytest.mark.usefixtures("installed")
def test_estimated_it_has_a_prior_and_gets_its_number(tmp_path: Path) -> None:
    recording = naming(simulated(tmp_path, SIZE), "estimated")
    assert systematic_of(recording.scene).entry("crosstalk") == Crosstalk.prior
    noise = Prepared(recording).noise
    size, deviation = noise.estimated[KEY]
    assert abs(size - abs(TRUE)) < 2 * deviation < 2 * Crosstalk.prior
    assert Prepared(recording).resolved.scene.estimated == {KEY: (size, deviation)}


@pytest.mark.slow
def test_a_class_of_a_notebook_is_an_effect(tmp_path: Path) -> None:
    simulated_too = f"unmodelled: {{crosstalk: {SIZE}}}\n"
    (tmp_path / "simulation.yaml").write_text(SIMULATION + simulated_too)
    (tmp_path / "notebook.py").write_text(MODULE + IN_A_NOTEBOOK)
    done = subprocess.run(
        [sys.executable, "notebook.py"], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "crosstalk must lie between 0 and 0.001" in done.stdout


@pytest.mark.parametrize(
    ("module", "sentence"),
    [
        (MODULE.replace("lampest.SharedEffect", "lampest.Term"), "is no effect"),
        (MODULE.replace('"crosstalk"', '"inl_lsb"'), "needs a setting unlike"),
    ],
)
def test_a_wrong_effect_gives_one_sentence(
    package: Callable[..., None], module: str, sentence: str
) -> None:
    package(module, effects="addon:Crosstalk")
    with pytest.raises(lampest.InputError, match=f"lampest.effects: Crosstalk .* {sentence}"):
        shared_effects()
