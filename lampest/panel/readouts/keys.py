"""Keys that circuits share: the ends that they state, their limits, and their words.

`drive_ohm`, `sense_ohm`, `input_ohm`, `groups`, `idle_volt`, `load_volt` and all other keys of
`DrivenReadout` mean the same in every kind. A kind has the keys that it declares; the others count
as None.
"""

from math import inf
from typing import Any

import numpy as np

from lampest.panel.circuit import FOLLOWS, Ends, Terminations, nominal_terminations, scanned
from lampest.panel.equation import equation_of
from lampest.panel.lines import (
    as_tuple,
    check_apart,
    check_groups,
    check_resistors,
    lines_text,
    of_side,
    opposite,
    per_line,
)
from lampest.panel.panel import Array
from lampest.panel.readouts.converter import MAX_VOLT, converter_in_words

MAX_OFFSET_VOLT = 0.1  # amplifiers without trimming: 15 mV (data sheet of the LM324)


def entry(readout: Any, key: str) -> Any:
    """Return the value of a key; None if the kind does not have it."""
    return getattr(readout, key, None)


# Ends of the lines.


def driven_ends(readout: Any, count: int) -> Ends:
    """Return the ends of driven lines while they are driven: the source behind drive_ohm."""
    own = entry(readout, "drive_volt")
    source = readout.supply_volt if own is None else own
    at = 0.0 if entry(readout, "polarity") == "down" else source
    return Ends.of(per_line("drive_ohm", readout.drive_ohm, count), at)


def idle_ends(readout: Any, ohm: Array) -> Ends:
    """Return the ends of idle driven lines behind resistances (lines,) ohm, at idle_volt."""
    volt = entry(readout, "idle_volt")
    return Ends.of(ohm, _ground(readout) if volt is None else volt)


def load_ends(readout: Any, count: int) -> Ends:
    """Return the ends of sensed lines while they are read.

    A load at load_volt and the converter's input to ground are beside each other.
    """
    key = readout.of_sensed[0]
    load = Ends.of(per_line(key, getattr(readout, key), count), load_volts(readout)[0])
    input_ohm = entry(readout, "input_ohm")
    return load if input_ohm is None else load.beside(Ends.of(np.full(count, input_ohm)))


def ends_with_loads(
    readout: Any, drive: Ends, idle: Ends, together: Ends, sensed: int, *, loads_stay: bool
) -> Terminations:
    """Return the ends of all lines, where sensed ones have loads behind their channels.

    The gain is the share Rs/(Rc + Rs) of the voltage of the line that is read, 1 without a load and
    at the far end of a line.

    Parameters
    ----------
    readout : Readout
    drive, idle, together : Ends, shape (driven,)
        Of driven lines while they are driven, idle, and selected with a driven one of another group
        of `driven_groups`.
    sensed : int
        Number of sensed lines.
    loads_stay : bool
        Whether idle sensed lines keep their loads, or else end in idle_load_ohm, or float.
    """
    load = load_ends(readout, sensed)
    total = load.behind(per_line("sense_ohm", entry(readout, "sense_ohm") or 0.0, sensed))
    idle_load = total
    if not loads_stay:
        ohm = entry(readout, "idle_load_ohm")
        idle_ohm = per_line("idle_load_ohm", inf if ohm is None else ohm, sensed)
        idle_load = Ends.of(idle_ohm, load_volts(readout)[1])
    at_far_end = entry(readout, "read_at") == "far_end"
    with np.errstate(invalid="ignore"):
        gain = np.where(np.isinf(load.ohm) | at_far_end, 1.0, load.ohm / total.ohm)
    return Terminations(
        readout.driven,
        scanned(drive, idle, entry(readout, "driven_groups"), together),
        scanned(total, idle_load, entry(readout, "groups")),
        gain,
        at_far_end,
        diode=entry(readout, "diode"),
    )


def load_volts(readout: Any) -> tuple[float, float]:
    """Return the potentials in which loads, and idle sensed lines end, in volt."""
    volt = entry(readout, "load_volt")
    idle = entry(readout, "idle_load_volt")
    volt = _ground(readout) if volt is None else float(volt)
    return volt, volt if idle is None else idle


def _ground(readout: Any) -> float:
    """Return the potential of the ends without one of their own: ground, or the supply, in volt."""
    return float(readout.supply_volt) if entry(readout, "polarity") == "down" else 0.0


# Limits.


