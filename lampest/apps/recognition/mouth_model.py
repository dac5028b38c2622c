"""Model of a mouth that the search for suction fits: parameters φ, their priors, their pressure.

φ are x and y of the centre, the logarithms of diameter, width of the rim, suction and push, the
tilts along x and y, and the numbers of `Unevenness`. The push is the excess of the rim's pressure
over p_bear.
"""

from collections.abc import Mapping
from math import exp, log
from typing import NamedTuple

import numpy as np

from lampest.apps.recognition.patches import EVEN, Unevenness, pressure_at_places
from lampest.panel.panel import Array, Panel
from lampest.recording.shapes.disc import Disc, bearing_kpa

# Common error of the places of both edges. Assumption: films are cut to a millimetre, and rims are
# rounded.
EDGE_MM = 1.1
COMPLEX_STEP = 2.0**-104  # of derivatives, which have full precision, because nothing is subtracted
CLOSED = 0.05  # rounding of d_i/d at 0, so that it stays positive for any width of the rim


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


# Priors of all parameters but the centre. Assumptions: 95 % of diameters are between 15 and 60 mm,
# and 95 % of rims are 3 to 10 mm wide (mouths have 4 to 7 mm, the paper's suction cup 4). They
# press with 0.02 to 110 kPa more than their suction requires: nearly nothing under a soft mouth,
# 80 kPa if bending under rim and teeth is included. 95 % of suctions are 1.8 to 35 kPa, and 95 %
# of tilts are below a half. 95 % of mouths have axes within a ratio of 1.22 and press evenly
# within ±34 % along the rim. A soft rim has more lobes than are fitted.
PRIORS = {
    "diameter": Prior(log(30), 0.35, step=0.2),
    "width": Prior(log(5.5), 0.3),
    "suction": Prior(log(8), 0.75),
    "push": Prior(log(1.5), 2.2, step=2.0),
    "tilt_x": Prior(0, 0.25, step=0.3, sway=0.1),
    "tilt_y": Prior(0, 0.25, step=0.3, sway=0.1),
    "along": Prior(0, 0.05, step=0.1),
    "across": Prior(0, 0.05, step=0.1),
    "lobe_along": Prior(0, 0.17, step=0.1),
    "lobe_across": Prior(0, 0.17, step=0.1),
}
NAMES = ("x", "y", *PRIORS)
SUCTION = NAMES.index("suction")  # place of ln of the suction in φ


def priors(panel: Panel) -> Mapping[str, Prior]:
    """Return the independent priors by the parameters' names, in the order of φ.

    Those of the centre, in mm, have the mean and variance of a uniform distribution over the panel,
    steps of half a pitch, and a sway of 1 mm.
    """
    pitch = panel.pitch_mm
    centre = {
        name: Prior((least + most) / 2, (most - least + pitch) / 12**0.5, pitch / 2, sway=1.0)
        for name, (least, most) in zip("xy", panel.extents_mm, strict=True)
    }
    return centre | PRIORS


def mean_and_sd(panel: Panel) -> tuple[Array, Array]:
    """Return the prior means and standard deviations of φ, (parameters,) each."""
    mean, sd, *_ = np.transpose([*priors(panel).values()])
    return mean, sd


def pressure(panel: Panel, patch_mm: float, parameters: Array) -> tuple[Array, Array]:
    """Return the pressure of an elongated, uneven disc.

    Returns
    -------
    pressure : array, shape (rows, columns)
        Mean pressure on the patches, kPa.
    slopes : array, shape (parameters, rows, columns)
        Derivatives of the pressure by φ, kPa.
    """
    disc, by_parameter = disc_with_slopes(parameters)
    form = slice(-len(EVEN), None)
    on_patches, by_number = pressure_at_places(
        panel.places_mm, patch_mm, disc, Unevenness(*parameters[form])
    )
    slopes = np.tensordot(by_parameter, by_number[: len(disc)], (0, 0))
    slopes[form] = by_number[len(disc) :]
    return on_patches, slopes


def disc_of(parameters: Array) -> Disc:
    """Return the disc of φ, without its unevenness."""
    return Disc(*_numbers(parameters).tolist())


def disc_with_slopes(parameters: Array) -> tuple[Disc, Array]:
    """Return the disc of φ, and its derivatives by complex steps, Im f(φ + ih)/h.

    Returns
    -------
    disc : Disc
    slopes : array, shape (8, parameters)
        Derivatives of the disc's numbers by φ.

    Source: Squire, Trapp, SIAM Review 40, 110 (1998).
    """
    numbers = _numbers(parameters[:, None] + 1j * COMPLEX_STEP * np.eye(len(parameters)))
    return Disc(*numbers[:, 0].real.tolist()), numbers.imag / COMPLEX_STEP


def _numbers(parameters: Array) -> Array:
    """Return the numbers of the disc, (8, …), of φ (parameters, …), real or complex."""
    x, y, *logarithms, tilt_x, tilt_y = parameters[: -len(EVEN)]
    diameter, width, suction, push = np.exp(logarithms)
    # d_i/d = 1 − 2w/d, smoothly limited to positive values
    hollow = 1 - 2 * width / diameter
    share = (hollow + np.sqrt(hollow**2 + CLOSED**2)) / 2
    # p_bear = −s d_i²/(d² − d_i²)
    rim = suction * share**2 / (1 - share**2) + push
    return np.stack([x, y, diameter, share * diameter, -suction, rim, tilt_x, tilt_y])


def start_of(disc: Disc) -> Array:
    """Return the start of a fit from a disc with a hole: φ, (parameters,)."""
    width = (disc.diameter_mm - disc.inner_mm) / 2
    bearing = bearing_kpa(disc.suction_kpa, disc.inner_mm, disc.diameter_mm)
    sizes = (
        disc.diameter_mm,
        max(min(width, 0.4 * disc.diameter_mm), 0.5),
        max(-disc.suction_kpa, 1.0),
        max(disc.rim_kpa - bearing, 0.5),
    )
    return np.array([disc.x_mm, disc.y_mm, *map(log, sizes), disc.tilt_x, disc.tilt_y, *EVEN])


def blind(parameters: Array) -> Array:
    """Return the deviations that readings cannot reduce: EDGE_MM/d of ln d, 0 of all others."""
    place = NAMES.index("diameter")
    return np.asarray(np.eye(len(parameters))[place] * (EDGE_MM / exp(parameters[place])))
