"""What round shapes share: the disc that they are, and how recognition fits it."""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import exp, log, sqrt

import numpy as np

from lampest.loads.response import VACUUM_KPA
from lampest.loads.shapes.disc import (
    EVEN,
    Disc,
    Unevenness,
    annular_pressure,
    bearing_kpa,
    checked_contact,
    log_bearing,
    oval_pressure,
)
from lampest.loads.shapes.shape import Candidate, Prior, Shape, Template, centre_priors
from lampest.panel.panel import Array, Panel

CLOSED = 0.05  # d_i/d where the rim would leave no inside
RIM_WIDTH_MM = 5.5  # an assumption: mouths have 4 to 7 mm, the paper's suction cup 4
# Assumptions: 95 % of diameters within 15 and 60 mm, of suctions within 1.8 and 35 kPa, of tilts below a half.
DIAMETER = Prior(log(30), 0.35, step=0.2)
WIDTH = Prior(log(RIM_WIDTH_MM), 0.45)
SUCTION = Prior(log(8), 0.75)
TILT = {"tilt_x": Prior(0, 0.25, step=0.3), "tilt_y": Prior(0, 0.25, step=0.3)}
# Assumptions: 95 % have axes within a ratio of 1.22, and press within ±34 % along themselves.
UNEVEN = (0.05, 0.05, 0.17, 0.17)
# An assumption: what is made stands as round as a lathe leaves it, within 8 %, and presses within ±16 % along its rim.
MADE = (0.02, 0.02, 0.08, 0.08)
# An assumption: films are cut to a millimetre and rims are rounded, so both edges of a disc may seem displaced.
EDGE_MM, SOFT_EDGE_MM = 0.7, 1.1  # of what is made, and of a soft rim in more lobes than are fitted
# Where the search begins with what sucks: mm, and a suction that shows as clearly as the rim.
SUCKING = (Template(45.0, 32.0, 1.0), Template(34.0, 22.0, 1.0), Template(24.0, 12.0, 1.0))


