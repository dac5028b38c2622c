"""Loads by their cells, without a shape: suction, and contacts.

Suction lifts the film from its electrodes, and resistance rises: the likelihood ratio of a risen
cell against one that has not is the evidence of suction. A rim that presses around the suction
bears it: fallen neighbours multiply the odds. Neither depends on the form of a mouth, on other
loads next to it, or on the film's curve.

Contacts are neighbouring cells that conduct more than at rest. A cover spreads pressure, and errors
of the circuit change the neighbours of a heavy load a little. Both join separate contacts. Contacts
are therefore divided where the change between them is faint, as a watershed divides two lakes, and
a contact has the cells that changed by more than a share of its strongest one. Errors of the cells
must not explain a division: between the cells of one foot on a real insole they did.
"""

from math import dist, hypot, inf, log, pi
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.special import expit, log_ndtr, logit, ndtr

from lampest.apps.recognition.observation import Observation, patch_of
from lampest.files.levels import NOISE_REACH
from lampest.panel.panel import Array, Mask, Numbers, Panel
from lampest.recording.shapes.disc import Disc, bearing_kpa

# ln r/r0 by a suction of 1 kPa. Of 64 hands, rocks, fish, fins, bubbles, rods and rings none raised
# a cell by more than 0.1 beyond its error; of 48 mouths and cups of −2.5 kPa and more, 47 raised
# one by more than 0.3, each by more than seven standard deviations.
MIN_RISE = 0.2
# Largest ln odds by risen cells alone: cells rise for other reasons, too, as where a load is
# relieved or an amplifier saturates. Of those loads 47 of 48 and none of 64 have risen cells.
RISEN_LOG_ODDS = log(20)
# Assumed probability that a neighbour of risen cells has fallen if they are under suction, and that
# it has not if they are not. Rims pass between patches, and other loads adjoin.
ENCLOSED = 0.75
# Probability that a load sucks none of whose cells has risen, where they would show it: assumed, of
# faint suctions, to which a film hardly answers, and of films that open late.
UNRISEN = 0.05
MIN_FALL = 0.05  # ln r/r0 of a cell under a rim; less is drift
# Standard deviations of ln r/r0 of a cell under suction, one-sided, and of one that nothing sucks
# at, beside its error: half the largest rise of those 64 loads.
SUCTION_SD = 1.0
UNMOVED_SD = 0.05
# Interquartile range of ln r0 of an unloaded film: 0.54 with a spread of 0.4, and 0.2 to 0.32 of
# the shipped panels; a foot that stands or walks on an insole has 1.2 and 2.4.
MAX_RANGE = 0.9
RIM_MM = (6.0, -12.0)  # usual width of a rim, and suction, at which a fit begins
APART_PITCHES = 2.2  # distance of two mouths: below, risen cells are of one
# Of the strongest ln r0/r of a contact: cells with less are its surroundings. Between two feet
# under a soft cover it is a fifth, under the arch of one foot a half.
FAINT_SHARE = 0.3
SMALL_CELLS = 3
# Likewise for contacts of fewer cells: between two feet in a circuit with grounded lines up to
# 0.12.
SMALL_SHARE = 0.15
# Of the strongest ln r0/r of all cells: errors of the circuit beside a heavy load.
GHOST_SHARE = 0.05


class Suction(NamedTuple):
    """A place on the panel that may be under suction.

    Attributes
    ----------
    cells : boolean array, shape (rows, columns)
        Neighbouring cells that have risen.
    odds : float
        ln odds that they are under suction.
    x_mm, y_mm : float
        Their middle, weighted with ln r/r0.
    """

    cells: Mask
    odds: float
    x_mm: float
    y_mm: float

    @property
    def probability(self) -> float:
        """Probability that the place is under suction."""
        return float(expit(self.odds))

    @property
    def centre(self) -> tuple[float, float]:
        """Coordinates x and y of the middle, mm."""
        return self.x_mm, self.y_mm

    def disc(self, panel: Panel) -> Disc:
        """Return the disc of the same area of suction with a usual rim."""
        inner = 2 * (float(self.cells.sum()) / pi) ** 0.5 * panel.pitch_mm
        width, suction = RIM_MM
        outer = inner + 2 * width
        bearing = bearing_kpa(suction, inner, outer)
        return Disc(*self.centre, outer, inner, suction, bearing, 0.0, 0.0)


