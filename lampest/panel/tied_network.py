"""Networks whose readings are an equation h(p, q, t) of a readout.

CasADi differentiates h: once for each equation and panel size, for readings of the whole panel.
"""

from collections.abc import Hashable
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from itertools import combinations_with_replacement, product
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lampest.panel.compiled import Compiled, guarded
from lampest.panel.network import ENTRY_NAMES, Entries, Network
from lampest.panel.panel import Array


class ReadCircuit(Hashable, Protocol):
    """Interface of a readout for a network; see `lampest.panel.readouts.readout.Readout`."""

    def reading(self, row: Any, column: Any, mutual: Any, *potentials: Any) -> Any:
        """Return h(Z_jj, Z_kk, Z_jk), or h(Z_jj, Z_kk, Z_jk, v_j, v_k) with potentials."""


def slope_names(*, with_potentials: bool) -> tuple[str, ...]:
    """Return the names of the entries of which h is a function; see `ENTRY_NAMES`."""
    return tuple(ENTRY_NAMES if with_potentials else ENTRY_NAMES[:3])


def curvature_names(*, with_potentials: bool) -> tuple[str, ...]:
    """Return the names of the second derivatives of h: 'pp', 'pq', and so on."""
    names = slope_names(with_potentials=with_potentials)
    return tuple(map("".join, combinations_with_replacement(names, 2)))


@cache
def curvature_places(*, with_potentials: bool) -> NDArray[np.intp]:
    """Return the place of h_pq among `curvature_names`, (entries, entries), where h_pq = h_qp."""
    entries = slope_names(with_potentials=with_potentials)
    names = curvature_names(with_potentials=with_potentials)
    places = np.empty((len(entries), len(entries)), dtype=np.intp)
    for (first, p), (second, q) in product(enumerate(entries), repeat=2):
        places[first, second] = names.index(p + q if first <= second else q + p)
    return places


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

    def _derivatives(self, names: tuple[str, ...]) -> Array:
        """Return derivatives of h, (names, rows, columns)."""
        shape = self.conductance.shape
        entries = (np.broadcast_to(part, shape).ravel() for part in self.entries(self._impedance))
        derivatives = equation_derivatives(self.readout, *shape, names)
        return derivatives(*entries).reshape(-1, *shape)

    @cached_property
    def slopes(self) -> Entries:
        return tuple(self._derivatives(slope_names(with_potentials=self.sources is not None)))

    @cached_property
    def curvatures(self) -> Array:
        several = self.sources is not None
        derivatives = self._derivatives(curvature_names(with_potentials=several))
        return np.asarray(derivatives[curvature_places(with_potentials=several)])


@guarded
@lru_cache(maxsize=64)
def equation_derivatives(
    readout: ReadCircuit, rows: int, columns: int, names: tuple[str, ...]
) -> Compiled:
    """Return the function of the entries with the named derivatives of h, flat.

    The entries are flat, (rows · columns) each.
    """
    import casadi

    # Expressions of whole arrays: their number does not grow with the panel.
    entries = slope_names(with_potentials=bool(set("".join(names)) & set(ENTRY_NAMES[3:])))
    flat = {name: casadi.MX.sym(name, rows * columns) for name in entries}
    reading = readout.reading(*(casadi.reshape(entry, columns, rows).T for entry in flat.values()))
    every = casadi.DM.ones(rows * columns)

    @cache
    def derivative(name: str) -> Any:
        """Return the derivative by the entries that `name` lists, flat.

        Every reading depends on its own entries only: along a change of all entries by one it is
        elementwise.
        """
        shorter: casadi.MX = (
            derivative(name[:-1]) if name else casadi.vec(casadi.densify(reading).T)
        )
        return casadi.jtimes(shorter, flat[name[-1]], every) if name else shorter

    stacked = casadi.cse(casadi.vertcat(*(casadi.densify(derivative(name)) for name in names)))
    return Compiled(casadi.Function("derivatives", list(flat.values()), [stacked]))
