"""What all pictures share: sizes, colours, texts, how they are begun, and how they become files."""

from base64 import b64encode
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from math import ceil, floor, log10
from pathlib import Path
from typing import Any, Literal

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from lampest.files.errors import InputError
from lampest.files.whole import whole_file
from lampest.runs.executors import each_of

WIDTH_INCH, HALF_INCH, TALLEST_INCH = 7.2, 3.6, 9.0  # of a page of a journal
TEXT_POINT, SMALL_POINT = 8, 6.5
BLUE, ORANGE = "#0072B2", "#D55E00"
SUFFIXES = (".png", ".svg", ".pdf")
PICTURES = f"pictures are written as {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}"
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def new_figure(height: float, width: float = WIDTH_INCH) -> Figure:
    """An empty figure of that many inches; HALF_INCH wide ones fit a phone, too."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def labelled(figure: Figure, x: str, y: str, title: str = "") -> Figure:
    """The figure with labels of all its axes together, and a title where there is one."""
    figure.supxlabel(x, fontsize=TEXT_POINT)
    figure.supylabel(y, fontsize=TEXT_POINT)
    if title:
        figure.suptitle(title, fontsize=TEXT_POINT + 1)
    return figure


def dressed(axes: Axes, x: str, y: str) -> None:
    """Labels of both axes where there are any, the size of all texts, and thin lines behind what is drawn."""
    axes.set_xlabel(x or axes.get_xlabel(), fontsize=TEXT_POINT)
    axes.set_ylabel(y or axes.get_ylabel(), fontsize=TEXT_POINT)
    axes.tick_params(labelsize=SMALL_POINT, which="both")
    axes.grid(True, which="major", color="0.92", lw=0.5)
    axes.set_axisbelow(True)


def shared_legend(figure: Figure, grid: Any, location: str = "upper center", least: int = 1, **look: Any) -> None:
    """One legend for all axes, each label once, unless there are fewer labels than `least`."""
    handles: dict[str, Any] = {}
    for axes in grid.flat:
        handles = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True)) | handles
    if len(handles) >= least:
        own: dict[str, Any] = {"fontsize": SMALL_POINT, "frameon": False, "ncols": len(handles)}
        figure.legend(handles.values(), handles.keys(), **own | {"loc": f"outside {location}"} | look)


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure as .png, .svg or .pdf, whole or not at all; the same figure gives the same bytes.

    Raises InputError for another suffix or where the place cannot be written.
    """
    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: {PICTURES}")
    _write(_drawn(figure, path.suffix[1:]), path)


def write_all(
    figures: Sequence[Callable[[], Figure]],
    files: Sequence[Path],
    on_picture: Callable[[int, int], None],
    here: bool = False,
) -> list[Path]:
    """Draw each of the figures, in processes, into its file: the files. here : in this process.

    on_picture : gets how many of how many pictures are drawn. Raises InputError where a place cannot be written.
    """
    tasks = list(zip(figures, files, strict=True))
    for file, image in zip(files, each_of(_image, tasks, on_picture, here=here), strict=True):
        _write(image, file)
    return list(files)


def _image(task: tuple[Callable[[], Figure], Path]) -> bytes:
    draw, file = task
    with verbatim():
        return _drawn(draw(), file.suffix[1:])


def _write(image: bytes, path: Path) -> None:
    with whole_file(path) as unfinished:
        unfinished.write_bytes(image)


def data_uri(figure: Figure, kind: Literal["png", "svg"] = "svg") -> str:
    """The figure as the address of an image that holds it; the same figure gives the same text."""
    form = "png" if kind == "png" else "svg+xml"
    return f"data:image/{form};base64,{b64encode(_drawn(figure, kind)).decode('ascii')}"


def _drawn(figure: Figure, kind: str) -> bytes:
    """The same figure gives the same bytes; words are drawn, so that no font is missing elsewhere."""
    stream = BytesIO()
    dated = {"png": ("Software",), "svg": ("Date", "Creator"), "pdf": ("CreationDate",)}[kind]
    with rc_context({"svg.hashsalt": "lampest", "svg.fonttype": "path"}):
        figure.savefig(stream, format=kind, dpi=200, metadata=dict.fromkeys(dated))
    return stream.getvalue()


@contextmanager
def verbatim() -> Iterator[None]:
    """Texts of figures made herein are no formulas, whatever signs a name holds."""
    with rc_context({"text.parse_math": False}):
        yield


def plain_number(value: float, _: int | None = None) -> str:
    """A tick's number without powers of ten."""
    return f"{value:g}".replace("-", "−")


def round_numbers(low: float, high: float) -> list[float]:
    """1, 2, 5, 10, 20 … and their fractions from low to high, both positive."""
    powers = range(floor(log10(low)), ceil(log10(high)) + 1)
    return [step for power in powers for one in (1, 2, 5) if low <= (step := float(f"{one}e{power}")) <= high]


def short_title(name: str, longest: int = 22) -> str:
    """A name that fits."""
    return name if len(name) <= longest else f"{name[: longest - 1]}…"


def change_text(value: float, whole: float) -> str:
    """'+3.7', '−82', '+9.5·10⁹': whole numbers from `whole` on, powers of ten where there would be six digits."""
    if abs(value) >= 1e5:
        digits, power = f"{value:+.1e}".split("e")
        text = f"{digits}·10{str(int(power)).translate(RAISED)}"
    else:
        text = f"{value:+.{0 if abs(value) >= whole else 1}f}"
    return text.replace("-", "−")