@dataclass(frozen=True, kw_only=True)
class RoundShape(Shape):
    """A shape that is a disc: its pressure follows from `disc`."""

    @abstractmethod
    def disc(self) -> Disc:
        """The disc. Raises ValueError where the shape's numbers make none."""

    @property
    def reach_mm(self) -> float:
        """Its outer radius."""
        return self.disc().diameter_mm / 2

    def pressure_at(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Suction inside, and the pressure of the rim."""
        return annular_pressure(self.disc(), x, y)

    def pressing(self, inner_mm: float, outer_mm: float, rim_kpa: float, suction_kpa: float = 0.0) -> Disc:
        """The disc with these numbers, its centre and tilt. Raises ValueError where a pressure is out of range."""
        if not VACUUM_KPA < suction_kpa <= 0:
            raise ValueError("pressure_kpa is a suction: it must be negative, and above -101 kPa, an empty space")
        direction = np.radians(self.tilt_direction_deg)
        tilt = (self.tilt * float(np.cos(direction)), self.tilt * float(np.sin(direction)))
        return Disc(*self.centre_mm, outer_mm, inner_mm, suction_kpa, checked_contact(rim_kpa), *tilt)

    def sucking(
        self, inner_mm: float, outer_mm: float, suction_kpa: float, rim_kpa: float | None = None, extra_kpa: float = 0.0
    ) -> Disc:
        """One whose rim bears the suction's force and `extra_kpa`, unless the rim's pressure is given.

        Raises ValueError where a number is out of range.
        """
        bearing = bearing_kpa(suction_kpa, inner_mm, outer_mm)
        if not suction_kpa < 0:
            raise ValueError("pressure_kpa is a suction: it must be negative")
        return self.pressing(inner_mm, outer_mm, bearing + extra_kpa if rim_kpa is None else rim_kpa, suction_kpa)


@dataclass(frozen=True, eq=False, kw_only=True)
class RoundCandidate(Candidate):
    """A disc described by φ: x, y and tilts themselves, other numbers by their logarithms.

    Parameters
    ----------
    numbers : priors of what stands beside the centre, in order. diameter, tilt_x, tilt_y; width of the rim, or the disc
        is full; suction, or there is none; rim, the pressure under it, or push, by which that is above p_bear.
    uneven : standard deviations of the numbers of `Unevenness`, which come last.
    edge_mm : by which both edges may seem to lie beside their places.
    """

    numbers: Mapping[str, Prior]
    uneven: tuple[float, ...] = UNEVEN
    edge_mm: float = EDGE_MM

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The parameters in order."""
        return ("x", "y", *self.numbers, *Unevenness._fields)

    def priors(self, panel: Panel) -> Mapping[str, Prior]:
        """Those of the centre, of all other numbers, and of its unevenness."""
        uneven = zip(Unevenness._fields, self.uneven, strict=True)
        return {**centre_priors(panel), **self.numbers, **{name: Prior(0, sd, step=0.1) for name, sd in uneven}}

    def pressure(self, panel: Panel, patch_mm: float, parameters: Array) -> tuple[Array, Array]:
        """That of the disc which φ describes, stretched and in lobes where it may be."""
        disc, by_parameter = self.disc_with_slopes(parameters)
        form = slice(len(self.names) - len(Unevenness._fields), None)
        pressure, by_number = oval_pressure(panel, patch_mm, disc, Unevenness(*parameters[form]))
        slopes = (by_parameter.T @ by_number[:8].reshape(8, -1)).reshape(-1, *panel.shape)
        slopes[form] = by_number[8:]
        return pressure, slopes

    def disc(self, parameters: Array) -> Disc:
        """The disc of φ."""
        return self.disc_with_slopes(parameters)[0]

    def disc_with_slopes(self, parameters: Array) -> tuple[Disc, Array]:
        """The disc of φ, and its derivatives (8, parameters)."""
        place, at = self._places, parameters.tolist()
        slopes = np.zeros((8, len(at)))
        for number, name in ((0, "x"), (1, "y"), (6, "tilt_x"), (7, "tilt_y")):
            slopes[number, place[name]] = 1.0
        diameter, share = exp(at[place["diameter"]]), 0.0
        slopes[2, place["diameter"]] = diameter
        if "width" in place:
            share, slope = _share(2 * exp(at[place["width"]]) / diameter)
            slopes[3, place["diameter"]], slopes[3, place["width"]] = diameter * (share - slope), diameter * slope
        suction = -exp(at[place["suction"]]) if "suction" in place else 0.0
        if "suction" in place:
            slopes[4, place["suction"]] = suction
        if "push" in place:
            bearing, push = exp(log_bearing(suction, share)), exp(at[place["push"]])
            rim, by_width = bearing + push, bearing * (2 / (share * (1 - share * share))) * slope
            slopes[5, place["push"]], slopes[5, place["suction"]] = push, bearing
            slopes[5, place["width"]], slopes[5, place["diameter"]] = by_width, -by_width
        else:
            rim = exp(at[place["rim"]])
            slopes[5, place["rim"]] = rim
        tilt = at[place["tilt_x"]], at[place["tilt_y"]]
        return Disc(at[0], at[1], diameter, share * diameter, suction, rim, *tilt), slopes

    @cached_property
    def _places(self) -> Mapping[str, int]:
        """Where in φ every parameter stands."""
        return {name: number for number, name in enumerate(self.names)}

    def start(self, disc: Disc) -> Array:
        """φ of a disc as far as this kind has it; what the disc has none of is small, or as before the measurement.

        A full one presses with the same force.
        """
        width, bearing, mean = RIM_WIDTH_MM, 0.0, disc.rim_kpa
        if disc.inner_mm:
            hole = (disc.inner_mm / disc.diameter_mm) ** 2
            mean = disc.rim_kpa * (1 - hole) + disc.suction_kpa * hole
            width = (disc.diameter_mm - disc.inner_mm) / 2
            bearing = bearing_kpa(disc.suction_kpa, disc.inner_mm, disc.diameter_mm)
        values = {
            "diameter": log(disc.diameter_mm),
            "width": log(max(min(width, 0.4 * disc.diameter_mm), 0.5)),
            "suction": log(max(-disc.suction_kpa, 1.0)),
            "rim": log(max(disc.rim_kpa if "width" in self.numbers else mean, 0.1)),
            "push": log(max(disc.rim_kpa - bearing, 0.5)),
            "tilt_x": disc.tilt_x,
            "tilt_y": disc.tilt_y,
        }
        others = (values.get(name, prior.mean) for name, prior in self.numbers.items())
        return np.array([disc.x_mm, disc.y_mm, *others, *EVEN])

    def like(self, other: Candidate, parameters: Array) -> Array | None:
        """That of the disc, as uneven where the other is round, too."""
        begin = super().like(other, parameters)
        if begin is not None and isinstance(other, RoundCandidate):
            form = len(Unevenness._fields)
            begin[-form:] = parameters[-form:]
        return begin

    def blind(self, parameters: Array) -> Array:
        """That of the diameter: edge_mm/d in its logarithm."""
        unseen = np.zeros(len(parameters))
        place = self.names.index("diameter")
        unseen[place] = self.edge_mm / exp(parameters[place])
        return unseen

    def report(self, parameters: Array) -> dict[str, tuple[float, Array]]:
        """Centre and diameter, and the suction of what sucks."""
        disc, slopes = self.disc_with_slopes(parameters)
        names = ("x_mm", "y_mm", "diameter_mm", *(("suction_kpa",) if self.sucks else ()))
        return {name: (getattr(disc, name), slopes[Disc._fields.index(name)]) for name in names}


def _share(solid: float) -> tuple[float, float]:
    """ι = d_i/d of 2w/d, and its slope by ln w, which is that by −ln d: 1 − 2w/d, but never quite zero."""
    hollow = 1 - solid
    root = sqrt(hollow * hollow + CLOSED * CLOSED)
    return (hollow + root) / 2, -solid * (1 + hollow / root) / 2
