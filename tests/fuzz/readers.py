"""Reading of an input by its reader, and a sentence on wrong behaviour."""

import faulthandler
import resource
import shutil
import time
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from attack.attack import MAX_SENTENCE, called
from fuzz.mutants import IMPORTED, KINDS, RUN, Mutant, text

from lampest import (
    InputError,
    Recording,
    import_file,
    read_results,
    read_run,
    read_scene,
    read_simulations,
)
from lampest.recording.simulation import run as simulate
from lampest.runs.checks import BESIDE

TAKEN = "taken"
REFUSED = "refused"
MAX_SECONDS = 30.0
MAX_KILOBYTES = 1_200_000
HANG_SECONDS = 120
SMALL_SIMULATION = 50_000


class ReceptionError(Exception):
    """An input was received as it must not be."""


def receive(mutant: Mutant, folder: Path) -> str:
    """'taken' or 'refused' with one sentence.

    Raises ReceptionError for everything else, for much time and for much memory.

    A reader that hangs in C code ends the process, with its stack on stderr.
    """
    path = folder / f"input{KINDS[mutant.kind][0]}"
    path.write_bytes(mutant.content)
    initial_peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begin = time.process_time()
    faulthandler.dump_traceback_later(HANG_SECONDS, exit=True)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            outcome = _received(mutant, path)
    finally:
        faulthandler.cancel_dump_traceback_later()
        # `describe` keeps the check of a recording that it could read.
        leftovers = cleared(folder) - {path.name, path.with_suffix(BESIDE).name}
    if leftovers:
        raise ReceptionError(f"left {leftovers}")
    seconds = time.process_time() - begin
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - initial_peak
    if seconds > MAX_SECONDS:
        raise ReceptionError(f"{seconds:.1f} s")
    if grown > MAX_KILOBYTES:
        raise ReceptionError(f"{grown // 1000} MB")
    return outcome


def cleared(folder: Path) -> set[str]:
    """Delete everything but the recording that runs name, and return the deleted names."""
    leftovers = [item for item in folder.iterdir() if item.name != "small.h5"]
    for item in leftovers:
        shutil.rmtree(item) if item.is_dir() else item.unlink()
    return {item.name for item in leftovers}


def _received(mutant: Mutant, path: Path) -> str:
    reader, command = READERS[mutant.kind]
    arguments = [word.format(path if word == "{}" else path.parent) for word in command.split()]
    try:
        reader(path)
    except InputError as error:
        _check_sentence(str(error))
        if arguments:
            _check_command(arguments, 2)
        return REFUSED
    except Exception as error:
        raise ReceptionError("".join(traceback.format_exception(error)[-4:])) from error
    if mutant.kind in ("recording", "results"):
        _check_command(arguments, 0)
    return TAKEN


def _check_sentence(sentence: str) -> None:
    if "Unable to allocate" in sentence or "more data than the memory" in sentence:
        raise ReceptionError(f"it was tried to take that much memory: {sentence}")
    if not sentence or len(sentence) > MAX_SENTENCE or not sentence.isprintable():
        raise ReceptionError(f"no sentence of {len(sentence)} characters: {sentence[:2000]!r}")


def _check_command(arguments: list[str], code: int) -> None:
    """The command ends with that code, and says one line on stderr where it refuses."""
    completed = called(*arguments, folder=Path.cwd())
    lines = completed.err.count("\n")
    refused = "lampest: " in completed.err and not completed.out
    if completed.code != code or lines != (code != 0) or (code and not refused):
        raise ReceptionError(completed.described(f"lampest {arguments[0]} must end with {code}"))


def _setting(path: Path) -> None:
    """The input is the word behind --set, of a run that is in order."""
    setting = path.read_bytes().decode("utf-8", "replace")
    path.write_bytes(text(RUN))
    read_run(path, (setting,))


def _simulations(path: Path) -> None:
    planned = read_simulations(path)
    readings = max(
        simulation.scene.readout.readings if simulation.scene.readout else 1
        for _, simulation in planned
    )
    if sum(simulation.values for _, simulation in planned) * readings < SMALL_SIMULATION:
        out = path.parent / "made"
        try:
            made = simulate(path, out / "made.h5" if len(planned) == 1 else out)
            for recording in made:
                Recording.load(recording)
        finally:
            shutil.rmtree(out, ignore_errors=True)


# How a file of each kind is read in Python, and the words of a command, without those that name the
# file.
READERS: dict[str, tuple[Callable[[Path], Any], str]] = {
    "run": (read_run, "run {} --out {}/never"),
    "scene": (read_scene, ""),
    "simulation": (_simulations, "simulate {} --out {}/never.h5"),
    "setting": (_setting, ""),
    "recording": (Recording.load, "info {}"),
    "results": (read_results, "compare {}"),
}
for _kind in IMPORTED:
    READERS[_kind] = (
        (lambda path: import_file(path, 3, 5)),
        "import {} --rows 3 --columns 5 --out {}/never.h5",
    )
