"""The cost terms of an estimator as a run's file writes them: kind → options."""

from collections.abc import Mapping
from dataclasses import field, make_dataclass
from typing import Any

from lampest.cost.terms import AnyTerm, Term, term_types
from lampest.files.typed import kinds_of, shipped

FORBID: dict[str, Any] = {"extra": "forbid"}


def terms_class(kinds: Mapping[str, type[Term]], *bases: type[Any]) -> type[Any]:
    """A dataclass with a field for every kind of term, None by default."""
    return make_dataclass(
        "Terms",
        [(kind, term | None, field(default=None)) for kind, term in kinds.items()],
        bases=bases,
        frozen=True,
        namespace={
            "__pydantic_config__": FORBID,
            "__module__": __name__,
            "__doc__": "The cost terms of an estimator, by kind.",
        },
    )


class _WithInstalled:
    """What is validated as these terms may name those of installed packages, too."""

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> Any:
        """The schema of a class with fields for them; called by the validating library."""
        further = {kind: term for kind, term in term_types().items() if kind not in source.__dataclass_fields__}
        return handler.generate_schema(terms_class(further, source)) if further else handler(source)


Terms = terms_class({kind: term for term in shipped(AnyTerm) for kind in kinds_of(term)}, _WithInstalled)


def terms_of(terms: Any) -> tuple[Term, ...]:
    """The terms that an object of `Terms` names, in order."""
    return tuple(term for kind in term_types() if (term := getattr(terms, kind, None)) is not None)
