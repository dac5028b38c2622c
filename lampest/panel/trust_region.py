"""Steps of a descent: the trust-region subproblem, backtracking, and a search along a line.

The subproblem is solved by preconditioned conjugate gradients (Steihaug and Toint).
Source: Steihaug, SIAM J. Numer. Anal. 20, 1983; Conn, Gould & Toint, Trust-Region Methods, 2000,
section 7.5; Nocedal & Wright, Numerical Optimization, 2006, algorithm 3.1 (backtracking); Kiefer,
Proc. Amer. Math. Soc. 4, 1953 (golden sections; importing those of SciPy takes 0.2 s).
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, sqrt
from typing import TypeVar

import numpy as np

from lampest.panel.panel import Array, Numbers

Linear = Callable[[Array], Array]
T = TypeVar("T")
DENSE_CELLS = 256  # unknowns up to which a factor costs less than the products that it saves
# The same for problems with many products: absolute losses, joint pairs, error bars.
MATRIX_CELLS = 600
MAX_DENSE = 1200  # unknowns beyond which matrices take seconds; products or samples replace them
# Of the predicted decrease, as in Nocedal & Wright, 2006, section 3.1, algorithm 4.1.
SUFFICIENT_DECREASE = 1e-4
# Relative change of a conductance up to which a direction of negative curvature is followed.
MAX_RELATIVE_CHANGE = 1.0
GOLDEN = (5**0.5 - 1) / 2  # share of a range that a golden section keeps


@dataclass(frozen=True, eq=False)
class SubproblemStep:
    """Step of the trust-region subproblem.

    Attributes
    ----------
    step : array, shape (unknowns,)
        s.
    length : float
        ‖s‖_M.
    decrease : float
        Decrease of the quadratic model, −gᵀs − ½ sᵀHs = −½ sᵀ(g + r) with the residual r = g + Hs.
    negative : bool
        Whether a direction of negative curvature was met.
    products : int
        Number of products with H.
    """

    step: Array
    length: float
    decrease: float
    negative: bool
    products: int


def steihaug(
    product: Linear,
    precondition: Linear,
    gradient: Array,
    accuracy: float,
    radius: float = inf,
    admits: Callable[[Array], bool] | None = None,
    most_products: int = 400,
) -> SubproblemStep:
    """Return argmin gᵀs + ½ sᵀHs over ‖s‖_M ≤ radius, with the gradient g.

    Parameters
    ----------
    product, precondition : Linear
        Functions p → H·p and p → M⁻¹·p; M is symmetric and positive definite.
    gradient : array, shape (unknowns,)
    accuracy : float
        ‖Hs + g‖ relative to ‖g‖, in the norm of M⁻¹, at which the iteration ends.
    radius : float
        May be infinite. A direction of negative curvature is followed to the radius, or until an
        entry of s reaches MAX_RELATIVE_CHANGE.
    admits : callable or None
        Whether a step s after the first is admissible: before one that is not the iteration ends.
    most_products : int
        Maximum number of products; the iteration then ends with the step so far.
    """
    step = np.zeros_like(gradient)
    residual = gradient
    scaled = precondition(gradient)
    if not gradient @ scaled > 0:
        scaled, precondition = gradient, np.copy  # M has lost its digits
    strength = float(gradient @ scaled)
    search = -scaled
    goal = accuracy**2 * strength
    step_square, mixed, search_square = 0.0, 0.0, strength
    curvature = inf
    count = 0
    while strength > goal and count < most_products:
        count += 1
        image = product(search)
        curvature = float(search @ image)
        longest = _length_to(radius, step_square, mixed, search_square)
        length = strength / curvature if curvature > 0 else _length_in_reach(step, search)
        inside = curvature > 0 and length < longest
        length = min(length, longest)
        if inside and count > 1 and admits is not None and not admits(step + length * search):
            break
        step = step + length * search
        residual = residual + length * image
        step_square += length * (2 * mixed + length * search_square)
        if not inside:
            break
        scaled = precondition(residual)
        ratio = float(residual @ scaled) / strength
        strength *= ratio
        search = ratio * search - scaled
        mixed = ratio * (mixed + length * search_square)
        search_square = strength + ratio**2 * search_square
    decrease = -0.5 * float(step @ (gradient + residual))
    return SubproblemStep(step, float(np.sqrt(step_square)), decrease, not curvature > 0, count)


def _length_to(radius: float, step_square: float, mixed: float, search_square: float) -> float:
    """Return t ≥ 0 with ‖s + t p‖_M = radius; infinite without a radius.

    `step_square`, `mixed` and `search_square` are ‖s‖², sᵀMp and ‖p‖². They follow by recursion,
    without a product with M (Steihaug 1983).
    """
    if radius == inf:
        return inf
    # Positive root of ‖p‖² t² + 2 sᵀMp t − (radius² − ‖s‖²) = 0, without cancellation
    room = max(radius**2 - step_square, 0.0)
    return room / ((mixed + sqrt(mixed**2 + search_square * room)) or 1.0)


def _length_in_reach(step: Array, search: Array) -> float:
    """Return the least t at which an entry of s + t p can reach MAX_RELATIVE_CHANGE."""
    room = np.maximum(MAX_RELATIVE_CHANGE - np.abs(step), 0.0)
    with np.errstate(divide="ignore"):
        return float(np.fmin.reduce(room / np.abs(search), initial=inf))


def backtracked(trial: Callable[[float], T | None], lengths: int) -> T | None:
    """Return the first accepted trial along a step; None if all are rejected.

    Parameters
    ----------
    trial : callable
        Function t → the trial at t times the step, or None if that is rejected.
    lengths : int
        Number of tried lengths t = 1, ½, ¼, ….
    """
    for power in range(lengths):
        accepted = trial(0.5**power)
        if accepted is not None:
            return accepted
    return None


def golden_section(value: Callable[[float], float], low: float, high: float, width: float) -> float:
    """Return the middle of a range of at most `width` about a minimum between two places."""
    # One of both golden sections is known; the other one lies as far from the other end
    inner = low + GOLDEN * (high - low)
    at_inner = value(inner)
    while abs(high - low) > width:
        mirrored = low + high - inner
        at_mirrored = value(mirrored)
        if at_mirrored < at_inner:
            high, inner, at_inner = inner, mirrored, at_mirrored
        else:
            low, high = high, mirrored
    return (low + high) / 2


def restricted(product: Linear, chosen: Numbers, size: int) -> Linear:
    """Return the restriction of a product over `size` unknowns to the chosen ones (numbers).

    All others are zero.
    """
    if len(chosen) == size:
        return product
    full = np.zeros(size)

    def part(values: Array) -> Array:
        full[chosen] = values
        return product(full)[chosen]

    return part
