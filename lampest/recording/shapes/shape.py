"""Base classes of shapes.

A shape gives the pressure at a point to simulations, and parameters with priors to recognition.
"""

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from lampest.files.typed import Configuration, check_positive_fields, check_range
from lampest.panel.panel import Array, Panel
from lampest.recording.shapes.disc import Disc

# Along either edge of a patch: the error of a footprint's edge is at most a sixteenth of the patch.
POINTS = 8


class Prior(NamedTuple):
    """Gaussian prior of a parameter.

    Attributes
    ----------
    mean, sd : float
        Mean and standard deviation.
    step : float
        Longest Gauss-Newton step.
    sway : float
        Standard deviation of periodic movements of the whole load in this parameter.
    """

    mean: float
    sd: float
    step: float = 0.7
    sway: float = 0.0


class Template(NamedTuple):
    """A disc that is compared with the map of the cells at all places, to find starts of fits.

    Attributes
    ----------
    outer_mm, inner_mm : float
        Diameters; `inner_mm` is 0 for a full disc.
    inside : float
        Effect of the inside on ln r: 0 for none, 1 for the opposite of the rim's.
    faint : bool
        Whether the template is also used to detect that something stands out of a panel at rest.
    """

    outer_mm: float
    inner_mm: float = 0.0
    inside: float = 0.0
    faint: bool = False


@dataclass(frozen=True, eq=False, kw_only=True)
class Candidate(ABC):
    """Candidate shape of recognition: unbounded parameters φ, their priors, and the pressure of φ.

    Attributes
    ----------
    label : str
        Name in tables, files and pictures.
    sucks : bool
        Whether the shape is attached by suction.
    templates : tuple of Template
        Templates of the search for starts of its fits.
    """

    label: str
    sucks: bool = False
    templates: tuple[Template, ...] = ()

    @abstractmethod
    def priors(self, panel: Panel) -> Mapping[str, Prior]:
        """Return the independent priors by the parameters' names, in the order of φ."""

    @abstractmethod
    def pressure(self, panel: Panel, patch_mm: float, parameters: Array) -> tuple[Array, Array]:
        """Return the mean pressure on every patch and its derivatives by φ.

        Returns
        -------
        pressure : array, shape (rows, columns)
            Mean pressure on the patches, kPa.
        slopes : array, shape (parameters, rows, columns)
            Derivatives of the pressure by φ, kPa.
        """

    @abstractmethod
    def start(self, disc: Disc) -> Array:
        """Return the start of a fit from a disc: φ, (parameters,)."""

    def disc(self, parameters: Array) -> Disc | None:
        """Return the most similar disc, from which fits of other kinds may start, or None."""
        return None

    def loads(self, parameters: Array) -> list[tuple["Candidate", Array]]:
        """Return every single load of the candidate with its own φ."""
        return [(self, parameters)]

    def report(self, parameters: Array) -> dict[str, tuple[float, Array]]:
        """Return reported quantities such as `x_mm`, by name, each with its derivatives by φ."""
        return {}

    def blind(self, parameters: Array) -> Array:
        """Return the standard deviation of φ that readings cannot reduce, (parameters,).

        The patches may share one error of this deviation.
        """
        return np.zeros(len(parameters))

    def mean(self, panel: Panel) -> Array:
        """Return the prior means of φ, (parameters,)."""
        return np.array([prior.mean for prior in self.priors(panel).values()])

    def sd(self, panel: Panel) -> Array:
        """Return the prior standard deviations of φ, (parameters,)."""
        return np.array([prior.sd for prior in self.priors(panel).values()])


def centre_priors(panel: Panel) -> dict[str, Prior]:
    """Return the priors of x and y of a centre, mm.

    The priors have the mean and variance of a uniform distribution over the panel, steps of half a
    pitch, and a sway of 1 mm.
    """
    pitch = panel.pitch_mm
    extents = zip("xy", panel.extents_mm, strict=True)
    return {
        name: Prior((least + most) / 2, (most - least + pitch) / 12**0.5, pitch / 2, sway=1.0)
        for name, (least, most) in extents
    }


@dataclass(frozen=True, kw_only=True)
class Shape(Configuration):
    """A load somewhere on the panel, of any footprint.

    A subclass adds its numbers and `kind`, and implements `reach_mm` and `pressure_at`, which
    suffice for simulation. `candidate` is the model that recognition fits, None for shapes that are
    only simulated. `positive` names the numbers that must be positive.

    Attributes
    ----------
    centre_mm : (float, float)
        x and y of the centre; cells lie at their places, of a full rectangle at x = k·pitch and
        y = j·pitch.
    tilt : float
        Relative change of the contact pressure from the centre to its reach, 0 to 1; the mean is
        unchanged where the contact is symmetric about the centre.
    tilt_direction_deg : float
        Direction of the highest pressure; 0 towards higher columns, 90 towards higher rows.

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
        # Inconsistent numbers are refused at construction, and not where the shape is used.
        if not np.isfinite(self.pressure_at(np.zeros(1), np.zeros(1))).all():
            raise ValueError("the contact pressure must be finite")

    @property
    @abstractmethod
    def reach_mm(self) -> float:
        """Largest distance of the footprint from the centre, mm."""

    @abstractmethod
    def pressure_at(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the pressure at points x, y in mm from the centre.

        Returns
        -------
        contact, suction : array, shape of `x`
            Contact pressure ≥ 0 without tilt, and suction ≤ 0, kPa.
        """

    def mean_pressure(self, panel: Panel, patch_mm: float) -> tuple[Array, Array]:
        """Return the mean pressure over square patches with the edge `patch_mm`.

        Returns
        -------
        contact, suction : array, shape (rows, columns)
            Mean contact pressure, tilt included, and mean suction, kPa.
        """
        offset = ((np.arange(POINTS) + 0.5) / POINTS - 0.5) * patch_mm
        across, down = np.where(panel.present, panel.places_mm, 0.0)[:, :, None, :, None]
        blocks = (panel.rows, POINTS, panel.columns, POINTS)
        # points of all patches, (rows, POINTS, columns, POINTS) mm from the centre
        x = np.broadcast_to(across + offset - self.centre_mm[0], blocks)
        y = np.broadcast_to(down + offset[:, None, None] - self.centre_mm[1], blocks)
        contact, suction = self.pressure_at(x, y)
        direction = np.radians(self.tilt_direction_deg)
        tilting = 1 + self.tilt * (x * np.cos(direction) + y * np.sin(direction)) / self.reach_mm
        contact, suction = (
            panel.present * part.mean(axis=(1, 3)) for part in (contact * tilting, suction)
        )
        return contact, suction
