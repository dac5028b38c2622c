"""Results as JSON, and their comparison."""

import dataclasses
import re
from collections.abc import Iterator, Mapping, Sequence
from enum import Enum
from typing import Any

import numpy as np
from scipy import sparse

# significant digits; numbers of an array that is stored whole, and of a longer one
DIGITS = 9
MAX_VALUES = 40
SAMPLE_SIZE = 16
# of a number, and of the largest of its array
RELATIVE_TOLERANCE = 1e-6
ABSOLUTE_TOLERANCE = 1e-7
# Factor on the differences between processors, as others differ from these.
TOLERANCE_FACTOR = 100.0


def content(value: Any) -> Any:
    """Return a result as JSON has it.

    A long array is reduced to some numbers, its mean and the count of values that are not finite.
    """
    if sparse.issparse(value):
        value = value.toarray()
    if isinstance(value, np.ndarray | np.generic | float):
        return of_array(np.asarray(value))
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {
            field.name: content(getattr(value, field.name))
            for field in dataclasses.fields(value)
            # keys of installed packages, where there are any
            if not (field.name == "own" and isinstance(getattr(value, field.name), tuple))
        }
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Mapping):
        return {str(key): content(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple | set | frozenset | Iterator):
        values = sorted(value) if isinstance(value, set | frozenset) else list(value)
        plain = bool(values) and all(isinstance(each, int | float | np.number) for each in values)
        return (
            of_array(np.array(values, dtype=float))
            if plain
            else [content(inner) for inner in values]
        )
    assert value is None or isinstance(value, str | int), (
        f"{type(value).__name__} has no golden form"
    )
    return value


def of_array(values: np.ndarray[Any, Any]) -> Any:
    if values.dtype.kind in "US":
        return values.tolist()
    flat = values.ravel().astype(float)
    if not values.ndim:
        return rounded(flat[0])
    if flat.size <= MAX_VALUES:
        return [rounded(number) for number in flat]
    finite = np.isfinite(flat)
    sample = flat[np.linspace(0, flat.size - 1, SAMPLE_SIZE).astype(int)]
    summary = {
        "shape": str(values.shape),
        "unknown": int((~finite).sum()),
        "mean": rounded(flat[finite].mean()),
    }
    return summary | {"some": [rounded(number) for number in sample]}


def rounded(number: float) -> float:
    return float(f"{number:.{DIGITS}g}")


def shortened(value: Any) -> Any:
    """Return a text with its long numbers rounded, since their last digits are rounding.

    Anything else is returned as it is.
    """
    if not isinstance(value, str):
        return value
    return re.sub(
        r"\d+\.\d{9,}(e[+-]?\d+)?", lambda number: f"{float(number[0]):.{DIGITS - 3}g}", value
    )


# place, with [] for any index → share of an array's largest number, or None
Tolerances = Mapping[str, float | None]


def difference(stored: Any, computed: Any, tolerances: Tolerances, place: str = "") -> str:
    """Return the first place at which two contents differ, and how; '' where there is none.

    What stands at a place whose tolerance is None is not compared.
    """
    anywhere = re.sub(r"\[\d+\]", "[]", place)
    if tolerances.get(anywhere, 0.0) is None:
        return ""
    if isinstance(stored, dict) and isinstance(computed, dict) and stored.keys() == computed.keys():
        pairs = ((stored[key], computed[key], f"{place}.{key}") for key in stored)
        return next(
            filter(None, (difference(*two, tolerances, inner) for *two, inner in pairs)), ""
        )
    if isinstance(stored, list) and isinstance(computed, list) and len(stored) == len(computed):
        if not is_numbers(stored + computed):
            pairs = (
                (*two, f"{place}[{k}]") for k, two in enumerate(zip(stored, computed, strict=True))
            )
            return next(
                filter(None, (difference(*two, tolerances, inner) for *two, inner in pairs)), ""
            )
    elif not is_numbers([stored, computed]):
        if shortened(stored) == shortened(computed):
            return ""
        return f"{place}: {stored!r} was stored, {computed!r} is computed"
    reference = np.atleast_1d(np.array(stored, dtype=float))
    current = np.atleast_1d(np.array(computed, dtype=float))
    far = ~np.isclose(
        current,
        reference,
        rtol=RELATIVE_TOLERANCE,
        atol=(tolerances.get(anywhere) or ABSOLUTE_TOLERANCE) * largest(reference),
        equal_nan=True,
    )
    if not far.any():
        return ""
    first = int(np.argmax(far))
    return (
        f"{place}[{first}]: {reference[first]:.10g} was stored, {current[first]:.10g} is computed"
    )


def is_numbers(values: Sequence[Any]) -> bool:
    return all(isinstance(value, int | float) for value in values)


def largest(values: np.ndarray[Any, Any]) -> float:
    return float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values)))


def unsteady(stored: Any, computed: Any, place: str = "") -> Iterator[tuple[str, float | None]]:
    """Yield (place, tolerance) where two computations of the same row differ."""
    if isinstance(stored, dict) and isinstance(computed, dict) and stored.keys() == computed.keys():
        for key in stored:
            yield from unsteady(stored[key], computed[key], f"{place}.{key}")
        return
    lists = isinstance(stored, list) and isinstance(computed, list) and len(stored) == len(computed)
    if lists and not is_numbers(stored + computed):
        for inner in zip(stored, computed, strict=True):
            yield from unsteady(*inner, f"{place}[]")
        return
    if not difference(stored, computed, {}):
        return
    if not lists and not is_numbers([stored, computed]):
        yield place, None
        return
    reference = np.atleast_1d(np.array(stored, dtype=float))
    current = np.atleast_1d(np.array(computed, dtype=float))
    share = (
        TOLERANCE_FACTOR
        * largest(current - reference)
        / max(largest(reference), np.finfo(float).tiny)
    )
    alike = np.array_equal(np.isfinite(reference), np.isfinite(current))
    yield place, 10.0 ** np.ceil(np.log10(share)) if alike and share < 0.1 else None
