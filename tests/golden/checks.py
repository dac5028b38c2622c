"""Rows of noise, outliers, checks of the circuit, and recognition."""

import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
from golden.circuits import PANEL, SHAPES, Rows, cells_of
from golden.content import of_kind
from golden.estimates import simulated

import lampest as lp
from lampest.apps.recognition import most_probable, observation
from lampest.apps.recognition.attachment import Attachment, continued_by
from lampest.apps.recognition.breath import Breath, breath, too_slow
from lampest.apps.recognition.breathing import Breathing
from lampest.apps.recognition.detect import detection
from lampest.apps.recognition.detect.answer import Detected, alarming, event_table, load_table
from lampest.apps.recognition.detector import Detector, Verdict
from lampest.apps.recognition.image import ImageWatch, Window
from lampest.apps.recognition.pumping import Pumping
from lampest.apps.recognition.steady_frames import SteadyFrames, changes_without_water, settled
from lampest.apps.recognition.suction import suctions
from lampest.apps.recognition.swings import Patterns, patterns_of
from lampest.apps.recognition.watch import Watch
from lampest.apps.recognition.watch_parts import Look, WatchSetup
from lampest.inference import evidence, noise
from lampest.inference.circuits.explanation import Explanation, noise_factor
from lampest.inference.circuits.model_check import module_factors
from lampest.inference.effects.converter_ends import saturated
from lampest.inference.effects.motion import displacement
from lampest.inference.nuisances import CircuitEffects
from lampest.inference.nuisances import candidates as possible_effects
from lampest.inference.prepared import Prepared
from lampest.inference.readings import outliers
from lampest.inference.variance_components import noted_excess, repeated_scatter, scatter
from lampest.panel.effects.line_effect import line_effects
from lampest.panel.effects.line_leak import LineLeak
from lampest.panel.effects.loose_contact import LooseContact
from lampest.panel.panel import EachModule, Modules
from lampest.panel.scene import OwnOfModule
from lampest.recording.readings import median
from lampest.recording.recording import baseline_readings, deciding_frames

# Preparation

WIDE = lp.Panel(7, 8)
HAND = lp.Block(centre_mm=(33.0, 28.0), length_mm=30.0, width_mm=25.0, mass_g=1500.0)
TWO = lp.TwoPointReadout(noise_lsb=0.7)
AT_COLUMNS = lp.LoadedColumnsReadout(noise_lsb=0.7, drive_ohm=60.0)
ON_GROUND = lp.GroundedReadout(noise_lsb=0.7)


def recorded(
    readout: Any = TWO, specified: Any = None, series: float = 140.0, **effects: float
) -> lp.Recording:
    """A hand on some cells, with effects that the scene does not name.

    Or it is with another readout than the scene has.
    """
    scene = lp.Scene(WIDE, readout, series if readout.unit == "ohm" else 0.0)
    known: dict[str, Any] = {
        "baseline_frames": 4,
        "frames": 9 if "load_speed_mm_s" in effects else 5,
        "loads": (HAND,),
    }
    unmodelled = lp.Unmodelled(**effects)
    cells = lp.Cells(spread=0.15)
    recording = lp.simulate(
        lp.Simulation(schema=1, seed=3, scene=scene, cells=cells, unmodelled=unmodelled, **known),
        "x",
    )
    return replace(recording, scene=specified or scene)


def touched_at_rest() -> lp.Recording:
    recording = recorded()
    return replace(
        recording, recorded=np.concatenate([recording.recorded[4:8], recording.recorded[:5]])
    )


@cache
def tiled() -> lp.Recording:
    """A rod over the seams of six modules, of which one is dead and one reads too much."""
    tiles = Modules(2, 3, EachModule(4, 4), seam_mm=3.0)
    own = (OwnOfModule((0, 1), series_resistance_ohm=150.0),)
    scene = lp.Scene(
        lp.Panel(modules=tiles), TWO, 140.0, faults=lp.Faults(dead_modules=((1, 2),)), modules=own
    )
    known: dict[str, Any] = {
        "loads": (lp.Rod(centre_mm=(36.0, 36.0), diameter_mm=40.0, mass_g=900.0),)
    }
    known |= {"course": lp.Course(start_s=1.0, release_at_s=5.0), "baseline_frames": 4, "frames": 7}
    recording = lp.simulate(lp.Simulation(schema=1, seed=5, scene=scene, **known), "tiles")
    factor = np.ones(scene.panel.shape)
    factor[4:, :4] = 1.7
    return replace(recording, recorded=recording.recorded * factor)


def disconnected() -> lp.Recording:
    """Return modules without a value, at a rail, dead, and with larger readings than the others.

    A sound module has an outlier.
    """
    values = tiled().recorded.copy()
    values[2, 1, 5] *= 1.4
    values[:, :4, :4], values[:, :4, 8:] = np.nan, TWO.recorded_from_volt(np.array(4.995))
    return replace(tiled(), recorded=values)


def without_values(share: float) -> lp.Recording:
    """Readings that are missing at random."""
    missing = np.random.default_rng(3).random(recorded().recorded.shape) < share
    return replace(recorded(), recorded=np.where(missing, np.nan, recorded().recorded))


def open_column() -> lp.Recording:
    """A column of cells that are open, which the scene does not say."""
    scene = lp.Scene(WIDE, TWO, 140.0)
    cells = np.where(np.arange(8) == 4, 1e12, recorded().truth_cell_resistance)
    exact = scene.circuit.to_recorded(scene.circuit.exact_reading(cells), scene)
    return replace(
        recorded(), recorded=exact + 0.1 * np.random.default_rng(2).standard_normal(exact.shape)
    )


