"""Options, messages, progress bar, tables and exit codes of all commands."""

import inspect
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from copy import copy
from datetime import timedelta
from io import TextIOWrapper
from itertools import chain, groupby
from math import ceil
from operator import itemgetter
from pathlib import Path
from shutil import get_terminal_size
from textwrap import fill, wrap
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any, TextIO, get_args, get_origin

import typer

from lampest.files.errors import InputError, printable

if TYPE_CHECKING:
    from rich.progress import Progress

    from lampest.panel.scene import Scene
    from lampest.report.compare import Table


WRONG_INPUT = 2
SOME_FAILED = 3
INTERRUPTED = 130
WIDTH = 100  # columns of a terminal that every table and note fits
UNKNOWN_TIME = "-:--:--"


def _place(value: str) -> Path:
    return Path(value if value.strip() else Path.cwd().anchor)


def _checked_place(parameter: typer.CallbackParam, value: Path | None) -> Path | None:
    """Return an output path.

    Raises InputError for an empty one and for the root of the file system.
    """
    if value is not None and value.resolve() == Path(value.resolve().anchor):
        raise InputError(
            f"{parameter.opts[0]}: output cannot be written to an empty path "
            "or to the root of the file system"
        )
    return value


def positive(parameter: typer.CallbackParam, value: float | None) -> float | None:
    """Return a number. Raises InputError unless it is positive and finite."""
    if value is not None and not 0 < value < float("inf"):
        raise InputError(f"{parameter.opts[0]} must be positive and finite")
    return value


def option(text: str = "", *names: str, **further: Any) -> Any:
    """Return an option with the name of its parameter, unless names are given.

    An option without a help text has that of the command's docstring.
    """
    return typer.Option(*names, help=text or None, **further)


OUTPUT = option(parser=_place, callback=_checked_place, metavar="PATH")
Output = Annotated[Path | None, OUTPUT]
NewFile = Annotated[Path, OUTPUT]
Count = Annotated[int, option(min=1)]
Amount = Annotated[float | None, option(callback=positive)]
Assign = Annotated[
    list[str] | None,
    option(
        "Override an entry of the file: formulation=reduced. Repeatable.",
        "--set",
        metavar="PATH=VALUE",
    ),
]
AssignToScene = Annotated[
    list[str] | None,
    option(
        "Override an entry of --scene: readout.adc_bits=12. Repeatable.",
        "--set",
        metavar="PATH=VALUE",
    ),
]
FramesNamed = Annotated[str | None, option("Range of frames: 40:50 is 40 to 49.", metavar="RANGE")]


def frames_of(text: str | None) -> range | None:
    """Return the frames that an option names, or None for all.

    Raises InputError unless it names some.
    """
    from lampest.recording.tare import frames_named

    return None if text is None else frames_named(text)


def documented(command: Callable[..., None]) -> tuple[str, inspect.Signature]:
    """Return the help of a command from its docstring, and the signature for typer.

    Truth values become flags without a value. Parameters without a default are arguments, and all
    others options, unless their annotation has a description.

    Returns
    -------
    about : str
        Docstring without its parameters.
    signature : inspect.Signature
        Signature of the command, each option with its help.
    """
    about, _, section = (inspect.getdoc(command) or "").partition("\n\nParameters\n----------\n")
    help_of = {
        name: " ".join(text.split())
        for name, text in re.findall(r"(?m)^(\w+)\n((?:    .*\n?)+)", section)
    }
    signature = inspect.signature(command)
    parameters = []
    for name, parameter in signature.parameters.items():
        kind = parameter.annotation
        note = typer.Argument() if parameter.default is parameter.empty else typer.Option()
        if get_origin(kind) is Annotated:
            kind, note = get_args(kind)
            note = copy(note)
        if kind is bool:
            note = option(note.help or "", f"--{name.strip('_').replace('_', '-')}")
        note.help = note.help or help_of.get(name)
        parameters.append(parameter.replace(annotation=Annotated[kind, note]))
    return about.strip(), signature.replace(parameters=parameters)


def is_written(parameter: inspect.Parameter) -> bool:
    """Return whether an option names an output."""
    return parameter.annotation.__metadata__[0].parser is _place


