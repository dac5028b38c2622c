"""Names that would move the cursor, paint, or pretend to be another line: what reaches a terminal is plain."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from attack.attack import HELD, Outcomes, Rng, attack, called, printable, small_folder

pytestmark = pytest.mark.slow
SIGNS = ("\x1b[2J", "\x1b]0;mine\x07", "\r", "\n", "\x9b31m", "\u202e", "\u2028", "\x7f", "\b\b\b", "[bold]", "\udc80")


@attack(2, len(SIGNS))
def test_control_characters_in_file_names_are_never_printed(rng: Rng, folder: Path, count: int) -> Outcomes:
    for number in rng.permutation(len(SIGNS))[:count]:
        sign = SIGNS[number]
        made = small_folder(folder / f"work{number}")
        for suffix in (".h5", ".csv"):
            (made / f"{'small' if suffix == '.h5' else 'table'}{suffix}").rename(made / f"a{sign}b{suffix}")
        (made / "results.h5").rename(made / f"r{sign}s.h5")
        for arguments in (
            ("info", f"a{sign}b.h5"),
            ("check", f"a{sign}b.h5", f"r{sign}s.h5", f"no{sign}.h5"),
            ("import", f"a{sign}b.csv", "--rows", "3", "--columns", "4", "--out", f"o{sign}.h5"),
            ("compare", f"r{sign}s.h5", "--csv", f"t{sign}.csv"),
            ("plot", f"r{sign}s.h5", "--out", f"p{sign}"),
            ("run", f"no{sign}.yaml"),
            ("run", "run.yaml", "--set", f"recordings=[{sign}.h5]"),
        ):
            ended = called(*arguments, folder=made)
            plain = printable(ended.out) and printable(ended.err) and "Traceback" not in ended.err
            lines = sum((ended.out + ended.err).count(f"\n{rest}") for rest in ("b.h5", "b.csv", "s.h5", ".h5", ".csv"))
            yield HELD if plain and not lines else ended.said(f"{arguments[0]} with {sign!r}")


@attack(2, len(SIGNS))
def test_control_characters_in_files_are_never_printed(rng: Rng, folder: Path, count: int) -> Outcomes:
    for number in rng.permutation(len(SIGNS))[:count]:
        sign = SIGNS[number].encode("utf-8", "replace").decode()
        made = small_folder(folder / f"work{number}")
        with h5py.File(made / "results.h5", "a") as file:
            case = file["entry/small/LSM"]
            for name, value in case.attrs.items():
                if isinstance(value, bytes):
                    case.attrs[name] = np.bytes_(value + sign.encode())
            case.attrs["model_explains"], case.attrs["model_check"] = "no", f"no{sign}"
            case.attrs["noise_check"], case.attrs["numpy_version"] = f"noise{sign}", sign
            case.copy(case, file["entry/small"], f"L{sign.replace('/', '')}M")
        with h5py.File(made / "small.h5", "a") as file:
            file["entry/start_time"] = np.bytes_(f"2026{sign}".encode())
            text = file["entry/scene"][()]
            del file["entry/scene"]
            file["entry/scene"] = np.bytes_(text + f"# {sign}\n".encode())
        with h5py.File(made / "only.h5", "w") as file:
            file.attrs["lampest_format"] = sign
            file[f"entry/two_point/resistance{sign}"] = np.ones(3)
        for arguments in (
            ("info", "results.h5"),
            ("info", "small.h5"),
            ("info", "only.h5"),
            ("compare", "results.h5", "--report", "r.html"),
            ("detect", "results.h5"),
        ):
            ended = called(*arguments, folder=made)
            plain = printable(ended.out) and printable(ended.err) and "Traceback" not in ended.err
            yield HELD if plain else ended.said(f"{arguments[0]} with {sign!r} inside")
