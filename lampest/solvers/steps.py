"""Parameters of the steps of solvers whose unknowns are the cells alone."""

from dataclasses import dataclass
from math import log


@dataclass(frozen=True)
class Steps:
    """Parameters of the steps.

    Attributes
    ----------
    radius_factor : float
        Next trust radius as a share of the length of a rejected step.
    max_step : float
        Largest change of log r of a cell in one step. Beyond it the quadratic model of a cell is
        wrong.
    max_tries : int
        Maximum number of solves of one direction, each of which may stop further cells at bounds;
        of tries of one step, whose radius is then 4⁻¹⁵, within rounding; and of further steps at a
        point that is stationary but not settled.
    gauss_newton : int
        Number of steps with the Gauss–Newton matrix before a direction of negative curvature is
        followed.
    max_products : tuple of int
        Maximum number of products in one solve, (sparse, dense). A new factor is cheaper on small
        problems.
    max_reuse_products : tuple of int
        Products of one step, (sparse, dense), beyond which the preconditioner is made anew.
    max_reuse_distance : float
        Change of log r beyond which the preconditioner is made anew. Without it small panels take a
        third more products.
    refactor_distance : float
        Change of log r up to which a factor of ∇²φ still serves as certificate; second derivatives
        change by about the same share. If the next step is expected to be shorter than its square,
        ∇²φ is factored before it. Without this a frame with a wrong model takes 248 iterations in
        place of 146 (test_random_problems).
    min_smoothed_cost : float
        Cost, relative to the cost's scale, below which the smoothing need not become finer.
    min_damping, next_damping, max_damping : float
        μ of Levenberg's step: first value, least value of a second try, and largest value.
    path_tolerance : float
        Projected gradient, relative to the cost's scale, below which a start does not follow the
        central path. Frames in sequence begin at 0.05, frames that are solved again at their
        tolerance.
    window : int
        Iterations after which a solve counts as stalled; well-posed frames end within 15
        iterations.
    min_decrease : float
        Relative decrease of the cost over the window. A joint pair on a plateau falls by more and
        still ends verified (test_random_problems).
    min_reduction : float
        Share of the projected gradient at the window's begin below which the solve still converges.
    """

    radius_factor: float = 0.25
    max_step: float = log(4.0)
    max_tries: int = 15
    gauss_newton: int = 3
    max_products: tuple[int, int] = (400, 40)
    max_reuse_products: tuple[int, int] = (30, 5)
    max_reuse_distance: float = 0.7
    refactor_distance: float = 0.01
    min_smoothed_cost: float = 1e-4
    min_damping: float = 1e-15
    next_damping: float = 1e-4
    max_damping: float = 1e3
    path_tolerance: float = 1e-3
    window: int = 20
    min_decrease: float = 1e-8
    min_reduction: float = 0.1


STEPS = Steps()
