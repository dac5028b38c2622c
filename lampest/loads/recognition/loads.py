"""The loads that a frame may show: their pressures on the patches with derivatives, and what is known beforehand.

One disc makes them all: a circle of diameter d about (x, y), pressing with p(1 + tilt) between its inner diameter d_i
and d, and sucking with s inside d_i.

    rod      d_i = 0, s = 0
    ring     s = 0
    cup      p = p_bear + push, where p_bear = −s·d_i²/(d² − d_i²) is what bears the suction; push < 40 kPa of a hand
    lamprey  p free, but harder than the suction needs: p > 1.25·p_bear

The parameters φ that are fitted have no bounds, and independent Gaussian priors.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import exp, log, sqrt
from typing import NamedTuple

import numpy as np

from lampest.loads.footprint import cover
from lampest.panel.panel import Array, Panel

CLOSED = 0.05  # d_i/d where the rim would leave no inside
PUSHED = 40.0  # kPa by which a cup is pushed at most beyond what its suction needs
HARDER = 1.25  # so many times as hard as its suction needs a lamprey's rim presses at least


class Disc(NamedTuple):
    """Numbers that describe every load: mm and kPa; tilt is the relative change of p from the centre to the edge."""

    x_mm: float
    y_mm: float
    diameter_mm: float
    inner_mm: float
    suction_kpa: float
    rim_kpa: float
    tilt_x: float
    tilt_y: float


class Prior(NamedTuple):
    """A parameter's mean and standard deviation before anything is measured."""

    mean: float
    sd: float


@dataclass(frozen=True)
class Candidate(ABC):
    """A kind of load: its parameters φ with their priors, and the pressure that they mean.

    The names: x, y, tilt_x, tilt_y and flat themselves, in mm, 1 and kPa; diameter, width, suction, rim and push by
    their logarithms.
    """

    label: str
    priors: dict[str, Prior]

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters in order."""
        return tuple(self.priors)

    def mean(self, panel: Panel) -> Array:
        """Prior mean of φ, (parameters); the centre's is the middle of the panel."""
        middle = {"x": (panel.columns - 1) * panel.pitch_mm / 2, "y": (panel.rows - 1) * panel.pitch_mm / 2}
        return np.array([middle.get(name, prior.mean) for name, prior in self.priors.items()])

    def sd(self, panel: Panel) -> Array:
        """Prior standard deviation of φ, (parameters); the centre's is that of a uniform one over the panel."""
        extent = {"x": panel.columns * panel.pitch_mm / 12**0.5, "y": panel.rows * panel.pitch_mm / 12**0.5}
        return np.array([extent.get(name, prior.sd) for name, prior in self.priors.items()])

    @abstractmethod
    def pressure(self, panel: Panel, patch_mm: float, parameters: Array) -> tuple[Array, Array]:
        """Mean pressure on every patch, (rows, columns) kPa, and its derivatives by φ (parameters, rows, columns)."""


@dataclass(frozen=True)
class Everywhere(Candidate):
    """The same pressure on all cells, which is also what a drift of the whole panel looks like; or none at all."""

    def pressure(self, panel: Panel, patch_mm: float, parameters: Array) -> tuple[Array, Array]:
        """p = φ."""
        slopes = np.ones((len(parameters), *panel.shape))
        return np.tensordot(parameters, slopes, 1), slopes


@dataclass(frozen=True)
class Round(Candidate):
    """A load with a circular footprint."""

    def pressure(self, panel: Panel, patch_mm: float, parameters: Array) -> tuple[Array, Array]:
        """That of the disc which φ describes."""
        disc, by_parameter = self.disc(parameters)
        pressure, by_disc = disc_pressure(panel, patch_mm, disc)
        return pressure, (by_parameter.T @ by_disc.reshape(8, -1)).reshape(-1, *panel.shape)

    def disc(self, parameters: Array) -> tuple[Disc, Array]:
        """The disc of φ, and its derivatives (8, parameters)."""
        at = dict(zip(self.names, parameters, strict=True))
        slopes = {name: np.zeros(8) for name in self.names}
        for place, name in ((0, "x"), (1, "y"), (6, "tilt_x"), (7, "tilt_y")):
            slopes[name][place] = 1.0
        diameter, share = exp(at["diameter"]), 0.0
        slopes["diameter"][2] = diameter
        if "width" in at:
            share, bend = _share(2 * exp(at["width"]) / diameter)
            slopes["diameter"][3], slopes["width"][3] = diameter * (share - bend), diameter * bend
        suction = -exp(at["suction"]) if "suction" in at else 0.0
        if "suction" in at:
            slopes["suction"][4] = suction
        if "push" in at:
            bearing, push = exp(log_bearing(suction, share)), exp(at["push"])
            rim = bearing + push
            slopes["push"][5], slopes["suction"][5] = push, bearing
            slopes["width"][5] = bearing * bearing_slope(share) * bend
            slopes["diameter"][5] = -slopes["width"][5]
        else:
            rim = exp(at["rim"])
            slopes["rim"][5] = rim
        disc = Disc(at["x"], at["y"], diameter, share * diameter, suction, rim, at["tilt_x"], at["tilt_y"])
        return disc, np.stack([slopes[name] for name in self.names], axis=1)

    def parameters(self, disc: Disc) -> Array:
        """φ of a disc, as far as this kind of load has it; what the disc has none of is taken as small."""
        width = (disc.diameter_mm - disc.inner_mm) / 2 if disc.inner_mm else exp(WIDTH.mean)
        suction, rim = max(-disc.suction_kpa, 1.0), max(disc.rim_kpa, 0.1)
        values = {
            "x": disc.x_mm,
            "y": disc.y_mm,
            "diameter": log(disc.diameter_mm),
            "width": log(max(min(width, 0.4 * disc.diameter_mm), 0.5)),
            "suction": log(suction),
            "rim": log(rim),
            "push": CUP.priors["push"].mean,
            "tilt_x": disc.tilt_x,
            "tilt_y": disc.tilt_y,
        }
        return np.array([values[name] for name in self.names])


