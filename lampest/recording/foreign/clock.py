"""When frames were taken: seconds, a board's milliseconds, stamps with date and zone, a clock's time of day."""

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import UTC, datetime

import numpy as np

from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.recording.foreign.frames import Clock
from lampest.recording.foreign.words import Numerals, bracketed

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
WORDS = {
    "s": "s sec secs second seconds sekunde sekunden",
    "ms": "ms milli millis millisecond milliseconds msec",
    "us": "us µs μs micro micros microsecond microseconds usec",
    "ns": "ns nanosecond nanoseconds",
    "min": "min minute minutes",
    "h": "h hour hours",
}
UNIT_OF_WORD = {word: unit for unit, words in WORDS.items() for word in words.split()}
EPOCH = 1e9  # s since 1970 begin there, in 2001; a board's own clock would have run for thirty years
COUNTER = 2.0**32  # where millis() and micros() of an Arduino begin again
DAY = 86400.0
LONG_STEP = 10.0  # s between frames: whole numbers that grow faster may be milliseconds
LONGEST_MILLIS = 10_000.0  # between frames: 10 s as milliseconds, 10 ms as microseconds; panels are read in between
TIME_OF_DAY = re.compile(r"(\d{1,2}):(\d{2})(?::(\d{2}(?:[.,:]\d+)?))?")
STAMPS = {
    "year-month-day": re.compile(r"(?P<y>\d{4})[-/.](?P<m>\d{1,2})[-/.](?P<d>\d{1,2})"),
    "day.month.year": re.compile(r"(?P<d>\d{1,2})\.(?P<m>\d{1,2})\.(?P<y>\d{4})"),
    "day/month/year": re.compile(r"(?P<d>\d{1,2})[/-](?P<m>\d{1,2})[/-](?P<y>\d{4})"),
    "month/day/year": re.compile(r"(?P<m>\d{1,2})[/-](?P<d>\d{1,2})[/-](?P<y>\d{4})"),
}
AFTERNOON = re.compile(r"(?<!\d)(\d{1,2})(:\d{2}(?::\d{2}(?:[.,]\d+)?)?)\s*([AP])M\b", re.IGNORECASE)
REST = re.compile(r"(?:[T ,]+(?P<t>\d{1,2}:\d{2}(?::\d{2}(?:[.,:]\d+)?)?)\s*(?P<z>Z|UTC|[+-]\d{2}:?\d{2})?)?", re.I)

Where = Callable[[int], str]


def is_stamp(text: str) -> bool:
    """Whether a text is a date, a time of day, or both."""
    text = _of_24_hours(text)
    return TIME_OF_DAY.fullmatch(text.strip()) is not None or any(_matches(text, way) for way in STAMPS)


def clock_of(texts: Sequence[str], name: str, where: Where, numerals: Numerals) -> Clock:
    """Times of frames from the texts of a column or of stamps before lines; `where` names the place of each.

    Raises InputError where one is no time, where dates can be read in two ways, and where times do not grow.
    """
    if all(not text or numerals.is_number(text) for text in texts):
        values, _, _ = numerals.numbers(np.array(texts, dtype=object))
        return clock_of_numbers(values, name, where)
    texts = [_of_24_hours(text) for text in texts]
    if any(TIME_OF_DAY.fullmatch(text.strip()) for text in texts):
        seconds = np.array([_of_day(text, where(number)) for number, text in enumerate(texts)])
        seconds = seconds + DAY * np.cumsum(np.diff(seconds, prepend=seconds[0]) < -DAY / 2)
        sentence = f"time of day, s from the first; it began at {texts[0].strip()}, the date is not in the file"
        return Clock(_growing(seconds - seconds[0], where), None, sentence)
    return _of_stamps(texts, where)


