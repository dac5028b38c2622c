"""How a panel is read: lines tied to ground, a reading as an equation, and the converter that turns it into codes.

A kind of readout is one file: it states its ties and its reading. All else has a default that follows from these two.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from lampest.panel.network import Network, inverse_of
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts.converter import Converter
from lampest.panel.readouts.lines import LineNumber, of_side, per_line
from lampest.panel.readouts.tied import TiedNetwork
from lampest.panel.readouts.wiring import WiredNetwork, Wiring

LEAST_SHARE = 1e-3  # (of a load) what a reading at its end leaves of the apparent resistance
SHORT_SHARE = 1e-6  # (of the apparent resistance) from here to a dead short readings move by a millionth


class Surroundings(Protocol):
    """What a readout reads of a scene; series_ohm : in series with every reading, broadcast to (rows, columns)."""

    @property
    def panel(self) -> Panel: ...

    @property
    def series_ohm(self) -> Array: ...

    @property
    def wiring(self) -> Wiring | None: ...


@dataclass(frozen=True, eq=False)
class FreeTest:
    """An inequality that readings of a circuit keep whatever its cells are.

    law : in words. excess : by how many σ the readings of every frame break it, at worst (frames). count : how many
    inequalities of a frame the worst was taken from. single : by how many σ each reading is too large beside the others
    (frames, rows, columns), where the inequality bounds one reading; else None.
    """

    law: str
    excess: Array
    count: int
    single: Array | None = None


@dataclass(frozen=True, kw_only=True)
class Readout(Converter, ABC):
    """What every kind of readout must say of its circuit; its converter has fields of its own, see `Converter`.

    A recorded reading lies between 0 and the supply in volt at the converter; see `rails` for what lies beyond.

    unit : of a reading, 'ohm' or 'volt'. signal, signal_name : its dataset in files, and that in words. homogeneous :
    whether readings grow with all cells by one factor. unique : whether plain least squares without noise has one
    minimum; else solvers search. in_series : whether the scene's series resistance adds to every reading. mirrored :
    whether loads lead to the supply, so that the converter sees Vcc minus the network's reading. by_columns : whether a
    scan goes column by column. series_name : what scenes call a resistance in series with the panel; '' without one.

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

    @property
    def mirrored(self) -> bool:
        return False

    @property
    def by_columns(self) -> bool:
        return False

    def check(self, scene: Surroundings) -> None:
        """Raise ValueError where the scene says what the readout has no model of, or it does not fit the panel."""
        per_line("noise_lsb", self.assumed_noise, of_side(self.noisy_side, *scene.panel.shape)[0])
        if np.any(scene.series_ohm) and not self.in_series:
            raise ValueError(
                "series_resistance_ohm belongs to readout.kind: two_point; with others a channel's resistance is part "
                "of the readout's drive_ohm or sense_ohm"
            )

    @abstractmethod
    def description(self) -> str:
        """The circuit and its numbers with their units, for people."""

    # The circuit: what a kind must state.

    @abstractmethod
    def ties(self, measured: Array) -> Array:
        """t (rows + columns) siemens: what ties every line to ground, for the readings (rows, columns) of a panel."""

    @abstractmethod
    def reading(self, row: Any, column: Any, mutual: Any) -> Any:
        """y = h(Z_jj, Z_kk, Z_jk), element by element of (rows, columns) in ohm; numpy arrays and CasADi alike."""

    @abstractmethod
    def apparent_resistance(self, measured: Array) -> Array:
        """The cell (…, rows, columns) ohm that would give each reading if it were the only one of the panel."""

    # What follows from the circuit.

    def ties_of_parts(self, measured: Array, parts: NDArray[np.intp] | None) -> Array:
        """t of a panel whose lines (lines) belong to parts that no cell joins, or None; lines of any kind are tied."""
        return self.ties(measured)

    def network(self, cell_resistance: Array, ties: Array, wiring: Wiring | None = None) -> Network:
        """The solved network of cells (rows, columns) ohm; wiring : what lies between them and the terminals, or None.

        Raises numpy.linalg.LinAlgError where a line is loose.
        """
        if wiring is not None:
            return WiredNetwork.solve(cell_resistance, ties, self, wiring)
        conductance = 1 / cell_resistance
        return TiedNetwork(cell_resistance, conductance, inverse_of(conductance, ties), self)

    def exact_reading(self, cell_resistance: Array, wiring: Wiring | None = None) -> Array:
        """y of cells (rows, columns) or (frames, rows, columns) ohm, any contrast; the same shape."""
        if cell_resistance.ndim == 3:
            return np.stack([self.exact_reading(frame, wiring) for frame in cell_resistance])
        with np.errstate(divide="ignore"):
            return self.network(cell_resistance, self.ties(cell_resistance), wiring).reading()

    def start(self, measured: Array, upper: Array, near: Array | None = None) -> Array:
        """Cells (rows, columns) ohm to begin a search at, from readings, upper bounds, an earlier estimate or None."""
        return self.uniform_start(measured) if near is None else near

    def uniform_start(self, measured: Array) -> Array:
        """Cells (…, rows, columns) ohm as if all were alike, as far as the kind knows better than apparent ones."""
        return self.apparent_resistance(measured)

    def least_cells(self, measured: Array, sigma: Array | None) -> Array:
        """What no cell can lie below, given its readings (…, rows, columns), ohm."""
        return self.nearly_shorted(measured)

    def nearly_shorted(self, measured: Array) -> Array:
        """Cells (…, rows, columns) ohm whose readings are those of dead shorts."""
        return SHORT_SHARE * self.apparent_resistance(measured)

    def resolution(self, measured: Array, sigma: Array) -> Array:
        """r_max = |∂y_c/∂g_c|/σ at the start: an open cell in its place changes its reading by just the noise σ.

        (…, rows, columns) ohm. Never below twice the start.
        """
        if measured.ndim > 2:
            return np.stack([self.resolution(*both) for both in zip(measured, sigma, strict=True)])
        start = self.uniform_start(measured)
        response = self.network(start, self.ties(measured)).own_response()
        return np.asarray(np.maximum(np.abs(response) * start / sigma, 2 * start))

    def common_step(self, measured: Array, expected: Array, chosen: NDArray[np.bool_]) -> float:
        """The factor by which all cells seem to have grown together; 1 where readings do not show it.

        measured, expected : (rows, columns) readings, and what was expected of them; chosen : those that count.
        """
        return 1.0

    # What readings show of the circuit.

    def free_tests(self, measured: Array, sigma: Array) -> tuple[FreeTest, ...]:
        """Inequalities that the circuit's readings (frames, rows, columns) keep whatever the cells are.

        sigma : likewise, infinite where a reading is no value.
        """
        return ()

    def most_in_series(self, measured: Array, sigma: Array) -> float:
        """The largest resistance that may stand in series with the panel, ohm; 0 where the kind has none.

        measured, sigma : as above, by a circuit that has none in series.
        """
        return 0.0

    # Between what is recorded and what the network is read by.

    def from_recorded(self, recorded: Array, scene: Surroundings) -> Array:
        """The network's reading of a recorded one, any shape ending in (rows, columns)."""
        return self.supply_volt - recorded if self.mirrored else recorded

    def to_recorded(self, reading: Array, scene: Surroundings) -> Array:
        """The recorded reading of a network's, any shape ending in (rows, columns)."""
        return self.supply_volt - reading if self.mirrored else reading

    @property
    def direction(self) -> float:
        """1 where a network's reading grows with the recorded one, -1 where it falls."""
        return -1.0 if self.mirrored else 1.0

    def rails_reached(self, recorded: Array) -> str:
        """'the rail of 0.005 volt', or both, that recorded readings reach or pass; '' where none does."""
        least, largest = self.rails()
        beyond = ((least, recorded < least), (largest, recorded > largest))
        reached = [f"{rail:.3g}" for rail, readings in beyond if np.any(readings)]
        plural = "s" * (len(reached) - 1)
        return f"the converter's rail{plural} of {' and '.join(reached)} {self.unit}" if reached else ""

    def sigma_of_reading(self, recorded: Array, sigma: Array) -> Array:
        """σ of the network's readings from that of recorded ones, the same shape."""
        return sigma

    def simulated(self, cell_resistance: Array, scene: Surroundings, row_ohm: Array, column_ohm: Array) -> Array:
        """Recorded readings (frames, rows, columns) of cells, without the converter.

        row_ohm, column_ohm : what every line's channel has in series beyond what the scene specifies, ohm.
        """
        return self.to_recorded(self.exact_reading(cell_resistance, scene.wiring), scene)

    def beyond(self, network: Network, scene: Surroundings, row_ohm: Array, column_ohm: Array) -> Array:
        """What so much more in the channels adds to a network's readings (rows, columns)."""
        recorded = self.simulated(network.cell_resistance, scene, row_ohm, column_ohm)
        return np.asarray(self.from_recorded(recorded, scene) - network.reading())

    def off_by(self, fraction: float) -> Self:
        """The same circuit with its reference resistor larger by a fraction."""
        return self

    def line_numbers(self) -> tuple[LineNumber, ...]:
        """What known resistors in place of the cells determine of the circuit; none, unless a kind says so."""
        return ()

    def shared_errors(
        self, cells: Array, measured: Array, scene: Surroundings, reference: float, channel: float
    ) -> Array:
        """What errors of all readings together do to them, (1 + rows + columns, rows, columns), or (1, rows, columns)
        without `channel`: secants of the model. Of two-point readouts also of many panels, (…, rows, columns).

        cells : the estimate, (rows, columns) ohm. measured : its readings. reference : by this fraction the reference
        resistor is off, see `off_by`. channel : by so many ohm one line's channel is, rows first, see `simulated`.
        """
        rows, columns = cells.shape
        lines, still = rows + columns if channel else 0, self.exact_reading(cells, scene.wiring)
        errors = np.zeros((1 + lines, rows, columns))
        if reference:
            errors[0] = self.off_by(reference).exact_reading(cells, scene.wiring) - still
        for line, more in enumerate(channel * np.eye(lines)):
            recorded = self.simulated(cells, scene, more[:rows], more[rows:])
            errors[1 + line] = self.from_recorded(recorded, scene) - still
        return errors
