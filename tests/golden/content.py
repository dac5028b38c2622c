"""Results as JSON, and their comparison."""

import dataclasses
import re
from collections.abc import Iterator, Mapping
from enum import Enum
from typing import Any

import numpy as np
from scipy import sparse

DIGITS, LONG, CHOSEN = 9, 40, 16  # significant digits; numbers of an array that is stored whole, and of a longer one
RELATIVE, ABSOLUTE = 1e-8, 1e-9  # of a number, and of the largest of its array


def content(value: Any) -> Any:
    """Return a result as JSON has it; of a long array some numbers, its mean and the count of what is not finite."""
    if sparse.issparse(value):
        value = value.toarray()
    if isinstance(value, np.ndarray | np.generic | float):
        return of_array(np.asarray(value))
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: content(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Mapping):
        return {str(key): content(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple | set | frozenset | Iterator):
        values = sorted(value) if isinstance(value, set | frozenset) else list(value)
        plain = bool(values) and all(isinstance(each, int | float | np.number) for each in values)
        return of_array(np.array(values, dtype=float)) if plain else [content(inner) for inner in values]
    assert value is None or isinstance(value, str | int), f"{type(value).__name__} has no golden form"
    return value


def of_array(values: np.ndarray[Any, Any]) -> Any:
    if values.dtype.kind in "US":
        return values.tolist()
    flat = values.ravel().astype(float)
    if not values.ndim:
        return rounded(flat[0])
    if flat.size <= LONG:
        return [rounded(number) for number in flat]
    finite = np.isfinite(flat)
    some = flat[np.linspace(0, flat.size - 1, CHOSEN).astype(int)]
    summary = {"shape": str(values.shape), "unknown": int((~finite).sum()), "mean": rounded(flat[finite].mean())}
    return summary | {"some": [rounded(number) for number in some]}


def rounded(number: float) -> float:
    return float(f"{number:.{DIGITS}g}")


def shortened(value: Any) -> Any:
    """Return a text with its long numbers rounded, since their last digits are rounding; anything else as it is."""
    if not isinstance(value, str):
        return value
    return re.sub(r"\d+\.\d{9,}(e[+-]?\d+)?", lambda number: f"{float(number[0]):.{DIGITS - 1}g}", value)


def difference(stored: Any, computed: Any, relative: float = RELATIVE, place: str = "") -> str:
    """Return the first place at which two contents differ, and how; '' where there is none."""
    if isinstance(stored, dict) and isinstance(computed, dict):
        if stored.keys() != computed.keys():
            return f"{place}: {sorted(stored.keys() ^ computed.keys())} stands on one side alone"
        return next(
            filter(None, (difference(stored[key], computed[key], relative, f"{place}.{key}") for key in stored)), ""
        )
    if isinstance(stored, list) and isinstance(computed, list) and len(stored) == len(computed):
        if not all(isinstance(value, int | float) for value in stored + computed):
            pairs = enumerate(zip(stored, computed, strict=True))
            return next(filter(None, (difference(*pair, relative, f"{place}[{k}]") for k, pair in pairs)), "")
    elif not (isinstance(stored, int | float) and isinstance(computed, int | float)):
        return (
            ""
            if shortened(stored) == shortened(computed)
            else f"{place}: {stored!r} was stored, {computed!r} is computed"
        )
    before, now = np.atleast_1d(np.array(stored, dtype=float)), np.atleast_1d(np.array(computed, dtype=float))
    largest = np.max(np.abs(before), initial=0.0, where=np.isfinite(before))
    far = ~np.isclose(now, before, rtol=relative, atol=ABSOLUTE * largest, equal_nan=True)
    if not far.any():
        return ""
    first = int(np.argmax(far))
    return f"{place}[{first}]: {before[first]:.10g} was stored, {now[first]:.10g} is computed"
