"""The direction in which a cost bends least, in machine code, without a matrix of cells × cells."""

from typing import Any

import numpy as np

from lampest.panel.machine import machine_code
from lampest.solvers.kernel.algebra import dot_of
from lampest.solvers.kernel.applied import precondition_into
from lampest.solvers.kernel.points import blank_point, free_numbers, priced, put_within
from lampest.solvers.kernel.products import bent_along, modelled

MOST_ROUNDS, DEPENDENT = 12, 1e-10  # of two vectors towards the softest directions; of vectors of length one


@machine_code
def softest_vector(
    addresses: Any, where: Any, arena: Any, given: Any, entries: Any, ties: Any, bounds: Any, position: Any, base: Any,
    seen: Any, inner: Any, share: float,
) -> Any:  # fmt: skip
    """(whether there is one, v): the direction (cells) in which φ bends by less than `share` of what it does in any
    other over the free cells, at `position` u; with the preconditioner that `pursue` left.

    By two vectors, their preconditioned residuals and last changes. Within |Hv − θ₁v| of the first Ritz value lies
    an eigenvalue, and the second one is at most θ₂. Source: Knyazev, SIAM J. Sci. Comput. 23, 2001 (LOBPCG).
    """
    rows, cells = where[9], len(position)
    for number in range(len(given)):
        arena[where[6] + number] = given[number]
    point, moving = blank_point(rows + cells // rows, cells), np.zeros(cells, dtype=np.int64)
    put_within(point[0], position, bounds)
    objective, _ = priced(addresses, where, arena, ties, point)
    free, basis, images = free_numbers(point[0], bounds), np.zeros((6, cells)), np.zeros((6, cells))
    if len(free) < len(basis) or not abs(objective) < np.inf:
        return False, basis[0]
    moving[free] = 1
    model, links = modelled(addresses, where, arena, entries, point, 0, True)
    for number in range(len(free)):  # any two that are not orthogonal to what is sought
        basis[0, free[number]], basis[1, free[number]] = np.cos(number + 0.5), np.cos(2 * number + 1.0)
    residual, fresh, left = np.empty(cells), 0, 0.0
    for _ in range(MOST_ROUNDS):
        for vector in range(fresh, fresh + 2):
            bent_along(addresses, rows, model, links, point, True, basis[vector], images[vector])
            for cell in range(cells):
                images[vector, cell] *= moving[cell]
        bends = _narrowed(basis, images)
        for vector in range(2):
            for cell in range(cells):
                residual[cell] = images[vector, cell] - bends[vector] * basis[vector, cell]
            left = np.sqrt(dot_of(residual, residual)) if vector == 0 else left
            precondition_into(addresses, rows, (base, seen, inner, True), moving, residual, basis[2 + vector])
        if bends[0] - left > share * bends[1]:
            break
        fresh = 2
    return bool(bends[0] <= share * bends[1]), basis[0].copy()


@machine_code
def _narrowed(basis: Any, images: Any) -> Any:
    """(2) θ : the least of vᵀHv over vectors v of length one that `basis` (6, cells) spans, and of those across it.

    images : H·basis. Of both the first two rows ← the vectors where these stand, the last two ← how these came to be
    from others than themselves; rows of zeros count for nothing.
    """
    count = len(basis)
    overlap, size = basis @ basis.T, np.zeros(count)
    for vector in range(count):
        size[vector] = 1 / np.sqrt(overlap[vector, vector]) if overlap[vector, vector] > 0 else 0.0
    length, mixed = np.linalg.eigh(overlap * size * size.reshape(count, 1))
    first = 0
    while length[first] <= DEPENDENT:
        first += 1
    across = np.ascontiguousarray(mixed[:, first:] * size.reshape(count, 1) / np.sqrt(length[first:]))
    bends, best = np.linalg.eigh(across.T @ (basis @ images.T) @ across)
    shares = np.ascontiguousarray((across @ np.ascontiguousarray(best[:, :2])).T)
    rest = shares.copy()
    rest[:, :2] = 0.0
    for rows in (basis, images):
        vectors, changes = shares @ rows, rest @ rows
        rows[:2], rows[4:] = vectors, changes
    return bends[:2].copy()
