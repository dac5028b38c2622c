"""Laws of readings: a reading as a function of the entries of its network.

    y = h(p, q, t),   p = K_jj, q = K_kk, t = K_jk

K is the impedance of a panel's lines, or has the entries of `DifferenceNetwork`. Where idle lines
end in potentials, x is the excitation of all lines by them, and a reading depends on v = K·x, too:
y = h(p, q, t, e, f) with e = v_j and f = v_k. As v is linear in K, nothing new enters the
derivatives.

For weights w of the readings, d(Σ w y) = tr(W dK) with W = [[diag Σ_k w h_p, ½ w h_t], [·, diag
Σ_j w h_q]]. With w_v the weights of v, W becomes W + ½(x w_vᵀ + w_v xᵀ).
"""

from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import product
from typing import Any

import numpy as np

from lampest.panel.circuit import CircuitOfLines
from lampest.panel.compiled import Compiled, guarded
from lampest.panel.equation import equation_of
from lampest.panel.kirchhoff import line_sums
from lampest.panel.panel import Array, Shape

ENTRY_NAMES = "pqtef"
TWO_POINT_SLOPES = np.array(1.0), np.array(1.0), np.array(-2.0)
# Values for (p, q, t), or (p, q, t, e, f), to be broadcast to (…, rows, columns)
Entries = tuple[Array, ...]


@dataclass(frozen=True, eq=False)
class Loading:
    """Matrix W of weights of the readings; see the module.

    Attributes
    ----------
    diagonal : array, shape (…, lines)
    between : array, shape (…, rows, columns)
        Block between rows and columns.
    of_potentials : array, shape (…, lines), or None
        w_v, where lines end in potentials.
    """

    diagonal: Array
    between: Array
    of_potentials: Array | None = None


@guarded
@lru_cache(maxsize=64)
def equation_derivatives(
    circuit: CircuitOfLines, rows: int, columns: int, count: int, order: int
) -> Compiled:
    """Return the function of `count` entries with all derivatives of h of an order, flat.

    The argument has the entries one after the other, (rows · columns) each. Second derivatives are
    h_pp, h_pq, and so on, for every two entries.
    """
    import casadi

    # Expressions of whole arrays: their number does not grow with the panel.
    size = rows * columns
    every = casadi.MX.sym("entries", size * count)
    ones = casadi.DM.ones(size)
    flat = [casadi.MX.sym(name, size) for name in ENTRY_NAMES[:count]]
    reading = equation_of(circuit, rows, columns).reading(
        *(casadi.reshape(entry, columns, rows).T for entry in flat)
    )

    @cache
    def derivative(*by: int) -> Any:
        """Return the derivative by the entries of these numbers, flat.

        Every reading depends on its own entries only: along a change of all entries by one it is
        elementwise.
        """
        if not by:
            return casadi.vec(casadi.densify(reading).T)
        return casadi.jtimes(derivative(*by[:-1]), flat[by[-1]], ones)

    # h_pq = h_qp
    every_pair = map(sorted, product(range(count), repeat=order))
    stacked = casadi.cse(casadi.vertcat(*(casadi.densify(derivative(*by)) for by in every_pair)))
    (of_every,) = casadi.substitute([stacked], flat, casadi.vertsplit(every, size))
    return Compiled(casadi.Function("derivatives", [every], [of_every]))


def law_derivatives(circuit: CircuitOfLines, entries: Entries, shape: Shape, order: int) -> Array:
    """Return all derivatives of h of an order, (derivatives, *shape), for readings of a shape."""
    every = all_entries(entries, shape)
    function = equation_derivatives(circuit, *shape[-2:], len(every), order)
    if every.ndim == 3:
        return function(every).reshape(-1, *shape)
    each = (function(every[:, number]) for number in range(shape[0]))
    return np.stack([one.reshape(-1, *shape[1:]) for one in each], axis=1)


def all_entries(parts: Entries, shape: Shape) -> Array:
    """Return entries of the readings as one array, (entries, *shape)."""
    every = np.empty((len(parts), *shape))
    for number, part in enumerate(parts):
        every[number] = part
    return every


def across(entries: Entries) -> Array:
    """Return bᵀ K b = K_jj + K_kk − 2 K_jk of every cell, (…, rows, columns)."""
    row, column, mutual, *_ = entries
    return row + column - 2 * mutual


def loading_of(row: Array, column: Array, mutual: Array, *of_sources: Array) -> Loading:
    """Return W from weights of K_jj, K_kk and K_jk, each (…, rows, columns).

    With potentials those of v_j and v_k follow.
    """
    of_potentials = line_sums(*of_sources) if of_sources else None
    return Loading(line_sums(row, column), mutual / 2, of_potentials)
