"""The command for the first hour: files to begin with."""

from pathlib import Path
from typing import Annotated

import typer


def init(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Made where it is not there; nothing is replaced.")
    ] = Path(),
) -> None:
    """Write files to begin with: a run, a scene, a simulated recording and how it was made, the schema for editors."""
    from lampest.runs.starter import RUN, write_starter

    for path in write_starter(folder):
        print(path)
    run = folder / RUN
    print(f"\nnow: lampest run {run}\n     lampest plot results/{run.stem}/results.h5")
