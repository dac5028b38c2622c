"""Circuits of other kinds and settings with the converter and the resistor of a scene.

Every preset is one, with either side driven; so are circuits with sensed lines read in parallel,
with idle lines held by switches or resistors, and with potentials that people build. A circuit has
a name by the entries of a scene that state it.
"""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import fields, replace
from functools import cache
from itertools import product
from math import inf
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np

from lampest.files.typed import members_of
from lampest.panel.circuit import nominal_terminations
from lampest.panel.lines import Side, opposite
from lampest.panel.readouts import AnyReadout, Readout
from lampest.panel.readouts.driven_readout import DrivenReadout
from lampest.panel.scene import Scene

# Names of the resistor that a converter reads across.
RESISTORS = ("reference_ohm", "load_ohm", "feedback_ohm")
CALLED = {
    "driven": "rows and columns swapped",
    "polarity": "polarity reversed",
    "measured_across": "read across the other resistor",
}
# Keys that alone make an alternative of the specified kind, and what they mean.
OF_ONE_KEY = {
    "groups": "read in parallel",
    "driven_groups": "multiplexers of driven lines",
    "load_volt": "loads end at half the supply",
    "idle_load_ohm": "idle sensed lines are held",
    "input_ohm": "of the converter",
}
OF_STATES = ("idle_ohm", "idle_volt", "idle_load_ohm")  # that name a driven circuit
RESISTORS_OF_IDLE = ("idle_ohm", "idle_load_ohm")
HELD_OHM = (3e4, 1e4, 3e3, 1e3)  # of pull-down resistors, those of microcontrollers included
SIDES: tuple[Side, ...] = ("rows", "columns")
INPUT_OHM = 1e5  # of a converter behind a divider of its module; those of chips are larger
PARALLEL = (2, 4)  # multiplexers in parallel: 16 lines on two of eight or four of four channels


def circuits_beside(readout: Readout, scene: Scene) -> Iterator[Any]:
    """Generate the readout with lines read in parallel, then all variants of every kind."""
    if getattr(readout, "measured_across", "reference") != "sensor" and hasattr(readout, "groups"):
        # Lines in parallel have no one line that the idle ones could follow.
        sensed = opposite(getattr(readout, "driven", "rows"))
        yield from _with_settings(readout, "groups", _multiplexers(scene, sensed))
    for kind in members_of(AnyReadout):
        yield from _variants(kind, readout)


def with_potentials(specified: Any, scene: Scene) -> Iterator[Any]:
    """Generate circuits with potentials that people build.

    Loads end at half the supply, multiplexers hold driven lines, idle lines follow the sensed one,
    and a converter has an input resistance beside resistors to the supply.
    """
    to_supply = getattr(specified, "polarity", "up") == "down"
    across_sensor = getattr(specified, "measured_across", "reference") == "sensor"
    if getattr(specified, "load_volt", 0.0) is None and not to_supply:
        half = nominal_terminations(specified).source_volt / 2
        yield from _with_settings(specified, "load_volt", [half])
    if getattr(specified, "idle_load_ohm", 0.0) is None:
        yield from _with_settings(specified, "idle_load_ohm", [0.0])
    if getattr(specified, "driven_groups", 0) is None:
        driven: Side = getattr(specified, "driven", "rows")
        yield from _with_settings(specified, "driven_groups", _multiplexers(scene, driven))
    if (to_supply or across_sensor) and getattr(specified, "input_ohm", 0.0) is None:
        yield from _with_settings(specified, "input_ohm", [INPUT_OHM])
    resistor = _resistor_of(specified)
    if resistor is None:
        return
    shared = _shared(specified)
    idle_ohm = shared.get("drive_ohm", 0.0)
    for side in SIDES:
        with suppress(ValueError):
            yield DrivenReadout(
                driven=side,
                idle_ohm=idle_ohm,
                idle_volt="follows",
                load_ohm=resistor,
                idle_load_ohm=inf,
                **shared,
            )


def _with_settings(specified: Any, key: str, settings: Iterable[Any]) -> Iterator[Any]:
    """Generate the specified circuit with other settings of a key, as far as it can have them."""
    for setting in settings:
        with suppress(ValueError):
            yield replace(specified, **{key: setting})


