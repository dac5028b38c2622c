"""The header of constants that the C library takes."""

import re

import numpy as np
import pytest

import lampest
from lampest.apps.microcontroller.constants import Constants
from lampest.apps.microcontroller.header import header

SINGLE_PRECISION = 1e-6


def array_of(text: str, field: str) -> lampest.Array:
    """The numbers of an array that a header declares."""
    declared = re.search(rf"panel_{field}\[\d*\] = \{{(.*?)\}}", text, flags=re.DOTALL)
    assert declared is not None
    return np.array([float(number) for number in re.findall(r"[-+.\de]+(?=f)", declared[1])])


def header_of(scene: lampest.Scene, cells: lampest.Array) -> str:
    """Return the header of an estimate of exact readings, the first two frames unloaded."""
    recorded = scene.circuit.to_recorded(scene.circuit.exact_reading(cells), scene)
    recording = lampest.Recording.from_array(
        recorded, unit=scene.circuit.unit, baseline=2, scene=scene
    )
    terms = [lampest.Misfit(weighting="noise"), lampest.LogGradient(weight=1.0)]
    case = lampest.reconstruct(recording, terms, formulation="reduced").result("smooth")
    return header(Constants.of(case), "panel", ())


def test_series_resistances_of_lines_add_up_to_those_of_the_readings() -> None:
    """A reading has the sum of its row's and its column's resistance."""
    rng = np.random.default_rng(5)
    rows = 4
    columns = 3
    lines = lampest.SeriesPerLine(
        rows=tuple(rng.uniform(50, 90, rows)), columns=tuple(rng.uniform(10, 40, columns))
    )
    panel = lampest.Panel(rows, columns)
    readout = lampest.TwoPointReadout(noise_lsb=0.7, readings=20)
    scene = lampest.Scene(panel, readout, series_resistance_ohm=lines)
    text = header_of(scene, rng.uniform(900, 2000, (5, rows, columns)))
    of_lines = array_of(text, "series")
    total = of_lines[:rows, None] + of_lines[rows:]
    assert total == pytest.approx(lines.ohm(panel), rel=SINGLE_PRECISION)


def test_mirrored_voltages_are_taken_from_the_potential_in_which_loads_end() -> None:
    """A converter's input of twice the pull-up leaves two thirds of the supply there."""
    readout = lampest.LoadedColumnsReadout(
        polarity="down", load_ohm=50e3, input_ohm=100e3, supply_volt=3.0, readings=4, noise_lsb=0.5
    )
    scene = lampest.Scene(lampest.Panel(4, 3), readout)
    text = header_of(scene, np.random.default_rng(5).uniform(9e3, 2e4, (5, 4, 3)))
    taken_from = re.search(r"supply_volt = ([\d.]+)f", text)
    assert taken_from is not None and float(taken_from[1]) == pytest.approx(2.0)
