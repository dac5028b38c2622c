"""The arithmetic of a warm frame, in one call: `descend` with a factor, `pursue` by conjugate gradients.

Both are the easy cases of `lampest.solvers.newton`.

With the blocks of Z over rows (r) and columns (c), by elimination of the rows from L(g) + diag(t):
S = C − gᵀR⁻¹g, Z_cc = S⁻¹, Z_rc = R⁻¹g S⁻¹, Z_rr = R⁻¹ + R⁻¹g Z_rcᵀ, R and C diagonal. With weights e of the readings
and slopes h of their equation W = [[diag Σ e h_p, ½ e h_t], [·, diag Σ e h_q]], K = Z W Z, Jᵀe = g·bᵀ K b.
What the terms and the readout's equation say comes from CasADi's functions, called by their addresses.

All functions stand in this one file: numba's cache asks for the date of the file of the function that is called.
"""

from typing import Any

import numpy as np

from lampest.panel.machine import call, machine_code

FELL_SHORT, SETTLED = 0, 1
FREELY, STOPPED, DOWN = 0, 1, 2
MOST_STEPS, MOST_STOPS, MOST_SEEN = 60, 6, 8
STRAIGHT = 0.2  # of log r
SHARES = (1.0, 0.5, 0.25, 0.1, 0.02)
ROUGH, FINE = 0.1, 0.01  # of a step by conjugate gradients, and of the last one, which is taken unseen
MOST_PRODUCTS = 1500  # of a frame; beyond, it is not an easy one
MOST_ROUNDS, DEPENDENT = 12, 1e-10  # of two vectors towards the softest directions; of vectors of length one
LEAST_SHARE = 0.05  # of a cell's own response, as in the two-point stencil
LOWER, TRANSPOSED, PLAIN = ord("L"), ord("T"), ord("N")


@machine_code
def _product(addresses: Any, one: Any, turned: bool, other: Any, other_turned: bool, result: Any) -> None:
    """result = A·B, of either its transpose where it is `turned`."""
    _add_product(addresses, 1.0, one, turned, other, other_turned, 0.0, result)


@machine_code
def _add_product(
    addresses: Any, share: float, one: Any, turned: bool, other: Any, other_turned: bool, left: float, result: Any
) -> None:
    """result = share·A·B + left·result; all may be parts of matrices. BLAS reads rows as columns."""
    rows, columns = result.shape
    inner = one.shape[0] if turned else one.shape[1]
    words, factors = np.empty(8, dtype=np.int32), np.empty(2)
    words[0] = TRANSPOSED if other_turned else PLAIN
    words[1] = TRANSPOSED if turned else PLAIN
    words[2], words[3], words[4] = columns, rows, inner
    words[5], words[6], words[7] = other.strides[0] // 8, one.strides[0] // 8, result.strides[0] // 8
    factors[0], factors[1] = share, left
    start, unit = words.ctypes.data, factors.ctypes.data
    call(
        addresses[7],
        (start, start + 4, start + 8, start + 12, start + 16, unit, other.ctypes.data, start + 20,
         one.ctypes.data, start + 24, unit + 8, result.ctypes.data, start + 28),
    )  # fmt: skip
    factors[0] = words[0]


@machine_code
def _solved(addresses: Any, conductance: Any, ties: Any, impedance: Any) -> bool:
    """Z (lines, lines); whether every pivot is positive.

    Elimination of a Laplacian needs no exchange of rows: its pivots are sums of what is left to ground.
    """
    rows, columns = conductance.shape
    over, total = np.empty((rows, columns)), np.empty(rows)
    for j in range(rows):
        total[j] = ties[j]
        for k in range(columns):
            total[j] += conductance[j, k]
        if not total[j] > 0:
            return False
        for k in range(columns):
            over[j, k] = conductance[j, k] / total[j]
    rest, across, between = np.empty((columns, columns)), np.empty((rows, columns)), np.empty((rows, rows))
    _product(addresses, conductance, True, over, False, rest)
    for k in range(columns):
        whole = ties[rows + k]
        for j in range(rows):
            whole += conductance[j, k]
        for other in range(columns):
            rest[k, other] = -rest[k, other]
        rest[k, k] += whole
    if not _inverted(rest):
        return False
    _product(addresses, over, False, rest, False, across)
    _product(addresses, across, False, over, True, between)
    for j in range(rows):
        for other in range(rows):
            impedance[j, other] = between[j, other]
        impedance[j, j] += 1 / total[j]
        for k in range(columns):
            impedance[j, rows + k] = across[j, k]
            impedance[rows + k, j] = across[j, k]
    for k in range(columns):
        for other in range(columns):
            impedance[rows + k, rows + other] = rest[k, other]
    return True


@machine_code
def _inverted(matrix: Any) -> bool:
    """A symmetric positive definite matrix to its inverse in place, by Gauss and Jordan; whether it was definite."""
    size = len(matrix)
    for pivot in range(size):
        head = matrix[pivot, pivot]
        if not head > 0:
            return False
        matrix[pivot, pivot] = 1.0
        for column in range(size):
            matrix[pivot, column] /= head
        for row in range(size):
            if row != pivot:
                factor = matrix[row, pivot]
                matrix[row, pivot] = 0.0
                for column in range(size):
                    matrix[row, column] -= factor * matrix[pivot, column]
    for row in range(size):
        for column in range(row):
            middle = (matrix[row, column] + matrix[column, row]) / 2
            matrix[row, column] = middle
            matrix[column, row] = middle
    return True


