"""Circuits that may have made a recording instead of the one that its scene tells.

Every kind of readout with the told converter and resistor, either side driven, and every kind with another resistance
in series. The converter's volts are what they have in common: a divider's equation is undone where the scene names it.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from itertools import product
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np

from lampest.files.errors import InputError
from lampest.files.tagged import members_of
from lampest.panel.panel import Array
from lampest.panel.readouts import AnyReadout, Readout
from lampest.panel.scene import Scene

RESISTORS = ("reference_ohm", "load_ohm", "feedback_ohm")  # what kinds call the resistor that a converter reads across
CHANNELS = ("drive_ohm", "sense_ohm", "input_ohm")
CONVERTER = tuple(field.name for field in fields(Readout))


@dataclass(frozen=True, eq=False)
class Rival:
    """scene : with another circuit. recorded : what that would have recorded of the same codes. kind : in words.

    sigma : of these, where the recording has its own; None: the readout's. own : whether it is the told circuit.
    in_series : the resistance that is tried in series, ohm; None: what the scene says.
    """

    scene: Scene
    recorded: Array
    sigma: Array | None
    kind: str
    own: bool = False
    in_series: float | None = None

    @property
    def name(self) -> str:
        """The circuit, as a scene would name it."""
        if self.in_series is None:
            return self.kind
        known = f"{self.scene.circuit.series_name} near {float(f'{self.in_series:.2g}'):g}"
        return known if self.own else f"{self.kind}, {known}"

    def with_series(self, ohm: float) -> "Rival":
        """The same with a resistance in series."""
        return replace(self, scene=self.scene.circuit.with_series(self.scene, float(ohm)), in_series=float(ohm))


def rivals_of(scene: Scene, recorded: Array, sigma: Array | None) -> Iterator[Rival]:
    """The told circuit itself, for other resistances in series, then those of every kind that can be had.

    recorded : (frames, rows, columns) as the scene's readout gives it.
    """
    yield Rival(scene, recorded, sigma, "", own=True)
    told = scene.readout
    if told is None:
        return
    volt = told.volt_from_recorded(recorded)
    apparent = _logarithm(told, scene, recorded)
    for kind in members_of(AnyReadout):
        for circuit in variants(kind, told):
            values = circuit.recorded_from_volt(volt)
            if circuit == told or not _alike(apparent, _logarithm(circuit, scene, values)):
                continue
            try:
                other = with_circuit(scene, circuit)
            except ValueError:  # of what the scene tells besides, the kind has no model
                continue
            yield Rival(other, values, sigma if circuit.unit == told.unit else None, circuit_name(circuit, told))


def variants(kind: type[Any], told: Readout) -> Iterator[Readout]:
    """A kind with the told readout's converter, resistor and all else that both have, in every choice of words."""
    names, hints = {field.name for field in fields(kind)}, get_type_hints(kind)
    resistor = next((getattr(told, name) for name in RESISTORS if hasattr(told, name)), None)
    shared = {name: getattr(told, name) for name in CONVERTER}
    shared |= {name: getattr(told, name) for name in CHANNELS if name in names and hasattr(told, name)}
    for name in RESISTORS:
        if name in names and resistor is not None:
            shared[name] = float(np.mean(resistor)) if hints[name] is float else resistor
    words = {name: get_args(hints[name]) for name in names - {"kind"} if get_origin(hints[name]) is Literal}
    for chosen in product(*words.values()):
        yield kind(**shared, **dict(zip(words, chosen, strict=True)))


def with_circuit(scene: Scene, circuit: Any) -> Scene:
    """The scene with another readout, and nothing that belongs to the one before."""
    return replace(scene, readout=circuit, series_resistance_ohm=0.0, systematic=None)


def circuit_name(circuit: Readout, told: Readout) -> str:
    """'rows and columns swapped' where nothing but the driven side differs, else the kind with its words."""
    words = {name: getattr(circuit, name) for name in ("kind", "driven", "sense") if hasattr(circuit, name)}
    if all(getattr(told, name, None) == word for name, word in words.items() if name != "driven"):
        return f"readout.driven: {words['driven']} (rows and columns swapped)" if "driven" in words else words["kind"]
    return ", ".join(f"readout.{name}: {word}" for name, word in words.items())


def _logarithm(circuit: Readout, scene: Scene, recorded: Array) -> Array | None:
    """log of the apparent resistances; None where the circuit does not fit the panel or its readings are none."""
    try:
        with np.errstate(all="ignore"):
            circuit.check(replace(scene, readout=None, series_resistance_ohm=0.0, systematic=None))
            return np.asarray(np.log(circuit.apparent_resistance(circuit.from_recorded(recorded, scene))))
    except (InputError, ValueError):
        return None


def _alike(first: Array | None, second: Array | None) -> bool:
    """Whether pressing a cell moves both in the same direction: a circuit read the other way round is none at all."""
    if first is None or second is None:
        return False
    known = np.isfinite(first) & np.isfinite(second)
    if not known.any():
        return False
    one, other = (values[known] - values[known].mean() for values in (first, second))
    return bool(np.sum(one * other) > 0)
