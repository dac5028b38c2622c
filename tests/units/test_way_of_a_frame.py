"""The way of a frame on the page of the architecture against the trace of a run."""

import re
import subprocess
import sys
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from small_files import write_recording

import lampest
from lampest.runs.batch import run_batch
from lampest.runs.config import read_run
from lampest.runs.executors import Serial

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "reference" / "architecture.md"
# Words of the page for objects whose class has another name, and what follows the objects.
CLASSES = {"estimates": "Estimates", "columns": "Column"}
NO_OBJECT = "file, page, stream"


def traced_classes(action: Any) -> list[str]:
    """Return the names of the package's classes in the order of their first objects."""
    classes: list[str] = []

    def notice(frame: FrameType, event: str, _: Any) -> None:
        if event == "call" and frame.f_code.co_name == "__init__" and "self" in frame.f_locals:
            made = type(frame.f_locals["self"])
            if made.__module__.startswith("lampest.") and made.__name__ not in classes:
                classes.append(made.__name__)

    sys.setprofile(notice)
    try:
        action()
    finally:
        sys.setprofile(None)
    return classes


def test_a_run_makes_the_objects_of_the_page_in_its_order(tmp_path: Path) -> None:
    (way,) = re.findall(r"^    (Recording → .*)$", PAGE.read_text(), re.M)
    *objects, last = way.split(" → ")
    assert last == NO_OBJECT
    document = tmp_path / "run.yaml"
    estimators = "{smooth: {terms: {misfit: {weighting: noise}, log_gradient: {weight: 0.5}}}}"
    recording = write_recording(tmp_path / "small.h5")
    document.write_text(
        f"schema: 1\nrecordings: [{recording}]\nestimators: {estimators}\nformulation: reduced\n"
        "check: none\n"
    )
    expected = [CLASSES.get(word, word) for word in objects]
    made = traced_classes(lambda: run_batch(read_run(document), tmp_path / "out", Serial()))
    assert [name for name in made if name in expected] == expected


CHECKED = """
import sys, lampest
from lampest.inference.prepared import Prepared
check = Prepared(lampest.Recording.load(sys.argv[1])).check
assert check.mark == "yes", check.sentence
print("scipy.optimize" in sys.modules)
"""
LOADED = """
import sys, lampest
recording = lampest.Recording.load(sys.argv[1])
terms = [lampest.Misfit(weighting="noise"), lampest.LogGradient()]
estimate = lampest.reconstruct(recording, terms)
assert estimate.cell_resistance_errors is not None and estimate.relative_change.shape
print(*[name for name in sys.modules if name.startswith("lampest.")])
"""
MAX_LOADED = 111  # modules of a first reconstruction, without the effects that its scene names
NAMED = ("channels", "reference")  # effects of the scene of ring.h5
MAX_PASSED = 47  # files whose functions a frame calls, without those effects


@pytest.mark.slow
def test_a_check_that_searches_for_a_resistance_loads_no_library_of_optimisation() -> None:
    """Loading it took an eighth of the command."""
    completed = subprocess.run(
        [sys.executable, "-c", CHECKED, str(ROOT / "data" / "cup_air_10kpa.h5")],
        capture_output=True,
        text=True,
        check=True,
    )
    assert completed.stdout.strip() == "False"


def test_a_first_reconstruction_loads_no_application_and_no_room_above() -> None:
    completed = subprocess.run(
        [sys.executable, "-c", LOADED, str(ROOT / "data" / "ring.h5")],
        capture_output=True,
        text=True,
        check=True,
    )
    modules = completed.stdout.split()
    rooms = {name.split(".")[1] for name in modules}
    assert not rooms & {"apps", "audit", "cli", "runs"}
    above = {name for name in modules if name.startswith("lampest.report.")}
    assert above == {"lampest.report.reconstruction"}
    assert not [name for name in modules if name.startswith("lampest.inference.effects")]
    effects = {name for name in modules if name.startswith("lampest.panel.effects.")}
    assert effects == {f"lampest.panel.effects.{name}" for name in NAMED}
    assert len(modules) <= MAX_LOADED + len(effects)


def test_a_frame_passes_few_files() -> None:
    recording = lampest.datasets.load("lamprey_35mm")
    frames = recording.resistance
    unloaded = recording.role == lampest.UNLOADED
    resting = lampest.Readings.of(recording.scene, frames[unloaded]).mean()
    estimator = lampest.Estimator(
        (lampest.Misfit(weighting="noise"), lampest.LogGradient(weight=1.0)), "reduced"
    )
    stream = lampest.Stream.begin(estimator, recording.scene, 1.0, resting)
    first, second = frames[~unloaded][:2]
    stream, _ = stream.push(lampest.Readings.of(recording.scene, first))
    passed = set()

    def notice(frame: FrameType, event: str, _: Any) -> None:
        if event == "call" and "/lampest/" in frame.f_code.co_filename:
            passed.add(frame.f_code.co_filename)

    sys.setprofile(notice)
    try:
        _, step = stream.push(lampest.Readings.of(recording.scene, second))
    finally:
        sys.setprofile(None)
    others = [name for name in sorted(passed) if Path(name).stem not in NAMED]
    assert step.bars is not None and len(others) <= MAX_PASSED, others
