"""Division of the lines of a table into frames, by the marks that the table itself shows."""

from collections import Counter
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
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
    count = len(table.lines)
    positions = arrangement.positions(table)
    texts = {"time": [""] * count, **_key_texts(table, arrangement)}
    shared: list[Hashable] = [None] * count
    if ends.shared:
        of_lines = zip(*(texts[key] for key in ends.shared), strict=True)
        shared = [line if all(line) else None for line in of_lines]
    seconds = [nan] * count
    if ends.max_step < inf:
        seconds = [seconds_of(text, comma=table.comma) for text in texts["time"]]
    places = [-1] * count if positions is None else positions.tolist()
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
        [f"{arrangement.note}{''.join(f'; {note}' for note in notes)}", *unused],
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
    if positions is None:
        titles = _titles_of_blocks(table, lines, changes)
        keys = tuple(key for key in changes if are_whole(changes[key], lines))
        step = inf if keys else _pause(texts, lines, table)
        return FrameEnds(lines, {}, keys, titles, step)
    often = np.bincount(positions[positions >= 0], minlength=1)
    usual = int(np.sum(2 * often >= often.max()))
    kinds = {
        kind: np.array([kind in of_line for of_line in table.kinds])
        for kind in dict.fromkeys(kind for of_line in table.kinds[1:] for kind in of_line)
    }
    certain = [
        changed for changed in (*changes.values(), *kinds.values()) if are_whole(changed, usual)
    ]
    parts = np.any(certain, axis=0) if certain else np.zeros(len(positions), dtype=bool)
    ranks = scan_order(positions.tolist(), parts)
    falls = _falls(positions, ranks)

    def ends_frames(changed: Mask) -> bool:
        return are_whole(changed, usual) or bool(
            np.any(changed[1:]) and np.mean(falls[1:][changed[1:]]) >= MIN_SHARE
        )

    keys = tuple(
        key
        for key, changed in changes.items()
        if ends_frames(changed) or (key == "frame" and not np.all(changed[1:]))
    )
    titles = frozenset(kind for kind, marked in kinds.items() if ends_frames(marked))
    step = inf if keys else _max_step(texts, falls, table)
    return FrameEnds(usual, ranks, keys, titles, step, gapless=usual == len(ranks))


def _key_texts(table: ReadingsTable, arrangement: TableLayout) -> dict[str, Sequence[str]]:
    """Return the texts of the frame's number and of the time of each line, where they have them."""
    texts: dict[str, Sequence[str]] = {}
    if "frame" in arrangement.roles:
        texts["frame"] = table.fields[:, arrangement.roles["frame"]].tolist()
    stamps = table.stamps(arrangement.times).texts
    if any(stamps):
        texts["time"] = stamps
    return texts


def _marked(table: ReadingsTable, titles: frozenset[str]) -> list[bool]:
    """Return whether a title or blank line of some kinds precedes each line."""
    return [bool(kinds) if ANY in titles else bool(kinds & titles) for kinds in table.kinds]


def _falls(positions: Numbers, ranks: Mapping[int, int]) -> Mask:
    """Return whether the position of a line does not rise, boolean (lines,)."""
    rank = np.array([ranks.get(position, -1) for position in positions.tolist()])
    return np.append(False, rank[1:] <= rank[:-1])


def _max_step(texts: dict[str, Sequence[str]], falls: Mask, table: ReadingsTable) -> float:
    """Return the largest step of the time within a frame; ∞ where times do not resolve it.

    A longer step is that of lines that were lost: half a frame's duration.
    """
    steps = _steps(texts, table)
    inner = steps[~falls[1:]] if len(steps) else steps
    if not np.any(steps > 0) or not np.any(falls) or not len(inner):
        return inf
    period = float(np.nansum(np.maximum(steps, 0))) / float(np.sum(falls))
    limit = float(np.nanmedian(inner)) + period / 2
    return limit if period / 2 > float(np.min(steps[steps > 0])) else inf


def _pause(texts: dict[str, Sequence[str]], lines: int, table: ReadingsTable) -> float:
    """Return the largest step of the time within a frame where frames are apart; else ∞."""
    steps = _steps(texts, table)
    frames = len(steps) // lines
    if frames < 2 or not np.all(np.isfinite(steps)):
        return inf
    largest = np.sort(steps)[::-1]
    pause, inner = (float(np.median(part)) for part in (largest[:frames], largest[frames:]))
    limit = (pause + inner) / 2
    apart = pause > MIN_PAUSE * inner and are_whole(np.append(False, steps > limit), lines)
    return limit if apart else inf


def _steps(texts: dict[str, Sequence[str]], table: ReadingsTable) -> Array:
    """Return the steps of the time between lines; none without times."""
    if "time" not in texts:
        return np.empty(0)
    return np.diff([seconds_of(text, comma=table.comma) for text in texts["time"]])


