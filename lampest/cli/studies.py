"""Commands that measure lampest itself: `lampest study ...`."""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lampest.cli.screen import Assign, Folder, option, progress, say, warn
from lampest.cli.tables import print_table

if TYPE_CHECKING:
    from lampest.studies.study import Reported, Study

Config = Annotated[Path | None, typer.Argument(metavar="[CONFIG]", help="The study's YAML file; else the shipped one.")]
# Word → the module of the study, and what it says of itself. A further study is a module with its STUDY, named here.
STUDIES = {
    "bench": (
        "lampest.studies.bench_report",
        """Compare solvers over panel sizes: time, accuracy, memory, growth; reduced, nodal, scipy's.

        Writes bench.csv (a row for every panel, method, solver and first, joint or later frames), growth.csv,
        bench.md and bench.h5 with every sample. What the file's limits or its budget leave out is named.
        """,
    ),
    "tradeoff": (
        "lampest.studies.tradeoff_report",
        "Measure what every rung of the ladder of formulations costs in time and in accuracy; table, HDF5 and figure.",
    ),
    "extremes": (
        "lampest.studies.extremes.report",
        "Solve scenes at the edge of what can be measured and say how each ended; table, HDF5 and heat map.",
    ),
    "audit": (
        "lampest.studies.audit",
        "Count how often error bars cover the truth where electronics, films or animals do what no scene states.",
    ),
}


def study_command(word: str) -> Callable[..., None]:
    """The command of a study."""
    module, about = STUDIES[word]

    def command(config: Config = None, out: Folder = None, assign: Assign = None) -> None:
        _run(import_module(module).STUDY, config, out, assign)

    command.__name__, command.__doc__ = word, about
    return command


def weights(
    config: Config = None,
    out: Folder = None,
    withhold: Annotated[
        float | None, option("--withhold", "Predict this share of the readings from all others, such as 0.1.")
    ] = None,
    draws: Annotated[int, option("--draws", "How often readings are drawn to be withheld.", min=1)] = 5,
    seed: Annotated[int, option("--seed", "Of the draws: the same seed, the same draws.")] = 0,
    assign: Assign = None,
) -> None:
    """Draw what weight: auto does: evidence, misfit, penalty and true error over λ, with every rule's choice.

    With --withhold, for recordings whose truth nobody knows: how well weights predict readings that are withheld.
    """
    from lampest.studies.weights_report import STUDY
    from lampest.studies.withheld import withheld_study

    _run(STUDY if withhold is None else withheld_study(withhold, draws, seed), config, out, assign)


def starts(
    config: Annotated[Path | None, typer.Argument(metavar="[CONFIG]", help="A run's YAML file; else table1's.")] = None,
    out: Folder = None,
    random: Annotated[int, option("--random", "Random starts for every frame.", min=1)] = 20,
    seed: Annotated[int, option("--seed", "Of the random starts: the same seed, the same starts.")] = 0,
    assign: Assign = None,
) -> None:
    """Say how often every case of a run reaches the best objective known from random starts; writes starts.csv."""
    from lampest.studies.starts import starts_study

    _run(starts_study(random, seed), config, out, assign)


def _run(study: "Study[Any, Any]", config: Path | None, out: Path | None, assign: list[str] | None) -> None:
    with progress(study.counts) as on_step:
        reported = study.run(config, out, tuple(assign or ()), on_step)
    print_reported(reported)


def paper(
    config: Annotated[
        Path | None, typer.Argument(metavar="[CONFIG]", help="Published numbers; else lampest's.")
    ] = None,
    out: Annotated[Path, option("--out", "Folder of the output.")] = Path("results/paper"),
    jobs: Annotated[int | None, option("--jobs", "Processes here; else all cores.", min=1)] = None,
) -> None:
    """Draw the paper's figures and its table from shipped recordings, each beside the published numbers.

    Writes paper.html with everything in it, numbers.csv and every picture as PNG.
    """
    from lampest.studies.paper.page import write_paper

    with progress("cases") as on_case:
        reported = write_paper(config, out, jobs, on_case)
    print_reported(reported)


def print_reported(reported: "Reported") -> None:
    """Tables, remarks and files of a study; what was left out on stderr."""
    for title, table in reported.tables:
        if title:
            say(title)
        print_table(table)
    for line in (*reported.remarks, *reported.files):
        say(line)
    for sentence in reported.left_out:
        warn(sentence)
