"""weight·loss(residual) of every term in every frame, as expressions, and the order in which a program takes them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi

from lampest.cost.losses import Loss, Lowered
from lampest.cost.terms import Term
from lampest.files.errors import InputError


@dataclass(frozen=True, eq=False)
class Summand:
    """weight·loss(residual) of one term in one frame.

    term : its number. residual : (rows, 1). weight : (1, 1).
    """

    term: int
    loss: Loss
    residual: casadi.SX
    weight: casadi.SX

    @property
    def cost(self) -> Any:
        """Its value. Raises InputError where a loss forgets to sum over its residuals."""
        cost = self.loss.cost(self.residual)
        if cost.shape != (1, 1):
            name, shape = type(self.loss).__name__, "×".join(map(str, cost.shape))
            raise InputError(f"loss {name}: cost gives {shape} numbers; it must give one, the sum over all residuals")
        return self.weight * cost

    @property
    def smooth(self) -> bool:
        """Whether it enters derivatives as it is, not through duals."""
        return self.loss.enters != "dual"

    @property
    def rows(self) -> int:
        """How many residuals it has."""
        return int(self.residual.shape[0])


def summands(terms: Sequence[Term], pairs: Iterable[tuple[int, casadi.SX]], weights: casadi.SX) -> list[Summand]:
    """Of the (number of the term, residual) pairs, in their order; weights : (terms, 1)."""
    return [Summand(number, terms[number].loss, residual, weights[number]) for number, residual in pairs]


def stacked(parts: Sequence[Summand]) -> tuple[casadi.SX, casadi.SX]:
    """(residual, weight) of all rows, (rows, 1) each."""
    weights = [casadi.repmat(part.weight, part.rows, 1) for part in parts]
    return casadi.vertcat(casadi.SX(0, 1), *(part.residual for part in parts)), casadi.vertcat(
        casadi.SX(0, 1), *weights
    )


def program_groups(parts: Sequence[Summand]) -> list[list[Summand]]:
    """What a program lowers together, in its order: each that it takes whole, all with duals, each that it splits."""
    whole, dual, split = ([part for part in parts if part.loss.enters == how] for how in ("whole", "dual", "split"))
    return [*([part] for part in whole), *([dual] if dual else []), *([part] for part in split)]


def lowered(group: Sequence[Summand], unit: casadi.SX) -> Lowered:
    """One group for a program; to it all that enters through duals is alike. unit : of the split."""
    first = group[0]
    residual, weight = (first.residual, first.weight) if first.smooth else stacked(group)
    return first.loss.lowered(residual, weight, unit)
