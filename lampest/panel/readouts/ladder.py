"""Wire between the terminals and the cells of a panel, with contacts and touching lines."""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from lampest.panel.panel import Array, Mask
from lampest.panel.readouts.wiring import Wiring


@dataclass(frozen=True, eq=False)
class Ladder:
    """Factorisation of K·i = e for the currents i through cells.

    The potential differences are e = Bᵀp of the terminals. K = diag(r) + T, T_cd the resistance of
    the wire that the paths of cells c and d to the terminals share. K is solved by block
    elimination along a ladder: the rows are its rungs, the wire of the columns its rails. The rungs
    passed so far act as a source with an internal conductance. Each rung adds its own conductance
    to it, and each segment of the rails its resistance. The cost is rows·columns³.

    Attributes
    ----------
    outer, inner : slice
        Slices that order the rungs, and the cells of a rung: a rung enters at its first cell, rails
        leave at the last rung.
    rung : array, shape (rungs, n, n)
        Inverse of K of every rung alone, siemens.
    passed : array, shape (rungs, n, n)
        Share of the source current that passes the next segment of the rails.
    shown : array, shape (rungs, n, n)
        Conductance of all rungs so far, as seen behind that segment, siemens.
    segment_ohm : array, shape (rungs, n)
        Resistance of the segments of the rails, ohm; the last one includes the contacts.
    """

    outer: slice
    inner: slice
    rung: Array
    passed: Array
    shown: Array
    segment_ohm: Array

    @classmethod
    def of(cls, cells: Array, wiring: Wiring) -> "Ladder":
        """Return the ladder of cells (rows, columns) ohm."""
        lines = wiring.lines
        contacts = wiring.contact_ohm(cells.shape)
        outer = slice(None, None, -1 if lines.columns_leave == "top" else 1)
        inner = slice(None, None, -1 if lines.rows_enter == "right" else 1)
        turned = cells[outer, inner]
        count, size = turned.shape
        steps = np.arange(1, size + 1)
        # K of one rung: cells c and d share min(c, d) segments and the rung's contact; r on the
        # diagonal.
        matrix = np.tile(
            lines.row_ohm_per_cell * np.minimum.outer(steps, steps).astype(float), (count, 1, 1)
        )
        matrix += contacts[:count][outer, None, None]
        np.einsum("kcc->kc", matrix)[...] += turned
        segment = np.full((count, size), lines.column_ohm_per_cell)
        segment[-1] += contacts[count:][inner]
        rung = np.linalg.inv(matrix)
        passed = np.empty_like(rung)
        shown = np.empty_like(rung)
        conductance = np.zeros((size, size))
        for number in range(count):
            # Y ← (1 + (Y + Y_rung)·diag(segment))⁻¹ (Y + Y_rung), the conductance behind the next
            # segment
            total = conductance + rung[number]
            passed[number] = np.linalg.inv(np.eye(size) + total * segment[number])
            conductance = shown[number] = passed[number] @ total
        return cls(outer, inner, rung, passed, shown, segment)

    def solve(self, differences: Array) -> Array:
        """Return i = K⁻¹·e, the currents through the cells, in ampere.

        e is (rows, columns, patterns) volt; the result has the same shape.
        """
        driven = self.rung @ differences[self.outer, self.inner]
        source = np.empty_like(driven)
        potential = np.empty_like(driven)
        # Forward: source current of all rungs so far, behind each segment.
        behind = np.zeros(driven.shape[1:])
        for number in range(len(driven)):
            behind = source[number] = self.passed[number] @ (behind + driven[number])
        # Backward: currents through the segments, and potentials of the rails at each rung.
        rail = np.zeros(driven.shape[1:])
        for number in reversed(range(len(driven))):
            current = source[number] - self.shown[number] @ rail
            rail = potential[number] = rail + self.segment_ohm[number, :, None] * current
        return (driven - self.rung @ potential)[self.outer, self.inner]


