"""Scene of a measurement: panel, circuit and effects. Effects that a scene does not specify are not modelled."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from lampest.files.document import read_document, to_yaml, validated
from lampest.files.typed import Configuration, check_positive_fields, check_range, check_ranges, members_of, typed
from lampest.panel.panel import Array, Modules, Panel, connected_parts
from lampest.panel.readouts import AnyReadout, Readout, TwoPointReadout
from lampest.panel.readouts.lines import MAX_OHM, PerLine, as_tuple, check_resistors, lines_text, per_line
from lampest.panel.readouts.wiring import Contacts, Lines, Wiring
from lampest.panel.response import AnyResponse, Film

ESTIMATED: Final = "estimated"  # in place of a number: the recording determines it
Size = float | Literal["estimated"]


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

    Each is a number, or `estimated`: the recording determines it once, beginning with the size of common electronics.

    Attributes
    ----------
    reference_tolerance : float or 'estimated', or None
        Largest relative error of the reference resistor, or of all loads or feedback resistors together.
    channel_spread_ohm : float or 'estimated', or None
        Standard deviation of the resistance of each line's channel, in ohm.
    series_tolerance_ohm : float or 'estimated', or None
        Standard deviation of a resistance in series with all driven lines, in addition to the scene's, in ohm.
    inl_lsb : float or 'estimated', or None
        Standard deviation of the converter's smooth deviation from a straight line, in least significant bits.
    wire_ohm_per_cell : float or 'estimated', or None
        Standard deviation of the wire of rows and columns from cell to cell, in addition to the scene's, in ohm.
    reading_error : float or 'estimated', or None
        Standard deviation of the logarithm of a factor on each reading, the same in all frames.
    response_sd : float, or None
        Relative standard deviation of each cell's response to pressure, in the logarithm of its resistance (bent film,
        differing patches); it widens pressures only.
    model_error : float or 'estimated', or None
        Standard deviation of the readings' errors of the model, in units of their noise σ, so that σ grows by
        √(1 + model_error²). 0: none. None: from evidence that no penalty can imitate; 'estimated': from the residuals
        of loaded frames, too. See `lampest.estimate.model_error`.

    >>> lampest.Systematic(reference_tolerance=0.01).reference_tolerance
    0.01
    """

    reference_tolerance: Size = 0.0
    channel_spread_ohm: Size = 0.0
    series_tolerance_ohm: Size | None = None
    inl_lsb: Size | None = None
    wire_ohm_per_cell: Size | None = None
    reading_error: Size | None = None
    response_sd: float | None = None
    model_error: Size | None = None

    def __post_init__(self) -> None:
        if not 0 <= (plain_size(self.reference_tolerance) or 0.0) < 1:
            raise ValueError("reference_tolerance must be zero or positive, and below 1")
        check_sizes(self, MAX_OHM, "channel_spread_ohm", "series_tolerance_ohm", "wire_ohm_per_cell")
        check_sizes(self, 2.0**32, "inl_lsb")
        check_sizes(self, 10, "reading_error", "response_sd")
        check_sizes(self, 1e6, "model_error")


def plain_size(size: Size | None) -> float | None:
    """Return a size that is a number; None where it is absent or `estimated`."""
    return None if isinstance(size, str) else size


def check_sizes(owner: Any, most: float, *names: str) -> None:
    """Raise ValueError unless each named field of an object is None, 'estimated', or lies between 0 and `most`."""
    check_ranges(owner, 0, most, *(name for name in names if getattr(owner, name) != ESTIMATED))


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
        layout = panel.modules
        lines = self.dead_rows or self.dead_columns or self.joined_rows or self.joined_columns
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

    def of_module(self, layout: Modules, number: int, module_faults: "Faults | None") -> "Faults | None":
        """Return the faults of one module by its own rows and columns, including those in `own`; None without any."""
        rows, columns = layout.cells(number)
        module_faults = module_faults or Faults()

        def inside(cells: tuple[tuple[int, int], ...]) -> list[tuple[int, int]]:
            moved = ((row - rows.start, column - columns.start) for row, column in cells)
            return [
                place for place in moved if 0 <= place[0] < layout.each.rows and 0 <= place[1] < layout.each.columns
            ]

        merged = replace(
            module_faults,
            open=(*module_faults.open, *inside(self.open)),
            shorted=(*module_faults.shorted, *inside(self.shorted)),
        )
        return None if merged == Faults() else merged


