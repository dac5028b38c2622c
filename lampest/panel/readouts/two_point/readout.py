"""Two-point readout: one row and one column are selected, all other lines float; a divider reads the resistance."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray

from lampest.panel.network import Block, Network, inverse_of
from lampest.panel.panel import Array
from lampest.panel.readouts.free_test import FreeTest
from lampest.panel.readouts.readout import Readout, check_positive
from lampest.panel.readouts.two_point.convex import convex_start, fitted_block
from lampest.panel.readouts.two_point.exact import two_point_resistance
from lampest.panel.readouts.two_point.floating import FloatingNetwork, grounding, uniform_factor
from lampest.panel.readouts.two_point.four_point import four_point_excess

if TYPE_CHECKING:
    from lampest.panel.scene import Scene


@dataclass(frozen=True, kw_only=True)
class TwoPointReadout(Readout):
    """R_jk = Z_jj + Z_kk − 2 Z_jk, all other lines floating; an ADC reads a divider with a reference resistor.

    Parameters
    ----------
    supply_volt : divider supply and ADC reference in volt.
    reference_ohm : reference resistor in ohm.
    measured_across : 'reference': R = (Vcc − V)/V · Rref; 'sensor': R = V/(Vcc − V) · Rref.
    adc_bits, readings, noise_lsb : the converter; see `Readout`.

    Recorded is what the divider equation gives, the series resistance of the scene included. Raises ValueError where a
    number is out of range. Source: paper, equation (1) (across the sensor) and section V.B (across the reference).
    """

    unit: ClassVar[str] = "ohm"
    signal: ClassVar[str] = "resistance"
    signal_name: ClassVar[str] = "two-point resistance, divider equation"
    homogeneous: ClassVar[bool] = True
    unique: ClassVar[bool] = True
    kind: Literal["two_point"] = "two_point"
    reference_ohm: float = 1000.0
    measured_across: Literal["reference", "sensor"] = "reference"

    def __post_init__(self) -> None:
        check_positive("supply_volt", self.supply_volt)
        check_positive("reference_ohm", self.reference_ohm)
        super().__post_init__()

    def check(self, scene: "Scene") -> None:
        """Nothing: scenes speak of this kind by default, and it fits any panel."""

    def description(self) -> str:
        """The divider and the converter."""
        return (
            f"two-point, {self.supply_volt:g} V, reference {self.reference_ohm:g} ohm, measured across the "
            f"{self.measured_across}, {self.converter_description()}"
        )

    def ties(self, measured: Array) -> Array:
        """One line, chosen by the readings; see `grounding`."""
        return grounding(measured)

    def reading(self, row: Any, column: Any, mutual: Any) -> Any:
        """R = Z_jj + Z_kk − 2 Z_jk in ohm; paper, equations (5)-(10)."""
        return row + column - 2 * mutual

    def network(self, cell_resistance: Array, ties: Array) -> FloatingNetwork:
        """The arithmetic of floating lines, which costs less than that of any reading."""
        conductance = 1 / cell_resistance
        return FloatingNetwork(cell_resistance, conductance, inverse_of(conductance, ties))

    def exact_reading(self, cell_resistance: Array) -> Array:
        """R = f(r) with at least ten digits at any contrast."""
        return two_point_resistance(cell_resistance)

    def apparent_resistance(self, measured: Array) -> Array:
        """R itself."""
        return measured

    def uniform_start(self, measured: Array) -> Array:
        """R·MN/(M + N − 1): right for equal cells."""
        uniform: Array = measured / uniform_factor(*measured.shape[-2:])
        return uniform

    def start(self, measured: Array, upper: Array, near: Array | None = None) -> Array:
        """Cells that reproduce attainable readings exactly; see `convex_start`."""
        return convex_start(measured, upper, near)

    def exact_start(self, measured: Array, upper: Array) -> Array:
        """The same to a millionth of every reading."""
        return convex_start(measured, upper, tolerance=1e-6)

    def least_cells(self, measured: Array, sigma: Array | None) -> Array:
        """r ≥ R: parallel paths only lower a reading; paper, equation (12)."""
        return measured.copy()

    def resolution(self, measured: Array, sigma: Array) -> Array:
        """r_max = R²/σ: an open cell in place of one of r_max changes R by just its noise σ.

        Never below twice the cell of a uniform panel.
        """
        least = 2 * measured / uniform_factor(*measured.shape[-2:])
        return np.asarray(np.maximum(resolution_limit(measured, sigma), least))

    def common_step(self, measured: Array, expected: Array, chosen: NDArray[np.bool_]) -> float:
        """The mean of the shortest half of log R_m/R, so that a load on some lines does not count.

        Two-point resistances are homogeneous: with all cells they grow by one factor. 1 without readings. Source:
        Andrews et al., Robust Estimates of Location, 1972 (the shorth).
        """
        steps = np.sort(np.log(measured[chosen] / expected[chosen]), axis=None)
        half = len(steps) // 2 + 1
        if half > len(steps):
            return 1.0
        first = int(np.argmin(steps[half - 1 :] - steps[: len(steps) - half + 1]))
        return float(np.exp(steps[first : first + half].mean()))

    def fitted_block(
        self, network: Network, block: Block, measured: Array, least: Array, chosen: NDArray[np.bool_]
    ) -> Network:
        """Of floating lines by a convex function; see `lampest.panel.readouts.two_point.convex`."""
        assert isinstance(network, FloatingNetwork)
        return fitted_block(network, block, measured, least, chosen)

    def free_tests(self, measured: Array, sigma: Array) -> tuple[FreeTest, ...]:
        """R_jk ≤ R_jq + R_pq + R_pk; see `four_point_excess`."""
        law = "R_jk <= R_jq + R_pq + R_pk of any two rows and columns"
        return (FreeTest(law, four_point_excess(measured, sigma), measured[0].size ** 2),)

    def most_in_series(self, measured: Array, sigma: Array) -> float:
        """min R: what is left for the panel is positive."""
        return float(measured[np.isfinite(sigma)].min(initial=np.inf))

    def with_series(self, scene: "Scene", ohm: float) -> "Scene":
        """As the scene's series resistance."""
        return replace(scene, series_resistance_ohm=ohm)

    def in_series(self, scene: "Scene") -> float:
        """The scene's."""
        return scene.series_resistance_ohm

    @property
    def series_name(self) -> str:
        """The scene's own."""
        return "series_resistance_ohm"

    def from_recorded(self, recorded: Array, scene: "Scene") -> Array:
        """R − R_series."""
        network: Array = recorded - scene.series_resistance_ohm
        return network

    def to_recorded(self, reading: Array, scene: "Scene") -> Array:
        """R + R_series."""
        total: Array = reading + scene.series_resistance_ohm
        return total

    def simulated(self, cell_resistance: Array, scene: "Scene", row_ohm: Array, column_ohm: Array) -> Array:
        """R + R_series + what both channels have more."""
        total = self.to_recorded(self.exact_reading(cell_resistance), scene)
        return np.asarray(total + (row_ohm[:, None] + column_ohm[None, :]))

    def off_by(self, fraction: float) -> Self:
        """Rref·(1 + fraction)."""
        return replace(self, reference_ohm=self.reference_ohm * (1 + fraction))

    def recorded_from_volt(self, volt: Array) -> Array:
        """R = (Vcc − V)/V·Rref across the reference, R = V/(Vcc − V)·Rref across the sensor; any shape, volt → ohm.

        0 V and Vcc give 0 or infinite ohm.
        """
        volt = np.asarray(volt, dtype=float)
        rest = self.supply_volt - volt
        upper, lower = (rest, volt) if self.measured_across == "reference" else (volt, rest)
        with np.errstate(divide="ignore"):
            return np.asarray(upper / lower * self.reference_ohm)

    def volt_from_recorded(self, recorded: Array) -> Array:
        """V = Vcc·Rref/(R + Rref) across the reference, V = Vcc·R/(R + Rref) across the sensor; any shape."""
        with np.errstate(divide="ignore"):
            ratio = np.asarray(recorded, dtype=float) / self.reference_ohm
        if self.measured_across == "reference":
            return np.asarray(self.supply_volt / (1 + ratio))
        with np.errstate(divide="ignore"):
            return np.asarray(self.supply_volt / (1 + 1 / ratio))

    def sigma(self, recorded: Array) -> Array:
        """σ_R = (R + Rref)²/Rref · σ_V/Vcc (delta method, either divider); any shape, ohm.

        `recorded` is what the divider sees, series resistance included. Source: error propagation of equation (1).
        """
        sigma_volt = self.sigma_code() * self.lsb_volt
        total = np.asarray(recorded, dtype=float) + self.reference_ohm
        return np.asarray(total**2 / self.reference_ohm * sigma_volt / self.supply_volt)


def resolution_limit(two_point_resistance: Array, sigma: Array) -> Array:
    """r_max = R²/σ, any shape, ohm."""
    return np.asarray(two_point_resistance) ** 2 / np.asarray(sigma)
