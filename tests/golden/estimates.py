"""Rows of recordings, estimates and calibration."""

import tempfile
from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache, partial
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import numpy as np
from golden.circuits import COLD, FILM, PANEL, RESPONSES, Rows, scenes
from golden.content import OfKind, of_kind
from unclosed import unclosed_recording

import lampest as lp
from lampest.apps.calibration import known_loads
from lampest.apps.calibration.loads import calibrate_loads
from lampest.apps.calibration.resistors import calibrate_resistors, noise_of
from lampest.apps.studies.common import CONFIGS, paper_methods
from lampest.cost.given import Background
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods import MethodName
from lampest.estimate.methods.joint import Joint, error_bars
from lampest.estimate.methods.method import OptimalMethod
from lampest.estimate.sequence import default_terms
from lampest.estimate.weights import converter_and_faults, strongest
from lampest.files.errors import InputError
from lampest.inference.prepared import Prepared
from lampest.panel.effects import Shared
from lampest.panel.panel import EachModule, Modules
from lampest.panel.readouts import tolerances
from lampest.panel.readouts.channel_memory import with_memory
from lampest.posterior.frame_noise import FrameNoise
from lampest.recording.readings import (
    Readings,
    equal_rows,
    mean_change,
    stand_in,
    stand_in_spread,
    strongest_frame,
)
from lampest.recording.simulation.measure import OPEN_OHM
from lampest.report.reconstruction import Reconstruction
from lampest.runs.filling import frame_noise_of

# Recordings

ROD = lp.Rod(centre_mm=(12.0, 13.0), diameter_mm=24.0, mass_g=500.0)
MOUTH = lp.OralDisc(
    centre_mm=(24.0, 18.0), diameter_mm=30.0, rim_width_mm=6.0, pressure_kpa=-9.0, rim_kpa=50.0
)
COURSE = lp.Course(
    approach_s=1.0,
    attachment_s=1.5,
    breathing_hz=0.31,
    breathing_depth=0.1,
    release_at_s=5.0,
    release_s=1.0,
)
PUMPS = replace(COURSE, release_at_s=None, pump_s=2.0, pump_loss=0.3)
EFFECTS_OF = {
    "series_resistance_ohm": {"series_resistance_ohm": 90.0},
    "channel_spread_ohm": {"channel_spread_ohm": 4.0},
    "reference_tolerance": {"reference_tolerance": 0.03},
    "drift_per_minute": {"drift_per_minute": 0.2},
    "common_drift_per_minute": {"common_drift_per_minute": 0.4},
    "leak_ohm": {"leak_ohm": 2e3},
    "ground_ohm": {"ground_ohm": 15.0},
    "contact_ohm": {"contact_ohm": 300.0, "begins_s": 4.0},
    "begins_s": {"leak_ohm": 9e3, "begins_s": 3.0},
    "saturation": {"saturation": 0.4},
    "outlier_probability": {"outlier_probability": 0.002},
    "noise_factor": {"noise_factor": 4.0},
    "supply_ripple_lsb": {"supply_ripple_lsb": 3.0, "supply_ripple_hz": 7.0},
    "supply_ripple_hz": {"supply_ripple_lsb": 3.0},
    "gain_spread": {"gain_spread": 0.004},
    "load_speed_mm_s": {"load_speed_mm_s": 9.0},
    "inl_lsb": {"inl_lsb": 4.0},
    "wire_ohm_per_cell": {"wire_ohm_per_cell": 9.0},
    "reading_error": {"reading_error": 0.03},
    "response_loss": {"response_loss": 0.3},
    "response_spread": {"response_spread": 0.3},
}


@cache
def simulated(effect: str = "", scene: lp.Scene | None = None, **known: Any) -> lp.Recording:
    """A rod on a panel for a while, with one effect that the scene does not name."""
    scene = scene or lp.Scene(
        PANEL,
        lp.TwoPointReadout(noise_lsb=0.7, adc_bits=12),
        140.0,
        response=lp.PublishedResponse(),
    )
    unmodelled = lp.Unmodelled(**EFFECTS_OF.get(effect, {}))
    given = {
        "baseline_frames": 4,
        "frames": 7,
        "loads": (ROD,),
        "course": COURSE,
        "unmodelled": unmodelled,
    } | known
    return lp.simulate(lp.Simulation(schema=1, seed=5, scene=scene, **given), effect or "rod")


