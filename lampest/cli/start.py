"""The command for the first hour: files to begin with."""

from pathlib import Path
from typing import Annotated

import typer

from lampest.cli.screen import say, say_text


def init(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Made where it is not there; nothing is replaced.")
    ] = Path(),
) -> None:
    """Write files to begin with: a run, a scene, a simulated recording and how it was made, the schema for editors."""
    from lampest.runs.starter import RUN, write_starter

    for path in write_starter(folder):
        say(path)
    run = folder / RUN
    say_text(f"\nnow: lampest run {run}\n     lampest plot results/{run.stem}/results.h5")
