"""Methods that `formulation:` may name.

To add one, write its file and add its class to `AnyMethod`.
"""

from typing import Annotated, Literal

from lampest.estimate.methods.approximate import (
    LinearisedMethod,
    TruncatedMethod,
    UncorrectedMethod,
)
from lampest.estimate.methods.method import Method, OptimalMethod
from lampest.estimate.methods.smoother import SmootherMethod
from lampest.files.errors import InputError, in_words
from lampest.files.typed import ByKind, members_by_kind

LessWork = UncorrectedMethod | LinearisedMethod | TruncatedMethod
AnyMethod = Annotated[OptimalMethod | LessWork | SmootherMethod, ByKind("lampest.methods")]
Optimal = Literal["per_pixel", "nodal", "reduced", "auto"]
Approximate = Literal["naive", "scaled", "linearised", "truncated"]
MethodName = Literal[Optimal, Approximate, "smoother"]


def named_method(method: "Method | str") -> Method:
    """Return the method with a name.

    A method is returned unchanged. Raises InputError for an unknown name.
    """
    if isinstance(method, Method):
        return method
    kinds = members_by_kind(AnyMethod)
    if not isinstance(method, str):
        raise InputError(
            "formulation must be a word or a method such as TruncatedMethod(), not "
            f"{in_words(method)}"
        )
    if method not in kinds:
        raise InputError(f"formulation: there is no {method!r}; there are {', '.join(kinds)}")
    chosen: Method = kinds[method](kind=method)
    return chosen
