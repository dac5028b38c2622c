"""Circumstances of a measurement: water and temperature, and who was measured in which experiment.

Water and temperature change the resistance of cells. No estimate depends on the subject and the
experiment.
"""

from dataclasses import dataclass

import numpy as np

from lampest.files.typed import Configuration, check_positive_fields, check_range, check_ranges
from lampest.panel.panel import Array, Panel, Shape

GRAVITY = 9.81  # m/s²


@dataclass(frozen=True)
class Water(Configuration):
    """Upright panel under water, with row 0 on top; also in the unloaded frames.

    Attributes
    ----------
    top_row_depth_mm : float
        Depth of row 0 below the surface in mm.

    Raises ValueError if the depth is negative or greater than that of the deepest sea, 1.1e7 mm.

    >>> lampest.Water(top_row_depth_mm=50.0).top_row_depth_mm
    50.0
    """

    top_row_depth_mm: float

    def __post_init__(self) -> None:
        check_range("top_row_depth_mm", self.top_row_depth_mm, 0, 1.1e7)


def water_pressure(panel: Panel, water: Water | None) -> Array:
    """Return the water's pressure p_w = ρ g (depth + y) of cells at y, (rows, columns) kPa.

    The result is 0 without water.
    """
    if water is None:
        return np.zeros(panel.shape)
    depth_mm = water.top_row_depth_mm + panel.places_mm[1]
    return np.asarray(np.nan_to_num(1e-6 * 1000 * GRAVITY * depth_mm))


def motion_patterns(shape: Shape) -> Array:
    """Return the patterns in which moving water changes ln r of all cells, (3, rows, columns).

    The patterns are 1, the place across the columns, and the place across the rows, from −1 to 1. A
    change of ln r that all cells share changes ln of each two-point resistance by the same amount;
    a gradient changes the readings by less.
    """
    rows, columns = (np.linspace(-1, 1, size) if size > 1 else np.zeros(1) for size in shape)
    return np.stack([np.ones(shape), *np.broadcast_arrays(columns, rows[:, None])])


def moved_by_water(measured: Array, motion: Array) -> Array:
    """Return the changes of readings (rows, columns) by motion of 3 sizes, (3, rows, columns)."""
    return motion[:, None, None] * motion_patterns(measured.shape) * measured


@dataclass(frozen=True)
class Temperature(Configuration):
    """Effect of the film's temperature on every cell between baseline and measurement.

    The model is r(T) = r(T_b)·exp(α (T − T_b)). The exponential agrees with 1 + α (T − T_b) within
    (α (T − T_b))²/2, and stays positive far from T_b. Raises ValueError if a number is out of
    range.

    Attributes
    ----------
    coefficient_per_kelvin : float
        α in 1/K.
    coefficient_sd_per_kelvin : float
        Standard deviation of α in 1/K.
    baseline_celsius, measured_celsius : float
        T_b of the unloaded and T of the measured frames, °C.

    >>> lampest.Temperature(-0.003, baseline_celsius=20.0, measured_celsius=12.0).difference_kelvin
    -8.0
    """

    coefficient_per_kelvin: float
    baseline_celsius: float
    measured_celsius: float
    coefficient_sd_per_kelvin: float = 0.0

    def __post_init__(self) -> None:
        check_ranges(self, -1, 1, "coefficient_per_kelvin")
        check_ranges(self, 0, 1, "coefficient_sd_per_kelvin")
        check_ranges(self, -273.15, 1000, "baseline_celsius", "measured_celsius")

    @property
    def difference_kelvin(self) -> float:
        """Temperature difference T − T_b in K."""
        return self.measured_celsius - self.baseline_celsius

    @property
    def logarithm(self) -> float:
        """Change of log r, ln(r(T)/r(T_b)) = α (T − T_b)."""
        return self.coefficient_per_kelvin * self.difference_kelvin


@dataclass(frozen=True)
class MeasuredSubject(Configuration):
    """Animal, person or object that touched the panel.

    Attributes
    ----------
    id : str
        Name in the laboratory.
    species : str
        Latin name.
    length_mm, mass_g : float, or None
        Length and mass of the body.
    note : str
        Remarks.

    Empty or None: not known. Raises ValueError if a number is not positive.

    >>> lampest.MeasuredSubject(species="Petromyzon marinus").species
    'Petromyzon marinus'
    """

    id: str = ""
    species: str = ""
    length_mm: float | None = None
    mass_g: float | None = None
    note: str = ""

    def __post_init__(self) -> None:
        check_positive_fields(self, "length_mm", "mass_g")


@dataclass(frozen=True)
class Experiment(Configuration):
    """Purpose and circumstances of a measurement.

    Attributes
    ----------
    title : str
        Title in a few words.
    experimenter, institution : str
    water_temperature_celsius : float, or None
        Temperature of the water around the panel in °C; the scene's key `temperature` describes its
        effect on the film.
    note : str
        Remarks.

    Empty or None: not known. Raises ValueError if the temperature is outside that of water.

    >>> lampest.Experiment(title="attachment").title
    'attachment'
    """

    title: str = ""
    experimenter: str = ""
    institution: str = ""
    water_temperature_celsius: float | None = None
    note: str = ""

    def __post_init__(self) -> None:
        check_ranges(self, -5, 100, "water_temperature_celsius")
