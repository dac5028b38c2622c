"""Base of the readouts: a circuit that states how each line ends, and its converter.

A kind of readout is one file with its keys and one function from keys to ends, `terminations`. All
else follows from the ends: `lampest.panel.equation` has the equation of the readings,
`lampest.panel.readouts.starts` the cells at which solves begin, and
`lampest.panel.readouts.inequalities` the bounds.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
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
from lampest.panel.readouts.starts import USUAL_OHM
from lampest.panel.readouts.unseen import Scale, unseen_scales
from lampest.panel.readouts.wiring import Wiring

LARGEST_OHM = 1e8  # of cells whose scale no reading shows: insulation beside usual ones
# Of the apparent resistance: readings of such a cell differ by a millionth from those of a short.
SHORT_SHARE = 1e-6


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

    @property
    def mirrored(self) -> bool:
        """Whether the voltage at the converter falls where the network's reading rises."""
        return nominal_terminations(self).sign < 0

    @property
    def by_columns(self) -> bool:
        """Whether a scan goes column by column; a list of readings counts as rows."""
        return (self.noisy_side if self.scan_order is None else self.scan_order) == "columns"

    def scan_places(self, rows: int, columns: int) -> NDArray[np.intp]:
        """Return the numbers of the readings, rows first, in scan order, (rows · columns,).

        Readings that a list leaves out are the last ones.
        """
        places = np.arange(rows * columns).reshape(rows, columns)
        if not isinstance(self.scan_order, tuple):
            return places.T.ravel() if self.by_columns else places.ravel()
        row, column = np.array(self.scan_order).T
        listed = places[row, column]
        return np.concatenate([listed, np.setdiff1d(places, listed)])

    def _check_scan_order(self, panel: Panel) -> None:
        """Raise ValueError unless a list of readings names every cell of a panel once."""
        if not isinstance(self.scan_order, tuple):
            return
        rows, columns = panel.shape
        for row, column in self.scan_order:
            if not (0 <= row < rows and 0 <= column < columns):
                raise ValueError(f"readout.scan_order: there is no reading [{row}, {column}]")
        if len(set(self.scan_order)) < len(self.scan_order):
            twice = next(at for at in self.scan_order if self.scan_order.count(at) > 1)
            raise ValueError(f"readout.scan_order: {list(twice)} is listed twice")
        listed = np.zeros(panel.shape, dtype=bool)
        for at in self.scan_order:
            listed[at] = True
        left_out = np.argwhere(panel.present & ~listed)
        if len(left_out):
            raise ValueError(f"readout.scan_order: {left_out[0].tolist()} is left out")

    def check(self, scene: Surroundings) -> None:
        """Raise ValueError if the scene does not fit the readout or the panel.

        A scene does not fit the readout if it has keys that the readout cannot model.
        """
        per_line("noise_lsb", self.assumed_noise, of_side(self.noisy_side, *scene.panel.shape)[0])
        self._check_scan_order(scene.panel)
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

    def ties(self, measured: Array) -> Array:
        """Return the ties to ground of the bases, (lines,) siemens, or (addresses, lines).

        Lines that 0 ohm hold have infinite ties.
        """
        return self.ties_of_parts(measured, None)

    def ties_of_parts(self, measured: Array, parts: NDArray[np.intp] | None) -> Array:
        """Return the ties of a panel that open cells may divide.

        `parts`, (lines,), is the number of each line's part, None for a connected panel.
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

    def several_panels(self, rows: int, columns: int) -> bool:
        """Return whether the readings of usual cells may be those of quite different cells, too."""
        return starts.several_panels(self, rows, columns)

    def every_panel(
        self,
        measured: Array,
        limits: tuple[Array, Array],
        tolerance: float,
        firsts: Sequence[Array] = (),
    ) -> list[Array]:
        """Return panels that give readings, (rows, columns) ohm each.

        The result is empty for circuits that do not have `several_panels`.

        Parameters
        ----------
        measured : array, shape (rows, columns)
            Readings; those that are NaN do not count.
        limits : tuple of two arrays, shape (rows, columns)
            Smallest and largest resistances, ohm; equal where a cell is known.
        tolerance : float
            Largest root mean square of the differences to them, over the median reading.
        firsts : sequence of array, shape (rows, columns)
            Cells at which searches begin, in addition to uniform ones, ohm.
        """
        return starts.panels_beyond_folds(self, measured, limits, tolerance, firsts)

    def panels_alike(self, measured: Array) -> list[tuple[float, Array]]:
        """Return the panels that give readings, the most probable one first.

        A panel is ln p and cells (rows, columns) ohm. The list is empty where uniform panels give
        the median reading with one resistance alone; see `lampest.panel.readouts.branches`.
        """
        return starts.uniform_branches(self, measured)

    def unseen_scales(self, rows: int, columns: int) -> tuple[Scale, ...]:
        """Return the scales of cells that no reading shows: 'all', 'rows', 'columns'."""
        equation = equation_of(self, rows, columns)
        # A load, or nothing that conducts elsewhere, shows the scale
        if np.isfinite(equation.load).all() or equation.floating:
            return ()
        return unseen_scales(self, rows, columns)

    def resolution(self, measured: Array, sigma: Array) -> Array:
        """Return the resolution limit r_max = |∂y_c/∂g_c|/σ at the uniform start.

        Shape (…, rows, columns), in ohm. An open cell in place of a cell of r_max changes its
        reading by the noise σ. r_max is at least twice the start. Without a scale it is that of any
        cell: no reading says more. Where no closed form gives a cell by its reading, it is the
        largest limit of uniform panels: a press moves the readings of other cells beyond those of
        any uniform panel.
        """
        rows, columns = measured.shape[-2:]
        if self.unseen_scales(rows, columns):
            return np.full(measured.shape, LARGEST_OHM)
        if starts.by_uniform_panels(self, measured):
            return np.asarray(starts.uniform_responses(self, rows, columns) / sigma)
        if measured.ndim > 2:
            frames = zip(measured, sigma, strict=True)
            return np.stack([self.resolution(*frame) for frame in frames])
        start = self.uniform_start(measured)
        response = self.network(start, self.ties(measured)).own_response()
        # |∂y_c/∂g_c|/σ = |J_cc|/(g σ) = |J_cc|·r/σ
        return np.asarray(np.maximum(np.abs(response) * start / sigma, 2 * start))

    def nearly_shorted(self, measured: Array) -> Array:
        """Return cells that count as shorts, (…, rows, columns) ohm.

        A share of the uniform start bounds them, too, because with idle lines at ground the
        apparent resistance is many times too large. So is the nearest uniform panel where a reading
        lies beyond those of all.
        """
        start = self.uniform_start(measured)
        if starts.by_uniform_panels(self, measured):
            return SHORT_SHARE * np.minimum(start, USUAL_OHM)
        return SHORT_SHARE * np.minimum(self.apparent_resistance(measured), start)

    def least_cells(self, measured: Array, sigma: Array | None) -> Array:
        """Return lower bounds of the cells, (…, rows, columns) ohm, for readings and their σ.

        σ is None if it is unknown.
        """
        equation = equation_of(self, *measured.shape[-2:])
        least = self.nearly_shorted(measured)
        bound = inequalities.least_cells(equation, measured, sigma)
        return least if bound is None else np.asarray(np.maximum(bound, least))

    def free_tests(self, measured: Array, sigma: Array) -> tuple[FreeTest, ...]:
        """Return tests of inequalities that the circuit's readings satisfy for any cells.

        `measured` and `sigma` are (frames, rows, columns); sigma is infinite for readings that are
        no values.
        """
        equation = equation_of(self, *measured.shape[-2:])
        return inequalities.free_tests(equation, measured, sigma)

    def most_in_series(self, measured: Array, sigma: Array) -> float:
        """Return the largest possible resistance in series with the panel, ohm.

        `measured` and `sigma` are those of `free_tests`, computed for a circuit without resistance
        in series.
        """
        equation = equation_of(self, *measured.shape[-2:])
        return inequalities.largest_drive_ohm(equation, measured, sigma)

    def common_step(self, measured: Array, expected: Array, chosen: NDArray[np.bool_]) -> float:
        """Return the common factor of all cells relative to a prediction.

        The result is 1 if the kind cannot determine it.

        Parameters
        ----------
        measured, expected : array, shape (rows, columns)
            Readings and their prediction.
        chosen : boolean array
            Readings that are used.
        """
        return 1.0

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

    @property
    def direction(self) -> float:
        """1 if the network's reading grows with the recorded value, -1 if it falls."""
        return -1.0 if self.mirrored else 1.0

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

    def beyond(
        self, network: Network, scene: Surroundings, row_ohm: Array, column_ohm: Array
    ) -> Array:
        """Return the change of a network's readings by additional channel resistance.

        Shape (rows, columns).
        """
        recorded = self.simulated(network.cell_resistance, scene, row_ohm, column_ohm)
        return np.asarray(self.from_recorded(recorded, scene) - network.reading())

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


def in_scan_order(readout: Readout, values: Array) -> Array:
    """Return values (…, rows, columns) in scan order, (…, channels)."""
    flat = values.reshape(*values.shape[:-2], -1)
    return np.asarray(flat[..., readout.scan_places(*values.shape[-2:])])


def in_scan_lines(readout: Readout, values: Array) -> Array:
    """Return values (…, rows, columns) in scan order by scanned lines, (…, lines, channels)."""
    rows, columns = values.shape[-2:]
    lines, channels = (columns, rows) if readout.by_columns else (rows, columns)
    return in_scan_order(readout, values).reshape(*values.shape[:-2], lines, channels)


def in_panel_order(readout: Readout, channels: Array, shape: tuple[int, ...]) -> Array:
    """Return values (…, channels) in scan order as an array of `shape` (…, rows, columns)."""
    flat = np.empty_like(channels)
    flat[..., readout.scan_places(*shape[-2:])] = channels
    return flat.reshape(shape)
