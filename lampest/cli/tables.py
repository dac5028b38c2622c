"""Tables on the screen: within 100 columns, whatever they hold."""

import re
import sys
from collections.abc import Iterator, Sequence
from itertools import groupby
from shutil import get_terminal_size
from textwrap import wrap
from typing import TYPE_CHECKING

from lampest.cli.screen import WIDTH, say
from lampest.files.errors import printable

if TYPE_CHECKING:
    from lampest.report.compare import Table

TOGETHER = re.compile(r" (?=[±/…] )|(?<= [±/…]) ")  # blanks within a figure: '2.3 ± 1.4'


def print_table(table: "Table") -> None:
    """Draw rows of text and figures within 100 columns, or as many as the terminal has where they are more.

    Columns in which no row has anything are left out, and a table without rows altogether. Where it is too wide,
    headers and texts take several lines and figures stay on one; where that is not enough, rows of one name in the
    first column stand together under it.
    """
    filled = [number for number in range(len(table.headers)) if any(cells[number] for cells in table.cells)]
    if not filled:
        return
    headers = [table.headers[number] for number in filled]
    texts = [["\n".join(map(printable, cells[number].split("\n"))) for number in filled] for cells in table.cells]
    rows = [[TOGETHER.sub("\N{NO-BREAK SPACE}", text) for text in cells] for cells in texts]
    room = max(get_terminal_size().columns if sys.stdout.isatty() else 0, WIDTH)
    widths, gap = _layout(headers, rows, room)
    if _whole(widths, gap) <= room or len(headers) < 2:
        _draw(headers, rows, widths, gap)
        return
    for name, block in groupby(rows, key=lambda cells: cells[0]):
        say(f"{name}:")
        others = [cells[1:] for cells in block]
        _draw(headers[1:], others, *_layout(headers[1:], others, room))


def _whole(widths: Sequence[int], gap: int) -> int:
    """The table's width; one blank more stands at each end."""
    return sum(widths) + gap * (len(widths) - 1) + 2


def _layout(headers: Sequence[str], rows: Sequence[Sequence[str]], room: int) -> tuple[list[int], int]:
    """The columns' widths and the blanks between them: the widest column is narrowed as long as all are too wide.

    Headers give way first, then texts, then the blanks between columns, then names in the first column; no other column
    is narrower than the longest of its words and figures.
    """
    columns = list(zip(*rows, strict=True))
    words = [_longest_word(header) for header in headers]
    lines = [[line for text in held for line in text.split("\n")] for held in columns]
    whole = [max(word, *map(len, held)) for word, held in zip(words, lines, strict=True)]
    least = [max(word, *map(_longest_word, held)) for word, held in zip(words, columns, strict=True)]
    names = [min(least[0], max(words[0], 12)), *least[1:]]  # below, a name is not cut into lines
    full = [max(len(header), width) for header, width in zip(headers, whole, strict=True)]
    for gap, steps in ((2, (whole, least)), (1, (whole, least, names))):
        widths = list(full)
        for floors in steps:
            spare = list(range(len(widths)))
            while _whole(widths, gap) > room and (spare := [at for at in spare if widths[at] > floors[at]]):
                widths[max(spare, key=lambda at: widths[at])] -= 1
        if _whole(widths, gap) <= room:
            break
    return widths, gap


def _longest_word(text: str) -> int:
    return max(map(len, re.split("[ \n]", text)))


def _folded(text: str, width: int) -> Iterator[str]:
    for line in text.split("\n"):
        yield from wrap(line, width, break_on_hyphens=False) or [""]


def _draw(headers: Sequence[str], rows: Sequence[Sequence[str]], widths: Sequence[int], gap: int) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table as RichTable

    padding = (0, gap - 1, 0, 0)  # the box itself has a blank between columns
    drawn = RichTable(box=box.SIMPLE_HEAD, padding=padding, pad_edge=False)
    for header, width in zip(headers, widths, strict=True):
        drawn.add_column("\n".join(_folded(header, width)), no_wrap=True, width=width)
    for cells in rows:
        parts = ("\n".join(_folded(cell, width)) for cell, width in zip(cells, widths, strict=True))
        drawn.add_row(*(part.replace("\N{NO-BREAK SPACE}", " ") for part in parts))
    Console(width=_whole(widths, gap), highlight=False, markup=False).print(drawn)
