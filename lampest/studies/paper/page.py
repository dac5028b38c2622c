"""`lampest study paper`: the paper's figures and table beside ours as one HTML file, with pictures and numbers.csv."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from lampest.files.whole import write_whole
from lampest.recording.datasets import folder as shipped_folder
from lampest.report.page.template import Illustration, Sheet, filled
from lampest.report.plots.style import data_uri, save, verbatim
from lampest.studies.paper import tables
from lampest.studies.paper.figures import (
    bending_figure,
    loads_figure,
    methods_figure,
    mouths_figure,
    response_figure,
)
from lampest.studies.paper.sides import Published, Side, all_sides, published_numbers
from lampest.studies.paper.tables import PublishedNumber, counts, csv_rows, sheet
from lampest.studies.study import Reported, comma_separated

PAGE, NUMBERS = "paper.html", "numbers.csv"
OURS = "lampest"
RESPONSE = (
    "The answer of one flat cell. lampest's curve was made to pass through the published numbers (orange); between and "
    "beyond them it is ours. In the inset, the published sensitivities are bars over their ranges."
)
BENDING = (
    "Left, Fig. 2-a: unloaded resistance of a bent cell; right, Fig. 2-d: its answer up to 40 kPa, of which the paper "
    "gives the ends (dots). lampest interpolates the logarithm. Fig. 2-b is a photograph of the set-up; of the three "
    "cycles of Fig. 2-c the text gives no numbers."
)
LOADS = (
    "What was measured of six loads, in the frame in which cells have moved furthest; below each map what the film "
    "feels there. The paper gives conditions, and no numbers of the maps."
)
METHODS = "Six maps of one frame of the large mouth; the paper's range stands below ours. All on the scale of ±100 %."
MOUTHS = (
    "A large and a small mouth. Covered are rows and columns with a cell that fell by more than half as much as the "
    "one that fell most."
)


def write_paper(numbers: Path | None, folder: Path, jobs: int | None, on_case: Callable[[int, int], None]) -> Reported:
    """Solve, draw and write all of it into a folder; what was solved there before is taken from it.

    numbers : a file of published ones, or None. Raises InputError where a shipped file is missing, a case fails, or the
    folder cannot be written.
    """
    published = published_numbers(numbers)
    return Reported((), write_page(folder, all_sides(shipped_folder(), folder, published, jobs, on_case), published))


@dataclass(frozen=True)
class Chapter:
    """A figure or table of the paper: title, place in it, sentence, tables, pictures."""

    title: str
    anchor: str
    place: str
    about: str
    sheets: tuple[tuple[str, Sheet], ...]
    pictures: tuple[Illustration, ...]


def write_page(folder: Path, sides: Sequence[Side], published: Published) -> tuple[Path, ...]:
    """Write paper.html, numbers.csv and every picture as PNG; returns their paths.

    Raises InputError where the folder cannot be written.
    """
    names = tuple(side.name for side in sides)
    numbers = [
        *tables.map_ranges(sides, published),
        *tables.covered_cells(sides, published),
        *tables.data_errors(sides, published),
    ]
    timed, own = tables.step_times(sides, published), tables.built_in(published, len(sides))
    pictures: list[Path] = []

    def drawn(figure: Figure, word: str, alternative: str, caption: str) -> Illustration:
        file = folder / f"{word}.png"
        save(figure, file)
        pictures.append(file)
        return Illustration(data_uri(figure, "png"), alternative, caption, True)

    with verbatim():
        chapters = (
            *_film(published, own, drawn),
            *_maps(sides, published, numbers, drawn),
            _table(numbers, timed, names, published),
        )
    text = filled("lampest.studies.paper", chapters=chapters, sides=sides, summary=_summary(numbers, names))
    write_whole(folder / PAGE, text)
    write_whole(folder / NUMBERS, comma_separated(csv_rows([*numbers, *timed, *own], names)))
    return (folder / PAGE, folder / NUMBERS, *pictures)


Drawn = Callable[[Figure, str, str, str], Illustration]


def _film(published: Published, own: Sequence[PublishedNumber], drawn: Drawn) -> tuple[Chapter, Chapter]:
    """Figures 1-e and 2."""
    first = sheet([row for row in own if row.figure.startswith("Fig. 1")], (OURS,))
    second = sheet([row for row in own if row.figure.startswith("Fig. 2")], (OURS,))
    response = drawn(response_figure(published), "fig1e", "Relative change over pressure, and its slope", RESPONSE)
    bending = drawn(bending_figure(published), "fig2", "Bent cells: resistance, and change under pressure", BENDING)
    return (
        Chapter(
            "The answer of a cell", "response", published.places["response"], "", (("The curve", first),), (response,)
        ),
        Chapter("A bent cell", "bending", published.places["bending"], "", (("Bent cells", second),), (bending,)),
    )


def _maps(
    sides: Sequence[Side], published: Published, numbers: Sequence[PublishedNumber], drawn: Drawn
) -> tuple[Chapter, ...]:
    """Figures 6, 8 and 9, one picture for each side."""
    names = tuple(side.name for side in sides)

    def maps(figure: Callable[[Side, Published], Figure], word: str, what: str, caption: str) -> list[Illustration]:
        beside = sides[:2] if word == "fig6" else sides  # the solver's scenes are those of the second side
        return [drawn(figure(side, published), f"{word}_{side.word}", f"Maps of {what}", caption) for side in beside]

    loads = maps(loads_figure, "fig6", "six loads", LOADS)
    methods = maps(methods_figure, "fig8", "six methods", METHODS)
    small = maps(mouths_figure, "fig9", "two mouths", MOUTHS)
    of_maps = [row for row in numbers if row.figure.startswith("Fig. 8")]
    of_mouths = [row for row in numbers if row.figure.startswith("Fig. 9")]
    return (
        Chapter("Six loads as measured", "loads", published.places["loads"], "", (), tuple(loads)),
        Chapter(
            "Six methods",
            "methods",
            published.places["ranges"],
            f"Of the ranges, {counts(of_maps, names)}",
            (("Ranges of the maps", sheet(of_maps, names)),),
            tuple(methods),
        ),
        Chapter(
            "Two mouths",
            "mouths",
            published.places["mouths"],
            f"Of rows and columns, {counts(of_mouths, names)}",
            (("Cells covered", sheet(of_mouths, names)),),
            tuple(small),
        ),
    )


def _table(
    numbers: Sequence[PublishedNumber], timed: Sequence[PublishedNumber], names: Sequence[str], published: Published
) -> Chapter:
    """Table I."""
    rows = [row for row in numbers if row.figure == "Table I"]
    sheets = (("Data errors |f(r) − R|/R", sheet(rows, names)), ("Time of a step", sheet(timed, names)))
    about = f"Of the errors, {counts(rows, names)} Times are those of another program on another machine."
    return Chapter("Errors and times", "errors", published.places["errors"], about, sheets, ())


def _summary(numbers: Sequence[PublishedNumber], names: Sequence[str]) -> str:
    """The checked numbers: the ranges of figure 8 and the mean errors of table I."""
    checked = [row for row in numbers if row.figure.startswith("Fig. 8") or row.quantity.endswith("data error")]
    return f"Of the twelve ranges of Fig. 8 and the seven mean errors of Table I, {counts(checked, names)}"
