"""Pictures of a results file, one file each."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from lampest.files.errors import InputError
from lampest.report.plots import plot_of
from lampest.report.plots.plot import Plot
from lampest.report.plots.style import SUFFIXES, save, verbatim
from lampest.runs.columns import Column
from lampest.runs.results import Results, read_results


def plot_results(
    path: str | Path, out: str | Path | None = None, show: str | Plot = "contours", columns: Sequence[Column] = ()
) -> list[Path]:
    """Draw every recording of a results file into <kind>_<recording>.png in the folder `out`, else beside the file.

    What is drawn for every estimator apart goes to <kind>_<recording>_<estimator>.png. `out` may name a .png or .pdf
    file where there is one picture. columns : as `read_results` takes them. Returns the files that were written.
    Raises InputError where there is no such plot, the results cannot be read or hold nothing to draw, or the place
    cannot be written.
    """
    plot = plot_of(show) if isinstance(show, str) else show
    path = Path(path)
    results = read_results(path, columns)
    target = path.parent if out is None else Path(out)
    with verbatim():
        pictures = list(_pictures(results, plot))
        if not pictures:
            wanted = f", which needs {', '.join(plot.needs)}" if plot.needs else ""
            raise InputError(f"{path}: holds no {plot.kind} to draw{wanted}")
        if target.suffix in SUFFIXES and len(pictures) > 1:
            raise InputError(f"{target}: one picture cannot hold {len(pictures)}; name a folder instead")
        written = []
        for name, figure in pictures:
            file = target if target.suffix in SUFFIXES else target / f"{plot.kind}_{name}.png"
            save(figure, file)
            written.append(file)
    return written


def _pictures(results: Results, plot: Plot) -> Iterator[tuple[str, Figure]]:
    for recording in results.recordings():
        cases = plot.drawable(results.of(recording))
        if plot.apart:
            for case in cases:
                yield f"{recording}_{case.estimator}", plot.draw((case,))
        elif cases:
            yield recording, plot.draw(cases)
