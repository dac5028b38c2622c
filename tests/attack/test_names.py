"""Names that would move the cursor, paint, or pretend to be another line."""

import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from attack.attack import Outcomes, Rng, attack, called, drawn, small_folder, unless

pytestmark = pytest.mark.slow
SIGNS = (
    "\x1b[2J",
    "\x1b]0;mine\x07",
    "\r",
    "\n",
    "\x9b31m",
    "\u202e",
    "\u2028",
    "\x7f",
    "\b\b\b",
    "[bold]",
    "\udc80",
)


@attack(2, len(SIGNS))
def test_control_characters_in_names_and_contents_of_files_are_never_printed(
    rng: Rng, folder: Path, count: int
) -> Outcomes:
    for number, sign in drawn(rng, SIGNS, count):
        work_folder = small_folder(folder / f"work{number}")
        text = sign.encode("utf-8", "replace").decode()
        shutil.copy(work_folder / "small.h5", work_folder / f"a{sign}b.h5")
        shutil.copy(work_folder / "table.csv", work_folder / f"a{sign}b.csv")
        shutil.copy(work_folder / "results.h5", work_folder / f"r{sign}s.h5")
        with h5py.File(work_folder / "results.h5", "a") as file:
            case = file["entry/small/LSM"]
            for name, value in case.attrs.items():
                if isinstance(value, bytes):
                    case.attrs[name] = np.bytes_(value + text.encode())
            case.attrs["model_explains"] = "no"
            case.attrs["model_check"] = f"no{text}"
            case.attrs["noise_check"] = f"noise{text}"
            case.attrs["numpy_version"] = text
            case.copy(case, file["entry/small"], f"L{text.replace('/', '')}M")
        with h5py.File(work_folder / "small.h5", "a") as file:
            file["entry/start_time"] = np.bytes_(f"2026{text}".encode())
            scene = file["entry/scene"][()]
            del file["entry/scene"]
            file["entry/scene"] = np.bytes_(scene + f"# {text}\n".encode())
        with h5py.File(work_folder / "only.h5", "w") as file:
            file.attrs["lampest_format"] = text
            file[f"entry/two_point/resistance{text}"] = np.ones(3)
        for arguments in (
            ("info", f"a{sign}b.h5"),
            ("check", f"a{sign}b.h5", f"r{sign}s.h5", f"no{sign}.h5"),
            ("import", f"a{sign}b.csv", "--rows", "3", "--columns", "4", "--out", f"o{sign}.h5"),
            ("compare", f"r{sign}s.h5", "--csv", f"t{sign}.csv"),
            ("plot", f"r{sign}s.h5", "--out", f"p{sign}"),
            ("run", f"no{sign}.yaml"),
            ("run", "run.yaml", "--set", f"recordings=[{sign}.h5]"),
            *(("info", name) for name in ("results.h5", "small.h5", "only.h5")),
            ("compare", "results.h5", "--report", "r.html"),
            ("detect", "results.h5"),
        ):
            completed = called(*arguments, folder=work_folder)
            lines = sum(
                (completed.out + completed.err).count(f"\n{line_start}")
                for line_start in ("b.h5", "b.csv", "s.h5", ".h5", ".csv")
            )
            yield unless(
                completed.plain and not lines, completed.described(f"{arguments[0]} with {sign!r}")
            )
