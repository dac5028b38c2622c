"""The command line that the scripts of these pages share."""

import os
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lampest.apps.studies.commands import run_study
from lampest.apps.studies.study import Study
from lampest.cli.screen import WRONG_INPUT, warn
from lampest.files.errors import InputError
from lampest.files.process import ONE_THREAD
from lampest.files.whole import sparing


def parser_of(description: str | None) -> ArgumentParser:
    """Return the parser of [CONFIG] [--out DIR] [--set PATH=VALUE]."""
    parser = ArgumentParser(description=description)
    parser.add_argument(
        "config", nargs="?", type=Path, help="YAML file of the study; the shipped one by default"
    )
    parser.add_argument("--out", type=Path, help="output folder; default: results/<config>")
    parser.add_argument(
        "--set", dest="assigned", action="append", metavar="PATH=VALUE", help="override an entry"
    )
    return parser


def main(study_of: Callable[[Namespace], Study[Any, Any]], parser: ArgumentParser) -> None:
    """Run a study; a mistake in its input ends with code 2 and one sentence."""
    options = parser.parse_args()
    os.environ.update({name: value for name, value in ONE_THREAD.items() if name not in os.environ})
    try:
        with sparing([options.config] if options.config else []):
            run_study(study_of(options), options.config, options.out, options.assigned)
    except InputError as error:
        warn(error)
        sys.exit(WRONG_INPUT)
