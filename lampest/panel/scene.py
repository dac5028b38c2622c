"""What a measurement contains. An effect that a scene does not name does not exist in the model."""

import warnings
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from lampest.files.document import to_yaml
from lampest.files.tagged import members_of
from lampest.panel.film import Film
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import AnyReadout, Readout, TwoPointReadout
from lampest.panel.readouts.lines import MOST_OHM, PerLine, as_tuple, check_resistors, lines_text, per_line
from lampest.panel.readouts.wiring import Contacts, Lines, Wiring
from lampest.panel.response import AnyResponse

DEEPEST_MM = 1.1e7
MOST_OFF = {"inl_lsb": 2.0**32, "reading_error": 10.0, "response_sd": 10.0}  # the rest in ohm


@dataclass(frozen=True)
class Faults:
    """What is known to be broken, by (row, column) or line; it leaves the model.

    Parameters
    ----------
    open : cells that carry nothing. shorted : cells that join their lines; their readings say nothing.
    dead_rows, dead_columns : lines without contact: their readings say nothing, their cells carry nothing.
    joined_rows, joined_columns : groups of lines that touch each other at their terminals: they are one node, either is
        read alike, and of their cells on one crossing only the sum of conductances is ever seen.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    open: tuple[tuple[int, int], ...] = ()
    shorted: tuple[tuple[int, int], ...] = ()
    dead_rows: tuple[int, ...] = ()
    dead_columns: tuple[int, ...] = ()
    joined_rows: tuple[tuple[int, ...], ...] = ()
    joined_columns: tuple[tuple[int, ...], ...] = ()

    def open_cells(self, panel: Panel) -> NDArray[np.bool_]:
        """(rows, columns) where a cell carries nothing."""
        cells = np.zeros(panel.shape, dtype=bool)
        for row, column in self.open:
            cells[row, column] = True
        cells[list(self.dead_rows)] = True
        cells[:, list(self.dead_columns)] = True
        return cells

    def shorted_cells(self, panel: Panel) -> NDArray[np.bool_]:
        """(rows, columns) where a cell joins its lines."""
        cells = np.zeros(panel.shape, dtype=bool)
        for row, column in self.shorted:
            cells[row, column] = True
        return cells

    def numbers(self, panel: Panel) -> tuple[int, ...]:
        """The numbers of all cells that are open or shorted."""
        return tuple(int(cell) for cell in np.flatnonzero(self.open_cells(panel) | self.shorted_cells(panel)))

    def blind(self, panel: Panel) -> NDArray[np.bool_]:
        """(rows, columns) where a reading says nothing."""
        readings = self.shorted_cells(panel)
        readings[list(self.dead_rows)] = True
        readings[:, list(self.dead_columns)] = True
        return readings

    def joined(self, panel: Panel) -> tuple[tuple[int, ...], ...]:
        """Groups of lines that are one node, by the numbers of lines, rows first."""
        columns = tuple(tuple(panel.rows + line for line in group) for group in self.joined_columns)
        return self.joined_rows + columns

    def check(self, panel: Panel) -> None:
        """Raise ValueError unless every fault lies on the panel, none is two things at once, and something is left."""
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
        if np.all(self.blind(panel)) or np.all(self.open_cells(panel)):
            raise ValueError("faults: nothing is left of the panel")


@dataclass(frozen=True)
class Water:
    """An upright panel under water, in the unloaded frames too: row 0 on top, top_row_depth_mm below the surface.

    Raises ValueError where the depth is out of range.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    top_row_depth_mm: float

    def __post_init__(self) -> None:
        if not 0 <= self.top_row_depth_mm <= DEEPEST_MM:
            raise ValueError(
                f"top_row_depth_mm must be zero or positive, and finite: at most {DEEPEST_MM:g}, the deepest sea"
            )