RECORDED: dict[str, Callable[[], lp.Recording]] = {
    "plain": recorded,
    **{
        effect: partial(simulated, effect)
        for effect in ("begins_s", "drift_per_minute", "outlier_probability")
    },
    **{
        effect: partial(simulated, effect)
        for effect in ("supply_ripple_lsb", "supply_ripple_hz", "gain_spread")
    },
    "leak": partial(recorded, leak_ohm=2e3),
    "late leak": partial(recorded, leak_ohm=9e3, begins_s=4.0),
    "contact": partial(recorded, contact_ohm=200.0, begins_s=6.0),
    "creep": partial(recorded, common_drift_per_minute=0.5),
    "saturation": partial(recorded, saturation=0.62),
    "saturation at rest": partial(recorded, saturation=0.55),
    "motion": partial(recorded, load_speed_mm_s=12.0),
    "reading error": partial(recorded, reading_error=0.05),
    "series": partial(recorded, TWO, lp.Scene(WIDE, TWO), series=240.0),
    "little series": partial(recorded, TWO, lp.Scene(WIDE, TWO), series=50.0),
    "touched": touched_at_rest,
    "kind": partial(recorded, AT_COLUMNS, lp.Scene(WIDE, ON_GROUND)),
    "columns": partial(recorded, AT_COLUMNS, lp.Scene(WIDE, replace(AT_COLUMNS, driven="columns"))),
    "polarity": partial(recorded, AT_COLUMNS, lp.Scene(WIDE, replace(AT_COLUMNS, polarity="down"))),
    "amplifiers": partial(
        recorded,
        lp.VirtualGroundReadout(noise_lsb=0.7, feedback_ohm=400.0),
        lp.Scene(WIDE, ON_GROUND),
    ),
    "estimated": partial(recorded, lp.TwoPointReadout(noise_lsb="estimated"), noise_factor=3.0),
    "modules": tiled,
    "coarse": partial(recorded, lp.TwoPointReadout(adc_bits=8, readings=1)),
    "disconnected": disconnected,
    "loud": partial(recorded, noise_factor=3.0),
    "half missing": partial(without_values, 0.5),
    "few missing": partial(without_values, 0.05),
    "open column": open_column,
    "no series": partial(recorded, TWO, lp.Scene(WIDE, TWO, 140.0), series=0.0),
    "less than series": partial(recorded, TWO, lp.Scene(WIDE, TWO, 1200.0), series=0.0),
}


def prepared_row(recording: lp.Recording) -> dict[str, Any]:
    prepared = Prepared(recording)
    noise = prepared.noise
    check = prepared.check
    known = detection.known_of(prepared)
    return {
        "warnings": prepared.warnings,
        "noise": noise.summary,
        "shared": noise.shared_sizes,
        "value": noise.readings.value,
        "sigma": noise.readings.sigma,
        "side": noise.readings.side,
        "factors": [
            noise.sigma_factor,
            noise.model_factor,
            noise.motion.mean if noise.motion else 0.0,
        ],
        "outliers": noise.outliers,
        "corrections": noise.corrected_effects and noise.corrected_effects.corrections,
        "explains": check.explains,
        "check": [check.sentence, check.mark, check.better, check.common_change, check.noise],
        "known": known.sigma if isinstance(known, detection.Known) else known.why,
    }


def mistakes_row() -> dict[str, Any]:
    """Warnings of recordings with wrong roles, times or units, or copied or few unloaded frames."""
    fine = simulated()
    rows = {}
    order = fine.recorded
    first = np.arange(len(fine.role))
    variants: dict[str, dict[str, Any]] = {
        **{
            f"{count} unloaded": {"role": (first >= count).astype(np.uint8)} for count in (0, 1, 11)
        },
        "swapped": {"role": (first < 4).astype(np.uint8)},
        "loaded": {"recorded": order[[5, 6, 5, 6, 4, 1, 2, 3, 0, 1, 2]]},
        "kohm": {"recorded": 1e3 * order},
        "copies": {"recorded": order[[0, 0, 0, 0, *range(4, 11)]]},
        "sigma": {"sigma": 0.02 * order},
        "no readout": {"scene": lp.Scene(PANEL)},
        "coarse": {"recorded": 40 * np.round(order / 40), "role": (first >= 1).astype(np.uint8)},
        **{f"every {step} s": {"time": step * first, "simulation": None} for step in (0.0, 50.0)},
    }
    for name, changes in variants.items():
        prepared = Prepared(replace(fine, **changes))
        rows[name] = prepared.warnings, prepared.noise.factor, prepared.check.mark
    return rows