PLACE = {"x": Prior(0, 0), "y": Prior(0, 0), "diameter": Prior(log(30), 0.35)}
TILT = {"tilt_x": Prior(0, 0.25), "tilt_y": Prior(0, 0.25)}
WIDTH = Prior(log(5.5), 0.45)
SUCTION = {"suction": Prior(log(8), 0.75)}
ROD = Round("rod", PLACE | {"rim": Prior(log(8), 1.0)} | TILT)
RING = Round("ring", PLACE | {"width": WIDTH} | {"rim": Prior(log(30), 1.0)} | TILT)
CUP = Round("cup", PLACE | {"width": WIDTH} | SUCTION | {"push": Prior(log(0.5), 1.8)} | TILT)
LAMPREY = Round("lamprey", PLACE | {"width": Prior(log(5.5), 0.3)} | SUCTION | {"rim": Prior(log(75), 0.4)} | TILT)
NOTHING = Everywhere("nothing", {})
FLAT = Everywhere("flat load", {"flat": Prior(0, 5)})
ROUND = (ROD, RING, CUP, LAMPREY)


def _share(solid: float) -> tuple[float, float]:
    """ι = d_i/d of 2w/d, and its slope by ln w, which is that by −ln d: 1 − 2w/d, but never quite zero."""
    hollow = 1 - solid
    root = sqrt(hollow * hollow + CLOSED * CLOSED)
    return (hollow + root) / 2, -solid * (1 + hollow / root) / 2


def log_bearing(suction_kpa: float, share: float) -> float:
    """ln(−s·ι²/(1 − ι²)), ι = d_i/d: logarithm of the rim pressure in kPa that bears the suction."""
    return log(-suction_kpa) + 2 * log(share) - log(1 - share * share)


def bearing_slope(share: float) -> float:
    """Its derivative by ι: 2/(ι (1 − ι²))."""
    return 2 / (share * (1 - share * share))


def disc_pressure(panel: Panel, patch_mm: float, disc: Disc) -> tuple[Array, Array]:
    """Mean pressure on every patch, (rows, columns) kPa, and its slopes by the disc's numbers (8, rows, columns)."""
    radius = disc.diameter_mm / 2
    circles = (disc.diameter_mm, disc.inner_mm) if disc.inner_mm > 0 else (disc.diameter_mm,)
    covered = cover(panel, patch_mm, (disc.x_mm, disc.y_mm), circles)
    tilt = np.array([1.0, disc.tilt_x / radius, disc.tilt_y / radius])
    contact, contact_slope = covered.values[0], covered.slopes[:, 0]
    slopes = np.zeros((8, *panel.shape))
    pressure = np.zeros(panel.shape)
    if disc.inner_mm > 0:
        inner, inner_slope = covered.values[1], covered.slopes[:, 1]
        contact = contact - inner
        pressure = disc.suction_kpa * inner[0]
        slopes[[0, 1, 3]] = disc.suction_kpa * inner_slope[:, 0]
        slopes[3] -= disc.rim_kpa * _weighted(tilt, inner_slope[2])
        slopes[4] = inner[0]
        contact_slope = contact_slope.copy()
        contact_slope[:2] -= inner_slope[:2]
    slopes[5] = _weighted(tilt, contact)
    pressure = pressure + disc.rim_kpa * slopes[5]
    for place in range(3):
        slopes[place] += disc.rim_kpa * _weighted(tilt, contact_slope[place])
    slopes[2] -= disc.rim_kpa * _weighted(tilt[1:], contact[1:]) / disc.diameter_mm
    slopes[6:] = disc.rim_kpa * contact[1:] / radius
    return pressure, slopes


def _weighted(weights: Array, parts: Array) -> Array:
    """Σ w_i·part_i, (parts, rows, columns) → (rows, columns)."""
    total: Array = (weights @ parts.reshape(len(weights), -1)).reshape(parts.shape[1:])
    return total
