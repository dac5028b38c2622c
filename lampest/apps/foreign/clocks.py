"""Times in foreign files: stamps, dates, numbers that count, and clocks that change."""

import re
from bisect import bisect_left
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from lampest.apps.foreign.words import (
    MAX_CUT,
    SECONDS,
    TIME_UNIT_OF_WORD,
    number_of,
    parted,
)
from lampest.files.errors import InputError, first_and_more
from lampest.panel.panel import Array, Mask, Numbers
from lampest.recording.acquisition import COUNTER

# Least time in s since 1970, in 2001; a board's own clock would have run for thirty years.
EPOCH = 1e9
DAYS_UNTIL_1970 = 25_569  # of Excel's, which begin at 1899-12-30
EXCEL_DAYS = (36_526, 73_050)  # of the years 2000 to 2099
MIN_STRETCH = 8  # times that grow, of a clock that begins again
HOUR = 3600.0  # by which clocks are changed in spring and autumn
STAMP = re.compile(
    r"(?=\d)(?:(\d{1,4})([-/.])(\d{1,2})\2(\d{1,4})(?=[T ,]|$))?[T ,]*"
    r"(?:(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,:](\d+))?)?\s*([AP]M\b)?)?\s*(Z|UTC|[+-]\d{2}:?\d{2})?",
    re.IGNORECASE,
)
# Order of a date's parts → separators.
DATES = {
    "year-month-day": "-/.",
    "day.month.year": ".",
    "day/month/year": "/-",
    "month/day/year": "/-",
}

Where = Callable[[int], str]


class Clock(NamedTuple):
    """Times of the frames of a file.

    Attributes
    ----------
    seconds : array, shape (frames,)
        Times in s.
    start : str or None
        Date and time of the first frame, ISO 8601, if the file contains it.
    sentence : str
        Sentence on both.
    unit : str or None
        Unit of times that are numbers.
    """

    seconds: Array
    start: str | None
    sentence: str
    unit: str | None = None

    def read_from(self, where: str) -> "Clock":
        """Return the clock with the place of the times in its sentence."""
        return self._replace(sentence=f"time: {where}{self.sentence}")


def is_stamp(text: str) -> bool:
    """Return whether a text is a date, a time of day, or both."""
    return STAMP.fullmatch(text.strip()) is not None


def seconds_of(text: str, *, comma: bool) -> float:
    """Return a number as it is, and a time of day in s; NaN for another text."""
    number = number_of(text, comma=comma)
    if number is not None:
        return number
    match = STAMP.fullmatch(text.strip())
    if match is None or not match[5]:
        return np.nan
    second = float(f"{match[7] or 0}.{match[8] or 0}")
    return 3600 * int(match[5]) + 60 * int(match[6]) + second


