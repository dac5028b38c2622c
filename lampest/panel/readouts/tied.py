"""Networks with tied lines and any reading y = h(Z_jj, Z_kk, Z_jk), with derivatives of h by CasADi."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from lampest.panel.compiled import Compiled, guarded
from lampest.panel.network import Entries, Network, ReadCircuit
from lampest.panel.panel import Array

# Outputs of `equation_derivatives` for h(p, q, t), p = Z_jj, q = Z_kk, t = Z_jk, in this order.
SLOPES = ("p", "q", "t")
CURVATURES = ("pp", "pq", "pt", "qq", "qt", "tt")


@dataclass(frozen=True, eq=False)
class TiedNetwork(Network):
    """Network whose readings are an equation of a readout.

    Attributes
    ----------
    readout : ReadCircuit
        Readout that defines h.
    """

    readout: ReadCircuit

    def read(self, entries: Entries) -> Array:
        return np.asarray(np.broadcast_to(self.readout.reading(*entries), self.conductance.shape))

    @cached_property
    def _derivatives(self) -> dict[str, Array]:
        """First and second derivatives of h by name, (rows, columns) each."""
        shape = self.conductance.shape
        entries = (np.broadcast_to(part, shape).ravel() for part in self.entries(self._impedance))
        values = equation_derivatives(self.readout, *shape)(*entries).reshape(-1, *shape)
        return dict(zip((*SLOPES, *CURVATURES), values, strict=True))

    @property
    def slopes(self) -> Entries:
        return self._derivatives["p"], self._derivatives["q"], self._derivatives["t"]

    @cached_property
    def curvatures(self) -> dict[str, Array]:
        return {name: self._derivatives[name] for name in CURVATURES if self._derivatives[name].any()}


@guarded
@lru_cache(maxsize=64)
def equation_derivatives(readout: ReadCircuit, rows: int, columns: int) -> Compiled:
    """Return the function of p, q and t, flat (rows · columns) each, with the outputs SLOPES and CURVATURES, flat."""
    import casadi

    flat = {name: casadi.SX.sym(name, rows * columns) for name in SLOPES}
    reading = readout.reading(*(casadi.reshape(entry, columns, rows).T for entry in flat.values()))
    # Every reading depends on its own entries only, so the gradient of the sum contains the elementwise derivatives.
    total = casadi.sum1(casadi.vec(casadi.densify(reading).T))
    slopes = {name: casadi.gradient(total, entry) for name, entry in flat.items()}
    seconds = [casadi.gradient(casadi.sum1(slopes[name[0]]), flat[name[1]]) for name in CURVATURES]
    parts = casadi.vertcat(*(casadi.densify(part) for part in (*slopes.values(), *seconds)))
    return Compiled(casadi.Function("derivatives", list(flat.values()), [parts]))


@guarded
@lru_cache(maxsize=64)
def reads_own(readout: ReadCircuit, rows: int, columns: int) -> tuple[bool, bool]:
    """Return whether the reading depends on the rows' impedances Z_jj, and whether on the columns' Z_kk."""
    import casadi

    row, column, mutual = (casadi.SX.sym(name, rows, columns) for name in SLOPES)
    reading = readout.reading(row, column, mutual)
    return bool(casadi.depends_on(reading, row)), bool(casadi.depends_on(reading, column))
