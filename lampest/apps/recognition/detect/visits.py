"""Visits over all recordings of a season; counts and a picture.

Visits are one row for each attachment, with clock times.
"""

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from math import floor, hypot, inf, isnan, log10
from pathlib import Path
from typing import Any

from lampest.apps.recognition.detect.answer import ERRORS, LAMPREY, PAIRS, SUCKS, Detected
from lampest.files import hdf5
from lampest.files.errors import InputError
from lampest.files.whole import refuse_inputs, sparing, whole_file, write_whole
from lampest.report.compare import Table, comma_separated
from lampest.report.export.formats import Export, write_matlab, write_parquet

FILE = "visits.csv"
PICTURE = "visits.png"
KINDS = ("csv", "parquet", "mat")  # of files to which visits are exported
DAY_HOURS = (6, 18)  # of the clock: from the first on and before the second it is day
REVISIT_H = 24.0  # between the end of a visit and one that may be by the same animal
HOUR_S = 3600.0
WITHOUT_CLOCK = "without a clock"
ALIKE = 2.0  # standard deviations of the difference of the diameters of one animal
COLUMNS = {
    "visit": "number of the visit, in the order of time",
    "recording": "name of the recording",
    "answer": "lamprey, sucks, suction cup or presses",
    "probability": "probability of the answer",
    "begin": "date and time of the arrival, by the clock of the recording; empty where it has none",
    "begin_s": "arrival after the begin of the recording, s",
    "duration_s": "s; of a visit that lasts to the end of the recording until that end",
    "left": "whether it left before the recording ended: yes or no",
    "x_mm": "centre across the columns, mm",
    "y_mm": "centre across the rows, mm",
    "diameter_mm": "outer diameter, mm",
    "diameter_sd_mm": "its standard deviation, mm",
    "suction_kpa": "typical suction at rest, kPa",
    "suction_sd_kpa": "its standard deviation, kPa",
    "strongest_kpa": "strongest suction, kPa",
    "strongest_sd_kpa": "its standard deviation, kPa",
    "breathing_hz": "rate of breathing, Hz",
    "breathing_depth": "relative amplitude of the suction by breathing",
    "pumps": "number of times that the suction was pumped up; empty where it was not observed",
    "pump_interval_s": "mean time between pumps, s",
    "may_be_visit": "number of the earlier visit that may be by the same animal",
    "why": "why the answer is no more specific",
}


@dataclass(frozen=True)
class Visit:
    """One visit; the attributes are the columns of visits.csv, None where they are not known.

    >>> from lampest.apps.recognition.detect.visits import Visit
    >>> Visit("mine", "lamprey", 0.98, 12.0, 60.0).begin is None
    True
    """

    recording: str
    answer: str
    probability: float
    begin_s: float
    duration_s: float | None
    begin: str | None = None
    left: str = "no"
    visit: int = 0
    x_mm: float | None = None
    y_mm: float | None = None
    diameter_mm: float | None = None
    diameter_sd_mm: float | None = None
    suction_kpa: float | None = None
    suction_sd_kpa: float | None = None
    strongest_kpa: float | None = None
    strongest_sd_kpa: float | None = None
    breathing_hz: float | None = None
    breathing_depth: float | None = None
    pumps: int | None = None
    pump_interval_s: float | None = None
    may_be_visit: int | None = None
    why: str | None = None

    @property
    def clock(self) -> datetime | None:
        """Date and time of the arrival."""
        return None if self.begin is None else datetime.fromisoformat(self.begin)

    @property
    def row(self) -> list[object]:
        """Values in the order of COLUMNS."""
        return [getattr(self, name) for name in COLUMNS]


def visits_of(answers: Iterable[Detected]) -> list[Visit]:
    """Return the visits of all recordings, numbered in the order of time."""
    visits = list[Visit]()
    for answer in answers:
        loads = answer.content()["attachments"]
        visits += rows_of(answer.recording, loads, answer.start_time, answer.end_s)
    return numbered(visits)


def numbered(rows: Iterable[Visit]) -> list[Visit]:
    """Return visits with their numbers in the order of time, and with possible earlier ones.

    An earlier visit may be by the same animal. Visits of recordings without a clock come last.
    """
    ordered = sorted(rows, key=_since_epoch)
    counted = [replace(visit, visit=number) for number, visit in enumerate(ordered, 1)]
    earlier = _earlier(counted)
    return [replace(visit, may_be_visit=earlier.get(visit.visit)) for visit in counted]


