"""Commands that measure lampest itself: `lampest study ...`."""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lampest.cli import screen

if TYPE_CHECKING:
    from lampest.apps.studies.study import Study

Config = Annotated[Path | None, typer.Argument(metavar="[CONFIG]")]
# Word → module of the study, and its help text. To add a study, write a module with its STUDY, add
# it here, and name its command in the application.
STUDIES = {
    "bench": (
        "lampest.apps.studies.bench",
        """Compare solvers over panel sizes: time and accuracy; reduced and nodal.

        Writes bench.csv (a row for every panel, method, solver and first, joint or later frames),
        bench.md and bench.h5 with every frame. Panels beyond the file's limits are named.
        """,
    ),
    "tradeoff": (
        "lampest.apps.studies.tradeoff",
        "Measure accuracy against speed of all formulations; table, HDF5 and figure.",
    ),
    "extremes": (
        "lampest.apps.studies.extremes",
        "Solve scenes at the limits of measurement and report how each ended; table and HDF5.",
    ),
}


PARAMETERS = """

        Parameters
        ----------
        config
            The study's YAML file; else the shipped one.
        out
            Output folder. Default: results/<config>.
        """


def study_command(word: str) -> Callable[..., None]:
    """Return the command of a study."""
    module, about = STUDIES[word]

    def command(
        config: Config = None, out: screen.Output = None, assign: screen.Assign = None
    ) -> None:
        run_study(import_module(module).STUDY, config, out, assign)

    command.__name__ = word
    command.__doc__ = f"{about}{PARAMETERS}"
    return command


bench, tradeoff, extremes = map(study_command, STUDIES)


def run_study(
    study: "Study[Any, Any]", config: Path | None, out: Path | None, assign: list[str] | None
) -> None:
    """Run a study; print its tables, remarks and files, and omissions on stderr."""
    with screen.progress(study.counts) as on_step:
        reported = study.run(config, out, tuple(assign or ()), on_step)
    for title, table in reported.tables:
        if title:
            screen.say(title)
        screen.print_table(table)
    for line in (*reported.remarks, *reported.files):
        screen.say(line)
    for sentence in reported.left_out:
        screen.warn(sentence)
