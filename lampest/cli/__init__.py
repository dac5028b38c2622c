"""The command line: parse, call, print. Libraries are imported by the command that needs them."""

import os
import sys

import typer

from lampest.cli import board, estimation, results, studies
from lampest.cli.screen import INTERRUPTED, WRONG_INPUT
from lampest.files.errors import InputError
from lampest.files.interrupts import ending_signals
from lampest.runs.executors import ONE_THREAD

app = typer.Typer(
    help="Cell resistances of passive resistive matrix sensors from two-point measurements.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for _command in (
    estimation.run,
    estimation.starts,
    estimation.tune,
    estimation.simulate,
    estimation.import_,
    results.compare,
    results.plot,
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
    app.command(_command.__name__.rstrip("_"))(_command)


def main() -> None:
    """Run the command; input errors end with code 2 and one sentence, Ctrl-C and its kin with 130."""
    os.environ.update({name: value for name, value in ONE_THREAD.items() if name not in os.environ})
    try:
        with ending_signals():
            app()
    except InputError as error:
        print(f"lampest: {error}", file=sys.stderr)
        sys.exit(WRONG_INPUT)
    except SystemExit as end:
        if end.code == INTERRUPTED:
            print("lampest: interrupted; what was finished is kept", file=sys.stderr)
        raise