def _since_epoch(visit: Visit) -> float:
    """Return the time of arrival in s, infinite without a clock.

    Times without a zone are of the clock of this computer.
    """
    return inf if visit.clock is None else visit.clock.timestamp()


def rows_of(
    recording: str, loads: Sequence[dict[str, Any]], begin: str | None, end: float | None
) -> list[Visit]:
    """Return the visits of one recording, without numbers.

    Parameters
    ----------
    recording : str
    loads : sequence of dict
        Attachments as in `Detected.content`.
    begin : str or None
        Date and time at 0 s.
    end : float or None
        Time of the last frame, s.
    """
    visits = list[Visit]()
    for load in loads:
        since = load["since_s"]
        until = load["until_s"]
        stop = end if until is None else until
        numbers = dict[str, Any]()
        for name in PAIRS.keys() & COLUMNS:
            stem, _, unit = name.rpartition("_")
            if unit != "kpa" or load["sucks"] > 0.5:
                numbers |= zip((name, f"{stem}_sd_{unit}"), _significant(load[name]), strict=True)
        visits.append(
            Visit(
                recording=recording,
                answer=load["answer"],
                probability=load["probability"],
                begin_s=since,
                duration_s=None if stop is None else round(max(stop - since, 0.0), 3),
                begin=_clock(begin, since),
                left="no" if until is None else "yes",
                pumps=None if load["pump_count"] is None else int(load["pump_count"]),
                pump_interval_s=load["pump_interval_s"],
                why=load["why"] or None,
                **{name: numbers[name] for name in numbers.keys() & COLUMNS},
            )
        )
    return visits


def _significant(pair: tuple[float, float] | None) -> tuple[float | None, float | None]:
    """Return a value and its standard deviation, rounded to two digits of the latter."""
    if pair is None:
        return None, None
    value, sd = pair
    if not 0 < sd < inf:
        return value, sd
    decimals = 1 - floor(log10(sd))
    return round(value, decimals), round(sd, decimals)


def _clock(start: str | None, seconds: float) -> str | None:
    """Return the date and time that many seconds after the start, to a tenth of a second.

    The result is None without a start.
    """
    if not start:
        return None
    try:
        begin = datetime.fromisoformat(start)
    except ValueError:
        return None
    return (begin + timedelta(seconds=round(seconds, 1))).isoformat(timespec="milliseconds")


def _earlier(visits: Sequence[Visit]) -> dict[int, int]:
    """Return the number of the earlier visit that each visit of a lamprey may continue.

    Diameters are about the same within ALIKE standard deviations of their difference. A visit that
    may be of several animals continues none. Visits that continue each other are of one animal,
    which has to have left. Without a clock only visits of one recording are compared.
    """
    animals = list[list[Visit]]()
    earlier = dict[int, int]()
    for visit in visits:
        if visit.answer != LAMPREY or visit.diameter_mm is None or not visit.diameter_sd_mm:
            continue
        alike = [animal for animal in animals if _may_return(animal, visit)]
        if len(alike) == 1:
            earlier[visit.visit] = alike[0][-1].visit
            alike[0].append(visit)
        else:
            animals.append([visit])
    return earlier


def _may_return(animal: Sequence[Visit], visit: Visit) -> bool:
    """Return whether a visit may be of an animal with earlier visits: its size, and the pause."""
    last = animal[-1]
    if last.left == "no" or last.duration_s is None:
        return False
    if last.begin is not None and visit.begin is not None:
        between_s = _since_epoch(visit) - _since_epoch(last)
    elif last.recording == visit.recording:
        between_s = visit.begin_s - last.begin_s
    else:
        return False
    return 0 <= between_s - last.duration_s < REVISIT_H * HOUR_S and all(
        abs((visit.diameter_mm or 0.0) - (other.diameter_mm or 0.0))
        < ALIKE * hypot(visit.diameter_sd_mm or 0.0, other.diameter_sd_mm or 0.0)
        for other in animal
    )


def write_visits(path: Path, visits: Sequence[Visit]) -> None:
    """Write one row for each visit as CSV atomically.

    Raises InputError where the place cannot be written.
    """
    write_whole(path, comma_separated([COLUMNS, *(visit.row for visit in visits)]))


