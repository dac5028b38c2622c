"""Results as JSON, and their comparison.

A number's tolerance follows from its quantity: from the kind of its row, which the row states where
it is made, and from its name where the quantity may be zero. `QUANTITIES` lists the
exceptions.
"""

import dataclasses
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from enum import Enum
from typing import Any

import numpy as np
from scipy import sparse

# significant digits; numbers of an array that is stored whole, and of a longer one
DIGITS = 9
MAX_VALUES = 40
SAMPLE_SIZE = 16
# Of a number: cells, error bars, costs, and all that follows from them without a search.
RELATIVE_TOLERANCE = 1e-6
LARGEST_SHARE = 0.1  # of a tolerance, which counts for the largest number of an array


@dataclasses.dataclass(frozen=True)
class Quantity:
    """Exactness of numbers that are less exact than RELATIVE_TOLERANCE, or may be zero.

    Attributes
    ----------
    names : str
        Regular expression of the names under which they stand: fields, keys, or the kind of a row.
    relative : float
        Tolerance of a number.
    zero : float
        Size in the unit of the quantity of which RELATIVE_TOLERANCE is zero: below, all that is
        computed is rounding.
    """

    names: str
    relative: float = RELATIVE_TOLERANCE
    zero: float = 0.0


QUANTITIES = (
    # Kinds of rows, which a row states where it is made (`of_kind`).
    Quantity("searched", relative=1e-4),  # smoothers and channels, whose cost has settled
    # Recognition and known loads: a search carries the rounding of its first steps to its end,
    # enlarged. Measured between kernels: 4e-7.
    Quantity("fitted", relative=5e-6),
    # Conjugate gradients that end at 1e-3 in the norm of a Hessian (SampledErrors), which weakly
    # determined directions exceed; golden sections that end at 0.005 (spectrum.PRECISION).
    Quantity("sampled", relative=3e-2),
    # Fields of results.
    Quantity("preconditioned", relative=1e-3),  # solves with matrices of condition 1e8 and more
    Quantity(r"pressure(_\w+)?", zero=1.0),  # kPa
    Quantity("effects", zero=1.0),  # of lines on readings, ohm
    # |z| ≤ 1, from residuals that are rounding at their corner: solves end where the gap of all is
    # 1e-9 of the cost, and single duals are known to a hundredth.
    Quantity("dual", zero=1e4),
    Quantity("verified_difference", zero=1.0),  # of log r, between two solutions
    # Costs of exact readings: ohm² or −2 log probability.
    Quantity("costs|objective|gap|misfit|chi_square", zero=1e-6),
)


@dataclasses.dataclass(frozen=True)
class OfKind:
    """A result whose numbers have the tolerance of a kind."""

    kind: str
    value: Any


def of_kind(kind: str, row: Callable[[], Any]) -> Callable[[], OfKind]:
    """Return a row whose numbers have the tolerance of a kind, see QUANTITIES."""
    return lambda: OfKind(kind, row())


def content(value: Any) -> Any:
    """Return a result as JSON has it.

    A long array is reduced to some numbers, its mean and the count of values that are not finite.
    """
    if isinstance(value, OfKind):
        return {value.kind: content(value.value)}
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


@dataclasses.dataclass(frozen=True)
class Tolerance:
    """Difference that a number may have.

    Attributes
    ----------
    relative : float
        Of the number; LARGEST_SHARE of it counts for the largest number of its array.
    absolute : float
        In the number's unit.
    """

    relative: float = RELATIVE_TOLERANCE
    absolute: float = 0.0

    def within(self, name: str) -> "Tolerance":
        """Return the tolerance of what stands under a name."""
        for quantity in QUANTITIES:
            if re.fullmatch(quantity.names, name):
                return Tolerance(
                    max(self.relative, quantity.relative),
                    max(self.absolute, RELATIVE_TOLERANCE * quantity.zero),
                )
        return self

    def of_array(self, values: np.ndarray[Any, Any]) -> "Tolerance":
        """Return the tolerance of numbers that follow from an array."""
        share = LARGEST_SHARE * self.relative * largest(values)
        return dataclasses.replace(self, absolute=max(self.absolute, share))

    def exceeded(self, stored: np.ndarray[Any, Any], computed: np.ndarray[Any, Any]) -> Any:
        """Return whether numbers differ by more, boolean in the shape of the arrays."""
        least = self.of_array(stored).absolute
        return ~np.isclose(computed, stored, rtol=self.relative, atol=least, equal_nan=True)


def difference(
    stored: Any, computed: Any, place: str = "", tolerance: Tolerance = Tolerance()
) -> str:
    """Return the first place at which two contents differ, and how; '' where there is none."""
    pairs: Iterator[tuple[Any, Any, str, Tolerance]]
    if isinstance(stored, dict) and "some" in stored:  # a long array, whose mean may cancel
        tolerance = tolerance.of_array(np.array(stored["some"], dtype=float))
    if isinstance(stored, dict) and isinstance(computed, dict) and stored.keys() == computed.keys():
        pairs = (
            (stored[key], computed[key], f"{place}.{key}", tolerance.within(key)) for key in stored
        )
        return next(filter(None, (difference(*pair) for pair in pairs)), "")
    if isinstance(stored, list) and isinstance(computed, list) and len(stored) == len(computed):
        if not is_numbers(stored + computed):
            pairs = (
                (*two, f"{place}[{k}]", tolerance)
                for k, two in enumerate(zip(stored, computed, strict=True))
            )
            return next(filter(None, (difference(*pair) for pair in pairs)), "")
    elif not is_numbers([stored, computed]):
        if shortened(stored) == shortened(computed):
            return ""
        return f"{place}: {stored!r} was stored, {computed!r} is computed"
    reference = np.atleast_1d(np.array(stored, dtype=float))
    current = np.atleast_1d(np.array(computed, dtype=float))
    far = tolerance.exceeded(reference, current)
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
