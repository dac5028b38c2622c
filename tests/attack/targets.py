"""What is attacked: small files as lampest makes them."""

from pathlib import Path

import numpy as np
from fuzz.batches import write_recording
from support import invented_case

from lampest.runs.results import write_results

RUN = "schema: 1\nrecordings: [small.h5]\nestimators: {LSM: {terms: {misfit: {}}, formulation: reduced}}\n"
SIMULATION = (
    "schema: 1\nseed: 1\nframes: 2\nbaseline_frames: 1\nscene:\n"
    "  panel: {rows: 3, columns: 4}\n  readout: {kind: two_point, noise_lsb: 0.7}\n  series_resistance_ohm: 140\n"
)


def small_folder(folder: Path) -> Path:
    """A folder with small.h5, run.yaml, scene.yaml, simulation.yaml, table.csv and results.h5."""
    folder.mkdir(parents=True, exist_ok=True)
    write_recording(folder / "small.h5", 2, 1)
    (folder / "run.yaml").write_text(RUN)
    (folder / "simulation.yaml").write_text(SIMULATION)
    np.savetxt(folder / "table.csv", np.random.default_rng(1).uniform(500, 5000, (6, 4)).round(2), delimiter=",")
    write_results(folder / "results.h5", [invented_case("LSM", "small", (2, 5, 6))])
    return folder


def everything(folder: Path) -> dict[str, bytes | str]:
    """What stands in a folder: path → bytes of a file, or what else it is."""
    found: dict[str, bytes | str] = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_symlink():
            found[name] = f"a link to {path.readlink()}"
        else:
            found[name] = path.read_bytes() if path.is_file() else "no regular file"
    return found