def clock_of(
    texts: Sequence[str], name: str, where: Where, *, comma: bool, unit: str | None
) -> Clock:
    """Return times of frames from the texts of a column or of stamps before lines.

    Parameters
    ----------
    texts : sequence of str
    name : str
        Name of the column, which may contain the unit of numbers.
    where : callable
        Number of a text → its place in the file.
    comma : bool
        Whether numbers have a decimal comma.
    unit : str or None
        's', 'ms' or 'us' for numbers; None: by the name and the numbers.

    Raises
    ------
    InputError
        If a text is no time, dates are ambiguous, times do not increase, or a unit is given for
        dates.
    """
    numbers = [number_of(text, comma=comma) for text in texts]
    if numbers.count(None) <= MAX_CUT * len(numbers):
        return clock_of_numbers(np.array(numbers, dtype=float), name, where, unit)
    if unit is not None:
        raise InputError(
            f"{where(0)}: {texts[0][:40]!r} is no number, so that it has no time unit {unit}"
        )
    stamped = [at for at, text in enumerate(texts) if is_stamp(text)]
    if len(texts) > len(stamped) >= (1 - MAX_CUT) * len(texts):  # the others are interpolated
        read = [texts[at] for at in stamped]
        clock = clock_of(read, name, lambda at: where(stamped[at]), comma=comma, unit=None)
        seconds = np.full(len(texts), np.nan)
        seconds[stamped] = clock.seconds
        seconds, cut = _growing(seconds, where)
        return clock._replace(seconds=seconds, sentence=f"{clock.sentence}{cut}")
    dated = any(match[1] for match in map(STAMP.fullmatch, map(str.strip, texts)) if match)
    ways = {}
    for way in DATES if dated else ("time of day",):
        with suppress(ValueError):  # of a text that is no date in this order
            ways[way] = [_iso(text, way) for text in texts]
    if not ways:
        strange = [number for number, text in enumerate(texts) if not is_stamp(text)] or [0]
        wrong = min(strange, key=lambda number: numbers[number] is not None)
        raise InputError(f"{where(wrong)}: {texts[wrong][:40]!r} is no time")
    if len(set(map(tuple, ways.values()))) > 1:
        raise InputError(
            f"{where(0)}: {texts[0][:40]!r} may be {' or '.join(ways)}; write year-month-day"
        )
    way, stamps = next(iter(ways.items()))
    return _clock_of_stamps(stamps, way if dated else "", texts[0], where)


def _clock_of_stamps(stamps: Sequence[str], way: str, first: str, where: Where) -> Clock:
    """Return times of stamps in ISO 8601, seconds from the first.

    `way` is the order of their dates, or '' for times of day, of which `first` is the first text.
    """
    times = list(map(datetime.fromisoformat, stamps))
    zoned = [time if time.tzinfo else time.replace(tzinfo=UTC) for time in times]
    seconds = np.array([(time - zoned[0]).total_seconds() for time in zoned])
    if way:
        zone = "" if times[0].tzinfo else ", no zone in the file"
        if not times[0].tzinfo:
            # Clocks are changed by an hour: in autumn times fall by it but for the step between
            # frames, in spring they leave out an hour from its beginning.
            steps = np.diff(seconds)
            usual = float(np.median(steps)) if len(steps) else 0.0
            slack = 3 * max(usual, 1e-3)
            begins = [
                time.hour != last.hour and time.minute * 60 + time.second <= slack
                for last, time in pairwise(times)
            ]
            back = (steps < 0) & (np.abs(steps + HOUR) <= slack)
            ahead = (np.abs(steps - HOUR - usual) <= slack) & np.array(begins, dtype=bool)
            changed = back | ahead
            if 0 < usual <= HOUR / 10 and 1 <= np.sum(changed) <= 2:
                seconds += HOUR * np.append(0, np.cumsum(back.astype(float) - ahead))
                at = times[1 + int(np.argmax(changed))].isoformat(" ")
                zone += f"; clocks were changed by an hour at {at}"
        sentence = f"{way}, s from the first, which is {stamps[0]}{zone}"
    else:  # across midnight
        day = SECONDS["d"]
        seconds[1:] += day * np.cumsum(np.diff(seconds) < -day / 2)
        sentence = (
            f"time of day, s from the first; it began at {first}, the date is not in the file"
        )
    seconds, cut = _growing(seconds, where)
    return Clock(seconds, stamps[0] if way else None, f"{sentence}{cut}")


def _iso(text: str, way: str) -> str:
    """Return a stamp in ISO 8601, by an order of its date's parts.

    Raises ValueError if it does not fit this order.
    """
    match = STAMP.fullmatch(text.strip())
    if match is None or (match[2] or "none") not in DATES.get(way, "none"):
        raise ValueError
    parts = {"year": "2000"}
    if match[1]:
        parts = dict(zip(re.split("[-./]", way), match.group(1, 3, 4), strict=False))
    hours = int(match[5] or 0)
    if match[9]:
        hours = hours % 12 + 12 * (match[9].upper() == "PM")
    fraction = f".{match[8]}" if match[8] else ""
    time = f"{hours:02d}:{match[6] or '00'}:{match[7] or '00'}{fraction}"
    zone = (match[10] or "").upper().replace("UTC", "Z")
    made = f"{parts['year']}-{parts.get('month', '1'):0>2}-{parts.get('day', '1'):0>2}T{time}{zone}"
    datetime.fromisoformat(made)
    return made