def clock_of_numbers(values: Array, name: str, where: Where) -> Clock:
    """Times of numbers in the unit that the column's name says, or in s. Raises InputError where they do not grow."""
    _check_growth(np.where(np.isfinite(values), np.arange(len(values)), np.nan), where)
    unit = unit_of_time(name) or _unit_of_counter(values)
    scale = SECONDS[unit or "s"]
    largest = float(np.max(values, initial=0.0)) * scale
    if unit is None and largest >= EPOCH:  # 1.7e9 s, 1.7e12 ms, 1.7e15 us since 1970
        unit = ("s", "ms", "us", "ns")[min(int(np.log10(largest / EPOCH) // 3), 3)]
        scale = SECONDS[unit]
        largest *= scale
    if largest >= EPOCH:
        first = _utc(float(values[0]) * scale, where(0))
        seconds = _growing((values - values[0]) * scale, where)
        return Clock(seconds, f"{first}", f"{unit or 's'} since 1970, s from the first, which is {first}")
    wraps = np.cumsum(np.diff(values, prepend=values[0]) < -COUNTER / 2) if unit in ("ms", "us") else 0 * values
    seconds = _growing((values + COUNTER * wraps) * scale, where)
    if unit is not None:
        often = "once" if wraps[-1] == 1 else f"{int(wraps[-1])} times"
        return Clock(seconds, None, f"{unit}; the counter began again {often}" if wraps[-1] else unit)
    step = float(np.median(np.diff(seconds))) if len(seconds) > 1 else 0.0
    slow = step >= LONG_STEP and bool(np.all(values == np.round(values)))
    doubt = f", so that frames are {step:g} s apart; if these are ms, call the column time_ms" if slow else ""
    return Clock(seconds, None, f"s, assumed{doubt}")


def unit_of_time(name: str) -> str | None:
    """'s', 'ms', 'us', 'ns', 'min' or 'h' where a column's name or its bracket says it."""
    parts = re.split(r"[\s_\-\[\](){}/.,]+", name.lower().strip())
    words = (bracketed(name).lower(), *reversed(parts))
    return next((UNIT_OF_WORD[word] for word in words if word in UNIT_OF_WORD), None)


def _unit_of_counter(values: Array) -> str | None:
    """'ms' or 'us', by its steps, of a nameless board's counter that begins again; None of other numbers."""
    steps = np.diff(values)
    if not np.any(steps < -COUNTER / 2) or np.any(values != np.round(values)) or np.max(values) >= COUNTER:
        return None
    return "ms" if np.median(steps) < LONGEST_MILLIS else "us"


def _growing(seconds: Array, where: Where) -> Array:
    _check_growth(seconds, where)
    return seconds


def _check_growth(seconds: Array, where: Where) -> None:
    """Raise InputError with the place of the first time that is not finite, or not after the one before."""
    bad = ~np.isfinite(seconds) | (np.diff(seconds, prepend=-np.inf) <= 0)
    if np.any(bad):
        raise InputError(f"{where(int(np.argmax(bad)))}: times must be finite and grow; --period sets them instead")


def _utc(seconds: float, where: str) -> str:
    """Seconds since 1970 as date and time, ISO 8601."""
    try:
        return f"{datetime.fromtimestamp(round(seconds, 6), UTC).replace(tzinfo=None).isoformat()}Z"
    except (ValueError, OverflowError, OSError) as error:
        raise InputError(f"{where}: {seconds:.6g} s since 1970 is no date") from error


def _of_day(text: str, where: str) -> float:
    match = TIME_OF_DAY.fullmatch(text.strip())
    if match is None:
        raise InputError(f"{where}: {text[:40]!r} is no time of day")
    hours, minutes, seconds = match.groups()
    return 3600.0 * int(hours) + 60.0 * int(minutes) + float((seconds or "0").replace(",", ".").replace(":", "."))


def _of_24_hours(text: str) -> str:
    """1:05 PM → 13:05, wherever it stands in a text."""
    return AFTERNOON.sub(lambda said: f"{int(said[1]) % 12 + 12 * (said[3] in 'pP'):02d}{said[2]}", text)


def _matches(text: str, way: str) -> re.Match[str] | None:
    date = STAMPS[way].match(text.strip())
    return date if date and REST.fullmatch(text.strip(), date.end()) else None


def _of_stamps(texts: Sequence[str], where: Where) -> Clock:
    """By the one order of day and month that fits all texts."""
    ways: dict[str, list[datetime]] = {}
    for way in STAMPS:
        with suppress(ValueError):  # of a text that is no date in this order
            ways[way] = [datetime.fromisoformat(_iso(text, way)) for text in texts]
    if not ways:
        wrong = next((number for number, text in enumerate(texts) if not is_stamp(text)), 0)
        raise InputError(f"{where(wrong)}: {texts[wrong][:40]!r} is no time")
    if len(ways) > 1 and len({tuple(times) for times in ways.values()}) > 1:
        raise InputError(f"{where(0)}: {texts[0][:40]!r} may be {' or '.join(ways)}; write year-month-day")
    way, times = next(iter(ways.items()))
    times = [time if time.tzinfo else time.replace(tzinfo=UTC) for time in times]
    seconds = np.array([(time - times[0]).total_seconds() for time in times])
    start = _iso(texts[0], way)
    zone = "" if re.search(r"(Z|[+-]\d{2}:?\d{2})$", start) else ", no zone in the file"
    return Clock(_growing(seconds, where), start, f"{way}, s from the first, which is {start}{zone}")


def _iso(text: str, way: str) -> str:
    """A stamp in ISO 8601, nothing where it is none."""
    date = _matches(text, way)
    if date is None:
        return ""
    rest = REST.fullmatch(text.strip(), date.end())
    assert rest is not None
    hours, minutes, *seconds = re.split("[:.,]", rest["t"] or "00:00")
    clock = f"{int(hours):02d}:{minutes}:{'.'.join(seconds or ['00'])}"
    zone = (rest["z"] or "").upper().replace("UTC", "Z")
    return f"{int(date['y']):04d}-{int(date['m']):02d}-{int(date['d']):02d}T{clock}{zone}"
