"""Style of all figures: sizes, colours, texts, files."""

import re
from base64 import b64encode
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from itertools import chain, product
from math import ceil, floor, log10
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from lampest.files.errors import InputError
from lampest.files.whole import whole_file
from lampest.runs.executors import Serial, each_of

WIDTH_INCH = 7.2  # of a page of a journal
TEXT_POINT = 8
SMALL_POINT = 6.5
BLUE = "#0072B2"
ORANGE = "#D55E00"
DOTS_PER_INCH = 200
SUFFIXES = (".png", ".svg", ".pdf")
PICTURES = "pictures are written as .png, .svg or .pdf"
PLAIN_NUMBER = "{x:g}"  # format of ticks without powers of ten
# Spaces at which a text is not broken: about a sign between two words, before λ, and between a
# number and its unit.
JOINED = re.compile(
    r" (?=[×±=≥≤<>] )|(?<=[×±=≥≤<>]) |(?<=paper's) (?=λ)|(?<=\d) "
    r"(?=(?:%|k?ohm|m?V|kPa|m?m|m?s|Hz|LSB|°C)(?!\w))"
)
HARD_SPACE = "\N{NO-BREAK SPACE}"
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class ShownFigure(Figure):
    """A figure that notebooks show without pyplot."""

    def _repr_png_(self) -> bytes:
        return _drawn(self, "png")


def new_figure(height: float, width: float = WIDTH_INCH) -> Figure:
    """Return an empty figure; sizes in inches. Half of WIDTH_INCH fits a phone."""
    return ShownFigure(figsize=(width, height), layout="constrained")


def labelled(figure: Figure, x: str, y: str, title: str = "") -> Figure:
    """Add common axis labels and a title to a figure."""
    figure.supxlabel(x, fontsize=TEXT_POINT)
    figure.supylabel(y, fontsize=TEXT_POINT)
    if title:
        figure.suptitle(title, fontsize=TEXT_POINT + 1)
    return figure


def dressed(axes: Axes, x: str, y: str) -> None:
    """Set axis labels, text sizes and a thin grid."""
    axes.set_xlabel(x or axes.get_xlabel(), fontsize=TEXT_POINT)
    axes.set_ylabel(y or axes.get_ylabel(), fontsize=TEXT_POINT)
    axes.tick_params(labelsize=SMALL_POINT, which="both")
    axes.grid(visible=True, which="major", color="0.92", lw=0.5)
    axes.set_axisbelow(True)


