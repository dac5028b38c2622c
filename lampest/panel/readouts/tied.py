"""Networks with tied lines and any reading y = h(Z_jj, Z_kk, Z_jk): all derivatives from ties and equation alone.

With weights w of the readings, W = [[diag Σ_k w h_p, ½ w h_t], [·, diag Σ_j w h_q]] makes d(Σ w y) = tr(W dZ).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from lampest.panel.compiled import Compiled
from lampest.panel.kirchhoff import injected
from lampest.panel.network import Network, Numbers, ReadCircuit, SecondOrder
from lampest.panel.panel import Array

# What the compiled equation returns, each (rows, columns): the reading y = h(p, q, t) of p = Z_jj, q = Z_kk, t = Z_jk,
# its slopes, and its second derivatives, in this order.
PARTS = ("y", "p", "q", "t", "pp", "pq", "pt", "qq", "qt", "tt")
Entries = tuple[Array, Array, Array]  # of (p, q, t) = (Z_jj, Z_kk, Z_jk)


@dataclass(frozen=True, eq=False)
class TiedNetwork(Network):
    """readout : states the equation."""

    readout: ReadCircuit

    def reading(self) -> Array:
        """h(Z_jj, Z_kk, Z_jk), without what only its derivatives need."""
        return np.asarray(np.broadcast_to(self.readout.reading(*self._read(self._impedance)), self.conductance.shape))

    @cached_property
    def _equation(self) -> dict[str, Array]:
        """h and its derivatives, each (rows, columns)."""
        shape = self.conductance.shape
        entries = self._read(self._impedance)
        values = compiled_equation(self.readout, *shape)(*(np.broadcast_to(part, shape).ravel() for part in entries))
        return dict(zip(PARTS, values.reshape(len(PARTS), *shape), strict=True))

    def _read(self, matrix: Array) -> Entries:
        """(K_jj, K_kk, K_jk), to be broadcast to (rows, columns)."""
        diagonal, rows = np.diag(matrix), self.rows
        return diagonal[:rows, None], diagonal[None, rows:], matrix[:rows, rows:]

    def _along_slopes(self, row: Array, column: Array, mutual: Array) -> Array:
        """h_p·row + h_q·column + h_t·mutual, (rows, columns)."""
        slopes = self._equation
        return np.asarray(slopes["p"] * row + slopes["q"] * column + slopes["t"] * mutual)

    def _loading(self, row: Array, column: Array, mutual: Array) -> Array:
        """W (lines, lines) from weights of Z_jj, Z_kk and Z_jk, each (rows, columns)."""
        rows = self.rows
        matrix = np.diag(np.concatenate([row.sum(axis=1), column.sum(axis=0)]))
        matrix[:rows, rows:] = mutual / 2
        matrix[rows:, :rows] = mutual.T / 2
        return matrix

    def loading(self, weights: Array) -> Array:
        """W of weights (rows, columns) of the readings."""
        return self._loading(*(weights * self._equation[name] for name in ("p", "q", "t")))

    def forward(self, step: Array) -> Array:
        """h_p dZ_jj + h_q dZ_kk + h_t dZ_jk with dZ = Z L_{g·p} Z."""
        return self.read_change(self._impedance @ injected(self.conductance * step, self._impedance))

    def read_change(self, change: Array) -> Array:
        """What a change of Z (lines, lines) does to the readings, to first order."""
        return self._along_slopes(*self._read(change))

    def adjoint(self, weights: Array) -> Array:
        """g·bᵀ(Z W Z)b."""
        return self.conductance * self._differences(self._impedance, self.loading(weights) @ self._impedance, True)

    @cached_property
    def potential_differences(self) -> Array:
        """D = Z·B (lines, cells) ohm: across every cell for a unit current into every line."""
        across = self._impedance[:, : self.rows, None] - self._impedance[:, None, self.rows :]
        return across.reshape(len(across), -1)

    def entry_responses(self, cells: Numbers | slice = slice(None)) -> Entries:
        """g_c·(D_jc², D_kc², D_jc·D_kc): (rows, cells), (columns, cells), (rows, columns, cells) for some cells."""
        row, column = np.split(self.potential_differences[:, cells], [self.rows])
        conductance = self.conductance.ravel()[cells]
        return row**2 * conductance, column**2 * conductance, row[:, None] * (column * conductance)

    def sensitivity(self, cells: Numbers | None = None, readings: Numbers | None = None) -> Array:
        """h_p ∂Z_jj/∂u + h_q ∂Z_kk/∂u + h_t ∂Z_jk/∂u."""
        row, column, mutual = self.entry_responses(slice(None) if cells is None else cells)
        slopes = [self._equation[name][:, :, None] for name in ("p", "q", "t")]
        response = slopes[2] * mutual
        response += slopes[0] * row[:, None]
        response += slopes[1] * column[None]
        whole: Array = response.reshape(self.conductance.size, row.shape[1])
        return whole if readings is None else whole[readings]

    def _own_differences(self) -> tuple[Array, Array]:
        """(D_jc, D_kc) of every cell c at its own row j and column k, (rows, columns): Z_jj − Z_jk, Z_jk − Z_kk."""
        row, column, mutual = self._read(self._impedance)
        return row - mutual, mutual - column

    def own_response(self) -> Array:
        """The same where a cell meets its own reading."""
        at_row, at_column = self._own_differences()
        return self.conductance * self._along_slopes(at_row**2, at_column**2, at_row * at_column)

    def second_order(self, weights: Array) -> SecondOrder:
        """Through Z twice, and through the curvature of h."""
        return TiedSecondOrder(self, weights)


@dataclass(frozen=True, eq=False)
class TiedSecondOrder:
    """H of weights (rows, columns) at a network, with K = Z W Z."""

    network: TiedNetwork
    weights: Array

    @cached_property
    def loading(self) -> Array:
        """W (lines, lines)."""
        return self.network.loading(self.weights)

    @cached_property
    def _twice(self) -> Array:
        """K (lines, lines)."""
        return self.network._impedance @ self.loading @ self.network._impedance

    def adjoint(self) -> Array:
        """g·bᵀ K b."""
        return self.network.conductance * self.network._across(self._twice)

    def products(self, step: Array) -> tuple[Array, Array]:
        """(J·p, g·(2 bᵀ K L_{g·p} Z b + bᵀ Z W' Z b)), W' from what the step does to the slopes of h."""
        network, impedance = self.network, self.network._impedance
        currents = injected(network.conductance * step, impedance)
        change = impedance @ currents
        twice = 2 * network._differences(self._twice, currents, symmetric=False)
        once = network._differences(impedance, self.loading_change(change) @ impedance, symmetric=True)
        return network.read_change(change), network.conductance * (twice + once)

    def loading_change(self, change: Array) -> Array:
        """W' (lines, lines): what a change of Z does to W through the slopes of h."""
        row, column, mutual = self.network._read(change)
        pp, pq, pt, qq, qt, tt = (self.weights * self.network._equation[name] for name in PARTS[4:])
        return self.network._loading(
            pp * row + pq * column + pt * mutual,
            pq * row + qq * column + qt * mutual,
            pt * row + qt * column + tt * mutual,
        )

    def matrix(self, cells: Numbers | None = None) -> Array:
        """2 g (BᵀZB ∘ BᵀKB) g, and what the curvature of h adds."""
        network = self.network
        conductance = network.conductance.ravel()
        matrix = 2 * network._between_cells(network._impedance) * network._between_cells(self._twice)
        matrix *= conductance[:, None] * conductance
        whole = self.with_curvature(matrix)
        return whole if cells is None else whole[np.ix_(cells, cells)]

    def with_curvature(self, matrix: Array) -> Array:
        """A matrix (cells, cells) with Σ_i w_i (∂(p, q, t)_i)ᵀ h″_i ∂(p, q, t)_i added to it in its place."""
        row, column, mutual = self.network.entry_responses()
        flat = mutual.reshape(len(matrix), -1)
        halves: dict[str, Callable[[Array], Array]] = {  # A of every pair of entries, whose share is A + Aᵀ
            "pp": lambda by: row.T @ (by.sum(axis=1)[:, None] * row) / 2,
            "qq": lambda by: column.T @ (by.sum(axis=0)[:, None] * column) / 2,
            "tt": lambda by: flat.T @ (by.reshape(-1, 1) * flat) / 2,
            "pq": lambda by: row.T @ (by @ column),
            "pt": lambda by: row.T @ np.einsum("jk,jkc->jc", by, mutual),
            "qt": lambda by: column.T @ np.einsum("jk,jkc->kc", by, mutual),
        }
        for name, half in halves.items():
            curvature = self.weights * self.network._equation[name]
            if curvature.any():
                part = half(curvature)
                matrix += part + part.T
        return matrix


@lru_cache(maxsize=64)
def compiled_equation(readout: ReadCircuit, rows: int, columns: int) -> Compiled:
    """h, ∂h and ∂²h of three flat (rows · columns) inputs, row by row: PARTS one after the other, flat."""
    import casadi

    flat = [casadi.SX.sym(name, rows * columns) for name in ("p", "q", "t")]
    reading = readout.reading(*(casadi.reshape(entry, columns, rows).T for entry in flat))
    value = casadi.vec(casadi.densify(reading).T)
    slopes = [casadi.gradient(casadi.sum1(value), entry) for entry in flat]
    seconds = [
        casadi.gradient(casadi.sum1(slopes[one]), flat[other])
        for one, other in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    ]
    parts = casadi.vertcat(*(casadi.densify(part) for part in (value, *slopes, *seconds)))
    return Compiled(casadi.Function("equation", flat, [parts]))


@lru_cache(maxsize=64)
def reads_own(readout: ReadCircuit, rows: int, columns: int) -> tuple[bool, bool]:
    """Whether the reading asks for the rows' own impedances Z_jj, and for the columns' Z_kk."""
    import casadi

    row, column, mutual = (casadi.SX.sym(name, rows, columns) for name in ("p", "q", "t"))
    reading = readout.reading(row, column, mutual)
    return bool(casadi.depends_on(reading, row)), bool(casadi.depends_on(reading, column))
