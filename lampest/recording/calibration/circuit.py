"""What known resistors would read behind electronics whose numbers are unknown: the model that a calibration fits."""

from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter
from typing import Any

import numpy as np

from lampest.panel.memory import with_memory
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.panel.readouts.lines import LineNumber, Side
from lampest.panel.scene import Scene
from lampest.recording.calibration.repeats import SHORT_OHM

# Channels near nothing: R + ln(1 + exp(-R)) is R from some ohm on, never below zero, and always tells which way to go.
CONTACT_OHM = 1.0
MOST_OHM, DROP_VOLT = 1e8, (0.05, 5.0)  # scenes end at 1e9 ohm; from a Schottky diode to a blue LED
TYPICAL_OHM = 70.0  # of a channel of a CD74HC4067 at 5 V: its data sheet
# Numbers to find where the scene names them, and what they are like: 2.9 % of the channel before were seen of a real
# board, and an ohm from cell to cell of conductive thread.
MEMORY = LineNumber("converter_memory", (), in_scene=True, unit="1")
WIRE = tuple(LineNumber(f"lines.{line}_ohm_per_cell", (), in_scene=True) for line in ("row", "column"))
TYPICAL = {MEMORY: 0.03} | dict.fromkeys(WIRE, 1.0)
MOST_MEMORY = 0.9
CHANNEL_SPREAD_OHM = 30.0  # by which channels differ: a third of 160 - 70 ohm, worst less typical, same sheet
RESISTOR_SPREAD = 0.05 / 3**0.5  # by which loads differ: evenly within the 5 % of ordinary resistors
STEP = 1e-5  # of the logarithm of a resistance, for differences: half of the digits


@dataclass(frozen=True)
class LineUnknowns:
    """Where in the unknowns the lines of one side stand that one number has."""

    number: int
    side: Side
    lines: slice


@dataclass(frozen=True, eq=False)
class Circuit:
    """The unknowns: for every number a common value, then for every line by how many spreads it is off.

    A channel's resistance is TYPICAL_OHM·q + CHANNEL_SPREAD_OHM·e, a resistor's R·exp(q)·(1 + RESISTOR_SPREAD·e) with R
    of the scene. e is as likely as a standard normal number, so that lines which nothing measures are taken for the
    mean of the others.
    """

    scene: Scene
    numbers: tuple[LineNumber, ...]

    @classmethod
    def of(cls, scene: Scene) -> "Circuit":
        """All numbers that resistors tell: the readout's, and those of what else the scene names."""
        memory = () if scene.converter_memory is None else (MEMORY,)
        return cls(scene, scene.circuit.line_numbers() + memory + (WIRE if scene.lines is not None else ()))

    @property
    def readout(self) -> Readout:
        """The scene's."""
        return self.scene.circuit

    @cached_property
    def parts(self) -> tuple[LineUnknowns, ...]:
        """The lines of every number, in the order of the unknowns."""
        found, first, lines = [], len(self.numbers), self._lengths
        for index, number in enumerate(self.numbers):
            for side in number.sides:
                found.append(LineUnknowns(index, side, slice(first, first + lines[side])))
                first += lines[side]
        return tuple(found)

    @cached_property
    def size(self) -> int:
        """Number of unknowns."""
        return int(self.parts[-1].lines.stop)

    @cached_property
    def start(self) -> Array:
        """The scene's numbers, channels at least typical ones; all lines alike."""
        found = np.zeros(self.size)
        for index, number in enumerate(self.numbers):
            if number.channel:
                found[index] = max(self.specified(number) / TYPICAL_OHM, len(number.sides))
            elif number in TYPICAL:
                found[index] = max(self.specified(number) / TYPICAL[number], 1.0)
        return found

    @property
    def least(self) -> Array:
        """(unknowns) below which none can be: channels, memories and wires are not negative."""
        found = np.full(self.size, -np.inf)
        found[[index for index, number in enumerate(self.numbers) if number.channel or number in TYPICAL]] = 0.0
        return found

    def specified(self, number: LineNumber) -> float:
        """What the scene says of a number, the mean where it lists one for each line."""
        if number.in_scene:
            value = self.scene.series_ohm if number.channel else attrgetter(number.name)(self.scene)
        else:
            value = attrgetter(number.name)(self.readout)
        return float(np.mean(np.asarray(value)))

    def common(self, unknowns: Array, number: int) -> tuple[float, float]:
        """(c, ∂c/∂q) of a number, in its unit."""
        one, at = self.numbers[number], float(unknowns[number])
        if one.channel:
            return TYPICAL_OHM * at, TYPICAL_OHM
        if one in TYPICAL:
            return TYPICAL[one] * at, TYPICAL[one]
        value = self.specified(one) * float(np.exp(at))
        return value, value

    def spread(self, unknowns: Array, number: int) -> float:
        """By how much lines differ, ohm."""
        one = self.numbers[number]
        return CHANNEL_SPREAD_OHM if one.channel else RESISTOR_SPREAD * self.common(unknowns, number)[0]

    def volt(self, unknowns: Array, cells: Array, reference_off: float = 0.0) -> Array:
        """(rows, columns) at the converter, for cells in ohm and a reference resistor that is off by a fraction."""
        channels: dict[Side, Array] = {side: np.zeros(length) for side, length in self._lengths.items()}
        fields, of_scene = dict[str, Any](), dict[str, float]()
        for index, number in enumerate(self.numbers):
            common, spread = self.common(unknowns, index)[0], self.spread(unknowns, index)
            off = {part.side: spread * unknowns[part.lines] for part in self.parts if part.number == index}
            if number in TYPICAL:
                of_scene[number.name] = min(common, MOST_MEMORY) if number == MEMORY else common
            elif number.in_scene:
                for side, ohm in off.items():
                    channels[side] = common / len(number.sides) + ohm
            else:
                each = common + sum(off.values())
                each = np.clip(CONTACT_OHM * np.logaddexp(0, each / CONTACT_OHM) if off else each, *_limits(number))
                fields[number.name] = tuple(float(value) for value in each) if off else float(each)
        circuit: Any = with_numbers(self.readout, fields)
        # Contacts and faults are the panel's, which is unplugged.
        bare = Scene(self.scene.panel, circuit, lines=self.scene.lines, converter_memory=self.scene.converter_memory)
        scene: Scene = with_numbers(bare, of_scene)
        recorded = circuit.simulated(cells, scene, channels["rows"], channels["columns"])
        volt = np.asarray(circuit.off_by(reference_off).volt_from_recorded(recorded))
        return with_memory(circuit, scene.converter_memory, volt) if scene.converter_memory else volt

    @cached_property
    def _lengths(self) -> dict[Side, int]:
        rows, columns = self.scene.panel.shape
        return {"rows": rows, "columns": columns}


def _limits(number: LineNumber) -> tuple[float, float]:
    """Where a fit to what is no calibration may wander, and no farther."""
    if number.unit == "volt":
        return DROP_VOLT
    return SHORT_OHM, MOST_OHM


def with_numbers(part: Any, numbers: dict[str, Any]) -> Any:
    """A readout, or a part of one, with other numbers by their names; dotted names are those of its parts."""
    for name, value in numbers.items():
        first, _, rest = name.partition(".")
        part = replace(part, **{first: with_numbers(getattr(part, first), {rest: value}) if rest else value})
    return part