@dataclass(frozen=True)
class SeriesPerLine(Configuration):
    """Resistance in series with every line: rows[j] + columns[k] for the reading of row j and column k.

    Attributes
    ----------
    rows, columns : PerLine
        Resistances in ohm, one for each line, or one for all lines of a side.

    Raises ValueError if one is negative.

    >>> lampest.SeriesPerLine(rows=(70.0, 72.0), columns=(69.0, 71.0)).ohm(lampest.Panel(2, 2))
    array([[139., 141.],
           [141., 143.]])
    """

    rows: PerLine
    columns: PerLine

    def __post_init__(self) -> None:
        check_resistors("rows", self.rows, open_end=False)
        check_resistors("columns", self.columns, open_end=False)

    def ohm(self, panel: Panel) -> Array:
        """Return the resistance in series with every reading, (rows, columns) ohm.

        Raises ValueError if a list has another length.
        """
        row = per_line("series_resistance_ohm.rows", self.rows, panel.rows)
        return np.asarray(row[:, None] + per_line("series_resistance_ohm.columns", self.columns, panel.columns))


@dataclass(frozen=True)
class OwnOfModule(Configuration):
    """Deviations of one module from the scene; None: as in the scene.

    Attributes
    ----------
    at : tuple
        (row, column) of the module.
    readout : AnyReadout or None
        Readout of the scene's kind.
    series_resistance_ohm : float, SeriesPerLine or None
        See `Scene`.
    faults : Faults or None
        Faults by the module's own rows and columns, in addition to the scene's.
    """

    at: tuple[int, int]
    readout: AnyReadout | None = None
    series_resistance_ohm: float | SeriesPerLine | None = None
    faults: Faults | None = None


