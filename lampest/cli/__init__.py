"""The command line: parse, call, print. Libraries are imported by the command that needs them."""

import os
import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer

from lampest.cli import board, estimation, results, studies
from lampest.cli.screen import (
    INTERRUPTED,
    WRONG_INPUT,
    as_options,
    documented,
    is_written,
    say,
    warn,
)
from lampest.files.errors import InputError, extra
from lampest.files.process import (
    ONE_THREAD,
    check_address_space,
    ending_signals,
    libraries_to_the_log,
)
from lampest.files.whole import refuse_inputs, sparing

app = typer.Typer(
    help="Estimate the cell resistances of resistive matrix sensors from readings with crosstalk.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    epilog="More: lampest show --help (cost terms, schema), lampest study --help (measurements of "
    "lampest itself)",
)


def _print_version(requested: bool) -> None:
    """Print the version and end, if requested."""
    if requested:
        from importlib.metadata import version

        say(f"lampest {version('lampest')}")
        raise typer.Exit


@app.callback(help=app.info.help)
def _about(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and end."
        ),
    ] = False,
) -> None:
    """Accept the options that precede a command."""


def _guarded(command: Callable[..., None]) -> Callable[..., None]:
    """Return the command with checks that its input files exist and that it overwrites none.

    Whether they exist is checked before libraries load.
    """
    about, signature = documented(command)
    outputs = {name for name, parameter in signature.parameters.items() if is_written(parameter)}

    def called(**options: Any) -> None:
        check_address_space()
        values = [value for name, value in options.items() if name not in outputs]
        for value in tuple(values):
            if isinstance(value, list):
                values += value
        inputs = [path for path in values if isinstance(path, Path)]
        if command is not estimation.init:  # which creates its folder
            for path in inputs:
                if not path.exists():
                    raise InputError(f"{path}: no such file")
        replaced = options.get("repair") or options.get("apply")  # these rewrite their inputs
        with sparing(() if replaced else inputs):
            refuse_inputs(
                [options[name] for name in outputs if isinstance(options.get(name), Path)]
            )
            command(**options)

    called.__doc__ = about
    called.__signature__ = signature  # type: ignore[attr-defined]
    return called


def _renamed(old: str, new: str) -> Callable[..., None]:
    """Return a command under its name of the previous release.

    It prints the new name and sets the flag in it.
    """
    name, _, flag = new.partition(" --")
    command = _guarded(COMMANDS[name][1])

    @wraps(command)
    def called(**options: Any) -> None:
        warn(f"{old} is now: lampest {new}; the old name works for one more release")
        command(**options | ({FLAGS[flag]: True} if flag else {}))

    return called


# Name → (part of the help, command, example).
COMMANDS: dict[str, tuple[str, Callable[..., None], str]] = {
    "init": ("Begin", estimation.init, "mine"),
    "import": (
        "Begin",
        estimation.import_,
        "mine.csv --scene scene.yaml --baseline 3 --out mine.h5",
    ),
    "simulate": ("Begin", estimation.simulate, "simulation.yaml --set seed=2 --out second.h5"),
    "tare": ("Begin", estimation.tare, "mine.h5 --frames 40:50 --out tared.h5"),
    "run": ("Reconstruct", estimation.run, "run.yaml --set formulation=reduced --jobs 2"),
    "detect": ("Reconstruct", results.detect, "mine.h5 --json"),
    "info": ("Look", results.info, "mine.h5 --picture mine.png"),
    "compare": ("Look", results.compare, "results/run/results.h5 --report page.html"),
    "plot": (
        "Look",
        results.plot,
        "results/run/results.h5 --frame 12 --estimator LSM --out one.svg",
    ),
    "export": ("Look", results.export, "results/run/results.h5 --to csv"),
    "check": ("Look", results.check, "mine.h5 results/run/results.h5"),
    "show terms": ("Look", results.terms, ""),
    "show schema": ("Look", results.schema, "> lampest.schema.json"),
    "record": (
        "Board",
        board.record,
        "--out today.h5 --scene scene.yaml --baseline 3 --seconds 60",
    ),
    "live": ("Board", board.live, "--recording example.h5 --speed 2"),
    "calibrate": ("Board", board.calibrate, "known.h5 --known known.csv --out scene.yaml"),
    **{
        f"study {word}": ("Study", studies.study_command(word), f"{word}.yaml --out results/mine")
        for word in studies.STUDIES
    },
    "study paper": ("Study", studies.paper, "--out results/paper"),
}
OLD = {  # word of the previous release → new name
    "ports": "record --list",
    "repair": "check --repair",
    "tune": "study weights",
    **{word: f"study {word}" for word in ("bench", "tradeoff", "extremes", "paper")},
    **{word: f"show {word}" for word in ("terms", "schema")},
}
FLAGS = {"list": "list_", "repair": "repair"}  # of new names → parameters
GROUPS = {
    "show": "List what a run file may contain: cost terms, or its JSON schema.",
    "study": "Measure lampest itself: solvers, formulations, extremes, weights, the paper.",
}


def _build() -> None:
    """Add all commands and groups in the parts of the help.

    Then add the hidden words of the previous release.
    """
    groups: dict[str, typer.Typer] = {"": app}

    def add(
        group: str, word: str, command: Callable[..., None], example: str, **further: Any
    ) -> None:
        groups[group].command(word, epilog=f"Example: lampest {example}".rstrip(), **further)(
            command
        )

    for name, (part, command, example) in COMMANDS.items():
        group, _, word = name.rpartition(" ")
        if group not in groups:
            groups[group] = typer.Typer(no_args_is_help=True, help=GROUPS[group])
            epilog = f"Example: lampest {name} {example}".rstrip()
            app.add_typer(
                groups[group], name=group, epilog=epilog, rich_help_panel=part, hidden=True
            )
        add(
            group,
            word,
            _guarded(command),
            f"{name} {example}",
            rich_help_panel=None if group else part,
        )
    for old, new in OLD.items():
        add("", old, _renamed(old, new), new, hidden=True)


def _program() -> Any:
    """Return the program; its help names no type for options without a value."""
    program = typer.main.get_command(app)
    waiting = [program]
    while waiting:
        command = waiting.pop()
        waiting += getattr(command, "commands", {}).values()
        for parameter in command.get_params(command.context_class(command)):
            if getattr(parameter, "is_flag", False):
                parameter.metavar = ""
    return program


_build()


NO_THREAD = "can't start new thread"  # the words of Python's RuntimeError


def main() -> None:
    """Run the command.

    Input errors end with code 2 and one sentence, Ctrl-C and similar signals with 130.
    """
    os.environ.update({name: value for name, value in ONE_THREAD.items() if name not in os.environ})
    try:
        with ending_signals(), libraries_to_the_log(), extra():
            _program()()
    except InputError as error:
        warn(as_options(str(error)))
        sys.exit(WRONG_INPUT)
    except MemoryError as error:
        message = " ".join(str(error).split()) or "no details"
        warn(f"not enough memory ({message})")
        sys.exit(WRONG_INPUT)
    except RuntimeError as error:
        if str(error) != NO_THREAD:
            raise
        warn(
            "cannot start a further thread: this user's processes and threads are at their limit "
            "(ulimit -u)"
        )
        sys.exit(WRONG_INPUT)
    except SystemExit as end:
        if end.code == INTERRUPTED:
            warn("interrupted; what was finished is kept")
        raise
