"""Solved networks of cells with the impedance Z = (L(g) + diag(t))⁻¹ of a panel's lines.

A readout defines the ties t of the lines to ground (siemens) and the readings y = h(p, q, t) with p
= Z_jj, q = Z_kk, t = Z_jk. All derivatives follow from these two. They are in u = log r. With D =
Z·B, B the ±1 incidence vectors of the cells, ∂Z_ab/∂u_c = g_c D_ac D_bc. For weights w of the
readings, d(Σ w y) = tr(W dZ) with
W = [[diag Σ_k w h_p, ½ w h_t], [·, diag Σ_j w h_q]]. CasADi differentiates h.
"""

from abc import ABC, abstractmethod
from collections.abc import Hashable
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lampest.panel.compiled import Compiled, guarded
from lampest.panel.kirchhoff import bipartite, injected, laplacian, line_sums
from lampest.panel.line_blocks import LineBlocks
from lampest.panel.panel import Array, check_line_memory

Numbers = NDArray[np.intp]
Entries = tuple[Array, Array, Array]  # values for (p, q, t), to be broadcast to (…, rows, columns)
Loading = tuple[Array, Array]  # W's diagonal (…, lines) and its block between rows and columns


class ReadCircuit(Hashable, Protocol):
    """Interface of a readout for a network; see `lampest.panel.readouts.readout.Readout`."""

    def reading(self, row: Any, column: Any, mutual: Any) -> Any:
        """Return h(Z_jj, Z_kk, Z_jk)."""


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
    """

    cell_resistance: Array
    _impedance: Array

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
        """Return h(p, q, t), (rows, columns)."""

    @property
    @abstractmethod
    def slopes(self) -> Entries:
        """First derivatives (h_p, h_q, h_t)."""

    @property
    def curvatures(self) -> dict[str, Array]:
        """Nonzero second derivatives of h: 'pp', 'pq', …, each (rows, columns)."""
        return {}

    def reading(self) -> Array:
        """Return y (rows, columns): the readings between every row and every column."""
        return self.read(self.entries(self._impedance))

    def read_change(self, change: Entries) -> Array:
        """Return h_p·dp + h_q·dq + h_t·dt, (rows, columns)."""
        row, column, mutual = (
            slope * part for slope, part in zip(self.slopes, change, strict=True)
        )
        return np.asarray(row + column + mutual)

    def forward(self, step: Array) -> Array:
        """Return J·p = ∂y/∂u·p for a step p of u = log r, (rows, columns).

        It takes (rows + columns)³ operations.
        """
        return self.read_change(self.changes(step))

    def changes(self, step: Array) -> Entries:
        """Return the entries of dZ = Z L_{g·p} Z."""
        return self.entries_of_product(
            self._impedance, injected(step / self.cell_resistance, self._impedance)
        )

    def adjoint(self, weights: Array) -> Array:
        """Return Jᵀ·w = g·bᵀ(Z W Z)b for weights w of the readings, (rows, columns).

        It takes (rows + columns)³ operations.
        """
        return np.asarray(self.drawn(self.loading(weights)) / self.cell_resistance)

    def loading(self, weights: Array) -> Loading:
        """Return W of weights (rows, columns) of the readings."""
        return loading_of(*(weights * slope for slope in self.slopes))

    def drawn(self, loading: Loading) -> Array:
        """Return bᵀ(Z W Z)b of every cell, (rows, columns)."""
        return across(
            self.entries_of_product(self._impedance, bipartite(*loading, self._impedance))
        )

    @cached_property
    def potential_differences(self) -> Array:
        """D = Z·B (…, lines, cells) ohm: across every cell for a unit current into every line."""
        differences = (
            self._impedance[..., : self.rows, None] - self._impedance[..., None, self.rows :]
        )
        return differences.reshape(*self._impedance.shape[:-1], -1)

    def entry_responses(self) -> Entries:
        """Return g_c·(D_jc², D_kc², D_jc·D_kc).

        Their shapes are (rows, cells), (columns, cells), (rows, columns, cells).
        """
        row, column = np.split(self.potential_differences, [self.rows])
        conductance = self.conductance.ravel()
        return row**2 * conductance, column**2 * conductance, row[:, None] * (column * conductance)

    def sensitivity(self) -> Array:
        """Return J, (readings, cells)."""
        # ∂y_jk/∂u_c = h_p·g_c D_jc² + h_q·g_c D_kc² + h_t·g_c D_jc D_kc
        row, column, mutual = self.entry_responses()
        of_row, of_column, of_mutual = (slope[:, :, None] for slope in self.slopes)
        response: Array = of_mutual * mutual
        response += of_row * row[:, None]
        response += of_column * column[None]
        return response.reshape(-1, response.shape[-1])

    def own_response(self) -> Array:
        """Return the diagonal of J, (rows, columns): the response of each cell's own reading."""
        row, column = self._own_differences()
        return np.asarray(self.conductance * self.read_change((row**2, column**2, row * column)))

    def _own_differences(self) -> tuple[Array, Array]:
        """Return (D_jc, D_kc) of every cell c at its own row j and column k, (rows, columns)."""
        row, column, mutual = self.entries(self._impedance)
        return row - mutual, mutual - column

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

        It is that while a unit current enters line `pattern`.
        """
        return self._impedance

    def leaking(self, across: Array, siemens: float) -> "Network":
        """Return the network with conductances between lines, for its readings.

        It uses Woodbury's Z − Z B (1/G + BᵀZB)⁻¹ BᵀZ.

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

        It is the amplification of the rounding of L in any reading. An error ε_l of L_ll changes
        bᵀZb by ε_l·v_l², v = Z·b, and v_l² ≤ Z_ll·bᵀZb. Infinite or NaN for a broken inverse.
        """
        driving_point = self._impedance.diagonal(axis1=-2, axis2=-1)
        return float(np.abs(line_sums(self.conductance) * driving_point).sum(axis=-1).max())

    def entries(self, matrix: Array) -> Entries:
        """Return (K_jj, K_kk, K_jk) of K (…, lines, lines)."""
        diagonal = matrix.diagonal(axis1=-2, axis2=-1)
        rows = self.rows
        return diagonal[..., :rows, None], diagonal[..., None, rows:], matrix[..., :rows, rows:]

    def entries_of_product(self, left: Array, right: Array, *, symmetric: bool = True) -> Entries:
        """Return the entries of ½(P + Pᵀ), P = left·right, without its other products.

        They are fewer if P is symmetric.
        """
        rows = self.rows
        diagonal = np.einsum("...ij,...ji->...i", left, right)
        mutual = left[..., :rows, :] @ right[..., rows:]
        if not symmetric:
            mutual = (mutual + (left[..., rows:, :] @ right[..., :rows]).swapaxes(-1, -2)) / 2
        return diagonal[..., :rows, None], diagonal[..., None, rows:], mutual

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
        return impedance @ bipartite(*self.loading, impedance)

    def adjoint(self) -> Array:
        """Return Jᵀ·w = g·bᵀ K b, (rows, columns), from the K that H needs."""
        return np.asarray(across(self.network.entries(self._twice)) / self.network.cell_resistance)

    def products(self, step: Array) -> tuple[Array, Array]:
        """Return J·p and H·p for a step p of u, (rows, columns) each.

        H·p = g·(2 bᵀ K L_{g·p} Z b + bᵀ Z W' Z b), W' the change of W by the change of the slopes
        of h.
        """
        network = self.network
        currents = injected(step / network.cell_resistance, network._impedance)
        change = network.entries_of_product(network._impedance, currents)
        second = 2 * across(network.entries_of_product(self._twice, currents, symmetric=False))
        if network.curvatures:
            second = second + network.drawn(loading_of(*self.change_of_slopes(change)))
        return network.read_change(change), second / network.cell_resistance

    def change_of_slopes(self, change: Entries) -> list[Array]:
        """Return w·(h_pp dp + h_pq dq + h_pt dt), and the same of h_q and h_t.

        They are those for changes (…) of (p, q, t).
        """
        changes: list[Array] = [
            np.zeros(np.broadcast_shapes(*(part.shape for part in change))) for _ in change
        ]
        for name, curvature in self.network.curvatures.items():
            weighted = self.weights * curvature
            weighted = weighted.reshape(*weighted.shape, *(1,) * (changes[0].ndim - 2))
            pair = ["pqt".index(entry) for entry in name]
            for of, by in {(pair[0], pair[1]), (pair[1], pair[0])}:
                changes[of] += weighted * change[by]
        return changes

    def matrix(self) -> Array:
        """Return H = 2 g (X ∘ BᵀKB) g plus the curvature of h, (…, cells, cells)."""
        conductance = self.network.flat_conductance
        matrix: Array = self.network.transfer * (2 * conductance[..., None])
        matrix *= self._between
        matrix *= conductance[..., None, :]
        if self.network.curvatures:
            # Σ_i w_i (∂(p, q, t)_i)ᵀ h″_i ∂(p, q, t)_i
            row, column, mutual = self.network.entry_responses()
            by_row, by_column, by_mutual = self.change_of_slopes(
                (row[:, None], column[None], mutual)
            )
            matrix += row.T @ by_row.sum(axis=1) + column.T @ by_column.sum(axis=0)
            matrix += mutual.reshape(-1, len(matrix)).T @ by_mutual.reshape(-1, len(matrix))
        return matrix

    @property
    def _between(self) -> Array:
        """BᵀKB (…, cells, cells)."""
        return self.network.between(self._twice)


def across(entries: Entries) -> Array:
    """Return bᵀ K b = K_jj + K_kk − 2 K_jk of every cell, (…, rows, columns)."""
    row, column, mutual = entries
    return np.asarray(row + column - 2 * mutual)


def loading_of(row: Array, column: Array, mutual: Array) -> Loading:
    """Return W from weights of Z_jj, Z_kk and Z_jk, each (…, rows, columns)."""
    return np.concatenate([row.sum(axis=-1), column.sum(axis=-2)], axis=-1), mutual / 2


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
    inverse[..., :rows, rows:], inverse[..., rows:, :rows] = between, between.swapaxes(-1, -2)
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


# First and second derivatives of h(p, q, t), p = Z_jj, q = Z_kk, t = Z_jk.
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

    def _derivatives(self, names: tuple[str, ...]) -> Array:
        """Return derivatives of h, (names, rows, columns)."""
        shape = self.conductance.shape
        entries = (np.broadcast_to(part, shape).ravel() for part in self.entries(self._impedance))
        return equation_derivatives(self.readout, *shape, names)(*entries).reshape(-1, *shape)

    @cached_property
    def slopes(self) -> Entries:
        row, column, mutual = self._derivatives(SLOPES)
        return row, column, mutual

    @cached_property
    def curvatures(self) -> dict[str, Array]:
        values = zip(CURVATURES, self._derivatives(CURVATURES), strict=True)
        return {name: derivative for name, derivative in values if derivative.any()}


@dataclass(frozen=True, eq=False)
class DifferenceNetwork(TiedNetwork):
    """Network whose derivatives follow from the potential differences D across its cells.

    A line with a tie of infinite conductance is held at ground. It is excited by a unit potential,
    any other line by a unit current. With C the conductances between lines that are not held (ties
    included), −G those between held and other lines, and A those between held lines, K = [[−(A − G
    C⁻¹ Gᵀ), G C⁻¹], [C⁻¹ Gᵀ, C⁻¹]] and the potentials of all lines for each excitation are P = [[1,
    G C⁻¹], [0, C⁻¹]], held lines first. Without held lines K = P = Z. In every case D = P·B and
    ∂K_ab/∂g_c = −D_ac D_bc. Nothing is lost to a tie that is only nearly infinite.

    Attributes
    ----------
    ties : array, shape (lines,)
        Ties t of the terminals to ground, siemens; infinite where a line is held.
    excited : array, shape (lines, lines)
        P; row a is the excitation of line a.
    """

    ties: Array
    excited: Array

    @property
    def held(self) -> NDArray[np.bool_]:
        """Whether a line is held at ground, (lines,)."""
        return np.isinf(self.ties)

    @abstractmethod
    def driven_through(self, sources: Array) -> Array:
        """Return X·s, (cells, patterns) volt, for currents driven through cells.

        The currents s are (cells, patterns) ampere.
        """

    def potentials(self) -> Array:
        """Return the potential of every line (lines, patterns).

        It is that for the excitation of line `pattern`.
        """
        return self.excited.T

    def leaking(self, across: Array, siemens: float) -> Network:
        """Return the network with conductances between lines; see `Network.leaking`."""
        towards = self.excited @ across
        # Bᵀ Z B with Z the impedance of the lines that are not held
        core = np.linalg.inv(
            np.eye(across.shape[1])
            + siemens * across.T @ np.where(self.held[:, None], 0.0, towards)
        )
        return replace(self, _impedance=self._impedance - siemens * towards @ core @ towards.T)

    def condition(self) -> float:
        """Return Σ_l |L_ll Z_ll| over the lines that are not held; see `Network.condition`."""
        driving_point = np.where(self.held, 0.0, self._impedance.diagonal())
        return float(np.abs(line_sums(self.conductance) * driving_point).sum())

    def changes(self, step: Array) -> Entries:
        """Return the entries of dK = D·diag(g·p)·Dᵀ."""
        differences = self.potential_differences
        return self.entries((differences * (self.conductance * step).ravel()) @ differences.T)

    def drawn(self, loading: Loading) -> Array:
        """Return diag(Dᵀ W D), (rows, columns)."""
        differences = self.potential_differences
        drawn = np.sum(differences * bipartite(*loading, differences), axis=0)
        return np.asarray(drawn.reshape(self.conductance.shape))

    def _own_differences(self) -> tuple[Array, Array]:
        rows, columns = self.conductance.shape
        row, column = np.indices((rows, columns))
        differences = self.potential_differences.reshape(-1, rows, columns)
        return differences[row, row, column], differences[rows + column, row, column]

    @cached_property
    def transfer(self) -> Array:
        """X (cells, cells), the potential differences for a unit current through every cell.

        See `SecondOrder`.
        """
        return self.driven_through(np.eye(self.conductance.size))

    def second_order(self, weights: Array) -> SecondOrder:
        return DifferenceSecondOrder(self, weights)


@dataclass(frozen=True, eq=False)
class DifferenceSecondOrder(SecondOrder):
    """Second derivatives H of a network of potential differences; see `SecondOrder`."""

    network: DifferenceNetwork

    def adjoint(self) -> Array:
        """Return Jᵀ·w = g·diag(Dᵀ W D), (rows, columns)."""
        return np.asarray(self.network.conductance * self.network.drawn(self.loading))

    def products(self, step: Array) -> tuple[Array, Array]:
        """Return J·p and H·p = g·(2 diag(Dᵀ W dD) + diag(Dᵀ W' D)), (rows, columns) each.

        dDᵀ = X·(g·p·Dᵀ), and W' is the change of W by the change of the slopes of h.
        """
        network = self.network
        change = self.network.changes(step)
        differences = network.potential_differences
        moved = network.driven_through((differences * (network.conductance * step).ravel()).T).T
        twice = 2 * np.sum(moved * bipartite(*self.loading, differences), axis=0).reshape(
            step.shape
        )
        return network.read_change(change), network.conductance * (
            twice + network.drawn(loading_of(*self.change_of_slopes(change)))
        )

    @property
    def _between(self) -> Array:
        """Dᵀ W D, (cells, cells)."""
        differences = self.network.potential_differences
        return np.asarray(differences.T @ bipartite(*self.loading, differences))


@dataclass(frozen=True, eq=False)
class HeldNetwork(DifferenceNetwork):
    """Network of which some lines are held at ground; see `DifferenceNetwork`."""

    @classmethod
    def solve(cls, cell_resistance: Array, ties: Array, readout: ReadCircuit) -> "HeldNetwork":
        """Return the solved network of cells (rows, columns) ohm.

        Raises numpy.linalg.LinAlgError if a line is not connected.
        """
        entries, potentials = excitations(laplacian(1 / cell_resistance), ties)
        return cls(cell_resistance, entries, readout, ties, potentials)

    @cached_property
    def potential_differences(self) -> Array:
        """D = P·B, (lines, cells): across every cell for the excitation of every line."""
        differences = self.excited[:, : self.rows, None] - self.excited[:, None, self.rows :]
        return differences.reshape(len(differences), -1)

    def driven_through(self, sources: Array) -> Array:
        """Return BᵀZB·s, Z the impedance of the lines that are not held."""
        currents = sources.reshape(*self.conductance.shape, -1)
        entering = np.concatenate([currents.sum(axis=1), -currents.sum(axis=0)])
        potentials = np.where(self.held[:, None], 0.0, self.excited) @ entering
        return np.asarray(potentials[: self.rows, None] - potentials[None, self.rows :]).reshape(
            sources.shape
        )


def excitations(admittance: Array, ties: Array) -> tuple[Array, Array]:
    """Return K and P of `DifferenceNetwork`, (lines, lines) each.

    They are computed from the lines' admittance without ties, siemens. `ties` are (lines,) siemens,
    infinite where a line is held. Raises numpy.linalg.LinAlgError if a line is not connected.
    """
    held = np.isinf(ties)
    other = ~held
    within = np.linalg.inv(admittance[np.ix_(other, other)] + np.diag(ties[other]))
    entries = np.zeros_like(admittance)
    potentials = np.zeros_like(admittance)
    # Current into held lines from the others: −G = admittance between them
    between = -admittance[np.ix_(held, other)] @ within
    entries[np.ix_(other, other)] = potentials[np.ix_(other, other)] = within
    entries[np.ix_(held, other)] = potentials[np.ix_(held, other)] = between
    entries[np.ix_(other, held)] = between.T
    entries[np.ix_(held, held)] = -(
        admittance[np.ix_(held, held)] + between @ admittance[np.ix_(other, held)]
    )
    potentials[np.ix_(held, held)] = np.eye(int(held.sum()))
    return entries, potentials


@guarded
@lru_cache(maxsize=64)
def equation_derivatives(
    readout: ReadCircuit, rows: int, columns: int, names: tuple[str, ...]
) -> Compiled:
    """Return the function of p, q and t with the named derivatives of h, flat.

    p, q and t are flat, (rows · columns) each.
    """
    import casadi

    # Expressions of whole arrays: their number does not grow with the panel.
    flat = {name: casadi.MX.sym(name, rows * columns) for name in SLOPES}
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


@guarded
@lru_cache(maxsize=64)
def reads_own(readout: ReadCircuit, rows: int, columns: int) -> tuple[bool, bool]:
    """Return whether the reading depends on the rows' Z_jj, and whether on the columns' Z_kk.

    Z_jj and Z_kk are impedances.
    """
    import casadi

    row, column, mutual = (casadi.MX.sym(name, rows, columns) for name in SLOPES)
    reading = readout.reading(row, column, mutual)
    return bool(casadi.depends_on(reading, row)), bool(casadi.depends_on(reading, column))
