"""Scene of a measurement: panel, circuit and effects.

Effects that a scene does not specify are not modelled. Scenes are read from YAML files, with the
entries that a file leaves to the defaults, and written to them.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lampest.files.applications import applications, loaded
from lampest.files.document import INLINE, Document, read_document, to_yaml, validated
from lampest.files.typed import Configuration, members_of, typed
from lampest.panel.conditions import Experiment, MeasuredSubject, Temperature, Water
from lampest.panel.faults import Faults
from lampest.panel.lines import (
    SeriesPerLine,
    as_tuple,
    check_resistors,
    lines_text,
)
from lampest.panel.panel import Array, Mask, Numbers, Panel
from lampest.panel.readouts import AnyReadout, Readout, TwoPointReadout
from lampest.panel.readouts.converter import range_assumed
from lampest.panel.readouts.wiring import Contacts, Lines, NeighbourLeaks, Wiring, connected_parts
from lampest.panel.response import AnyResponse, Film
from lampest.panel.sizes import (
    ESTIMATED,
    LINE_EFFECTS,
    Size,
    Systematic,
    check_sizes,
    plain_size,
)

CHOSEN_RANGE = "readout.converter.full_volt"  # of a chip with several ranges
OF_APPLICATIONS = {"film": "film", "purpose": "recognition"}  # keys that only applications read
# Frames tell them: the check of the circuit names the other one where it fits better.
CHECKED_DEFAULTS = {"polarity"}


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
        Resistance in series with every two-point resistance (two multiplexer channels) in ohm, for
        all or each line.
    faults : Faults, or None
        Known faults.
    water : Water, or None
        Depth of the panel under water; None: in air, or unknown.
    temperature : Temperature, or None
        Temperature of the film and its effect on resistance; None: constant, or unknown.
    systematic : Systematic or {'typical', 'none'}, or None
        Errors that all readings may share. 'typical': those of common electronics for the readout's
        kind, see `lampest.panel.effects`. None, 'none': absent.
    lines : Lines, or None
        Resistance of rows and columns themselves; None: zero.
    leak_ohm : NeighbourLeaks or None
        Constant resistances between neighbouring lines, as one sheet of film under all strips has
        them; None: none.
    converter_memory : float or 'estimated', or None
        Fraction of the previously converted channel that remains in a reading, in volt at the
        converter; see `lampest.panel.readouts.readout`. None: zero.
    contacts : Contacts or 'estimated', or None
        Resistance between the lines and their terminals, estimated together with the cells;
        'estimated': single bad contacts, searched for once and taken off the readings; None: none.
    leaks : 'estimated', or None
        Leaks between neighbouring lines, searched for once and taken off the readings; None: none.
    ground_ohm : float or 'estimated', or None
        Resistance to ground that all idle driven lines share; it is taken off the readings. None:
        none.
    gain : float or 'estimated', or None
        Relative standard deviation of each frame's gain; None: none.
    ripple : float or 'estimated', or None
        Standard deviation of the interference that the lines of a scan share, in least significant
        bits; None: none.
    motion : float or 'estimated', or None
        Share of the time between frames that a scan takes while loads move, 0 to 1. Frames tell
        how much loads jitter within a scan. None: none.
    creep : float or 'estimated', or None
        Change of log r of all cells alike since the unloaded frames, which is no load; None: none.
    outliers : {'keep', 'exclude', 'robust'}, or None
        Readings that differ from their neighbours in time while their row and column do not. None:
        kept. 'robust': kept, and squared misfits have Student's loss
        (`Estimator.for_outliers`). What no cells give is missing in any case.
    estimated : dict, or None
        Of resolved scenes: key of each number that the recording determined → (number, standard
        deviation).
    film : Film, or None
        Hysteresis, creep and bending of the film; None: absent.
    response : AnyResponse, or None
        Response curve of the film and gains of its cells, see `lampest.panel.response`; None: no
        pressures.
    assumed : tuple of str
        Entries that the scene's file leaves to lampest's defaults, such as readout.readings.
    baseline : {'raw', 'subtracted'}, or None
        'raw': readings are as converted, also where most are 0 at rest; 'subtracted': the firmware
        subtracted a resting frame, which an import adds again. None: raw, and refused at import
        where they look otherwise.
    purpose : {'mat'}, or None
        'mat': contacts of any form, no suction. None: also mouths and cups.
    subject, experiment : MeasuredSubject, or None
        Measured subject and purpose; None: unspecified. No estimate depends on them.
    modules : tuple of OwnOfModule, or None
        Deviations of single modules of a panel of modules.
    own_keys : tuple of (str, object)
        Keys that installed applications add, see `lampest.files.applications.Application`.

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
    leak_ohm: NeighbourLeaks | None = None
    converter_memory: Size | None = None
    contacts: Contacts | Literal["estimated"] | None = None
    leaks: Literal["estimated"] | None = None
    ground_ohm: Size | None = None
    gain: Size | None = None
    ripple: Size | None = None
    motion: Size | None = None
    creep: Size | None = None
    outliers: Literal["exclude", "keep", "robust"] | None = None
    film: Film | None = None
    response: AnyResponse | None = None
    baseline: Literal["raw", "subtracted"] | None = None
    purpose: Literal["mat"] | None = None
    subject: MeasuredSubject | None = None
    experiment: Experiment | None = None
    modules: tuple[OwnOfModule, ...] | None = None
    assumed: tuple[str, ...] = field(default=(), compare=False)
    estimated: dict[str, tuple[float, float]] | None = field(default=None, compare=False)
    own_keys: tuple[tuple[str, Any], ...] = field(default=(), metadata={INLINE: True})

    def __post_init__(self) -> None:
        for key, application in OF_APPLICATIONS.items():
            if getattr(self, key) is not None:
                applications().require(application, key)
        for own_key, setting in self.own_keys:
            target = applications().scene_keys.get(own_key)
            if target is None:
                raise ValueError(f"{own_key}: no installed application has this key")
            if not isinstance(setting, loaded(target)):
                raise ValueError(f"{own_key}: an object of {target} is needed")
        if self.faults is not None:
            self.faults.check(self.panel)
        if self.response is not None:
            self.response.check(self.panel.shape)
        places = [module.at for module in self.modules or ()]
        for module in self.modules or ():
            where = list(module.at)
            if not self.panel.has_module(module.at):
                raise ValueError(f"modules: there is no module {where}")
            if places.count(module.at) > 1:
                raise ValueError(f"modules: module {where} is named twice")
            if module.readout is not None and type(module.readout) is not type(self.readout):
                raise ValueError(
                    f"modules: module {where} has a readout of another kind than the scene"
                )
        assert self.of_modules  # every scene checks itself
        if self.panel.modules is not None:
            return
        if isinstance(self.series_resistance_ohm, SeriesPerLine):
            self.series_resistance_ohm.ohm(self.panel)
        else:
            check_resistors("series_resistance_ohm", self.series_resistance_ohm, open_end=False)
        if self.known_memory is not None and not 0 <= self.known_memory < 1:
            raise ValueError("converter_memory must be zero or positive, and below 1")
        check_sizes(self, "converter_memory", "ground_ohm", "gain", "ripple", "motion", "creep")
        for key in ("leaks", "contacts"):
            if getattr(self, key) == ESTIMATED and not any(e.key == key for e in LINE_EFFECTS):
                raise ValueError(f"{key}: no installed effect has this key")
        if self.contact_prior is not None:
            # Lists of the wrong length raise.
            self.contact_prior.mean(self.panel.shape)
            self.contact_prior.deviation(self.panel.shape)
        if self.leak_ohm is not None:
            self.leak_ohm.check(self.panel.shape)
        (self.readout or self.circuit).check(self)

    def own(self, key: str) -> Any:
        """Return the object that a scene has under the key of an application; None without it."""
        return dict(self.own_keys).get(key)

    @cached_property
    def of_modules(self) -> tuple["Scene", ...]:
        """Scenes of all modules, by their numbers; equal ones are one object.

        The scene itself without modules.
        """
        layout = self.panel.modules
        if layout is None:
            return (self,)
        owns = {module.at: module for module in self.modules or ()}
        distinct = dict[Scene, Scene]()
        scenes = []
        for number in range(layout.count):
            own = owns.get(layout.place(number)) or OwnOfModule((0, 0))
            cells = layout.cells(number)
            series = own.series_resistance_ohm
            water = self.water
            if water is not None:
                _, row_centres = self.panel.centres_mm()
                water = Water(water.top_row_depth_mm + row_centres[cells[0].start])
            scene = replace(
                self,
                panel=self.panel.network,
                modules=None,
                readout=own.readout or self.readout,
                series_resistance_ohm=self.series_resistance_ohm if series is None else series,
                faults=(self.faults or Faults()).of_module(layout, number, own.faults),
                water=water,
                response=None if self.response is None else self.response.of_cells(cells),
            )
            scenes.append(distinct.setdefault(scene, scene))
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
        places = () if self.faults is None else self.faults.dead_modules
        return tuple(sorted({row * self.panel.layout.columns + column for row, column in places}))

    @cached_property
    def blind(self) -> Mask:
        """Whether faults leave no reading, boolean (rows, columns)."""
        return self._of_faults(Faults.blind)

    @cached_property
    def requested(self) -> Mask:
        """Whether a frame should have a reading, boolean (rows, columns).

        A frame may have further readings, of places without a cell.
        """
        return self.panel.present & ~self.blind

    @cached_property
    def open_cells(self) -> Mask:
        """Whether a crossing does not conduct, boolean (rows, columns).

        Such crossings have no cell, or a cell that is open by a fault.
        """
        return ~self.panel.present | self._of_faults(Faults.open_cells)

    @cached_property
    def shorted_cells(self) -> Mask:
        """Whether a cell shorts its lines, boolean (rows, columns)."""
        return self._of_faults(Faults.shorted_cells)

    @cached_property
    def broken(self) -> Mask:
        """Whether a crossing has no cell to be estimated, boolean (rows, columns)."""
        return self.open_cells | self.shorted_cells

    @property
    def whole(self) -> bool:
        """Whether every crossing has an intact cell."""
        return self.faults is None and self.panel.cells is None

    def _of_faults(self, mask: Callable[[Faults, Panel], Mask]) -> Mask:
        """Return a mask of the faults, (rows, columns); true for all cells of dead modules."""
        parts = np.stack([mask(scene.faults or Faults(), scene.panel) for scene in self.of_modules])
        parts[list(self.dead_modules)] = True
        return self.panel.layout.joined(parts)

    @property
    def assumed_text(self) -> str:
        """Entries that the scene's file leaves open, with their values.

        The text is such as 'readings: 20, adc_bits: 10'.
        """
        texts = []
        for path in self.assumed:
            part, _, name = path.partition(".")
            value = getattr(getattr(self, part, None), name, None)
            if path == CHOSEN_RANGE and self.readout is not None:
                value = self.readout.characteristic.full_volt
            if value is not None:
                text = f"{value:g}" if isinstance(value, float) else value
                texts.append(f"{name}: {text}")
        return ", ".join(texts)

    @cached_property
    def yaml(self) -> str:
        """Scene as YAML, made once for all results of a recording."""
        return to_yaml(self)

    @cached_property
    def circuit(self) -> Readout:
        """Circuit by which readings follow from cells.

        A scene without a readout has two-point resistances.
        """
        return TwoPointReadout() if self.readout is None else self.readout.in_scene(self)

    @property
    def series_ohm(self) -> Array:
        """Resistance in series with every reading in ohm, to be broadcast to (rows, columns)."""
        series = self.series_resistance_ohm
        return series.ohm(self.panel) if isinstance(series, SeriesPerLine) else np.array(series)

    @property
    def series_lines(self) -> tuple[Array, Array]:
        """Resistance in series with each row and with each column, half each of a common number.

        Returns
        -------
        rows, columns : arrays, shapes (rows,) and (columns,)
            In ohm.
        """
        panel = self.panel.network
        series = self.series_resistance_ohm
        if isinstance(series, SeriesPerLine):
            return series.of_lines(panel)
        return np.full(panel.rows, series / 2), np.full(panel.columns, series / 2)

    @property
    def series_text(self) -> str:
        """Series resistance in words: '140 ohm', or the ranges of rows and of columns."""
        series = self.series_resistance_ohm
        if not isinstance(series, SeriesPerLine):
            return lines_text(series)
        return f"rows {lines_text(series.rows)}, columns {lines_text(series.columns)}"

    @property
    def series_name(self) -> str:
        """Key of a resistance in series with the panel, of the scene or of its readout.

        '' if the readout's kind has none.
        """
        return "series_resistance_ohm" if self.circuit.unit == "ohm" else self.circuit.channels[0]

    def with_series(self, ohm: float) -> "Scene":
        """Return the scene with a resistance in ohm in series with all driven lines.

        Returns the scene itself if the readout's kind has none; see `series_name`.
        """
        if not self.series_name:
            return self
        changes: dict[str, Any] = {self.series_name: ohm}
        if self.circuit.unit != "ohm":
            changes = {"readout": replace(self.circuit, **changes)}
        return replace(self, **changes)

    @property
    def specified_in_series(self) -> float:
        """Specified resistance in series in ohm; the mean if lines differ."""
        if self.circuit.unit == "ohm":
            return float(np.mean(self.series_ohm))
        return float(np.mean(as_tuple(getattr(self.circuit, self.series_name, 0.0))))

    @property
    def known_memory(self) -> float | None:
        """`converter_memory` if it is a number; None otherwise."""
        return None if isinstance(self.converter_memory, str) else self.converter_memory

    @property
    def common_change(self) -> tuple[float, float]:
        """Change of log r of all cells since the unloaded frames, by temperature and creep.

        Returns
        -------
        change, sd : float
            The change and its standard deviation.
        """
        warmth = self.temperature
        creep, creep_sd = (self.estimated or {}).get("creep", (0.0, 0.0))
        specified = plain_size(self.creep)
        if specified is not None:
            creep = specified
        if warmth is None:
            return creep, creep_sd
        warming_sd = warmth.difference_kelvin * warmth.coefficient_sd_per_kelvin
        return creep + warmth.logarithm, float(np.hypot(creep_sd, warming_sd))

    @property
    def contact_prior(self) -> Contacts | None:
        """Prior of the contacts that are estimated together with the cells; None without one."""
        return self.contacts if isinstance(self.contacts, Contacts) else None

    @cached_property
    def parts(self) -> Numbers | None:
        """Number of the connected part of each line, (lines,); None if cells connect all lines."""
        if self.whole:
            return None
        conducting = ~self.open_cells
        return connected_parts(
            conducting if self.wiring is None else self.wiring.connecting(conducting)
        )

    @cached_property
    def wiring(self) -> Wiring | None:
        """Wire, contacts and touching lines between terminals and cells, and leaks of lines.

        The value is None without any of them.
        """
        joined = () if self.faults is None else self.faults.joined(self.panel)
        wiring = Wiring(self.lines or Lines(), joined, self.contact_prior, self.leak_ohm)
        return None if wiring.at_terminals and wiring.leaks is None else wiring


def specified(scene: Scene, key: str) -> Any:
    """Return the entry of a scene at a dotted key; None where it is absent."""
    entry: Any = scene
    for part in key.split("."):
        if isinstance(entry, Systematic):
            entry = entry.entry(part)
        else:
            entry = None if isinstance(entry, str) else getattr(entry, part, None)
    return entry


def validated_scene(document: Document) -> Scene:
    """Return the scene of a document, with the keys that installed applications add.

    Raises InputError as `validated`.
    """
    document, own_keys = without_own_keys(document)
    scene: Scene = validated(document, Scene)
    return replace(scene, own_keys=own_keys) if own_keys else scene


def without_own_keys(document: Document) -> tuple[Document, tuple[tuple[str, Any], ...]]:
    """Return a scene's document without the keys of applications, and their objects.

    Raises InputError as `validated`.

    Returns
    -------
    document : Document
    own_keys : tuple of (str, object)
        See `Scene`.
    """
    content = document.content
    own = {entry.name for entry in fields(Scene)} - {"own_keys"}
    added = content.keys() - own if isinstance(content, dict) else set()
    if not added:
        return document, ()
    registered = applications().scene_keys
    objects: dict[str, Any] = {}
    for key in sorted(added & registered.keys()):
        part = replace(document, content={key: content[key]})
        objects |= validated(part, dict[str, loaded(registered[key])])  # type: ignore[misc]
    left = {key: value for key, value in content.items() if key not in objects}
    return replace(document, content=left), tuple(objects.items())


@typed
def read_scene(path: str | Path, assigned: tuple[str, ...] = ()) -> Scene:
    """Return the scene of a YAML file, which is the whole file or its entry `scene`.

    `assigned` overrides entries by texts PATH=VALUE, such as readout.noise_lsb=1.2. Raises
    InputError with line and column.

    >>> from pathlib import Path
    >>> _ = Path("scene.yaml").write_text("panel: {rows: 2, columns: 3}")
    >>> lampest.read_scene("scene.yaml").panel.shape
    (2, 3)
    """
    document = read_document(Path(path), assigned)
    if isinstance(document.content, dict) and "scene" in document.content:
        document = replace(
            document, content=document.content["scene"], marks=document.marks["scene"]
        )
    scene = validated_scene(document)
    stated = {"panel": {*document.content["panel"]}}
    if scene.panel.modules is not None:  # rows, columns and pitch follow from the modules
        stated["panel"] |= {"rows", "columns", *document.content["panel"]["modules"]["each"]}
    if scene.readout is not None:  # a named converter states its bits
        completed = scene.readout.completed(document.content["readout"])
        stated["readout"] = {"kind", *CHECKED_DEFAULTS, *completed}
    left_open = [
        f"{name}.{entry.name}"
        for name, specified in stated.items()
        for part in [getattr(scene, name)]
        for entry in fields(part)
        if entry.name not in specified and getattr(part, entry.name)
    ]
    if scene.readout is not None and range_assumed(scene.readout):
        left_open.append(CHOSEN_RANGE)
    return replace(scene, assumed=scene.assumed or tuple(left_open))


def scene_text(scene: Scene) -> str:
    """Return the scene as YAML.

    Warns if the kind of its readout belongs to no installed package.
    """
    if scene.readout is not None and type(scene.readout) not in members_of(AnyReadout):
        kind = getattr(scene.readout, "kind", type(scene.readout).__name__)
        warnings.warn(
            f"readout.kind {kind} is not among the readouts of lampest or of an installed package: "
            "this file can be read again once it is (docs/howto/adding.md)",
            stacklevel=2,
        )
    return scene.yaml
