"""The command `calibrate`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lampest.cli import screen
from lampest.files.errors import InputError

if TYPE_CHECKING:
    from lampest.apps.calibration.calibration import Calibration


def calibrate(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...")],
    known: list[str] | None = None,
    loads: Path | None = None,
    from_recording: bool = False,
    tolerance: float = 0.01,
    out: screen.Output = None,
) -> None:
    """Calibrate the electronics or the film, and write a scene.

    The electronics are calibrated with known resistors or many loads, the film with known loads.
    Every number comes with its uncertainty.

    Parameters
    ----------
    files
        Recordings of shorted lines, resistors or loads.
    known
        Resistors in place of the cells, in ohm, or a .csv or .npy table; one for each file.
    loads
        YAML or CSV of known weights or pressures, to calibrate the film's response.
    from_recording
        Calibrate channels and reference from ordinary recordings under many loads.
    tolerance
        Relative tolerance of resistors or loads: 0.01 for 1 %.
    out
        Scene file to write. Default: print it.
    """
    from lampest.files.whole import write_whole

    if not 0 <= tolerance <= 0.5:
        raise InputError("--tolerance must lie between 0 and 0.5")
    if sum((loads is not None, bool(known), from_recording)) > 1:
        raise InputError(
            "--known, --loads and --from-recording are different calibrations: give one of them"
        )
    words = known or ["0"]
    if len(words) not in (1, len(files)):
        raise InputError(f"--known: give one for each of the {len(files)} files, or one for all")
    calibration = _calibrated(files, words, loads, from_recording, tolerance)
    if out is None:
        screen.say_text(calibration.text().removesuffix("\n"))
    else:
        write_whole(out, calibration.text())
        screen.say(f"{calibration.summary}: {out}")
    for warning in calibration.warnings:
        screen.warn(warning)


def _calibrated(
    files: list[Path], words: list[str], loads: Path | None, from_recording: bool, tolerance: float
) -> "Calibration":
    """Return the calibration with known loads, ordinary recordings or resistors that words name."""
    from lampest.recording.recording import Recording

    recordings = [Recording.load(file) for file in files]
    with screen.progress("calibrating"):
        if loads is not None:
            from lampest.apps.calibration.known_loads import read_known_loads
            from lampest.apps.calibration.loads import calibrate_loads

            return calibrate_loads(recordings, read_known_loads(loads), tolerance)
        if from_recording:
            from lampest.apps.calibration.channels import calibrate_channels

            return calibrate_channels(recordings)
        from lampest.apps.calibration.resistors import calibrate_resistors
        from lampest.apps.calibration.trials import known_resistors

        named = zip(recordings, words * (len(recordings) // len(words)), strict=True)
        tables = [known_resistors(word, recording.scene.panel) for recording, word in named]
        return calibrate_resistors(recordings, tables, tolerance)