def recording_row(recording: lp.Recording) -> dict[str, Any]:
    row = {
        "recorded": recording.recorded,
        "cells": recording.truth_cell_resistance,
        "sums": recording.raw_sums,
    }
    return row | {
        "pressure": recording.truth_pressure,
        "role": recording.role,
        "time": recording.time,
    }


def readings_row() -> dict[str, Any]:
    scene = scenes()["noisy"]
    recorded = simulated().recorded[:3].copy()
    recorded[0, 1, 2], recorded[1, 0], recorded[2, 3, 4], recorded[:, 2, 2] = (
        np.nan,
        100.0,
        np.inf,
        recorded[:, 3, 2],
    )
    readings = Readings.of(scene, recorded)
    known = readings.plain[0]
    value = 100 + np.array([[0.0, 9, 0.1, 0, 3], [0.1, 0, 0.2, 4, 3], [0.2, 0, 0, 9, 3]])[:, None]
    side = np.array([[-1.0, -1, 1, 1, 1], [0, 0, 1, -1, 1], [0, 0, 0, 0, 0]])[:, None]
    bounds = lp.Readings(value, np.full(value.shape, 0.1), side, np.ones(value.shape))
    return {
        "mean": [readings.mean(), bounds.mean()],
        "missing": readings.missing(scene),
        "shown": readings.shown,
        "enough": readings.enough(scene),
        "sigma": readings.sigma_of_values,
        "bounds": readings.bounds,
        "stand in": stand_in(readings.value[0], known),
        "spread": stand_in_spread(readings.value[0], known),
        "rows": equal_rows(readings),
        "columns": equal_rows(readings.each(lambda part: part.swapaxes(-1, -2))),
        "change": mean_change(readings.value, readings.value[0]),
        "strongest": strongest_frame(readings.value, readings.value[0], np.arange(3)),
        "memory": Readings.of(
            replace(scene, converter_memory=0.03), np.where(recorded == 100.0, 1e5, recorded)
        ),
    }


def killed_row() -> list[Any]:
    """Recordings of a killed recorder, and their date and time at 0 s by clocks of the host."""
    with tempfile.TemporaryDirectory() as folder:
        path = unclosed_recording(
            Path(folder) / "r.h5", lp.Scene(PANEL, lp.TwoPointReadout(noise_lsb=0.7)), 6, 3
        )
        recording = lp.Recording.load(path)
    board = recording.acquisition
    assert board is not None
    hosts = [
        replace(board, host_time=board.host_time + moved)
        for moved in (3600.5, -1.7e9, np.inf, 1e15)
    ]
    return [
        recording.recorded,
        recording.start_time,
        vars(board),
        [host.start(0.25) for host in hosts],
    ]


def of_recording() -> Rows:
    effects = {field.name for field in fields(lp.Unmodelled)} - {"own"}  # of installed packages
    assert effects == EFFECTS_OF.keys()
    kinds = {f"of {name}": scene for name, scene in scenes().items() if scene.panel.modules is None}
    film = lp.Scene(
        PANEL,
        lp.TwoPointReadout(adc_bits=12),
        film=FILM,
        water=lp.Water(50.0),
        temperature=COLD,
        response=RESPONSES["table"],
    )
    return (
        {
            f"effect {effect}": lambda effect=effect: recording_row(simulated(effect))
            for effect in EFFECTS_OF
        }
        | {
            name: lambda scene=scene: recording_row(simulated(scene=scene))
            for name, scene in kinds.items()
        }
        | {
            "of a film": lambda: recording_row(
                simulated(scene=film, film=replace(FILM, hysteresis=0.3), water=lp.Water(70.0))
            ),
            "of pumps": lambda: recording_row(
                simulated(scene=lp.Scene(PANEL), loads=(MOUTH,), course=PUMPS)
            ),
            "of modules": lambda: recording_row(simulated(scene=scenes()["modules"])),
            "course": lambda: [
                course.contact_and_suction(np.linspace(-1, 8, 40)) for course in (COURSE, PUMPS)
            ],
            "readings": readings_row,
            "killed recorder": killed_row,
        }
    )


