"""The command line: parse, call, print. Libraries are imported by the command that needs them."""

import inspect
import os
import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer

from lampest.cli import board, estimation, results, start, studies
from lampest.cli.screen import INTERRUPTED, WRONG_INPUT, is_written, say
from lampest.files.errors import InputError
from lampest.files.interrupts import ending_signals
from lampest.files.log import libraries_to_the_log
from lampest.files.memory import allow_memory
from lampest.files.whole import refuse_input, sparing
from lampest.runs.executors import ONE_THREAD

app = typer.Typer(
    help="Cell resistances of passive resistive matrix sensors from two-point measurements.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
_MEMORY = typer.Option("--memory", metavar="SIZE", help="Memory it may take, such as 8GB; else most of what is free.")


EXAMPLES = {
    "init": "lampest init mine",
    "run": "lampest run run.yaml --set formulation=reduced --jobs 2",
    "starts": "lampest starts run.yaml --random 50",
    "tune": "lampest tune run.yaml --out results/tune",
    "simulate": "lampest simulate simulation.yaml --set seed=2 --out second.h5",
    "import": "lampest import mine.csv --scene scene.yaml --baseline 3 --out mine.h5",
    "tare": "lampest tare mine.h5 --frames 40:50 --out tared.h5",
    "compare": "lampest compare results/run/results.h5 --report page.html",
    "plot": "lampest plot results/run/results.h5 --frame 12 --estimator LSM --out one.svg",
    "detect": "lampest detect results/run/results.h5 --depth 50",
    "terms": "lampest terms",
    "schema": "lampest schema > lampest.schema.json",
    "info": "lampest info mine.h5",
    "check": "lampest check mine.h5 results/run/results.h5",
    "ports": "lampest ports",
    "record": "lampest record --out today.h5 --scene scene.yaml --baseline 3 --seconds 60",
    "repair": "lampest repair today.h5",
    "calibrate": "lampest calibrate known.h5 --known known.csv --out scene.yaml",
    "export": "lampest export results/run/results.h5 --to csv",
    "live": "lampest live --recording example.h5 --speed 2",
    "bench": "lampest bench bench.yaml --set sizes=[10]",
    "tradeoff": "lampest tradeoff tradeoff.yaml",
    "extremes": "lampest extremes extremes.yaml",
    "audit": "lampest audit audit.yaml",
    "paper": "lampest paper --out results/paper",
}


def _print_version(asked: bool) -> None:
    """Print the version and end."""
    if asked:
        from importlib.metadata import version

        say(f"lampest {version('lampest')}")
        raise typer.Exit


@app.callback(help=app.info.help)
def _about(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and end.")
    ] = False,
) -> None:
    """What stands before a command."""


def _guarded(command: Callable[..., None]) -> Callable[..., None]:
    """The command with the option --memory; it writes over no file that it was told to read."""
    signature = inspect.signature(command, eval_str=True)
    outputs = {name for name, each in signature.parameters.items() if is_written(each.annotation)}

    @wraps(command)
    def called(memory: str | None = None, **options: Any) -> None:
        if memory is not None:
            allow_memory(memory)
        places = {name: _paths(value) for name, value in options.items()}
        with sparing([path for name, paths in places.items() if name not in outputs for path in paths]):
            for path in (path for name in outputs for path in places.get(name, ())):
                refuse_input(path)
            command(**options)

    kind = Annotated[str | None, _MEMORY]
    memory = inspect.Parameter("memory", inspect.Parameter.KEYWORD_ONLY, default=None, annotation=kind)
    signature = signature.replace(parameters=[*signature.parameters.values(), memory])
    called.__signature__ = signature  # type: ignore[attr-defined]
    return called


def _paths(value: object) -> list[Path]:
    """What an option names of files and folders."""
    return [each for each in (value if isinstance(value, list) else [value]) if isinstance(each, Path)]


for _command in (
    start.init,
    estimation.run,
    estimation.starts,
    estimation.tune,
    estimation.simulate,
    estimation.import_,
    estimation.tare,
    results.compare,
    results.plot,
    results.export,
    results.detect,
    results.terms,
    results.schema,
    results.info,
    results.check,
    board.ports,
    board.record,
    board.repair,
    board.calibrate,
    board.live,
    studies.bench,
    studies.tradeoff,
    studies.extremes,
    studies.audit,
    studies.paper,
):
    _small = _command in (results.terms, results.schema, board.ports)
    _name = _command.__name__.rstrip("_")
    _epilog = f"Example: {EXAMPLES[_name]}" if _name in EXAMPLES else None
    app.command(_name, epilog=_epilog)(_command if _small else _guarded(_command))


def main() -> None:
    """Run the command; input errors end with code 2 and one sentence, Ctrl-C and its kin with 130."""
    os.environ.update({name: value for name, value in ONE_THREAD.items() if name not in os.environ})
    try:
        with ending_signals(), libraries_to_the_log():
            app()
    except InputError as error:
        say(f"lampest: {error}", to=sys.stderr)
        sys.exit(WRONG_INPUT)
    except MemoryError as error:
        said = " ".join(str(error).split()) or "no more is said"
        say(f"lampest: more memory is needed than there is ({said})", to=sys.stderr)
        sys.exit(WRONG_INPUT)
    except SystemExit as end:
        if end.code == INTERRUPTED:
            say("lampest: interrupted; what was finished is kept", to=sys.stderr)
        raise
