"""One voltage pattern for each line: a unit current into every line instead of one for every measured pixel."""

from dataclasses import dataclass
from typing import Any, Literal

import casadi
import numpy as np

from lampest.panel.network import Network, current_balance
from lampest.panel.panel import Array, Panel
from lampest.solvers.ipopt.formulation import Formulation, NetworkSymbols


@dataclass(frozen=True)
class Nodal(Formulation):
    """R_jk = Z_jj + Z_kk − 2 Z_jk, where column c of Z holds the potentials for a unit current into line c.

    Z is symmetric, so only its half is unknown. Call the shorter side of the panel the driven one, the other the far
    one. What one far line sees when another far line is driven is read by no measurement and follows from the rest, so
    it is no unknown either. With n driven and m far lines n(n + 1)/2 + mn + m voltages remain, as many as equations.
    """

    kind: Literal["nodal"] = "nodal"

    def network(self, panel: Panel, conductance: casadi.SX, tie: casadi.SX, prefix: str) -> NetworkSymbols:
        """Drive the lines of the shorter side; a far line's own impedance closes its balance when it is driven."""
        far, driven = sorted(panel.shape, reverse=True)
        swapped = _swapped(panel.shape)
        cells = conductance.T if swapped else conductance
        tie_far, tie_driven = (casadi.diag(part) for part in _sides(tie, panel.shape))
        half = casadi.SX.sym(f"{prefix}driven_driven", driven * (driven + 1) // 2)
        mixed = casadi.SX.sym(f"{prefix}far_driven", far * driven)
        own = casadi.SX.sym(f"{prefix}far_far", far)
        near_potential = casadi.reshape(half[_symmetric(driven)], driven, driven)
        far_potential = casadi.reshape(mixed, driven, far).T

        from_far, from_driven = current_balance(cells, far_potential, near_potential)
        from_far += tie_far @ far_potential
        from_driven += tie_driven @ near_potential - casadi.DM.eye(driven)
        from_own, _ = current_balance(cells, casadi.diag(own), far_potential.T)
        own_balance = casadi.diag(from_own + tie_far @ casadi.diag(own)) - 1
        lower = casadi.vertcat(*(from_driven[line, : line + 1].T for line in range(driven)))

        own_sum = casadi.repmat(own, 1, driven) + casadi.repmat(casadi.diag(near_potential).T, far, 1)
        resistance = own_sum - 2 * far_potential
        return NetworkSymbols(
            casadi.vertcat(half, mixed, own),
            casadi.vertcat(lower, casadi.vec(from_far.T), own_balance),
            casadi.vec(resistance if swapped else resistance.T),
        )

    def potentials(self, network: Network) -> Array:
        """Half of the driven block, the far-driven block and the diagonal of the far block of Z."""
        far, driven = _sides(np.arange(len(network.impedance)), network.conductance.shape)
        half = network.impedance[np.ix_(driven, driven)][np.tril_indices(len(driven))]
        mixed = network.impedance[np.ix_(far, driven)]
        return np.concatenate([half, mixed.ravel(), np.diag(network.impedance)[far]])


def _swapped(shape: tuple[int, ...]) -> bool:
    """Whether the rows are the driven lines."""
    return shape[0] < shape[1]


def _sides(lines: Any, shape: tuple[int, ...]) -> tuple[Any, Any]:
    """(far, driven) parts of something that is numbered rows first, then columns."""
    rows, columns = lines[: shape[0]], lines[shape[0] :]
    return (columns, rows) if _swapped(shape) else (rows, columns)


def _symmetric(size: int) -> list[int]:
    """Numbers of the entries of a symmetric matrix in its packed lower half, size² of them."""
    index = np.zeros((size, size), dtype=int)
    index[np.tril_indices(size)] = np.arange(size * (size + 1) // 2)
    return [int(number) for number in np.maximum(index, index.T).ravel()]