@machine_code
def _priced(addresses: Any, where: Any, arena: Any, ties: Any, point: Any) -> tuple[float, float]:
    """(φ, the scale of its gradient) at vectors[0] = u, and all else of a point; infinite where Z does not exist.

    vectors : (5, cells) u, r, r·∂φ/∂r, Jᵀ∂φ/∂y and ∂φ/∂y. impedance, twice : Z and K (lines, lines).
    """
    vectors, impedance, twice = point
    rows, cells, terms = where[9], vectors.shape[1], where[7]
    columns = cells // rows
    conductance = np.empty((rows, columns))
    for cell in range(cells):
        conductance[cell // columns, cell % columns] = 1 / vectors[1, cell]
    if not _solved(addresses, conductance, ties[0], impedance):
        return np.inf, 1.0
    for cell in range(cells):
        j, k = cell // columns, rows + cell % columns
        arena[where[2] + cell] = impedance[j, j]
        arena[where[2] + cells + cell] = impedance[k, k]
        arena[where[2] + 2 * cells + cell] = impedance[j, k]
    call(addresses[0], (addresses[3],))
    for cell in range(cells):
        arena[where[0] + cell] = vectors[1, cell]
        arena[where[1] + cell] = arena[where[4] + cell]
    call(addresses[0], (addresses[1],))
    first, objective, blank = where[3], 0.0, 0.0
    for term in range(terms):
        objective += arena[first + term]
        blank += arena[first + terms + term]
    for cell in range(cells):
        vectors[2, cell] = arena[first + 2 * terms + cell] * vectors[1, cell]
        vectors[4, cell] = arena[first + 2 * terms + cells + cell]
    loading, half = np.zeros(impedance.shape), np.empty(impedance.shape)
    slopes = where[4] + cells
    for cell in range(cells):
        j, k, weight = cell // columns, rows + cell % columns, vectors[4, cell]
        loading[j, j] += weight * arena[slopes + cell]
        loading[k, k] += weight * arena[slopes + cells + cell]
        loading[j, k] = loading[k, j] = weight * arena[slopes + 2 * cells + cell] / 2
    _product(addresses, loading, False, impedance, False, half)
    _product(addresses, impedance, False, half, False, twice)
    for cell in range(cells):
        j, k = cell // columns, rows + cell % columns
        vectors[3, cell] = (twice[j, j] + twice[k, k] - 2 * twice[j, k]) / vectors[1, cell]
    scale = blank / cells + objective
    return objective, scale if scale != 0 else 1.0


@machine_code
def _curvature(addresses: Any, where: Any, arena: Any, entries: Any, point: Any, free: Any, whole: bool) -> Any:
    """∇²φ over the free cells, its upper triangle; the point is the one that was priced last.

    Or, not `whole`, Gauss and Newton's: without the second derivatives of readings, and of r where they bend down.
    """
    vectors, impedance, twice = point
    rows, cells, count = where[9], vectors.shape[1], len(free)
    columns = cells // rows
    stiffness = _stiffness(addresses, where, arena, entries, cells)
    across, conductance = np.empty((rows + columns, count)), np.empty(count)
    _across_cells(impedance, free, rows, across)
    for number in range(count):
        conductance[number] = 1 / vectors[1, free[number]]
    matrix = np.zeros((count, count))
    if whole:
        _add_second_order(twice, free, rows, across, conductance, matrix)
        _add_bends(addresses, where, arena, vectors[4], across, conductance, matrix)
    for number in range(count):
        direct, through = vectors[2, free[number]], vectors[3, free[number]]
        matrix[number, number] += direct - through if whole else max(direct, 0.0)
    _add_responses(addresses, where, arena, stiffness, across, conductance, matrix)
    _add_entries(where, arena, entries, vectors[1], free, matrix)
    return matrix


@machine_code
def _add_second_order(twice: Any, free: Any, rows: int, across: Any, conductance: Any, matrix: Any) -> None:
    """matrix += 2 g (BᵀZB ∘ BᵀKB) g over the free cells, the upper triangle."""
    count, columns = len(free), len(twice) - rows
    bent = np.empty(across.shape)
    _across_cells(twice, free, rows, bent)
    for one in range(count):
        j, k = free[one] // columns, rows + free[one] % columns
        for other in range(one, count):
            both = (across[j, other] - across[k, other]) * (bent[j, other] - bent[k, other])
            matrix[one, other] += 2 * conductance[one] * conductance[other] * both


@machine_code
def _stiffness(addresses: Any, where: Any, arena: Any, entries: Any, cells: int) -> Any:
    """(cells) ∂²φ/∂y² of every reading, where the point is that was priced last."""
    call(addresses[0], (addresses[2],))
    stiffness = np.zeros(cells)
    for number in range(entries.shape[1]):
        if entries[0, number] >= cells:
            stiffness[entries[0, number] - cells] += arena[where[5] + number]
    return stiffness


@machine_code
def _across_cells(matrix: Any, free: Any, rows: int, across: Any) -> None:
    """A·b of every free cell (lines, free), of a matrix A (lines, lines)."""
    lines = len(matrix)
    columns = lines - rows
    for line in range(lines):
        for number in range(len(free)):
            across[line, number] = matrix[line, free[number] // columns] - matrix[line, rows + free[number] % columns]


@machine_code
def _add_responses(
    addresses: Any, where: Any, arena: Any, stiffness: Any, across: Any, conductance: Any, matrix: Any
) -> None:
    """matrix += Jᵀ·diag(stiffness)·J over the free cells, the upper triangle."""
    rows, cells, count = where[9], len(stiffness), len(conductance)
    if count == 0:
        return
    columns, slopes = cells // rows, where[4] + cells
    response, least = np.empty((cells, count)), 0.0
    for number in range(cells):
        j, k, root = number // columns, rows + number % columns, np.sqrt(abs(stiffness[number]))
        p, q = root * arena[slopes + number], root * arena[slopes + cells + number]
        t, least = root * arena[slopes + 2 * cells + number], min(least, stiffness[number])
        for cell in range(count):
            at_row, at_column = across[j, cell], across[k, cell]
            slope = p * at_row * at_row + q * at_column * at_column + t * at_row * at_column
            response[number, cell] = conductance[cell] * slope
    if least >= 0:
        words, one = np.empty(4, dtype=np.int32), np.empty(1)
        words[0], words[1], words[2], words[3], one[0] = LOWER, PLAIN, count, cells, 1.0
        start, unit = words.ctypes.data, one.ctypes.data
        call(
            addresses[4],
            (start, start + 4, start + 8, start + 12, unit, response.ctypes.data, start + 8, unit,
             matrix.ctypes.data, start + 8),
        )  # fmt: skip
        one[0] = words[0] * response[0, 0]
    else:
        signed, square = response.copy(), np.empty((count, count))
        for number in range(cells):
            if stiffness[number] < 0:
                for cell in range(count):
                    signed[number, cell] = -response[number, cell]
        _product(addresses, signed, True, response, False, square)
        _add(matrix, square, False)


@machine_code
def _add(matrix: Any, more: Any, turned: bool) -> None:
    """matrix += A, or Aᵀ."""
    for one in range(len(matrix)):
        for other in range(len(matrix)):
            matrix[one, other] += more[other, one] if turned else more[one, other]


@machine_code
def _add_bends(
    addresses: Any, where: Any, arena: Any, weights: Any, across: Any, conductance: Any, matrix: Any
) -> None:
    """matrix += Σ_i e_i (∂(p, q, t)_i)ᵀ h″_i ∂(p, q, t)_i for weights e, as far as h bends at all."""
    rows, cells, count = where[9], len(weights), len(conductance)
    columns, bends, largest = cells // rows, where[4] + 4 * cells, 0.0
    for number in range(6 * cells):
        largest = max(largest, abs(arena[bends + number]))
    if largest == 0:
        return
    lines = rows + columns
    own, pulled, square = np.empty((lines, count)), np.zeros((lines, count)), np.empty((count, count))
    mutual, bent, largest = np.empty((cells, count)), np.empty((cells, count)), 0.0
    for line in range(lines):
        for cell in range(count):
            own[line, cell] = across[line, cell] ** 2 * conductance[cell]
    for number in range(cells):
        j, k, weight, at = number // columns, rows + number % columns, weights[number], bends + number
        pp, pq, pt = weight * arena[at], weight * arena[at + cells], weight * arena[at + 2 * cells]
        qq, qt, tt = weight * arena[at + 3 * cells], weight * arena[at + 4 * cells], weight * arena[at + 5 * cells]
        largest = max(largest, abs(tt))
        for cell in range(count):
            both = across[j, cell] * across[k, cell] * conductance[cell]
            mutual[number, cell], bent[number, cell] = both, tt * both
            pulled[j, cell] += pp / 2 * own[j, cell] + pq * own[k, cell] + pt * both
            pulled[k, cell] += qq / 2 * own[k, cell] + qt * both
    _product(addresses, own, True, pulled, False, square)
    _add(matrix, square, False)
    _add(matrix, square, True)
    if largest > 0:
        _product(addresses, mutual, True, bent, False, square)
        _add(matrix, square, False)


@machine_code
def _add_entries(where: Any, arena: Any, entries: Any, resistance: Any, free: Any, matrix: Any) -> None:
    """matrix += r·(second derivatives of the terms between cells)·r, the upper triangle."""
    cells = len(resistance)
    slot = np.full(cells, -1)
    for number in range(len(free)):
        slot[free[number]] = number
    for number in range(entries.shape[1]):
        one, other = entries[0, number], entries[1, number]
        if one < cells and slot[one] >= 0 and slot[one] <= slot[other]:
            bend = arena[where[5] + number]
            matrix[slot[one], slot[other]] += bend * resistance[one] * resistance[other]


@machine_code
def _factored(addresses: Any, matrix: Any) -> bool:
    """The upper triangle of a matrix to that of its Cholesky factor, in place; whether it is positive definite."""
    words = np.empty(3, dtype=np.int32)
    words[0], words[1], words[2] = LOWER, len(matrix), 0
    start = words.ctypes.data
    if len(matrix) > 0:
        call(addresses[5], (start, start + 4, matrix.ctypes.data, start + 4, start + 8))
    return bool(words[2] == 0)


@machine_code
def _divided(addresses: Any, factor: Any, right: Any) -> None:
    """right ← (the matrix of a factor)⁻¹·right."""
    words = np.empty(4, dtype=np.int32)
    words[0], words[1], words[2], words[3] = LOWER, len(factor), 1, 0
    start = words.ctypes.data
    if len(factor) > 0:
        call(
            addresses[6],
            (start, start + 4, start + 8, factor.ctypes.data, start + 4, right.ctypes.data, start + 4, start + 12),
        )
    if words[3] != 0:
        right[0] = np.nan


@machine_code
def _free(vectors: Any, bounds: Any) -> Any:
    """The numbers of the cells that have room and are not pressed against a bound; bounds : (2, cells) of u."""
    cells = vectors.shape[1]
    chosen, count = np.empty(cells, dtype=np.int64), 0
    for cell in range(cells):
        slope = vectors[2, cell] + vectors[3, cell]
        low, high = bounds[0, cell], bounds[1, cell]
        pressed = (vectors[0, cell] <= low and slope > 0) or (vectors[0, cell] >= high and slope < 0)
        if low < high and not pressed:
            chosen[count] = cell
            count += 1
    return chosen[:count].copy()


@machine_code
def _residual(vectors: Any, bounds: Any, scale: float) -> float:
    """max |u − Π(u − ∇φ/s)|."""
    largest = 0.0
    for cell in range(vectors.shape[1]):
        target = vectors[0, cell] - (vectors[2, cell] + vectors[3, cell]) / scale
        target = min(max(target, bounds[0, cell]), bounds[1, cell])
        away = abs(vectors[0, cell] - target)
        if not away <= largest:
            largest = away
    return largest


@machine_code
def _same(one: Any, other: Any) -> bool:
    same = len(one) == len(other)
    for number in range(min(len(one), len(other))):
        same = same and one[number] == other[number]
    return same


@machine_code
def _away(one: Any, other: Any) -> float:
    """max |a − b|."""
    largest = 0.0
    for number in range(len(one)):
        largest = max(largest, abs(one[number] - other[number]))
    return largest


@machine_code
def _put(vectors: Any, target: Any, bounds: Any) -> None:
    """A target as the place of a point, within the bounds."""
    for cell in range(len(target)):
        held = min(max(target[cell], bounds[0, cell]), bounds[1, cell])
        vectors[0, cell] = held
        vectors[1, cell] = np.exp(held)


@machine_code
def _blank(lines: int, cells: int) -> Any:
    """Where a point is put."""
    return np.empty((5, cells)), np.empty((lines, lines)), np.empty((lines, lines))


@machine_code
def _pull(vectors: Any, free: Any, step: Any) -> None:
    """step ← −∇φ at the free cells."""
    for number in range(len(free)):
        step[number] = -(vectors[2, free[number]] + vectors[3, free[number]])


@machine_code
def _along(addresses: Any, kept: Any, seen: Any, count: int, along: Any) -> None:
    """along ← H⁻¹·along, H the second derivatives of a kept factor mended by what `count` steps have shown.

    seen : (2, steps, free) steps and what they changed ∇φ by. Source: Nocedal, Math. Comput. 35, 1980.
    """
    shares = np.empty(count)
    for back in range(count):
        number = count - 1 - back
        step, change = seen[0, number], seen[1, number]
        shares[number] = _dot(step, along) / _dot(step, change)
        for cell in range(len(along)):
            along[cell] -= shares[number] * change[cell]
    _divided(addresses, kept, along)
    for number in range(count):
        step, change = seen[0, number], seen[1, number]
        more = shares[number] - _dot(change, along) / _dot(step, change)
        for cell in range(len(along)):
            along[cell] += more * step[cell]


@machine_code
def _dot(one: Any, other: Any) -> float:
    total = 0.0
    for number in range(len(one)):
        total += one[number] * other[number]
    return total


@machine_code
def _noted(before: Any, after: Any, free: Any, seen: Any, count: int) -> bool:
    """A step from one point to another as the next of `seen`; whether ∇φ grew along it."""
    for number in range(len(free)):
        cell = free[number]
        seen[0, count, number] = after[0, cell] - before[0, cell]
        seen[1, count, number] = after[2, cell] + after[3, cell] - before[2, cell] - before[3, cell]
    return bool(_dot(seen[0, count], seen[1, count]) > 0)


@machine_code
def _stop_at_bounds(
    addresses: Any, matrix: Any, vectors: Any, bounds: Any, free: Any, straight: Any, step: Any
) -> bool:
    """Let cells that a step over the free ones takes beyond their bounds stop there, and ask the others again; whether
    there were any. Step and bounds in what is `straight`, see `_straightened`.
    """
    count = len(free)
    known, moving, left = np.zeros(count), np.ones(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    for stops in range(MOST_STOPS):
        remaining, before = 0, len(left)
        for number in range(count):
            place, kind = vectors[0, free[number]], straight[number]
            low, high = _bent(bounds[0, free[number]] - place, kind), _bent(bounds[1, free[number]] - place, kind)
            held = min(max(step[number], low), high)
            if moving[number] and held != step[number]:
                known[number], moving[number] = held, 0
            if moving[number]:
                left[remaining] = number
                remaining += 1
        if remaining == before:
            return stops > 0
        left = left[:remaining]
        part, right, found = np.empty((remaining, remaining)), np.empty(count), np.empty(remaining)
        _pull(vectors, free, right)
        for one in range(remaining):
            found[one] = right[left[one]]
            for number in range(count):
                if not moving[number]:
                    found[one] -= matrix[min(left[one], number), max(left[one], number)] * known[number]
            for other in range(one, remaining):
                part[one, other] = matrix[left[one], left[other]]
        if not _factored(addresses, part):
            return True
        _divided(addresses, part, found)
        for number in range(count):
            step[number] = known[number]
        for one in range(remaining):
            step[left[one]] = found[one]
    return True


@machine_code
def _bent(change: float, kind: int) -> float:
    """A change of u as one of what is straight: of u, or relative of r (1) or of the conductance, downwards (-1)."""
    if kind == 0:
        return change
    return float(np.expm1(change)) if kind > 0 else float(-np.expm1(-change))


@machine_code
def _unbent(change: float, kind: int) -> float:
    """The change of u, infinite beyond what is positive."""
    if kind == 0:
        return change
    if kind > 0:
        return float(np.log1p(change)) if change > -1 else -np.inf
    return float(-np.log1p(-change)) if change < 1 else np.inf


@machine_code
def _straightened(addresses: Any, matrix: Any, vectors: Any, free: Any, step: Any, straight: Any) -> bool:
    """step over the free cells ← Newton's in r of those that it would make far smaller, in 1/r of those that it would
    make far larger, in u of all others; matrix ← its second derivatives. Whether there are such cells, and a step.

    With H and g the second and first derivatives in u, those in r are H − diag g, and in 1/r they are H + diag g, both
    for relative changes. In u a cell that is nearly open or shorted moves by about 1 a step, and hardly arrives.
    """
    many, kept = False, matrix.copy()
    for number in range(len(free)):
        slope = vectors[2, free[number]] + vectors[3, free[number]]
        if (step[number] > STRAIGHT and slope < 0) or (step[number] < -STRAIGHT and slope > 0):
            straight[number], many = -1 if slope < 0 else 1, True
            kept[number, number] -= abs(slope)
            matrix[number, number] -= abs(slope)
    if not many or not _factored(addresses, kept):
        return False
    _pull(vectors, free, step)
    _divided(addresses, kept, step)
    return True


@machine_code
def _trial(
    addresses: Any, where: Any, arena: Any, ties: Any, bounds: Any, limits: Any, here: Any, there: Any, step: Any,
    shares: int, costs: Any,
) -> bool:  # fmt: skip
    """Whether a step, or the best of so many shares of it, leads to a better point, which `there` is then.

    costs : φ, its scale and what the step promised, first of `here`, then of `there`.
    """
    vectors, target = here[0], np.empty(len(step))
    for number in range(shares):
        length, promise = SHARES[number], 0.0
        for cell in range(len(step)):
            moved = vectors[0, cell] + max(length * step[cell], -limits[5])
            target[cell] = min(max(moved, bounds[0, cell]), bounds[1, cell])
            promise -= (vectors[2, cell] + vectors[3, cell]) * (target[cell] - vectors[0, cell])
        _put(there[0], target, bounds)
        costs[3], costs[4] = _priced(addresses, where, arena, ties, there)
        costs[5], gain = promise, costs[0] - costs[3]
        if promise > 0 and gain >= limits[2] * promise:
            return True
        if abs(gain) <= limits[3] * abs(costs[0]):
            residual = _residual(vectors, bounds, costs[1])
            if _residual(there[0], bounds, costs[4]) < limits[4] * residual:
                return True
    return False


@machine_code
def _straight_trial(
    addresses: Any, where: Any, arena: Any, ties: Any, bounds: Any, limits: Any, here: Any, there: Any, other: Any,
    matrix: Any, free: Any, along: Any, better: bool, costs: Any,
) -> bool:  # fmt: skip
    """Whether a step that is straight elsewhere, see `_straightened`, leads to a point that is better, and lower than
    `there` where that is `better`: `other` is it then, and costs are its.

    along : over the free cells, the step that is straight in u. It and the matrix are overwritten.
    """
    straight, step, told = np.zeros(len(free), dtype=np.int64), np.zeros(len(here[0][0])), np.zeros(4)
    if not _straightened(addresses, matrix, here[0], free, along, straight):
        return False
    _stop_at_bounds(addresses, matrix, here[0], bounds, free, straight, along)
    _spread(here[0], bounds, free, straight, along, step, told)
    found = costs.copy()
    reached = _trial(addresses, where, arena, ties, bounds, limits, here, other, step, 1, found)
    if reached and (not better or found[3] < costs[3]):
        costs[:] = found
        return True
    _priced(addresses, where, arena, ties, there)
    return False


@machine_code
def _certified(
    addresses: Any, where: Any, arena: Any, entries: Any, limits: Any, sigma: Any, step: Any, told: Any
) -> bool:
    """Whether a step is as short as a certificate asks for; told : its promise, decrement, share and length."""
    told[1], told[2] = np.sqrt(max(told[0], 0.0)), np.inf
    told[3] = 0.0
    for cell in range(len(step)):
        told[3] = max(told[3], abs(step[cell]))
    if told[3] > limits[8] and len(sigma) > 0:
        told[2] = told[1] / _deviation(_stiffness(addresses, where, arena, entries, len(step)), sigma)
    return bool(told[3] <= limits[8] or told[2] <= limits[9])


@machine_code
def _spread(vectors: Any, bounds: Any, free: Any, straight: Any, along: Any, step: Any, told: Any) -> bool:
    """step (cells) ← a step over the free cells, within bounds; told[0] : −∇φ·s; whether no bound was in its way."""
    inside, told[0] = True, 0.0
    for cell in range(len(step)):
        step[cell] = 0.0
    for number in range(len(free)):
        cell = free[number]
        target = vectors[0, cell] + _unbent(along[number], straight[number])
        held = min(max(target, bounds[0, cell]), bounds[1, cell])
        inside = inside and held == target
        step[cell] = held - vectors[0, cell]
        told[0] -= (vectors[2, cell] + vectors[3, cell]) * along[number]
    return inside


@machine_code
def _overdue(addresses: Any, limits: Any) -> bool:
    """Whether the clock is past limits[15]; limits[14] : its number, which goes where others take a pointer."""
    if limits[15] == np.inf or addresses[8] == 0:
        return False
    now = np.zeros(2, dtype=np.int64)
    call(addresses[8], (int(limits[14]), now.ctypes.data))
    return bool(now[0] + 1e-9 * now[1] > limits[15])


@machine_code
def descend(
    addresses: Any,
    where: Any,
    arena: Any,
    given: Any,
    entries: Any,
    ties: Any,
    bounds: Any,
    start: Any,
    kept: Any,
    kept_cells: Any,
    kept_at: Any,
    limits: Any,
    sigma: Any,
) -> Any:
    """(ending, u, the last step, its decrement and share, factors made, the last one, its cells, where it was taken).

    Of one frame from `start` on. given : all that the terms know, copied to the arena's end. bounds : (2, cells) of u.
    start : u. kept : a factor of second derivatives over `kept_cells`, taken at `kept_at`, or nothing. sigma : of the
    readings, or nothing where it is not known. limits : see `limits` of `lampest.solvers.kernel.following`. SETTLED :
    the projected gradient was below the tolerance before the last step, and that is as short as a certificate asks for.
    FELL_SHORT : anything else; u then says nothing.
    """
    rows, cells = where[9], len(start)
    lines = rows + cells // rows
    for number in range(len(given)):
        arena[where[6] + number] = given[number]
    here, there, other = _blank(lines, cells), _blank(lines, cells), _blank(lines, cells)
    step, told, costs = np.zeros(cells), np.zeros(4), np.zeros(6)
    _put(here[0], start, bounds)
    costs[0], costs[1] = _priced(addresses, where, arena, ties, here)
    costs[2], factors = np.inf, 0
    usable = len(kept_cells) > 0 and _away(here[0][0], kept_at) <= limits[6]
    ending, exact, begun, steps, seen = FELL_SHORT, True, 0.0, 0, np.empty((2, MOST_SEEN, len(kept_cells)))
    for _ in range(MOST_STEPS):
        vectors = here[0]
        residual = _residual(vectors, bounds, costs[1])
        if not (abs(costs[0]) < np.inf and residual < np.inf) or _overdue(addresses, limits):
            break
        free, near = _free(vectors, bounds), residual <= limits[0]
        usable = usable and exact and _same(free, kept_cells)
        along, stopped, fresh = np.empty(len(free)), False, not usable
        straight = np.zeros(len(free), dtype=np.int64)
        _pull(vectors, free, along)
        if fresh:
            if factors >= limits[13]:
                break
            factors += 1
            matrix = _curvature(addresses, where, arena, entries, here, free, True)
            kept = matrix.copy()
            exact = _factored(addresses, kept)
            if not exact:
                matrix = _curvature(addresses, where, arena, entries, here, free, False)
                kept = matrix.copy()
                if near or not _factored(addresses, kept):
                    break
            kept_cells, kept_at, usable = free, vectors[0].copy(), True
            _along(addresses, kept, seen, 0, along)
            steps, seen = 0, np.empty((2, MOST_SEEN, len(free)))
            tried = along.copy()
            stopped = _stop_at_bounds(addresses, matrix, vectors, bounds, free, straight, along)
        else:
            _along(addresses, kept, seen, steps, along)
        inside = _spread(vectors, bounds, free, straight, along, step, told)
        if not abs(told[0]) < np.inf:
            break
        sure = _away(vectors[0], kept_at) <= limits[7]
        sure = sure or (_away(vectors[0], kept_at) <= limits[10] and told[0] <= limits[11] ** 2 * begun)
        if near and sure and not stopped and _certified(addresses, where, arena, entries, limits, sigma, step, told):
            ending = SETTLED
            if told[3] <= limits[12]:
                break
        if fresh or (inside and 0 < told[0] <= limits[1] ** 2 * costs[2]):
            better = _trial(addresses, where, arena, ties, bounds, limits, here, there, step, 5 if fresh else 1, costs)
            if (
                fresh
                and exact
                and _straight_trial(
                    addresses,
                    where,
                    arena,
                    ties,
                    bounds,
                    limits,
                    here,
                    there,
                    other,
                    matrix,
                    free,
                    tried,
                    better,
                    costs,
                )
            ):
                there, other, better = other, there, True
            if better:
                here, there, ending = there, here, FELL_SHORT
                begun = costs[5] if costs[2] == np.inf else begun
                costs[0], costs[1], costs[2] = costs[3], costs[4], costs[5]
                if steps < MOST_SEEN:
                    usable = _noted(there[0], here[0], kept_cells, seen, steps)
                    steps += 1
                continue
            if fresh or ending == SETTLED:
                break
            _priced(addresses, where, arena, ties, here)
        if ending == SETTLED:
            break
        usable = False
    if told[3] <= limits[7]:  # one that is short against the noise alone may lead further than derivatives hold
        for cell in range(cells):
            here[0][0, cell] += step[cell]
    return ending, here[0][0].copy(), step, told[1], told[2], factors, kept, kept_cells, kept_at


@machine_code
def _loaded(addresses: Any, own: Any, block: Any, matrix: Any, result: Any) -> None:
    """result = W·A (lines, lines), W = [[diag, B], [Bᵀ, diag]] of `own` (lines) and `block` B (rows, columns)."""
    rows, lines = len(block), len(matrix)
    for line in range(lines):
        for other in range(lines):
            result[line, other] = own[line] * matrix[line, other]
    _add_product(addresses, 1.0, block, False, matrix[rows:], False, 1.0, result[:rows])
    _add_product(addresses, 1.0, block, True, matrix[:rows], False, 1.0, result[rows:])


@machine_code
def _add_diagonal(share: float, one: Any, other: Any, result: Any) -> None:
    """result += share·diag(A·B), A symmetric."""
    for line in range(len(one)):
        for place in range(len(one)):
            result[place] += share * one[line, place] * other[line, place]


@machine_code
def _modelled(addresses: Any, where: Any, arena: Any, entries: Any, point: Any, straight: int, whole: bool) -> Any:
    """(model, links): what products with ∇²φ need at the point that was priced last, in u or in 1/r (`straight` -1).

    model : (12, cells) g, ∂²φ/∂y², the slopes p, q, t of the readings' equation, ∂φ/∂y times its six bends, and what
    stands on the diagonal beside those. links : of the terms' second derivatives between cells, with both their cells.
    Not `whole`: Gauss and Newton's.
    """
    vectors = point[0]
    cells = vectors.shape[1]
    model, count = np.zeros((12, cells)), 0
    stiffness = _stiffness(addresses, where, arena, entries, cells)
    for cell in range(cells):
        model[0, cell], model[1, cell] = 1 / vectors[1, cell], stiffness[cell]
        for part in range(3):
            model[2 + part, cell] = arena[where[4] + (1 + part) * cells + cell]
        direct, through = vectors[2, cell], vectors[3, cell]
        if whole:
            for part in range(6):
                model[5 + part, cell] = vectors[4, cell] * arena[where[4] + (4 + part) * cells + cell]
            model[11, cell] = direct - through - straight * (direct + through)
        else:
            model[11, cell] = max(direct, 0.0)
    links = np.empty((3, entries.shape[1]))
    for number in range(entries.shape[1]):
        one, other = entries[0, number], entries[1, number]
        if one < cells:
            links[0, count], links[1, count] = one, other
            links[2, count] = arena[where[5] + number] * vectors[1, one] * vectors[1, other]
            count += 1
    return model, links[:, :count].copy()


@machine_code
def _bent_along(
    addresses: Any, rows: int, model: Any, links: Any, point: Any, whole: bool, step: Any, image: Any
) -> None:
    """image ← ∇²φ·step (cells), of a model at a point, without a matrix of cells × cells.

    With dZ = Z L_{g s} Z the change of Z and dy that of the readings: g·bᵀ (Z W' Z + Z L_{g s} K + K L_{g s} Z) b,
    where W' is of the weights ∂²φ/∂y² dy and of what the slopes change by.
    """
    _, impedance, twice = point
    lines, cells = len(impedance), len(step)
    columns = lines - rows
    block, own, cross = np.empty((rows, columns)), np.zeros(lines), np.empty((rows, columns))
    for cell in range(cells):
        j, k, drawn = cell // columns, cell % columns, model[0, cell] * step[cell]
        block[j, k] = -drawn
        own[j] += drawn
        own[rows + k] += drawn
    moved, pulled, change = np.empty((lines, lines)), np.empty((lines, lines)), np.zeros(lines)
    _loaded(addresses, own, block, impedance, moved)
    _add_product(addresses, 1.0, impedance[:rows], False, moved[:, rows:], False, 0.0, cross)
    _add_diagonal(1.0, impedance, moved, change)
    own[:] = 0.0
    for cell in range(cells):
        j, k = cell // columns, rows + cell % columns
        p, q, t = change[j], change[k], cross[j, k - rows]
        weight = model[1, cell] * (model[2, cell] * p + model[3, cell] * q + model[4, cell] * t)
        own[j] += weight * model[2, cell] + model[5, cell] * p + model[6, cell] * q + model[7, cell] * t
        own[k] += weight * model[3, cell] + model[6, cell] * p + model[8, cell] * q + model[9, cell] * t
        half = weight * model[4, cell] + model[7, cell] * p + model[9, cell] * q + model[10, cell] * t
        block[j, k - rows] = half / 2
    _loaded(addresses, own, block, impedance, pulled)
    _add_product(addresses, 1.0, impedance[:rows], False, pulled[:, rows:], False, 0.0, cross)
    change[:] = 0.0
    _add_diagonal(1.0, impedance, pulled, change)
    if whole:
        _add_product(addresses, 1.0, twice[:rows], False, moved[:, rows:], False, 1.0, cross)
        _add_product(addresses, 1.0, moved[:, :rows], True, twice[:, rows:], False, 1.0, cross)
        _add_diagonal(2.0, twice, moved, change)
    for cell in range(cells):
        j, k = cell // columns, rows + cell % columns
        bent = model[0, cell] * (change[j] + change[k] - 2 * cross[j, k - rows])
        image[cell] = bent + model[11, cell] * step[cell]
    for number in range(links.shape[1]):
        image[int(links[0, number])] += links[2, number] * step[int(links[1, number])]


@machine_code
def _own_slopes(rows: int, model: Any, impedance: Any, ties: Any) -> Any:
    """(own, lines): −∂y/∂g of every cell's own reading (cells), and of a line's readings by its other cells (lines).

    Where all else stands alike, a current into a line of total conductance A, with its tie, moves that by 1/A.
    """
    cells, lines = model.shape[1], len(impedance)
    columns = lines - rows
    own, total, slope = np.empty(cells), ties.copy(), np.zeros(lines)
    for cell in range(cells):
        j, k = cell // columns, rows + cell % columns
        own[cell] = _slope(rows, model, impedance, cell, cell)
        total[j] += model[0, cell]
        total[k] += model[0, cell]
        slope[j] += model[2, cell] / columns
        slope[k] += model[3, cell] / rows
    return own, slope / total**2


@machine_code
def _slope(rows: int, model: Any, impedance: Any, reading: int, cell: int) -> float:
    """−∂y/∂g of one reading by one cell."""
    columns = len(impedance) - rows
    j, k = reading // columns, rows + reading % columns
    m, n = cell // columns, rows + cell % columns
    at_row, at_column = impedance[j, m] - impedance[j, n], impedance[k, m] - impedance[k, n]
    both = model[4, reading] * at_row * at_column
    return float(model[2, reading] * at_row * at_row + model[3, reading] * at_column * at_column + both)


@machine_code
def _preconditioner(addresses: Any, rows: int, model: Any, links: Any, point: Any, band: int, ties: Any) -> Any:
    """(base, seen, inner, whether it is one): P = B + V C Vᵀ stands for ∇²φ over all cells, by Woodbury's formula.

    The terms as they are, JᵀWJ as of J's stencil (diag(e) + U K Uᵀ) g of any readout, whose diagonal e is a cell, whose
    columns U are the lines, and whose K is what a line's readings share; see
    `lampest.panel.readouts.two_point.stencil`. base : B = (the terms) + diag(g²e²w), as 1/B (cells, 1) or, where terms
    tie cells (`band` > 0, how far apart), as its Cholesky factor (cells, band + 1). seen : (2, cells) g·e·w and g, so
    that V = [g e w U, g U]. inner : (C⁻¹ + Vᵀ B⁻¹ V)⁻¹, (2·lines)², C⁻¹ = [[−UᵀwU, K⁻¹], [K⁻¹, 0]]; empty where a
    line's readings share nothing.
    """
    _, impedance, _ = point
    cells, lines = model.shape[1], len(impedance)
    columns = lines - rows
    own, shared = _own_slopes(rows, model, impedance, ties)
    squares, seen, largest = np.empty(cells), np.empty((2, cells)), 0.0
    inner, right = np.zeros((2 * lines, 2 * lines)), np.zeros((2 * lines, 2 * lines))
    for cell in range(cells):
        largest = max(largest, model[1, cell])
    for cell in range(cells):
        j, k, least = cell // columns, rows + cell % columns, LEAST_SHARE * abs(own[cell])
        rest = own[cell] - shared[j] - shared[k]
        if abs(rest) < least or rest * own[cell] < 0:
            rest = least if own[cell] > 0 else -least
        weight = max(model[1, cell], 1e-6 * largest)
        seen[0, cell], seen[1, cell] = model[0, cell] * rest * weight, model[0, cell]
        squares[cell] = (model[0, cell] * rest) ** 2 * weight
        _add_between(inner, 0, 0, j, k, -weight)
    base, solid = _base(addresses, model, links, squares, band)
    for line in range(lines):
        if shared[line] == 0 or not solid:
            return base, seen, np.empty((0, 0)), solid
        inner[line, lines + line] += 1 / shared[line]
        inner[lines + line, line] += 1 / shared[line]
    for line in range(2 * lines):
        right[line, line] = 1.0
    _add_through_base(addresses, rows, base, seen, inner)
    return base, seen, right, _divided_by(addresses, inner, right)


@machine_code
def _base(addresses: Any, model: Any, links: Any, squares: Any, band: int) -> Any:
    """(base, whether it is one) of `_preconditioner`; cells where the terms bend down count as if they did not where
    squares do not outweigh that.
    """
    cells, largest = len(squares), 0.0
    base = np.empty((cells, band + 1))
    for attempt in range(2):
        base[:] = 0.0
        for number in range(links.shape[1]):
            one, other = int(links[0, number]), int(links[1, number])
            if one >= other:
                base[other, one - other] += links[2, number]
        for cell in range(cells):
            base[cell, 0] += squares[cell] + max(model[11, cell], 0.0 if attempt > 0 or band == 0 else -np.inf)
            largest = max(largest, base[cell, 0])
        if band == 0:
            for cell in range(cells):
                base[cell, 0] = 1 / base[cell, 0] if base[cell, 0] > 0 else 0.0
            return base, True
        for cell in range(cells):
            base[cell, 0] += 1e-9 * largest
        if _factored_band(addresses, base):
            return base, True
    return base, False


@machine_code
def _add_through_base(addresses: Any, rows: int, base: Any, seen: Any, inner: Any) -> None:
    """inner += Vᵀ B⁻¹ V of what `_preconditioner` has; with a factor L of B that is YᵀY, L Y = V."""
    cells, band, lines = len(base), base.shape[1] - 1, len(inner) // 2
    columns = lines - rows
    if band == 0:
        for cell in range(cells):
            j, k, inverse = cell // columns, rows + cell % columns, base[cell, 0]
            for one in range(2):
                for other in range(2):
                    _add_between(inner, one * lines, other * lines, j, k, seen[one, cell] * seen[other, cell] * inverse)
        return
    through, square = np.zeros((cells, 2 * lines)), np.empty(inner.shape)
    for cell in range(cells):
        row = through[cell]
        for part in range(2):
            row[part * lines + cell // columns] += seen[part, cell]
            row[part * lines + rows + cell % columns] += seen[part, cell]
        most = min(band, cell)
        for back in range(1, most - 2, 4):  # four at a time: half the time
            one, above = base[cell - back, back], through[cell - back]
            two, second = base[cell - back - 1, back + 1], through[cell - back - 1]
            three, third = base[cell - back - 2, back + 2], through[cell - back - 2]
            four, fourth = base[cell - back - 3, back + 3], through[cell - back - 3]
            for line in range(2 * lines):
                row[line] -= one * above[line] + two * second[line] + three * third[line] + four * fourth[line]
        for back in range(most - most % 4 + 1, most + 1):
            share, above = base[cell - back, back], through[cell - back]
            for line in range(2 * lines):
                row[line] -= share * above[line]
        for line in range(2 * lines):
            row[line] /= base[cell, 0]
    _product(addresses, through, True, through, False, square)
    _add(inner, square, False)


@machine_code
def _add_between(matrix: Any, above: int, left: int, j: int, k: int, value: float) -> None:
    """matrix += what a cell between lines j and k adds to Uᵀ diag(x) U, in one of four blocks."""
    matrix[above + j, left + j] += value
    matrix[above + k, left + k] += value
    matrix[above + j, left + k] += value
    matrix[above + k, left + j] += value


@machine_code
def _factored_band(addresses: Any, base: Any) -> bool:
    """A banded matrix, (size, band + 1) downwards from its diagonal, to its Cholesky factor; whether it is definite."""
    words = np.empty(5, dtype=np.int32)
    words[0], words[1], words[2], words[3], words[4] = LOWER, len(base), base.shape[1] - 1, base.shape[1], 0
    start = words.ctypes.data
    call(addresses[9], (start, start + 4, start + 8, base.ctypes.data, start + 12, start + 16))
    return bool(words[4] == 0)


@machine_code
def _divided_by(addresses: Any, matrix: Any, right: Any) -> bool:
    """right ← A⁻¹·right, symmetric both; A is overwritten. Whether A has an inverse."""
    words, pivots = np.empty(2, dtype=np.int32), np.empty(len(matrix), dtype=np.int32)
    words[0], words[1] = len(matrix), 0
    start = words.ctypes.data
    call(
        addresses[11],
        (start, start, matrix.ctypes.data, start, pivots.ctypes.data, right.ctypes.data, start, start + 4),
    )
    return bool(words[1] == 0 and pivots[0] > 0)


@machine_code
def _preconditioned(addresses: Any, rows: int, found: Any, moving: Any, values: Any, result: Any) -> None:
    """result ← P⁻¹·values over the moving cells, of what `_preconditioner` found: B⁻¹(x − V·inner·Vᵀ B⁻¹x)."""
    base, seen, inner, _ = found
    cells, lines = len(values), len(inner) // 2
    result[:] = values
    _base_divided(addresses, base, result)
    if lines > 0:
        columns = lines - rows
        sums, back = np.zeros(2 * lines), np.zeros(2 * lines)
        for cell in range(cells):
            j, k = cell // columns, rows + cell % columns
            for part in range(2):
                share = seen[part, cell] * result[cell]
                sums[part * lines + j] += share
                sums[part * lines + k] += share
        for line in range(2 * lines):
            for other in range(2 * lines):
                back[other] += inner[line, other] * sums[line]
        for cell in range(cells):
            j, k = cell // columns, rows + cell % columns
            pulled = seen[0, cell] * (back[j] + back[k]) + seen[1, cell] * (back[lines + j] + back[lines + k])
            result[cell] = values[cell] - pulled
        _base_divided(addresses, base, result)
    for cell in range(cells):
        result[cell] = result[cell] if moving[cell] else 0.0


@machine_code
def _base_divided(addresses: Any, base: Any, values: Any) -> None:
    """values ← B⁻¹·values of what `_preconditioner` found."""
    cells, band = len(values), base.shape[1] - 1
    if band == 0:
        for cell in range(cells):
            values[cell] *= base[cell, 0]
        return
    words = np.empty(6, dtype=np.int32)
    words[0], words[1], words[2], words[3], words[4], words[5] = LOWER, cells, band, 1, band + 1, 0
    start = words.ctypes.data
    call(
        addresses[10],
        (start, start + 4, start + 8, start + 12, base.ctypes.data, start + 16, values.ctypes.data, start + 4,
         start + 20),
    )  # fmt: skip
    if words[5] != 0:
        values[0] = np.nan


@machine_code
def _conjugated(
    addresses: Any, rows: int, model: Any, links: Any, point: Any, whole: bool, found: Any, moving: Any,
    accuracy: float, begun: bool, told: Any, step: Any,
) -> bool:  # fmt: skip
    """step (cells) ← nearer to −(∇²φ)⁻¹ ∇φ over the moving cells, the others as they are; whether nothing bent down.

    begun : whether it is not zero. told[0] : the products left; told[1] : ∇φ's strength where a step of zero began,
    against which `accuracy` is. Source: Steihaug, SIAM J. Numer. Anal. 20, 1983.
    """
    cells = len(step)
    residual, scaled, image = np.empty(cells), np.empty(cells), np.empty(cells)
    if begun:
        _bent_along(addresses, rows, model, links, point, whole, step, image)
        told[0] -= 1
    for cell in range(cells):
        residual[cell] = -(point[0][2, cell] + point[0][3, cell]) - (image[cell] if begun else 0.0)
        residual[cell] = residual[cell] if moving[cell] else 0.0
    _preconditioned(addresses, rows, found, moving, residual, scaled)
    search, strength = scaled.copy(), _dot(residual, scaled)
    if not begun:
        told[1] = strength
    while strength > accuracy**2 * told[1] and told[0] > 0:
        _bent_along(addresses, rows, model, links, point, whole, search, image)
        told[0] -= 1
        bend = 0.0
        for cell in range(cells):
            image[cell] = image[cell] if moving[cell] else 0.0
            bend += search[cell] * image[cell]
        if not bend > 0:
            return False
        for cell in range(cells):
            step[cell] += strength / bend * search[cell]
            residual[cell] -= strength / bend * image[cell]
        _preconditioned(addresses, rows, found, moving, residual, scaled)
        before, strength = strength, _dot(residual, scaled)
        for cell in range(cells):
            search[cell] = scaled[cell] + strength / before * search[cell]
    return bool(told[0] > 0)


@machine_code
def _approached(
    addresses: Any, rows: int, model: Any, links: Any, point: Any, whole: bool, found: Any, bounds: Any, straight: int,
    moving: Any, accuracy: float, told: Any, step: Any,
) -> int:  # fmt: skip
    """step ← Newton's over the moving cells, of which those stop at their bounds that it would take beyond.

    DOWN where the cost bends down, STOPPED where cells stopped, else FREELY. Step and bounds as in `_bent`.
    """
    cells, rough, ending = len(step), max(accuracy, ROUGH), FREELY
    step[:] = 0.0
    for stops in range(MOST_STOPS + 2):
        if not _conjugated(addresses, rows, model, links, point, whole, found, moving, rough, stops > 0, told, step):
            return DOWN
        beyond = 0
        for cell in range(cells):
            low = _bent(bounds[0, cell] - point[0][0, cell], straight)
            high = _bent(bounds[1, cell] - point[0][0, cell], straight)
            held = min(max(step[cell], low), high)
            if moving[cell] and held != step[cell]:
                step[cell], moving[cell] = held, 0
                beyond += 1
        if beyond > 0:
            ending = STOPPED
        elif rough == accuracy:
            break
        else:
            rough = accuracy
    return ending


@machine_code
def _ventured(
    addresses: Any, where: Any, arena: Any, ties: Any, bounds: Any, limits: Any, here: Any, there: Any, along: Any,
    straight: int, costs: Any,
) -> bool:  # fmt: skip
    """Whether a step or a share of it leads to a better point, which `there` is then; as `_trial`, straight in 1/r
    where `straight` is −1.
    """
    vectors, target = here[0], np.empty(len(along))
    for number in range(len(SHARES)):
        promise = 0.0
        for cell in range(len(along)):
            moved = _unbent(SHARES[number] * along[cell], straight)
            moved = min(max(vectors[0, cell] + max(moved, -limits[5]), bounds[0, cell]), bounds[1, cell])
            target[cell] = moved
            promise -= (vectors[2, cell] + vectors[3, cell]) * _bent(moved - vectors[0, cell], straight)
        _put(there[0], target, bounds)
        costs[3], costs[4] = _priced(addresses, where, arena, ties, there)
        costs[5], gain = promise, costs[0] - costs[3]
        if promise > 0 and gain >= limits[2] * promise:
            return True
        if abs(gain) <= limits[3] * abs(costs[0]):
            residual = _residual(vectors, bounds, costs[1])
            if _residual(there[0], bounds, costs[4]) < limits[4] * residual:
                return True
    return False


@machine_code
def pursue(
    addresses: Any, where: Any, arena: Any, given: Any, entries: Any, ties: Any, bounds: Any, start: Any, base: Any,
    seen: Any, inner: Any, found_at: Any, straight: int, band: int, limits: Any, sigma: Any,
) -> Any:  # fmt: skip
    """(ending, u, the last step, its decrement and share, steps before it, the last preconditioner's parts and place,
    how many were made) of one larger frame.

    As `descend`, without matrices of cells × cells. base, seen, inner : of a preconditioner that was made at `found_at`
    u, or nothing. straight : −1 where steps are straight in 1/r, 0 in u. band : how far apart cells stand that a term
    ties.
    """
    rows, cells = where[9], len(start)
    lines = rows + cells // rows
    for number in range(len(given)):
        arena[where[6] + number] = given[number]
    here, there = _blank(lines, cells), _blank(lines, cells)
    step, along, moving = np.zeros(cells), np.zeros(cells), np.zeros(cells, dtype=np.int64)
    told, costs, spent = np.zeros(4), np.zeros(6), np.zeros(2)
    _put(here[0], start, bounds)
    costs[0], costs[1] = _priced(addresses, where, arena, ties, here)
    ending, solves, made, spent[0] = FELL_SHORT, 0, 0, MOST_PRODUCTS
    found = (base, seen, inner, len(found_at) > 0)
    for turn in range(MOST_STEPS):
        residual = _residual(here[0], bounds, costs[1])
        if not (abs(costs[0]) < np.inf and residual < np.inf) or _overdue(addresses, limits) or solves >= limits[13]:
            break
        near, better = residual <= limits[0], False
        accuracy = FINE if near else min(ROUGH, np.sqrt(residual))
        for attempt in range(2):
            whole = attempt == 0 and (turn > 0 or straight == 0 or near)
            if attempt == 0 and not whole:
                continue
            moving[:] = 0
            moving[_free(here[0], bounds)] = 1
            model, links = _modelled(addresses, where, arena, entries, here, straight, whole)
            if not found[3] or _away(here[0][0], found_at) > limits[6]:
                found = _preconditioner(addresses, rows, model, links, here, band, ties[0])
                found_at, made = here[0][0].copy(), made + 1
            if not found[3]:
                break
            way = _approached(
                addresses, rows, model, links, here, whole, found, bounds, straight, moving, accuracy, spent, along
            )
            if way == DOWN:
                continue
            told[0] = 0.0
            for cell in range(cells):
                step[cell] = _unbent(along[cell], straight)
                told[0] -= (here[0][2, cell] + here[0][3, cell]) * along[cell]
            sure = near and way == FREELY and whole
            if sure and _certified(addresses, where, arena, entries, limits, sigma, step, told):
                ending = SETTLED
                break
            better = _ventured(addresses, where, arena, ties, bounds, limits, here, there, along, straight, costs)
            if better:
                break
            _priced(addresses, where, arena, ties, here)
        if not better:
            break
        here, there, solves = there, here, solves + 1
        costs[0], costs[1] = costs[3], costs[4]
    if ending == SETTLED and told[3] <= limits[7]:
        for cell in range(cells):
            here[0][0, cell] += step[cell]
    return ending, here[0][0].copy(), step, told[1], told[2], solves, found[0], found[1], found[2], found_at, made


@machine_code
def preconditioned(addresses: Any, rows: int, base: Any, seen: Any, inner: Any, values: Any) -> Any:
    """(cells) what a preconditioner that `pursue` left makes of values (cells)."""
    result, moving = np.empty(len(values)), np.ones(len(values), dtype=np.int64)
    _preconditioned(addresses, rows, (base, seen, inner, True), moving, values, result)
    return result


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
    point, moving = _blank(rows + cells // rows, cells), np.zeros(cells, dtype=np.int64)
    _put(point[0], position, bounds)
    objective, _ = _priced(addresses, where, arena, ties, point)
    free, basis, images = _free(point[0], bounds), np.zeros((6, cells)), np.zeros((6, cells))
    if len(free) < len(basis) or not abs(objective) < np.inf:
        return False, basis[0]
    moving[free] = 1
    model, links = _modelled(addresses, where, arena, entries, point, 0, True)
    for number in range(len(free)):  # any two that are not orthogonal to what is sought
        basis[0, free[number]], basis[1, free[number]] = np.cos(number + 0.5), np.cos(2 * number + 1.0)
    residual, fresh, left = np.empty(cells), 0, 0.0
    for _ in range(MOST_ROUNDS):
        for vector in range(fresh, fresh + 2):
            _bent_along(addresses, rows, model, links, point, True, basis[vector], images[vector])
            for cell in range(cells):
                images[vector, cell] *= moving[cell]
        bends = _narrowed(basis, images)
        for vector in range(2):
            for cell in range(cells):
                residual[cell] = images[vector, cell] - bends[vector] * basis[vector, cell]
            left = np.sqrt(_dot(residual, residual)) if vector == 0 else left
            _preconditioned(addresses, rows, (base, seen, inner, True), moving, residual, basis[2 + vector])
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


@machine_code
def appraised(addresses: Any, where: Any, arena: Any, given: Any, ties: Any, cell_resistance: Any) -> Any:
    """(readings, what the cost's `first` returns, ∇φ in u) of cells (cells) ohm; no number where Z does not exist."""
    cells, rows = len(cell_resistance), where[9]
    for number in range(len(given)):
        arena[where[6] + number] = given[number]
    point = _blank(rows + cells // rows, cells)
    reading, first, gradient = np.empty(cells), np.empty(2 * where[7] + 2 * cells), np.empty(cells)
    for cell in range(cells):
        point[0][1, cell] = cell_resistance[cell]
    objective, _ = _priced(addresses, where, arena, ties, point)
    for number in range(len(first)):
        first[number] = arena[where[3] + number] if objective < np.inf else np.nan
    for cell in range(cells):
        reading[cell] = arena[where[1] + cell]
        gradient[cell] = point[0][2, cell] + point[0][3, cell]
    return reading, first, gradient


@machine_code
def _deviation(stiffness: Any, sigma: Any) -> float:
    """√(mean ∂²φ/∂y² σ²) over the readings that count."""
    total, count = 0.0, 0
    for number in range(len(stiffness)):
        if stiffness[number] > 0:
            total += stiffness[number] * sigma[number] ** 2
            count += 1
    return np.sqrt(total / count) if count else 0.0