def clock_of_numbers(values: Array, name: str, where: Where, unit: str | None) -> Clock:
    """Return the clock of times as numbers.

    The unit of the times is the given one, or follows from the column's name or the numbers.

    Raises InputError if the times do not increase.
    """
    values = np.where(np.isfinite(values), values, np.nan)
    largest = float(np.max(values[_longest_growing(values)], initial=0.0))
    restarts = _restarts(values)
    # Unit: as specified, by the name, by the usual step of whole numbers, or by the size of times
    # since 1970.
    word, suffix = parted(name)
    how = " (as specified)" if unit else ""
    unit = unit or TIME_UNIT_OF_WORD.get(suffix.lower()) or TIME_UNIT_OF_WORD.get(word)
    if unit is None:
        steps = np.diff(values)
        finite = values[np.isfinite(values)]
        usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
        # Frames come every 10 ms to 10 s.
        counted = "us" if usual >= 10_000 else "ms"
        limit = EPOCH if counted == "ms" and not restarts[-1] else COUNTER
        if usual >= 10 and largest < limit and np.all(finite == np.round(finite)):
            unit = counted
            how = f" (guessed: whole numbers that grow by {usual:g}; --time-unit says otherwise)"
    if unit is None and _are_days(values):
        unit = "d"
    elif unit is None and largest >= EPOCH:  # 1.7e9 s, 1.7e12 ms, 1.7e15 us since 1970
        unit = ("s", "ms", "us", "ns")[min(int(np.log10(largest / EPOCH) // 3), 3)]
    scale = SECONDS[unit or "s"]
    if largest * scale >= EPOCH:
        days = DAYS_UNTIL_1970 if unit == "d" else 0.0
        first = _date_of((float(values[0]) - days) * scale, where(0))
        seconds, cut = _growing((values - values[0]) * scale, where)
        kind = "Excel's days" if days else f"{unit or 's'} since 1970"
        sentence = f"{kind}, s from the first, which is {first}{cut}"
        return Clock(seconds, first, sentence, unit or "s")
    wraps = restarts if unit in ("ms", "us") else 0 * restarts
    seconds, cut = _growing((values + COUNTER * wraps) * scale, where)
    times = "once" if wraps[-1] == 1 else f"{wraps[-1]} times"
    restarted = f"; the counter began again {times}" if wraps[-1] else ""
    sentence = f"{unit or 's (assumed; --time-unit says otherwise)'}{restarted}{how}{cut}"
    return Clock(seconds, None, sentence, unit or "s")


def _are_days(values: Array) -> bool:
    """Return whether times are days since 1899-12-30, as Excel has them: fractions, of this age."""
    finite = values[np.isfinite(values)]
    return bool(
        len(finite) > 1
        and np.all((finite > EXCEL_DAYS[0]) & (finite < EXCEL_DAYS[1]))
        and 0 < np.median(np.diff(finite)) < 1e-2
        and np.any(finite != np.round(finite))
    )


def _date_of(seconds: float, where: str) -> str:
    """Return the date and time of seconds since 1970, ISO 8601.

    Raises InputError with the place if there is none.
    """
    try:
        return datetime.fromtimestamp(seconds, UTC).isoformat().replace("+00:00", "Z")
    except (ValueError, OverflowError, OSError) as error:
        raise InputError(f"{where}: {seconds:.6g} s since 1970 is no date") from error


def _growing(seconds: Array, where: Where) -> tuple[Array, str]:
    """Return increasing times, and a sentence on those that are interpolated.

    The stamp of a cut line is missing, or does not fit its neighbours. A clock that begins again
    goes on. Raises InputError with the place of the first such stamp if their share exceeds
    MAX_CUT.
    """
    seconds, again = _continued(seconds, where)
    grow = _longest_growing(seconds)
    cut = np.flatnonzero(~grow)
    if len(cut) > MAX_CUT * len(seconds):
        bad = ~np.isfinite(seconds) | (np.diff(seconds, prepend=-np.inf) <= 0)
        raise InputError(
            f"{where(int(np.argmax(bad)))}: "
            "times must be finite and grow; `period` sets them instead"
        )
    if not len(cut):
        return seconds, again
    number = np.arange(len(seconds))
    growing = np.flatnonzero(grow)
    inner = np.interp(number, growing, seconds[growing])
    # before the first and after the last of them by the usual step
    usual = float(np.median(np.diff(seconds[growing]) / np.diff(growing))) if grow.sum() > 1 else 0
    inner += usual * (np.minimum(number - growing[0], 0) + np.maximum(number - growing[-1], 0))
    places = ", ".join(where(int(place)) for place in cut[:5]) + (", ..." if len(cut) > 5 else "")
    return inner, f"{again}; the time at {places} is missing or does not grow, and is interpolated"


def _continued(seconds: Array, where: Where) -> tuple[Array, str]:
    """Return times that go on by their usual step where a clock begins again, and a sentence.

    A board that resets counts from its start, and a frame's number wraps. A stretch of times that
    grow begins again if its first one is below the median of the stretch before; otherwise a stamp
    was wrong. Stamps between two stretches are missing.
    """
    grown = np.flatnonzero(np.isfinite(seconds))
    falls = np.flatnonzero(np.diff(seconds[grown]) <= 0) + 1
    stretches = [part for part in np.split(grown, falls) if len(part) >= MIN_STRETCH]
    if sum(map(len, stretches)) < (1 - MAX_CUT) * len(seconds):
        return seconds, ""
    begins = [
        int(later[0])
        for part, later in pairwise(stretches)
        if seconds[later[0]] < np.median(seconds[part])
    ]
    if not begins or len(begins) < len(stretches) - 1:
        return seconds, ""
    step = float(np.median(np.concatenate([np.diff(seconds[part]) for part in stretches])))
    continued = np.full(len(seconds), np.nan)
    end = seconds[stretches[0][0]] - step
    for part in stretches:
        continued[part] = seconds[part] - seconds[part[0]] + end + step
        end = continued[part[-1]]
    places = first_and_more([where(begin) for begin in begins])
    return continued, f"; it begins again at {places}, and goes on by its usual step"


def unwrapped(values: Array) -> Array:
    """Return numbers of a counter of 32 bits that go on where it began again."""
    return values + COUNTER * _restarts(values)


def _restarts(values: Array) -> Numbers:
    """Return how often a counter of 32 bits began again until each of its values."""
    with np.errstate(invalid="ignore"):  # of two infinite numbers
        return np.cumsum(np.diff(values, prepend=values[:1]) < -COUNTER / 2)


def grows(values: Array) -> bool:
    """Return whether numbers increase, but for the few that cut lines may have."""
    return bool(np.mean(_longest_growing(values)) >= 1 - MAX_CUT)


def _longest_growing(values: Array) -> Mask:
    """Return the longest increasing subsequence of values, boolean (n,).

    If several are equally long, the last one is returned.
    """
    ends = list[float]()
    numbers = list[int]()
    before = list[int]()
    for number, value in enumerate(values.tolist()):
        if not np.isfinite(value):
            before.append(-1)
            continue
        length = bisect_left(ends, value)
        before.append(numbers[length - 1] if length else -1)
        ends[length : length + 1] = [value]
        numbers[length : length + 1] = [number]
    chosen = np.zeros(len(values), dtype=bool)
    number = numbers[-1] if numbers else -1
    while number >= 0:
        chosen[number] = True
        number = before[number]
    return chosen