def suctions(frame: Observation) -> list[Suction]:
    """Return the places that are more probably under suction than not, the largest first.

    Neighbouring cells that more probably have risen than not are a group, with neighbours that have
    by MIN_FALL and one standard deviation, and with cells between two of them that cannot show a
    usual suction, as those of a dead line. With the likelihood ratio B of the clearest cell, beyond
    the rise of its lines, and O of `_enclosure`, it is under suction with the odds

        1 / (N / (B min(O, N)) + e^−RISEN_LOG_ODDS / O):

    any of the N cells may be the clearest one by chance, unless others enclose it, as in a ring,
    too. Nothing is concluded if the cells of the unloaded panel are as uneven as under loads: a
    rising cell may then have been relieved.
    """
    panel = frame.panel
    chance = log(panel.present.sum())
    change = frame.free_map
    sd = frame.free_sd
    intact = frame.baseline.logarithm[panel.present & ~frame.baseline.scene.broken]
    lower, upper = np.quantile(intact, (0.25, 0.75))
    if upper - lower >= MAX_RANGE:
        return []
    places = list[Suction]()
    risen = panel.present & (_rise_evidence(change, sd) > 0)
    hidden = panel.present & (NOISE_REACH * sd > SUCTION_SD) & _between(panel, risen)
    for clear in groups_of(panel, risen | hidden):
        cells = clear | (around(panel, clear) & (change > np.maximum(MIN_FALL, sd)))
        if not around(panel, cells).any():
            continue  # the whole panel has risen
        # An amplifier that saturates under a heavy load raises all cells of its row or its column
        # that have not fallen: their median beside the group.
        beside = panel.present & ~cells & (change > -MIN_FALL)
        of_lines = [change[beside & cells.any(axis=axis, keepdims=True)] for axis in (0, 1)]
        lines = max(0.0, *(float(np.median(line)) if line.size else 0.0 for line in of_lines))
        rise = _rise_evidence((change - lines)[cells], sd[cells], lines).max()
        enclosure = _enclosure(frame, cells)
        rise += min(enclosure - chance, 0.0)
        odds = -float(np.logaddexp(-rise, -RISEN_LOG_ODDS - enclosure))
        weight = np.maximum(change[cells], 0.0)
        weight /= weight.sum()
        x, y = panel.places_mm[:, cells] @ weight
        places.append(Suction(cells, odds, float(x), float(y)))
    places.sort(key=lambda place: -np.maximum(change[place.cells], 0.0).sum())
    # without those that are nearer to a larger one than two mouths can be
    separate = list[Suction]()
    for place in places:
        distances = [dist(place.centre, larger.centre) for larger in separate]
        if place.odds > 0 and min(distances, default=inf) > APART_PITCHES * panel.pitch_mm:
            separate.append(place)
    return separate


def under(panel: Panel, disc: Disc) -> Mask:
    """Return the cells whose centre is within a disc enlarged by half a pitch, (rows, columns)."""
    across, down = panel.places_mm
    reach = (disc.diameter_mm + panel.pitch_mm) / 2
    return np.asarray(np.hypot(across - disc.x_mm, down - disc.y_mm) < reach)


def inner_cells(panel: Panel, place: tuple[float, float], diameter_mm: float) -> Mask:
    """Return the cells that would show that a round load sucks, boolean (rows, columns).

    Their patches lie within a usual rim.

    Parameters
    ----------
    panel : Panel
    place : (float, float)
        Centre of the load, mm.
    diameter_mm : float
    """
    x, y = panel.places_mm
    distances = np.hypot(x - place[0], y - place[1])
    inside = distances + patch_of(panel) / 2 <= diameter_mm / 2 - RIM_MM[0]
    return np.asarray(panel.present & inside)


def rise_odds(frame: Observation, cells: Mask) -> float:
    """Return the ln likelihood ratio of suction by the clearest of some cells.

    At least UNRISEN remains: that suction raises no cell. The result is 0 without cells.
    """
    if not cells.any():
        return 0.0
    evidence = _rise_evidence(frame.free_map[cells], frame.free_sd[cells])
    return max(float(evidence.max()), float(logit(UNRISEN)))


def _rise_evidence(change: Array, sd: Array, lines: float = 0.0) -> Array:
    """Return the ln likelihood ratio of cells under suction against unmoved ones.

    The posterior N(x, s²) of a cell has the prior N(0, 1), so its readings say ln r/r0 with the
    variance v = s²/(1 − s²) about y = x/(1 − s²). Under suction ln r/r0 is a positive N(0, S²), and
    otherwise N(0, U²):

        ln 2 Φ(z) + ln N(y; 0, v + S²) − ln N(y; 0, v + U²),   z = y S / √(v (v + S²)).

    A cell of which nothing is known, as under a dead line, has 0. S is SUCTION_SD. U is UNMOVED_SD,
    and as much more as whole lines have risen, because these rise unevenly.

    Parameters
    ----------
    change, sd : array
        x and s.
    lines : float
        Rise of the lines, by which x is less than ln r/r0.
    """
    own = np.maximum(1 - sd**2, np.finfo(float).eps)
    variance = sd**2 / own
    shown = change / own
    lifted, unmoved = (variance + size**2 for size in (SUCTION_SD, hypot(UNMOVED_SD, lines)))
    positive = log_ndtr(shown * SUCTION_SD / np.sqrt(variance * lifted))
    squares = shown**2 * (1 / unmoved - 1 / lifted)
    return np.asarray(log(2) + positive + (squares + np.log(unmoved / lifted)) / 2)