def odd_modules(count: int) -> dict[int, float]:
    """The factors of some modules in a row, of which the second reads four times as much."""
    layout = Modules(1, count, EachModule(2, 2), 4.0)
    scales = np.where(np.arange(2 * count) // 2 == 1, 4e3, 1e3)
    scene = lp.Scene(lp.Panel(modules=layout), TWO)
    role = np.array([0, 0, 1], dtype=np.uint8)
    return module_factors(
        lp.Recording(scene, scales * np.ones((3, 2, 1)), np.arange(3.0), role), layout
    )


def outliers_row() -> dict[str, Any]:
    """Frames of which some have readings that stand alone, at rest and under a load that comes."""
    rng = np.random.default_rng(8)
    value = (
        1000
        + 9 * rng.standard_normal((16, 4, 5))
        + 400 * (np.arange(16) > 8)[:, None, None] * cells_of((4, 5)) / 3000
    )
    value[3, 1, 2], value[12, 0, 4], value[15, 3, 0] = 1300.0, 600.0, 2000.0
    scale = np.full(value.shape, 9.0)
    scene = lp.Scene(PANEL, TWO)
    frames = outliers.FramesBefore()
    cells = cells_of(PANEL.shape, spread=0.1)
    live = []
    noisy = 1 + 4e-3 * rng.standard_normal((7, 4, 5))
    for frame in lp.two_point_resistance(np.repeat(cells[None], 7, axis=0)) * noisy:
        frame[2, 3] *= 1.3 if len(live) >= 5 else 1.0
        frame[3, 0] *= 1.015 if len(live) == 4 else 1.0
        frame[0, 1] *= 0.7 if len(live) == 6 else 1.0
        readings = lp.Readings.of(scene, frame)
        live.append(frames.without_impossible(readings, scene))
        frames = frames.after(readings)
    single = lp.two_point_resistance(cells) * np.where(cells == cells.max(), 9.0, 1.0)
    live.append(frames.without_impossible(lp.Readings.of(scene, single), scene))
    touched = np.full((7, 8, 8), 2000.0)
    touched[3, 4, 4] = 500.0
    touched = lp.two_point_resistance(touched)
    apart = np.stack([value, 1000 + 5 * (value - 1000)], axis=1)
    unloaded = np.arange(16) < 8
    pair = lp.Readings(
        apart, np.full(apart.shape, 9.0), np.zeros(apart.shape), np.ones(apart.shape)
    )
    sizes = (pair.sigma, None, 5 * pair.sigma, 0.2 * pair.sigma)
    panels = [
        [
            outliers.outliers_of_one_frame(replace(pair, sigma=size)[:, panel], unloaded)
            for panel in (0, 1)
        ]
        for size in sizes
    ]
    flagged = [np.stack([outlying for outlying, *_ in halves], axis=1) for halves in panels]
    course = value + np.where(unloaded, 0.0, 3.0)[:, None, None] * (
        value - np.median(value, axis=0)
    )
    course[np.arange(8, 15), np.arange(7) % 4, np.arange(7) % 5] += (
        90,
        150,
        250,
        400,
        -150,
        -250,
        900,
    )
    course[np.arange(8) % 7, np.arange(8) % 4, np.arange(8) % 5] += (120, -120) * 4
    course[[10, 10, 12, 12, 12], [0, 3, 1, 2, 3], [1, 3, 0, 4, 1]] += 500.0
    loaded = lp.Readings.of(scene, course)
    impossible = lp.Readings.of(
        scene, lp.two_point_resistance(cells)[None] * np.where(cells == cells.max(), 9.0, 1.0)
    )
    return {
        "whole": outliers.detect_outliers(value, scale),
        "few": outliers.detect_outliers(value[:4], scale[:4], 0.1),
        "scales": flagged[1:],
        "panels": (flagged[0], panels[0]),
        "loaded": outliers.outliers_of_one_frame(loaded.without(course > 16000), unloaded),
        "two frames": outliers.outliers_of_one_frame(loaded[7:9], unloaded[7:9])[0].sum(),
        "live": live,
        "impossible": outliers.impossible_readings(scene.circuit, impossible),
        "median": median(value)[0],
        "touch": outliers.detect_outliers(touched, 1e-3 * touched)[0].sum(),
    }


def scatter_row() -> dict[str, Any]:
    """Variance components of deviations with a gain, ripples and noise; steps within a scan."""
    rng = np.random.default_rng(4)
    loud = np.full((10, 8), 3000.0)
    plain = rng.standard_normal((9, 10, 8))
    parts = {
        "plain": plain,
        "gain": plain + 0.003 * 3000 * rng.standard_normal((9, 1, 1)),
        "common": plain + 3 * np.sin(np.arange(8) + 6 * rng.random((9, 1, 1))),
        "lines": plain + 4 * rng.standard_normal((9, 10, 1)),
    }
    single = [rng.standard_normal((6, *shape)) for shape in ((1, 1), (1, 12), (12, 1))]
    small_group = 500 * np.exp(0.01 * plain[:, :2, :3])
    small_group[:, 0, 0], small_group[1:, 0, 1], small_group[:, 0, 2] = 500.0, np.nan, np.nan
    recording = recorded()
    measured = recording.measured_frames()
    readings = recording.readings()
    resting = baseline_readings(recording, readings)
    lonely = recording.time == 4
    frame, *neighbours = deciding_frames(recording, readings, resting)

    def components(deviations: lp.Array, level: lp.Array, degrees: int) -> Any:
        found = scatter(deviations, level, degrees)
        # Roots of the covariances of ripples are not unique; the covariances are.
        roots = found.common_ripple, found.line_ripple
        common, lines = (root @ root.swapaxes(-1, -2) for root in roots)
        return replace(found, common_ripple=common, line_ripple=lines)

    return {
        "scatter": [components(part - part.mean(axis=0), loud, 8) for part in parts.values()],
        "few frames": [
            components(part[:4] - part[:4].mean(axis=0), loud, 3) for part in parts.values()
        ],
        "single": [
            components(part - part.mean(axis=0), np.full(part[0].shape, 3e3), 5) for part in single
        ],
        "displacement": displacement(recording.scene, readings, measured),
        "repeated": repeated_scatter(readings[measured]),
        "excess": [noted_excess(*pair) for pair in ((500.0, 300.0), (310.0, 300.0), (0.0, 0.0))],
        "shown": [noise.shown_noise(recording.scene.circuit, factor) for factor in (0.0, 0.5, 3.0)],
        "frame": frame,
        "unknown": noise_factor(replace(readings, sigma=None)),
        "factor": noise_factor(readings[:4]),
        "lonely": deciding_frames(
            replace(recording, role=lonely.astype(np.uint8)), readings, resting
        )[1:],
        "beside": np.array(neighbours),
        "possible": [str(each) for each in possible_effects((3, 4), line_effects())],
        "scattered": detection.noise_by_scatter(small_group),
    }


def factors_of_modules(factor: float) -> dict[int, float]:
    recorded = tiled().recorded.copy()
    recorded[:, :4, 4:8] *= factor
    return module_factors(
        replace(tiled(), recorded=recorded), Modules(2, 3, EachModule(4, 4), seam_mm=3.0)
    )


def contacts_row() -> dict[str, Any]:
    """Effects in words, modules that differ, and noise of frames with many outliers."""
    effects: Any = SimpleNamespace(
        effects=(LooseContact((5,), size=40.0), LineLeak((1,), size=1e-4)), shape=(4, 5)
    )
    rng = np.random.default_rng(5)
    recording = recorded()
    shared = {}
    for unloaded in (2, 4):
        fewer = replace(recording, role=(np.arange(9) >= unloaded).astype(np.uint8))
        flagged = (
            rng.random(recording.recorded.shape)
            < np.where(np.arange(9) < 6, 0.02, 0.2)[:, None, None]
        )
        for readings in (fewer.readings(), replace(fewer.readings(), sigma=None)):
            shared[f"{unloaded} {readings.sigma is None}"] = noise.estimate_noise(
                fewer, flagged, readings
            ).warnings
    fits: Any = [
        SimpleNamespace(chi_square=2.0 + k, readings=SimpleNamespace(bounds=np.eye(2 + k)))
        for k in (0, 1)
    ]
    explanation = Explanation(None, tuple(fits), SimpleNamespace(density=70.0, misfits=65.0))  # type: ignore[arg-type]
    calm = 1000 + np.where(np.arange(60) < 30, 2.0, 30.0)[:, None, None] * rng.standard_normal(
        (60, 3, 4)
    )
    calm[[8, 20, 33, 59], 1, 2] += 90.0
    wild = rng.standard_t(2, (41, 9, 11)) * np.exp(np.arange(41) / 9)[:, None, None]
    return {
        "modules": [factors_of_modules(factor) for factor in (1.01, 1.1, 1.3, 1.6, 2.5)],
        "warnings": shared,
        "odd modules": [odd_modules(count) for count in (2, 3)],
        "scores": [explanation.score],
        "corrections": CircuitEffects(pair=effects).corrections,
        "usual": outliers.detect_outliers(calm, np.full(calm.shape, 2.0))[0].nonzero(),
        "wild": outliers.detect_outliers(wild, np.full(wild.shape, 0.3))[0].sum(axis=(1, 2)),
    }


def ends_row() -> list[Any]:
    """Channels that end together by chance, with others a little below, all, or those of a row."""
    steps = np.r_[np.linspace(0, 0.9, 5), np.linspace(3, 9, 6), np.linspace(12, 300, 45)]
    rows = list[Any]()
    row = np.r_[np.linspace(0, 0.5, 8), np.linspace(60, 300, 48)]
    for below in (steps, np.where(steps < 10, 0.1 * steps, steps), steps / 40, row):
        for order in (np.random.default_rng(4).permutation(below), below):
            for sign in (1, -1):
                volt = (2.5 + sign * (0.47 - 0.0024 * order)).reshape(WIDE.shape)
                ends = np.broadcast_to((5 - volt) / volt * 1000, (9, *WIDE.shape))
                rows.append(saturated(replace(recorded(), recorded=ends)))
    return rows


def values_row() -> dict[str, Any]:
    """Numbers and bounds of single values and deviations, with a readout and without."""
    values = np.full((2, 4, 5), 720.0)
    rows = {}
    values[0].flat[:9] = np.nan, np.inf, 1e9, 100.0, 0.0, -5.0, -np.inf, 139.9, 200.0
    sigma = np.full((4, 5), 2.0)
    sigma[3, 1:3] = np.nan, np.inf
    for name, readout in (("readout", TWO), ("none", None)):
        scene = lp.Scene(PANEL, readout, 140.0)
        for given in (None, sigma, np.stack([sigma, 2 * sigma])):
            read = lp.Readings.of(scene, values, given)
            parts = read, read.mean(), read[0].together(read[1])
            rows[f"{name} {None if given is None else given.ndim}"] = [
                (each.value, each.side, each.seen, each.sigma) for each in parts
            ]
    return rows


def changed_row() -> dict[str, Any]:
    """Cells that moved, by their changes and a precision."""
    rng = np.random.default_rng(7)
    root = rng.standard_normal((20, 20))
    precision = 30 * (root @ root.T / 20 + np.eye(20))
    change = 0.1 * rng.standard_normal(20)
    change[[3, 4, 9]] -= 1.5
    moved = np.abs(change) > 1
    return {
        "starts": evidence.usual_starts(change),
        "touching": evidence.touching(moved.reshape(1, 4, 5)),
        "away": [evidence.away_from_changed(~part, (4, 5)) for part in (moved, change > 0)],
        "still": [evidence.mostly_still(part) for part in (moved, ~moved)],
        "selected": [
            evidence.select_changed(precision @ change, precision, evidence.usual_starts(change))
        ],
        "scores": evidence.scores_with_errors(change, precision, rng.standard_normal((20, 4))),
    }


def of_checks() -> Rows:
    rows: Rows = {
        f"prepared {name}": lambda made=made: prepared_row(made())
        for name, made in RECORDED.items()
    }
    return rows | {
        "outliers": outliers_row,
        "scatter": scatter_row,
        "changed cells": changed_row,
        "contacts": contacts_row,
        "mistakes": mistakes_row,
        "values": values_row,
        "ends": ends_row,
    }


# Recognition

WATCHED = lp.Scene(
    lp.Panel(6, 7),
    lp.TwoPointReadout(noise_lsb=0.7, adc_bits=12),
    140.0,
    response=lp.PublishedResponse(),
)
SWINGING = lp.Course(
    start_s=1.0, approach_s=0.5, attachment_s=0.5, breathing_hz=1.1, breathing_depth=0.15
)
ON_FILM: dict[str, tuple[tuple[lp.Shape, ...], lp.Course, int, float]] = {
    "nothing": ((), lp.Course(), 6, 1.0),
    "rod": (
        (replace(SHAPES["rod"], centre_mm=(28.0, 24.0), mass_g=700.0),),
        lp.Course(start_s=1.0, release_at_s=5.0),
        8,
        1.0,
    ),
    "ring": (
        (replace(SHAPES["ring"], centre_mm=(28.0, 24.0), outer_diameter_mm=30.0),),
        lp.Course(start_s=1.0),
        5,
        1.0,
    ),
    "block": ((replace(SHAPES["block"], centre_mm=(28.0, 24.0)),), lp.Course(start_s=1.0), 5, 1.0),
    "two": (
        (
            lp.Rod(centre_mm=(10.0, 12.0), diameter_mm=20.0, mass_g=500.0),
            replace(SHAPES["oral_disc"], centre_mm=(44.0, 36.0)),
        ),
        lp.Course(start_s=1.0, release_at_s=6.0),
        8,
        1.0,
    ),
    "mouth": (
        (replace(SHAPES["oral_disc"], centre_mm=(28.0, 24.0), diameter_mm=33.0),),
        SWINGING,
        40,
        0.25,
    ),
}


@cache
def detected(name: str, purpose: Any = None) -> Detected:
    loads, course, frames, period = ON_FILM[name]
    simulation = lp.Simulation(
        1,
        3,
        replace(WATCHED, purpose=purpose),
        loads=loads,
        course=course,
        frames=frames,
        frame_period_s=period,
    )
    with tempfile.TemporaryDirectory() as folder:
        lp.simulate(simulation, name).save(Path(folder) / f"{name}.h5")
        return detection.detect_recording(Path(folder) / f"{name}.h5")


def detected_row(name: str, purpose: Any = None) -> dict[str, Any]:
    return answer_row(detected(name, purpose))


def bare_row() -> dict[str, Any]:
    """A rod on a panel of which neither circuit nor noise are known."""
    loads, course, _, _ = ON_FILM["rod"]
    scene = lp.Scene(lp.Panel(6, 7), response=lp.PublishedResponse())
    unmodelled = lp.Unmodelled(drift_per_minute=0.1)
    recording = lp.simulate(
        lp.Simulation(1, 3, scene, loads=loads, course=course, frames=5, unmodelled=unmodelled)
    )
    with tempfile.TemporaryDirectory() as folder:
        recording.save(Path(folder) / "bare.h5")
        return answer_row(detection.detect_recording(Path(folder) / "bare.h5"))


def frames_of(recording: lp.Recording) -> detection.Frames:
    """Values, σ and time of the measured frames."""
    return detection.measured_frames(
        recording, detection.known_of(Prepared(recording)), recording.role == 1
    )


def answer_row(answer: Detected) -> dict[str, Any]:
    return {
        "answer": answer.content(),
        "sentence": answer.sentence,
        "events": answer.events,
        "notes": answer.notes,
        "course": answer.course,
        "change": answer.change,
        "warnings": answer.warnings,
        "called": answer.called,
        "tables": [event_table([answer]), load_table([answer])],
        "alarming": alarming(answer),
        "loads": [
            [load.area_mm2, load.conductance_s, load.cells, load.lives]
            for load in answer.attachments
        ],
    }


@cache
def verdict_of(name: str) -> tuple[Verdict, observation.Observation]:
    """One frame under a load, against three without."""
    loads, _, _, _ = ON_FILM[name]
    readings = lp.simulate(lp.Simulation(1, 3, WATCHED, frames=1, loads=loads)).readings()
    resting = readings[[0, 1, 2]].mean()
    baseline = observation.Baseline.of(
        resting.value,
        resting.sigma,
        WATCHED,
        observation.ModelErrors(reading_error=0.01),
    )
    frame = observation.Observation(
        readings.value[3], readings.sigma[3], baseline, np.zeros((6, 7)), 30.0
    )
    return Detector(6.0).verdict(frame), frame


def verdict_row(name: str) -> dict[str, Any]:
    verdict, frame = verdict_of(name)
    pressures = np.r_[-1e4, np.linspace(-12.0, 60.0, 40), 500.0].reshape(6, 7)
    return {
        "under water": replace(frame, water=np.full((6, 7), 2.0)).change(pressures),
        "changed": verdict.changed,
        "suctions": [
            [place.cells, place.probability, place.x_mm, place.y_mm] for place in suctions(frame)
        ],
        "nothing": verdict.nothing,
        "clear": verdict.clear,
        "change": verdict.change,
        "discs": [[disc.disc, disc.report, disc.goodness] for disc in verdict.discs],
    }


def breathing_row() -> dict[str, Any]:
    """Readings that swing with suction and rim, and the belief in breath over three windows."""
    rng = np.random.default_rng(1)
    times = np.arange(32) / 4
    rise = np.repeat([-2.0, 1.0], 12)
    slopes = np.where(rise < 0, -300.0, 90.0)
    moves = 8 * rng.standard_normal((1, 24))
    swing = 0.08 * np.outer(
        np.sin(2 * np.pi * 1.1 * times), slopes * (0.9 + 0.1 * rng.standard_normal(24))
    )
    patterns = Patterns.of(
        np.eye(24),
        rise,
        slopes[None],
        0.2 * np.abs(slopes),
        moves,
        rng.standard_normal((24, 1)),
    )
    changes = settled(swing + rng.standard_normal(swing.shape))
    interval = SteadyFrames.of(times, changes)
    swing_breath = breath(interval, changes, patterns)
    results = [
        breath(SteadyFrames.of(times[part], changes[part]), changes[part], patterns)
        for part in (slice(10), slice(None, None, 2))
    ]
    parted, remaining = interval.parted((3.0, 5.5))
    stepped = changes[remaining] + 40.0 * (parted.part == 1)[:, None] * slopes / 300.0
    results += [parted.times, parted.part, parted.trend(), breath(parted, stepped, patterns)]
    pull = (times > 2.9) & (times < 5.1)
    results.append(breath(interval, changes + 0.5 * pull[:, None] * slopes, patterns))
    belief = [Breathing()]
    courses = list[Any]()
    for full in (False, True, True):
        belief.append(belief[-1].after(swing_breath, 8.0, full=full))
    for _ in range(12):
        state = Breathing()
        for window in range(6):
            suction = float(rng.choice([0.02, 0.4, 0.7, 0.96]))
            observed = Breath(
                float(rng.choice([-4.0, -0.3, 0.4, 3.0])), suction, (1.0, 0.1 * window), (0.1, 0.02)
            )
            state = state.after(
                observed if rng.random() < 0.9 else None, 8.0, full=bool(rng.random() < 0.6)
            )
            courses.append(
                [
                    state.odds,
                    state.previous_odds,
                    state.suction,
                    state.last,
                    state.causes,
                    (state.hertz or (0, 0))[1],
                ]
            )
    pumping = Pumping.begin(np.ones(4) / 4, np.zeros(4), 0.0, 3)
    for number in range(30):
        pumping = pumping.after(
            0.02 * rng.standard_normal(4) + 0.3 * (number % 10 > 6), 0.5 * number
        )
    moved = Pumping.begin(np.ones(4), np.ones(4), 15.0, 4, pumping).after(
        np.array([4 * [1.0], 4 * [1.2]]), 17.0
    )
    return {
        "breath": swing_breath,
        "belief": belief,
        "probability": [state.probability for state in belief],
        "slow": too_slow(1.5),
        "too few": results,
        "pumping": [pumping.odds, np.sort(pumping.logarithm, axis=-1)],
        "pumps": [pumping.pumps, pumping.interval_s, pumping.observed_s],
        "courses": courses,
        "moved": [moved.odds, np.sort(moved.logarithm, axis=-1)],
    }


def patterns_row() -> list[Any]:
    """Swings of a mouth beside a rod in air and under water, in readings."""
    verdict, frame = verdict_of("two")
    rng = np.random.default_rng(3)
    value = frame.measured.ravel()
    sigma = frame.sigma.ravel()
    whitening = np.diag(value / sigma) + 5 * rng.standard_normal((42, 42))
    logarithms = np.log(value) + 1e-3 * rng.standard_t(2, (9, 42))
    rows = list[Any]()
    for depth in (0.0, 2.0):
        submerged = replace(frame, water=depth + np.arange(42).reshape(6, 7) / 40)
        patterns = patterns_of(replace(verdict, frame=submerged), whitening)
        rows += [patterns, [pattern.suction_weights(whitening) for pattern in patterns]]
        interval = SteadyFrames.of(np.arange(9) / 4, logarithms)
        rows.append(changes_without_water(interval, submerged, verdict.change))
    return rows


def watch_begun() -> tuple[Watch, lp.Readings]:
    """A watch before its first frame, and the readings of four frames.

    Three frames are without a rod and one is with it.
    """
    readings = lp.simulate(
        lp.Simulation(1, 3, WATCHED, frames=1, loads=ON_FILM["rod"][0])
    ).readings()
    setup = WatchSetup(
        WATCHED, Detector(6.0), np.zeros((6, 7)), observation.ModelErrors(reading_error=0.01)
    )
    return Watch.begin(
        setup, readings.value[0], readings.sigma[0], readings.value[:3], 2.0
    ), readings


def recognised_row() -> list[Any]:
    """A watch that recognises a rod, a faint one, nothing, or a rod that left before."""
    verdict, _ = verdict_of("rod")
    rows = list[Any]()
    initial, readings = watch_begun()
    resting = initial.rest.mean
    initial = replace(initial, present=True, level=replace(initial.level, since_s=3.0))
    loaded = np.log(readings.value[3].ravel())
    look = Look.after(None, verdict, np.ones(len(initial.test.loud)), 2.5)
    states = [
        replace(initial, look=previous_look, known=known)
        for previous_look, known in product((None, look), (False, True))
    ]
    for state, nothing_share, share in product(states, (1.0, 0.05, 0.04), (1.0, 0.0)):
        shown = share * resting + (1 - share) * loaded
        level = replace(state.level, mean=shown)
        watch = replace(state, level=level, window=tuple((3.5 + k, shown) for k in range(3)))
        judged = replace(verdict, nothing=nothing_share)
        with patch.object(Detector, "verdict", return_value=judged):
            watch = watch._looked(5.0)
        times = [(load.since_s, load.until_s or 0.0) for load in watch.attachments]
        last_look = watch.look and [watch.look.time_s, watch.look.over, watch.look.size.sum()]
        rows.append(
            [
                watch.present,
                watch.known,
                watch.next_s,
                watch.history,
                last_look,
                watch.rest.frames,
                times,
            ]
        )
        rows.append([np.sum(part) for part in (watch.rest.mean, watch.film_sd)])
    return rows


def steps_row() -> list[Any]:
    """A watch that follows noise, a rod, a harder press that ends, and the end of the rod."""
    verdict, _ = verdict_of("rod")
    rng = np.random.default_rng(6)
    rows = list[Any]()
    initial, readings = watch_begun()
    watch = initial
    states = list[Watch]()
    resting = initial.rest.mean
    rod = np.log(readings.value[3].ravel()) - resting
    shares = (0, 0, 0, 0.01, 1, 1, 1, 1, 1.6, 1.6, 1.6, 1, 1, 1, 0, 0, 0, 0, 0.3, 0.3, 0.3)
    times = 3.0 + 0.25 * np.arange(len(shares)) + 30.0 * (np.arange(len(shares)) > 16)
    for number, (time, share) in enumerate(zip(times, shares, strict=True)):
        measured = np.exp(resting + share * rod + 1e-3 * rng.standard_normal(42)).reshape(6, 7)
        sigma = np.where(np.arange(42).reshape(6, 7) == number, np.nan, readings.sigma[0])
        watch = watch.followed(measured, sigma, time)
        states.append(watch)
        if number == 6:
            size = watch.test.sizes(watch.level.mean - resting)
            watch = replace(
                watch, known=True, look=Look.after(None, verdict, size, time), former=None
            )
        if number == 16:
            watch = watch._gone(time)
    for state in (*states, states[10].former or initial):
        levels = [
            [np.sum(phase.mean), phase.frames, phase.since_s, phase.until_s]
            for phase in (state.rest, state.level)
        ]
        held = [
            state.present,
            state.known,
            state.next_s,
            state.steps,
            np.sum(state.recent),
            state.stands_out,
        ]
        rows.append([levels, held, state.test.loud.sum(), state.doubt, state.faults])
        rows.append([(at, *frame[:3]) for at, frame in state.window])
        rows.append(state.look and state.look.fading(40.0).sum())
    stepped = replace(states[8], film_sd=0.03)
    for share in (1.6, 0.5, 0.15, 0.1, 0.0):
        later = stepped._frame(resting + share * rod, 7.0)
        rows.append(
            [
                later.baseline.covariance.diagonal(),
                stepped._left(later),
                np.sum(stepped._keeps(later)),
            ]
        )
        rows.append(stepped._resumed(resting + share * rod).known)
    loud = np.geomspace(0.01, 30.0, len(initial.test.loud))
    rows += [replace(initial.test, loud=factor * loud).least() for factor in (0.01, 1.0)]
    frames = np.repeat(readings.value[:1], 6, axis=0)
    frames[2:5] = readings.value[3]
    missing = np.where(np.arange(42).reshape(6, 7) == 8, np.nan, frames)
    return [
        *rows,
        [initial.touched(part) for part in (frames[:3], frames[:4], frames, missing, frames[:2])],
    ]


def swings_row() -> list[Any]:
    """Windows of a mouth beside a rod that are too short, partial and full."""
    verdict, frame = verdict_of("two")
    rng = np.random.default_rng(3)
    rows = list[Any]()
    initial, _ = watch_begun()
    (pattern,) = patterns_of(verdict, initial.test.whitening)
    mouth = Attachment(0.9, 0.0, (44.0, 1.0), (36.0, 1.0), patterns=pattern)
    departed = replace(mouth, until_s=4.0)
    faint = replace(mouth, sucks=0.4)
    rod = replace(mouth, patterns=None)
    logarithm = np.log(frame.measured.ravel())
    suction = np.linalg.solve(initial.test.whitening, pattern.own[:, 0])
    look = Look.after(None, verdict, np.ones(len(initial.test.loud)), 0.0)
    for lasts, full_s in ((3.0, -np.inf), (6.0, -np.inf), (8.0, -np.inf), (12.0, 4.0), (12.0, 5.0)):
        at = 1.0 + np.arange(0.0, lasts, 0.25)
        swings = logarithm + 0.06 * np.outer(np.sin(2 * np.pi * at), suction)
        window = tuple(
            zip(at.tolist(), swings + 1e-3 * rng.standard_normal(swings.shape), strict=True)
        )
        breath = Breathing(full_s=full_s)
        loads = tuple(replace(load, breath=breath) for load in (mouth, departed, faint, rod))
        watch = replace(
            initial, present=True, known=True, look=look, window=window, attachments=loads
        )
        heard = watch._heard()
        rows.append([load.breath for load in heard.attachments])
        moved = tuple(
            replace(load, moved_s=times) for load in heard.attachments for times in ((), (2.0,))
        )
        returned = replace(heard, attachments=moved)._heard()
        for track in filter(
            None, (load.track for load in (*heard.attachments, *returned.attachments))
        ):
            rows.append(
                [
                    track.odds,
                    track.since_s,
                    track.moves,
                    np.abs(track.weights).sum(),
                    track.moments.mean.sum(),
                ]
            )
    return [
        *rows,
        replace(mouth, patterns=pattern) == replace(mouth, patterns=pattern._replace(rim=1)),
        str(mouth),
    ]


def outlying_row() -> list[Any]:
    """One or five outliers of several sizes, where the errors of neighbours are correlated."""
    root = np.linalg.cholesky(0.95 ** np.abs(np.subtract.outer(np.arange(120), np.arange(120))))
    noise = root @ np.random.default_rng(1).standard_normal(120)
    wrong = np.eye(120)[[7, 8, 50, 90, 92]]
    cases = product(
        (1.0, 1.5, 3.0, 60.0),
        (wrong[0], wrong[:2].sum(axis=0), wrong.T @ [1.0, -1.0, 3.0, 2.0, 2.0]),
    )
    return [
        most_probable.outliers(most_probable.Whitening(root), noise + size * each)
        for size, each in cases
    ]


def watch_over(layout: Modules, cells: lp.Array, dead: int) -> tuple[ImageWatch, lp.Array]:
    """Watch of a panel of modules after three unloaded frames at 0 s, and σ of its readings.

    The module `dead` is not read.
    """
    scene = lp.Scene(lp.Panel(modules=layout), TWO, 140.0)
    measured = image_of(layout, cells)
    sigma = 0.002 * measured
    sigma[layout.cells(dead)] = np.inf
    setup = WatchSetup(scene, Detector(6.0), np.zeros(layout.shape), observation.ModelErrors())
    return ImageWatch.begin(setup, measured, sigma, np.stack([measured] * 3), 0.0), sigma


def image_of(layout: Modules, cells: lp.Array) -> lp.Array:
    return layout.joined(lp.two_point_resistance(layout.split(cells)))


def states_of(watch: ImageWatch) -> list[Any]:
    states = [*watch.modules.values(), *(inside for _, inside, _ in watch.opened)]
    return list(map(state_of, states))


def state_of(state: Watch) -> list[Any]:
    levels = [
        [level.mean, level.frames, level.since_s, level.until_s]
        for level in (state.rest, state.level)
    ]
    scalars = [
        state.recent,
        state.film_sd,
        state.window,
        state.steps,
        state.present,
        state.known,
        state.next_s,
    ]
    return [levels, scalars, state.history, state.faults, state.stands_out]


def opened_row() -> list[Any]:
    """A watch over modules of different pasts, one of them dead."""
    layout = Modules(2, 2, EachModule(3, 3))
    levels = np.array([3.0, 2.0, 1.5, 1.0])[:, None, None]
    watch, sigma = watch_over(layout, layout.joined(1e3 * levels * np.ones((4, 3, 3))), 3)
    parts = {
        number: replace(
            part,
            test=replace(part.test, loud=part.test.loud + number),
            rest=replace(
                part.rest, frames=float((5, 3, 4)[number]), until_s=(1.0, 2.5, 2.0)[number]
            ),
            level=replace(part.level, mean=part.level.mean - number, until_s=3.5 - number),
            recent=(part.level.mean + number, part.level.mean + 2 * number),
        )
        for number, part in watch.modules.items()
    }
    middle, corner = (
        Window.about(watch.setup.scene, np.array(place)) for place in ((20.0, 20.0), (55.0, -9.0))
    )
    watch = replace(watch, modules=parts)
    initial = watch._begun(middle, sigma)
    numbers = np.arange(36.0)
    baseline = replace(initial.rest, mean=numbers)
    level = replace(initial.level, mean=numbers + 40)
    departed = replace(
        initial,
        rest=baseline,
        level=level,
        recent=(numbers + 80, numbers + 120),
        history="it left at 6.0 s",
    )
    opened = replace(watch, opened=((middle, departed, 20.0), (corner, departed, 21.0)))
    rows: list[Any] = [state_of(initial), initial.test.loud, middle.numbers, corner.numbers]
    return rows + [states_of(opened._closed(time)) for time in (79.9, 80.0)]


def image_row() -> list[Any]:
    """A panel of modules, one of them dead."""
    layout = Modules(1, 4, EachModule(4, 4), seam_mm=4.0)
    resting = np.repeat([3000.0, 2000.0, 1500.0, 2500.0], 4) * np.ones((4, 1))
    loaded = resting.copy()
    small = resting.copy()
    loaded[1:3, 2:6], small[1:3, 5:7] = 700.0, 800.0
    images = [image_of(layout, cells) for cells in (resting, loaded, small)]
    watch, sigma = watch_over(layout, resting, 3)
    rows: list[Any] = [watch.change]
    times = (0.5, 1.0, 1.25, 1.5, 2.5, 5.0, 5.25, 65.0, 65.6, 66.0, 66.25, 66.5)
    for time, number in zip(times, (0, 1, 1, 1, 1, 0, 0, 0, 0, 2, 2, 2), strict=True):
        watch = watch.push(images[number], sigma, time)
        if time in (1.0, 1.25, 5.25, 65.6, 66.5):
            rows.append(states_of(watch))
        rows.append([[window.numbers, touched_s] for window, _, touched_s in watch.opened])
        rows += [watch.doubt, watch.stands_out, watch.change]
    return [*rows, watch.attachments, watch.ended().attachments]


def windows_row() -> Any:
    """Windows about places of a panel of modules, and loads that two of them see."""
    scene = lp.Scene(lp.Panel(modules=Modules(2, 3, EachModule(6, 7), 4.0)), TWO, 140.0)
    rng = np.random.default_rng(9)
    places = (
        (69.0, 100.0),
        (143.0, 100.0),
        (140.0, 60.0),
        (-5.0, 400.0),
        (80.0, 45.0),
        (27.0, 57.0),
    )
    windows = [Window.about(scene, np.array(place)) for place in places]

    def loads(window: Window, count: int) -> tuple[Attachment, ...]:
        drawn = zip(
            rng.uniform(50, 160, count),
            rng.uniform(20, 110, count),
            rng.integers(4, size=count),
            strict=True,
        )
        return tuple(
            Attachment(
                0.9,
                float(kind),
                (x - window.x_mm, 0.5),
                (y - window.y_mm, 0.5),
                (30.0, 1.0) if kind else None,
                area_mm2=(900.0, 90.0),
                until_s=None if kind < 2 else kind + 0.5,
            )
            for x, y, kind in drawn
        )

    def opened(window: Window) -> Any:
        return window, SimpleNamespace(attachments=loads(window, 3)), 0.0

    cases = [
        ImageWatch(None, {}, tuple(map(opened, windows[:2])), loads(windows[3], 4))
        for _ in range(12)
    ]  # type: ignore[arg-type]
    numbers = [
        [window.numbers, window.x_mm, window.y_mm, window.middle, str(window.cells)]
        for window in windows
    ]
    circuit = windows[2].scene.circuit
    cells = cells_of((12, 14))
    network = circuit.network(cells, circuit.ties(cells), None)
    offsets = observation.ModelErrors().offsets(cells, windows[2].scene)
    return {
        "windows": numbers,
        "series": circuit.series_ohm,
        "merged": [
            [(*load.place, load.since_s, load.present) for load in case._merged()] for case in cases
        ],
        "unit": circuit.unit,
        "start": circuit.uniform_start(cells),
        "reading": network.reading(),
        "sensitivity": network.sensitivity(),
        "offsets": offsets,
        "offset of cell": np.abs(offsets).sum(axis=1),
    }


def answers_row() -> dict[str, Any]:
    """Answers on loads: alone, together, gone, with breath and pumps."""
    observed = Attachment(
        0.99,
        6.0,
        (44.1, 0.6),
        (46.0, 0.6),
        (35.0, 1.6),
        ((-11.0, 1.9),),
        cells=12,
        area_mm2=(1200.0, 100.0),
    )
    breath = Breathing(6.0, hertz=(1.1, 0.05), depth=(0.08, 0.01))
    mouth = replace(observed, sucks_s=8.0, moved_s=(12.0,), breath=breath)
    rod = replace(observed, sucks=0.0, suctions=())
    departed = replace(mouth, since_s=5.0, until_s=30.0)
    still = Pumping.begin(np.ones(1), np.zeros(1), 0.0, 0)
    pumping = replace(
        still, logarithm=still.logarithm + np.array([0, 0, 6.0]).reshape(3, 1, 1, 1, 1)
    )
    contacts = [replace(rod, diameter_mm=None, x_mm=(float(x), 1.0)) for x in range(8)]
    changes: tuple[dict[str, Any], ...] = (
        {"odds": 9.0},
        {"odds": -4.0, "previous_odds": -4.0, "max_depth": 0.02},
        {"odds": -4.0},
        {"odds": 1.0},
        {"odds": 0.0},
        {"odds": 4.0, "suction": 0.02},
        {"odds": 0.0, "hertz": None},
    )
    breaths = [replace(mouth, breath=replace(breath, **change)) for change in changes]
    alone = [mouth, departed, rod, replace(mouth, sucks=1.0), replace(mouth, sucks=0.02), *breaths]
    alone += [
        replace(attachment, track=track)
        for attachment in (observed, breaths[2])
        for track in (still, pumping)
    ]
    groups = [[load] for load in alone] + [
        [mouth, departed],
        [departed, mouth],
        [rod, mouth],
        [mouth, mouth],
        contacts,
        [],
    ]
    answers = [Detected.of("mouth", tuple(loads), rate) for loads in groups for rate in (1.0, 4.0)]
    return {
        "answers": list(map(answer_row, answers)),
        "lives": [[load.lives, load.pumps] for load in alone],
        "without a rate": [replace(answer, frames_per_second=None).called for answer in answers],
    }


def attachments_row() -> Any:
    """Loads that stay, leave, come or fade from one recognition to the next."""
    rng = np.random.default_rng(5)
    courses = []
    frame: Any = None  # of loads whose cells are not known

    def joined(before: Any, loads: Any, time: float, *, again: bool = False) -> Any:
        return continued_by(before, loads, time, frame, lambda _: True, again=again)

    for _ in range(20):
        present: tuple[Attachment, ...] = ()
        for time, returns in ((1.0, False), (4.0, False), (4.0, True), (6.0, False)):
            drawn = zip(rng.uniform(0, 60, 3), rng.integers(8, size=3), strict=True)
            loads = [
                Attachment(
                    0.9 if kind < 4 else 0.1,
                    time,
                    (x, 0.6),
                    (0.0, 0.6),
                    None if kind % 2 else (15.0, 1.0),
                    clear=float(900 * (kind % 3)),
                )
                for x, kind in drawn
            ]
            present = joined(present, loads, time, again=returns)
        courses.append(
            [
                (*load.place, load.since_s, load.until_s or 0.0, load.sucks, len(load.moved_s))
                for load in present
            ]
        )
    loads = [
        Attachment(0.2, float(k), (20.0 * k, 0.6), (9.0 * k, 0.6), (15.0, 1.0), cells=5)
        for k in range(4)
    ]
    present = joined((), loads[:2], 1.0)
    present = joined(
        present, [replace(loads[1], x_mm=(24.0, 0.6), sucks=0.9, since_s=3.0), loads[3]], 3.0
    )
    returned = joined(
        present, [replace(loads[3], y_mm=(30.0, 0.5), diameter_mm=(20.0, 2.0))], 3.0, again=True
    )
    return {
        "attachments": [present, returned, joined(returned, [], 8.0)],
        "courses": courses,
        "sizes": [[load.size, load.width, load.lives] for load in present],
    }


def of_recognition() -> Rows:
    fitted: Rows = {f"detected {name}": partial(detected_row, name) for name in ON_FILM}
    fitted |= {f"verdict on {name}": partial(verdict_row, name) for name in ON_FILM}
    fitted |= {
        "detected without a readout": bare_row,
        "detected on a mat": partial(detected_row, "block", "mat"),
        "swings": swings_row,
        "patterns": patterns_row,
        "detected on modules": lambda: answer_row(
            detection.known_of(Prepared(tiled())).answer(frames_of(tiled()))
        ),
    }
    return {name: of_kind("fitted", row) for name, row in fitted.items()} | {
        "breathing": breathing_row,
        "recognitions": recognised_row,
        "steps": steps_row,
        "outliers": outlying_row,
        "errors": lambda: [
            observation.ModelErrors().of_scene(replace(WATCHED, systematic=each), 0.02)
            for each in (
                None,
                "none",
                lp.Systematic(reference_tolerance=0.05, channel_spread_ohm=7.0),
            )
        ],
        "answers": answers_row,
        "attachments": attachments_row,
        "watch over modules": image_row,
        "windows over modules": windows_row,
        "states over modules": opened_row,
    }
