"""Division of the lines of a table into frames, by the marks that the table itself shows."""

from collections import Counter
from collections.abc import Hashable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise, repeat
from math import inf, nan

import numpy as np

from lampest.apps.foreign.arrays import Frames, Shape, check_count
from lampest.apps.foreign.breaks import whole_parts
from lampest.apps.foreign.clocks import seconds_of
from lampest.apps.foreign.layouts import TableLayout, arranged
from lampest.apps.foreign.segments import (
    ANY,
    MIN_SHARE,
    FrameEnds,
    LineKeys,
    Placed,
    Segmenter,
    alternate,
    are_whole,
    changes_of,
    few_values,
    placed,
    scan_order,
    several_sources,
    unused_note,
)
from lampest.apps.foreign.table import ReadingsTable, kind_of
from lampest.files.errors import InputError, counted, first_and_more
from lampest.panel.panel import Array, Mask, Numbers

MIN_PAUSE = 1.5  # times the steps of the time within a frame that the step between frames is
MAX_REMARKS = 5  # on single frames


def line_keys(table: ReadingsTable, arrangement: TableLayout, ends: FrameEnds) -> list[LineKeys]:
    """Return the keys by which the lines of a table end frames."""
    positions = arrangement.positions(table)
    texts = {"time": [""] * len(table.lines), **_key_texts(table, arrangement)}
    shared: Iterable[Hashable] = repeat(None)
    if ends.shared:
        of_lines = zip(*(texts[key] for key in ends.shared), strict=True)
        shared = (line if all(line) else None for line in of_lines)
    seconds: Iterable[float] = repeat(nan)
    if ends.max_step < inf:
        seconds = (seconds_of(text, comma=table.comma) for text in texts["time"])
    places = repeat(-1) if positions is None else positions.tolist()
    return list(map(LineKeys, shared, places, _marked(table, ends.titles), seconds))