# Estimates

OMITTED_FIELDS = (
    "case_id",
    "case_yaml",
    "versions",
    "iterations",
    "starts",
    "solve_time",
    "error_bar_time",
    "baseline_solve_time",
    "kkt_residual",
    "scene",
)
AUTO = lp.LogGradient(weight="auto")
PAPER = {"total_variation": (lp.Misfit(), lp.TotalVariation(weight=0.5))}
PAPER |= {name: method.parts for name, method in paper_methods().items() if name != "LSM"}
ESTIMATORS: dict[str, Estimator] = {
    **{
        name: Estimator(terms, OptimalMethod("reduced", joint=True))
        for name, terms in PAPER.items()
    },
    **{
        f"by {word}": Estimator((lp.Misfit(), lp.LogGradient(weight=0.05)), word)
        for word in get_args(MethodName)
        if word != "smoother"
    },
    "bare": Estimator((lp.Misfit(),), "reduced"),
    "joint": Estimator(
        (lp.Misfit(), lp.RelativeChange(weight=10.0)), OptimalMethod("reduced", joint=True)
    ),
    "following": Estimator(
        (lp.Misfit(weighting="noise"), lp.Arrival(), lp.LogRatio(weight=0.1, reference="previous"))
    ),
    "auto": Estimator((lp.Misfit(weighting="noise"), AUTO), "reduced"),
    "auto per frame": Estimator(
        (lp.Misfit(weighting="noise"), AUTO),
        "reduced",
        auto_weight=lp.AutoWeight(per="frame"),
    ),
    "evidence": Estimator(
        (lp.Misfit(weighting="noise"), AUTO, lp.LogRatio()),
        "reduced",
        auto_weight=lp.AutoWeight(rule="evidence"),
    ),
    "several": Estimator((lp.Misfit(weighting="noise"), AUTO, lp.CellResistance()), "reduced"),
    "bounds": Estimator((lp.Misfit(),), "reduced", bounds=lp.Bounds(lower=900.0, upper=4000.0)),
    "smoother": Estimator(
        (lp.Misfit(weighting="noise", loss=lp.Student(corner=4.0)),), lp.SmootherMethod(lag=3)
    ),
    "smoother at bounds": Estimator(
        (lp.Misfit(weighting="noise", loss=lp.Student(corner=4.0)),),
        lp.SmootherMethod(lag=3),
        bounds=lp.Bounds(lower=2000.0),
    ),
    "truncated": Estimator((lp.Misfit(), lp.LogGradient(weight=0.05)), lp.TruncatedMethod(steps=4)),
    "tared": Estimator((lp.Misfit(),), "reduced", tare=lp.Tare(frames=5)),
}
SHARED_ERRORS = lp.Scene(
    PANEL,
    lp.TwoPointReadout(noise_lsb=0.7, adc_bits=12),
    140.0,
    systematic=lp.Systematic(0.01, 3.0),
)


def case_row(case: lp.CaseResult) -> dict[str, Any]:
    """All columns and texts of a case, but for times and versions."""
    for seconds in (case.solve_time, case.error_bar_time, case.baseline_solve_time):
        taken = np.asarray(seconds, dtype=float)
        assert not np.any((taken < 0) | (taken > 600)), "a time that no solve takes"
    names = [field.name for field in fields(case) if field.name not in OMITTED_FIELDS]
    return {name: getattr(case, name) for name in names}


@cache
def prepared() -> Any:
    return Prepared(simulated())


