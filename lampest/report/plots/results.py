"""Pictures of a results file, one file each."""

from collections.abc import Iterator
from pathlib import Path
from typing import Literal

from matplotlib.figure import Figure

from lampest.files.errors import InputError
from lampest.report.plots.certainty import certainty
from lampest.report.plots.contours import SUFFIXES, contours, save
from lampest.report.plots.pressure import pressure_figure
from lampest.report.plots.report import verbatim
from lampest.runs.results import Results, read_results

Show = Literal["contours", "certainty", "pressure"]


def plot_results(path: str | Path, out: str | Path | None = None, show: Show = "contours") -> list[Path]:
    """Draw every recording of a results file into <show>_<recording>.png in the folder `out`, else beside the file.

    Pressures are drawn for every estimator apart, <recording>_<estimator>. `out` may name a .png or .pdf file where
    there is one picture. Returns the files that were written.
    Raises InputError where the results cannot be read, hold nothing to draw, or the place cannot be written.
    """
    path = Path(path)
    results = read_results(path)
    target = path.parent if out is None else Path(out)
    with verbatim():
        pictures = list(_pictures(results, show))
        if not pictures:
            raise InputError(f"{path}: holds no {'results' if show == 'contours' else show} to draw")
        if target.suffix in SUFFIXES and len(pictures) > 1:
            raise InputError(f"{target}: one picture cannot hold {len(pictures)}; name a folder instead")
        written = []
        for name, figure in pictures:
            file = target if target.suffix in SUFFIXES else target / f"{show}_{name}.png"
            save(figure, file)
            written.append(file)
    return written


def _pictures(results: Results, show: Show) -> Iterator[tuple[str, Figure]]:
    for recording in results.recordings():
        if show == "contours":
            yield recording, contours(results, recording)
        elif show == "certainty":
            yield recording, certainty(results, recording)
        else:
            for case in results.of(recording):
                if case.pressure is not None:
                    yield f"{recording}_{case.estimator}", pressure_figure(case)