@dataclass(frozen=True)
class Temperature:
    """r(T) = r(T_b)·exp(α (T − T_b)): how the film's temperature changes every cell between baseline and measurement.

    Exponential, because 1 + α (T − T_b) turns negative far from T_b and depends on which temperature is called the
    first; both agree within (α (T − T_b))²/2, which is 3e-4 for −0.3 % per kelvin over 8 kelvin.

    Parameters
    ----------
    coefficient_per_kelvin : α. coefficient_sd_per_kelvin : its standard deviation.
    baseline_celsius, measured_celsius : T_b of the unloaded and T of the measured frames.

    Raises ValueError where a number is out of range.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    coefficient_per_kelvin: float
    baseline_celsius: float
    measured_celsius: float
    coefficient_sd_per_kelvin: float = 0.0

    def __post_init__(self) -> None:
        if not -1 <= self.coefficient_per_kelvin <= 1:
            raise ValueError("coefficient_per_kelvin must lie between -1 and 1")
        if not 0 <= self.coefficient_sd_per_kelvin <= 1:
            raise ValueError("coefficient_sd_per_kelvin must lie between 0 and 1")
        for name in ("baseline_celsius", "measured_celsius"):
            if not -273.15 <= getattr(self, name) <= 1000:
                raise ValueError(f"{name} must lie between -273.15 and 1000")

    @property
    def difference_kelvin(self) -> float:
        """T − T_b."""
        return self.measured_celsius - self.baseline_celsius

    @property
    def logarithm(self) -> float:
        """ln(r(T)/r(T_b)) = α (T − T_b)."""
        return self.coefficient_per_kelvin * self.difference_kelvin


@dataclass(frozen=True)
class Systematic:
    """How far off all readings may be together; widens error bars and changes no estimate.

    Parameters
    ----------
    reference_tolerance : the reference resistor, or all loads or feedback resistors together, are off by up to this
        fraction.
    channel_spread_ohm : standard deviation of the resistance of each line's channel, in ohm.
    series_ohm : of what stands in series with all driven lines alike, beside what the scene tells, in ohm.
    inl_lsb : of the converter's curve about a straight line, a smooth one, in least significant bits.
    wire_ohm_per_cell : of the wire of rows and columns from cell to cell, beside what the scene tells, in ohm.
    reading_error : of the logarithm of a factor on each reading, the same in all frames.
    response_sd : of a factor on each cell's answer to pressure, in the logarithm of its resistance (bent film, patches
        that differ); widens pressures alone.

    None: absent. Raises ValueError where a number is out of range.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
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
        for name in (
            "channel_spread_ohm",
            "series_ohm",
            "inl_lsb",
            "wire_ohm_per_cell",
            "reading_error",
            "response_sd",
        ):
            value = getattr(self, name)
            most = MOST_OFF.get(name, MOST_OHM)
            if value is not None and not 0 <= value <= most:
                raise ValueError(f"{name} must be zero or positive, and finite: at most {most:g}")


@dataclass(frozen=True)
class SeriesPerLine:
    """What stands in series with every line: with a reading of row j and column k, rows[j] + columns[k].

    rows, columns : ohm, one number for each line, or one for all of a side. Raises ValueError where one is negative.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    rows: PerLine
    columns: PerLine

    def __post_init__(self) -> None:
        check_resistors("rows", self.rows, open_end=False)
        check_resistors("columns", self.columns, open_end=False)

    def ohm(self, panel: Panel) -> Array:
        """(rows, columns) ohm. Raises ValueError where a list has another length."""
        row = per_line("series_resistance_ohm.rows", self.rows, panel.rows)
        return np.asarray(row[:, None] + per_line("series_resistance_ohm.columns", self.columns, panel.columns))


@dataclass(frozen=True)
class MeasuredSubject:
    """Who touched the panel.

    Parameters
    ----------
    id : its name in the laboratory. species : its Latin name. length_mm : of the body. mass_g : of the body.
    note : what else there is to say.

    Empty or None: not told. Raises ValueError where a number is not positive.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    id: str = ""
    species: str = ""
    length_mm: float | None = None
    mass_g: float | None = None
    note: str = ""

    def __post_init__(self) -> None:
        for name in ("length_mm", "mass_g"):
            value = getattr(self, name)
            if value is not None and not 0 < value < float("inf"):
                raise ValueError(f"{name} must be positive and finite")


