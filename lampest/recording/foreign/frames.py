"""What every kind of foreign file is turned into: frames, and when they were taken.

Times are seconds, a board's milliseconds, stamps with date and zone, or a clock's time of day.
"""

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.recording.foreign.words import Numerals, bracketed

MOST_BYTES = 500_000_000  # of a file, of what it unpacks to, and of its values in memory
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
TIME = r"\d{1,2}:\d{2}(?::\d{2}(?:[.,:]\d+)?)?"
TIME_OF_DAY = re.compile(TIME)
STAMPS = {
    "year-month-day": re.compile(r"(?P<y>\d{4})[-/.](?P<m>\d{1,2})[-/.](?P<d>\d{1,2})"),
    "day.month.year": re.compile(r"(?P<d>\d{1,2})\.(?P<m>\d{1,2})\.(?P<y>\d{4})"),
    "day/month/year": re.compile(r"(?P<d>\d{1,2})[/-](?P<m>\d{1,2})[/-](?P<y>\d{4})"),
    "month/day/year": re.compile(r"(?P<m>\d{1,2})[/-](?P<d>\d{1,2})[/-](?P<y>\d{4})"),
}
AFTERNOON = re.compile(r"(?<!\d)(\d{1,2})(:\d{2}(?::\d{2}(?:[.,]\d+)?)?)\s*([AP])M\b", re.IGNORECASE)
REST = re.compile(rf"(?:[T ,]+(?P<t>{TIME})\s*(?P<z>Z|UTC|[+-]\d{{2}}:?\d{{2}})?)?", re.IGNORECASE)

Place = Callable[[int, int, int], str]
Where = Callable[[int], str]


@dataclass(frozen=True, eq=False)
class Clock:
    """Times of frames in s; date and time of the first one, ISO 8601, where the file names it; a sentence on both."""

    seconds: Array
    start: str | None
    sentence: str

    def said(self, where: str) -> "Clock":
        """The same with where the times stand in the file."""
        return replace(self, sentence=f"time: {where}{self.sentence}")


@dataclass(frozen=True, eq=False)
class Frames:
    """Which numbers of a file are the readings of which cells, and what else it says.

    numbers : all that the file holds, in any unit and order; NaN where one is missing, infinite where it says so.
    number : (frames, rows, columns) index into them; -1: the file has none for the cell.
    named : index → where in the file; -1 → the file.
    timing : when the frames were taken, or raises InputError; None where the file has no times.
    notes : sentences on how it was understood. words : names of columns or arrays in which the unit may stand.
    """

    numbers: Array
    number: NDArray[np.intp]
    named: Callable[[int], str]
    timing: Callable[[], Clock] | None
    notes: tuple[str, ...]
    words: tuple[str, ...] = ()

    @property
    def values(self) -> Array:
        """(frames, rows, columns) in the file's unit."""
        values = np.asarray(self.numbers[self.number], dtype=float)
        values[self.number < 0] = np.nan
        return values

    def place(self, frame: int, row: int, column: int) -> str:
        """Where in the file a reading stands."""
        number = int(self.number[frame, row, column])
        return self.named(number) if number >= 0 else f"{self.named(-1)}: row {row}, column {column} of frame {frame}"

    def arranged(self, number: NDArray[np.intp], note: str) -> "Frames":
        """The same numbers as those of other cells, and a sentence on that."""
        return replace(self, number=number, notes=(*self.notes, note))


def check_count(where: object, values: int) -> None:
    """Raise InputError where a file claims more values than are imported."""
    if 8 * values > MOST_BYTES:
        raise InputError(f"{where}: {values} values, more than {MOST_BYTES // 8} are not imported")


def refuse_where(bad: NDArray[np.bool_], values: Array, place: Place, why: str) -> None:
    """Raise InputError with the place of the first bad value, the value, and `why`."""
    if np.any(bad):
        frame, row, column = (int(part) for part in np.argwhere(bad)[0])
        raise InputError(f"{place(frame, row, column)}: {values[frame, row, column]:.6g} {why}")


def is_stamp(text: str) -> bool:
    """Whether a text is a date, a time of day, or both."""
    text = _of_24_hours(text)
    return TIME_OF_DAY.fullmatch(text) is not None or any(_iso(text, way) for way in STAMPS)


def clock_of(texts: Sequence[str], name: str, where: Where, numerals: Numerals) -> Clock:
    """Times of frames from the texts of a column or of stamps before lines; `where` names the place of each.

    Raises InputError where one is no time, where dates can be read in two ways, and where times do not grow.
    """
    if all(map(numerals.is_number, texts)):
        values, _, _ = numerals.numbers(np.array(texts, dtype=object))
        return clock_of_numbers(values, name, where)
    texts = [_of_24_hours(text) for text in texts]
    if not any(map(TIME_OF_DAY.fullmatch, texts)):
        return _of_stamps(texts, where)
    seconds = np.array([_of_day(text, where(number)) for number, text in enumerate(texts)])
    day = 24 * SECONDS["h"]
    seconds = seconds + day * np.cumsum(np.diff(seconds, prepend=seconds[0]) < -day / 2)
    sentence = f"time of day, s from the first; it began at {texts[0]}, the date is not in the file"
    return Clock(_growing(seconds - seconds[0], where), None, sentence)


