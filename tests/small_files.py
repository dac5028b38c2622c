"""Small recordings and runs on the disk, written from the format's description alone."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np

from tests.netlist import two_point_resistances

COMMAND = Path(sys.executable).with_name("lampest")
SCENE = (
    "panel: {rows: 3, columns: 4, pitch_mm: 10}\nreadout: {kind: "
    "two_point}\nseries_resistance_ohm: 140\n"
)
RUN = """\
schema: 1
recordings: [small.h5]
estimators:
  LSM: {terms: {misfit: {}}}
  LSR-CR:
    terms:
      misfit: {}
      cell_resistance: {weight: 1e-3}
  LSR-dCR: {terms: {misfit: {}, relative_change: {weight: 10}}}
"""
SIMULATION = """\
schema: 1
seed: 4
scene:
  panel: {rows: 4, columns: 3, pitch_mm: 10}
  readout: {kind: two_point}
  series_resistance_ohm: 140
frames: 2
loads:
  - {kind: oral_disc, centre_mm: [10, 10], diameter_mm: 25, rim_width_mm: 4, pressure_kpa: -10}
  - {kind: rod, centre_mm: [20, 0], diameter_mm: 10, mass_g: 50}
"""
TRADEOFF = """\
schema: 1
simulated:
  sizes: [8, [8, 9]]
  noise: {10bit: {}}
  scenes: {clean: {}, realistic: {channel_spread_ohm: 3, drift_per_minute: 0.01}}
estimators:
  LSM: {terms: {misfit: {}}}
  LSR-dCR: {terms: {misfit: {}, relative_change: {weight: 10}}}
formulations: [naive, scaled, linearised, {kind: truncated, steps: 2}, reduced, nodal]
frames: 3
repeats: 2
limits: {nodal: 8}
"""


def exact(cells: Any) -> Any:
    """Two-point resistances of frames of cells."""
    return np.stack([two_point_resistances(panel) for panel in cells])


def write_recording(
    path: Path, scene: str = SCENE, shape: tuple[int, int, int] = (3, 3, 4), **changes: Any
) -> Path:
    """One unloaded frame, the others measured; `changes` replace datasets, None leaves them out."""
    rng = np.random.default_rng(1)
    cells = 3000 * np.exp(0.2 * rng.standard_normal(shape))
    datasets: dict[str, Any] = {
        "resistance": exact(cells) + 140,
        "time": np.arange(float(shape[0])),
        "role": (np.arange(shape[0]) > 0).astype(np.uint8),
    } | changes
    with h5py.File(path, "w") as file:
        file.attrs["lampest_format"] = np.bytes_("recording/1")
        file.attrs["code_offset_steps"] = 0.0
        file["entry/scene"] = np.bytes_(scene)
        for name, values in datasets.items():
            if values is not None:
                file[f"entry/two_point/{name}"] = values
        file["entry/truth/cell_resistance"] = cells
    return path


def run_command(*arguments: object, **options: Any) -> subprocess.CompletedProcess[str]:
    """The installed command in its own process."""
    return subprocess.run(
        [COMMAND, *map(str, arguments)], capture_output=True, text=True, timeout=120, **options
    )


def on_disk(folder: Path) -> SimpleNamespace:
    """Return a folder with small.h5 and run.yaml, and functions that write more of them."""
    write_recording(folder / "small.h5")
    (folder / "run.yaml").write_text(RUN)

    def run(text: str = RUN, name: str = "run.yaml") -> Path:
        (folder / name).write_text(text, encoding="utf-8")
        return folder / name

    return SimpleNamespace(
        folder=folder,
        run=run,
        text=RUN,
        scene=SCENE,
        recording=write_recording,
        exact=exact,
        command=run_command,
    )
