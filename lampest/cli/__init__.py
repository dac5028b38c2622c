"""The command line: parse, call, print. Libraries are imported by the command that needs them."""

import inspect
import os
import sys
from collections.abc import Callable
from functools import wraps
from typing import Annotated, Any

import typer

from lampest.cli import board, estimation, results, start, studies
from lampest.cli.screen import INTERRUPTED, WRONG_INPUT, say
from lampest.files.errors import InputError
from lampest.files.interrupts import ending_signals
from lampest.files.memory import allow_memory
from lampest.runs.executors import ONE_THREAD

app = typer.Typer(
    help="Cell resistances of passive resistive matrix sensors from two-point measurements.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
_MEMORY = typer.Option("--memory", metavar="SIZE", help="Memory it may take, such as 8GB; else most of what is free.")


def _with_memory(command: Callable[..., None]) -> Callable[..., None]:
    """The command with the option --memory."""

    @wraps(command)
    def called(memory: str | None = None, **options: Any) -> None:
        if memory is not None:
            allow_memory(memory)
        command(**options)

    signature = inspect.signature(command, eval_str=True)
    kind = Annotated[str | None, _MEMORY]
    memory = inspect.Parameter("memory", inspect.Parameter.KEYWORD_ONLY, default=None, annotation=kind)
    signature = signature.replace(parameters=[*signature.parameters.values(), memory])
    called.__signature__ = signature  # type: ignore[attr-defined]
    return called


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
    app.command(_command.__name__.rstrip("_"))(_command if _small else _with_memory(_command))


def main() -> None:
    """Run the command; input errors end with code 2 and one sentence, Ctrl-C and its kin with 130."""
    os.environ.update({name: value for name, value in ONE_THREAD.items() if name not in os.environ})
    try:
        with ending_signals():
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
