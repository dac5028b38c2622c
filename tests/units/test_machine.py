"""Machine code that is kept on disk is that of what stands in its folder now."""

import os
import subprocess
import sys
from pathlib import Path

ASKED = "from caller import twice; print(twice(3.0), sum(twice.stats.cache_hits.values()))"
CALLER = """
from lampest.panel.machine import machine_code
from called import once

@machine_code
def twice(x):
    return 2 * once(x)
"""
CALLED = """
from lampest.panel.machine import machine_code

@machine_code
def once(x):
    return x + {}
"""


def test_a_change_of_what_is_called_is_seen(tmp_path: Path) -> None:
    """numba alone would go on with the code of the first version, of which the caller's file knows nothing."""
    folder = tmp_path / "code"
    folder.mkdir()
    (folder / "caller.py").write_text(CALLER)
    paths = os.pathsep.join([str(Path(__file__).parents[2]), str(folder)])
    kept = {"NUMBA_CACHE_DIR": str(tmp_path / "kept"), "PYTHONDONTWRITEBYTECODE": "1"}
    given = os.environ | {"PYTHONPATH": paths} | kept
    said = []
    for added in (1, 1, 5):
        (folder / "called.py").write_text(CALLED.format(added))
        found = subprocess.run([sys.executable, "-c", ASKED], env=given, check=True, capture_output=True, text=True)
        said.append(found.stdout.split())
    assert said == [["8.0", "0"], ["8.0", "1"], ["16.0", "0"]]
