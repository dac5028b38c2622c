"""One voltage pattern for each measured pixel, as the paper argues."""

from dataclasses import dataclass
from typing import Literal

import casadi
import numpy as np

from lampest.files.errors import InputError
from lampest.panel.kirchhoff import current_balance
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout, TwoPointReadout
from lampest.solvers.ipopt.formulation import Formulation, NetworkSymbols


@dataclass(frozen=True)
class PerPixel(Formulation):
    """R_jk = V_j − V^k while a unit current enters row j and leaves column k; paper, equations (5)-(9)."""

    kind: Literal["per_pixel"] = "per_pixel"

    def check(self, readout: Readout) -> None:
        """Raise InputError for a readout other than two_point, whose patterns these are."""
        if not isinstance(readout, TwoPointReadout):
            raise InputError("formulation: per_pixel knows readout.kind: two_point only; nodal and reduced know all")

    def network(
        self, readout: Readout, conductance: casadi.SX, tie: casadi.SX, scale: casadi.SX, prefix: str
    ) -> NetworkSymbols:
        """(rows + columns)·cells voltages and as many current balances."""
        rows, columns = conductance.shape
        cells = rows * columns
        row_potential = casadi.SX.sym(f"{prefix}row", rows, cells)
        column_potential = casadi.SX.sym(f"{prefix}column", columns, cells)
        from_rows, from_columns = current_balance(conductance, row_potential, column_potential)
        row, column = np.divmod(np.arange(cells), columns)
        every = np.arange(cells)
        into_rows = casadi.DM.triplet(row.tolist(), every.tolist(), [1.0] * cells, rows, cells)
        into_columns = casadi.DM.triplet(column.tolist(), every.tolist(), [1.0] * cells, columns, cells)
        from_rows += casadi.diag(tie[:rows]) @ row_potential - into_rows
        from_columns += casadi.diag(tie[rows:]) @ column_potential + into_columns
        seen = casadi.sum1(into_rows * row_potential) - casadi.sum1(into_columns * column_potential)
        return NetworkSymbols(
            casadi.vec(casadi.vertcat(row_potential, column_potential)),
            casadi.vec(casadi.vertcat(from_rows, from_columns)),
            scale * seen.T,
        )

    def potentials(self, readout: Readout, network: Network) -> Array:
        """Z b for every pixel's current pattern b, one after the other."""
        rows, impedance = network.rows, network.potentials()
        pattern = impedance[:, :rows][:, :, None] - impedance[:, rows:][:, None, :]
        return pattern.reshape(len(impedance), -1).T.ravel()

    def multipliers(self, readout: Readout, network: Network, tie: Array, slope: Array) -> Array:
        """λ = −Z ∂φ/∂V, pattern by pattern."""
        impedance = network.potentials()
        return -(slope.reshape(-1, len(impedance)) @ impedance).ravel()
