"""Scales of cells that no reading of a circuit shows.

A direction in which no reading changes is a null vector of J = ∂y/∂ln r. The vector belongs to the
circuit, not to the cells: inputs without any resistor, with idle lines held at ground, read a mean
of potentials weighted by the conductances of a column, and a factor on the column changes none of
them. One search at scattered cells finds it for a circuit.
"""

from functools import lru_cache
from typing import Literal, Protocol

import numpy as np

from lampest.panel.circuit import CircuitOfLines
from lampest.panel.equation import equation_of
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.readouts.wiring import Wiring

Scale = Literal["all", "rows", "columns"]
TYPICAL_OHM = 3000.0
SCATTER = 0.5  # of ln r, so that no direction is null by symmetry
MAX_LINES = 8  # of a side: a circuit without lists has the same null vectors at any size
MAX_CELLS = 400  # of a circuit with lists
NULL = 1e-6  # singular value over the largest; of readings that are shown 0.01 and more
WITHIN = 0.9  # share of a scale's square that lies in the null space


class SolvableCircuit(CircuitOfLines, Protocol):
    """Interface of a readout whose cells are searched for."""

    def ties(self, measured: Array) -> Array:
        """Return the ties of the lines, see `Readout.ties`."""

    def network(self, cell_resistance: Array, ties: Array, wiring: Wiring | None = None) -> Network:
        """Return the solved network, see `Readout.network`."""

    def uniform_start(self, measured: Array) -> Array:
        """Return cells (…, rows, columns) ohm as if all were equal."""

    def exact_reading(self, cell_resistance: Array, wiring: Wiring | None = None) -> Array:
        """Return the readings of cells (…, rows, columns) ohm."""


def unseen_scales(circuit: SolvableCircuit, rows: int, columns: int) -> tuple[Scale, ...]:
    """Return the scales that no reading shows: of all cells, of each row, of each column.

    A load, or nothing that conducts elsewhere, shows the scale.
    """
    equation = equation_of(circuit, rows, columns)
    if np.isfinite(equation.load).all() or equation.floating:
        return ()
    listed = any(isinstance(value, tuple) for value in vars(circuit).values())
    if not listed:
        return _unseen(circuit, min(rows, MAX_LINES), min(columns, MAX_LINES))
    return _unseen(circuit, rows, columns) if rows * columns <= MAX_CELLS else ()


@lru_cache(maxsize=64)
def _unseen(circuit: SolvableCircuit, rows: int, columns: int) -> tuple[Scale, ...]:
    """Return the scales of a circuit that lie in the null space of its Jacobian at random cells.

    A scale is unseen if more than WITHIN of the square of each of its directions lies there.
    """
    scatter = SCATTER * np.random.default_rng(1).standard_normal((rows, columns))
    cells = TYPICAL_OHM * np.exp(scatter)
    # An orthonormal basis of the directions of ln r that no reading shows
    _, singular, basis = np.linalg.svd(circuit.network(cells, circuit.ties(cells)).sensitivity())
    null = basis[singular <= NULL * singular[0]]
    # Directions of each scale, (cells, directions)
    scales: dict[Scale, Array] = {
        "all": np.ones((cells.size, 1)),
        "rows": np.repeat(np.eye(rows), columns, axis=0),
        "columns": np.tile(np.eye(columns), (rows, 1)),
    }
    return tuple(
        name
        for name, along in scales.items()
        if np.all(np.sum((null @ along) ** 2, axis=0) > WITHIN * np.sum(along**2, axis=0))
    )


def unseen_sentence(scales: tuple[str, ...]) -> str:
    """Return the scales in words, with the cure; '' for none."""
    if not scales:
        return ""
    of_lines = " and ".join(name for name in scales if name != "all")
    scale = f"each of the {of_lines} has a scale of its own" if of_lines else "all cells share one"
    return (
        f"{scale} that no reading shows: no resistor sets it; only ratios of cells within them "
        "are known, and a resistor from each sensed line to ground (load_ohm) would show it"
    )