@dataclass(frozen=True)
class Scene(Configuration):
    """Panel, its readout, and the effects between the two.

    Attributes
    ----------
    panel : Panel
        Rows, columns and pitch.
    readout : AnyReadout, or None
        Electronics; None if only resistances are known, whose σ is then unknown.
    series_resistance_ohm : float or SeriesPerLine
        Resistance in series with every two-point resistance (two multiplexer channels) in ohm, for all or each line.
    faults : Faults, or None
        Known faults.
    water : Water, or None
        Depth of the panel under water; None: in air, or unknown.
    temperature : Temperature, or None
        Temperature of the film and its effect on resistance; None: constant, or unknown.
    systematic : Systematic or {'typical', 'none'}, or None
        Errors that all readings may share. 'typical': those of common electronics for the readout's kind, see
        `lampest.panel.systematic`. None, 'none': absent.
    lines : Lines, or None
        Resistance of rows and columns themselves; None: zero.
    converter_memory : float or 'estimated', or None
        Fraction of the previously converted channel that remains in a reading, in volt at the converter; see
        `lampest.panel.readouts.readout`. None: zero.
    contacts : Contacts or 'estimated', or None
        Resistance between the lines and their terminals, estimated together with the cells; 'estimated': single bad
        contacts, searched for once and taken off the readings; None: none.
    leaks : 'estimated', or None
        Leaks between neighbouring lines, searched for once and taken off the readings; None: none.
    gain : float or 'estimated', or None
        Relative standard deviation of each frame's gain; None: none.
    ripple : float or 'estimated', or None
        Standard deviation of the interference that the lines of a scan share, in least significant bits; None: none.
    motion : float or 'estimated', or None
        Share of the time between frames that a scan takes while loads move, 0 to 1; None: none.
    creep : float or 'estimated', or None
        Change of log r of all cells alike since the unloaded frames, which is no load; None: none.
    outliers : {'exclude', 'keep'}, or None
        Readings of a single frame that differ from its neighbours in time, and frozen ones. None: excluded.
    estimated : dict, or None
        Of resolved scenes: key of each number that the recording determined → (number, standard deviation).
    film : Film, or None
        Hysteresis, creep and bending of the film; None: absent.
    response : AnyResponse, or None
        Response curve of the film and gains of its cells, see `lampest.panel.response`; None: no pressures.
    assumed : tuple of str
        Entries that the scene's file leaves to lampest's defaults, such as readout.readings.
    baseline : {'raw', 'subtracted'}, or None
        'raw': readings are as converted, also where most are 0 at rest; 'subtracted': the firmware subtracted a resting
        frame, which an import adds again. None: raw, and refused at import where they look otherwise.
    purpose : {'mat'}, or None
        'mat': contacts of any form, no suction. None: also mouths and cups.
    subject, experiment : MeasuredSubject, or None
        Measured subject and purpose; None: unspecified. No estimate depends on them.
    modules : tuple of OwnOfModule, or None
        Deviations of single modules of a panel of modules.

    >>> lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0).series_text
    '140 ohm'
    """

    panel: Panel
    readout: AnyReadout | None = None
    series_resistance_ohm: float | SeriesPerLine = 0.0
    faults: Faults | None = None
    water: Water | None = None
    temperature: Temperature | None = None
    systematic: Systematic | Literal["typical", "none"] | None = None
    lines: Lines | None = None
    converter_memory: Size | None = None
    contacts: Contacts | Literal["estimated"] | None = None
    leaks: Literal["estimated"] | None = None
    gain: Size | None = None
    ripple: Size | None = None
    motion: Size | None = None
    creep: Size | None = None
    outliers: Literal["exclude", "keep"] | None = None
    film: Film | None = None
    response: AnyResponse | None = None
    baseline: Literal["raw", "subtracted"] | None = None
    purpose: Literal["mat"] | None = None
    subject: MeasuredSubject | None = None
    experiment: Experiment | None = None
    modules: tuple[OwnOfModule, ...] | None = None
    assumed: tuple[str, ...] = field(default=(), compare=False)
    estimated: dict[str, tuple[float, float]] | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        if self.faults is not None:
            self.faults.check(self.panel)
        if self.response is not None:
            self.response.check(self.panel.shape)
        self._check_modules()
        if self.panel.modules is not None:
            return
        if isinstance(self.series_resistance_ohm, SeriesPerLine):
            self.series_resistance_ohm.ohm(self.panel)
        else:
            check_resistors("series_resistance_ohm", self.series_resistance_ohm, open_end=False)
        if self.known_memory is not None and not 0 <= self.known_memory < 1:
            raise ValueError("converter_memory must be zero or positive, and below 1")
        check_sizes(self, 1.0, "gain", "motion")
        if (creep := plain_size(self.creep)) is not None:
            check_range("creep", creep, -1, 1)
        check_sizes(self, 2.0**32, "ripple")
        if (prior := self.contact_prior) is not None:
            prior.mean(self.panel.shape), prior.deviation(self.panel.shape)
        (self.readout or self.circuit).check(self)

    def _check_modules(self) -> None:
        """Raise ValueError if an entry of `modules` is not allowed, or does not fit its scene."""
        layout = self.panel.modules
        places = [module.at for module in self.modules or ()]
        for module in self.modules or ():
            where = list(module.at)
            if layout is None or not (0 <= module.at[0] < layout.rows and 0 <= module.at[1] < layout.columns):
                raise ValueError(f"modules: there is no module {where}")
            if places.count(module.at) > 1:
                raise ValueError(f"modules: module {where} is named twice")
            if module.readout is not None and type(module.readout) is not type(self.readout):
                raise ValueError(f"modules: module {where} has a readout of another kind than the scene")
        if layout is not None:
            assert self.of_modules  # every scene checks itself

    @cached_property
    def of_modules(self) -> tuple["Scene", ...]:
        """Scenes of all modules, by their numbers; equal ones are one object. The scene itself without modules."""
        layout = self.panel.modules
        known = dict[Scene, Scene]()
        if layout is None:
            return (self,)
        owns = {module.at: module for module in self.modules or ()}
        scenes = []
        for number in range(layout.count):
            module = owns.get(layout.place(number)) or OwnOfModule((0, 0))
            series = module.series_resistance_ohm
            cells = layout.cells(number)
            scene = replace(
                self,
                panel=self.panel.network,
                modules=None,
                readout=module.readout or self.readout,
                series_resistance_ohm=self.series_resistance_ohm if series is None else series,
                faults=(self.faults or Faults()).of_module(layout, number, module.faults),
                water=self.water and Water(self.water.top_row_depth_mm + self.panel.centres_mm()[1][cells[0].start]),
                response=self.response and self.response.of_cells(cells),
            )
            scenes.append(known.setdefault(scene, scene))
        return tuple(scenes)

    @cached_property
    def alike(self) -> tuple[tuple["Scene", tuple[int, ...]], ...]:
        """Pairs of a scene and the numbers of the modules that have it."""
        numbers: dict[Scene, list[int]] = {}
        for number, scene in enumerate(self.of_modules):
            numbers.setdefault(scene, []).append(number)
        return tuple((scene, tuple(members)) for scene, members in numbers.items())

    @property
    def dead_modules(self) -> tuple[int, ...]:
        """Numbers of the modules that are not read."""
        layout = self.panel.modules
        faults = self.faults or Faults()
        return () if layout is None else tuple(sorted({row * layout.columns + k for row, k in faults.dead_modules}))

    @cached_property
    def blind(self) -> NDArray[np.bool_]:
        """Whether faults leave no reading, boolean (rows, columns)."""
        return self._of_faults(Faults.blind)

    @cached_property
    def requested(self) -> NDArray[np.bool_]:
        """Whether a frame should have a reading, boolean (rows, columns); it may have more, without a cell."""
        return self.panel.present & ~self.blind

    @cached_property
    def open_cells(self) -> NDArray[np.bool_]:
        """Whether a crossing does not conduct, without a cell or open by a fault, boolean (rows, columns)."""
        return ~self.panel.present | self._of_faults(Faults.open_cells)

    @cached_property
    def shorted_cells(self) -> NDArray[np.bool_]:
        """Whether a cell shorts its lines, boolean (rows, columns)."""
        return self._of_faults(Faults.shorted_cells)

    @cached_property
    def broken(self) -> NDArray[np.bool_]:
        """Whether a crossing has no cell to be estimated, boolean (rows, columns)."""
        return self.open_cells | self.shorted_cells

    @property
    def whole(self) -> bool:
        """Whether every crossing has an intact cell."""
        return self.faults is None and self.panel.cells is None

    def _of_faults(self, mask: Callable[[Faults, Panel], NDArray[np.bool_]]) -> NDArray[np.bool_]:
        """Return a mask of the faults, (rows, columns); true for all cells of dead modules."""
        layout = self.panel.modules
        if layout is None:
            return np.zeros(self.panel.shape, dtype=bool) if self.faults is None else mask(self.faults, self.panel)
        parts = np.stack([scene._of_faults(mask) for scene in self.of_modules])
        parts[list(self.dead_modules)] = True
        return layout.joined(parts)

    @property
    def assumed_text(self) -> str:
        """Entries that the scene's file leaves open, with their values, such as 'readings: 20, adc_bits: 10'."""
        places = (path.partition(".") for path in self.assumed)
        named = ((name, getattr(getattr(self, room, None), name, None)) for room, _, name in places)
        texts = ((name, f"{value:g}" if isinstance(value, float) else value) for name, value in named)
        return ", ".join(f"{name}: {text}" for name, text in texts if text is not None)

    @cached_property
    def circuit(self) -> Readout:
        """Circuit by which readings follow from cells: the readout, or two-point resistances without one."""
        return TwoPointReadout() if self.readout is None else self.readout.in_scene(self)

    @property
    def series_ohm(self) -> Array:
        """Resistance in series with every reading in ohm, to be broadcast to (rows, columns)."""
        series = self.series_resistance_ohm
        return series.ohm(self.panel) if isinstance(series, SeriesPerLine) else np.array(series)

    @property
    def series_lines(self) -> tuple[Array, Array]:
        """Resistance in series with each row and with each column, ohm; half of a number that is for both channels."""
        rows, columns = self.panel.network.shape
        series = self.series_resistance_ohm
        if not isinstance(series, SeriesPerLine):
            return np.full(rows, series / 2), np.full(columns, series / 2)
        row, column = (f"series_resistance_ohm.{side}" for side in ("rows", "columns"))
        return per_line(row, series.rows, rows), per_line(column, series.columns, columns)

    @property
    def series_text(self) -> str:
        """Series resistance in words: '140 ohm', or the ranges of rows and of columns."""
        series = self.series_resistance_ohm
        if not isinstance(series, SeriesPerLine):
            return lines_text(series)
        return f"rows {lines_text(series.rows)}, columns {lines_text(series.columns)}"

    def with_series(self, ohm: float) -> "Scene":
        """Return the scene with a resistance in ohm in series with all driven lines.

        Returns the scene itself if the readout's kind has none; see `Readout.series_name`.
        """
        changes: dict[str, Any] = {self.circuit.series_name: ohm}
        if self.circuit.in_series:
            return replace(self, **changes)
        circuit = self.circuit
        return replace(self, readout=replace(circuit, **changes)) if circuit.series_name else self  # type: ignore[arg-type]

    @property
    def specified_in_series(self) -> float:
        """Specified resistance in series in ohm; the mean if lines differ."""
        if self.circuit.in_series:
            return float(np.mean(self.series_ohm))
        return float(np.mean(as_tuple(getattr(self.circuit, self.circuit.series_name, 0.0))))

    @property
    def known_memory(self) -> float | None:
        """`converter_memory` if it is a number; None otherwise."""
        return plain_size(self.converter_memory)

    @property
    def common_change(self) -> tuple[float, float]:
        """Change of log r of all cells since the unloaded frames, by temperature and creep, and its deviation."""
        warmth, (creep, creep_sd) = self.temperature, (self.estimated or {}).get("creep", (0.0, 0.0))
        creep = creep if (known := plain_size(self.creep)) is None else known
        if warmth is None:
            return creep, creep_sd
        warming_sd = warmth.difference_kelvin * warmth.coefficient_sd_per_kelvin
        return creep + warmth.logarithm, float(np.hypot(creep_sd, warming_sd))

    @property
    def contact_prior(self) -> Contacts | None:
        """Prior of the contacts that are estimated together with the cells; None without one."""
        return self.contacts if isinstance(self.contacts, Contacts) else None

    @cached_property
    def parts(self) -> NDArray[np.intp] | None:
        """Number of the connected part of each line, (lines,); None if cells connect all lines."""
        if self.whole:
            return None
        return connected_parts(~self.open_cells)

    @cached_property
    def wiring(self) -> Wiring | None:
        """Wire, contacts and touching lines between terminals and cells; None without any of them."""
        joined = () if self.faults is None else self.faults.joined(self.panel)
        lines = self.lines or Lines()
        wired = joined or lines.resist or self.contact_prior is not None
        return Wiring(lines, joined, self.contact_prior) if wired else None


