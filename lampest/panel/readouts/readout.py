"""Base of the readouts: a circuit that states how each line ends, and its converter.

A kind of readout is one file with its keys and one function from keys to ends, `terminations`. All
else follows from the ends: `lampest.panel.equation` has the equation of the readings,
`lampest.panel.readouts.starts` the cells at which solves begin,
`lampest.panel.readouts.inequalities` the bounds, and `lampest.panel.readouts.tolerances` the
errors of resistors and channels.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from lampest.files.typed import check_ranges
from lampest.panel.circuit import NOMINAL_LINES, Terminations, nominal_terminations
from lampest.panel.equation import equation_of
from lampest.panel.law import TWO_POINT, Law
from lampest.panel.lines import Side, along, listed_lines, of_side, opposite, per_line
from lampest.panel.network import Network, SolvedNetwork
from lampest.panel.panel import Array, Panel, connected_parts
from lampest.panel.readouts import starts
from lampest.panel.readouts.converter import MAX_VOLT, MIN_VOLT, Converter
from lampest.panel.readouts.floating import grounding, two_point_resistance
from lampest.panel.readouts.keys import check_keys, check_on_panel, entry
from lampest.panel.readouts.scan_order import check_scan_order
from lampest.panel.readouts.starts import USUAL_OHM
from lampest.panel.readouts.wiring import Wiring


class Surroundings(Protocol):
    """Interface of a scene for a readout."""

    @property
    def panel(self) -> Panel:
        """Panel that is read."""

    @property
    def series_ohm(self) -> Array:
        """Resistance in series with every reading, ohm, to be broadcast to (rows, columns)."""

    @property
    def series_lines(self) -> tuple[Array, Array]:
        """Resistance in series with each row, (rows,), and with each column, (columns,), ohm."""

    @property
    def wiring(self) -> Wiring | None:
        """Wire, contacts and touching lines; None without any."""


@dataclass(frozen=True, kw_only=True)
class Readout(Converter, ABC):
    """Base of readouts: the circuit of a kind, with the fields of its converter from `Converter`.

    At the converter, recorded readings are voltages between 0 and the supply; `rails` are the
    limits of valid readings.

    Attributes
    ----------
    unit : {'ohm', 'volt'}
        Unit of a reading.
    signal, signal_name : str
        Dataset in files, and its long name.
    of_driven, of_sensed : tuple of str
        Keys of numbers of driven, and of sensed lines; the first one of sensed lines is the
        reference resistor of a reading.
    may_be_zero, may_be_infinite : tuple of str
        Keys of resistances that may be 0, or infinite.
    channels : tuple of str
        Keys, a number or one for each line, of the channels of driven, and of sensed lines; ''
        without any. Sensed lines without a channel have 0.

    >>> issubclass(lampest.GroundedReadout, lampest.Readout)
    True
    """

    unit: ClassVar[str] = "volt"
    signal: ClassVar[str] = "volt"
    signal_name: ClassVar[str] = "voltage at the converter"
    of_driven: ClassVar[tuple[str, ...]] = ("drive_ohm",)
    of_sensed: ClassVar[tuple[str, ...]] = ("load_ohm",)
    may_be_zero: ClassVar[tuple[str, ...]] = ("drive_ohm", "sense_ohm")
    may_be_infinite: ClassVar[tuple[str, ...]] = ()
    channels: ClassVar[tuple[str, str]] = ("", "")

    def __post_init__(self) -> None:
        own_volts = [name for name in ("drive_volt", "converter_volt") if hasattr(self, name)]
        check_ranges(self, MIN_VOLT, MAX_VOLT, *own_volts)
        super().__post_init__()
        check_keys(self)

    @abstractmethod
    def terminations(self, driven: int, sensed: int) -> Terminations:
        """Return the ends of the lines of a panel with so many driven and sensed lines."""

    @property
    def series_name(self) -> str:
        """Scene's key of a resistance in series with the panel; '' without one."""
        return "series_resistance_ohm" if self.unit == "ohm" else self.channels[0]

    @property
    def nominal_lines(self) -> tuple[int, int]:
        """Numbers of driven and of sensed lines that lists and groups tell, otherwise two."""
        sides = (
            (self.of_driven, entry(self, "driven_groups")),
            ((*self.of_sensed, "offset_volt"), entry(self, "groups")),
        )
        driven, sensed = (
            max(
                [
                    *(
                        len(value)
                        for key in keys
                        if isinstance(value := vars(self).get(key), tuple)
                    ),
                    *([] if groups is None else [max(listed_lines(groups)) + 1]),
                ],
                default=NOMINAL_LINES,
            )
            for keys, groups in sides
        )
        return driven, sensed

    def check(self, scene: Surroundings) -> None:
        """Raise ValueError if the scene does not fit the readout, or lists do not fit its panel.

        A scene does not fit the readout if it has keys that the readout cannot model.
        """
        per_line("noise_lsb", self.assumed_noise, of_side(self.noisy_side, *scene.panel.shape)[0])
        check_scan_order(self, scene.panel)
        if np.any(scene.series_ohm) and self.unit != "ohm":
            raise ValueError(
                "series_resistance_ohm belongs to readout.kind: two_point; "
                "with others a channel's resistance is part of the readout's drive_ohm or sense_ohm"
            )
        check_on_panel(self, scene)

    def in_scene(self, scene: Surroundings) -> "Readout":
        """Return the circuit that gives the readings of a scene."""
        return self

    @abstractmethod
    def description(self) -> str:
        """Return the circuit and its numbers with their units, in words."""

    @cached_property
    def two_point(self) -> bool:
        """Whether a reading is the resistance between two lines while all others float.

        Then a common factor on all cells multiplies all readings, and plain least squares without
        noise has one minimum.
        """
        return nominal_terminations(self).two_point

    @property
    def law(self) -> Law:
        """Law of the readings, h with its derivatives."""
        return TWO_POINT if self.two_point else Law(self)

    # Readings of cells.

    def ties(self, measured: Array, parts: NDArray[np.intp] | None = None) -> Array:
        """Return the ties to ground of the bases, (lines,) siemens, or (addresses, lines).

        Lines that 0 ohm hold have infinite ties. `parts`, (lines,), is the number of each line's
        part of a panel that open cells divide; None for a connected panel.
        """
        if self.two_point:
            return grounding(measured, parts)
        equation = equation_of(self, *measured.shape[-2:])
        ties = equation.ties_of_parts(parts, lambda: self.apparent_resistance(measured))
        return ties[0] if len(ties) == 1 else ties

    def network(self, cell_resistance: Array, ties: Array, wiring: Wiring | None = None) -> Network:
        """Return the solved network of cells (rows, columns) ohm, with `wiring` before them.

        The ties are those of `ties`. Raises numpy.linalg.LinAlgError if a line is not connected.
        """
        if self.two_point:
            return self.solved_network(cell_resistance, ties, wiring)
        equation = equation_of(self, *cell_resistance.shape)
        excited = equation.excitations(np.atleast_2d(ties))
        if ties.ndim == 1:
            sources = None if excited is None else excited[0]
            return self.solved_network(cell_resistance, ties, wiring, sources)
        from lampest.panel.joined_network import JoinedNetwork  # for several bases

        if (wiring is None or wiring.at_terminals) and not np.isinf(ties).any():
            cells = np.broadcast_to(cell_resistance, equation.read_at.shape)
            networks: list[Network] = [self.solved_network(cells, ties, wiring, excited)]
        else:
            networks = [
                self.solved_network(
                    cell_resistance, tie, wiring, None if excited is None else excited[number]
                )
                for number, tie in enumerate(ties)
            ]
        return JoinedNetwork.addressed(cell_resistance, networks, equation.read_at > 0)

    def exact_reading(self, cell_resistance: Array, wiring: Wiring | None = None) -> Array:
        """Return the readings y of cells of any contrast.

        The cells are (rows, columns) or (frames, rows, columns) ohm; the readings have the same
        shape. Open cells may divide the panel into parts. Resistances between two lines have at
        least ten correct digits without wiring.
        """
        if wiring is None and self.two_point:
            return two_point_resistance(cell_resistance)
        if cell_resistance.ndim == 3:
            return np.stack([self.exact_reading(frame, wiring) for frame in cell_resistance])
        conducting = np.isfinite(cell_resistance)
        if wiring is not None:
            conducting = wiring.connecting(conducting)
        equation = equation_of(self, *cell_resistance.shape)
        parts = connected_parts(conducting)
        ties = np.squeeze(equation.ties_of_parts(parts, lambda: np.array(USUAL_OHM)))
        with np.errstate(divide="ignore"):
            return self.network(cell_resistance, ties, wiring).reading()

    def reading(self, row: Any, column: Any, mutual: Any, *potentials: Any) -> Any:
        """Return the readings; see `lampest.panel.equation.Equation.reading`."""
        return equation_of(self, *mutual.shape[-2:]).reading(row, column, mutual, *potentials)

    def solved_network(
        self,
        cell_resistance: Array,
        ties: Array,
        wiring: Wiring | None = None,
        sources: Array | None = None,
    ) -> SolvedNetwork:
        """Return the network of one state of the lines, or of many as its leading axis.

        Infinite ties hold lines at ground, and `sources` are the excitations of the lines by the
        potentials in which they end, (…, lines); see `network`. Many states have neither wire nor
        held lines.
        """
        leaks = None if wiring is None else wiring.leak_admittance(cell_resistance.shape[-2:])
        at_terminals = wiring is None or wiring.at_terminals
        if at_terminals and not np.isinf(ties).any():
            return SolvedNetwork.tied(cell_resistance, ties, self.law, sources, leaks)
        from lampest.panel.difference_network import DifferenceNetwork  # for wire and held lines

        if wiring is None or at_terminals:
            return DifferenceNetwork.held(cell_resistance, ties, self.law, sources, leaks)
        return DifferenceNetwork.wired(cell_resistance, ties, self.law, wiring, sources)

    # Cells at which solves begin, and their bounds.

    def apparent_resistance(self, measured: Array) -> Array:
        """Return the cells that would give each reading if they were alone on the panel.

        Shape (…, rows, columns), in ohm.
        """
        return starts.apparent_resistance(self, measured)

    def uniform_start(self, measured: Array) -> Array:
        """Return cells (…, rows, columns) ohm as if all were equal."""
        return starts.uniform_start(self, measured)

    def start(self, measured: Array, upper: Array, near: Array | None = None) -> Array:
        """Return cells to start a solve from, (rows, columns) ohm.

        Parameters
        ----------
        measured : array, shape (rows, columns)
            Readings.
        upper : array, shape (rows, columns)
            Upper bounds, ohm.
        near : array, shape (rows, columns), or None
            Earlier estimate, ohm.
        """
        return starts.start(self, measured, upper, near)

    # Between recorded values and the network's readings.

    @property
    def full_scale_volt(self) -> float:
        own = entry(self, "converter_volt")
        return self.supply_volt if own is None else float(own)

    @property
    def noisy_side(self) -> Side:
        side: Side = getattr(self, "driven", "rows")
        return side

    def _level(self, shape: tuple[int, ...]) -> Array | float:
        """Return the recorded value of a reading of 0, to be broadcast to (rows, columns), volt.

        Amplifiers add their offsets; an inverting one is recorded below its reference.
        """
        ends = nominal_terminations(self)
        offset = entry(self, "offset_volt")
        if offset is None:
            return ends.recorded_reference
        sensed = of_side(ends.driven, *shape[-2:])[1]
        of_lines = along(opposite(ends.driven), per_line("offset_volt", offset, sensed))
        return ends.recorded_reference + (-of_lines if ends.amplified else of_lines)

    def from_recorded(self, recorded: Array, scene: Surroundings) -> Array:
        """Return the network's readings of recorded values, (…, rows, columns)."""
        ends = nominal_terminations(self)
        level = self._level(recorded.shape)
        if ends.sign > 0 and not np.any(level):
            return recorded
        return np.asarray(ends.sign * (recorded - level))

    def to_recorded(self, reading: Array, scene: Surroundings) -> Array:
        """Return the recorded values of the network's readings, (…, rows, columns)."""
        ends = nominal_terminations(self)
        level = self._level(reading.shape)
        if ends.sign > 0 and not np.any(level):
            return reading
        return np.asarray(level + ends.sign * reading)

    def rails_reached(self, recorded: Array) -> str:
        """Return the rails that recorded readings exceed, in words; '' if no reading does."""
        least, largest = self.rails()
        beyond = ((least, recorded < least), (largest, recorded > largest))
        reached = [f"{rail:.3g}" for rail, readings in beyond if np.any(readings)]
        if not reached:
            return ""
        rails = "rails" if len(reached) > 1 else "rail"
        return f"the converter's {rails} of {' and '.join(reached)} {self.unit}"

    def sigma_of_reading(self, recorded: Array, sigma: Array) -> Array:
        """Return the σ of the network's readings y, σ·|∂y/∂(recorded)|.

        `sigma` is the σ of the recorded values; all have the same shape.
        """
        return sigma
