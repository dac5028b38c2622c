"""Changes of a circuit by the tolerances of its resistors and channels, and by calibration."""

from dataclasses import replace
from math import inf
from typing import Any, TypeVar

import numpy as np

from lampest.panel.circuit import nominal_terminations
from lampest.panel.lines import (
    LineNumber,
    SeriesPerLine,
    along,
    as_tuple,
    of_side,
    opposite,
    with_channels,
)
from lampest.panel.panel import Array
from lampest.panel.readouts.keys import entry
from lampest.panel.readouts.readout import Readout
from lampest.panel.scene import Scene

Circuit = TypeVar("Circuit", bound=Readout)


def off_by(circuit: Circuit, fraction: float | Array) -> Circuit:
    """Return the circuit with every reference resistor larger by a fraction, or by one each.

    The circuit itself is returned if its kind has no such key.
    """
    name = circuit.of_sensed[0]
    value = entry(circuit, name)
    if value is None:
        return circuit
    larger = np.array(value) * (1 + fraction)
    changes: dict[str, Any] = {name: tuple(larger.tolist()) if larger.ndim else float(larger)}
    return replace(circuit, **changes)


def behind_channels(circuit: Circuit, row_ohm: Array, column_ohm: Array) -> Circuit:
    """Return the circuit with additional channel resistances, (rows,) and (columns,) ohm.

    Sensed lines without a channel have none in addition; see `Readout.channels`.
    """
    driven, sensed = of_side(nominal_terminations(circuit).driven, row_ohm, column_ohm)
    of_driven, of_sensed = circuit.channels
    additional = {of_driven: driven} if of_driven else {}
    if entry(circuit, of_sensed):
        additional[of_sensed] = sensed
    named = "series_resistance_ohm" if circuit.unit == "ohm" else ""
    changes: dict[str, Any] = {
        key: with_channels(named or key, getattr(circuit, key), ohm)
        for key, ohm in additional.items()
    }
    return replace(circuit, **changes) if changes else circuit


def scene_behind_channels(scene: Any, row_ohm: Array, column_ohm: Array) -> Any:
    """Return the scene with additional channels, (rows,) and (columns,) ohm.

    Channels of a two-point readout are resistances in series. Raises ValueError where one would be
    negative.
    """
    if scene.circuit.unit != "ohm":
        return replace(scene, readout=behind_channels(scene.readout, row_ohm, column_ohm))
    key = "series_resistance_ohm"
    rows, columns = (
        with_channels(key, tuple(lines), ohm)
        for lines, ohm in zip(scene.series_lines, (row_ohm, column_ohm), strict=True)
    )
    return replace(scene, series_resistance_ohm=SeriesPerLine(rows=rows, columns=columns))


def _reading_behind(
    circuit: Readout, cells: Array, scene: Scene, row_ohm: Array, column_ohm: Array
) -> Array:
    """Return the readings with additional channels, which are part of a resistance that is read."""
    actual = behind_channels(circuit, row_ohm, column_ohm)
    reading = actual.exact_reading(cells, scene.wiring)
    return reading + (row_ohm[:, None] + column_ohm) if circuit.unit == "ohm" else reading


def simulated(
    circuit: Readout, cells: Array, scene: Scene, row_ohm: Array, column_ohm: Array
) -> Array:
    """Return recorded values (frames, rows, columns) of cells, without noise and quantisation.

    `row_ohm` and `column_ohm` are additional resistances of every line's channel, (lines of a
    side,) ohm.
    """
    return circuit.to_recorded(_reading_behind(circuit, cells, scene, row_ohm, column_ohm), scene)


def reference_error(
    circuit: Readout, cells: Array, measured: Array, scene: Scene, fraction: float
) -> Array:
    """Return the effect of a relative error of the reference resistor on the readings.

    The effect is a secant of the model; see `off_by`. On resistances it is
    −(R + R_series)·fraction. `measured` are the readings of the cells, with two-point readouts also
    (…, rows, columns) of many panels; the result has their shape.
    """
    if circuit.unit == "ohm":
        return -(measured + scene.series_ohm) * fraction
    changed = off_by(circuit, fraction).exact_reading(cells, scene.wiring)
    return changed - circuit.exact_reading(cells, scene.wiring)


def channel_errors(
    circuit: Readout, cells: Array, measured: Array, scene: Scene, channel: float
) -> Array:
    """Return the effect of `channel` ohm more in each line's channel on the readings, rows first.

    Shape (rows + columns, …, rows, columns), for cells and readings as those of `reference_error`;
    see `simulated`. Where idle driven lines are not connected through their channels, the channel
    of a driven line changes the readings of this line alone, so that one network shows all of them.
    """
    rows, columns = measured.shape[-2:]
    errors = np.zeros((rows + columns, *measured.shape))
    if circuit.two_point:
        np.einsum("j...jk->j...k", errors[:rows])[...] = channel
        np.einsum("k...jk->k...j", errors[rows:])[...] = channel
        return errors
    lines = np.eye(len(errors))
    side = nominal_terminations(circuit).driven
    driven, sensed = of_side(side, *np.split(np.arange(len(lines)), [rows]))
    unchanged = circuit.exact_reading(cells, scene.wiring)

    def error(chosen: Array) -> Array:
        added = np.split(channel * chosen, [rows])
        return _reading_behind(circuit, cells, scene, *added) - unchanged

    every = lines[driven].sum(axis=0)
    behind = behind_channels(circuit, *np.split(channel * every, [rows]))
    if np.array_equal(circuit.ties(cells), behind.ties(cells)):
        errors[driven] = error(every) * [along(side, own) for own in np.eye(len(driven))]
    else:
        errors[driven] = [error(one) for one in lines[driven]]
    if circuit.unit == "ohm" or entry(circuit, circuit.channels[1]):
        errors[sensed] = [error(one) for one in lines[sensed]]
    return errors


def line_numbers(circuit: Readout) -> tuple[LineNumber, ...]:
    """Return the numbers of a circuit that known resistors in place of the cells determine.

    They are resistances in series, which include channels, reference resistors, and a diode's drop.
    A kind without channels has none.
    """
    if circuit.unit == "ohm":
        return (
            LineNumber("series_resistance_ohm", ("rows", "columns"), channel=True, in_scene=True),
        )
    drive = circuit.channels[0]
    if not drive:
        return ()
    ends = nominal_terminations(circuit)
    numbers = [LineNumber(drive, (ends.driven,), channel=True)]
    name = circuit.of_sensed[0]
    if hasattr(circuit, name) and max(as_tuple(getattr(circuit, name))) < inf:
        numbers.append(LineNumber(name, (opposite(ends.driven),)))
    if ends.diode is not None:
        numbers.append(LineNumber("diode.drop_volt", (), unit="volt"))
    return tuple(numbers)
