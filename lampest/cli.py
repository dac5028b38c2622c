"""The command line: parse, call, print. Libraries are imported by the command that needs them."""

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lampest.errors import InputError
from lampest.executors import ONE_THREAD

if TYPE_CHECKING:
    from lampest.compare import Table

WRONG_INPUT, SOME_FAILED, INTERRUPTED = 2, 3, 130

app = typer.Typer(
    help="Cell resistances of passive resistive matrix sensors from two-point measurements.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
Out = Annotated[Path | None, typer.Option("--out", help="Where the output goes.")]


@app.command()
def run(
    config: Annotated[Path, typer.Argument(help="The run's YAML file.")],
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder of the results; results/<config> by default.")
    ] = None,
    assign: Annotated[list[str] | None, typer.Option("--set", help="PATH=VALUE, overrides one entry.")] = None,
    jobs: Annotated[int | None, typer.Option("--jobs", min=1, help="Processes; all cores by default.")] = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Solve again what is done.")] = False,
) -> None:
    """Reconstruct recordings with every estimator of a run's file; cases that are done are skipped."""
    from lampest.batch import run_batch
    from lampest.config import read_run
    from lampest.executors import Processes, Serial

    cases = read_run(config, tuple(assign or ()))
    workers = min(jobs or len(os.sched_getaffinity(0)), len(cases.cases))
    executor = Serial() if workers == 1 else Processes(workers)
    with progress("cases") as on_case:
        report = run_batch(cases, out or Path("results") / config.stem, executor, fresh, on_case)
    print(
        f"{report.done} cases solved, {report.skipped} were done before, {len(report.failed)} failed: {report.results}"
    )
    for name, sentence in report.failed:
        print(f"lampest: {name} failed: {sentence}", file=sys.stderr)
    if report.failed:
        raise typer.Exit(SOME_FAILED)


@app.command()
def simulate(
    config: Annotated[Path, typer.Argument(help="The simulation's YAML file.")],
    out: Annotated[Path | None, typer.Option("--out", help="The recording, or a folder where the file sweeps.")] = None,
) -> None:
    """Make recordings with their truth from a scene."""
    from lampest.simulate import run as run_simulation

    for path in run_simulation(config, out):
        print(path)


@app.command("import")
def import_(
    file: Annotated[Path, typer.Argument(help="CSV, .npy or .mat.")],
    rows: Annotated[int, typer.Option("--rows", min=1)],
    columns: Annotated[int, typer.Option("--columns", min=1)],
    out: Annotated[Path, typer.Option("--out", help="The recording that is written.")],
    scene: Annotated[Path | None, typer.Option("--scene", help="YAML file of the scene.")] = None,
    unit: Annotated[str, typer.Option("--unit", help="ohm, volt or code.")] = "ohm",
    baseline: Annotated[int, typer.Option("--baseline", min=0, help="The first so many frames are unloaded.")] = 0,
    transpose: Annotated[bool, typer.Option("--transpose", help="Rows and columns of the file are swapped.")] = False,
    variable: Annotated[str | None, typer.Option("--variable", help="The variable of a .mat file.")] = None,
) -> None:
    """Turn a table of two-point measurements into a recording."""
    from lampest.importing import import_file, read_scene

    recording, notes = import_file(
        file, rows, columns, read_scene(scene) if scene else None, unit, baseline, transpose, variable
    )
    recording.save(out)
    for note in notes:
        print(note)
    print(out)


@app.command()
def compare(
    results: Annotated[list[Path], typer.Argument(help="Results files.")],
    csv: Annotated[Path | None, typer.Option("--csv", help="Write the table to this file too.")] = None,
) -> None:
    """Table over methods and recordings: times, data errors, cell errors, published figures."""
    from lampest.compare import compare_files, screen_table, write_csv

    rows = compare_files(results)
    if csv:
        write_csv(csv, rows)
    print_table(screen_table(rows))


@app.command()
def plot(results: Annotated[Path, typer.Argument(help="A results file.")], out: Out = None) -> None:
    """Mapping contours of every recording, side by side."""
    from lampest.plot import plot_results

    for path in plot_results(results, out):
        print(path)


@app.command()
def terms() -> None:
    """List the cost terms with their formulas, units and options."""
    import dataclasses

    from lampest.compare import Table
    from lampest.terms import term_types

    rows = []
    for kind, term in term_types().items():
        options = ", ".join(
            f"{field.name}: {getattr(field.default, 'kind', field.default)}"
            for field in dataclasses.fields(term)
            if field.name != "kind"
        )
        rows.append((kind, " ".join((term.__doc__ or "").split("\n\n")[0].split()), term.unit, options))
    print_table(Table(("term", "residual", "unit", "options and defaults"), tuple(rows)))


@app.command()
def schema() -> None:
    """Print the JSON schema of a run's file."""
    import json

    from lampest.config import json_schema

    print(json.dumps(json_schema(), indent=2))


@app.command()
def info(file: Annotated[Path, typer.Argument(help="A recording or a results file.")]) -> None:
    """Say what a file holds and draw the first frame as a small map."""
    from lampest.info import describe

    for line in describe(file):
        print(line)


def print_table(table: "Table") -> None:
    """Draw a table; as wide as the terminal, or as it needs where the output is no terminal."""
    from rich import box
    from rich.console import Console
    from rich.table import Table as RichTable

    drawn = RichTable(*table.headers, box=box.SIMPLE)
    for cells in table.cells:
        drawn.add_row(*cells)
    Console(width=None if sys.stdout.isatty() else 200, highlight=False, markup=False).print(drawn)


class progress:  # noqa: N801
    """A progress bar on stderr, silent where that is no terminal."""

    def __init__(self, what: str) -> None:
        from rich.console import Console
        from rich.progress import Progress

        self._bar = Progress(console=Console(stderr=True), disable=not sys.stderr.isatty())
        self._task = self._bar.add_task(what, total=None)

    def __enter__(self) -> Any:
        self._bar.__enter__()
        return lambda done, total: self._bar.update(self._task, completed=done, total=total)

    def __exit__(self, *error: Any) -> None:
        self._bar.__exit__(*error)


def main() -> None:
    """Run the command; input errors end with code 2 and one sentence, Ctrl-C with 130."""
    os.environ.update({name: value for name, value in ONE_THREAD.items() if name not in os.environ})
    try:
        app()
    except InputError as error:
        print(f"lampest: {error}", file=sys.stderr)
        sys.exit(WRONG_INPUT)
    except SystemExit as end:
        if end.code == INTERRUPTED:
            print("lampest: interrupted; what was finished is kept", file=sys.stderr)
        raise
