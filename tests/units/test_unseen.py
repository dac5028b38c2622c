"""Scales that no reading shows, and doubts on numbers that readings contradict."""

from dataclasses import replace
from math import inf
from typing import Any

import numpy as np
import pytest

import lampest
from lampest import (
    Characteristic,
    DrivenReadout,
    GroundedReadout,
    LoadedColumnsReadout,
    Misfit,
    Panel,
    Recording,
    Scene,
    TwoPointReadout,
)
from lampest.audit.advice import Audit, verdict
from lampest.audit.finding import with_lines
from lampest.cost.terms import term_kind
from lampest.inference.circuits.model_check import ModelCheck
from lampest.inference.prepared import Prepared
from lampest.panel.readouts.starts import unseen_scales

INPUTS = DrivenReadout(
    drive_ohm=45.0, idle_ohm=45.0, load_ohm=inf, supply_volt=3.3, adc_bits=16, readings=1
)
SHAPE = (5, 6)
PRESSED = (8, 8)
EXPLAINED = ModelCheck(explains=True, sentence="the circuit can give these readings")


def cells(shape: tuple[int, int] = SHAPE) -> lampest.Array:
    return 20_000 * np.exp(0.3 * np.random.default_rng(4).standard_normal(shape))


def press(ohm: float = 1200.0) -> tuple[lampest.Array, lampest.Array]:
    """Resting and pressed cells."""
    pressed = cells(PRESSED)
    pressed[1:3, 2:4] = ohm
    return cells(PRESSED), pressed


def recording(readout: Any, measured: lampest.Readout, noise: float = 0.5) -> Recording:
    rng = np.random.default_rng(5)
    frames = np.stack([measured.exact_reading(cells())] * 6)
    volt = measured.to_recorded(frames, Scene(Panel(*SHAPE), measured))
    codes = measured.code_from_volt(volt + noise * measured.lsb_volt * rng.normal(size=volt.shape))
    scene = Scene(Panel(*SHAPE), readout)
    return Recording.from_array(codes.astype(float), unit="code", scene=scene, baseline=4)


@pytest.mark.parametrize(
    ("readout", "scales"),
    [
        (INPUTS, ("all", "columns")),
        (
            DrivenReadout(driven="columns", drive_ohm=45.0, idle_ohm=45.0, load_ohm=inf),
            ("all", "rows"),
        ),
        (DrivenReadout(idle_ohm=3300.0, load_ohm=inf), ()),
        (GroundedReadout(), ()),
        (LoadedColumnsReadout(), ()),
        (TwoPointReadout(), ()),
    ],
    ids=["inputs", "inputs of rows", "pull-downs", "grounded", "loaded", "two-point"],
)
def test_scales_that_no_reading_shows_follow_from_the_circuit(
    readout: lampest.Readout, scales: tuple[str, ...]
) -> None:
    assert unseen_scales(readout, *SHAPE) == scales


@pytest.mark.slow
def test_the_verdict_names_the_scales_and_no_bound_excludes_the_cells() -> None:
    made = recording(INPUTS, INPUTS)
    answer = verdict(EXPLAINED, Prepared(made))
    assert (
        answer.mark == "doubtful"
        and "each of the columns has a scale of its own" in answer.sentence
    )
    estimate = lampest.reconstruct(made, [Misfit(weighting="noise")])
    lower, upper = estimate.cell_resistance_lower[-1], estimate.cell_resistance_upper[-1]
    assert np.all((lower <= cells()) & (cells() <= upper))


@pytest.mark.slow
@pytest.mark.parametrize(("formulation", "pressed_ohm"), [("reduced", 1200.0), ("nodal", 1500.0)])
def test_the_unloaded_panel_and_usual_cells_choose_scales_that_no_reading_shows(
    formulation: Any, pressed_ohm: float
) -> None:
    """Under a stronger press rounding decides in which of two local optima nodal solves end."""
    readout = replace(INPUTS, adc_bits=12)
    resting, pressed = press(pressed_ohm)
    exact = np.stack([readout.exact_reading(cells) for cells in [resting] * 4 + [pressed] * 2])
    draws = 0.5 * readout.lsb_volt * np.random.default_rng(9).standard_normal(exact.shape)
    codes = readout.code_from_volt(exact + draws).astype(float)
    scene = Scene(Panel(*PRESSED), readout)
    made = Recording.from_array(codes, unit="code", scene=scene, baseline=4)
    estimate = lampest.reconstruct(made, formulation=formulation)
    change = np.log1p(estimate.relative_change[-1] / 100) - np.log(pressed / resting)
    assert np.abs(change - np.median(change, axis=0)).max() < 0.05
    assert np.abs(np.median(change, axis=0)).max() < 0.2
    assert not estimate.open_cell.any() and not estimate.at_lower_bound.any()
    lower, upper = estimate.cell_resistance_lower, estimate.cell_resistance_upper
    assert lower is not None and upper is not None
    assert np.all((lower[-1] < pressed) & (pressed < upper[-1]))
    # no bar promises what no reading shows
    assert np.log(upper[-1] / lower[-1]).min() > np.log(10)


