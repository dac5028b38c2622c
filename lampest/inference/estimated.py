"""Sentences on the numbers of a scene that its recording determined."""

from collections.abc import Iterable, Mapping
from math import floor, inf, log10

from lampest.panel.sizes import unit_of_key

RANGES = ("readout.passes_volt",)  # keys of which the pair is a range in volt
MAX_LINES = 12  # a panel of many modules has numbers of each


def estimated_lines(estimated: Mapping[str, tuple[float, float]] | None) -> tuple[str, ...]:
    """Return a line for each number, and one for those beyond MAX_LINES.

    Such a line is 'ripple: 0.096 ± 0.057 LSB'.

    Parameters
    ----------
    estimated : mapping or None
        Key of the scene → number and standard deviation, as in `Scene.estimated`; None without any.
    """
    lines = [_line(key, *pair) for key, pair in (estimated or {}).items()]
    more = len(lines) - MAX_LINES
    if more > 0:
        lines[MAX_LINES:] = [f"{more} more numbers, which the scene of the results holds"]
    return tuple(lines)


def about_recordings(
    scenes: Iterable[tuple[str, Mapping[str, tuple[float, float]] | None]],
) -> tuple[str, ...]:
    """Return the lines of several recordings, each behind the recording's name, and each once."""
    lines = list[str]()
    for name, estimated in scenes:
        lines += [f"{name}: {line}" for line in estimated_lines(estimated)]
    return tuple(dict.fromkeys(lines))


def _line(key: str, number: float, deviation: float) -> str:
    """Return a number with its standard deviation and unit, or a range, in words."""
    if key in RANGES:
        return f"{key}: {number:.3g} to {deviation:.3g} V"
    name = key.partition(" of ")[0]  # without the place: leaks of row 3
    unit = unit_of_key(name) or "(relative)"
    if not 0 < deviation < inf:
        return f"{key}: {number:.2g} ± {deviation:.2g} {unit}"
    # Negative numbers of decimals are tens, hundreds and so on: '1230', or '2e-07' below 0.0001
    decimals = 1 - floor(log10(deviation))
    texts = []
    for rounded in (round(number, decimals), round(deviation, decimals)):
        exponent = floor(log10(abs(rounded))) if rounded else 0
        texts.append(f"{rounded:.{max(exponent + decimals, exponent, 0) + 1}g}" if rounded else "0")
    return f"{key}: {' ± '.join(texts)} {unit}"
