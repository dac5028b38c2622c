"""The command `detect`."""

from pathlib import Path
from typing import Annotated

from lampest.cli import screen


def detect(
    files: list[Path],
    out: screen.Output = None,
    json_: bool = False,
    all_: bool = False,
    patch: screen.Amount = None,
    threshold: Annotated[float, screen.option(min=0.5, max=1.0)] = 0.9,
    estimator: str | None = None,
    frames: screen.FramesNamed = None,
    no_check: bool = False,
) -> None:
    """Detect contacts: since when, where, how large, and whether one sucks.

    The output is one sentence per recording, then events. Writes detections.h5, visits.csv with one
    row for each visit, and a timeline of each recording. Of several visits, but not of contacts of
    mats, also visits.png; of results with pressures also pressed.csv with every frame.

    Parameters
    ----------
    files
        Recordings, results files, or folders of recordings.
    out
        Output folder. Default: results/<recording>, of several results/visits (of mats
        results/contacts), or beside the results.
    json_
        Print the answers as JSON, and write no files.
    all_
        Also print notes and, for results, the frame of the largest force.
    patch
        Edge length of a cell's film in mm, such as 6. Default: 0.6 of the pitch.
    threshold
        Probability from which something is called a lamprey or a suction cup. Default: 0.9.
    estimator
        Estimator whose force and area are printed, such as LSM. Default: the first.
    no_check
        Leave out whether the circuits of recordings explain their readings.
    """
    from lampest.apps.recognition.detect.output import examined, tell_answers  # with scipy

    chosen = screen.frames_of(frames)
    folder, answers, loads = examined(
        files, patch, threshold, estimator, chosen, check=not no_check
    )
    tell_answers(out or folder, answers, loads, as_json=json_, everything=all_)
