"""Selection of changed cells with a spike-and-slab prior.

Log changes d of cells that stand still are N(0, P⁻¹). A cell moved with odds of one to four, and
then by N(0, 1). The changes of the moved cells M are integrated out:

    −2 ln evidence = dᵀ P d + MOVED_COST |M| + ln |P_MM + 1| − s_Mᵀ (P_MM + 1)⁻¹ s_M,   s = P d

The search adds or removes one cell at a time, each time the one that lowers −2 ln evidence most.
The sweep operator updates all gains after an exchange in O(cells²).

A load is an extended thing: its cells change alike, and its outline counts, not its area. Where
circuits are compared, the moved cells are single ones, as above, or a smooth field within an
outline, whose size, distance and share of each cell's own are estimated (`Changes.cost_of_field`).
An outline costs OUTLINE_COST an edge, because a walk along edges goes on in one of three
directions. A load that touches all cells has none.
Sources: Mitchell & Beauchamp, J. Am. Stat. Assoc. 83, 1988; Goodnight, The American Statistician
33, 1979; Madras & Slade, The Self-Avoiding Walk, 1993 (number of outlines of a length).
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import NamedTuple, Self

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from lampest.inference.number import mean_cost
from lampest.panel.panel import Array, Mask, Numbers
from lampest.posterior.gaussian import Conditioned
from lampest.posterior.linear import inverse_and_volume, misfit_and_volume, swept, whitened

MOVED_COST = 2.8  # 2 ln 4: −2 ln of the prior odds of one to four that a cell moved
OUTLINE_COST = 2 * float(np.log(3))  # for each edge between a moved and a still cell
# −2 ln prior odds of a bound, an effect or a resistance in series that an explanation needs
PARAMETER_COST = 12.0
# Smooth fields that are tried: deviations of ln r, distances in cells, shares of the variance.
FIELD_DEVIATIONS = (0.3, 1.0, 3.0)
CORE_SHARE = 0.2  # of the largest change: the core of a load changes by more
FIELD_CELLS = (1.0, 2.0, 4.0, np.inf)
OWN_SHARES = (1e-4, 1e-2, 1e-1)
TRIED_SIZES = (FIELD_DEVIATIONS, FIELD_CELLS, OWN_SHARES)
TAILS = (0.03, 0.1, 0.3)  # of a load: tried deviations of ln r of the cells beside its core
MAX_EXCHANGES = 4  # for each cell, of one search
MIN_PIVOT = 1e-300  # rounding may take a pivot to zero, whose logarithm does not exist
FIRST_ROOM = 16  # added cells for which memory is taken first; it doubles as needed
MIN_STILL_SHARE = 0.3  # of the cells: with fewer still cells, a load covers the panel


def mostly_still(moved: Mask) -> bool:
    """Return whether fewer than half of the cells moved."""
    return 2 * int(moved.sum()) < moved.size


def away_from_changed(still: Mask, shape: tuple[int, ...]) -> Mask:
    """Return the still cells of all frames without the neighbours of moved cells.

    The tail of a load moves these neighbours. Where less than MIN_STILL_SHARE of the cells would
    remain, all still cells are returned.

    Parameters
    ----------
    still : boolean array, shape (frames · cells,)
    shape : tuple of int
        Rows and columns.
    """
    distant = ~touching(~still.reshape(-1, *shape)).ravel()
    return distant if distant.mean() >= MIN_STILL_SHARE else still


def touching(chosen: Mask) -> Mask:
    """Return the chosen cells with their eight neighbours, (frames, rows, columns)."""
    around = np.pad(chosen, ((0, 0), (1, 1), (1, 1)))
    return np.asarray(sliding_window_view(around, (3, 3), axis=(1, 2)).any(axis=(-2, -1)))


@dataclass(frozen=True, eq=False)
class Changes:
    """Changes of the log cells between frames, d = A z + noise over still cells.

    The errors are z ~ N(0, 1).

    Attributes
    ----------
    change : array, shape (n,)
        d.
    noise : array, shape (n, n)
        Σ, the covariance of d over still cells without these errors.
    columns : array, shape (n, errors)
        A.
    """

    change: Array
    noise: Array
    columns: Array

    @cached_property
    def covariance(self) -> Array:
        """C = Σ + A Aᵀ, the covariance of d over still cells, (n, n)."""
        return self.noise + self.columns @ self.columns.T

    @cached_property
    def inverse_and_volume(self) -> tuple[Array, float]:
        """Inverse of the covariance, and its determinant.

        Returns
        -------
        precision : array, shape (n, n)
            C⁻¹.
        volume : float
            ln |C⁻¹|.
        """
        return inverse_and_volume(self.covariance)

    def selected(self, starts: Sequence[Mask]) -> tuple[float, Mask]:
        """Select the moved cells, see `select_changed`.

        Returns
        -------
        score : float
            −2 ln evidence.
        moved : boolean array, shape (n,)
            The moved cells.
        """
        precision, volume = self.inverse_and_volume
        slope = precision @ self.change
        lost, moved = select_changed(slope, precision, starts)
        return lost + float(self.change @ slope) - volume, moved

    def cost_of_field(self, place: Numbers, changed: Mask) -> float:
        """Return −2 ln evidence of the changes as a smooth field within an outline.

        Parameters
        ----------
        place : integer array, shape (n, 2)
            Row and column of each cell.
        changed : boolean array, shape (n,)
            Cells within the outline.
        """
        covariances = map(Field.of(place[changed]).covariance, EVERY_SIZE)
        evidence = mean_cost(self.costs_with(changed, covariances))
        return OUTLINE_COST * outline(place, changed) + evidence

    def costs_with(self, cells: Mask, covariances: Iterable[Array]) -> Array:
        """Return −2 ln density with further changes of some cells, for each covariance of these.

        They change the second factor alone of p(d) = p(d_others) p(d_cells | d_others).
        """
        covariance = self.covariance
        root = np.linalg.cholesky(covariance[np.ix_(~cells, ~cells)])
        of_others = np.column_stack([self.change, covariance[:, cells]])[~cells]
        known, across = np.split(whitened(root, of_others), [1], axis=1)
        change = self.change[cells] - across.T @ known[:, 0]
        noise = covariance[np.ix_(cells, cells)] - across.T @ across
        costs = [sum(misfit_and_volume(noise + each, change)) for each in covariances]
        others = np.sum(known**2) + 2 * np.log(root.diagonal()).sum()
        return np.asarray(others + np.array(costs))

    def outlines(self, place: Numbers, moved: Mask) -> list[Mask]:
        """Return outlines that a load may have: that of the moved cells, and one about its core.

        Noise and the tail of a load make the first one long. The core are cells with more than
        CORE_SHARE of the largest change, the outline is about their neighbours.

        Parameters
        ----------
        place : integer array, shape (n, 2)
            Row and column of each cell.
        moved : boolean array, shape (n,)
        """
        return [moved, core_and_around(self.change, place)[1]]

    def single_loads(self, place: Numbers) -> "list[Load]":
        """Return loads of single cells that may have made the changes, beside errors z.

        Their core are cells with more than CORE_SHARE of the largest change. Changes of the core
        and of further single cells, with tails beside the core, are as probable as `smooth_loads`.

        Parameters
        ----------
        place : integer array, shape (n, 2)
            Row and column of each cell.
        """
        core, around = core_and_around(self.change, place)
        loads = list[Load]()
        for tail in TAILS:
            loaded = np.where(core, FIELD_DEVIATIONS[-1], tail * around)
            beside = replace(self, noise=self.noise + np.diag(loaded**2))
            further = beside.selected([np.zeros_like(core)])[1]
            single = np.where(further, 1.0, loaded)
            cells = single > 0
            cost = MOVED_COST * int((core | further).sum()) + 2 * float(np.log(len(TAILS)))
            loads.append(Load(cost, cells, [np.diag(single[cells] ** 2)], smooth=False))
        return loads

    def with_load(self, cells: Mask, covariance: Array) -> "Changes":
        """Return the changes with further ones of these cells, as noise."""
        noise = self.noise.copy()
        noise[np.ix_(cells, cells)] += covariance
        return replace(self, noise=noise)

    def part(self, cells: Mask) -> "Changes":
        """Return the changes of these cells alone."""
        return Changes(self.change[cells], self.noise[np.ix_(cells, cells)], self.columns[cells])

    @property
    def misfit(self) -> float:
        """χ² of the changes, dᵀ C⁻¹ d."""
        return misfit_and_volume(self.covariance, self.change)[0]

    @property
    def errors(self) -> Conditioned:
        """The errors z, conditioned on the changes."""
        return Conditioned.on(self.columns, self.noise, np.eye(self.columns.shape[1]))

    def posterior(self, still: Mask) -> tuple[Array, Array]:
        """Return the posterior of z given the changes d_s of the still cells.

        Returns
        -------
        mean : array, shape (errors,)
        covariance : array, shape (errors, errors)
        """
        part = self.part(still)
        errors = part.errors
        return errors.mean(part.change), errors.covariance


def places_of(shape: tuple[int, ...]) -> Numbers:
    """Return row and column of each cell of a panel of this shape, (cells, 2)."""
    return np.argwhere(np.ones(shape, dtype=bool))


class FieldSizes(NamedTuple):
    """Sizes of a smooth field, as numbers of those that are tried.

    Attributes
    ----------
    deviation, cells, own : int
        Numbers of one of FIELD_DEVIATIONS, FIELD_CELLS and OWN_SHARES.
    """

    deviation: int
    cells: int
    own: int


MIDDLE_SIZES = FieldSizes(deviation=1, cells=1, own=0)
EVERY_SIZE = [FieldSizes(*each) for each in product(*map(range, map(len, TRIED_SIZES)))]


class Load(NamedTuple):
    """Equally probable loads that may have made the changes of cells.

    Attributes
    ----------
    cost : float
        −2 ln of the prior probability of each, up to a constant.
    cells : boolean array, shape (n,)
        Cells that they change.
    covariances : list of array, shape (cells, cells)
        Covariance of the changes of these cells by each.
    smooth : bool
        Whether it is a smooth field, and not single cells.
    """

    cost: float
    cells: Mask
    covariances: list[Array]
    smooth: bool


@dataclass(frozen=True, eq=False)
class Field:
    """Changes of the cells within an outline that are a smooth field, N(0, s² ((1 − o) S + o)).

    All FIELD_DEVIATIONS s, FIELD_CELLS ℓ of S and shares OWN_SHARES o of a cell's own are equally
    probable.

    Attributes
    ----------
    smooth : array, shape (distances, n, n)
        S of each distance ℓ: exp(−distance²/(2 ℓ²)) of two cells.
    own : array, shape (n, n)
        Covariance of changes of each cell's own.
    """

    smooth: Array
    own: Array

    @classmethod
    def of(cls, place: Numbers) -> Self:
        """Return the field of the cells at places (n, 2), which are rows and columns."""
        square = ((place[:, None] - place) ** 2).sum(axis=-1)
        smooth = [np.exp(-square / (2 * cells**2)) for cells in FIELD_CELLS]
        return cls(np.stack(smooth), np.eye(len(place)))

    def through(self, jacobian: Array) -> "Field":
        """Return the field of readings with this Jacobian, (readings, n)."""
        return Field(jacobian @ self.smooth @ jacobian.T, jacobian @ self.own @ jacobian.T)

    def covariance(self, sizes: FieldSizes) -> Array:
        """Return the covariance with these sizes, (n, n)."""
        variance, own = FIELD_DEVIATIONS[sizes.deviation] ** 2, OWN_SHARES[sizes.own]
        covariance = variance * (1 - own) * self.smooth[sizes.cells]
        covariance += variance * own * self.own
        return np.asarray(covariance)


def core_and_around(change: Array, place: Numbers) -> tuple[Mask, Mask]:
    """Return the core of a load, and the same with the eight neighbours of its cells, (n,) each.

    The core are cells with more than CORE_SHARE of the largest change.

    Parameters
    ----------
    change : array, shape (n,)
    place : integer array, shape (n, 2)
        Row and column of each cell.
    """
    size = np.abs(change)
    core = size > CORE_SHARE * size.max()
    distance = np.abs(place[:, None] - place[core]).max(axis=-1)
    return core, np.asarray((distance <= 1).any(axis=1))


def smooth_loads(change: Array, place: Numbers) -> list[Load]:
    """Return loads that are a smooth field: of the core and the cells beside it, and of all cells.

    They are the same beside any errors. Parameters as those of `core_and_around`.
    """
    core, around = core_and_around(change, place)
    loads = list[Load]()
    for changed in (around, np.ones_like(core)):
        cost = OUTLINE_COST * outline(place, changed) + 2 * float(np.log(len(EVERY_SIZE)))
        covariances = [*map(Field.of(place[changed]).covariance, EVERY_SIZE)]
        loads.append(Load(cost, changed, covariances, smooth=True))
    return loads


def outline(place: Numbers, moved: Mask) -> int:
    """Return the number of edges between moved and still cells.

    Parameters
    ----------
    place : integer array, shape (n, 2)
        Row and column of each cell.
    moved : boolean array, shape (n,)
    """
    distance = np.abs(place[moved, None] - place[~moved]).sum(axis=-1)
    return int((distance == 1).sum())


def usual_starts(change: Array) -> list[Mask]:
    """Return the sets of moved cells that a search begins with.

    The sets are none, all, and the half that changed most.
    """
    deviation = np.abs(change - np.median(change))
    return [
        np.zeros(len(change), dtype=bool),
        np.ones(len(change), dtype=bool),
        deviation > np.median(deviation),
    ]


def select_changed(slope: Array, precision: Array, starts: Sequence[Mask]) -> tuple[float, Mask]:
    """Return the moved cells with the largest evidence that a search from several starts finds.

    Parameters
    ----------
    slope : array, shape (cells,)
        s = P d.
    precision : array, shape (cells, cells)
        P.
    starts : sequence of boolean array, shape (cells,)
        Moved cells that each search begins with; the best end is returned.

    Returns
    -------
    float
        −2 ln evidence, less dᵀ P d.
    boolean array, shape (cells,)
        The moved cells.
    """
    slab = precision + np.eye(len(slope))
    ends = (_exchange_cells(slope, slab, start) for start in starts)
    return min(ends, key=lambda selection: selection[0])


def _exchange_cells(slope: Array, slab: Array, moved: Mask) -> tuple[float, Mask]:
    """Exchange single cells until no exchange lowers −2 ln evidence.

    Parameters
    ----------
    slope : array, shape (cells,)
        s.
    slab : array, shape (cells, cells)
        P + 1.
    moved : boolean array, shape (cells,)
    """
    inside = np.flatnonzero(moved)
    outside = np.flatnonzero(~moved)
    # Table of the sweep operator [P + 1 | s], swept by the moved cells M: block (M, M) is −(P_MM +
    # 1)⁻¹, the last column holds (P_MM + 1)⁻¹ s_M within M, and s − P_·M (P_MM + 1)⁻¹ s_M outside.
    moved = moved.copy()
    table = np.ascontiguousarray(np.column_stack([slab, slope]))
    inverse, volume = inverse_and_volume(slab[np.ix_(inside, inside)])
    across = slab[np.ix_(outside, inside)]
    pulled = inverse @ np.column_stack([across.T, slope[inside]])
    cost = MOVED_COST * len(inside) - volume - float(slope[inside] @ pulled[:, -1])
    to_outside = np.append(outside, len(slope))
    table[np.ix_(outside, to_outside)] -= across @ pulled
    table[np.ix_(inside, to_outside)] = pulled
    table[np.ix_(inside, inside)] = -inverse
    table[np.ix_(outside, inside)] = pulled[:, :-1].T
    for _ in range(MAX_EXCHANGES * len(slope)):
        # Decrease of −2 ln evidence if a cell is added: s²/p − ln p − MOVED_COST with its pivot p;
        # if it is removed: MOVED_COST − s²/|p| − ln |p|.
        pivots = np.maximum(np.abs(table.diagonal()), MIN_PIVOT)
        gains = np.where(moved, -1, 1) * (table[:, -1] ** 2 / pivots - MOVED_COST) - np.log(pivots)
        cell = int(gains.argmax())
        if not gains[cell] > 0:
            break
        cost -= float(gains[cell])
        moved[cell] = not moved[cell]
        table = swept(table, cell)
    return cost, moved


def scores_with_errors(change: Array, precision: Array, columns: Array) -> Array:
    """Return −2 ln evidence with one further error, for each of several errors, (errors,).

    The change of still cells is d = a θ + noise with θ ~ N(0, 1): the precision P becomes P − P a
    aᵀ P/(1 + aᵀ P a). Compared with no error, −2 ln evidence has ln(1 + aᵀ P a) more. The selection
    of moved cells is greedy: cells are only added.

    Parameters
    ----------
    change : array, shape (cells,)
        d.
    precision : array, shape (cells, cells)
        P, of the change without these errors.
    columns : array, shape (cells, errors)
        a of each error.
    """
    # w = P a (errors, cells), k = 1 + aᵀ P a; P d loses w (wᵀ d)/k, and P + 1 loses w wᵀ/k
    weighted = (precision @ columns).T
    within = 1 + np.sum(weighted * columns.T, axis=1)
    pulled = weighted @ change / within
    slope = precision @ change - pulled[:, None] * weighted
    slab = precision + np.eye(len(change))
    size = np.diag(slab) - weighted**2 / within[:, None]

    def column(cells: Numbers) -> Array:
        of_cell = np.take_along_axis(weighted, cells[:, None], axis=1)
        return np.asarray(slab[cells] - of_cell * weighted / within[:, None])

    # dᵀ P d − (aᵀ P d)²/k, less the gain of moved cells, plus ln k
    unexplained = float(change @ precision @ change) - within * pulled**2
    return np.asarray(unexplained - _gained(slope, size, column) + np.log(within))


def _gained(vector: Array, size: Array, column: Callable[[Numbers], Array]) -> Array:
    """Return the total decrease of −2 ln evidence by greedily added cells, (hypotheses,).

    All hypotheses are treated at once. The matrices P + 1 are factored by pivoted Cholesky, one
    column for each added cell, so that they are never stored.

    Parameters
    ----------
    vector : array, shape (hypotheses, cells)
        s of each.
    size : array, shape (hypotheses, cells)
        Diagonal of each P + 1.
    column : callable
        Returns one column of each P + 1, (hypotheses, cells), for one cell's number of each
        hypothesis, (hypotheses,).
    """
    index = np.arange(len(vector))
    total = np.zeros(len(vector))
    added = np.zeros(vector.shape, dtype=bool)
    # Rows of the pivoted Cholesky factors, one for each added cell; there is room for some more.
    room = np.empty((len(vector), FIRST_ROOM, vector.shape[1]))
    for count in range(vector.shape[1]):
        rows = room[:, :count]
        pivots = np.maximum(size, MIN_PIVOT)
        gains = np.where(added, -np.inf, vector**2 / pivots - np.log(pivots) - MOVED_COST)
        cells = np.argmax(gains, axis=1)
        largest = gains[index, cells]
        active = largest > 0
        if not active.any():
            break
        total = total + np.where(active, largest, 0.0)
        added[index[active], cells[active]] = True
        # Schur complement by the new cell c: column ← column − Σ_k l_k l_kc, s ← s − column s_c/p,
        # and the diagonal loses l².
        of_cell = column(cells) - np.matmul(rows[index, :, cells][:, None], rows)[:, 0]
        pivot = np.where(active, of_cell[index, cells], 1.0)[:, None]
        of_cell = np.where(active[:, None], of_cell, 0.0)
        vector = vector - of_cell * (vector[index, cells][:, None] / pivot)
        if count == room.shape[1]:
            room = np.concatenate([room, np.empty_like(room)], axis=1)
        room[:, count] = of_cell / np.sqrt(pivot)
        size = size - room[:, count] ** 2
    return total