def shared_legend(
    figure: Figure, grid: Any, location: str = "upper center", least: int = 1, **look: Any
) -> None:
    """Add one legend for all axes, unless there are fewer labels than `least`."""
    handles: dict[str, Any] = {}
    for axes in grid.flat:
        artists, labels = axes.get_legend_handles_labels()
        handles = dict(zip(labels, artists, strict=True)) | handles
    if len(handles) >= least:
        usual: dict[str, Any] = {"loc": f"outside {location}", "ncols": len(handles)}
        usual |= {"fontsize": SMALL_POINT, "frameon": False}
        figure.legend(handles.values(), handles.keys(), **usual | look)


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure as .png, .svg or .pdf, atomically and reproducibly.

    Raises InputError for other suffixes and for a place that cannot be written.
    """
    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: {PICTURES}")
    with whole_file(path) as unfinished:
        unfinished.write_bytes(_drawn(figure, path.suffix[1:]))


def write_all(
    figures: Sequence[Callable[[], Figure]],
    files: Sequence[Path],
    on_picture: Callable[[int, int], None],
    *,
    in_process: bool = False,
) -> list[Path]:
    """Draw figures into files, in processes unless `in_process`; return the files.

    `on_picture` receives the numbers of drawn and of all pictures. Raises InputError if a file
    cannot be written.
    """
    tasks = list(zip(figures, files, strict=True))
    images = each_of(_image, tasks, on_picture, Serial() if in_process else None)
    for file, image in zip(files, images, strict=True):
        with whole_file(file) as unfinished:
            unfinished.write_bytes(image)
    return list(files)


def _image(task: tuple[Callable[[], Figure], Path]) -> bytes:
    """Draw a figure in this process, and return the bytes of its file."""
    draw, file = task
    with verbatim():
        return _drawn(draw(), file.suffix[1:])


def data_uri(figure: Figure) -> str:
    """Return a figure as a data URI, reproducibly."""
    return f"data:image/png;base64,{b64encode(_drawn(figure, 'png')).decode('ascii')}"


def _drawn(figure: Figure, kind: str) -> bytes:
    """Render a figure reproducibly; texts become paths, so that no fonts are needed."""
    stream = BytesIO()
    dated = {"png": ("Software",), "svg": ("Date", "Creator"), "pdf": ("CreationDate",)}
    metadata = dict.fromkeys(dated[kind])
    for spine in chain.from_iterable(axes.spines.values() for axes in figure.axes):
        spine.set_in_layout(False)  # its ticks fit into the gaps
    with rc_context({"svg.hashsalt": "lampest", "svg.fonttype": "path"}):
        if kind != "png":
            figure.savefig(stream, format=kind, metadata=metadata)
            return stream.getvalue()
        # The figure is laid out for its pixels, so that it is drawn once.
        engine = figure.get_layout_engine()
        dots = figure.dpi
        canvas: Any = FigureCanvasAgg(figure)
        figure.dpi = DOTS_PER_INCH
        if engine is not None:
            measured = [_measured_once(axes) for axes in figure.axes]
            engine.execute(figure)
            for axes in measured:
                del axes.get_tightbbox
        figure.set_layout_engine("none")
        try:
            canvas.print_png(stream, metadata=metadata)
        finally:
            figure.set_layout_engine(engine)
            figure.dpi = dots
    return stream.getvalue()


def _measured_once(axes: Any) -> Any:
    """Return axes that keep their extent at each place where they are measured.

    Layouts measure a colour bar anew for every map beside it.
    """
    measure = axes.get_tightbbox
    extents = dict[Any, Any]()

    def kept(*arguments: Any, **named: Any) -> Any:
        place = axes.get_position(original=True).bounds
        if place not in extents:
            extents[place] = measure(*arguments, **named)
        return extents[place]

    axes.get_tightbbox = kept
    return axes


@contextmanager
def verbatim() -> Iterator[None]:
    """Draw texts verbatim, without formulas, in figures made within this context."""
    with rc_context({"text.parse_math": False}):
        yield


def round_numbers(low: float, high: float) -> list[float]:
    """Return the numbers 1, 2, 5 times powers of ten from low to high, both positive."""
    powers = range(floor(log10(low)), ceil(log10(high)) + 1)
    numbers = [float(f"{digit}e{power}") for power, digit in product(powers, (1, 2, 5))]
    return [number for number in numbers if low <= number <= high]


def short_title(name: str, longest: int = 22) -> str:
    """Shorten a name."""
    return name if len(name) <= longest else f"{name[: longest - 1]}…"


def wrapped(text: str, signs: int) -> str:
    """Break a text into lines of at most `signs` characters, between words or after a sign in them.

    Numbers are not broken, and neither are words of JOINED.
    """
    lines = [""]
    text = JOINED.sub(HARD_SPACE, text)
    for part in re.findall(
        r"(?:[^ ._,;:/+-]|(?<=\d)[.,](?=\d)|(?<=\de)[+-](?=\d))+[ ._,;:/+-]*|[ ._,;:/+-]+", text
    ):
        if lines[-1] and len((lines[-1] + part).rstrip()) > signs:
            lines.append("")
        lines[-1] += part
    return "\n".join(line.strip() for line in lines).replace(HARD_SPACE, " ")


def change_text(value: float, integer_from: float) -> str:
    """Format a change, such as '+3.7', '−82', '+9.5·10⁹'.

    Numbers from `whole` on are rounded to integers.
    """
    if abs(value) >= 1e5:
        digits, power = f"{value:+.1e}".split("e")
        text = f"{digits}·10{f'{int(power)}'.translate(RAISED)}"
    else:
        text = f"{value:+.{0 if abs(value) >= integer_from else 1}f}"
    return text.replace("-", "−")