def estimate_row(recording: Callable[[], Any], estimator: Estimator) -> Any:
    progress: list[tuple[int, int]] = []
    estimates = Reconstruction.of(
        recording(), estimator, lambda done, frames: progress.append((done, frames))
    )
    row = case_row(estimates.result("mine")) | {"progress": progress}
    # The walk of a smoother is learned in rounds that end once nothing moves by more than noise.
    smooths = isinstance(estimator.method, lp.SmootherMethod)
    return OfKind("searched", row) if smooths else row


def gapped() -> lp.Recording:
    """Readings that are missing, and some at a rail."""
    recorded = simulated().recorded.copy()
    recorded[2, 0, 0], recorded[6, 1, 1:3], recorded[7, 2, 2], recorded[8, 3, 1] = (
        np.nan,
        np.nan,
        1.0,
        np.inf,
    )
    return replace(simulated(), recorded=recorded)


def in_scene(name: str) -> lp.Recording:
    return simulated(scene=replace(scenes()[name], response=lp.PublishedResponse()))


def dropping_out(coupled: bool) -> lp.Recording:
    """A rod over the seams of four modules whose readings are incomplete.

    One module is dead, another lacks the first loaded frame, and all lack the last one.
    """
    panel = lp.Panel(modules=Modules(2, 2, EachModule(3, 4), 4.0, coupled=coupled))
    faults = lp.Faults(dead_modules=((1, 1),))
    scene = lp.Scene(panel, lp.TwoPointReadout(noise_lsb=0.7, adc_bits=12), 140.0, faults=faults)
    recording = simulated(
        scene=scene, frames=3, loads=(replace(ROD, centre_mm=(36.0, 24.0), diameter_mm=45.0),)
    )
    values = recording.recorded.copy()
    values[4, :3, 4:], values[6] = np.nan, np.nan
    return replace(recording, recorded=values)


def calibration_row(calibration: Any) -> dict[str, Any]:
    return {
        "text": calibration.text(),
        "summary": calibration.summary,
        "remarks": calibration.remarks,
        "warnings": calibration.warnings,
    }


def on_resistors(
    scene: lp.Scene, printed: lp.Array, shift: float = 0.0, spread: float = 9.0, **true: Any
) -> lp.Recording:
    """Six frames of known resistors, with other channels and parts than those of the scene.

    Cells without a resistor are infinite.
    """
    actual = replace(scene, **true)
    memory = true.get("converter_memory")
    rows = np.linspace(-spread, spread, 4) + shift
    columns = np.linspace(-4, 8, 5) + shift
    if scene.circuit.unit == "volt" and "readout" not in true:
        actual = replace(actual, readout=replace(actual.circuit, drive_ohm=90.0))
    volt = tolerances.simulated(
        actual.circuit,
        np.repeat(np.minimum(printed, OPEN_OHM)[None], 6, axis=0),
        actual,
        rows,
        columns,
    )
    volt = with_memory(actual.circuit, memory, volt) if memory else volt
    noise = 1 + 1e-4 * np.random.default_rng(5).standard_normal(volt.shape)
    return lp.Recording(scene, volt * noise, np.arange(6.0), np.zeros(6, dtype=np.uint8))


def moved_resistors_row() -> dict[str, Any]:
    """Calibrations of diodes, wires and a memory by resistors that move from cell to cell."""
    pull_ups = scenes()["wired pull-ups"]
    diode = replace(scenes()["diodes"].circuit, diode=lp.Diode(drop_volt=0.63), drive_ohm=20.0)
    cases: dict[str, tuple[lp.Scene, dict[str, Any]]] = {
        "diodes": (scenes()["diodes"], {"readout": diode}),
        "wires": (pull_ups, {"lines": lp.Lines(12.0, 5.0)}),
        "memory": (replace(pull_ups, lines=None, converter_memory=0.0), {"converter_memory": 0.03}),
        "two point": (scenes()["noisy"], {}),
    }
    tables = [
        np.random.default_rng(seed).choice([100.0, 470, 1000, 2200, 9000], PANEL.shape)
        for seed in (4, 5)
    ]
    for table in tables:
        table[1], table[:, 3] = np.inf, np.inf
    rows = {}
    for name, (scene, true) in cases.items():
        recordings = [on_resistors(scene, table, **true) for table in tables]
        rows[name] = calibration_row(calibrate_resistors(recordings, tables, 1e-3))
    return rows


