"""Currents through the cells of a wired panel, exactly and without building its matrix.

With e = Bᵀp the potential differences that terminals at potentials p put on the cells, currents i flow through them:

    K·i = e,   K = diag(r) + T,   T_cd = Σ of the wire that cells c and d have in common on their ways to the terminals.

K is solved exactly, without building it and without a large conductance in it: wire of no resistance is no special
case. Along the lines of one side, c and d of the same line, K is a matrix of that line; from line to line the currents
add up like in a ladder: the cells passed so far are a source with an internal conductance, to which each line adds its
own and each segment of wire its resistance (block elimination). Costs long·short³ for M·N = long·short cells.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lampest.panel.panel import Array


@dataclass(frozen=True, eq=False)
class Ladder:
    """K⁻¹ of a wired panel, in an order where rungs are chains that enter at their first cell, rails leave at the last.

    swapped : whether the columns are the rungs. outer, inner : steps that put rungs and their cells in that order.
    rung : (rungs, n, n) siemens, of every rung's own K⁻¹. passed : (rungs, n, n), the share of the current that gets
    through the next segment of the rails. shown : (rungs, n, n) siemens, the conductance that all rungs so far show
    beyond that segment. segment_ohm : (rungs, n) of the rails, the contacts in the last.
    """

    swapped: bool
    outer: slice
    inner: slice
    rung: Array
    passed: Array
    shown: Array
    segment_ohm: Array

    @classmethod
    def of(
        cls,
        cells: Array,
        swapped: bool,
        flipped: tuple[bool, bool],
        ohm: tuple[float, float],
        contact_ohm: Sequence[Array],
    ) -> "Ladder":
        """Of cells (rows, columns) ohm in the panel's order.

        flipped : whether rungs, and cells of a rung, come from the last to the first. ohm, contact_ohm : of a segment,
        and of every line's contact, of the rungs and of the rails.
        """
        outer, inner = (slice(None, None, -1 if flip else 1) for flip in flipped)
        turned = (cells.T if swapped else cells)[outer, inner]
        along, across = ohm
        count, size = turned.shape
        steps, every = np.arange(1, size + 1), np.arange(size)
        matrix = np.tile(along * np.minimum.outer(steps, steps).astype(float), (count, 1, 1))
        matrix += contact_ohm[0][outer, None, None]
        matrix[:, every, every] += turned
        segment = np.full((count, size), across)
        segment[-1] += contact_ohm[1][inner]
        rung = np.linalg.inv(matrix)
        passed, shown = np.empty_like(rung), np.empty_like(rung)
        before, one = np.zeros((size, size)), np.eye(size)
        for number in range(count):
            total = before + rung[number]
            passed[number] = np.linalg.inv(one + total * segment[number])
            before = shown[number] = passed[number] @ total
        return cls(swapped, outer, inner, rung, passed, shown, segment)

    def solve(self, differences: Array) -> Array:
        """i = K⁻¹·e: currents through the cells for e (rows, columns, patterns) volt, the same shape, ampere."""
        turned = (differences.swapaxes(0, 1) if self.swapped else differences)[self.outer, self.inner]
        own = self.rung @ turned
        source, potential = np.empty_like(own), np.empty_like(own)
        before = np.zeros(own.shape[1:])
        for number in range(len(own)):
            before = source[number] = self.passed[number] @ (before + own[number])
        after = np.zeros(own.shape[1:])
        for number in reversed(range(len(own))):
            current = source[number] - self.shown[number] @ after
            after = potential[number] = after + self.segment_ohm[number, :, None] * current
        current = (own - self.rung @ potential)[self.outer, self.inner]
        return current.swapaxes(0, 1) if self.swapped else current
