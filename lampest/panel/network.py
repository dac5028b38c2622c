"""Solved networks of cells with the impedance Z = (L(g) + diag(t))⁻¹ of a panel's lines.

A readout defines the ties t of the lines to ground (siemens) and the readings y = h(p, q, t) with p
= Z_jj, q = Z_kk, t = Z_jk. All derivatives are with respect to u = log r, and follow from these
two. With D = Z·B, B the ±1 incidence vectors of the cells, ∂Z_ab/∂u_c = g_c D_ac D_bc. For weights
w of the readings, d(Σ w y) = tr(W dZ) with W = [[diag Σ_k w h_p, ½ w h_t], [·, diag Σ_j w h_q]].

Where idle lines end in potentials, x is the excitation of all lines by them, and a reading depends
on v = Z·x, too: y = h(p, q, t, e, f) with e = v_j and f = v_k. As v is linear in Z, nothing new
enters the derivatives: with w_v the weights of v, W becomes W + ½(x w_vᵀ + w_v xᵀ).
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lampest.panel.kirchhoff import bipartite, injected, line_sums
from lampest.panel.line_blocks import LineBlocks
from lampest.panel.panel import Array, check_line_memory

ENTRY_NAMES = "pqtef"
Numbers = NDArray[np.intp]
# Values for (p, q, t), or (p, q, t, e, f), to be broadcast to (…, rows, columns)
Entries = tuple[Array, ...]
# Indices of rows and columns that give (rows, columns, …) for all readings.
EVERY_ROW = (slice(None), None)
EVERY_COLUMN = (None, slice(None))


@dataclass(frozen=True, eq=False)
class Loading:
    """Matrix W of weights of the readings; see the module.

    Attributes
    ----------
    diagonal : array, shape (…, lines)
    between : array, shape (…, rows, columns)
        Block between rows and columns.
    of_potentials : array, shape (lines,), or None
        w_v, where lines end in potentials.
    """

    diagonal: Array
    between: Array
    of_potentials: Array | None = None


@dataclass(frozen=True, eq=False)
class NormalByLines:
    """Matrix diag(own) + V·mixed·Vᵀ over cells.

    V = [diag(v)·U for v in along], and U is the incidence of cells and lines.

    Attributes
    ----------
    own : array, shape (rows, columns)
    along : array, shape (k, rows, columns)
    mixed : LineBlocks of k values
    mixed_inverse : LineBlocks of k values
    """

    own: Array
    along: Array
    mixed: LineBlocks
    mixed_inverse: LineBlocks


@dataclass(frozen=True, eq=False)
class Network(ABC):
    """Solved network of a panel.

    Networks of floating lines may have leading axes, for many networks at once. The impedance Z,
    (lines, lines) ohm, is private to the network.

    Attributes
    ----------
    cell_resistance : array, shape (rows, columns)
        Cells r in ohm.
    sources : array, shape (lines,), or None
        Excitation x of the lines by the potentials in which idle lines end; None without any.
    """

    cell_resistance: Array
    _impedance: Array
    sources: Array | None = field(default=None, kw_only=True)

    @cached_property
    def conductance(self) -> Array:
        """Conductances g = 1/r, (rows, columns) siemens."""
        return np.asarray(1 / self.cell_resistance)

    @property
    def rows(self) -> int:
        """Number of row lines."""
        return int(self.conductance.shape[-2])

    @property
    def flat_conductance(self) -> Array:
        """Conductances g (…, cells)."""
        return self.conductance.reshape(*self.conductance.shape[:-2], -1)

    @abstractmethod
    def read(self, entries: Entries) -> Array:
        """Return h(p, q, t), or h(p, q, t, e, f), (rows, columns)."""

    @property
    @abstractmethod
    def slopes(self) -> Entries:
        """First derivatives (h_p, h_q, h_t), or (h_p, h_q, h_t, h_e, h_f)."""

    @property
    def curvatures(self) -> Array | None:
        """Second derivatives h″ of h, (entries, entries, rows, columns); None: h is linear."""
        return None

    def reading(self) -> Array:
        """Return y (rows, columns): the readings between every row and every column."""
        return self.read(self.entries(self._impedance))

    def read_change(self, change: Entries) -> Array:
        """Return h_p·dp + h_q·dq + h_t·dt, (rows, columns)."""
        row, column, *others = (
            slope * part for slope, part in zip(self.slopes, change, strict=True)
        )
        return np.asarray(sum(others, row + column))

    def forward(self, step: Array) -> Array:
        """Return J·p = ∂y/∂u·p for a step p of u = log r, (rows, columns).

        The product takes (rows + columns)³ operations.
        """
        return self.read_change(self.changes(step))

    def changes(self, step: Array) -> Entries:
        """Return the entries of dZ = Z L_{g·p} Z."""
        return self.entries_of_product(
            self._impedance, injected(step / self.cell_resistance, self._impedance)
        )

    def adjoint(self, weights: Array) -> Array:
        """Return Jᵀ·w = g·bᵀ(Z W Z)b for weights w of the readings, (rows, columns).

        The product takes (rows + columns)³ operations.
        """
        return np.asarray(self.drawn(self.loading(weights)) / self.cell_resistance)

    def loading(self, weights: Array) -> Loading:
        """Return W of weights (rows, columns) of the readings."""
        return loading_of(*(weights * slope for slope in self.slopes))

    def drawn(self, loading: Loading) -> Array:
        """Return bᵀ(Z W Z)b of every cell, (rows, columns)."""
        return across(
            self.entries_of_product(
                self._impedance, self.loaded(loading, self._impedance), with_sources=False
            )
        )

    def loaded(self, loading: Loading, values: Array) -> Array:
        """Return W·V, (…, lines, patterns), for values V of the same shape."""
        product = bipartite(loading.diagonal, loading.between, values)
        if loading.of_potentials is not None:
            # ½ (x w_vᵀ + w_v xᵀ)
            assert self.sources is not None
            product = product + 0.5 * np.outer(self.sources, loading.of_potentials @ values)
            product = product + 0.5 * np.outer(loading.of_potentials, self.sources @ values)
        return product

    @cached_property
    def source_differences(self) -> Array:
        """Difference of v = Z·x across every cell, (rows, columns)."""
        assert self.sources is not None
        potentials = self._impedance @ self.sources
        return np.asarray(potentials[: self.rows, None] - potentials[None, self.rows :])

    @cached_property
    def potential_differences(self) -> Array:
        """D = Z·B (…, lines, cells) ohm: across every cell for a unit current into every line."""
        differences = (
            self._impedance[..., : self.rows, None] - self._impedance[..., None, self.rows :]
        )
        return differences.reshape(*self._impedance.shape[:-1], -1)

    def entry_responses(self, j: Any = EVERY_ROW, k: Any = EVERY_COLUMN) -> Entries:
        """Return g_c·(D_jc², D_kc², D_jc·D_kc).

        Their shapes are (rows, cells), (columns, cells), (rows, columns, cells). With potentials
        g_c·(D_jc·D_vc, D_kc·D_vc) follow, (rows, cells), (columns, cells), with D_v the
        differences of v.

        Parameters
        ----------
        j, k : index
            Rows and columns of the readings for which the third response is returned.
        """
        row, column = np.split(self.potential_differences, [self.rows])
        conductance = self.conductance.ravel()
        responses = (
            row**2 * conductance,
            column**2 * conductance,
            row[j] * (column * conductance)[k],
        )
        if self.sources is None:
            return responses
        by_sources = self.source_differences.ravel() * conductance
        return *responses, row * by_sources, column * by_sources

    def sensitivity(self) -> Array:
        """Return J, (readings, cells)."""
        response = self._sensitivity(EVERY_ROW, EVERY_COLUMN, self.slopes)
        return response.reshape(-1, response.shape[-1])

    def sensitivity_of(self, read: NDArray[np.bool_]) -> Array:
        """Return the rows of J of the readings that are True in `read` (rows, columns)."""
        j, k = np.nonzero(read)
        return self._sensitivity(j, k, tuple(slope[read] for slope in self.slopes))

    def _sensitivity(self, j: Any, k: Any, slopes: Entries) -> Array:
        """Return ∂y/∂u of the readings at rows j and columns k, with their slopes of h."""
        # ∂y_jk/∂u_c = h_p·g_c D_jc² + h_q·g_c D_kc² + h_t·g_c D_jc D_kc
        row, column, mutual, *by_sources = self.entry_responses(j, k)
        of_row, of_column, of_mutual, *of_sources = (slope[..., None] for slope in slopes)
        response: Array = of_mutual * mutual
        response += of_row * row[j]
        response += of_column * column[k]
        if by_sources:
            response += of_sources[0] * by_sources[0][j]
            response += of_sources[1] * by_sources[1][k]
        return response

    def own_response(self) -> Array:
        """Return the diagonal of J, (rows, columns): the response of each cell's own reading."""
        row, column = self._own_differences()
        change: Entries = (row**2, column**2, row * column)
        if self.sources is not None:
            change = (*change, row * self.source_differences, column * self.source_differences)
        return np.asarray(self.conductance * self.read_change(change))

    def _own_differences(self) -> tuple[Array, Array]:
        """Return (D_jc, D_kc) of every cell c at its own row j and column k, (rows, columns)."""
        row, column, mutual, *_ = self.entries(self._impedance)
        return row - mutual, mutual - column

    def response_of(self, response: Callable[["Network"], Array]) -> Array:
        """Return a response of the readings, (…, rows, columns, k).

        Of several networks, each reading has the response of the one that gives it.
        """
        return response(self)

    @property
    def branch(self) -> Array:
        """Sign of the median change of the readings where all cells grow by one factor, (…).

        Panels that give the same readings and differ in sign lie on two sides of a fold; see
        `lampest.panel.readouts.branches`.
        """
        grown = self.forward(np.ones(self.cell_resistance.shape))
        return np.asarray(np.sign(np.median(grown, axis=(-2, -1))))

    def second_order(self, weights: Array) -> "SecondOrder":
        """Return the second derivatives of Σ w·y, for weights w of the readings (rows, columns)."""
        return SecondOrder(self, weights)

    def normal_by_lines(self, weight: Array) -> NormalByLines:
        """Return an approximation of JᵀWJ for weights w ≥ 0 of the readings (rows, columns).

        In the base class it contains the diagonal of J only; kinds of networks may add the parts of
        lines.
        """
        diagonal: Array = weight * self.own_response() ** 2
        none = LineBlocks(np.zeros((0, 0, sum(diagonal.shape))), np.zeros((0, 0, *diagonal.shape)))
        return NormalByLines(diagonal, np.zeros((0, *diagonal.shape)), none, none)

    def potentials(self) -> Array:
        """Return the potential of every line, (lines, patterns) V/A.

        Pattern k is a unit current into line k.
        """
        return self._impedance

    def leaking(self, across: Array, siemens: float) -> "Network":
        """Return the network with conductances between lines, for its readings.

        By Woodbury's formula Z becomes Z − Z B (1/G + BᵀZB)⁻¹ BᵀZ.

        Parameters
        ----------
        across : array, shape (lines, leaks)
            Incidence B of each leak, +1 and −1 at its lines.
        siemens : float
            G of each leak.
        """
        towards = self._impedance @ across
        # (1/G + Bᵀ Z B)⁻¹ = G (1 + G Bᵀ Z B)⁻¹, which allows G = 0
        core = np.linalg.inv(np.eye(across.shape[1]) + siemens * across.T @ towards)
        return replace(self, _impedance=self._impedance - siemens * towards @ core @ towards.T)

    def condition(self) -> float:
        """Return Σ_l |L_ll Z_ll| over the lines.

        The sum is the amplification of the rounding of L in any reading. An error ε_l of L_ll
        changes bᵀZb by ε_l·v_l², v = Z·b, and v_l² ≤ Z_ll·bᵀZb. The sum is infinite or NaN for a
        broken inverse.
        """
        driving_point = self._impedance.diagonal(axis1=-2, axis2=-1)
        return float(np.abs(line_sums(self.conductance) * driving_point).sum(axis=-1).max())

    def entries(self, matrix: Array) -> Entries:
        """Return (K_jj, K_kk, K_jk) of K (…, lines, lines), with sources also both parts of K·x."""
        diagonal = matrix.diagonal(axis1=-2, axis2=-1)
        rows = self.rows
        entries = (
            diagonal[..., :rows, None],
            diagonal[..., None, rows:],
            matrix[..., :rows, rows:],
        )
        return self._with_potentials(entries, lambda sources: matrix @ sources)

    def _with_potentials(
        self, entries: Entries, product: Callable[[Array], Array], *, wanted: bool = True
    ) -> Entries:
        """Return entries followed by both parts of a product with the sources, if there are any."""
        if self.sources is None or not wanted:
            return entries
        potentials = product(self.sources[..., None])[..., 0]
        return *entries, potentials[..., : self.rows, None], potentials[..., None, self.rows :]

    def entries_of_product(
        self, left: Array, right: Array, *, symmetric: bool = True, with_sources: bool = True
    ) -> Entries:
        """Return the entries of ½(P + Pᵀ), P = left·right, without its other products.

        A symmetric P needs fewer products.
        """
        rows = self.rows
        diagonal = np.einsum("...ij,...ji->...i", left, right)
        mutual = left[..., :rows, :] @ right[..., rows:]
        if not symmetric:
            mutual = (mutual + (left[..., rows:, :] @ right[..., :rows]).swapaxes(-1, -2)) / 2
        entries = (diagonal[..., :rows, None], diagonal[..., None, rows:], mutual)
        return self._with_potentials(
            entries, lambda sources: left @ (right @ sources), wanted=with_sources
        )

    @cached_property
    def transfer(self) -> Array:
        """X = BᵀZB (…, cells, cells) ohm: ∂D_ac/∂g_d = −D_ad X_dc."""
        return self.between(self._impedance)

    def between(self, matrix: Array) -> Array:
        """Return BᵀKB (…, cells, cells) for K (…, lines, lines)."""
        *leading, rows, columns = self.conductance.shape
        at_cells = matrix[..., :rows, None] - matrix[..., None, rows:]
        transfer = at_cells[..., :rows, None, :, :] - at_cells[..., None, rows:, :, :]
        return transfer.reshape(*leading, rows * columns, rows * columns)


