"""Methods that `formulation:` may name.

To add one, write its file and name it in `AnyMethod`. A method is imported when it is named.
"""

from typing import Annotated, Literal

from lampest.estimate.methods.method import Method
from lampest.files.errors import InputError, in_words
from lampest.files.typed import ByKind, member_of_kind, members_by_kind

Optimal = Literal["per_pixel", "nodal", "reduced", "auto"]
Approximate = Literal["naive", "scaled", "linearised", "truncated"]
MethodName = Literal[Optimal, Approximate, "smoother"]
OPTIMAL = "lampest.estimate.methods.method:OptimalMethod"
APPROXIMATE = "lampest.estimate.methods.approximate"
AnyMethod = Annotated[
    Method,
    ByKind(
        "lampest.methods",
        members={
            "per_pixel": OPTIMAL,
            "nodal": OPTIMAL,
            "reduced": OPTIMAL,
            "auto": OPTIMAL,
            "naive": f"{APPROXIMATE}:UncorrectedMethod",
            "scaled": f"{APPROXIMATE}:UncorrectedMethod",
            "linearised": f"{APPROXIMATE}:LinearisedMethod",
            "truncated": f"{APPROXIMATE}:TruncatedMethod",
            "smoother": "lampest.estimate.methods.smoother:SmootherMethod",
        },
    ),
]


def named_method(method: "Method | str") -> Method:
    """Return the method with a name.

    A method is returned unchanged. Raises InputError for an unknown name.
    """
    if isinstance(method, Method):
        return method
    if not isinstance(method, str):
        raise InputError(
            "formulation must be a word "
            f"or a method such as TruncatedMethod(), not {in_words(method)}"
        )
    kind = member_of_kind(AnyMethod, method)
    if kind is None:
        kinds = ", ".join(members_by_kind(AnyMethod))
        raise InputError(f"formulation: there is no {method!r}; there are {kinds}")
    chosen: Method = kind(kind=method)
    return chosen