def scene_of(path: Path | None, assigned: list[str] | None) -> "Scene | None":
    """Return the scene of a YAML file with some entries overridden, or None if no file is named.

    Raises InputError with line and column, and for overrides without a file.
    """
    from lampest.panel.scene import read_scene

    if path is None and assigned:
        raise InputError("--set: overrides entries of a scene; name its file with --scene")
    return read_scene(path, tuple(assigned or ())) if path else None


def say(message: object, to: TextIO | None = None) -> None:
    """Print one line with control characters escaped."""
    print(printable(str(message)), file=to, flush=True)


def written(path: Path, *, replaced: bool) -> str:
    """Return the path of a new file, and whether it replaced one."""
    return f"{path}{' (in place of the file that had this name)' if replaced else ''}"


def warn(sentence: object) -> None:
    """Print a sentence on stderr, after the program's name."""
    with suppress(OSError):  # nothing can be said on a full disk
        print(printable(f"lampest: {sentence}"), file=sys.stderr, flush=True)


def usable_streams() -> None:
    r"""Open closed standard streams on the null device, and let them write any character.

    Characters that an encoding lacks are written as escapes, such as \xb1 in ASCII.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            descriptor = os.open(os.devnull, os.O_RDWR)  # the lowest free number, that of the name
            setattr(sys, name, os.fdopen(descriptor, mode, closefd=False))
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def end_of_output(error: OSError) -> str:
    """Return a sentence on an error of the standard output, which leads nowhere from now on."""
    descriptor = os.open(os.devnull, os.O_WRONLY)
    os.dup2(descriptor, sys.__stdout__.fileno() if sys.__stdout__ else 1)
    os.close(descriptor)
    return f"standard output cannot be written ({error.strerror or error})"


def as_options(sentence: str) -> str:
    """Return a sentence on arguments with the options of their names.

    Thus `unit='mV'` becomes --unit mV.
    """
    return re.sub(
        r"`(\w+)(?:='?([^`']*)'?)?`", lambda word: f"--{word[1]} {word[2] or ''}".rstrip(), sentence
    )


def say_text(text: str) -> None:
    """Print a text line by line."""
    for line in text.split("\n"):
        say(line)


def print_notes(notes: Iterable[str]) -> None:
    """Print sentences within 100 columns with hanging indents."""
    for note in notes:
        print(
            fill(
                printable(note),
                WIDTH,
                subsequent_indent="    ",
                break_long_words=False,
                break_on_hyphens=False,
            )
        )


@contextmanager
def progress(label: str, *, counted: bool = False) -> Iterator[Callable[..., None]]:
    """Show a progress bar with the remaining time on stderr, hidden unless stderr is a terminal.

    Yields a function that takes the number of finished parts, their total, a text for the label,
    the name of a further step with a bar of its own, and the remaining time in s. Without it the
    remaining time is that of parts of equal length. The first call for a step starts its
    clock. The first finished part starts it anew if the call before said that nothing is finished
    yet, as while a run prepares its recordings, or if another step has not ended. So does the end
    of another step.

    Parameters
    ----------
    label : str
        Name of the things that are counted.
    counted : bool
        Whether the numbers of finished and of all parts are shown.
    """
    if not sys.stderr.isatty():  # the library of the bar takes a tenth of a second to load
        yield lambda *shown, **more: None
        return
    from rich.markup import escape

    with _bars(counted=counted) as bar:
        tasks = {label: bar.add_task(label, total=None, left=UNKNOWN_TIME)}
        began: dict[str, tuple[float, int]] = {}
        unfinished: dict[str, int] = {}
        idle: dict[str, bool] = {}  # step of which nothing is finished → whether it has not begun

        def show(
            done: int,
            total: int | None,
            text: str | None = None,
            step: str = label,
            left_s: float | None = None,
        ) -> None:
            now = monotonic()
            if step not in tasks:
                tasks[step] = bar.add_task(step, total=None, left=UNKNOWN_TIME)
            if step not in began:
                began[step], idle[step] = (now, done), False
            elif step in idle and done == began[step][1]:
                idle[step] = True
            elif step in idle and (idle.pop(step) or unfinished.keys() - {step}):
                began[step] = now, done
            start, before = began[step]
            if done != total:
                unfinished[step] = done
            elif unfinished.pop(step, None) is not None:
                began.update({other: (now, count) for other, count in unfinished.items()})
            unsolved = None if total is None else total - done
            left = time_left(now - start, done - before, unsolved)
            bar.update(
                tasks[step],
                completed=done,
                total=total,
                description=text and escape(printable(text)),
                left=left if left_s is None else time_left(left_s, 1, 1),
            )

        yield show


def _bars(*, counted: bool) -> "Progress":
    """Return bars on stderr with a label, the percentage, the time left and, if asked, counts."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TextColumn("{task.fields[left]} left"),
        *[MofNCompleteColumn()] * counted,
    )
    return Progress(*columns, console=Console(stderr=True))