@dataclass(frozen=True, eq=False)
class SecondOrder:
    """Second derivatives H = diag(g)·Σ_i w_i ∂²y_i/∂g²·diag(g) of the readings.

    Σ_i w_i ∂²y_i/∂u² = H − diag(Jᵀw).

    Attributes
    ----------
    network : Network
    weights : array, shape (rows, columns)
        Weights w of the readings.
    """

    network: Network
    weights: Array

    @cached_property
    def loading(self) -> Loading:
        """W for the weights, as its diagonal and its block between rows and columns."""
        return self.network.loading(self.weights)

    @cached_property
    def _twice(self) -> Array:
        """K = Z W Z (lines, lines)."""
        impedance = self.network._impedance
        return impedance @ self.network.loaded(self.loading, impedance)

    def adjoint(self) -> Array:
        """Return Jᵀ·w = g·bᵀ K b, (rows, columns), from the K that H needs."""
        return np.asarray(across(self.network.entries(self._twice)) / self.network.cell_resistance)

    def products(self, step: Array) -> tuple[Array, Array]:
        """Return the products with the Jacobian and the Hessian for a step p of u.

        Returns
        -------
        change : array, shape (rows, columns)
            J·p.
        second : array, shape (rows, columns)
            H·p = g·(2 bᵀ K L_{g·p} Z b + bᵀ Z W' Z b), W' the change of W by that of the slopes of
            h.
        """
        network = self.network
        currents = injected(step / network.cell_resistance, network._impedance)
        change = network.entries_of_product(network._impedance, currents)
        second = 2 * across(
            network.entries_of_product(self._twice, currents, symmetric=False, with_sources=False)
        )
        if network.curvatures is not None:
            second = second + network.drawn(loading_of(*self.change_of_slopes(change)))
        return network.read_change(change), second / network.cell_resistance

    def change_of_slopes(self, change: Entries) -> list[Array]:
        """Return the changes of the weighted slopes of h for changes (…) of the entries.

        The first one is w·(h_pp dp + h_pq dq + …) of h_p; those of h_q and all others follow.
        """
        weighted = self._weighted_curvatures
        shape = np.broadcast_shapes(*(part.shape for part in change))
        if shape == self.weights.shape:
            every = np.empty((len(change), *shape))
            for number, part in enumerate(change):
                every[number] = part
            summed: Array = (weighted * every).sum(axis=1)
            return [summed[number] for number in range(len(change))]
        changes: list[Array] = [np.zeros(shape) for _ in change]
        for of, by in np.argwhere(weighted.any(axis=(-2, -1))):
            curvature = weighted[of, by]
            changes[of] += (
                curvature.reshape(*curvature.shape, *(1,) * (len(shape) - 2)) * change[by]
            )
        return changes

    @cached_property
    def _weighted_curvatures(self) -> Array:
        """w·h″, (entries, entries, rows, columns)."""
        assert self.network.curvatures is not None
        return np.asarray(self.weights * self.network.curvatures)

    def matrix(self) -> Array:
        """Return H = 2 g (X ∘ BᵀKB) g plus the curvature of h, (…, cells, cells)."""
        conductance = self.network.flat_conductance
        matrix: Array = self.network.transfer * (2 * conductance[..., None])
        matrix *= self._between
        matrix *= conductance[..., None, :]
        if self.network.curvatures is not None:
            # Σ_i w_i (∂(p, q, t)_i)ᵀ h″_i ∂(p, q, t)_i
            row, column, mutual, *of_sources = self.network.entry_responses()
            changes: Entries = (row[:, None], column[None], mutual)
            if of_sources:
                changes = (*changes, of_sources[0][:, None], of_sources[1][None])
            by_row, by_column, by_mutual, *by_sources = self.change_of_slopes(changes)
            matrix += row.T @ by_row.sum(axis=1) + column.T @ by_column.sum(axis=0)
            matrix += mutual.reshape(-1, len(matrix)).T @ by_mutual.reshape(-1, len(matrix))
            for axis, (part, by_part) in enumerate(zip(of_sources, by_sources, strict=True)):
                matrix += part.T @ by_part.sum(axis=1 - axis)
        return matrix

    @property
    def _between(self) -> Array:
        """BᵀKB (…, cells, cells)."""
        return self.network.between(self._twice)


