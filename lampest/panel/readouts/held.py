"""Driven lines that are held at a potential all the time, each through its resistance: at the supply or at ground.

A resistance of zero has no tie, but its limit is plain: readings depart from it by Rd·ΣG of a driven line's cells,
which LEAST_DRIVE makes some 1e-8 of ordinary cells, below what any converter sees.
"""

from typing import TYPE_CHECKING

import numpy as np

from lampest.panel.panel import Array
from lampest.panel.readouts.free_test import FreeTest
from lampest.panel.readouts.lines import PerLine, Side, of_side, per_line, with_channels

if TYPE_CHECKING:
    from lampest.panel.readouts.readout import Readout

LEAST_DRIVE = 1e-6  # ohm
LEAST_REST = 1e-3  # the load's share of a sensed line's current; noise of 12 bits over 16 lines is as much
LEAST_VOLTAGE = 1e-9  # of the frame's largest
MOST_ROUNDS = 40
SETTLED = 1e-3  # of log g: a start need not be better
# Of the closed form's conductance, which is off by up to five where drives are large beside a driven line's cells.
LEAST, LARGEST = 0.02, 1e3


def drives_of(drive_ohm: PerLine, lines: int) -> Array:
    """Rd (lines) ohm, never below LEAST_DRIVE."""
    return np.maximum(per_line("drive_ohm", drive_ohm, lines), LEAST_DRIVE)


def with_both_channels(drive_ohm: PerLine, sense_ohm: PerLine, driven: Array, sensed: Array) -> tuple[PerLine, PerLine]:
    """(drives, senses) ohm with what channels have more, (driven lines) and (sensed lines); no sense, no channel."""
    drives = with_channels("drive_ohm", drive_ohm, driven)
    return drives, with_channels("sense_ohm", sense_ohm, sensed) if sense_ohm else 0.0


def at_ideal_drives(driven: Side, share: Array, load: Array) -> Array:
    """r_ij = Rs_j·(1 − Σ_k v_kj)/v_ij: cells (…, rows, columns) ohm that give v where Rd = 0.

    share : v (…, rows, columns), the sensed lines' voltages in units of the supply. load : Rs, all that stands between
    a sensed line and ground, to be broadcast to (rows, columns). Then no sensed line knows of another, and with its
    load or without, all others stay as they are.
    """
    along = -2 if driven == "rows" else -1
    voltage = np.maximum(share, LEAST_VOLTAGE * share.max(axis=(-2, -1), keepdims=True))
    rest = 1 - voltage.sum(axis=along, keepdims=True)
    # No circuit leaves less than nothing: it is noise, or what stands in for a dead line. Then the load is like a cell.
    return np.asarray(load * np.where(rest > LEAST_REST, rest, 1 / (1 + share.shape[along])) / voltage)


def held_start(
    readout: "Readout", driven: Side, share: Array, drive: Array, load: Array, near: Array | None, one: bool
) -> Array:
    """Cells (rows, columns) ohm that give v (rows, columns), in units of the supply, at the sensed lines.

    Given cells, the network says where all driven lines p stand while i is driven and j is read, u_p. Given those,
    Σ_p g_pj (u_p − v_ij) = v_ij/Rs_j is linear in the cells of one sensed line. Both in turn, from `at_ideal_drives`
    on or from an earlier estimate, converge to the cells that reproduce the readings: some six rounds, up to 40 where
    drives are large. A start, not an estimate.

    drive, load : Rd of the driven and Rs of the sensed lines. near : an earlier estimate (rows, columns) ohm. one :
    whether idle sensed lines have no load; the line that is read is then drawn down by its own, which the ties of the
    readout leave out (Sherman and Morrison).
    """
    rows, columns = share.shape
    lines = np.split(np.arange(rows + columns), [rows])
    driven_lines, sensed_lines = of_side(driven, *lines)
    by_driven = driven == "rows"
    voltage = (share if by_driven else share.T).T  # (sensed, driven)
    ideal = 1 / at_ideal_drives(driven, share, load[None, :] if by_driven else load[:, None])
    conductance = ideal if near is None else np.clip(1 / near, LEAST * ideal, LARGEST * ideal)
    ties = readout.ties(share)
    for _ in range(MOST_ROUNDS):
        potential = readout.network(1 / conductance, ties).potentials()
        at_supply = potential[:, driven_lines] / drive  # (line, driven): while the driven one is at 1 volt
        own = np.broadcast_to(at_supply[driven_lines].T, (len(load), len(drive), len(drive)))
        if one:
            sinking = at_supply[sensed_lines] / (load + np.diag(potential)[sensed_lines])[:, None]
            own = own - sinking[:, :, None] * potential[np.ix_(sensed_lines, driven_lines)][:, None, :]
        cells = np.linalg.solve(own - voltage[:, :, None], (voltage / load[:, None])[:, :, None])[:, :, 0]
        before, conductance = conductance, np.clip(cells.T if by_driven else cells, LEAST * ideal, LARGEST * ideal)
        if np.abs(np.log(conductance / before)).max() < SETTLED:
            break
    return np.asarray(1 / conductance)


def held_tests(driven: Side, share: Array, noise: Array, drop: Array) -> tuple[FreeTest, FreeTest]:
    """Σ_i v_ij ≤ 1, and v_ij + Σ_k v_ik·Rd_i/Rs_k ≤ 1, whatever the cells are.

    With all driven lines at the supply at once no sensed line stands above it (superposition: Z·t ≤ 1); and none
    stands above the driven one, which lies below the supply by the loads' current through its Rd.

    share, noise : v and its σ (frames, rows, columns), the sensed lines' voltages in units of the supply, both 0 where
    there is no value. drop : Rd_i/Rs_k of loads that are there at once, to be broadcast to (rows, columns); else 0.
    """
    along_driven, along_sensed = (-2, -1) if driven == "rows" else (-1, -2)
    total, of_total = share.sum(axis=along_driven), np.sqrt((noise**2).sum(axis=along_driven))
    below = share + (share * drop).sum(axis=along_sensed, keepdims=True)
    of_below = np.hypot(noise, np.sqrt(((noise * drop) ** 2).sum(axis=along_sensed, keepdims=True)))
    return (
        FreeTest("readings of a sensed line add up to no more than the supply", _worst(total, of_total), total[0].size),
        FreeTest(
            "no sensed line stands above the driven one behind its drive_ohm", _worst(below, of_below), below[0].size
        ),
    )


def _worst(share: Array, noise: Array) -> Array:
    """max (share − 1)/σ of every frame, (frames); −∞ where there is no value."""
    excess = np.where(noise > 0, (share - 1) / np.where(noise > 0, noise, 1.0), -np.inf)
    return np.asarray(excess.reshape(len(share), -1).max(axis=1))


def most_drive(driven: Side, share: Array, load: Array) -> float:
    """Rd ≤ min_i (1 − max_j v_ij)/Σ_j v_ij/Rs_j, ohm; infinite without a current.

    share : as above. load : Rs_j of loads that are there at once, to be broadcast to (rows, columns).
    """
    along_sensed = -1 if driven == "rows" else -2
    current = (share / load).sum(axis=along_sensed)
    left = 1 - share.max(axis=along_sensed)
    return float(np.min(np.where(current > 0, left / np.where(current > 0, current, 1.0), np.inf)))
