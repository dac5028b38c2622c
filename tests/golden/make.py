"""Results that later versions must give again: one small file for each estimator of run.yaml.

Run it with: python -m tests.golden.make. Do so only where numbers are meant to change, and say in the commit why.
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import h5py

HERE = Path(__file__).parent
COMMAND = Path(sys.executable).with_name("lampest")
RECORDING = "recording.h5"


def simulated(folder: Path) -> Path:
    """The recording that scene.yaml describes, made in `folder`."""
    target = folder / RECORDING
    subprocess.run([COMMAND, "simulate", HERE / "scene.yaml", "--out", target], check=True, stdout=subprocess.DEVNULL)
    return target


def reconstructed(recording: Path, folder: Path) -> dict[str, Path]:
    """Estimator → its results file, made in `folder` from the recording."""
    for source in (recording, HERE / "run.yaml"):
        shutil.copy(source, folder / source.name)
    words = ["run", folder / "run.yaml", "--out", folder / "out", "--jobs", "1"]
    subprocess.run([COMMAND, *words], check=True, stdout=subprocess.DEVNULL)
    files = {}
    for file in sorted((folder / "out" / "cases").glob("*.h5")):
        with h5py.File(file) as content:
            (name,) = content[f"entry/{recording.stem}"].keys() - {"recording"}
        files[name] = file
    return files


def keep(results: Path, target: Path) -> None:
    """Write what is compared, and nothing else: a third of a results file, and the same bytes each time."""
    with h5py.File(results) as source, h5py.File(target, "w", libver=("earliest", "v110")) as file:

        def copy(path: str, item: h5py.Group | h5py.Dataset) -> None:
            if isinstance(item, h5py.Dataset) and not path.endswith("_time"):
                file[path] = item[()]
            for name in item.attrs.keys() & {"baseline_status", "joint_start"}:
                file.require_group(path).attrs[name] = item.attrs[name]

        source.visititems(copy)


def main() -> None:
    """Replace the files of this folder."""
    with tempfile.TemporaryDirectory() as name:
        recording = simulated(HERE)
        for file in {*HERE.glob("*.h5")} - {recording}:
            file.unlink()
        for estimator, results in reconstructed(recording, Path(name)).items():
            keep(results, HERE / f"{estimator}.h5")


if __name__ == "__main__":
    main()
