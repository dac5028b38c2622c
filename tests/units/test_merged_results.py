"""A results file of stored cases: copied as they are, with their digests and axes."""

import dataclasses
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from fuzz.batches import content, same
from support import METHODS, invented_case

from lampest import CaseResult, InputError, read_results, write_results
from lampest.files import checksums, hdf5
from lampest.runs.case import StoredCase
from lampest.runs.results import stored_cases


def stored(folder: Path, cases: list[CaseResult]) -> list[StoredCase]:
    """Write each case into a file of its own; return references to them."""
    references = list[StoredCase]()
    for number, case in enumerate(cases):
        path = folder / f"case{number}.h5"
        write_results(path, [case])
        references += stored_cases(path)
    return references


def axes(path: Path) -> dict[str, Any]:
    """Return the scales of the axes of every dataset, and the users of every scale."""
    scales: dict[str, Any] = {}

    def look(name: str, node: Any) -> None:
        if isinstance(node, h5py.Dataset):
            scales[name] = [[scale.name for scale in axis.values()] for axis in node.dims]
            users = node.attrs.get("REFERENCE_LIST", ())
            scales[f"{name} is used by"] = sorted((file[user].name, int(n)) for user, n in users)

    with h5py.File(path) as file:
        file.visititems(look)
    return scales


@pytest.mark.slow
def test_stored_cases_give_the_file_of_cases_in_memory(tmp_path: Path) -> None:
    cases = [invented_case(name, stem, failed=(1,)) for stem in ("b", "a") for name in METHODS[:2]]
    write_results(tmp_path / "memory.h5", cases)
    write_results(tmp_path / "stored.h5", stored(tmp_path, cases))
    same(content(tmp_path / "stored.h5"), content(tmp_path / "memory.h5"))
    assert axes(tmp_path / "stored.h5") == axes(tmp_path / "memory.h5")
    expected = hdf5.checked(tmp_path / "memory.h5")[1]
    assert hdf5.checked(tmp_path / "stored.h5")[1] == expected
    assert not expected.without_digest


def test_a_value_is_digested_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A case by its own file; the file of all cases takes its digests, a check reads each once."""
    digested: list[str] = []
    entry = checksums._entry

    def counted(first: int, values: Any) -> bytes:
        digested.append(f"{first} {values.shape}")
        return entry(first, values)

    monkeypatch.setattr(checksums, "_entry", counted)
    [reference] = stored(tmp_path, [invented_case("LSM")])
    with h5py.File(reference.path) as file:
        nodes = [node for _, node in checksums.nodes_below(file, "/")]
        count = sum(isinstance(node, h5py.Dataset) for node in nodes)
    assert len(digested) == count
    digested.clear()
    write_results(tmp_path / "r.h5", [reference])
    assert digested == []
    assert hdf5.checked(reference.path)[1].datasets == len(digested) == count


def test_a_dataset_is_written_once_and_opened_never(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Digests, texts and axes are written where it is created, or by its path."""
    case = invented_case("LSM")
    created: list[bytes] = []
    create = h5py.h5d.create

    def counted(group: Any, name: bytes, *types: Any, **properties: Any) -> Any:
        created.append(name)
        return create(group, name, *types, **properties)

    monkeypatch.setattr(h5py.h5d, "create", counted)
    monkeypatch.setattr(h5py.h5d, "open", None)
    [reference] = stored(tmp_path, [case])
    with h5py.File(reference.path) as file:
        nodes = [node for _, node in checksums.nodes_below(file, "/")]
        assert len(created) == sum(isinstance(node, h5py.Dataset) for node in nodes)
    created.clear()
    write_results(tmp_path / "r.h5", [reference])
    assert not created


def test_the_text_of_a_scene_is_made_once_for_all_its_cases(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[Any] = []
    monkeypatch.setattr("lampest.panel.scene.to_yaml", lambda scene: made.append(scene) or "{}")
    case = invented_case("LSM")
    scene = dataclasses.replace(case.scene, assumed=("readout.readings",))
    for name in METHODS[:2]:
        each = dataclasses.replace(case, estimator=name, scene=scene)
        write_results(tmp_path / f"{name}.h5", [each])
    assert made == [scene]


def test_a_short_text_in_place_of_a_long_one_has_no_digest_of_the_long_one(tmp_path: Path) -> None:
    case = invented_case("LSM", warnings="long " * 1000)
    [reference] = stored(tmp_path, [case])
    after = dataclasses.replace(reference, verdict=("yes", "fits"), warnings="short")
    write_results(tmp_path / "r.h5", [after])
    [read] = read_results(tmp_path / "r.h5").cases
    assert read.warnings == "short"


def test_a_reference_is_that_of_the_written_case(tmp_path: Path) -> None:
    case = invented_case("LSM", warnings="one\ntwo", advice="three", case_id="c")
    [reference] = stored(tmp_path, [case])
    frames, rows, columns = case.measured.shape
    assert (reference.frames, reference.cells) == (frames, rows * columns)
    assert (reference.recording, reference.estimator) == (case.recording, "LSM")
    assert (reference.case_id, reference.warnings, reference.advice) == ("c", "one\ntwo", "three")


def test_stored_cases_of_different_recordings_are_refused(tmp_path: Path) -> None:
    case = invented_case("LSM")
    deviating = dataclasses.replace(case, estimator="b", measured=case.measured * 1.01)
    with pytest.raises(InputError, match=r"different recordings of the name \w+ \(resistance diff"):
        write_results(tmp_path / "r.h5", stored(tmp_path, [case, deviating]))
    assert not (tmp_path / "r.h5").exists()


@pytest.mark.parametrize("limit", [0, 10**9])
def test_the_place_of_a_large_file_is_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: int
) -> None:
    references = stored(tmp_path, [invented_case(name) for name in METHODS[:2]])
    monkeypatch.setattr("lampest.recording.stored.MAX_READINGS", limit)
    monkeypatch.setattr(hdf5, "new_large_file" if limit else "new_file", None)
    write_results(tmp_path / "r.h5", references)
    assert read_results(tmp_path / "r.h5").estimators() == tuple(METHODS[:2])


def test_the_bytes_of_a_file_do_not_depend_on_the_order_of_sets(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Processes order sets of texts differently: folders are written by name."""
    folders = list[str]()
    set_attributes = hdf5.set_attributes

    def noted(node: Any, **attributes: Any) -> None:
        if attributes.get("NX_class") == "NXcollection":
            folders.append(node.name)
        set_attributes(node, **attributes)

    monkeypatch.setattr(hdf5, "set_attributes", noted)
    named = {"gradient": np.ones(3)}
    case = invented_case(METHODS[0], "a", weight_sigma=named, misfit=named)
    write_results(tmp_path / "case.h5", [case])
    assert len(folders) == 4 and folders == sorted(folders)
