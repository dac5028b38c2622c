"""Conductance between a line and the next one of its side, as water makes it: a low-rank change of Z."""

from collections.abc import Sequence

import numpy as np

from lampest.panel.network import Network, ReadCircuit
from lampest.panel.panel import Array


def neighbours(rows: int, columns: int) -> tuple[int, ...]:
    """Every line that has a next one on its side, rows first."""
    return tuple(line for line in range(rows + columns - 1) if line != rows - 1)


def leak_effect(circuit: ReadCircuit, network: Network, lines: Sequence[int], siemens: float) -> Array:
    """What conductances between each of the lines and the next one do to the readings, (rows, columns).

    Z − Z B (1/G + Bᵀ Z B)⁻¹ Bᵀ Z, B the incidence vectors of the pairs (Woodbury).
    """
    rows, count = network.rows, sum(network.conductance.shape)
    each = np.eye(count)
    across = each[:, list(lines)] - each[:, [line + 1 for line in lines]]
    towards = network.potentials() @ across
    core = np.linalg.inv(np.eye(len(lines)) + siemens * across.T @ towards)
    wet = network.potentials() - siemens * towards @ core @ towards.T
    own = np.diag(wet)
    return np.asarray(circuit.reading(own[:rows, None], own[None, rows:], wet[:rows, rows:]) - network.reading())
