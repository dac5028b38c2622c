"""Base of the readouts: a circuit that states how each line ends, and its converter.

A kind of readout is one file with its keys and one function from keys to ends, `terminations`. All
else follows from the ends: `lampest.panel.equation` has the equation of the readings,
`lampest.panel.readouts.starts` the cells at which solves begin, and
`lampest.panel.readouts.inequalities` the bounds.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from lampest.panel.circuit import NOMINAL_LINES, Terminations, nominal_terminations
from lampest.panel.equation import equation_of
from lampest.panel.law import Law
from lampest.panel.lines import (
    LineNumber,
    PerLine,
    as_tuple,
    listed_lines,
    of_side,
    per_line,
)
from lampest.panel.network import Network, SolvedNetwork
from lampest.panel.panel import Array, Panel, connected_parts
from lampest.panel.readouts import inequalities, starts
from lampest.panel.readouts.converter import Converter
from lampest.panel.readouts.inequalities import FreeTest
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
    homogeneous : bool
        Whether a common factor on all cells multiplies all readings.
    unique : bool
        Whether plain least squares without noise has one minimum; otherwise solvers begin at
        several starts.
    in_series : bool
        Whether the scene's series resistance adds to every reading.
    series_name : str
        Scene's key of a resistance in series with the panel; '' without one.
    of_driven, of_sensed : tuple of str
        Keys of numbers of driven, and of sensed lines; the first one of sensed lines is the
        reference resistor of a reading.

    >>> issubclass(lampest.GroundedReadout, lampest.Readout)
    True
    """

    unit: ClassVar[str] = "volt"
    signal: ClassVar[str] = "volt"
    signal_name: ClassVar[str] = "voltage at the converter"
    homogeneous: ClassVar[bool] = False
    unique: ClassVar[bool] = False
    in_series: ClassVar[bool] = False
    series_name: ClassVar[str] = ""
    of_driven: ClassVar[tuple[str, ...]] = ()
    of_sensed: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def terminations(self, driven: int, sensed: int) -> Terminations:
        """Return the ends of the lines of a panel with so many driven and sensed lines."""

    @property
    def nominal_lines(self) -> tuple[int, int]:
        """Numbers of driven and of sensed lines that lists and groups tell, otherwise two."""
        sides = (
            (self.of_driven, getattr(self, "driven_groups", None)),
            ((*self.of_sensed, "offset_volt"), getattr(self, "groups", None)),
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
        """Raise ValueError if the scene does not fit the readout or the panel.

        A scene does not fit the readout if it has keys that the readout cannot model.
        """
        per_line("noise_lsb", self.assumed_noise, of_side(self.noisy_side, *scene.panel.shape)[0])
        check_scan_order(self, scene.panel)
        if np.any(scene.series_ohm) and not self.in_series:
            raise ValueError(
                "series_resistance_ohm belongs to readout.kind: two_point; "
                "with others a channel's resistance is part of the readout's drive_ohm or sense_ohm"
            )

    def in_scene(self, scene: Surroundings) -> "Readout":
        """Return the circuit that gives the readings of a scene."""
        return self

    @abstractmethod
    def description(self) -> str:
        """Return the circuit and its numbers with their units, in words."""

    @property
    def law(self) -> Law:
        """Law of the readings, h with its derivatives."""
        return Law(self)

    # Readings of cells.

    def ties(self, measured: Array, parts: NDArray[np.intp] | None = None) -> Array:
        """Return the ties to ground of the bases, (lines,) siemens, or (addresses, lines).

        Lines that 0 ohm hold have infinite ties. `parts`, (lines,), is the number of each line's
        part of a panel that open cells divide; None for a connected panel.
        """
        equation = equation_of(self, *measured.shape[-2:])
        ties = equation.ties_of_parts(parts, lambda: self.apparent_resistance(measured))
        return ties[0] if len(ties) == 1 else ties

    def network(self, cell_resistance: Array, ties: Array, wiring: Wiring | None = None) -> Network:
        """Return the solved network of cells (rows, columns) ohm, with `wiring` before them.

        The ties are those of `ties`. Raises numpy.linalg.LinAlgError if a line is not connected.
        """
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
        shape. Open cells may divide the panel into parts.
        """
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

    def free_tests(self, measured: Array, sigma: Array) -> tuple[FreeTest, ...]:
        """Return tests of inequalities that the circuit's readings satisfy for any cells.

        `measured` and `sigma` are (frames, rows, columns); sigma is infinite for readings that are
        no values.
        """
        equation = equation_of(self, *measured.shape[-2:])
        return inequalities.free_tests(equation, measured, sigma)

    # Information of readings on the circuit.

    def largest_possible(self, measured: Array) -> Array:
        """Return the largest value of each reading that the others allow, (..., rows, columns).

        Infinite readings in `measured` allow anything. The result is infinite where no law limits a
        reading.
        """
        return np.full(measured.shape, np.inf)

    # Between recorded values and the network's readings.

    def offset(self, shape: tuple[int, ...]) -> Array | float:
        """Return what amplifiers add to recorded values, to be broadcast to (rows, columns)."""
        return 0.0

    def from_recorded(self, recorded: Array, scene: Surroundings) -> Array:
        """Return the network's readings of recorded values, (…, rows, columns)."""
        ends = nominal_terminations(self)
        level = ends.recorded_reference + self.offset(recorded.shape)
        if ends.sign > 0 and not np.any(level):
            return recorded
        return np.asarray(ends.sign * (recorded - level))

    def to_recorded(self, reading: Array, scene: Surroundings) -> Array:
        """Return the recorded values of the network's readings, (…, rows, columns)."""
        ends = nominal_terminations(self)
        level = ends.recorded_reference + self.offset(reading.shape)
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

    def simulated(
        self, cell_resistance: Array, scene: Surroundings, row_ohm: Array, column_ohm: Array
    ) -> Array:
        """Return recorded values (frames, rows, columns) of cells, without noise and quantisation.

        `row_ohm` and `column_ohm` are additional series resistances of every line's channel, (lines
        of a side,) ohm.
        """
        return self.to_recorded(self.exact_reading(cell_resistance, scene.wiring), scene)

    def off_by(self, fraction: float) -> Self:
        """Return the circuit with every reference resistor larger by a fraction.

        A kind that names no key of sensed lines has none.
        """
        if not self.of_sensed:
            return self
        name = self.of_sensed[0]
        value: PerLine = getattr(self, name)
        larger = tuple(number * (1 + fraction) for number in as_tuple(value))
        changes: dict[str, Any] = {name: larger if isinstance(value, tuple) else larger[0]}
        return replace(self, **changes)

    def line_numbers(self) -> tuple[LineNumber, ...]:
        """Return the numbers of the circuit that known resistors determine.

        The known resistors are in place of the cells.
        """
        return ()

    def shared_errors(
        self, cells: Array, measured: Array, scene: Surroundings, reference: float, channel: float
    ) -> Array:
        """Return the effect of shared errors on the readings, as secants of the model.

        Parameters
        ----------
        cells : array, shape (rows, columns)
            Estimate in ohm.
        measured : array, same shape
            Its readings; with two-point readouts also (…, rows, columns) of many panels.
        scene : Scene
        reference : float
            Relative error of the reference resistor, see `off_by`.
        channel : float
            Error of one line's channel in ohm, see `simulated`.

        Returns
        -------
        array, shape (1 + rows + columns, rows, columns), or (1, rows, columns) without `channel`
            Effect of the reference, then of the channel of each line, rows first.
        """
        unchanged = self.exact_reading(cells, scene.wiring)
        errors = np.zeros((1, *cells.shape))
        if reference:
            errors[0] = self.off_by(reference).exact_reading(cells, scene.wiring) - unchanged
        if not channel:
            return errors
        return np.concatenate([errors, self.channel_errors(cells, scene, channel)])

    def channel_errors(self, cells: Array, scene: Surroundings, channel: float) -> Array:
        """Return the effect of each line's channel on the readings, rows first.

        Shape (rows + columns, rows, columns). See `shared_errors`.
        """
        unchanged = self.exact_reading(cells, scene.wiring)
        rows, columns = cells.shape
        return np.stack(
            [
                self.from_recorded(self.simulated(cells, scene, extra[:rows], extra[rows:]), scene)
                - unchanged
                for extra in channel * np.eye(rows + columns)
            ]
        )
