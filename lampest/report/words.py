"""Formatting of numbers and lists."""

from collections.abc import Callable, Sequence

import numpy as np

from lampest.panel.panel import Array


def listed(names: Sequence[str]) -> str:
    """Join names, such as 'A, B and C'."""
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def no_formula(value: object) -> object:
    """Return a value, with a leading apostrophe if a spreadsheet would evaluate it as a formula."""
    if isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t", "\r")):
        return f"'{value}"
    return value


def digits(value: float, count: int = 3, like: float | None = None) -> str:
    """Format a number with `count` significant digits, such as '0.0012', '3,050'.

    Numbers from 10⁻⁴ to 10⁶ have no exponent. `like` is a number that gets `count` digits; the
    value then has the same decimals.
    """
    if np.isnan(value):
        return "not a number"
    if np.isinf(value):
        return "−∞" if value < 0 else "∞"
    size = abs(value if like is None else like)
    if size and not 1e-4 <= size < 1e6:
        mantissa, exponent = f"{value:.{count - 1}e}".split("e")
        return f"{mantissa}e{int(exponent)}".replace("-", "−")
    places = max(0, count - 1 - int(np.floor(np.log10(size)))) if size else 0
    return f"{value:,.{places}f}".replace("-", "−")


def text_of(value: float | str | None, form: str = "digits") -> str:
    """Format a value, '' for None and NaN; the form `digits` has three digits, with commas."""
    if value is None or value != value:
        return ""
    return digits(float(value)) if form == "digits" else format(value, form)


def median_text(values: Array, text: Callable[[float], str] = digits) -> str:
    """Return the median of the known values, with their range where they differ.

    '' where none is known.
    """
    finite = values[np.isfinite(values)]
    if not finite.size:
        return ""
    least, middle, largest = map(text, np.percentile(finite, [0, 50, 100]).tolist())
    return middle if least == largest else f"{middle} ({least} to {largest})"


def spanned(values: Array, unit: str) -> str:
    """Return the smallest and the largest known value in words, such as '219.5 to 672.9 ohm'."""
    finite = values[np.isfinite(values)]
    return f"{finite.min():.4g} to {finite.max():.4g} {unit}" if finite.size else "unknown"