def test_estimators_of_circuits_that_show_the_scale_stay_as_they_are() -> None:
    estimator = lampest.Estimator((Misfit(weighting="noise"), lampest.LogGradient(weight=1.0)))
    for readout, kinds in ((LoadedColumnsReadout(), ()), (INPUTS, ("log_ratio", "usual_scale"))):
        made = recording(readout, readout)
        given = estimator.in_scene(made.scene, made.readings())
        assert tuple(map(term_kind, given.terms)) == ("misfit", "log_gradient", *kinds)
        assert given.in_scene(made.scene, made.readings()) == given


def test_a_plain_misfit_has_the_same_priors_in_its_own_unit() -> None:
    made = recording(INPUTS, INPUTS)
    readings = made.readings()
    assert readings.sigma is not None
    priors = [
        lampest.Estimator((misfit,)).in_scene(made.scene, readings).terms[1:]
        for misfit in (Misfit(weighting="noise"), Misfit())
    ]
    square = np.mean(readings.sigma**2)
    for by_noise, plain in zip(*priors, strict=True):
        assert plain.weight == pytest.approx(float(by_noise.weight) * square)


@pytest.mark.slow
def test_codes_that_are_rounded_down_are_named_where_readings_are_redundant() -> None:
    """Without resistors a column has one reading more than ratios of cells."""
    built = replace(INPUTS, adc_bits=12)
    frames = np.repeat([built.exact_reading(panel) for panel in press()], 12, axis=0)
    draws = 0.5 * np.random.default_rng(9).standard_normal(frames.shape)
    codes = np.floor(frames / built.lsb_volt + draws)

    def checked(readout: DrivenReadout) -> Audit:
        scene = Scene(Panel(*PRESSED), readout)
        return Audit(Prepared(Recording.from_array(codes, unit="code", scene=scene, baseline=12)))

    audit = checked(built)
    assert audit.verdict.mark == "no"
    assert "codes are rounded down" in audit.verdict.better
    [finding] = [finding for finding in audit.advice if finding.room == "circuit"]
    _, _, refused = with_lines(audit.prepared.recording.scene, [finding])
    assert "import the readings again" in refused[0]
    half = built.lsb_volt / 2
    again = checked(replace(built, converter=Characteristic(zero_volt=half)))
    assert again.prepared.check.explains


@pytest.mark.slow
def test_codes_of_fewer_bits_are_asked_for() -> None:
    """They pile up at the last code of fewer bits; a panel that reads little has no such pile."""
    built = LoadedColumnsReadout(load_ohm=3e4, adc_bits=10, readings=1)
    scene = LoadedColumnsReadout(load_ohm=3e4, adc_bits=12, readings=1)
    question = "does the converter have 10 bits"
    at_end = recording(scene, built)
    pile = at_end.recorded.copy()
    pile[4:, 0, :2] = 1023 * scene.lsb_volt
    at_end = replace(at_end, recorded=pile)
    assert question in verdict(EXPLAINED, Prepared(at_end)).sentence
    assert question not in verdict(EXPLAINED, Prepared(recording(scene, scene))).sentence
    low = LoadedColumnsReadout(load_ohm=600.0, adc_bits=12, readings=1)
    assert (
        "does the converter have" not in verdict(EXPLAINED, Prepared(recording(low, low))).sentence
    )


def test_a_circuit_with_feedback_is_checked() -> None:
    """Among its alternatives, those in parallel groups cannot have it."""
    follows = DrivenReadout(load_ohm=1e4, idle_volt="follows", idle_ohm=70.0)
    assert Prepared(recording(follows, follows)).check.explains is not None
