"""What a scene states beside its circuit: water, temperature, errors that all readings share, subject, experiment."""

from dataclasses import dataclass

from lampest.files.typed import Configuration, check_positive_fields, check_range, check_ranges
from lampest.panel.readouts.lines import MOST_OHM


@dataclass(frozen=True)
class Water(Configuration):
    """An upright panel under water, in the unloaded frames too: row 0 on top, top_row_depth_mm below the surface.

    Raises ValueError where the depth is negative or beyond the deepest sea, 1.1e7 mm.

    >>> lampest.Water(top_row_depth_mm=50.0).top_row_depth_mm
    50.0
    """

    top_row_depth_mm: float

    def __post_init__(self) -> None:
        check_range("top_row_depth_mm", self.top_row_depth_mm, 0, 1.1e7)


@dataclass(frozen=True)
class Temperature(Configuration):
    """r(T) = r(T_b)·exp(α (T − T_b)): how the film's temperature changes every cell between baseline and measurement.

    coefficient_per_kelvin : α. coefficient_sd_per_kelvin : its standard deviation.
    baseline_celsius, measured_celsius : T_b of the unloaded and T of the measured frames.

    1 + α (T − T_b), with which it agrees within (α (T − T_b))²/2, turns negative far from T_b. Raises ValueError where
    a number is out of range.

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
        """T − T_b."""
        return self.measured_celsius - self.baseline_celsius

    @property
    def logarithm(self) -> float:
        """ln(r(T)/r(T_b)) = α (T − T_b)."""
        return self.coefficient_per_kelvin * self.difference_kelvin


@dataclass(frozen=True)
class Systematic(Configuration):
    """Errors that all readings may share; widens error bars and changes no estimate.

    reference_tolerance : the reference resistor, or all loads or feedback resistors together, are off by up to this
        fraction.
    channel_spread_ohm : standard deviation of the resistance of each line's channel, in ohm.
    series_ohm : of what stands in series with all driven lines alike, beside what the scene names, in ohm.
    inl_lsb : of the converter's curve about a straight line, a smooth one, in least significant bits.
    wire_ohm_per_cell : of the wire of rows and columns from cell to cell, beside what the scene names, in ohm.
    reading_error : of the logarithm of a factor on each reading, the same in all frames.
    response_sd : of a factor on each cell's answer to pressure, in the logarithm of its resistance (bent film, patches
        that differ); widens pressures alone.

    None: absent.

    >>> lampest.Systematic(reference_tolerance=0.01).reference_tolerance
    0.01
    """

    reference_tolerance: float = 0.0
    channel_spread_ohm: float = 0.0
    series_ohm: float | None = None
    inl_lsb: float | None = None
    wire_ohm_per_cell: float | None = None
    reading_error: float | None = None
    response_sd: float | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.reference_tolerance < 1:
            raise ValueError("reference_tolerance must be zero or positive, and below 1")
        check_ranges(self, 0, MOST_OHM, "channel_spread_ohm", "series_ohm", "wire_ohm_per_cell")
        check_ranges(self, 0, 2.0**32, "inl_lsb")
        check_ranges(self, 0, 10, "reading_error", "response_sd")


@dataclass(frozen=True)
class MeasuredSubject(Configuration):
    """Who touched the panel.

    id : its name in the laboratory. species : its Latin name. length_mm, mass_g : of the body. note : what else there
    is to say. Empty or None: not known. Raises ValueError where a number is not positive.

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
    """What it was measured for.

    title : in a few words. experimenter : who did it. institution : where. water_temperature_celsius : of the water
    around the panel; what warmth does to the film is another key, `temperature`. note : what else there is to say.
    Empty or None: not known. Raises ValueError where the water is no water.

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
