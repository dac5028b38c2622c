"""Recordings of small panels for the C library: cells under a press that comes, moves and goes."""

from unittest import mock

import numpy as np

import lampest
from lampest.panel.readouts.tolerances import simulated

CIRCUITS = {
    "two_point": {"kind": "two_point", "noise_lsb": 0.7},
    "two_point_across_sensor": {
        "kind": "two_point",
        "measured_across": "sensor",
        "noise_lsb": 0.7,
        "input_ohm": 1e6,
    },
    "loaded_columns": {
        "kind": "loaded_columns",
        "load_ohm": 1000.0,
        "drive_ohm": 100.0,
        "noise_lsb": 0.7,
    },
    "pull_ups": {
        "kind": "loaded_columns",
        "load_ohm": 3000.0,
        "drive_ohm": 30.0,
        "noise_lsb": 0.7,
        "polarity": "down",
    },
    "driven_columns": {
        "kind": "loaded_columns",
        "load_ohm": 1000.0,
        "noise_lsb": 0.7,
        "driven": "columns",
    },
    "grounded_all": {
        "kind": "grounded",
        "sense": "all",
        "drive_ohm": 50.0,
        "load_ohm": 1000.0,
        "noise_lsb": 0.7,
    },
    "grounded_one": {
        "kind": "grounded",
        "sense": "one",
        "drive_ohm": 50.0,
        "load_ohm": 1000.0,
        "noise_lsb": 0.7,
    },
    "virtual_ground": {
        "kind": "virtual_ground",
        "drive_ohm": 70.0,
        "sense_ohm": 70.0,
        "feedback_ohm": 500.0,
        "noise_lsb": 0.7,
    },
}
CIRCUITS["pull_downs"] = {
    "kind": "driven",
    "drive_ohm": 70.0,
    "idle_ohm": 3300.0,
    "load_ohm": 1000.0,
    "idle_load_ohm": float("inf"),
    "noise_lsb": 0.7,
}
READOUTS = {
    "driven": lampest.DrivenReadout,
    "two_point": lampest.TwoPointReadout,
    "loaded_columns": lampest.LoadedColumnsReadout,
    "grounded": lampest.GroundedReadout,
    "virtual_ground": lampest.VirtualGroundReadout,
}


def scene_of(circuit, rows=6, columns=5, cells=None, series_ohm=0.0, **keys):
    """Return the scene of a circuit of CIRCUITS."""
    about = dict(CIRCUITS[circuit]) | {"adc_bits": 12, "readings": 4} | keys
    readout = READOUTS[about.pop("kind")](**about)
    return lampest.Scene(lampest.Panel(rows, columns, 10.0, cells=cells), readout, series_ohm)


def pressed_cells(scene, frames=8, unloaded=3, seed=0, ohm=4000.0, strength=1.2):
    """Return cells (frames, rows, columns) ohm: at rest, then under a press.

    The press moves along a diagonal.
    """
    rng = np.random.default_rng(seed)
    rows, columns = scene.panel.shape
    resting = ohm * np.exp(0.2 * rng.standard_normal((rows, columns)))
    cells = []
    for frame in range(frames):
        share = max(frame - unloaded, 0) / max(frames - unloaded, 1)
        place = np.array([rows - 1, columns - 1]) * (0.3 + 0.3 * share)
        distance = np.hypot(*(np.indices((rows, columns)) - place[:, None, None]))
        cells.append(
            resting * np.exp(-strength * (frame >= unloaded) * np.exp(-((distance / 1.2) ** 2)))
        )
    return np.where(scene.panel.present, cells, 1e12)


def sums_of(scene, cells, seed=1):
    """Return sums of codes (frames, rows, columns) of cells, with noise."""
    rng = np.random.default_rng(seed)
    readout = scene.circuit
    zero = np.zeros(scene.panel.rows), np.zeros(scene.panel.columns)
    volt = readout.volt_from_recorded(simulated(readout, cells, scene, *zero))
    codes = volt[..., None] / readout.lsb_volt + readout.noise_lsb * rng.standard_normal(
        (*volt.shape, readout.readings)
    )
    return np.clip(np.floor(codes), 0, 2**readout.adc_bits - 1).sum(axis=-1).astype(np.uint32)


def recording_of(scene, sums, unloaded=3):
    """Return the recording of sums."""
    readout = scene.circuit
    values = readout.recorded_from_volt(readout.volt_from_code(sums.astype(int) / readout.readings))
    return lampest.Recording.from_array(values, unit=readout.unit, baseline=unloaded, scene=scene)


def unchecked_case(estimate, name="estimator"):
    """Return the case of an estimate but for the check of its circuit, which no board computes.

    The check takes longer than all the rest; tests/oracles/test_model_check.py has it.
    """
    warnings = {"warnings": "\n".join(estimate.checks_without_circuit)}
    with mock.patch("lampest.runs.filling._audited", lambda estimates: warnings):
        return estimate.result(name)


def solved_case(scene, terms, seed=0, sums=None, unloaded=3, **options):
    """Return (sums of the measured frames, CaseResult) of a simulated recording."""
    if sums is None:
        sums = sums_of(scene, pressed_cells(scene, unloaded=unloaded, seed=seed), seed + 1)
    estimate = lampest.reconstruct(
        recording_of(scene, sums, unloaded), list(terms), formulation="reduced", **options
    )
    return sums[unloaded:], unchecked_case(estimate)
