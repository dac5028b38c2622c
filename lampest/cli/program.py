"""The program: commands of the core and of applications, with their help and their checks."""

from collections.abc import Callable
from copy import copy
from pathlib import Path
from typing import Annotated, Any

import typer
import typer.core

from lampest.cli import estimation
from lampest.cli.screen import documented, is_written, say, warn
from lampest.files.applications import Command, applications, loaded
from lampest.files.errors import InputError
from lampest.files.process import check_address_space
from lampest.files.whole import refuse_inputs, sparing

app = typer.Typer(
    help="Estimate the cell resistances of resistive matrix sensors from readings with crosstalk.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    epilog="More: lampest show --help (cost terms, schema), "
    "lampest study --help (measurements of lampest itself)",
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
        inputs = [
            path
            for name, value in options.items()
            for path in (value if isinstance(value, list) else [value])
            if isinstance(path, Path) and name not in outputs
        ]
        for path in inputs:
            if not path.exists() and command is not estimation.init:  # which creates its folder
                raise InputError(f"{path}: no such file")
        import numpy as np  # not needed by help

        # SciPy takes every name of NumPy; this one would load a compiler of Fortran.
        vars(np).setdefault("f2py", None)
        replaced = options.get("repair") or options.get("apply")  # these rewrite their inputs
        with sparing(() if replaced else inputs):
            written = map(options.get, outputs)
            refuse_inputs([path for path in written if isinstance(path, Path)])
            command(**options)

    called.__doc__ = about
    called.__signature__ = signature  # type: ignore[attr-defined]
    return called


class StarterCommand(typer.core.TyperCommand):
    """The command `init`, whose help ends with the words of circuits, one line each."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help; the circuits are read for it alone."""
        from lampest.runs.starter import circuits

        lines = (f"{word}: {circuit.line}" for word, circuit in circuits().items())
        listing = copy(self)
        listing.epilog = "\n\n".join(("Circuits:", *lines, "", self.epilog or ""))
        super(StarterCommand, listing).format_help(ctx, formatter)


# The core's commands. Those of applications follow.
CORE: dict[str, Command] = {
    name: Command(part=part, target=target, example=example)
    for name, part, target, example in (
        ("init", "Begin", "lampest.cli.estimation:init", "mine"),
        (
            "simulate",
            "Begin",
            "lampest.cli.estimation:simulate",
            "simulation.yaml --set seed=2 --out second.h5",
        ),
        ("tare", "Begin", "lampest.cli.estimation:tare", "mine.h5 --frames 40:50 --out tared.h5"),
        (
            "run",
            "Reconstruct",
            "lampest.cli.estimation:run",
            "run.yaml --set formulation=reduced --jobs 2",
        ),
        ("info", "Look", "lampest.cli.results:info", "mine.h5 --picture mine.png"),
        (
            "compare",
            "Look",
            "lampest.cli.results:compare",
            "results/run/results.h5 --report page.html",
        ),
        (
            "plot",
            "Look",
            "lampest.cli.results:plot",
            "results/run/results.h5 --frame 12 --estimator LSM --out one.svg",
        ),
        ("export", "Look", "lampest.cli.results:export", "results/run/results.h5 --to csv"),
        ("check", "Look", "lampest.cli.results:check", "mine.h5 results/run/results.h5"),
        ("show terms", "Look", "lampest.cli.results:terms", ""),
        ("show schema", "Look", "lampest.cli.results:schema", "> lampest.schema.json"),
    )
}
GROUPS = {"show": "List what a run file may contain: cost terms, or its JSON schema."}
PARTS = ("Begin", "Reconstruct", "Look", "Board", "Study")  # in this order, then those of others


def _build() -> None:
    """Add the commands of the core and of applications, in the parts of the help."""
    others = applications().usable.values()
    commands = dict(CORE)
    for other in others:
        for name, added in other.commands.items():
            if commands.setdefault(name, added) is not added:
                warn(f"the application '{other.name}': there is a command '{name}' already")
    abouts = GROUPS | {name: about for other in others for name, about in other.groups.items()}
    parts = list(dict.fromkeys((*PARTS, *(command.part for command in commands.values()))))
    groups = {"": app}
    for name, command in sorted(commands.items(), key=lambda item: parts.index(item[1].part)):
        group, _, word = name.rpartition(" ")
        epilog = f"Example: lampest {name} {command.example}".rstrip()
        if group not in groups:
            groups[group] = typer.Typer(no_args_is_help=True, help=abouts.get(group))
            app.add_typer(
                groups[group], name=group, epilog=epilog, rich_help_panel=command.part, hidden=True
            )
        try:
            called = _guarded(loaded(command.target))
        except (ImportError, AttributeError) as error:
            warn(f"the command '{name}' cannot be loaded ({error})")
            continue
        panel = None if group else command.part
        kind = StarterCommand if name == "init" else None
        groups[group].command(word, cls=kind, epilog=epilog, rich_help_panel=panel)(called)


def program() -> Any:
    """Return the program of all commands; its help names no type for options without a value."""
    program = typer.main.get_command(app)
    waiting = [program]
    for command in waiting:
        waiting += getattr(command, "commands", {}).values()
        for parameter in command.get_params(command.context_class(command)):
            if getattr(parameter, "is_flag", False):
                parameter.metavar = ""
    return program


_build()