def _titles_of_blocks(table: ReadingsTable, lines: int, changes: dict[str, Mask]) -> frozenset[str]:
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
        return int(np.sum(run[run % lines == 0] // lines)) if len(run) > 1 else int(run[0] // lines)

    best = max(options, key=lambda titles: whole(runs(titles)))
    run = runs(best)
    single = np.array([len(kinds)])
    if len(run) == 1 or len(run) == len(kinds) or 2 * len(run) < whole(single):
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
        if segment is not None:
            yield from placed(segment, ends)


def _divided(
    table: ReadingsTable, arrangement: TableLayout, ends: FrameEnds
) -> tuple[list[Placed], list[str]]:
    """Return the frames of a table and notes on those that are missing or left out.

    Raises InputError if nothing says where frames begin, and lines are lost.
    """
    keys = line_keys(table, arrangement, ends)
    notes: list[str] = []
    groups: list[Placed] = []
    parts = [range(len(keys))]
    if ends.counted and ends.lines > 1:
        parts, notes = _parts_by_readings(table, arrangement)
    for number, part in enumerate(parts):
        if number:
            groups.append(Placed(parts[number - 1].stop, (), (), ""))
        groups.extend(_segmented(part, keys, ends))
    if ends.lines > 1:
        groups, remarks = _trimmed(table, groups, ends)
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
    called = table.called
    notes = [
        f"nothing says where a frame begins: every {lines} lines from {called(parts[0].begin)} on "
        "are taken as one; `skip_lines` leaves out lines before the first frame"
    ]
    if parts[0].begin:
        notes.append(f"the lines before {called(parts[0].begin)} are of a cut frame, and left out")
    notes += [
        f"lines are lost or doubled between {called(last.end)} and {called(part.begin)}: "
        "a frame is missing"
        for last, part in pairwise(parts)
    ]
    return [range(part.begin, part.end) for part in parts], notes


def _trimmed(
    table: ReadingsTable, groups: list[Placed], ends: FrameEnds
) -> tuple[list[Placed], list[str]]:
    """Return the frames without a first and a last one that are not whole, and notes on others."""
    notes: list[str] = []
    whole = [not group.remark for group in groups]
    if ends.gapless or not ends.ranks:
        if len(groups) > 1 and not whole[0]:
            notes.append(f"the first frame ({table.called(groups[0].begin)}) is cut and left out")
            groups = groups[1:]
        if len(groups) > 1 and groups[-1].remark:
            notes.append(f"the last frame ({table.called(groups[-1].begin)}) is cut and left out")
            groups = groups[:-1]
    else:
        return groups, notes
    odd = [group for group in groups if group.remark]
    notes += [
        f"the frame at {table.called(group.begin)} {group.remark}" for group in odd[:MAX_REMARKS]
    ]
    if len(odd) > MAX_REMARKS:
        notes.append(f"so have {counted(len(odd) - MAX_REMARKS, 'more frame')}")
    return groups, notes


def _with_merged_keys(table: ReadingsTable, arrangement: TableLayout) -> ReadingsTable:
    """Return the table with the frame's number and time of merged cells in all their lines."""
    fields = table.fields
    for at in (*arrangement.times, arrangement.roles.get("frame")):
        if at is None:
            continue
        empty = fields[:, at] == ""
        if arrangement.lines == 1 or empty[0] or 2 * empty.sum() < len(empty):
            continue
        last = np.maximum.accumulate(np.where(empty, 0, np.arange(len(empty))))
        fields = fields.copy()
        fields[:, at] = fields[last, at]
    return table if fields is table.fields else replace(table, fields=fields)


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
    key = next((key for key in ("frame", "time") if key in texts), None)
    if positions is None or key is None or (key == "time" and not arrangement.times):
        return None
    names = texts[key]
    runs = 1 + int(changes_of(names).sum())
    distinct = dict.fromkeys(names)
    pairs = len(set(zip(names, positions.tolist(), strict=True)))
    if 2 * runs < 3 * len(distinct) or pairs < len(names) or 2 * len(distinct) > len(names):
        return None
    if key == "frame":
        seconds = {name: seconds_of(name, comma=table.comma) for name in distinct}
        distinct = dict.fromkeys(sorted(distinct, key=seconds.__getitem__))
    lines: dict[str, list[int]] = {name: [] for name in distinct}
    for line, name in enumerate(names):
        if positions[line] >= 0:
            lines[name].append(line)
    groups = [
        Placed(of[0], tuple(of), tuple(positions[of].tolist()), "") for of in lines.values() if of
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
            by_position: dict[int, set[str]] = {}
            for group in groups:
                for line, position in zip(group.lines, group.positions, strict=True):
                    by_position.setdefault(position, set()).add(texts[line])
            several = [len({texts[line] for line in group.lines}) > 1 for group in groups]
            follows = all(len(of_position) == 1 for of_position in by_position.values())
            mixed = not follows and 2 * sum(several) >= len(several)
        if mixed:
            sentence = several_sources(table.names[at], values)
            raise InputError(f"{table.place(0, at)}: {sentence}, or skip the field in `layout`")