def across(entries: Entries) -> Array:
    """Return bᵀ K b = K_jj + K_kk − 2 K_jk of every cell, (…, rows, columns)."""
    row, column, mutual, *_ = entries
    return np.asarray(row + column - 2 * mutual)


def loading_of(row: Array, column: Array, mutual: Array, *of_sources: Array) -> Loading:
    """Return W from weights of Z_jj, Z_kk and Z_jk, each (…, rows, columns).

    With potentials those of v_j and v_k follow.
    """
    return Loading(_sums(row, column), mutual / 2, _sums(*of_sources) if of_sources else None)


def _sums(row: Array, column: Array) -> Array:
    """Return the sums of weights of rows, and of columns, over the readings of every line."""
    return np.concatenate([row.sum(axis=-1), column.sum(axis=-2)], axis=-1)


def inverse_of(conductance: Array, ties: Array) -> Array:
    """Return Z = (L(g) + diag(t))⁻¹, (…, lines, lines) ohm.

    Raises LinAlgError if a line is not connected.

    The lines of the longer side are eliminated by hand, so that the cost is that of the shorter
    side's inverse and of the entries of Z. With a the sums of the eliminated lines, the others form
    a network of conductances Gᵀ diag(a)⁻¹ G with ties t + Gᵀ diag(a)⁻¹ t. Positive sums lose no
    digits where cells are decades apart.
    Source: Grassmann, Taksar, Heyman, Operations Research 33 (1985).
    """
    rows, columns = conductance.shape[-2:]
    if rows < columns:
        return np.roll(inverse_of(*_exchanged(conductance, ties)), (rows, rows), axis=(-2, -1))
    check_line_memory(rows, columns)
    row_sums, shares, schur = _without_rows(conductance, ties)
    # Z_kk' = S⁻¹, Z_jk = diag(a)⁻¹ G S⁻¹, Z_jj' = diag(a)⁻¹ + diag(a)⁻¹ G S⁻¹ Gᵀ diag(a)⁻¹
    within: Array = np.linalg.inv(schur)
    inverse = np.empty((*ties.shape, rows + columns), dtype=within.dtype)
    between = shares @ within
    inverse[..., rows:, rows:] = within
    inverse[..., :rows, rows:] = between
    inverse[..., rows:, :rows] = between.swapaxes(-1, -2)
    inverse[..., :rows, :rows] = between @ shares.swapaxes(-1, -2)
    np.einsum("...ii->...i", inverse)[..., :rows] += 1 / row_sums
    return inverse