def count_table(answers: Sequence[Detected], visits: Sequence[Visit]) -> Table:
    """Return the certain and the possible visits of lampreys of each day.

    Visits are counted by day and by night, and per recorded hour. Recordings without a clock are
    one row.
    """
    hours = defaultdict[tuple[str, bool], float](float)
    for answer in answers:
        for when, seconds in _recorded(answer):
            hours[when] += seconds / HOUR_S
    counts = Counter((_day_or_night(visit.clock), visit.answer) for visit in visits)
    rows = []
    for day in sorted({day for day, _ in hours}):
        cells = [day]
        for night in (False, True):
            recorded = hours[day, night]
            lampreys = counts[(day, night), LAMPREY]
            rate = f"{lampreys / recorded:.2g}" if recorded > 0 else ""
            unsure = counts[(day, night), SUCKS]
            cells += [f"{recorded:.2g}", str(lampreys), str(unsure), rate]
        rows.append(tuple(cells))
    first, last = DAY_HOURS
    heads = ["day"]
    for part in (f"{first}–{last} h", f"{last}–{first} h"):
        for text in ("recorded [h]", "lampreys", "unsure", "lampreys an hour"):
            heads.append(f"{part} {text}")
    return Table(tuple(heads), tuple(rows), title="visits by day and by night")


def _recorded(answer: Detected) -> Iterable[tuple[tuple[str, bool], float]]:
    """Generate the day, whether it is night, and the seconds of each recorded hour.

    A recorded hour is one that a recording covers.
    """
    remaining = answer.end_s or 0.0
    begin = _clock(answer.start_time, 0.0)
    if begin is None:
        yield _day_or_night(None), remaining
        return
    clock = datetime.fromisoformat(begin)
    while remaining > 0:
        next_hour = (clock + timedelta(hours=1)).replace(minute=0, second=0, microsecond=0)
        part = min((next_hour - clock).total_seconds(), remaining)
        yield _day_or_night(clock), part
        clock = next_hour
        remaining = remaining - part


def _day_or_night(clock: datetime | None) -> tuple[str, bool]:
    """Return the day, and whether the time is outside of DAY_HOURS; without a clock it is not."""
    if clock is None:
        return WITHOUT_CLOCK, False
    return clock.date().isoformat(), not DAY_HOURS[0] <= clock.hour < DAY_HOURS[1]


def visits_in(path: Path) -> list[Visit]:
    """Return the visits of a file of detections.

    Raises InputError where it is none or is damaged.
    """
    visits = list[Visit]()
    with hdf5.existing_file(path) as file:
        names = hdf5.children(file, "entry", object)
        groups = {name: f"entry/{name}" for name in names}
        for name in sorted(names, key=lambda name: hdf5.read_number(file, groups[name], "order")):
            begin = str(hdf5.read_attribute(file, groups[name], "start_time"))
            end = float(hdf5.read_attribute(file, groups[name], "end_s"))
            table = f"{groups[name]}/attachments"
            loads = _stored_loads(file, table) if hdf5.has(file, table) else []
            visits += rows_of(name, loads, begin, None if isnan(end) else end)
    return numbered(visits)


def _stored_loads(file: Any, group: str) -> list[dict[str, Any]]:
    """Return the attachments of a table of `write_detections` as in `Detected.content`."""
    count = hdf5.length_of(file, f"{group}/answer")
    columns = dict[str, list[Any]]()
    for name in hdf5.children(file, group):
        if name in ("answer", "why"):
            columns[name] = list(hdf5.read_texts(file, f"{group}/{name}", count))
        else:
            values = hdf5.read_array(file, f"{group}/{name}", 1).tolist()
            columns[name] = [None if isnan(value) else value for value in values]
    for name in [name for name in columns if f"{name}{ERRORS}" in columns]:
        pairs = zip(columns[name], columns.pop(f"{name}{ERRORS}"), strict=True)
        columns[name] = [None if value is None else (value, sd) for value, sd in pairs]
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def export_visits(path: Path, to: str | Export, out: str | Path | None) -> Path:
    """Write the visits of a file of detections in a format, atomically; return the file.

    Raises InputError for a damaged file, a format that has no table, or a place that cannot be
    written.
    """
    kind = to if isinstance(to, str) else to.kind
    if kind not in KINDS:
        raise InputError(f"{path}: visits are exported as {', '.join(KINDS)}, not as {kind}")
    target = path.with_name(f"visits.{kind}") if out is None else Path(out)
    with sparing((path,)):
        refuse_inputs((target,))
        visits = visits_in(path)
        columns = {name: [getattr(visit, name) for visit in visits] for name in COLUMNS}
        with whole_file(target) as unfinished:
            if kind == "csv":
                rows = zip(*columns.values(), strict=True)
                unfinished.write_text(comma_separated([COLUMNS, *rows]), encoding="utf-8")
            elif kind == "parquet":
                write_parquet(unfinished, columns, COLUMNS)
            else:
                write_matlab(unfinished, "visits", columns)
    return target
