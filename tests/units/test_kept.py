"""What a batch keeps of a finished case: all of it, in one short file, and no waiting for the disk."""

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest
from support import invented_case

from lampest.files.errors import InputError
from lampest.runs.batch import MOST_PACKED, read_kept, write_kept
from lampest.runs.case import CaseResult
from lampest.runs.results import read_results, stored_cases, write_results

Command = Callable[..., SimpleNamespace]


def same(ours: Any, theirs: Any) -> bool:
    """Whether two values of a case's field are equal to the last bit, type and shape included."""
    if isinstance(ours, np.ndarray):
        return (ours.dtype, ours.shape, ours.tobytes()) == (theirs.dtype, theirs.shape, theirs.tobytes())
    if isinstance(ours, dict):
        return ours.keys() == theirs.keys() and all(same(ours[name], theirs[name]) for name in ours)
    return bool(ours == theirs) or (ours != ours and theirs != theirs)


def case(**changes: Any) -> CaseResult:
    return invented_case("LSM", "mouth", (3, 4, 5), failed=(1,), case_id="abc", **changes)


def test_every_field_comes_back(tmp_path: Path) -> None:
    ours = case(baseline_solve_time=float("nan"), film_sentence="weiß", tared=("", "taken", ""))
    write_kept(tmp_path / "a.h5", ours)
    theirs = read_kept(tmp_path / "a.h5", "abc")
    assert theirs is not None
    different = [
        field.name
        for field in dataclasses.fields(CaseResult)
        if not same(getattr(ours, field.name), getattr(theirs, field.name))
    ]
    assert different == []
    for name, one in (("ours", ours), ("theirs", theirs)):
        write_results(tmp_path / f"{name}.h5", [one])
    assert (tmp_path / "ours.h5").read_bytes() == (tmp_path / "theirs.h5").read_bytes()
    assert read_kept(tmp_path / "a.h5", "another") is None


def test_one_that_is_cut_or_says_nonsense_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    write_kept(path, case())
    whole = path.read_bytes()
    wrong = whole.replace(b"LSM", b"LSN")
    assert wrong != whole
    for damaged in (whole[:-1000], whole[: len(whole) // 2], b"", bytes(len(whole)), wrong):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match=r"a\.h5"):
            read_kept(path, "abc")


def test_values_that_a_power_failure_cost_are_missed(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    write_kept(path, invented_case("LSM", "mouth", (30, 20, 20), case_id="abc"))
    with h5py.File(path) as file:
        begin, length = file["values"].id.get_offset(), file["values"].id.get_storage_size()
    whole = path.read_bytes()
    path.write_bytes(whole[:begin] + bytes(length) + whole[begin + length :])
    with pytest.raises(InputError, match="values is damaged"):
        read_kept(path, "abc")


def test_a_long_text_that_was_damaged_is_missed(tmp_path: Path) -> None:
    """HDF5 keeps attributes of more than 4 kB where it has no checksum."""
    path = tmp_path / "a.h5"
    write_results(path, [case(case_yaml="k" * 8000)])
    path.write_bytes(path.read_bytes().replace(b"k" * 4000, b"k" * 3999 + b"j", 1))
    with pytest.raises(InputError, match="case is damaged"):
        read_results(path)


def test_a_large_one_is_a_results_file(tmp_path: Path) -> None:
    frames = MOST_PACKED // (8 * 20)
    large = invented_case("LSM", "mouth", (frames, 4, 5), case_id="abc")
    write_kept(tmp_path / "a.h5", large)
    assert [one.case_id for one in read_results(tmp_path / "a.h5").cases] == ["abc"]
    theirs = read_kept(tmp_path / "a.h5", "abc")
    assert theirs is not None and np.array_equal(theirs.cell_resistance, large.cell_resistance)
    assert {case.case_id for case in stored_cases(tmp_path / "a.h5")} == {"abc"}


def test_a_batch_waits_for_the_disk_once(disk: SimpleNamespace, lampest: Command, monkeypatch: Any) -> None:
    waited: list[int] = []
    sync = os.fsync
    monkeypatch.setattr(os, "fsync", lambda descriptor: (waited.append(descriptor), sync(descriptor)))
    assert lampest("run", disk.folder / "run.yaml", "--out", disk.folder / "out", "--jobs", "1").code == 0
    assert len(waited) == 1
