"""Solved networks of cells with the impedance Z = (L(g) + diag(t))⁻¹ of a panel's lines.

A readout defines the ties t of the lines to ground (siemens) and the law y = h(p, q, t) of its
readings with p = Z_jj, q = Z_kk, t = Z_jk; see `lampest.panel.law`. All derivatives are with
respect to u = log r, and follow from these two. With D = Z·B, B the ±1 incidence vectors of the
cells, ∂Z_ab/∂u_c = g_c D_ac D_bc.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from lampest.panel.circuit import CircuitOfLines
from lampest.panel.equation import equation_of
from lampest.panel.kirchhoff import (
    LineBlocks,
    NormalByLines,
    bipartite,
    inverse_of,
    laplacian,
    line_sums,
    square_by_lines,
)
from lampest.panel.law import (
    TWO_POINT_SLOPES,
    Entries,
    Loading,
    across,
    all_entries,
    law_derivatives,
    loading_of,
)
from lampest.panel.panel import Array, Mask, Numbers, Shape

# Indices of rows and columns that give (rows, columns, …) for all readings.
EVERY_ROW = (slice(None), None)
EVERY_COLUMN = (None, slice(None))


@dataclass(frozen=True, eq=False)
class Network(ABC):
    """Solved network of a panel's cells: readings and their derivatives.

    Attributes
    ----------
    cell_resistance : array, shape (…, rows, columns)
        Cells r in ohm.
    """

    cell_resistance: Array

    @cached_property
    def conductance(self) -> Array:
        """Conductances g = 1/r, (…, rows, columns) siemens."""
        return 1 / self.cell_resistance

    @abstractmethod
    def reading(self) -> Array:
        """Return y (rows, columns): the readings between every row and every column."""

    @abstractmethod
    def forward(self, step: Array) -> Array:
        """Return J·p = ∂y/∂u·p for a step p of u = log r, (rows, columns)."""

    @abstractmethod
    def adjoint(self, weights: Array) -> Array:
        """Return Jᵀ·w for weights w of the readings, (rows, columns)."""

    @abstractmethod
    def sensitivity(self, read: Mask | None = None) -> Array:
        """Return J, (readings, cells).

        With `read`, (rows, columns), it has the rows alone of the readings that are True there.
        """

    @abstractmethod
    def own_response(self) -> Array:
        """Return the diagonal of J, (rows, columns): the response of each cell's own reading."""

    @abstractmethod
    def second_order(self, weights: Array) -> "SecondOrder":
        """Return the second derivatives of Σ w·y, for weights w of the readings (rows, columns)."""

    @abstractmethod
    def leaking(self, across: Array, siemens: float) -> "Network":
        """Return the network with conductances between lines, for its readings.

        Parameters
        ----------
        across : array, shape (lines, leaks)
            Incidence B of each leak, +1 and −1 at its lines.
        siemens : float
            G of each leak.
        """

    @abstractmethod
    def response_of(self, response: "Callable[[SolvedNetwork], Array]") -> Array:
        """Return a response of the readings, (…, rows, columns, k).

        Of several networks, each reading has the response of the one that gives it.
        """

    @property
    def branch(self) -> Array:
        """Sign of the median change of the readings where all cells grow by one factor, (…).

        Panels that give the same readings and differ in sign lie on two sides of a fold; see
        `lampest.panel.readouts.branches`.
        """
        return np.sign(np.median(self.forward(np.ones_like(self.cell_resistance)), axis=(-2, -1)))

    def normal_by_lines(self, weight: Array) -> NormalByLines:
        """Return an approximation of JᵀWJ for weights w ≥ 0 of the readings (rows, columns).

        In the base class it contains the diagonal of J only; kinds of networks may add the parts of
        lines.
        """
        diagonal = weight * self.own_response() ** 2
        none = LineBlocks(np.zeros((0, 0, sum(diagonal.shape))), np.zeros((0, 0, *diagonal.shape)))
        return NormalByLines(diagonal, np.zeros((0, *diagonal.shape)), none, none)