def refused_resistors_row() -> list[str]:
    """Why recordings are no calibration; and some that are one."""
    scene = scenes()["LoadedColumnsReadout"]
    known = np.full(PANEL.shape, np.inf)
    noisy = scenes()["noisy"]
    known[0, :3] = 1000.0, 3300.0, 9000.0
    single = np.where(known == 1000, known, np.inf)
    equal = np.where(known < 9e9, 2e3, known)
    recording = on_resistors(scene, known)
    foam = on_resistors(scene, 3000 + 9 * np.arange(20.0).reshape(4, 5))
    volt = np.repeat(recording.recorded, 3, axis=0) * np.linspace(1, 1.1, 18)[:, None, None]
    drift = lp.Recording(scene, volt, np.arange(18.0), np.zeros(18, dtype=np.uint8))
    spikes, wild = (drift.recorded[:1] * np.ones((18, 1, 1)) for _ in range(2))
    spikes[3, 0, 1], spikes[9, 0, 2], wild[::2, 0, 1] = 0.1, 4.9, 0.3
    expected = replace(noisy, series_resistance_ohm=800.0)
    wired = replace(noisy, lines=lp.Lines())
    larger = on_resistors(noisy, known, 400.0)
    cases = [
        (recording, known[:, ::-1]),
        (recording, np.full(PANEL.shape, np.nan)),
        (recording, -1.0),
        (recording, 0.0),
        (foam, 3000.0),
        (on_resistors(scene, single), single),
        (on_resistors(scene, equal), equal),
        (drift, known),
        (replace(drift, recorded=spikes), known),
        (replace(drift, recorded=wild), known),
        (on_resistors(scene, known, 400.0), known),
        (larger, known),
        (replace(larger, scene=expected), known),
        (on_resistors(noisy, np.ones(PANEL.shape), spread=99.0), 1.0),
        (on_resistors(wired, 10 * known), 10 * known),
        (on_resistors(scene, known, readout=replace(scene.circuit, drive_ohm=9.001)), known),
    ]
    answers = []
    for case, table in cases:
        try:
            answers.append(calibrate_resistors([case], [table], tolerance=1e-3).summary)
        except InputError as error:
            answers.append(str(error))
    return answers


def repeats_row() -> list[Any]:
    """Noise of lines from repeats: alike, different, and too few."""
    cases = (
        ((40, 50, 60), (1.0, 1.1, 0.9)),
        ((40, 50, 60), (1.0, 3.0, 0.1)),
        ((40, 2, 60), (1.0, 9.0, 1.3)),
        ((1, 2, 0), (1,) * 3),
    )
    trials = [[SimpleNamespace(repeats=np.array(n), noise_lsb=np.array(x))] for n, x in cases]
    return [noise_of(trial) for trial in (*trials, trials[0] + trials[2])]  # type: ignore[arg-type]


def stored_noise_row() -> list[Any]:
    """Noise that readings share, by a results file, or the reason of a refusal."""
    scene = lp.Scene(PANEL, lp.TwoPointReadout(noise_lsb=0.7))
    held = {"gain": np.array(0.01), "unloaded": np.array(4), "apart": np.ones((5, 2))}
    rows = list[Any]()
    changes: list[dict[str, Any]] = [
        {},
        {"gain": -1.0},
        {"gain": np.nan},
        {"unloaded": 0},
        {"unloaded": 1},
        {"together": np.ones((9, 1))},
    ]
    for change in changes:
        try:
            noise = frame_noise_of(
                {**held, **{name: np.asarray(value) for name, value in change.items()}}, scene
            )
            rows.append(
                noise and [noise.unloaded, noise.gain, noise.common_ripple, noise.line_ripple]
            )
        except ValueError as error:
            rows.append(str(error))
    return rows


