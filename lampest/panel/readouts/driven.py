"""Circuits that drive the lines of one side, one after the other, and sense the other side.

`DrivenCircuit` has the keys that such circuits share, and the ends that follow from them.
"""

from dataclasses import replace
from math import inf
from typing import Any, ClassVar, Literal, Self

import numpy as np

from lampest.files.typed import check_ranges
from lampest.panel.circuit import FOLLOWS, Ends, Terminations, nominal_terminations
from lampest.panel.diode import Diode
from lampest.panel.equation import equation_of
from lampest.panel.lines import (
    Groups,
    LineNumber,
    PerLine,
    Side,
    along,
    as_tuple,
    check_apart,
    check_groups,
    check_resistors,
    lines_text,
    of_side,
    opposite,
    per_line,
    with_channels,
)
from lampest.panel.panel import Array
from lampest.panel.readouts.converter import MAX_VOLT, MIN_VOLT
from lampest.panel.readouts.readout import Readout, Surroundings

MAX_OFFSET_VOLT = 0.1  # amplifiers without trimming: 15 mV (data sheet of the LM324)


class DrivenCircuit(Readout):
    """Base of circuits with driven and sensed lines.

    Kinds are dataclasses that declare their keys in the files' order.

    Attributes
    ----------
    driven : {'rows', 'columns'}
        Side that is driven.
    drive_ohm : PerLine
        Rd in ohm, between the source and the driven line.
    sense_ohm : PerLine
        Resistance of the channels of the sensed lines in ohm.
    polarity : {'up', 'down'}
        Whether loads lead to ground or to the supply.
    diode : Diode, or None
        Diode in series with Rd.
    input_ohm : float, or None
        Input resistance of the converter in ohm.
    groups, driven_groups : tuple of tuple of int, or None
        Sensed lines, and driven lines, behind one multiplexer each.
    idle_volt : float or {'follows'}, or None
        Potential in which idle driven lines end, in volt; 'follows': that of the sensed line, as
        with voltage feedback. None: ground, or the supply with polarity: down.
    load_volt, idle_load_volt : float, or None
        Potential in which the load of a sensed line ends, and an idle sensed line, in volt. None:
        ground, or the supply with polarity: down, and load_volt.
    offset_volt : PerLine, or None
        Offset of each sensed line's amplifier in volt, which is recorded in addition.
    may_be_zero, may_be_infinite : tuple of str
        Keys of resistances that may be 0, or infinite.
    """

    of_driven: ClassVar[tuple[str, ...]] = ("drive_ohm",)
    of_sensed: ClassVar[tuple[str, ...]] = ("load_ohm",)
    may_be_zero: ClassVar[tuple[str, ...]] = ("drive_ohm", "sense_ohm")
    may_be_infinite: ClassVar[tuple[str, ...]] = ()
    series_name: ClassVar[str] = "drive_ohm"
    driven: Side
    drive_ohm: PerLine
    sense_ohm: PerLine = 0.0
    polarity: Literal["up", "down"] = "up"
    diode: Diode | None = None
    input_ohm: float | None = None
    groups: Groups | None = None
    driven_groups: Groups | None = None
    idle_volt: float | Literal["follows"] | None = None
    load_volt: float | None = None
    idle_load_volt: float | None = None
    offset_volt: PerLine | None = None

    # Ends of the lines, which every kind states.

    def driven_ends(self, count: int) -> Ends:
        """Return the ends of driven lines while they are driven: the source behind drive_ohm."""
        own = getattr(self, "drive_volt", None)
        source = self.supply_volt if own is None else own
        drive = per_line("drive_ohm", self.drive_ohm, count)
        return Ends.of(drive, 0.0 if self.polarity == "down" else source)

    def idle_ends(self, ohm: Array) -> Ends:
        """Return the ends of idle driven lines behind resistances (lines,) ohm, at idle_volt."""
        return Ends.of(ohm, self._ground if self.idle_volt is None else self.idle_volt)

    def load_ends(self, count: int) -> Ends:
        """Return the ends of sensed lines while they are read.

        A load at load_volt and the converter's input to ground are beside each other.
        """
        volt = self._ground if self.load_volt is None else self.load_volt
        load = Ends.of(per_line("load_ohm", getattr(self, self.of_sensed[0]), count), volt)
        if self.input_ohm is None:
            return load
        return load.beside(Ends.of(np.full(count, self.input_ohm)))

    def idle_load_ends(self, count: int) -> Ends:
        """Return the ends of idle sensed lines that have one of their own, else floating ones."""
        ohm = getattr(self, "idle_load_ohm", None)
        end = self._ground if self.load_volt is None else self.load_volt
        volt = end if self.idle_load_volt is None else self.idle_load_volt
        return Ends.of(per_line("idle_load_ohm", inf if ohm is None else ohm, count), volt)

    @property
    def _ground(self) -> float:
        """Potential of the ends without one of their own: ground, or the supply, in volt."""
        return self.supply_volt if self.polarity == "down" else 0.0

    @property
    def full_scale_volt(self) -> float:
        own = getattr(self, "converter_volt", None)
        return self.supply_volt if own is None else float(own)

    # Keys.

    def __post_init__(self) -> None:
        own_volts = [name for name in ("drive_volt", "converter_volt") if hasattr(self, name)]
        check_ranges(self, MIN_VOLT, MAX_VOLT, *own_volts)
        super().__post_init__()
        for name in (*self.of_driven, *self.of_sensed):
            value = getattr(self, name)
            limited = tuple(
                ohm for ohm in as_tuple(value) if not (ohm == inf and name in self.may_be_infinite)
            )
            if value is not None and (limited or not as_tuple(value)):
                check_resistors(name, limited, open_end=name not in self.may_be_zero)
        if self.input_ohm is not None:
            check_resistors("input_ohm", self.input_ohm, most=inf)
        if self.groups is not None:
            check_apart(self.groups)
        if self.driven_groups is not None:
            check_apart(self.driven_groups, "driven_groups")
        self._check_potentials()

    def _check_potentials(self) -> None:
        """Raise ValueError if potentials contradict the circuit."""
        for name in ("idle_volt", "load_volt", "idle_load_volt"):
            volt = getattr(self, name)
            if isinstance(volt, float | int) and not abs(volt) <= MAX_VOLT:
                raise ValueError(f"{name} must lie within {MAX_VOLT:g} V of ground")
        if self.offset_volt == ():
            raise ValueError("offset_volt lists no number")
        if not all(abs(volt) <= MAX_OFFSET_VOLT for volt in as_tuple(self.offset_volt or 0.0)):
            raise ValueError(f"offset_volt must lie within {MAX_OFFSET_VOLT:g} V of zero")
        if self.idle_volt == FOLLOWS:
            if self.groups is not None and len(self.groups) > 1:
                raise ValueError(
                    "idle_volt: follows needs one sensed line at a time, not groups in parallel"
                )
            if self.driven_groups is not None:
                raise ValueError("idle_volt: follows has no place with driven_groups")
        ends = nominal_terminations(self)
        keeps_load = getattr(self, "idle_load_ohm", 0.0) is None
        for name, connected, lines in (
            ("idle_volt", ends.driving.connected(own=False).size, "idle driven lines"),
            ("load_volt", ends.sensing.connected(own=True).size, "sensed lines"),
            (
                "idle_load_volt",
                ends.sensing.connected(own=False).size and not keeps_load,
                "idle sensed lines keep their load or",
            ),
        ):
            if getattr(self, name) is not None and not connected:
                raise ValueError(f"{name} has no place where {lines} float: name their resistor")
        source = float(np.mean(ends.source))
        if self.idle_volt != FOLLOWS and source == ends.reference:
            raise ValueError(
                f"all lines end at {source:g} V, as the driven one does: no current flows"
            )

    def check(self, scene: Surroundings) -> None:
        """Raise ValueError as `Readout.check`, or if a list does not fit the panel's lines.

        Resistances and groups may be lists.
        """
        super().check(scene)
        driven, sensed = of_side(self.driven, *scene.panel.shape)
        for name in (*self.of_driven, *self.of_sensed):
            value = getattr(self, name)
            if value is not None:
                per_line(name, value, driven if name in self.of_driven else sensed)
        per_line("offset_volt", self.offset_volt or 0.0, sensed)
        check_groups(self.groups, opposite(self.driven), sensed)
        check_groups(self.driven_groups, self.driven, driven, "driven_groups")
        self._check_ends(self.terminations(driven, sensed))
        equation = equation_of(self, *scene.panel.shape)
        if self.diode is not None and equation.potentials is not None:
            raise ValueError("diode: circuits with several potentials have no diode in this model")
        if self.diode is not None and self.driven_groups is not None:
            raise ValueError("diode: circuits with driven_groups have no diode in this model")
        if scene.wiring is not None and scene.wiring.joined and np.isinf(equation.ties).any():
            raise ValueError(
                "faults: lines that touch cannot be joined to idle ones that 0 ohm hold at ground"
            )

    def _check_ends(self, ends: Terminations) -> None:
        """Raise ValueError if no current flows at an address: one line at most ends somewhere."""
        driving, sensing = np.isfinite(ends.driving.ohm), np.isfinite(ends.sensing.ohm)
        side = self.driven.removesuffix("s")
        if not driving.diagonal().all():
            line = int(np.argmin(driving.diagonal()))
            raise ValueError(f"readout.drive_ohm: {side} {line} ends nowhere while it is driven")
        ending = driving.sum(axis=1)[:, None] + sensing.sum(axis=1)
        if ending.min() < 2:
            line, read = divmod(int(np.argmin(ending)), ending.shape[1])
            raise ValueError(
                f"readout.{self.of_sensed[0]}: while {side} {line} is driven and "
                f"{opposite(self.driven).removesuffix('s')} {read} is read no other line ends "
                "anywhere: no current flows; name the resistor of the line that is read"
            )

    @property
    def _end_text(self) -> str:
        """Description of the groups and of the converter, with its input resistance."""
        text = ""
        if self.groups is not None:
            text += f", {len(self.groups)} {opposite(self.driven)} read in parallel"
        if self.driven_groups is not None:
            text += f", {len(self.driven_groups)} multiplexers of {self.driven}"
        if self.idle_volt is not None:
            volt = "those of the sensed line"
            if self.idle_volt != FOLLOWS:
                volt = f"{self.idle_volt:g} V"
            text += f", idle {self.driven} at {volt}"
        if self.load_volt is not None:
            text += f", loads end at {self.load_volt:g} V"
        if self.idle_load_volt is not None:
            text += f", idle {opposite(self.driven)} at {self.idle_load_volt:g} V"
        if self.offset_volt:
            text += f", amplifiers off by {lines_text(self.offset_volt, 'V')}"
        if self.input_ohm is not None:
            text += f", converter input {self.input_ohm:g} ohm"
        return f"{text}, {self.converter_description()}"

    # Between recorded values and readings.

    @property
    def noisy_side(self) -> Side:
        return self.driven

    def offset(self, shape: tuple[int, ...]) -> Array | float:
        if self.offset_volt is None:
            return 0.0
        sensed = of_side(self.driven, *shape[-2:])[1]
        offset = along(opposite(self.driven), per_line("offset_volt", self.offset_volt, sensed))
        # An inverting amplifier is recorded below its reference
        return -offset if nominal_terminations(self).amplified else offset

    # Changes of the circuit.

    def simulated(
        self, cell_resistance: Array, scene: Surroundings, row_ohm: Array, column_ohm: Array
    ) -> Array:
        """Return recorded values with the channels added to the resistances.

        Channels add to drive_ohm, and to sense_ohm unless it is zero.
        """
        actual = self.with_channels(row_ohm, column_ohm)
        return actual.to_recorded(actual.exact_reading(cell_resistance, scene.wiring), scene)

    def channel_errors(self, cells: Array, scene: Surroundings, channel: float) -> Array:
        """Return the effect of each line's channel on the readings, rows first.

        Where idle driven lines are not connected through their channels, the channel of a driven
        line changes the readings of this line alone, so that one network shows all of them.
        """
        rows = len(cells)
        lines = np.eye(sum(cells.shape))
        driven, sensed = of_side(self.driven, *np.split(np.arange(len(lines)), [rows]))
        errors = np.zeros((len(lines), *cells.shape))
        unchanged = self.exact_reading(cells, scene.wiring)

        def with_additions(chosen: Array) -> "DrivenCircuit":
            return self.with_channels(*np.split(channel * chosen, [rows]))

        def error(chosen: Array) -> Array:
            return with_additions(chosen).exact_reading(cells, scene.wiring) - unchanged

        every = lines[driven].sum(axis=0)
        if np.array_equal(self.ties(cells), with_additions(every).ties(cells)):
            together = error(every)
            for line, own in zip(driven, np.eye(len(driven)), strict=True):
                errors[line] = together * along(self.driven, own)
        else:
            errors[driven] = [error(one) for one in lines[driven]]
        if self.sense_ohm:
            errors[sensed] = [error(one) for one in lines[sensed]]
        return errors

    def with_channels(self, row_ohm: Array, column_ohm: Array) -> Self:
        """Return the circuit with additional channel resistances, (rows,) and (columns,) ohm."""
        driven, sensed = of_side(self.driven, row_ohm, column_ohm)
        changes: dict[str, Any] = {"drive_ohm": with_channels("drive_ohm", self.drive_ohm, driven)}
        if self.sense_ohm:
            changes["sense_ohm"] = with_channels("sense_ohm", self.sense_ohm, sensed)
        return replace(self, **changes)

    def line_numbers(self) -> tuple[LineNumber, ...]:
        """Return the numbers to calibrate.

        Calibration estimates drive resistances, which include channels, reference resistors, and a
        diode's drop.
        """
        drive = LineNumber("drive_ohm", (self.driven,), channel=True)
        reference = getattr(self, self.of_sensed[0])
        resistors = (
            (LineNumber(self.of_sensed[0], (opposite(self.driven),)),)
            if max(as_tuple(reference)) < inf
            else ()
        )
        diode = () if self.diode is None else (LineNumber("diode.drop_volt", (), unit="volt"),)
        return drive, *resistors, *diode
