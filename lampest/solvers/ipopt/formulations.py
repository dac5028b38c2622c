"""Formulations of the network equations with node voltages as decision variables: nodal, and per pixel."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Literal

import casadi
import numpy as np

from lampest.files.errors import InputError
from lampest.panel.kirchhoff import current_balance
from lampest.panel.network import Network, reads_own
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout, TwoPointReadout


@dataclass(frozen=True, eq=False)
class NetworkSymbols:
    """Symbols of one frame's network.

    Attributes
    ----------
    potentials : casadi.SX, shape (n, 1)
        Node voltages for unit currents, the unknowns.
    balance : casadi.SX, shape (n, 1)
        Kirchhoff's current law; zero at a solution, bilinear in conductances and potentials.
    reading : casadi.SX, shape (cells, 1)
        Modelled readings, row-major, in the readout's unit.
    """

    potentials: casadi.SX
    balance: casadi.SX
    reading: casadi.SX


class Formulation(ABC):
    """Node voltages as decision variables, Kirchhoff's current law as constraints."""

    @abstractmethod
    def network(
        self, readout: Readout, conductance: casadi.SX, tie: casadi.SX, scale: casadi.SX, prefix: str
    ) -> NetworkSymbols:
        """Return variables and equations of one frame's network.

        Parameters
        ----------
        readout : Readout
        conductance : casadi.SX, shape (rows, columns)
            Conductances in 1/`scale`.
        tie : casadi.SX, shape (rows + columns, 1)
            Ties of the lines to ground in 1/`scale`.
        scale : casadi.SX
            Unit of resistances in ohm; potentials for unit currents have the same unit.
        prefix : str
            Begin of the names of the symbols.
        """

    @abstractmethod
    def potentials(self, readout: Readout, network: Network) -> Array:
        """Return the values of `NetworkSymbols.potentials` in a solved network, in ohm."""

    @abstractmethod
    def multipliers(self, readout: Readout, network: Network, tie: Array, slope: Array) -> Array:
        """Return the multipliers λ of `NetworkSymbols.balance` in a solved network, (n,).

        They solve ∂φ/∂V + λᵀ ∂balance/∂V = 0, V the `potentials`.

        Parameters
        ----------
        readout : Readout
        network : Network
        tie : array, shape (lines,)
            Ties to ground, siemens.
        slope : array, shape (n,)
            ∂φ/∂V, 1/ohm.

        Raises
        ------
        numpy.linalg.LinAlgError
            If double precision does not suffice.
        """

    def check(self, readout: Readout) -> None:  # noqa: B027 - most formulations know all readouts
        """Raise InputError for a readout that the formulation cannot express."""


