"""Trust-region subproblem by preconditioned conjugate gradients (Steihaug and Toint).

Source: Steihaug, SIAM J. Numer. Anal. 20, 1983; Conn, Gould & Toint, Trust-Region Methods, 2000,
section 7.5.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, isfinite

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array

Linear = Callable[[Array], Array]
DENSE_CELLS = 256  # unknowns up to which a factor costs less than the products that it saves
# The same for problems with many products: absolute losses, joint pairs, error bars.
MATRIX_CELLS = 600
MAX_DENSE = 1200  # unknowns beyond which matrices take seconds; products or samples replace them
# Of the predicted decrease, as in Nocedal & Wright, 2006, section 3.1, algorithm 4.1.
SUFFICIENT_DECREASE = 1e-4
# Relative change of a conductance up to which a direction of negative curvature is followed.
MAX_RELATIVE_CHANGE = 1.0


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
        Decrease of the quadratic model, −gᵀs − ½ sᵀHs.
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
    """Return argmin gᵀs + ½ sᵀHs over ‖s‖_M ≤ radius.

    It is correct up to `accuracy` where the minimum is inside the radius.

    Parameters
    ----------
    product : Linear
        Function p → H·p.
    precondition : Linear
        Function p → M⁻¹·p, symmetric and positive definite.
    gradient : array, shape (unknowns,)
        g.
    accuracy : float
        ‖Hs + g‖ relative to ‖g‖, in the norm of M⁻¹, at which the iteration ends.
    radius : float
        Trust radius; may be infinite. A direction of negative curvature is followed to the radius,
        or until an entry of s reaches MAX_RELATIVE_CHANGE.
    admits : callable or None
        Function s → whether the step is admissible. The iteration ends before an inadmissible step,
        except for the first one. None: all are admissible.
    most_products : int
        Maximum number of products; the iteration then ends with the step so far.
    """
    step = np.zeros_like(gradient)
    residual = gradient
    scaled = precondition(residual)
    if not (strength := float(residual @ scaled)) > 0:
        precondition = np.copy  # M has lost its digits
        scaled = residual
        strength = float(residual @ residual)
    search = -scaled
    goal = accuracy**2 * strength
    # ‖s‖², sᵀMp, ‖p‖²
    inner = 0.0
    mixed = 0.0
    outer = strength
    count = 0
    while strength > goal and count < most_products:
        count += 1
        image = product(search)
        curvature = float(search @ image)
        length = strength / curvature if curvature > 0 else inf
        # ‖s + αp‖²_M = ‖s‖² + 2α sᵀMp + α²‖p‖², without a product with M
        further = inner + 2 * length * mixed + length * length * outer if isfinite(length) else inf
        if not further < radius**2:
            negative = not curvature > 0
            length = _length_to_radius(radius, inner, mixed, outer)
            if negative:
                length = min(length, _length_to_largest_change(step, search))
            ended = np.sqrt(inner + 2 * length * mixed + length * length * outer)
            step = step + length * search
            residual = residual + length * image
            # −gᵀs − ½ sᵀHs = −½ sᵀ(g + r) with the residual r = g + Hs
            return SubproblemStep(
                step, float(ended), -0.5 * float(step @ (gradient + residual)), negative, count
            )
        longer = step + length * search
        if admits is not None and count > 1 and not admits(longer):
            break
        step = longer
        inner = further
        residual = residual + length * image
        scaled = precondition(residual)
        before = strength
        strength = float(residual @ scaled)
        ratio = strength / before
        search = ratio * search - scaled
        # sᵀMp and ‖p‖² of the next search direction p ← βp − z by recursion (Steihaug 1983)
        mixed = ratio * (mixed + length * outer)
        outer = strength + ratio**2 * outer
    return SubproblemStep(
        step,
        float(np.sqrt(inner)),
        -0.5 * float(step @ (gradient + residual)),
        negative=False,
        products=count,
    )


def _length_to_radius(radius: float, inner: float, mixed: float, outer: float) -> float:
    """Return t ≥ 0 with ‖s + t p‖_M = radius; infinite without a radius.

    It is computed for ‖s‖², sᵀMp and ‖p‖² in the norm of M.
    """
    if radius == inf:
        return inf
    # Positive root of ‖p‖² t² + 2 sᵀMp t − (radius² − ‖s‖²) = 0, without cancellation
    room = max(radius**2 - inner, 0.0)
    return room / ((mixed + float(np.sqrt(mixed**2 + outer * room))) or 1.0)


def _length_to_largest_change(step: Array, search: Array) -> float:
    """Return the least t at which an entry of s + t p can reach MAX_RELATIVE_CHANGE."""
    with np.errstate(divide="ignore"):
        reached = np.maximum(MAX_RELATIVE_CHANGE - np.abs(step), 0.0) / np.abs(search)
    return float(np.fmin.reduce(reached, initial=inf))


def restricted(product: Linear, chosen: NDArray[np.intp], size: int) -> Linear:
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