def clock_of_numbers(values: Array, name: str, where: Where) -> Clock:
    """Times of numbers in the unit that the column's name says, or in s. Raises InputError where they do not grow."""
    _growing(np.where(np.isfinite(values), np.arange(len(values)), np.nan), where)
    counter = float(2**32)  # where millis() and micros() of an Arduino begin again
    steps = np.diff(values, prepend=values[0])
    whole, again = bool(np.all(values == np.round(values))), np.cumsum(steps < -counter / 2)
    unit = unit_of_time(name)
    if unit is None and again[-1] and whole and np.max(values) < counter:  # a nameless board's counter
        # Panels are read more often than every 10 s, so that larger steps are of a smaller unit.
        unit = "ms" if np.median(steps[1:]) < 10 / SECONDS["ms"] else "us"
    largest = float(np.max(values)) * SECONDS[unit or "s"]
    if unit is None and largest >= EPOCH:  # 1.7e9 s, 1.7e12 ms, 1.7e15 us since 1970
        unit = ("s", "ms", "us", "ns")[min(int(np.log10(largest / EPOCH) // 3), 3)]
        largest *= SECONDS[unit]
    scale = SECONDS[unit or "s"]
    if largest >= EPOCH:
        first = _utc(float(values[0]) * scale, where(0))
        seconds = _growing((values - values[0]) * scale, where)
        return Clock(seconds, first, f"{unit or 's'} since 1970, s from the first, which is {first}")
    if unit not in ("ms", "us"):
        again[:] = 0
    seconds = _growing((values + counter * again) * scale, where)
    if unit is not None:
        often = "once" if again[-1] == 1 else f"{int(again[-1])} times"
        return Clock(seconds, None, f"{unit}; the counter began again {often}" if again[-1] else unit)
    step = float(np.median(np.diff(seconds))) if len(seconds) > 1 else 0.0
    doubt = f", so that frames are {step:g} s apart; if these are ms, call the column time_ms"
    return Clock(seconds, None, f"s, assumed{doubt if step >= 10 and whole else ''}")


def unit_of_time(name: str) -> str | None:
    """'s', 'ms', 'us', 'ns', 'min' or 'h' where a column's name or its bracket says it."""
    parts = re.split(r"[\s_\-\[\](){}/.,]+", name.lower().strip())
    words = (bracketed(name).lower(), *reversed(parts))
    return next((UNIT_OF_WORD[word] for word in words if word in UNIT_OF_WORD), None)


def _growing(seconds: Array, where: Where) -> Array:
    """Raise InputError with the place of the first time that is not finite, or not after the one before."""
    bad = ~np.isfinite(seconds) | (np.diff(seconds, prepend=-np.inf) <= 0)
    if np.any(bad):
        raise InputError(f"{where(int(np.argmax(bad)))}: times must be finite and grow; --period sets them instead")
    return seconds


def _utc(seconds: float, where: str) -> str:
    try:
        return f"{datetime.fromtimestamp(seconds, UTC).replace(tzinfo=None).isoformat()}Z"
    except (ValueError, OverflowError, OSError) as error:
        raise InputError(f"{where}: {seconds:.6g} s since 1970 is no date") from error


def _of_day(text: str, where: str) -> float:
    if TIME_OF_DAY.fullmatch(text) is None:
        raise InputError(f"{where}: {text[:40]!r} is no time of day")
    hours, minutes, *seconds = re.split("[:.,]", text)
    return 3600.0 * int(hours) + 60.0 * int(minutes) + float(".".join(seconds or ["0"]))


def _of_24_hours(text: str) -> str:
    """1:05 PM → 13:05, wherever it stands in a text."""
    return AFTERNOON.sub(lambda said: f"{int(said[1]) % 12 + 12 * (said[3] in 'pP'):02d}{said[2]}", text).strip()


def _of_stamps(texts: Sequence[str], where: Where) -> Clock:
    """By the one order of day and month that fits all texts."""
    ways: dict[str, list[datetime]] = {}
    for way in STAMPS:
        with suppress(ValueError):  # of a text that is no date in this order
            ways[way] = [datetime.fromisoformat(_iso(text, way)) for text in texts]
    if not ways:
        wrong = next((number for number, text in enumerate(texts) if not is_stamp(text)), 0)
        raise InputError(f"{where(wrong)}: {texts[wrong][:40]!r} is no time")
    if len({tuple(times) for times in ways.values()}) > 1:
        raise InputError(f"{where(0)}: {texts[0][:40]!r} may be {' or '.join(ways)}; write year-month-day")
    way, times = next(iter(ways.items()))
    zone = "" if times[0].tzinfo else ", no zone in the file"
    times = [time if time.tzinfo else time.replace(tzinfo=UTC) for time in times]
    seconds = np.array([(time - times[0]).total_seconds() for time in times])
    start = _iso(texts[0], way)
    return Clock(_growing(seconds, where), start, f"{way}, s from the first, which is {start}{zone}")


def _iso(text: str, way: str) -> str:
    """A stamp in ISO 8601, nothing where it is none."""
    date = STAMPS[way].match(text)
    rest = date and REST.fullmatch(text, date.end())
    if not date or not rest:
        return ""
    hours, minutes, *seconds = re.split("[:.,]", rest["t"] or "00:00")
    clock = f"{int(hours):02d}:{minutes}:{'.'.join(seconds or ['00'])}"
    zone = (rest["z"] or "").upper().replace("UTC", "Z")
    return f"{int(date['y']):04d}-{int(date['m']):02d}-{int(date['d']):02d}T{clock}{zone}"