def frames_of(table: ReadingsTable, shape: Shape) -> Frames:
    """Return the frames of a table.

    The layout is found by its header and by the number of fields of its lines.

    Raises InputError if these do not determine the layout, or if the table does not fit the panel.
    """
    table, arrangement = arranged(table, shape)
    table = _without_doubled(_with_merged_keys(table, arrangement), arrangement)
    table = _without_swapped(table, arrangement)
    grouped = _grouped_by_name(table, arrangement)
    ends = learned_ends(table, arrangement) if grouped is None else FrameEnds(1)
    groups, notes = grouped or _divided(table, arrangement, ends)
    _refuse_two_sources(table, arrangement, groups)
    begins = [group.begin for group in groups]
    timing = table.timing(table.times(arrangement.times, begins, ends.title), begins)
    unused = [
        unused_note(table.names[at], values) for at, values in _categories(table, arrangement)
    ]
    rows, columns = shape
    check_count(table.source.source, len(groups) * rows * columns)
    # line · width + field of each reading; -1 where it is missing
    number = np.full((len(groups), rows * columns), -1)
    frame = np.repeat(np.arange(len(groups)), [len(group.lines) for group in groups])
    lines = np.array([line for group in groups for line in group.lines], dtype=np.intp)
    positions = np.array([at for group in groups for at in group.positions], dtype=np.intp)
    begin = positions * (rows * columns // arrangement.lines)
    fields, places = arrangement.places
    number[frame[:, None], begin[:, None] + places] = lines[:, None] * table.width + fields
    return table.frames(
        number.reshape(-1, rows, columns),
        sorted(arrangement.cells),
        timing,
        ["; ".join([arrangement.note, *notes]), *unused],
    )


def learned_ends(table: ReadingsTable, arrangement: TableLayout) -> FrameEnds:
    """Return what says in a table where frames end.

    A number, a time or a title counts if most of its runs are whole frames, or if it changes where
    positions begin again.

    Raises InputError if titles stand between blocks that are no frames.
    """
    lines = arrangement.lines
    if lines == 1:
        return FrameEnds(1)
    positions = arrangement.positions(table)
    texts = _key_texts(table, arrangement)
    changes = {key: changes_of(values) for key, values in texts.items()}

    def steps() -> Array:
        """Return the steps of the time between lines; none without times."""
        return np.diff([seconds_of(text, comma=table.comma) for text in texts.get("time", ())])

    if positions is None:
        titles = _titles_of_blocks(table, lines)
        keys = tuple(key for key in changes if are_whole(changes[key], lines))
        return FrameEnds(lines, {}, keys, titles, inf if keys else _pause(steps(), lines))
    often = np.bincount(positions[positions >= 0], minlength=1)
    usual = int(np.sum(2 * often >= often.max()))
    kinds = {
        kind: np.array([kind in of_line for of_line in table.kinds])
        for kind in dict.fromkeys(kind for of_line in table.kinds[1:] for kind in of_line)
    }
    certain = [
        changed for changed in (*changes.values(), *kinds.values()) if are_whole(changed, usual)
    ]
    parts = np.any([np.zeros(len(positions), dtype=bool), *certain], axis=0)
    ranks = scan_order(positions.tolist(), parts)
    rank = np.array([ranks.get(position, -1) for position in positions.tolist()])
    falls = np.diff(rank) <= 0  # positions that do not rise

    def ends_frames(changed: Mask) -> bool:
        begins = changed[1:]
        return are_whole(changed, usual) or bool(
            np.any(begins) and np.mean(falls[begins]) >= MIN_SHARE
        )

    keys = tuple(
        key
        for key, changed in changes.items()
        if ends_frames(changed) or (key == "frame" and not np.all(changed[1:]))
    )
    titles = frozenset(kind for kind, marked in kinds.items() if ends_frames(marked))
    step = inf if keys else _max_step(steps(), falls)
    return FrameEnds(usual, ranks, keys, titles, step, gapless=usual == len(ranks))


def _key_texts(table: ReadingsTable, arrangement: TableLayout) -> dict[str, Sequence[str]]:
    """Return the texts of the frame's number and of the time of each line, where they have them."""
    texts = {}
    if "frame" in arrangement.roles:
        texts["frame"] = table.fields[:, arrangement.roles["frame"]].tolist()
    stamps = table.stamps(arrangement.times).texts
    if any(stamps):
        texts["time"] = stamps
    return texts


def _marked(table: ReadingsTable, titles: frozenset[str]) -> list[bool]:
    """Return whether a title or blank line of some kinds precedes each line."""
    return [bool(kinds) if ANY in titles else bool(kinds & titles) for kinds in table.kinds]


def _max_step(steps: Array, falls: Mask) -> float:
    """Return the largest step of the time within a frame; ∞ where times do not resolve it.

    A longer step is that of lines that were lost: half a frame's duration.

    Parameters
    ----------
    steps : array, shape (lines - 1,)
        Steps of the time between lines; none without times.
    falls : boolean array, shape (lines - 1,)
        Whether the position of a line does not rise.
    """
    inner = steps[~falls] if len(steps) else steps
    if not np.any(steps > 0) or not np.any(falls) or not len(inner):
        return inf
    half = float(np.nansum(np.maximum(steps, 0))) / float(np.sum(falls)) / 2
    return float(np.nanmedian(inner)) + half if half > np.min(steps[steps > 0]) else inf


def _pause(steps: Array, lines: int) -> float:
    """Return the largest step of the time within a frame where frames are apart; else ∞."""
    frames = len(steps) // lines
    if frames < 2 or not np.all(np.isfinite(steps)):
        return inf
    largest = np.sort(steps)[::-1]
    pause, inner = (float(np.median(part)) for part in (largest[:frames], largest[frames:]))
    limit = (pause + inner) / 2
    apart = pause > MIN_PAUSE * inner and are_whole(np.append(False, steps > limit), lines)
    return limit if apart else inf


def _titles_of_blocks(table: ReadingsTable, lines: int) -> frozenset[str]:
    """Return the kinds of the titles between blocks of lines without names.

    Titles are those that give most whole frames, if these are not fewer than without any.
    """
    kinds = table.kinds
    often = Counter(kind for of_line in kinds[1:] for kind in of_line)
    options = [frozenset([ANY]), *(frozenset([kind]) for kind, _ in often.most_common(8))]

    def runs(titles: frozenset[str]) -> Numbers:
        marked = np.flatnonzero(_marked(table, titles)[1:]) + 1
        return np.diff([0, *marked, len(kinds)])

    def whole(run: Numbers) -> int:
        """Return the number of complete frames; lines of a single group may be cut at the end."""
        return int(np.sum(run[(run % lines == 0) | (len(run) == 1)] // lines))

    best = max(options, key=lambda titles: whole(runs(titles)))
    run = runs(best)
    if len(run) in (1, len(kinds)) or 2 * len(run) < len(kinds) // lines:
        return frozenset()
    if np.any(run > lines) and not whole(run):
        number = int(np.argmax(run > lines))
        raise InputError(
            f"{table.place(int(np.sum(run[:number])), None)}: "
            f"a block of {run[number]} lines, where the panel has {lines} rows"
        )
    return best


def _segmented(lines: Iterable[int], keys: Sequence[LineKeys], ends: FrameEnds) -> Iterator[Placed]:
    """Yield the frames of lines with these keys."""
    segmenter = Segmenter(ends)
    for segment in (*(segmenter.feed(line, keys[line]) for line in lines), segmenter.close()):
        if segment:
            yield from placed(segment, ends)


def _divided(
    table: ReadingsTable, arrangement: TableLayout, ends: FrameEnds
) -> tuple[list[Placed], list[str]]:
    """Return the frames of a table and notes on those that are missing or left out.

    Raises InputError if nothing says where frames begin, and lines are lost.
    """
    keys = line_keys(table, arrangement, ends)
    notes: list[str] = []
    parts = [range(len(keys))]
    if ends.counted and ends.lines > 1:
        parts, notes = _parts_by_readings(table, arrangement)
    groups = [*_segmented(parts[0], keys, ends)]
    for last, part in pairwise(parts):
        groups += [Placed(last.stop, (), ()), *_segmented(part, keys, ends)]
    if ends.lines > 1 and (ends.gapless or not ends.ranks):
        # A first and a last frame that are not whole are left out; others are named.
        remarks: list[str] = []
        for name, at, others in (("first", 0, slice(1, None)), ("last", -1, slice(-1))):
            if len(groups) > 1 and groups[at].remark:
                begin = table.called(groups[at].begin)
                remarks.append(f"the {name} frame ({begin}) is cut and left out")
                groups = groups[others]
        odd = [
            f"the frame at {table.called(group.begin)} {group.remark}"
            for group in groups
            if group.remark
        ]
        remarks += odd[:MAX_REMARKS]
        if len(odd) > MAX_REMARKS:
            remarks.append(f"so have {counted(len(odd) - MAX_REMARKS, 'more frame')}")
        notes = [*remarks, *notes]
    if ends.title is not None:
        skipped = [
            place
            for before in table.before[1:]
            for text, place in before.items()
            if text and kind_of(text) not in ends.titles
        ]
        notes += [f"skipped between rows: {first_and_more(skipped)}"] if skipped else []
    if ends.ranks and not ends.shared and not ends.titles:
        position = "cell" if len(arrangement.cells) == 1 else "row"
        notes.append(f"a new frame begins where a {position} comes again")
    return groups, notes


def _parts_by_readings(
    table: ReadingsTable, arrangement: TableLayout
) -> tuple[list[range], list[str]]:
    """Return the parts of whole frames in lines without marks, by their readings, and notes."""
    lines = arrangement.lines
    parts = whole_parts(table.values[:, sorted(arrangement.cells)], lines)
    if parts is None:
        raise InputError(
            f"{table.source.source}: {counted(len(table.lines), 'line')} "
            f"are no whole number of frames of {lines} lines, "
            "and the readings do not show which are lost, doubled or of a cut frame; "
            "leave the lines before the first whole frame and behind the last one out "
            "(`skip_lines` leaves out those at the beginning)"
        )
    first = table.called(parts[0].start)
    notes = [
        f"nothing says where a frame begins: every {lines} lines from {first} on "
        "are taken as one; `skip_lines` leaves out lines before the first frame"
    ]
    if parts[0].start:
        notes.append(f"the lines before {first} are of a cut frame, and left out")
    notes += [
        f"lines are lost or doubled between {table.called(last.stop)} and "
        f"{table.called(part.start)}: a frame is missing"
        for last, part in pairwise(parts)
    ]
    return parts, notes


def _with_merged_keys(table: ReadingsTable, arrangement: TableLayout) -> ReadingsTable:
    """Return the table with the frame's number and time of merged cells in all their lines."""
    keys = {*arrangement.times, arrangement.roles.get("frame")} - {None}
    if arrangement.lines == 1 or not keys:
        return table
    fields = table.fields.copy()
    for at in keys:
        empty = fields[:, at] == ""
        if not empty[0] and 2 * empty.sum() >= len(empty):
            last = np.maximum.accumulate(np.where(empty, 0, np.arange(len(empty))))
            fields[:, at] = fields[last, at]
    return replace(table, fields=fields)


def _without_doubled(table: ReadingsTable, arrangement: TableLayout) -> ReadingsTable:
    """Return the table without a few lines that repeat the previous one, keys included."""
    if not (arrangement.roles or arrangement.times or table.clock):
        return table
    same = np.append(False, np.all(table.fields[1:] == table.fields[:-1], axis=1))
    same &= np.any(table.fields != "", axis=1)
    return table.without(same, "repeat the line before")


def _without_swapped(table: ReadingsTable, arrangement: TableLayout) -> ReadingsTable:
    """Return a table of frames in lines without a few that came too late.

    Their number or time puts them before the previous line.
    """
    swapped = np.zeros(len(table.lines), dtype=bool)
    for texts in _key_texts(table, arrangement).values() if arrangement.lines == 1 else ():
        values = np.array([seconds_of(text, comma=table.comma) for text in texts])
        before, last, this, after = values[:-3], values[1:-2], values[2:-1], values[3:]
        swapped[2:-1] |= (before < this) & (this < last) & (last < after)
    return table.without(swapped, "belong before the previous line")


def _grouped_by_name(
    table: ReadingsTable, arrangement: TableLayout
) -> tuple[list[Placed], list[str]] | None:
    """Return the frames of lines that are in no order; None where they follow each other.

    The lines of such a table, of which each has the number or time of its frame and a position of
    its own, are scattered; frames are in the order of their numbers.
    """
    positions = arrangement.positions(table)
    texts = _key_texts(table, arrangement)
    key = next(iter(texts), None)
    if positions is None or key is None or (key == "time" and not arrangement.times):
        return None
    names = texts[key]
    runs = 1 + int(changes_of(names).sum())
    pairs = set(zip(names, positions.tolist(), strict=True))
    lines: dict[str, list[int]] = {name: [] for name in names}
    if 2 * runs < 3 * len(lines) or len(pairs) < len(names) or 2 * len(lines) > len(names):
        return None
    for line, name in enumerate(names):
        if positions[line] >= 0:
            lines[name].append(line)
    order = list(lines)
    if key == "frame":
        order.sort(key=lambda name: seconds_of(name, comma=table.comma))
    groups = [
        Placed(lines[name][0], tuple(lines[name]), tuple(positions[lines[name]].tolist()))
        for name in order
        if lines[name]
    ]
    return groups, [f"lines in no order: frames by their {key}"]


def _categories(table: ReadingsTable, arrangement: TableLayout) -> Iterator[tuple[int, list[str]]]:
    """Yield the fields that nothing uses and that take a few values, with these."""
    for at in set(range(table.width)) - arrangement.used:
        values = few_values(table.fields[:, at].tolist())
        if values:
            yield at, values


def refuse_several_boards(table: ReadingsTable, arrangement: TableLayout, ends: FrameEnds) -> None:
    """Raise InputError if the first lines of a port are those of several boards."""
    keys = line_keys(table, arrangement, ends)
    groups = [*_segmented(range(len(keys)), keys, ends)]
    _refuse_two_sources(table, arrangement, groups)


def _refuse_two_sources(
    table: ReadingsTable, arrangement: TableLayout, groups: Sequence[Placed]
) -> None:
    """Raise InputError if a field that nothing uses tells lines of several boards apart.

    It then changes from frame to frame most of the times, or within frames, but not with the
    position.
    """
    for at, values in _categories(table, arrangement):
        texts = table.fields[:, at].tolist()
        if arrangement.lines == 1:
            mixed = alternate(texts)
        else:
            pairs = {
                (position, texts[line])
                for group in groups
                for line, position in zip(group.lines, group.positions, strict=True)
            }
            several = [len({texts[line] for line in group.lines}) > 1 for group in groups]
            follows = len(pairs) == len({position for position, _ in pairs})
            mixed = not follows and 2 * sum(several) >= len(several)
        if mixed:
            sentence = several_sources(table.names[at], values)
            raise InputError(f"{table.place(0, at)}: {sentence}, or skip the field in `layout`")
