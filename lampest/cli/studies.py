"""Commands that measure lampest itself."""

from pathlib import Path
from typing import Annotated

import typer

from lampest.cli.screen import Assign, Folder, progress, say
from lampest.cli.tables import print_table


def bench(
    config: Annotated[Path, typer.Argument(help="The benchmark's YAML file.")],
    out: Folder = None,
    assign: Assign = None,
) -> None:
    """Compare solvers over panel sizes: time, accuracy, memory, growth; reduced, nodal, scipy's, published ones.

    Writes bench.csv (a row for every panel, method, solver and first, joint or later frames), growth.csv, mats.csv,
    bench.md and bench.h5 with every sample. What the file's limits or its budget leave out is named.
    """
    from lampest.studies.bench.files import tables, write_bench
    from lampest.studies.bench.report import bench_remarks
    from lampest.studies.bench.run import run_bench
    from lampest.studies.bench.settings import read_bench

    settings = read_bench(config, tuple(assign or ()))
    with progress("methods") as on_step:
        found = run_bench(settings, on_step)
    files = write_bench(out or Path("results") / config.stem, found, settings)
    for title, table in tables(found):
        say(title)
        print_table(table)
    for line in (*bench_remarks(found, settings), *files):
        say(line)


def tradeoff(
    config: Annotated[Path, typer.Argument(help="The trade-off's YAML file.")],
    out: Folder = None,
    assign: Assign = None,
) -> None:
    """Measure what every rung of the ladder of formulations costs in time and in accuracy; table, HDF5 and figure."""
    from lampest.studies.tradeoff.figure import plot_tradeoff
    from lampest.studies.tradeoff.report import tradeoff_table, write_tradeoff
    from lampest.studies.tradeoff.run import run_tradeoff
    from lampest.studies.tradeoff.settings import read_plan

    plan = read_plan(config, tuple(assign or ()))
    with progress("measurements") as on_step:
        found = run_tradeoff(plan, on_step)
    folder = out or Path("results") / config.stem
    files = (*write_tradeoff(folder, found), plot_tradeoff(found, folder / "tradeoff.png"))
    print_table(tradeoff_table(found))
    for file in files:
        say(file)


def extremes(
    config: Annotated[Path, typer.Argument(help="The atlas' YAML file.")],
    out: Folder = None,
    assign: Assign = None,
) -> None:
    """Solve scenes at the edge of what can be measured and tell how each ended; table, HDF5 and heat map."""
    from lampest.studies.extremes.figure import plot_extremes
    from lampest.studies.extremes.report import atlas_remarks, atlas_table, write_atlas
    from lampest.studies.extremes.run import run_atlas
    from lampest.studies.extremes.settings import read_atlas

    atlas = read_atlas(config, tuple(assign or ()))
    with progress("scenes") as on_step:
        found = run_atlas(atlas, on_step)
    folder = out or Path("results") / config.stem
    files = (*write_atlas(folder, found), plot_extremes(found, folder / "extremes.png"))
    print_table(atlas_table(found))
    for line in (*atlas_remarks(found), *files):
        say(line)


def audit(
    config: Annotated[Path, typer.Argument(help="The audit's YAML file.")],
    out: Folder = None,
    assign: Assign = None,
) -> None:
    """Count how often error bars hold the truth where electronics, films or animals do what no scene tells."""
    from lampest.studies.audit.report import audit_remarks, audit_table, write_audit
    from lampest.studies.audit.run import run_audit
    from lampest.studies.audit.settings import read_audit

    settings = read_audit(config, tuple(assign or ()))
    with progress("recordings") as on_step:
        found = run_audit(settings, on_step)
    files = write_audit(out or Path("results") / config.stem, found)
    print_table(audit_table(found))
    for line in (*audit_remarks(found), *files):
        say(line)


def paper(
    out: Annotated[Path, typer.Option("--out", help="Folder of the output.")] = Path("results/paper"),
    jobs: Annotated[int | None, typer.Option("--jobs", min=1, help="Processes here; else all cores.")] = None,
) -> None:
    """Draw the paper's figures and its table from shipped recordings, each beside the published numbers.

    Writes paper.html with everything in it, numbers.csv and every picture as PNG.
    """
    from lampest.studies.paper.run import write_paper

    with progress("cases") as on_case:
        files = write_paper(out, jobs, on_case)
    for file in files:
        say(file)
