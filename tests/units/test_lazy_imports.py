"""Libraries that take long to import are imported by the commands that need them."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
READ = "import lampest; lampest.Recording.load('data/lamprey_35mm.h5')"
ESTIMATE = (
    "import lampest; recording = lampest.Recording.load('tests/golden/recording.h5'); "
    "lampest.reconstruct(recording, [lampest.Misfit(), lampest.LogGradient()])"
)


def imported(code: str) -> set[str]:
    """The modules that a fresh process holds after some code."""
    told = subprocess.run(
        [sys.executable, "-c", f"{code}; import sys; print(*sys.modules)"], cwd=ROOT, capture_output=True, text=True
    )
    assert told.returncode == 0, told.stderr
    return set(told.stdout.split())


@pytest.mark.parametrize(
    ("code", "absent"),
    [
        (READ, ("scipy.linalg", "scipy.sparse", "casadi", "matplotlib", "pandas")),
        ("import lampest.report.info, lampest.report.compare", ("scipy.linalg", "casadi", "lampest.estimate")),
        ("import lampest.estimate.calibration.resistors", ("scipy.stats", "scipy.optimize")),
        (ESTIMATE, ("scipy.optimize", "scipy.ndimage", "scipy.stats", "matplotlib", "pandas")),
    ],
)
def test_process_does_without(code: str, absent: tuple[str, ...]) -> None:
    assert not imported(code) & set(absent)