def frame_noise_row() -> list[Any]:
    """Random errors that frames share, also of readings near the ends of the converter's range."""
    rng = np.random.default_rng(2)
    rows = list[Any]()
    volt = np.r_[0.002, 0.03, np.linspace(0.2, 4.8, 16), 4.97, 4.998].reshape(4, 5)
    for scene, channels in ((scenes()["noisy"], 5), (scenes()["floating"], 4)):
        ripple = 0.02 * rng.standard_normal((2, channels, 2))
        errors = 0.01 * rng.standard_normal((2, 3, 4, 5))
        measured = scene.circuit.from_recorded(
            scene.circuit.recorded_from_volt(np.stack([volt, volt[::-1]])), scene
        )
        for held, baseline in product((None, errors), (True, False)):
            columns = FrameNoise(scene, 4, 0.01, *ripple, held).columns(measured, baseline=baseline)
            rows += [columns.sum(axis=1), np.abs(columns).sum(axis=0)]
    return rows


def joint_row() -> list[Any]:
    """The joint problem of all frames at three points, with shared errors and those of a frame."""
    recording = simulated("gain_spread", SHARED_ERRORS)
    rng = np.random.default_rng(2)
    rows = list[Any]()
    robust = (lp.Misfit(weighting="noise", loss=lp.Student(corner=4.0)),)
    estimator = Estimator(robust, "reduced", bounds=lp.Bounds(lower=2500.0))
    data = [
        estimator.data(recording.readings()[frame].alone(), Background(recording.scene))
        for frame in range(3, 7)
    ]
    cells = np.log(recording.truth_cell_resistance[3:7]).reshape(
        4, -1
    ) + 0.01 * rng.standard_normal((4, 20))
    noise = FrameNoise(recording.scene, 4, 0.004, *np.zeros((2, 5, 0)))
    begun = Joint.of(
        [estimator.cost(recording.scene, 1)] * 4, data, Shared.of(recording.scene), cells, noise, 2
    )
    stiffness = rng.uniform(10, 1e4, (3, 20))
    begun = replace(begun, stiffness=stiffness, shift=0.2 * rng.standard_normal(len(begun.shift)))
    for joint in (begun, begun.stepped().sharing(), begun.stepped().stepped()):
        held = [
            joint.agreeing(joint.stiffness * np.where(np.arange(20) < count, 0.1, 1.0))
            for count in (1, 4, 15)
        ]
        rows += [
            joint.value,
            joint.gradient,
            joint.kkt_residual,
            joint.pressed,
            joint.newton(),
            joint.expected_squares(),
            joint.shared_estimate,
            [each.held for each in held],
            held[-1].value,
            held[-1].newton()[1],
            joint.answer(joint.shared[:, :, :2]),
            [each.uncertain.variance for each in (joint, held[-1])],
        ]
    return [*rows, error_bars(begun.stepped(), 2, Shared.of(recording.scene))]


def loads_row() -> dict[str, Any]:
    """A rod on four places of the panel, one recording each."""
    rods = [
        replace(ROD, centre_mm=place)
        for place in ((10.0, 10.0), (30.0, 10.0), (10.0, 22.0), (30.0, 22.0))
    ]
    scene = lp.Scene(PANEL, lp.TwoPointReadout(adc_bits=12, noise_lsb=0.7), 140.0)
    lying: dict[str, Any] = {"course": lp.Course(), "frames": 3}
    recordings = [
        replace(simulated("response_spread", scene, loads=(rod,), **lying), name=f"r{number}")
        for number, rod in enumerate(rods)
    ]
    known = [
        known_loads.KnownLoad(
            frames=(4, 6),
            recording=f"r{n}",
            mass_g=500.0,
            x_mm=rod.centre_mm[0],
            y_mm=rod.centre_mm[1],
            diameter_mm=24.0,
        )
        for n, rod in enumerate(rods)
    ]
    calibration = calibrate_loads(
        recordings, known_loads.KnownLoads(schema=1, loads=tuple(known)), 0.01
    )
    blocks = known_loads.KnownLoads(
        schema=1,
        loads=(
            known_loads.KnownLoad(
                frames=(0, 1),
                force_newton=5.0,
                x_mm=20.0,
                y_mm=10.0,
                length_mm=30.0,
                width_mm=12.0,
                angle_deg=20.0,
            ),
            known_loads.KnownLoad(frames=(2, 3), pressure_kpa=7.0),
        ),
    )
    doubled = [
        replace(each, mass_g=500.0 * (1 + (n == 2)), diameter_mm=16.0)
        for n, each in enumerate(known)
    ]
    late = [replace(known[0], frames=(5, 6)), *doubled[1:]]
    lists = [known_loads.KnownLoads(schema=1, loads=tuple(loads)) for loads in (doubled, late)]
    odd = [calibrate_loads(recordings, each, 0.0) for each in lists]
    return calibration_row(calibration) | {
        "odd": [
            [each.warnings, each.remarks, each.fitted.spread, each.fitted.scatter] for each in odd
        ],
        "fitted": calibration.fitted,
        "pressures": blocks.pressures(PANEL),
        "moved": known[0].pressure(PANEL, 6.0, 3.0, -2.0),
        "read": [
            known_loads.read_known_loads(CONFIGS / f"known_loads.{kind}") for kind in ("csv",)
        ],
    }