@dataclass(frozen=True, eq=False)
class Wire:
    """Cells behind wire, as seen from the terminals.

    The currents through the cells for potentials p of the terminals are C·p with C = K⁻¹Bᵀ, B the
    incidence of cells and lines, and K that of `Ladder`. The differences across the cells are
    r·C·p, so that Cᵀr takes the place of B. While all terminals are held, a current driven through
    a cell causes the differences of X₀ = diag(r) − r K⁻¹ r. Without wire C = g·Bᵀ and X₀ = 0.

    Attributes
    ----------
    cells : array, shape (rows, columns)
        Resistances r of the cells, ohm.
    ladder : Ladder
        Factorisation of K.
    currents : array, shape (cells, lines)
        C in siemens.
    """

    cells: Array
    ladder: Ladder
    currents: Array

    @classmethod
    def of(cls, cells: Array, wiring: Wiring) -> Self:
        """Return the wire of cells (rows, columns) ohm."""
        ladder = Ladder.of(cells, wiring)
        return cls(cells, ladder, ladder.solve(incidence(*cells.shape)).reshape(cells.size, -1))

    @property
    def admittance(self) -> Array:
        """BC (lines, lines): currents of every terminal for a unit potential at each, siemens."""
        return into_lines(self.currents.reshape(*self.cells.shape, -1))

    @cached_property
    def _resistance(self) -> Array:
        """r, (cells, 1)."""
        return self.cells.reshape(-1, 1)

    def across(self, potentials: Array) -> Array:
        """Return p·Cᵀ·r, (…, cells), for potentials p (…, lines)."""
        return (self._resistance * (self.currents @ np.atleast_2d(potentials).T)).T

    def entering(self, currents: Array) -> Array:
        """Return Cᵀ·r·i, (lines, patterns), for currents i driven through the cells."""
        return self.currents.T @ (self._resistance * currents)

    def within(self, currents: Array) -> Array:
        """Return X₀·i, (cells, patterns) volt, for currents i driven through the cells."""
        pushed = self._resistance * currents
        drawn = self.ladder.solve(pushed.reshape(*self.cells.shape, -1)).reshape(pushed.shape)
        return pushed - self._resistance * drawn


@dataclass(frozen=True, eq=False)
class FarEnds:
    """Far ends of lines, beyond the last cell, from which no current flows.

    Their potentials are those of the terminals plus M·i for the currents i through the cells, M_lc
    the resistance of line l from the terminal to cell c, negative for rows, from which currents
    flow. For potentials p of the terminals and currents i₀ driven through the cells M·i = M·C·p −
    M·K⁻¹·r·i₀; see `Wire`.

    Attributes
    ----------
    lines : boolean array, shape (lines,)
        Lines that have a far end; the others have zeros in M.
    of_lines : array, shape (lines, lines)
        M·C.
    of_cells : array, shape (lines, cells)
        −M·K⁻¹·r in ohm.
    """

    lines: Mask
    of_lines: Array
    of_cells: Array

    @classmethod
    def of(cls, wire: Wire, wiring: Wiring, lines: Mask) -> Self:
        """Return the far ends of some lines of a wire."""
        rows, columns = wire.cells.shape
        ohm = np.tile(wiring.contact_ohm(wire.cells.shape), (rows, columns, 1))
        along, down = wiring.wire_ohm(wire.cells.shape)
        ohm[..., :rows] += along[..., None]
        ohm[..., rows:] += down[..., None]
        # Mᵀ = −Bᵀ∘ohm; K⁻¹Mᵀ is the transpose of M·K⁻¹, because K is symmetric
        solved = wire.ladder.solve(-incidence(rows, columns) * ohm * lines)
        of_cells = -(wire.cells[..., None] * solved).reshape(wire.cells.size, -1)
        return cls(lines, into_lines(solved).T, of_cells.T)


def into_lines(currents: Array) -> Array:
    """Return B·i, (lines, patterns), for currents i (rows, columns, patterns) through the cells."""
    return np.concatenate([currents.sum(axis=1), -currents.sum(axis=0)])


def incidence(rows: int, columns: int) -> Array:
    """Return Bᵀ, (rows, columns, lines): +1 at a cell's row, −1 at its column."""
    matrix = np.zeros((rows, columns, rows + columns))
    np.einsum("jkj->jk", matrix[..., :rows])[...] = 1.0
    np.einsum("jkk->jk", matrix[..., rows:])[...] = -1.0
    return matrix