def _multiplexers(scene: Scene, side: Side) -> Iterator[tuple[tuple[int, ...], ...]]:
    """Generate the lines of two and of four multiplexers of a side.

    Each multiplexer has a block of lines, or every second or fourth line.
    """
    lines = range(scene.panel.shape[0 if side == "rows" else 1])
    for count in PARALLEL:
        size = -(-len(lines) // count)
        blocks = tuple(tuple(lines[first : first + size]) for first in lines[::size])
        taken_in_turn = tuple(tuple(lines[first::count]) for first in range(count))
        if len(blocks) == count and size > 1:
            yield from (blocks, taken_in_turn)


def _variants(kind: Any, specified: Readout) -> Iterator[Any]:
    """Generate circuits of a kind, one for every choice of words.

    The converter, the resistor and all other common settings are those of the specified circuit.
    """
    # Its presets are alternatives of their own; what remains has idle lines that are held.
    if kind is DrivenReadout:
        yield from _held_lines(specified)
        return
    words = choices(kind)
    types = get_type_hints(kind)
    names = {setting.name for setting in fields(kind)} - {*words, "groups"}
    shared = {name: getattr(specified, name) for name in names if hasattr(specified, name)}
    if "converter_volt" not in names:
        shared["supply_volt"] = specified.full_scale_volt
    resistor = _resistor_of(specified)
    if resistor is not None:
        for name in names.intersection(RESISTORS):
            # the specified resistor takes the role of the kind's own; a list for lines becomes its
            # mean where one is needed
            shared[name] = float(np.mean(resistor)) if types[name] is float else resistor
    for chosen in product(*words.values()):
        with suppress(ValueError):  # potentials of the specified circuit that the kind cannot have
            yield kind(**shared, **dict(zip(words, chosen, strict=True)))


def _held_lines(specified: Any) -> Iterator[DrivenReadout]:
    """Generate circuits whose idle lines switches hold at ground, or resistors near it.

    Where switches hold the driven lines, idle sensed ones keep their load, are held at ground, or
    float. Resistors are at one side, the first of HELD_OHM (`open_number_of`). They do not exchange
    sides, too.
    """
    resistor = _resistor_of(specified)
    if resistor is None:
        return
    by_switches = product(SIDES, product((0.0,), (None, 0.0, inf)))
    sides = (specified.driven,) if hasattr(specified, "driven") else SIDES
    weak = HELD_OHM[0]
    by_resistors = product(sides, ((weak, None), (weak, inf), (inf, weak)))
    for driven, (idle, idle_load) in (*by_switches, *by_resistors):
        with suppress(ValueError):
            yield DrivenReadout(
                driven=driven,
                idle_ohm=idle,
                load_ohm=resistor,
                idle_load_ohm=idle_load,
                **_shared(specified),
            )


def open_number_of(circuit: Readout) -> str:
    """Return the setting with the resistor of idle lines that holds them near ground, '' if none.

    Its value is to be estimated.
    """
    if not isinstance(circuit, DrivenReadout):
        return ""
    return next((name for name in RESISTORS_OF_IDLE if getattr(circuit, name) in HELD_OHM), "")


def _resistor_of(specified: Any) -> Any:
    """Return the resistor that the converter reads across; None without one."""
    resistors = (getattr(specified, name) for name in RESISTORS if hasattr(specified, name))
    return next(resistors, None)


def _shared(specified: Any) -> dict[str, Any]:
    """Return the converter's settings and the channels of a circuit, as far as it has them."""
    names = (
        "supply_volt",
        "adc_bits",
        "readings",
        "noise_lsb",
        "floor_code",
        "passes_volt",
        "converter",
        "drive_ohm",
        "sense_ohm",
    )
    return {name: getattr(specified, name) for name in names if hasattr(specified, name)}


@cache
def choices(kind: type[Readout]) -> dict[str, tuple[str, ...]]:
    """Return the words that each literal setting of a kind may have.

    The first setting is its name.
    """
    types = get_type_hints(kind)
    names = [setting.name for setting in fields(kind)]
    return {name: get_args(types[name]) for name in names if get_origin(types[name]) is Literal}


def entries_of(circuit: Readout, specified: Readout) -> dict[str, Any]:
    """Return the entries of a readout that state a circuit.

    The single setting that differs from the specified one is enough; otherwise all settings in
    words are stated.
    """
    groups = getattr(circuit, "groups", None)
    specified_groups = getattr(specified, "groups", None)
    same_kind = type(circuit) is type(specified)
    changed = [
        setting.name
        for setting in fields(circuit)
        if same_kind and getattr(circuit, setting.name) != getattr(specified, setting.name)
    ]
    if len(changed) == 1 and changed[0] in OF_ONE_KEY and getattr(circuit, changed[0]) is not None:
        (name,) = changed
        value = getattr(circuit, name)
        return {name: [list(group) for group in value] if "groups" in name else value}
    ungrouped = {"groups": None} if specified_groups is not None and groups is None else {}
    words = {name: getattr(circuit, name) for name in choices(type(circuit))}
    if isinstance(circuit, DrivenReadout):
        states = {name: getattr(circuit, name) for name in OF_STATES}
        words |= {name: value for name, value in states.items() if value is not None}
    differ = [name for name, word in words.items() if getattr(specified, name, None) != word]
    if ungrouped and not differ:
        return ungrouped
    if len(differ) == 1 and differ[0] in CALLED:
        return {differ[0]: words[differ[0]], **ungrouped}
    if same_kind:
        return {**words, **ungrouped}
    # of the resistor only where it is not the kind's default
    resistors = {
        setting.name: getattr(circuit, setting.name)
        for setting in fields(circuit)
        if setting.name in RESISTORS and getattr(circuit, setting.name) != setting.default
    }
    numbers = {name: ohm for name, ohm in resistors.items() if isinstance(ohm, float)}
    return {**words, **numbers, **ungrouped}


def entries_in_words(entries: Mapping[str, Any]) -> str:
    """Return the name of the circuit that entries of a readout state."""
    names = []
    for name, value in entries.items():
        if name == "groups" and value is None:
            names.append("no readout.groups (lines read one after the other)")
        else:
            text = f"{value:g}" if isinstance(value, float) else str(value)
            reason = f" ({OF_ONE_KEY[name]})" if name in OF_ONE_KEY else ""
            names.append(f"readout.{name}: {text}{reason}")
        if "kind" not in entries and name in CALLED:
            names[-1] += f" ({CALLED[name]})"
    return ", ".join(names)