CHECKED_DEFAULTS = {"polarity"}  # frames tell them: the check of the circuit names the other one where it fits better


@typed
def read_scene(path: str | Path, assigned: tuple[str, ...] = ()) -> Scene:
    """Return the scene of a YAML file, which is the whole file or its entry `scene`.

    `assigned` overrides entries by texts PATH=VALUE, such as readout.noise_lsb=1.2. Raises InputError with line and
    column.

    >>> _ = Path("scene.yaml").write_text("panel: {rows: 2, columns: 3}")
    >>> lampest.read_scene("scene.yaml").panel.shape
    (2, 3)
    """
    document = read_document(Path(path), assigned)
    if isinstance(document.content, dict) and "scene" in document.content:
        document = replace(document, content=document.content["scene"], marks=document.marks["scene"])
    scene: Scene = validated(document, Scene)
    parts: dict[str, Any] = {"panel": scene.panel} | ({} if scene.readout is None else {"readout": scene.readout})
    specified = {name: {"kind", *document.content[name]} for name in parts}
    if scene.panel.modules is not None:  # rows, columns and pitch follow from the modules
        specified["panel"] |= {"rows", "columns", *document.content["panel"]["modules"]["each"]}
    left_open = tuple(
        f"{name}.{entry.name}"
        for name, part in parts.items()
        for entry in fields(part)
        if entry.name not in specified[name] | CHECKED_DEFAULTS and getattr(part, entry.name)
    )
    return replace(scene, assumed=scene.assumed or left_open)


def scene_text(scene: Scene) -> str:
    """Return the scene as YAML; warns if the kind of its readout belongs to no installed package."""
    if scene.readout is not None and type(scene.readout) not in members_of(AnyReadout):
        kind = getattr(scene.readout, "kind", type(scene.readout).__name__)
        warnings.warn(
            f"readout.kind {kind} is not among the readouts of lampest or of an installed package: this file can be "
            "read again once it is (docs/howto/adding.md)",
            stacklevel=2,
        )
    return to_yaml(scene)