def check_keys(readout: Any) -> None:
    """Raise ValueError if a number is out of range, or if potentials contradict the circuit."""
    for name in (*readout.of_driven, *readout.of_sensed):
        value = entry(readout, name)
        if value is None:
            continue
        ohm = as_tuple(value)
        if name in readout.may_be_infinite:
            ohm = tuple(number for number in ohm if number != inf)
        if ohm or value == ():
            check_resistors(name, ohm, open_end=name not in readout.may_be_zero)
    if entry(readout, "input_ohm") is not None:
        check_resistors("input_ohm", readout.input_ohm, most=inf)
    for key in ("groups", "driven_groups"):
        if entry(readout, key) is not None:
            check_apart(getattr(readout, key), key)
    for name in ("idle_volt", "load_volt", "idle_load_volt"):
        volt = entry(readout, name)
        if isinstance(volt, float | int) and not abs(volt) <= MAX_VOLT:
            raise ValueError(f"{name} must lie within {MAX_VOLT:g} V of ground")
    offset = entry(readout, "offset_volt")
    if offset == ():
        raise ValueError("offset_volt lists no number")
    if not all(abs(volt) <= MAX_OFFSET_VOLT for volt in as_tuple(offset or 0.0)):
        raise ValueError(f"offset_volt must lie within {MAX_OFFSET_VOLT:g} V of zero")
    follows = entry(readout, "idle_volt") == FOLLOWS
    if follows and len(entry(readout, "groups") or ()) > 1:
        raise ValueError(
            "idle_volt: follows needs one sensed line at a time, not groups in parallel"
        )
    if follows and entry(readout, "driven_groups") is not None:
        raise ValueError("idle_volt: follows has no place with driven_groups")
    ends = nominal_terminations(readout)
    keeps_load = getattr(readout, "idle_load_ohm", 0.0) is None
    for name, connected, lines in (
        ("idle_volt", ends.driving.connected(own=False).size, "idle driven lines"),
        ("load_volt", ends.sensing.connected(own=True).size, "sensed lines"),
        (
            "idle_load_volt",
            ends.sensing.connected(own=False).size and not keeps_load,
            "idle sensed lines keep their load or",
        ),
    ):
        if entry(readout, name) is not None and not connected:
            raise ValueError(f"{name} has no place where {lines} float: name their resistor")
    source = float(np.mean(ends.source))
    if not follows and source == ends.reference:
        raise ValueError(f"all lines end at {source:g} V, as the driven one does: no current flows")


def check_on_panel(readout: Any, scene: Any) -> None:
    """Raise ValueError if a list or an end does not fit the lines of a scene's panel.

    Raises InputError if there is no memory for the ends of all lines at all addresses.
    """
    ends = nominal_terminations(readout)
    driven, sensed = of_side(ends.driven, *scene.panel.shape)
    for keys, count in (
        (readout.of_driven, driven),
        ((*readout.of_sensed, "offset_volt"), sensed),
    ):
        for key in keys:
            if entry(readout, key) is not None:
                per_line(key, getattr(readout, key), count)
    check_groups(entry(readout, "groups"), opposite(ends.driven), sensed)
    check_groups(entry(readout, "driven_groups"), ends.driven, driven, "driven_groups")
    if ends.two_point:
        return  # all lines end as those of the nominal panel
    equation = equation_of(readout, *scene.panel.shape)
    table = equation.terminations
    driving, sensing = np.isfinite(table.driving.ohm), np.isfinite(table.sensing.ohm)
    side = ends.driven.removesuffix("s")
    if not driving.diagonal().all():
        line = int(np.argmin(driving.diagonal()))
        raise ValueError(f"readout.drive_ohm: {side} {line} ends nowhere while it is driven")
    ending = driving.sum(axis=1)[:, None] + sensing.sum(axis=1)
    if ending.min() < 2:
        line, read = divmod(int(np.argmin(ending)), ending.shape[1])
        raise ValueError(
            f"readout.{readout.of_sensed[0]}: while {side} {line} is driven and "
            f"{opposite(ends.driven).removesuffix('s')} {read} is read no other line ends "
            "anywhere: no current flows; name the resistor of the line that is read"
        )
    if ends.diode is not None and equation.potentials is not None:
        raise ValueError("diode: circuits with several potentials have no diode in this model")
    if ends.diode is not None and entry(readout, "driven_groups") is not None:
        raise ValueError("diode: circuits with driven_groups have no diode in this model")
    if ends.at_far_end and equation.potentials is not None:
        raise ValueError(
            "read_at: circuits with several potentials are read at the terminals in this model"
        )
    if scene.wiring is not None and scene.wiring.joined and np.isinf(equation.ties).any():
        raise ValueError(
            "faults: lines that touch cannot be joined to idle ones that 0 ohm hold at ground"
        )


# Words.


def ends_in_words(readout: Any) -> str:
    """Return the groups, potentials and converter of a circuit, with its input resistance."""
    driven = nominal_terminations(readout).driven
    sensed = opposite(driven)
    text = ""
    if entry(readout, "groups") is not None:
        text += f", {len(readout.groups)} {sensed} read in parallel"
    if entry(readout, "driven_groups") is not None:
        text += f", {len(readout.driven_groups)} multiplexers of {driven}"
    idle_volt = entry(readout, "idle_volt")
    if idle_volt is not None:
        volt = "those of the sensed line" if idle_volt == FOLLOWS else f"{idle_volt:g} V"
        text += f", idle {driven} at {volt}"
    if entry(readout, "load_volt") is not None:
        text += f", loads end at {readout.load_volt:g} V"
    if entry(readout, "idle_load_volt") is not None:
        text += f", idle {sensed} at {readout.idle_load_volt:g} V"
    if entry(readout, "offset_volt"):
        text += f", amplifiers off by {lines_text(readout.offset_volt, 'V')}"
    if entry(readout, "input_ohm") is not None:
        text += f", converter input {readout.input_ohm:g} ohm"
    if nominal_terminations(readout).at_far_end:
        text += f", {sensed} read at their far end"
    return f"{text}, {converter_in_words(readout)}"
