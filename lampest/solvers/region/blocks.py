"""Blocks of cells: where they lie, and what a network becomes when only their cells change."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from lampest.cost.problem import Data
from lampest.panel.network import Network, laplacian
from lampest.panel.panel import Array

MARGIN = 1
MOST_FITS, FITTED, ROUNDING = 30, 1e-9, 1e-14
LENGTHS = tuple(0.5**power for power in range(20))

Block = tuple[slice, slice]


def changed(network: Network, block: Block, conductance: Array) -> Network:
    """The network with other conductances in a block: Z − Z_S (1 + ΔL Z_SS)⁻¹ ΔL Z_Sᵀ, S the lines of the block."""
    lines = lines_of(network, block)
    change = laplacian(conductance - network.conductance[block])
    towards = network.impedance[:, lines]
    core = np.linalg.solve(np.eye(len(lines)) + change @ towards[lines], change)
    whole = network.conductance.copy()
    whole[block] = conductance
    return Network(whole, network.impedance - towards @ core @ towards.T)


def lines_of(network: Network, block: Block) -> NDArray[np.intp]:
    """The numbers of a block's lines, rows first."""
    rows, columns = network.conductance.shape
    return np.concatenate([np.arange(rows)[block[0]], rows + np.arange(columns)[block[1]]])


def fitted(network: Network, data: Data, block: Block, plain: NDArray[np.bool_]) -> Network:
    """The network with the block's cells such that they reproduce its plain readings, as far as bounds allow.

    g* = argmin ⟨R_m, g⟩ − log det C(g), convex; see `lampest.solvers.convex`.
    """
    measured, least = data.measured[0][block], 1 / data.upper[0][block]
    lines = lines_of(network, block)
    resting, impedance = network.conductance[block], network.impedance[np.ix_(lines, lines)]

    def at(conductance: Array) -> tuple[float, Network]:
        system = np.eye(len(lines)) + impedance @ laplacian(conductance - resting)
        value = float(np.sum(measured * conductance)) - float(np.linalg.slogdet(system)[1])
        return value, Network(conductance, np.linalg.solve(system, impedance))

    conductance = resting
    value, here = at(conductance)
    for _ in range(MOST_FITS):
        gradient = measured - here.two_point_resistance()
        free = plain[block] & ((conductance > least * (1 + 1e-12)) | (gradient < 0))
        if np.max(np.abs(gradient[free] / measured[free]), initial=0) < FITTED:
            break
        chosen, step = np.flatnonzero(free), np.zeros(measured.shape)
        curvature = here.transfer()[np.ix_(chosen, chosen)] ** 2
        step[free] = np.linalg.solve(curvature, -gradient[free])
        for length in LENGTHS:
            trial = np.maximum(conductance + length * step, np.maximum(least, conductance / 10))
            trial_value, there = at(trial)
            if trial_value <= value + 1e-4 * float(np.sum(gradient * (trial - conductance))) + ROUNDING * abs(value):
                break
        else:
            break
        conductance, value, here = trial, trial_value, there
    return changed(network, block, conductance)


def grown(cells: NDArray[np.bool_], blocks: tuple[Block, ...]) -> tuple[Block, ...]:
    """The rectangles round neighbouring cells with a margin of one, and round earlier blocks; none overlap."""
    covered = np.zeros(cells.shape, dtype=bool)
    for row, column in np.argwhere(cells):
        covered[max(row - MARGIN, 0) : row + MARGIN + 1, max(column - MARGIN, 0) : column + MARGIN + 1] = True
    for block in blocks:
        covered[block] = True
    count = -1
    while count != int(covered.sum()):
        count = int(covered.sum())
        found = tuple(patches(covered))
        for block in found:
            covered[block] = True
    return found


def patches(cells: NDArray[np.bool_]) -> Iterator[Block]:
    """The rectangle round each group of cells that touch, corners included."""
    left = {(int(row), int(column)) for row, column in np.argwhere(cells)}
    while left:
        group = [left.pop()]
        for row, column in group:  # grows while it is walked through
            near = {(row + down, column + right) for down in (-1, 0, 1) for right in (-1, 0, 1)} & left
            left -= near
            group += near
        sides = [[cell[axis] for cell in group] for axis in (0, 1)]
        down, across = (slice(min(side), max(side) + 1) for side in sides)
        yield down, across


def area(block: Block) -> int:
    """Number of cells."""
    return int((block[0].stop - block[0].start) * (block[1].stop - block[1].start))


def widened(block: Block, by: int, shape: tuple[int, ...]) -> Block:
    """The block with so many more cells on every side, as far as the panel goes."""
    down, across = (
        slice(max(side.start - by, 0), min(side.stop + by, n)) for side, n in zip(block, shape, strict=True)
    )
    return down, across
