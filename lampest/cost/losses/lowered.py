"""A loss as solvers take it that need second derivatives everywhere."""

from dataclasses import dataclass

import casadi


@dataclass(frozen=True, eq=False)
class Lowered:
    """weight·loss of a column of residuals x as the least of `objective` over p, q ≥ 0 where `equation` is 0.

    split : p and q, (rows, 1) each, in a unit that makes them of order one; () where the loss needs none.
    equation : (rows, 1), x in that unit − p + q, whose multipliers are weight·unit·z, z the duals; None unless the loss
    enters through duals.
    """

    objective: casadi.SX
    split: tuple[casadi.SX, ...] = ()
    equation: casadi.SX | None = None
