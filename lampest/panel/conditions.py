"""Conditions of a measurement outside the circuit: water, temperature, shared errors, faults, subject, experiment."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lampest.files.typed import Configuration, check_positive_fields, check_range, check_ranges
from lampest.panel.panel import Modules, Panel
from lampest.panel.readouts.lines import MAX_OHM


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


@dataclass(frozen=True)
class Temperature(Configuration):
    """Effect of the film's temperature on every cell between baseline and measurement, r(T) = r(T_b)·exp(α (T − T_b)).

    The exponential agrees with 1 + α (T − T_b) within (α (T − T_b))²/2, and stays positive far from T_b. Raises
    ValueError if a number is out of range.

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
class Systematic(Configuration):
    """Systematic errors that all readings may share; they widen error bars and change no estimate. None: absent.

    Attributes
    ----------
    reference_tolerance : float
        Largest relative error of the reference resistor, or of all loads or feedback resistors together.
    channel_spread_ohm : float
        Standard deviation of the resistance of each line's channel, in ohm.
    series_ohm : float, or None
        Standard deviation of a resistance in series with all driven lines, in addition to the scene's, in ohm.
    inl_lsb : float, or None
        Standard deviation of the converter's smooth deviation from a straight line, in least significant bits.
    wire_ohm_per_cell : float, or None
        Standard deviation of the wire of rows and columns from cell to cell, in addition to the scene's, in ohm.
    reading_error : float, or None
        Standard deviation of the logarithm of a factor on each reading, the same in all frames.
    response_sd : float, or None
        Relative standard deviation of each cell's response to pressure, in the logarithm of its resistance (bent film,
        differing patches); it widens pressures only.

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
        check_ranges(self, 0, MAX_OHM, "channel_spread_ohm", "series_ohm", "wire_ohm_per_cell")
        check_ranges(self, 0, 2.0**32, "inl_lsb")
        check_ranges(self, 0, 10, "reading_error", "response_sd")


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
        Temperature of the water around the panel in °C; the scene's key `temperature` describes its effect on the film.
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


@dataclass(frozen=True)
class Faults(Configuration):
    """Known faults by (row, column) or line; broken parts are removed from the model.

    Attributes
    ----------
    open : pairs of int
        Cells that carry no current.
    shorted : pairs of int
        Cells that join their lines; their readings carry no information.
    dead_rows, dead_columns : tuple of int
        Lines without contact: no readings, no current through their cells.
    dead_modules : pairs of int
        Modules that are not read; their cells are not estimated.
    joined_rows, joined_columns : tuples of int
        Groups of lines that touch at their terminals. They are one node with equal readings, which determine only the
        sum of the conductances of their cells on one crossing line.

    >>> lampest.Faults(dead_rows=(1,)).open_cells(lampest.Panel(2, 3)).sum()
    np.int64(3)
    """

    open: tuple[tuple[int, int], ...] = ()
    shorted: tuple[tuple[int, int], ...] = ()
    dead_rows: tuple[int, ...] = ()
    dead_columns: tuple[int, ...] = ()
    joined_rows: tuple[tuple[int, ...], ...] = ()
    joined_columns: tuple[tuple[int, ...], ...] = ()
    dead_modules: tuple[tuple[int, int], ...] = ()

    def open_cells(self, panel: Panel) -> NDArray[np.bool_]:
        """Return whether a cell carries no current, boolean (rows, columns)."""
        cells = np.zeros(panel.shape, dtype=bool)
        for row, column in self.open:
            cells[row, column] = True
        cells[list(self.dead_rows)] = True
        cells[:, list(self.dead_columns)] = True
        return cells

    def shorted_cells(self, panel: Panel) -> NDArray[np.bool_]:
        """Return whether a cell shorts its lines, boolean (rows, columns)."""
        return Faults(open=self.shorted).open_cells(panel)

    def blind(self, panel: Panel) -> NDArray[np.bool_]:
        """Return whether a reading is missing because of a fault, boolean (rows, columns)."""
        return replace(self, open=self.shorted).open_cells(panel)

    def joined(self, panel: Panel) -> tuple[tuple[int, ...], ...]:
        """Return the groups of lines that are one node, by the numbers of the lines, rows first."""
        return (*self.joined_rows, *(tuple(panel.rows + line for line in group) for group in self.joined_columns))

    def check(self, panel: Panel) -> None:
        """Raise ValueError unless all faults are on the panel, agree with each other, and leave an intact part."""
        layout, lines = panel.modules, self.dead_rows or self.dead_columns or self.joined_rows or self.joined_columns
        if layout is not None and lines:
            raise ValueError(
                "faults: every module has lines of its own; name those under modules: [{at: ..., faults: ...}]"
            )
        for place in self.dead_modules:
            if layout is None or not (0 <= place[0] < layout.rows and 0 <= place[1] < layout.columns):
                raise ValueError(f"faults: there is no module {list(place)}")
        for row, column in (*self.open, *self.shorted):
            if not (0 <= row < panel.rows and 0 <= column < panel.columns):
                raise ValueError(f"faults: there is no cell [{row}, {column}]")
        sides = (
            (self.dead_rows, self.joined_rows, panel.rows, "row"),
            (self.dead_columns, self.joined_columns, panel.columns, "column"),
        )
        for dead, joined, count, name in sides:
            touching = [line for group in joined for line in group]
            if any(len(group) < 2 for group in joined) or len(set(touching)) < len(touching):
                raise ValueError(f"faults: joined_{name}s lists groups of two or more, each {name} once")
            if set(touching) & set(dead):
                raise ValueError(f"faults: a {name} cannot be dead and joined to another")
            for line in (*dead, *touching):
                if not 0 <= line < count:
                    raise ValueError(f"faults: there is no {name} {line}")
        if np.any(self.open_cells(panel) & self.shorted_cells(panel)):
            raise ValueError("faults: a cell cannot be open and shorted")
        read, conducting = (panel.present & ~gone for gone in (self.blind(panel), self.open_cells(panel)))
        all_dead = layout is not None and len(set(self.dead_modules)) == layout.count
        if not (read.any() and conducting.any()) or all_dead:
            raise ValueError("faults: nothing is left of the panel")

    def of_module(self, layout: Modules, number: int, own: "Faults | None") -> "Faults | None":
        """Return the faults of one module by its own rows and columns, including those in `own`; None without any."""
        rows, columns = layout.cells(number)
        own = own or Faults()

        def inside(cells: tuple[tuple[int, int], ...]) -> list[tuple[int, int]]:
            moved = ((row - rows.start, column - columns.start) for row, column in cells)
            return [
                place for place in moved if 0 <= place[0] < layout.each.rows and 0 <= place[1] < layout.each.columns
            ]

        merged = replace(own, open=(*own.open, *inside(self.open)), shorted=(*own.shorted, *inside(self.shorted)))
        return None if merged == Faults() else merged