def time_left(elapsed: float, done: int, left: int | None) -> str:
    """Return the remaining time as hours, minutes and seconds.

    The remaining time is `elapsed`/`done`·`left`; it is unknown while nothing is done.

    Parameters
    ----------
    elapsed : float
        Time in s in which `done` parts were finished.
    done : int
    left : int or None
        Number of unfinished parts; None if unknown.
    """
    if left is None or (left and done <= 0):
        return UNKNOWN_TIME
    return str(timedelta(seconds=ceil(elapsed / done * left) if left else 0))


TOGETHER = re.compile(r" (?=[±/…] )|(?<= [±/…]) ")  # blanks within a figure: '2.3 ± 1.4'
MIN_NAME = 12  # characters to which names in the first column are cut


def print_table(table: "Table") -> None:
    """Print a table within 100 columns, or within the width of a wider terminal.

    Empty columns and empty tables are omitted. In a table that is too wide, headers and texts are
    folded, figures are not. If that is insufficient, rows that share the name in the first column
    are printed under that name.
    """
    columns = list[list[str]]()
    for header, *texts in zip(table.headers, *table.cells, strict=True):
        if any(texts):
            shown = ["\n".join(map(printable, text.split("\n"))) for text in texts]
            columns.append([header, *(TOGETHER.sub("\N{NO-BREAK SPACE}", text) for text in shown)])
    if not columns:
        return
    room = max(get_terminal_size().columns if sys.stdout.isatty() else 0, WIDTH)
    if _draw(columns, room, last=len(columns) < 2):
        return
    headers, *rows = zip(*columns, strict=True)
    for name, block in groupby(rows, key=itemgetter(0)):
        say(f"{name}:")
        _draw(list(zip(headers, *block, strict=True))[1:], room, last=True)


def _draw(table: Sequence[Sequence[str]], room: int, *, last: bool) -> bool:
    """Print a table, given as columns with their headers, and return True.

    Return False if it does not fit, unless this is the last attempt. The widest column is narrowed
    until the table fits, down to the longest word of each column. If that is insufficient, the
    blanks between columns shrink and names in the first column are cut.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table as RichTable

    columns = [[text.split("\n") for text in column] for column in table]
    words = [[line.split(" ") for line in chain.from_iterable(column)] for column in columns]
    full, least = (
        [max(map(len, chain.from_iterable(column))) for column in parts]
        for parts in (columns, words)
    )
    cut_names = [min(least[0], max(MIN_NAME, len(table[0][0]))), *least[1:]]
    for gap, floors in ((2, least), (1, cut_names)):
        widths = [*full]
        beyond = sum(full) + gap * (len(full) - 1) + 2 - room
        while beyond > 0:
            # The widest column that is above its floor loses a character at a time.
            spare = [number for number, width in enumerate(widths) if width > floors[number]]
            if not spare:
                break
            widths[max(spare, key=widths.__getitem__)] -= 1
            beyond -= 1
        else:
            break
    if beyond > 0 and not last:
        return False
    # The box adds one blank.
    drawn = RichTable(box=box.SIMPLE_HEAD, padding=(0, gap - 1, 0, 0), pad_edge=False)
    folded = []
    for column, width in zip(columns, widths, strict=True):
        header, *texts = (
            "\n".join("\n".join(wrap(line, width, break_on_hyphens=False)) for line in lines)
            for lines in column
        )
        drawn.add_column(header, no_wrap=True, width=width)
        folded.append(text.replace("\N{NO-BREAK SPACE}", " ") for text in texts)
    for cells in zip(*folded, strict=True):
        drawn.add_row(*cells)
    Console(width=max(room, room + beyond), highlight=False, markup=False).print(drawn)
    return True