def of_estimate() -> Rows:
    recordings: dict[str, Callable[[], lp.Recording]] = {
        "gaps": gapped,
        "film": lambda: simulated(
            scene=lp.Scene(
                PANEL, lp.TwoPointReadout(adc_bits=12), film=FILM, response=RESPONSES["published"]
            )
        ),
        "outliers": lambda: simulated("outlier_probability"),
        "ripple": lambda: simulated("supply_ripple_lsb"),
    }
    recordings |= {
        f"scene {name}": partial(in_scene, name)
        for name in scenes()
        if name not in ("DrivenReadout",)
    }
    usual = Estimator((lp.Misfit(weighting="noise"), lp.LogGradient(weight=3.0)))
    return (
        {
            f"estimate {name}": partial(estimate_row, prepared, estimator)
            for name, estimator in ESTIMATORS.items()
        }
        | {
            f"estimate with {name}": partial(estimate_row, made, usual)
            for name, made in recordings.items()
        }
        | {
            "estimate of coupled modules": partial(
                estimate_row,
                partial(dropping_out, True),
                Estimator((lp.Misfit(), lp.LogGradient(weight=3e4)), "reduced", error_bars=False),
            ),
            "estimate bare with gaps": partial(estimate_row, gapped, ESTIMATORS["bare"]),
            "smoother of modules": partial(
                estimate_row, partial(dropping_out, False), ESTIMATORS["smoother"]
            ),
            "deciding networks": lambda: [
                strongest([0.1, 0.7, 0.3, 0.9, 0.2, 0.5]),
                [str(converter_and_faults(scene)) for scene in scenes().values()],
            ],
            "default terms": lambda: [
                default_terms(each) for each in (simulated(), simulated(scene=lp.Scene(PANEL)))
            ],
            "estimate of modules that drop out": partial(
                estimate_row, partial(dropping_out, False), ESTIMATORS["total_variation"]
            ),
            "effort": lambda: [
                each.effort(panel)
                for each in ESTIMATORS.values()
                for panel in (PANEL, scenes()["modules"].panel)
            ],
            "estimate auto per frame on modules": partial(
                estimate_row, partial(in_scene, "modules"), ESTIMATORS["auto per frame"]
            ),
            "estimate auto on modules": partial(
                estimate_row, partial(in_scene, "modules"), ESTIMATORS["auto"]
            ),
            "smoother of shared errors": partial(
                estimate_row,
                partial(simulated, "gain_spread", SHARED_ERRORS),
                ESTIMATORS["smoother"],
            ),
            "repeats": repeats_row,
            "moved resistors": moved_resistors_row,
            "no resistors": refused_resistors_row,
            "stored noise": stored_noise_row,
            "noise of frames": frame_noise_row,
            "frames as one": joint_row,
            "known loads": of_kind("fitted", loads_row),
        }
    )