def log_determinant(conductance: Array, ties: Array) -> float:
    """Return ln det(L(g) + diag(t)) of a single network.

    Raises LinAlgError if a line is not connected.
    """
    if conductance.shape[0] < conductance.shape[1]:
        conductance, ties = _exchanged(conductance, ties)
    row_sums, _, schur = _without_rows(conductance, ties)
    return float(np.log(row_sums).sum() + np.linalg.slogdet(schur)[1])


def _exchanged(conductance: Array, ties: Array) -> tuple[Array, Array]:
    """Return the conductances and ties of a network whose rows are columns."""
    rows = conductance.shape[-2]
    return conductance.swapaxes(-1, -2), np.concatenate(
        [ties[..., rows:], ties[..., :rows]], axis=-1
    )


def _without_rows(conductance: Array, ties: Array) -> tuple[Array, Array, Array]:
    """Return a, diag(a)⁻¹ G, and the matrix of the columns' network without rows.

    See `inverse_of`.
    """
    total = line_sums(conductance) + ties
    if not total.all():
        raise np.linalg.LinAlgError("a line is not connected")
    rows = conductance.shape[-2]
    row_sums = total[..., :rows]
    shares = conductance / row_sums[..., None]
    meshed = shares.swapaxes(-1, -2) @ conductance
    np.einsum("...ii->...i", meshed)[...] = 0.0
    tied = ties[..., rows:] + np.einsum("...jk,...j->...k", shares, ties[..., :rows])
    schur = -meshed
    np.einsum("...ii->...i", schur)[...] = meshed.sum(axis=-1) + tied
    return row_sums, shares, schur