@dataclass(frozen=True)
class Nodal(Formulation):
    """Nodal formulation: y_jk = h(Z_jj, Z_kk, Z_jk), column c of Z the potentials for a unit current into line c.

    The n lines of the shorter side are driven, the m others are far. Unknowns are half of the symmetric driven block
    of Z, the far-driven block, and the diagonal of the far block where the readout reads it: n(n + 1)/2 + mn + m.
    """

    kind: Literal["nodal"] = "nodal"

    def network(
        self, readout: Readout, conductance: casadi.SX, tie: casadi.SX, scale: casadi.SX, prefix: str
    ) -> NetworkSymbols:
        far, driven = sorted(conductance.shape, reverse=True)
        swapped = conductance.shape[0] < conductance.shape[1]
        cells = conductance.T if swapped else conductance
        ties = [casadi.diag(part) for part in casadi.vertsplit(tie, [0, conductance.shape[0], tie.shape[0]])]
        tie_far, tie_driven = _far_first(ties, conductance.shape)
        # Unknowns: Z_dd (upper half), Z_fd, and diag(Z_ff).
        half = casadi.SX.sym(f"{prefix}driven_driven", driven * (driven + 1) // 2)
        mixed = casadi.SX.sym(f"{prefix}far_driven", far * driven)
        own = casadi.SX.sym(f"{prefix}far_far", far)
        near_potential = casadi.triu2symm(casadi.SX(casadi.Sparsity.upper(driven), half))
        far_potential = casadi.reshape(mixed, driven, far).T

        # L·Z = 1: (far, driven) block zero, (driven, driven) block 1 by its lower half, diagonal of the far block 1
        from_far, from_driven = current_balance(cells, far_potential, near_potential)
        from_far += tie_far @ far_potential
        from_driven += tie_driven @ near_potential - casadi.DM.eye(driven)
        from_own, _ = current_balance(cells, casadi.diag(own), far_potential.T)
        own_balance = casadi.diag(from_own + tie_far @ casadi.diag(own)) - 1
        lower = casadi.vertcat(*(from_driven[line, : line + 1].T for line in range(driven)))

        # Z_jj and Z_kk of every cell in the order (rows, columns) of the readout
        of_far, of_driven = casadi.repmat(own, 1, driven), casadi.repmat(casadi.diag(near_potential).T, far, 1)
        entries = [of_driven.T, of_far.T, far_potential.T] if swapped else [of_far, of_driven, far_potential]
        inner, outer = (1, scale) if readout.homogeneous else (scale, 1)
        reading = outer * readout.reading(*(inner * entry for entry in entries))
        reads_far, _ = _far_first(reads_own(readout, *conductance.shape), conductance.shape)
        return NetworkSymbols(
            casadi.vertcat(half, mixed, *([own] if reads_far else [])),
            casadi.vertcat(lower, casadi.vec(from_far.T), *([own_balance] if reads_far else [])),
            casadi.vec(reading.T),
        )

    def potentials(self, readout: Readout, network: Network) -> Array:
        """Return half of the driven block, the far-driven block and, if read, the diagonal of the far block of Z."""
        impedance, shape = network.potentials(), network.conductance.shape
        far, driven = _far_first(np.split(np.arange(len(impedance)), [shape[0]]), shape)
        half = impedance[np.ix_(driven, driven)][np.tril_indices(len(driven))]
        own = np.diag(impedance)[far if _far_first(reads_own(readout, *shape), shape)[0] else []]
        return np.concatenate([half, impedance[np.ix_(far, driven)].ravel(), own])

    def multipliers(self, readout: Readout, network: Network, tie: Array, slope: Array) -> Array:
        """Return λ of the lower half of S·Z_d = 1, then λ of the far lines; S = Z_d⁻¹ is the Schur complement.

        F contains the slopes of φ in Z_d, including those through the far lines. The multipliers Λ of the driven lines
        solve SΛ + (SΛ)ᵀ = −F. With the Cholesky factor Z_d = HHᵀ this is triangular: H⁻¹ΛH + (H⁻¹ΛH)ᵀ = −HᵀFH.
        """
        impedance, shape = network.potentials(), network.conductance.shape
        far, driven = _far_first(np.split(np.arange(len(impedance)), [shape[0]]), shape)
        cells = network.conductance.T if shape[0] < shape[1] else network.conductance
        leaving = cells.sum(axis=1) + tie[far]
        rows, columns = np.tril_indices(len(driven))
        half, mixed, own = np.split(slope, [len(rows), len(rows) + cells.size])
        # F: slopes in Z_d, plus those in Z_fd and diag(Z_ff) through the balance of the far lines.
        through = mixed.reshape(cells.shape)
        if len(own):
            through = through + cells * (own / leaving)[:, None]
        slopes = (cells / leaving[:, None]).T @ through
        slopes[rows, columns] += half
        # Λ from H⁻¹ΛH = −(half of the diagonal, and the strict lower triangle, of HᵀFH)
        root = np.linalg.cholesky(impedance[np.ix_(driven, driven)])
        turned = root.T @ (slopes + slopes.T) @ root
        triangle = np.diag(turned.diagonal() / 2) - np.tril(turned)
        of_driven = np.linalg.solve(root.T, (root @ triangle).T).T
        # Multipliers of the far lines from the stationarity in Z_fd.
        of_far = (cells @ of_driven - through) / leaving[:, None]
        return np.concatenate([of_driven[rows, columns], of_far.ravel(), -own / leaving[: len(own)]])


def _far_first(sides: Any, shape: tuple[int, ...]) -> Any:
    """Return the pair (rows, columns) of values as (far, driven): the longer side is far."""
    return sides if shape[0] >= shape[1] else sides[::-1]


@dataclass(frozen=True)
class PerPixel(Formulation):
    """Per-pixel formulation of the paper, equations (5)-(9).

    R_jk = V_j − V^k while a unit current enters row j and leaves column k.
    """

    kind: Literal["per_pixel"] = "per_pixel"

    def check(self, readout: Readout) -> None:
        """Raise InputError for a readout other than two_point, whose patterns these are."""
        if not isinstance(readout, TwoPointReadout):
            raise InputError("formulation: per_pixel knows readout.kind: two_point only; nodal and reduced know all")

    def network(
        self, readout: Readout, conductance: casadi.SX, tie: casadi.SX, scale: casadi.SX, prefix: str
    ) -> NetworkSymbols:
        """Return (rows + columns)·cells voltages and as many current balances; see `Formulation.network`."""
        rows, columns = conductance.shape
        row_potential = casadi.SX.sym(f"{prefix}row", rows, rows * columns)
        column_potential = casadi.SX.sym(f"{prefix}column", columns, rows * columns)
        from_rows, from_columns = current_balance(conductance, row_potential, column_potential)
        # Unit currents of pattern c = (j, k), one column for each cell: into row j, out of column k.
        into_rows = casadi.kron(casadi.DM.eye(rows), casadi.DM.ones(1, columns))
        into_columns = casadi.kron(casadi.DM.ones(1, rows), casadi.DM.eye(columns))
        from_rows += casadi.diag(tie[:rows]) @ row_potential - into_rows
        from_columns += casadi.diag(tie[rows:]) @ column_potential + into_columns
        read = casadi.sum1(into_rows * row_potential) - casadi.sum1(into_columns * column_potential)
        return NetworkSymbols(
            casadi.vec(casadi.vertcat(row_potential, column_potential)),
            casadi.vec(casadi.vertcat(from_rows, from_columns)),
            scale * read.T,
        )

    def potentials(self, readout: Readout, network: Network) -> Array:
        rows, impedance = network.rows, network.potentials()
        pattern = impedance[:, :rows][:, :, None] - impedance[:, rows:][:, None, :]
        return pattern.reshape(len(impedance), -1).T.ravel()

    def multipliers(self, readout: Readout, network: Network, tie: Array, slope: Array) -> Array:
        """Return λ = −Z ∂φ/∂V, pattern by pattern; see `Formulation.multipliers`."""
        impedance = network.potentials()
        return -(slope.reshape(-1, len(impedance)) @ impedance).ravel()


FORMULATIONS: dict[str, Formulation] = {form.kind: form for form in (Nodal(), PerPixel())}