@dataclass(frozen=True, eq=False)
class SecondOrder(ABC):
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

    @abstractmethod
    def adjoint(self) -> Array:
        """Return Jᵀ·w, (rows, columns), from what H needs."""

    @abstractmethod
    def products(self, step: Array) -> tuple[Array, Array]:
        """Return the products with the Jacobian and the Hessian for a step p of u.

        Returns
        -------
        change : array, shape (rows, columns)
            J·p.
        second : array, shape (rows, columns)
            H·p.
        """

    @abstractmethod
    def matrix(self) -> Array:
        """Return H, (…, cells, cells)."""


def matrix_vector(matrix: Array, vector: Array) -> Array:
    """Return A·x, (…, lines), of matrices (…, lines, lines) and vectors (…, lines)."""
    return (matrix @ vector[..., None])[..., 0]


@dataclass(frozen=True, eq=False)
class SolvedNetwork(Network):
    """Solved network of lines that end in ties to ground.

    Arrays may have leading axes, for many networks at once. The impedance Z,
    (lines, lines) ohm, is private to the network. Products with the cells are products with the
    bipartite matrix of the lines: (rows + columns)³ operations. `DifferenceNetwork` keeps more
    digits, and its products cost more.

    Attributes
    ----------
    circuit : CircuitOfLines or None
        Circuit whose equation is h. None: two-point readings R_jk = Z_jj + Z_kk − 2 Z_jk in ohm,
        whose h has no curvature.
    sources : array, shape (…, lines), or None
        Excitation x of the lines by the potentials in which idle lines end; None without any.
    """

    _impedance: Array
    circuit: CircuitOfLines | None
    sources: Array | None = field(default=None, kw_only=True)

    @classmethod
    def tied(
        cls,
        cell_resistance: Array,
        ties: Array,
        circuit: CircuitOfLines | None,
        sources: Array | None = None,
        leaks: Array | None = None,
    ) -> Self:
        """Return the network of cells (…, rows, columns) ohm with ties (…, lines) siemens.

        `leaks` are the admittance of conductances between lines, (lines, lines) siemens. Raises
        numpy.linalg.LinAlgError if a line is not connected.
        """
        if leaks is None:
            impedance = inverse_of(1 / cell_resistance, ties)
        else:
            admittance = laplacian(1 / cell_resistance) + leaks
            np.einsum("...ii->...i", admittance)[...] += ties
            impedance = np.linalg.inv(admittance)
        return cls(cell_resistance, impedance, circuit, sources=sources)

    @classmethod
    def floating(cls, conductance: Array, ties: Array) -> Self:
        """Return the network of two-point readings, of conductances (…, rows, columns) siemens.

        The ties are (…, lines) siemens. Raises numpy.linalg.LinAlgError if a line is not connected.
        """
        with np.errstate(divide="ignore"):
            return cls(1 / conductance, inverse_of(conductance, ties), None)

    def some(self, numbers: Numbers | int) -> Self:
        """Return the chosen ones of many networks, or a single one by its number."""
        return replace(
            self,
            cell_resistance=self.cell_resistance[numbers],
            _impedance=self._impedance[numbers],
            sources=None if self.sources is None else self.sources[numbers],
        )

    @property
    def shape(self) -> Shape:
        """Shape of the cells, (…, rows, columns)."""
        return self.cell_resistance.shape

    @property
    def rows(self) -> int:
        """Number of row lines."""
        return int(self.cell_resistance.shape[-2])

    @property
    def flat_conductance(self) -> Array:
        """Conductances g (…, cells)."""
        return self.conductance.reshape(*self.shape[:-2], -1)

    def potentials(self) -> Array:
        """Return P, (…, lines, lines): row a has all lines for the excitation of line a.

        The excitation is a unit current into the line, and P is Z.
        """
        return self._impedance

    def read_potentials(self) -> Array:
        """Return P for excitations of lines where they are read; see `DifferenceNetwork.far`."""
        return self.potentials()

    def free(self, values: Array) -> Array:
        """Return values (…, lines, patterns) of lines that are not held, 0 for held ones."""
        return values

    def reading(self) -> Array:
        if self.circuit is None:
            return across(self._entries)
        reading = equation_of(self.circuit, *self.shape[-2:]).reading(*self._entries)
        whole = reading.shape == self.shape
        return reading if whole else np.array(np.broadcast_to(reading, self.shape))

    @cached_property
    def _entries(self) -> Entries:
        """Entries of Z."""
        return self.entries(self._impedance)

    @cached_property
    def slopes(self) -> Entries:
        """First derivatives (h_p, h_q, h_t), or (h_p, h_q, h_t, h_e, h_f)."""
        if self.circuit is None:
            return TWO_POINT_SLOPES
        return tuple(law_derivatives(self.circuit, self._entries, self.shape, 1))

    @cached_property
    def curvatures(self) -> Array | None:
        """Second derivatives h″ of h, (entries, entries, rows, columns); None: h is linear."""
        if self.circuit is None:
            return None
        second = law_derivatives(self.circuit, self._entries, self.shape, 2)
        return second.reshape(len(self._entries), -1, *self.shape)

    def read_change(self, change: Entries) -> Array:
        """Return h_p·dp + h_q·dq + h_t·dt, (rows, columns)."""
        row, column, *others = (
            slope * part for slope, part in zip(self.slopes, change, strict=True)
        )
        return sum(others, row + column)

    def forward(self, step: Array) -> Array:
        """Return J·p = ∂y/∂u·p for a step p of u = log r, (rows, columns)."""
        return self.read_change(self.changes(step / self.cell_resistance))

    def adjoint(self, weights: Array) -> Array:
        """Return Jᵀ·w = g·bᵀ(Z W Z)b for weights w of the readings, (rows, columns)."""
        return self.drawn(self.loading(weights)) / self.cell_resistance

    def loading(self, weights: Array) -> Loading:
        """Return W of weights (rows, columns) of the readings.

        Of two-point readings it is L_w, the Laplacian with the weights as conductances.
        """
        return loading_of(*(weights * slope for slope in self.slopes))

    def loaded(self, loading: Loading, values: Array) -> Array:
        """Return W·V, (…, lines, patterns), for values V of the same shape."""
        product = bipartite(loading.diagonal, loading.between, values)
        if loading.of_potentials is not None:
            # ½ (x w_vᵀ + w_v xᵀ)
            assert self.sources is not None
            source = 0.5 * self.sources[..., None]
            weight = loading.of_potentials[..., None]
            product += source * (weight.swapaxes(-1, -2) @ values)
            product += weight * (source.swapaxes(-1, -2) @ values)
        return product

    # Sums over the cells, D = Z·B, and X = BᵀZB. `DifferenceNetwork` has another D, and another X.

    @cached_property
    def potential_differences(self) -> Array:
        """D = P·B (…, lines, cells): across every cell for the excitation of every line."""
        return self.across_cells(self.read_potentials())

    @cached_property
    def transfer(self) -> Array:
        """X = BᵀZB (…, cells, cells) ohm: ∂D_ac/∂g_d = −D_ad X_dc."""
        return self.between(self._impedance)

    @property
    def across_readings(self) -> Array:
        """Difference across every cell for a unit current through each reading's two lines.

        The shape is (…, readings, cells). Without wire it is X.
        """
        return self.transfer

    def currents(self, step: Array) -> Array:
        """Return B·diag(s)·Dᵀ = L_s Z, (…, lines, lines), for steps s = g·p, (rows, columns)."""
        return bipartite(line_sums(step), -step, self._impedance)

    def changes(self, step: Array) -> Entries:
        """Return the entries of D·diag(s)·Dᵀ = P·B·diag(s)·Dᵀ for steps s = g·p."""
        return self.entries_of_product(self.potentials(), self.currents(step))

    def drawn(self, loading: Loading) -> Array:
        """Return diag(DᵀWD) = bᵀ(Z W Z)b of every cell, (rows, columns)."""
        impedance = self._impedance
        loaded = bipartite(loading.diagonal, loading.between, impedance)
        drawn = across(self.entries_of_product(impedance, loaded, with_sources=False))
        if loading.of_potentials is not None:
            # ½ bᵀZ (x w_vᵀ + w_v xᵀ) Zb
            by_weights = matrix_vector(impedance, loading.of_potentials)
            drawn += self.source_differences * self.across_cells(by_weights).reshape(self.shape)
        return drawn

    def weighed(self, loading: Loading) -> Array:
        """Return the product with W that second derivatives share, Z W Z (lines, lines)."""
        return self._impedance @ self.loaded(loading, self._impedance)

    def drawn_of(self, weighed: Array) -> Array:
        """Return diag(DᵀWD) from `weighed`, (rows, columns)."""
        return across(self.entries(weighed))

    def between_cells(self, weighed: Array) -> Array:
        """Return DᵀWD from `weighed`, (…, cells, cells)."""
        return self.between(weighed)

    def moved(self, weighed: Array, step: Array) -> tuple[Entries, Array]:
        """Return the first-order changes for steps s = g·p, (rows, columns).

        Returns
        -------
        change : Entries
            Those of dK = D·diag(s)·Dᵀ; see `changes`.
        drawn : array, shape (rows, columns)
            2 diag(DᵀW dD), dDᵀ = X·diag(s)·Dᵀ.
        """
        currents = self.currents(step)
        change = self.entries_of_product(self._impedance, currents)
        second = self.entries_of_product(weighed, currents, symmetric=False, with_sources=False)
        return change, 2 * across(second)

    @cached_property
    def source_differences(self) -> Array:
        """Difference of v = Pᵀ·x across every cell, (…, rows, columns)."""
        assert self.sources is not None
        potentials = matrix_vector(self.potentials().swapaxes(-1, -2), self.sources)
        return self.across_cells(potentials).reshape(self.shape)

    def across_cells(self, values: Array) -> Array:
        """Return V·B (…, cells) for values V (…, lines)."""
        row, column = self._parts(values)
        return (row - column).reshape(*values.shape[:-1], -1)

    def own_differences(self) -> tuple[Array, Array]:
        """Return (D_jc, D_kc) of every cell c at its own row j and column k, (rows, columns)."""
        row, column, mutual, *_ = self._entries
        return row - mutual, mutual - column

    # Derivatives of single readings.

    def entry_responses(self, j: Any = EVERY_ROW, k: Any = EVERY_COLUMN) -> Entries:
        """Return g_c·(D_jc², D_kc², D_jc·D_kc).

        The shapes are (rows, cells), (columns, cells), (rows, columns, cells). With potentials
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

    def sensitivity(self, read: Mask | None = None) -> Array:
        """Return J, (…, readings, cells); of two-point readings J = (D_jc − D_kc)²·g_c."""
        response: Array
        if self.circuit is None:
            response = self.across_readings**2
            response *= self.flat_conductance[..., None, :]
            return response if read is None else response[read.ravel()]
        # ∂y_jk/∂u_c = h_p·g_c D_jc² + h_q·g_c D_kc² + h_t·g_c D_jc D_kc
        j: Any = EVERY_ROW
        k: Any = EVERY_COLUMN
        slopes = self.slopes
        if read is not None:
            j, k = np.nonzero(read)
            slopes = tuple(slope[read] for slope in slopes)
        parts = self.entry_responses(j, k)
        response = slopes[2][..., None] * parts[2]
        for number, lines in ((0, j), (1, k), (3, j), (4, k))[: len(parts) - 1]:
            response += slopes[number][..., None] * parts[number][lines]
        return response.reshape(-1, response.shape[-1])

    def own_response(self) -> Array:
        row, column = self.own_differences()
        if self.circuit is None:
            return (row - column) ** 2 / self.cell_resistance
        change: Entries = (row**2, column**2, row * column)
        if self.sources is not None:
            change += row * self.source_differences, column * self.source_differences
        return self.conductance * self.read_change(change)

    def response_of(self, response: "Callable[[SolvedNetwork], Array]") -> Array:
        return response(self)

    def second_order(self, weights: Array) -> SecondOrder:
        return SolvedSecondOrder(self, weights)

    def normal_by_lines(self, weight: Array) -> NormalByLines:
        """Return JᵀWJ; of two-point readings with parts of rows and columns, `square_by_lines`."""
        if self.circuit is not None:
            return super().normal_by_lines(weight)
        return square_by_lines(self.conductance, self.reading(), weight)

    def leaking(self, across: Array, siemens: float) -> Self:
        """Return the network with conductances between lines; see `Network.leaking`.

        By Woodbury's formula Z becomes Z − Z B (1/G + BᵀZB)⁻¹ BᵀZ.
        """
        between = across.T @ self.free(self.potentials() @ across)
        towards = self.read_potentials() @ across
        # (1/G + Bᵀ Z B)⁻¹ = G (1 + G Bᵀ Z B)⁻¹, which allows G = 0
        core = siemens * np.linalg.inv(np.eye(across.shape[1]) + siemens * between)
        changed = self._impedance - towards @ core @ towards.swapaxes(-1, -2)
        return replace(self, _impedance=changed)

    def entries(self, matrix: Array) -> Entries:
        """Return (K_jj, K_kk, K_jk) of K (…, lines, lines), with sources also both parts of K·x."""
        row, column = self._parts(matrix.diagonal(axis1=-2, axis2=-1))
        entries = row, column, matrix[..., : self.rows, self.rows :]
        if self.sources is None:
            return entries
        return *entries, *self._parts(matrix_vector(matrix, self.sources))

    def _parts(self, potentials: Array) -> tuple[Array, Array]:
        """Return potentials (…, lines) of rows, (…, rows, 1), and of columns, (…, 1, columns)."""
        return potentials[..., : self.rows, None], potentials[..., None, self.rows :]

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
        entries = (*self._parts(diagonal), mutual)
        if self.sources is None or not with_sources:
            return entries
        return *entries, *self._parts(matrix_vector(left, matrix_vector(right, self.sources)))

    def between(self, matrix: Array) -> Array:
        """Return BᵀKB (…, cells, cells) for K (…, lines, lines)."""
        at_cells = self.across_cells(matrix)
        transfer = at_cells[..., : self.rows, None, :] - at_cells[..., None, self.rows :, :]
        return transfer.reshape(*self.shape[:-2], -1, at_cells.shape[-1])


@dataclass(frozen=True, eq=False)
class SolvedSecondOrder(SecondOrder):
    """Second derivatives of a solved network, from D, X and the law; see `SecondOrder`."""

    network: SolvedNetwork

    @cached_property
    def _weighed(self) -> Array:
        """Product of the network with W for the weights; see `SolvedNetwork.weighed`."""
        return self.network.weighed(self.network.loading(self.weights))

    def adjoint(self) -> Array:
        """Return Jᵀ·w = g·diag(DᵀWD), (rows, columns)."""
        return self.network.drawn_of(self._weighed) / self.network.cell_resistance

    def products(self, step: Array) -> tuple[Array, Array]:
        """Return J·p and H·p = g·(2 diag(DᵀW dD) + diag(DᵀW'D)).

        W' is the change of W by that of the slopes of h; see `SecondOrder.products`.
        """
        network = self.network
        change, second = network.moved(self._weighed, step / network.cell_resistance)
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
            return list((weighted * all_entries(change, shape)).sum(axis=1))
        changes: list[Array] = [np.zeros(shape) for _ in change]
        # Of single networks alone: the shape is that of the readings, and of the cells
        for of, by in np.argwhere(weighted.any(axis=(-2, -1))):
            changes[of] += weighted[of, by][..., None] * change[by]
        return changes

    @cached_property
    def _weighted_curvatures(self) -> Array:
        """w·h″, (entries, entries, rows, columns)."""
        assert self.network.curvatures is not None
        return self.weights * self.network.curvatures

    def matrix(self) -> Array:
        """Return H = 2 g (X ∘ DᵀWD) g plus the curvature of h, (…, cells, cells)."""
        network = self.network
        conductance = network.flat_conductance
        matrix = network.transfer * (2 * conductance[..., None])
        matrix *= network.between_cells(self._weighed)
        matrix *= conductance[..., None, :]
        if network.curvatures is not None:
            # Σ_i w_i (∂(p, q, t)_i)ᵀ h″_i ∂(p, q, t)_i
            responses = network.entry_responses()
            # Axes of the readings along which a response is the same: its own line has several
            axes = (1, 0, (), 1, 0)[: len(responses)]
            changes = self.change_of_slopes(tuple(map(np.expand_dims, responses, axes)))
            for response, change, axis in zip(responses, changes, axes, strict=True):
                changed = change if axis == () else change.sum(axis=axis)
                matrix += response.reshape(-1, len(matrix)).T @ changed.reshape(-1, len(matrix))
        return matrix
