"""Laws of readings: a reading as a function of the entries of its network.

    y = h(p, q, t),   p = K_jj, q = K_kk, t = K_jk

K is the impedance of a panel's lines, or has the entries of `DifferenceNetwork`. Where idle lines
end in potentials, x is the excitation of all lines by them, and a reading depends on v = K·x, too:
y = h(p, q, t, e, f) with e = v_j and f = v_k. As v is linear in K, nothing new enters the
derivatives.

For weights w of the readings, d(Σ w y) = tr(W dK) with W = [[diag Σ_k w h_p, ½ w h_t], [·, diag
Σ_j w h_q]]. With w_v the weights of v, W becomes W + ½(x w_vᵀ + w_v xᵀ).
"""

from collections.abc import Hashable
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import product
from typing import Any, Protocol

import numpy as np

from lampest.panel.compiled import Compiled, guarded
from lampest.panel.kirchhoff import line_sums
from lampest.panel.panel import Array

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


class ReadCircuit(Hashable, Protocol):
    """Interface of a readout for a law; see `lampest.panel.readouts.readout.Readout`."""

    def reading(self, row: Any, column: Any, mutual: Any, *potentials: Any) -> Any:
        """Return h(K_jj, K_kk, K_jk), or h(K_jj, K_kk, K_jk, v_j, v_k) with potentials."""


@dataclass(frozen=True)
class Law:
    """Law h of the readings of a network.

    CasADi differentiates the equation of a readout. The derivatives are compiled once for each
    equation and panel size, for readings of the whole panel.

    Attributes
    ----------
    readout : ReadCircuit or None
        Readout that defines h. None: two-point readings R_jk = Z_jj + Z_kk − 2 Z_jk in ohm, whose h
        has no curvature.
    """

    readout: ReadCircuit | None

    @property
    def two_point(self) -> bool:
        """Whether h = p + q − 2t."""
        return self.readout is None

    def read(self, entries: Entries, shape: tuple[int, ...]) -> Array:
        """Return h of the entries, (…, rows, columns)."""
        if self.readout is None:
            return across(entries)
        reading = self.readout.reading(*entries)
        return reading if reading.shape == shape else np.array(np.broadcast_to(reading, shape))

    def slopes(self, entries: Entries, shape: tuple[int, ...]) -> Entries:
        """Return the first derivatives (h_p, h_q, h_t), or (h_p, h_q, h_t, h_e, h_f)."""
        if self.readout is None:
            return TWO_POINT_SLOPES
        return tuple(self._derivatives(self.readout, 1, entries, shape))

    def curvatures(self, entries: Entries, shape: tuple[int, ...]) -> Array | None:
        """Return the second derivatives, (entries, entries, …, rows, columns).

        The result is None if h is linear.
        """
        if self.readout is None:
            return None
        derivatives = self._derivatives(self.readout, 2, entries, shape)
        return derivatives.reshape(len(entries), len(entries), *shape)

    def change(self, slopes: Entries, change: Entries) -> Array:
        """Return h_p·dp + h_q·dq + h_t·dt, (…, rows, columns)."""
        if self.readout is None:
            return across(change)
        row, column, *others = (slope * part for slope, part in zip(slopes, change, strict=True))
        return np.asarray(sum(others, row + column))

    def loading(self, slopes: Entries, weights: Array) -> Loading:
        """Return W of weights (…, rows, columns) of the readings.

        Of two-point readings it is L_w, the Laplacian with the weights as conductances.
        """
        if self.readout is None:
            return Loading(line_sums(weights), -weights)
        return loading_of(*(weights * slope for slope in slopes))

    @staticmethod
    def _derivatives(
        readout: ReadCircuit, order: int, entries: Entries, shape: tuple[int, ...]
    ) -> Array:
        """Return all derivatives of h of an order, (derivatives, …, rows, columns)."""
        if len(shape) > 2:
            each = (
                Law._derivatives(readout, order, tuple(part[number] for part in entries), shape[1:])
                for number in range(shape[0])
            )
            return np.stack(list(each), axis=1)
        every = np.empty((len(entries), *shape))
        for number, part in enumerate(entries):
            every[number] = part
        derivatives = equation_derivatives(readout, *shape, len(entries), order)
        return derivatives(every).reshape(-1, *shape)


TWO_POINT = Law(None)


@guarded
@lru_cache(maxsize=64)
def equation_derivatives(
    readout: ReadCircuit, rows: int, columns: int, count: int, order: int
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
    reading = readout.reading(*(casadi.reshape(entry, columns, rows).T for entry in flat))

    @cache
    def derivative(*by: int) -> Any:
        """Return the derivative by the entries of these numbers, flat.

        Every reading depends on its own entries only: along a change of all entries by one it is
        elementwise.
        """
        if not by:
            return casadi.vec(casadi.densify(reading).T)
        return casadi.jtimes(derivative(*by[:-1]), flat[by[-1]], ones)

    names = product(range(count), repeat=order)
    # h_pq = h_qp
    listed = (casadi.densify(derivative(*sorted(numbers))) for numbers in names)
    stacked = casadi.cse(casadi.vertcat(*listed))
    (of_every,) = casadi.substitute([stacked], flat, casadi.vertsplit(every, size))
    return Compiled(casadi.Function("derivatives", [every], [of_every]))


def across(entries: Entries) -> Array:
    """Return bᵀ K b = K_jj + K_kk − 2 K_jk of every cell, (…, rows, columns)."""
    row, column, mutual, *_ = entries
    return np.asarray(row + column - 2 * mutual)


def loading_of(row: Array, column: Array, mutual: Array, *of_sources: Array) -> Loading:
    """Return W from weights of K_jj, K_kk and K_jk, each (…, rows, columns).

    With potentials those of v_j and v_k follow.
    """
    return Loading(_sums(row, column), mutual / 2, _sums(*of_sources) if of_sources else None)


def _sums(row: Array, column: Array) -> Array:
    """Return the sums of weights of rows, and of columns, over the readings of every line."""
    return np.concatenate([row.sum(axis=-1), column.sum(axis=-2)], axis=-1)