@dataclass(frozen=True)
class Experiment:
    """What it was measured for.

    Parameters
    ----------
    title : in a few words. experimenter : who did it. institution : where. water_temperature_celsius : of the water
        around the panel; what warmth does to the film is another key, `temperature`. note : what else there is to say.

    Empty or None: not told. Raises ValueError where the water is no water.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    title: str = ""
    experimenter: str = ""
    institution: str = ""
    water_temperature_celsius: float | None = None
    note: str = ""

    def __post_init__(self) -> None:
        celsius = self.water_temperature_celsius
        if celsius is not None and not -5 <= celsius <= 100:
            raise ValueError("water_temperature_celsius must lie between -5 and 100")


@dataclass(frozen=True)
class Scene:
    """The panel, how it is read, and what stands between the two.

    Parameters
    ----------
    panel : rows, columns and pitch.
    readout : the electronics; None where only resistances are known, and then their σ is unknown too.
    series_resistance_ohm : resistance in series with every two-point resistance (two multiplexer channels) in ohm; a
        number for all, or one for each line.
    faults : what is known to be broken, or None.
    water : how deep the panel stands under water; None: in air, or not known.
    temperature : of the film, and what it does to its resistance; None: the same throughout, or not known.
    systematic : how far off all readings may be together; 'none': not at all; None: not said, then as electronics of
        the readout's kind usually are, see `lampest.panel.systematic`.
    lines : the resistance of rows and columns themselves; None: none.
    converter_memory : the fraction of the channel converted before that is left in a reading, in volt at the converter;
        see `lampest.panel.memory`. None: nothing.
    contacts : resistance between the lines and their terminals, estimated beside the cells; None: none.
    film : what the film does beside its response curve: hysteresis, creep, bending; None: nothing.
    response : the film's own curve and its cells' gains, see `lampest.panel.response`; None: there are no
        pressures.
    subject, experiment : who was measured and for what; None: not told. No estimate depends on them.

    Raises ValueError where a number is out of range.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    panel: Panel
    readout: AnyReadout | None = None
    series_resistance_ohm: float | SeriesPerLine = 0.0
    faults: Faults | None = None
    water: Water | None = None
    temperature: Temperature | None = None
    systematic: Systematic | Literal["none"] | None = None
    lines: Lines | None = None
    converter_memory: float | None = None
    contacts: Contacts | None = None
    film: Film | None = None
    response: AnyResponse | None = None
    subject: MeasuredSubject | None = None
    experiment: Experiment | None = None

    def __post_init__(self) -> None:
        if isinstance(self.series_resistance_ohm, SeriesPerLine):
            self.series_resistance_ohm.ohm(self.panel)
        else:
            check_resistors("series_resistance_ohm", self.series_resistance_ohm, open_end=False)
        if self.converter_memory is not None and not 0 <= self.converter_memory < 1:
            raise ValueError("converter_memory must be zero or positive, and below 1")
        if self.faults is not None:
            self.faults.check(self.panel)
        if self.response is not None:
            self.response.check(self.panel.shape)
        if self.contacts is not None:
            self.contacts.mean(self.panel.shape), self.contacts.deviation(self.panel.shape)
        self.circuit.check(self)

    @property
    def circuit(self) -> Readout:
        """How readings follow from cells: the readout's circuit, or two-point resistances where it names none."""
        return TwoPointReadout() if self.readout is None else self.readout

    @property
    def series_ohm(self) -> Array:
        """What stands in series with every reading, ohm; to be broadcast to (rows, columns)."""
        series = self.series_resistance_ohm
        return series.ohm(self.panel) if isinstance(series, SeriesPerLine) else np.array(series)

    @property
    def series_text(self) -> str:
        """'140 ohm', or the ranges of rows and of columns."""
        series = self.series_resistance_ohm
        if not isinstance(series, SeriesPerLine):
            return lines_text(series)
        return f"rows {lines_text(series.rows)}, columns {lines_text(series.columns)}"

    def with_series(self, ohm: float) -> "Scene":
        """The same with a resistance in series with the panel, which all lines are driven through.

        Itself where the readout's kind has none; see `Readout.series_name`.
        """
        name = self.circuit.series_name
        if self.circuit.in_series:
            return replace(self, series_resistance_ohm=ohm)
        changes: dict[str, Any] = {name: ohm}
        return replace(self, readout=replace(self.circuit, **changes)) if name else self  # type: ignore[arg-type]

    @property
    def told_in_series(self) -> float:
        """What the scene says of it, ohm; the mean where lines differ."""
        name = self.circuit.series_name
        if self.circuit.in_series:
            return float(np.mean(self.series_ohm))
        return float(np.mean(as_tuple(getattr(self.circuit, name)))) if name else 0.0

    @property
    def told_systematic(self) -> Systematic | None:
        """What the scene itself says of such errors; None where it says nothing, or that there are none."""
        return None if self.systematic == "none" else self.systematic

    @cached_property
    def wiring(self) -> Wiring | None:
        """What lies between terminals and cells; None where there is nothing."""
        joined = () if self.faults is None else self.faults.joined(self.panel)
        lines = self.lines or Lines()
        wired = joined or lines.resist or self.contacts is not None
        return Wiring(lines, joined, self.contacts) if wired else None


def scene_text(scene: Scene) -> str:
    """The scene as files hold it, YAML; warns where its readout is of a kind that nobody who reads the file knows."""
    if scene.readout is not None and type(scene.readout) not in members_of(AnyReadout):
        kind = getattr(scene.readout, "kind", type(scene.readout).__name__)
        warnings.warn(
            f"readout.kind {kind} is not among the readouts of lampest or of an installed package: this file can be "
            "read again once it is (docs/howto/adding.md)",
            stacklevel=2,
        )
    return to_yaml(scene)
