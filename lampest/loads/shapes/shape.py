"""A shape: its pressure at a point for simulation, and its parameters with priors for recognition."""

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from lampest.files.typed import Configuration, check_positive_fields, check_range
from lampest.loads.shapes.disc import Disc
from lampest.panel.panel import Array, Panel

POINTS = 8  # along either edge of a patch; an edge of a footprint is then off by a sixteenth of it at most


class Prior(NamedTuple):
    """A parameter before anything is measured.

    Attributes
    ----------
    mean, sd : float
        Mean and standard deviation.
    step : float
        Longest step of Gauss-Newton.
    sway : float
        Standard deviation by which the whole load may swing in it.
    """

    mean: float
    sd: float
    step: float = 0.7
    sway: float = 0.0


class Template(NamedTuple):
    """A disc that is laid over a map of the cells, where a search begins; inner_mm is 0 where it is full.

    Attributes
    ----------
    inside : float
        Effect of the inside on ln r, 0 for none, 1 for as much as the rim the other way.
    faint : bool
        Whether it is looked for in the noise of a panel at rest too.
    """

    outer_mm: float
    inner_mm: float = 0.0
    inside: float = 0.0
    faint: bool = False


@dataclass(frozen=True, eq=False, kw_only=True)
class Candidate(ABC):
    """Candidate shape of recognition: parameters φ without bounds, their priors and the pressure they mean.

    Attributes
    ----------
    label : str
        Its name in tables, files and pictures.
    sucks : bool
        Whether it is attached, and not only touching.
    templates : tuple of Template
        Patterns that the search lays over the panel for it, starts of all kinds.
    """

    label: str
    sucks: bool = False
    templates: tuple[Template, ...] = ()

    @abstractmethod
    def priors(self, panel: Panel) -> Mapping[str, Prior]:
        """Independent Gaussian priors by the parameters' names, in the order of φ."""

    @abstractmethod
    def pressure(self, panel: Panel, patch_mm: float, parameters: Array) -> tuple[Array, Array]:
        """Mean pressure on every patch, (rows, columns) kPa, and its derivatives by φ (parameters, rows, columns)."""

    @abstractmethod
    def start(self, disc: Disc) -> Array:
        """φ where a fit begins that a disc suggests, (parameters)."""

    def disc(self, parameters: Array) -> Disc | None:
        """Return the disc that is most like it, from which other kinds may start; None: there is none."""
        return None

    def like(self, other: "Candidate", parameters: Array) -> Array | None:
        """φ where a fit begins that another kind's φ suggests, (parameters); None where that is like no disc."""
        disc = other.disc(parameters)
        return None if disc is None else self.start(disc)

    def loads(self, parameters: Array) -> list[tuple["Candidate", Array]]:
        """Return each of its loads with its own φ."""
        return [(self, parameters)]

    def report(self, parameters: Array) -> dict[str, tuple[float, Array]]:
        """Return value and slopes by φ of the quantities `x_mm`, `y_mm`, `diameter_mm` and `suction_kpa`, by name."""
        return {}

    def blind(self, parameters: Array) -> Array:
        """Return the standard deviation of φ that no reading reduces, (parameters): all patches may be off alike."""
        return np.zeros(len(parameters))

    def mean(self, panel: Panel) -> Array:
        return np.array([prior.mean for prior in self.priors(panel).values()])

    def sd(self, panel: Panel) -> Array:
        return np.array([prior.sd for prior in self.priors(panel).values()])


def centre_priors(panel: Panel) -> dict[str, Prior]:
    """x and y in mm of a centre that is uniform over the panel; half a pitch a step, and a sway of 1 mm."""
    pitch, extents = panel.pitch_mm, zip("xy", panel.extents_mm, strict=True)
    return {
        name: Prior((least + most) / 2, (most - least + pitch) / 12**0.5, pitch / 2, sway=1.0)
        for name, (least, most) in extents
    }


@dataclass(frozen=True, kw_only=True)
class Shape(Configuration):
    """A load somewhere on the panel, of any footprint.

    A subclass adds its numbers and `kind`, and has `reach_mm` and `pressure_at`; simulation needs no more. `candidate`
    is how recognition fits it, None: it is only simulated. `positive` names the numbers that must be above zero.

    centre_mm : (x, y) of the centre; cells lie at their places, of a full rectangle at x = k·pitch and y = j·pitch.
    tilt : relative change of the contact pressure from the centre to its reach, 0 to 1; the mean stays where the
        contact is symmetrical about the centre. tilt_direction_deg : where it is strongest; 0 towards higher columns,
        90 towards higher rows.

    >>> issubclass(lampest.Rod, lampest.Shape)
    True
    """

    candidate: ClassVar[Candidate | None] = None
    positive: ClassVar[tuple[str, ...]] = ()
    centre_mm: tuple[float, float]
    tilt: float = 0.0
    tilt_direction_deg: float = 0.0

    def __post_init__(self) -> None:
        check_positive_fields(self, *self.positive)
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, float | tuple) and not np.isfinite(value).all():
                raise ValueError(f"{field.name} must be finite")
        check_range("tilt", self.tilt, 0, 1)
        # Numbers that make no pressure together are refused now, and not where the shape is used.
        if not np.isfinite(self.pressure_at(np.zeros(1), np.zeros(1))).all():
            raise ValueError("the contact pressure must be finite")

    @property
    @abstractmethod
    def reach_mm(self) -> float:
        """The largest distance of the footprint from the centre in mm."""

    @abstractmethod
    def pressure_at(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Contact pressure ≥ 0 without tilt and suction ≤ 0, kPa, at points x, y mm from the centre; all one shape."""

    def mean_pressure(self, panel: Panel, patch_mm: float) -> tuple[Array, Array]:
        """Mean contact pressure and mean suction over square patches of edge `patch_mm`, both (rows, columns) kPa."""
        offset = ((np.arange(POINTS) + 0.5) / POINTS - 0.5) * patch_mm
        across, down = np.where(panel.present, panel.places_mm, 0.0)[:, :, None, :, None]
        blocks = (panel.rows, POINTS, panel.columns, POINTS)
        x = np.broadcast_to(across + offset - self.centre_mm[0], blocks)
        y = np.broadcast_to(down + offset[:, None, None] - self.centre_mm[1], blocks)
        contact, suction = self.pressure_at(x, y)
        direction = np.radians(self.tilt_direction_deg)
        tilting = 1 + self.tilt * (x * np.cos(direction) + y * np.sin(direction)) / self.reach_mm
        contact, suction = (panel.present * part.mean(axis=(1, 3)) for part in (contact * tilting, suction))
        return contact, suction