def _enclosure(frame: Observation, cells: Mask) -> float:
    """Return the ln likelihood ratio of suction by the neighbours of a group, (rows, columns).

    A neighbour has fallen by more than MIN_FALL with the probability p. It has with the probability
    ENCLOSED if the cells are under suction, and has not with the same if they are not. The ratio is

        Π (E p + (1 − E)(1 − p)) / ((1 − E) p + E (1 − p)),   E = ENCLOSED.

    A neighbour of which nothing is known has p = 1/2 and no effect.
    """
    rim = around(frame.panel, cells)
    fallen = ndtr(-(frame.free_map[rim] + MIN_FALL) / frame.free_sd[rim])
    under = ENCLOSED * fallen + (1 - ENCLOSED) * (1 - fallen)
    return float(np.sum(np.log(under / (1 - under))))


def _between(panel: Panel, which: Mask) -> Mask:
    """Return the cells of which two neighbours are among some, boolean (rows, columns)."""
    first, second, _ = panel.neighbours
    beside = np.zeros(which.size)
    np.add.at(beside, first, which.flat[second])
    np.add.at(beside, second, which.flat[first])
    return beside.reshape(which.shape) >= 2


def groups_of(panel: Panel, which: Mask) -> list[Mask]:
    """Return the groups of neighbouring cells among some, in the order of their cells.

    Each group is a boolean array (rows, columns).
    """
    if not which.any():
        return []
    from scipy.sparse.csgraph import connected_components  # with all of scipy.sparse.linalg

    first, second, _ = panel.neighbours
    linked = which.flat[first] & which.flat[second]
    pairs = coo_array((linked[linked], (first[linked], second[linked])), shape=2 * (which.size,))
    _, labels = connected_components(pairs)
    return [labels.reshape(which.shape) == label for label in dict.fromkeys(labels[which.ravel()])]


def around(panel: Panel, group: Mask) -> Mask:
    """Return the neighbours of a group of cells that are not of it, boolean (rows, columns)."""
    first, second, _ = panel.neighbours
    beside = np.zeros(group.size, dtype=bool)
    beside[second[group.flat[first]]] = True
    beside[first[group.flat[second]]] = True
    return beside.reshape(group.shape) & ~group


def contacts_of(panel: Panel, change: Array, sd: Array) -> list[Mask]:
    """Return the cells of every contact, boolean (rows, columns) each, the strongest one first.

    Parameters
    ----------
    panel : Panel
    change, sd : array, shape (rows, columns)
        ln r/r0 and its standard deviation. Only cells that conduct more count.
    """
    strength = -change
    clear = strength > np.maximum(MIN_FALL, NOISE_REACH * sd)
    if not clear.any():
        return []
    touched = clear & (strength > GHOST_SHARE * strength[clear].max())
    order = np.argsort(-strength, axis=None, kind="stable")
    unassigned = np.full(panel.shape, -1, dtype=np.intp)
    basin = _watershed(panel, strength, sd, order[touched.flat[order]], unassigned, assigned=True)
    # One cell between two basins that may have changed as they have is enough to join them. Of a
    # cell whose readings are bounds, or of a dead line, nothing is known: it divides no contact.
    between = np.flatnonzero(basin < 0)
    joined = _watershed(panel, strength, sd, between, basin, assigned=False)
    members = touched & ~_is_faint(strength, sd, basin)
    peaks = sorted(set(joined[touched]), key=lambda cell: -strength.flat[cell])
    contacts = [members & (joined == peak) for peak in peaks]
    least = SMALL_SHARE * strength[clear].max()
    return [
        cells for cells in contacts if cells.sum() >= SMALL_CELLS or strength[cells].max() >= least
    ]


def _is_faint(strength: Array, sd: Array, peak: Numbers | int) -> Mask:
    """Return whether cells changed by clearly less than a share of a contact's strongest cell.

    `peak` is the number of that cell, or of that of each cell, (rows, columns).
    """
    error = np.hypot(sd, FAINT_SHARE * sd.ravel()[peak])
    return np.asarray(FAINT_SHARE * strength.ravel()[peak] - strength > NOISE_REACH * error)


def _watershed(
    panel: Panel, strength: Array, sd: Array, cells: Numbers, basin: Numbers, *, assigned: bool
) -> Numbers:
    """Return the number of the strongest cell of every cell's contact, (rows, columns).

    A cell that connects two groups joins them unless it is faint for the weaker one.

    Parameters
    ----------
    panel : Panel
    strength, sd : array, shape (rows, columns)
    cells : integer array
        Numbers of the cells that may connect groups, one after the other.
    basin : integer array, shape (rows, columns)
        The groups so far; −1 elsewhere.
    assigned : bool
        Whether the cells become members.
    """
    first, second, _ = panel.neighbours
    basin = basin.copy()
    for cell in cells.tolist():
        beside = np.concatenate([second[first == cell], first[second == cell]])
        near = {*basin.flat[beside].tolist()} - {-1}
        peaks = sorted(near, key=lambda peak: -strength.flat[peak]) or [cell]
        if assigned:
            basin.flat[cell] = peaks[0]
        for peak in peaks[1:]:
            if not _is_faint(strength, sd, peak).flat[cell]:
                basin[basin == peak] = peaks[0]
    return basin
