"""The cost terms. To add one: write its file, name it in `AnyTerm`."""

from typing import Annotated

from lampest.cost.terms.arrival import Arrival
from lampest.cost.terms.cell_resistance import CellResistance
from lampest.cost.terms.gradient import Gradient
from lampest.cost.terms.gradient_of_relative_change import GradientOfRelativeChange
from lampest.cost.terms.log_ratio import LogRatio
from lampest.cost.terms.misfit import Misfit
from lampest.cost.terms.relative_change import RelativeChange
from lampest.cost.terms.term import Term
from lampest.cost.terms.total_variation import TotalVariation
from lampest.cost.terms.total_variation_of_change import TotalVariationOfChange
from lampest.files.tagged import ByKind, members_by_kind

AnyTerm = Annotated[
    Misfit
    | CellResistance
    | RelativeChange
    | Gradient
    | GradientOfRelativeChange
    | TotalVariation
    | LogRatio
    | TotalVariationOfChange
    | Arrival,
    ByKind("lampest.terms"),
]


def term_kind(term: Term) -> str:
    """The word that names the term in YAML and results."""
    return str(getattr(term, "kind", type(term).__name__))


def term_types() -> dict[str, type[Term]]:
    """kind → class, for every member of the union, in its order; then those of installed packages."""
    return members_by_kind(AnyTerm)
