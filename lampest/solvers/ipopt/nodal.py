"""One voltage pattern for each line: a unit current into every line instead of one for every measured pixel."""

from dataclasses import dataclass
from typing import Any, Literal

import casadi
import numpy as np

from lampest.panel.kirchhoff import current_balance
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.panel.readouts.equation import reads_own
from lampest.solvers.ipopt.formulation import Formulation, NetworkSymbols


@dataclass(frozen=True)
class Nodal(Formulation):
    """y_jk = h(Z_jj, Z_kk, Z_jk), where column c of Z holds the potentials for a unit current into line c.

    Z is symmetric, so only its half is unknown. Call the shorter side of the panel the driven one, the other the far
    one. What one far line sees when another far line is driven is read by no measurement and follows from the rest, so
    it is no unknown either, nor is a far line's own potential where the readout does not ask for it. With n driven and
    m far lines n(n + 1)/2 + mn + m voltages remain, as many as equations.
    """

    kind: Literal["nodal"] = "nodal"

    def network(
        self, readout: Readout, conductance: casadi.SX, tie: casadi.SX, scale: casadi.SX, prefix: str
    ) -> NetworkSymbols:
        """Drive the lines of the shorter side; a far line's own impedance closes its balance when it is driven."""
        far, driven = sorted(conductance.shape, reverse=True)
        swapped = _swapped(conductance.shape)
        cells = conductance.T if swapped else conductance
        tie_far, tie_driven = (casadi.diag(part) for part in _sides(tie, conductance.shape))
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

        of_far, of_driven = casadi.repmat(own, 1, driven), casadi.repmat(casadi.diag(near_potential).T, far, 1)
        entries = [of_driven.T, of_far.T, far_potential.T] if swapped else [of_far, of_driven, far_potential]
        reads_far = _reads_far(readout, conductance.shape)
        unknown, balance = [half, mixed], [lower, casadi.vec(from_far.T)]
        return NetworkSymbols(
            casadi.vertcat(*unknown, *([own] if reads_far else [])),
            casadi.vertcat(*balance, *([own_balance] if reads_far else [])),
            casadi.vec(_scaled_reading(readout, entries, scale).T),
        )

    def potentials(self, readout: Readout, network: Network) -> Array:
        """Half of the driven block, the far-driven block and, if read, the diagonal of the far block of Z."""
        impedance, shape = network.potentials(), network.conductance.shape
        far, driven = _sides(np.arange(len(impedance)), shape)
        half = impedance[np.ix_(driven, driven)][np.tril_indices(len(driven))]
        mixed = impedance[np.ix_(far, driven)]
        own = np.diag(impedance)[far if _reads_far(readout, shape) else []]
        return np.concatenate([half, mixed.ravel(), own])

    def multipliers(self, readout: Readout, network: Network, tie: Array, slope: Array) -> Array:
        """λ of the lower half of S·Z_d = 1, then of the far lines; S = Z_d⁻¹ is what the driven lines see.

        With slopes F of φ in Z_d, what far lines add included, the half Λ of driven lines obeys SΛ + (SΛ)ᵀ = −F, which
        Z_d = HHᵀ makes triangular: H⁻¹ΛH + (H⁻¹ΛH)ᵀ = −HᵀFH.
        """
        impedance, shape = network.potentials(), network.conductance.shape
        far, driven = _sides(np.arange(len(impedance)), shape)
        cells = network.conductance.T if _swapped(shape) else network.conductance
        leaving = cells.sum(axis=1) + tie[far]
        rows, columns = np.tril_indices(len(driven))
        half, mixed, own = np.split(slope, [len(rows), len(rows) + cells.size])
        through = mixed.reshape(cells.shape)
        if len(own):
            through = through + cells * (own / leaving)[:, None]
        slopes = (cells / leaving[:, None]).T @ through
        slopes[rows, columns] += half
        root = np.linalg.cholesky(impedance[np.ix_(driven, driven)])
        turned = root.T @ (slopes + slopes.T) @ root
        triangle = np.diag(turned.diagonal() / 2) - np.tril(turned)
        of_driven = np.linalg.solve(root.T, (root @ triangle).T).T
        of_far = (cells @ of_driven - through) / leaving[:, None]
        return np.concatenate([of_driven[rows, columns], of_far.ravel(), -own / leaving[: len(own)]])


def _scaled_reading(readout: Readout, entries: list[casadi.SX], scale: casadi.SX) -> casadi.SX:
    """h of entries of Z in units of `scale`, (rows, columns)."""
    if readout.homogeneous:
        return casadi.SX(scale * readout.reading(*entries))
    return casadi.SX(readout.reading(*(scale * entry for entry in entries)))


def _reads_far(readout: Readout, shape: tuple[int, ...]) -> bool:
    """Whether the reading asks for the far lines' own impedances."""
    row, column = reads_own(readout, *shape)
    return column if _swapped(shape) else row


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
