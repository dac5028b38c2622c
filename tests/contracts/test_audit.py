"""The script of the audit's page: a table on screen, CSV and HDF5, and one sentence for a mistake in its file."""

import csv
import os
import subprocess
import sys
from pathlib import Path

import h5py
import pytest

ROOT = Path(__file__).parents[2]
FILE = """schema: 1
simulation:
  schema: 1
  seed: 3
  scene:
    panel: {rows: 6, columns: 5}
    response: {kind: published}
    readout: {kind: two_point, adc_bits: 12, noise_lsb: 1}
    series_resistance_ohm: 140
  baseline_frames: 5
  frames: 2
  loads: [{kind: rod, centre_mm: [20, 25], diameter_mm: 20, mass_g: 200}]
seeds: 3
estimators: {LSM: {terms: {misfit: {}}}}
effects:
  nothing: {}
  noise 3: {noise_factor: 3}
executor: {kind: serial}
"""


def audit(folder: Path, text: str = FILE) -> subprocess.CompletedProcess[str]:
    """Run it on a file of that text."""
    (folder / "small.yaml").write_text(text)
    command = [sys.executable, "-m", "docs.studies.audit", "small.yaml", "--out", "out"]
    environment = {**os.environ, "COLUMNS": "100", "PYTHONPATH": str(ROOT)}
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300, env=environment)


@pytest.mark.slow
def test_table_csv_and_samples_say_the_same(tmp_path: Path) -> None:
    done = audit(tmp_path)
    assert done.returncode == 0, done.stderr
    table = done.stdout.split("cells, change, press.")[0]
    assert max(len(line.rstrip()) for line in table.splitlines()) <= 100
    with (tmp_path / "out" / "audit.csv").open() as stream:
        nothing, noisy = csv.DictReader(stream)
    assert (nothing["effect"], nothing["verdict"]) in (("nothing", "covered"), ("nothing", "wide"))
    assert (noisy["reported"], noisy["verdict"]) == ("3", "reported")
    assert float(noisy["chi_square"]) > 5 > 2 > float(nothing["chi_square"])
    assert float(noisy["cells"]) > 80
    assert "measured in unloaded frames; the scene specifies" in done.stdout
    with h5py.File(tmp_path / "out" / "audit.h5") as file:
        group = file["entry/recordings"]
        held, cells = group["cells_covered"][3:].sum(), group["cells"][3:].sum()
        assert cells == 3 * 2 * 30
        assert 100 * held / cells == pytest.approx(float(noisy["cells"]), rel=1e-4)
        assert all("units" in group[name].attrs for name in group)


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("noise_factor", "noise_facto", "small.yaml:17:"),
        ("seeds: 3", "seeds: 0", "small.yaml"),
        ("baseline_frames: 5", "baseline_frames: 1", "small.yaml"),
    ],
)
def test_a_mistake_in_the_file_is_one_sentence(tmp_path: Path, old: str, new: str, place: str) -> None:
    done = audit(tmp_path, FILE.replace(old, new))
    assert done.returncode == 2
    assert place in done.stderr and len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()
