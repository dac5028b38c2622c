"""The results file: its content is read as it was written, and other programs open it."""

import dataclasses
import os
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import h5py
import numpy as np
import pytest
from support import METHODS, invented_case

from lampest import (
    CaseResult,
    Experiment,
    Faults,
    InputError,
    MeasuredSubject,
    Panel,
    PublishedFigures,
    Recording,
    Scene,
    StepFigures,
    Systematic,
    Temperature,
    TwoPointReadout,
    Water,
    read_results,
    write_results,
)

LAMPREY = Path(__file__).parents[2] / "data" / "lamprey_25mm.h5"
PUBLISHED = {"LSM": PublishedFigures(all=StepFigures(16.45, 0.40, 1.33, 1.29))}


@pytest.fixture
def written(tmp_path: Path) -> Path:
    path = tmp_path / "results.h5"
    cases = [
        invented_case(name, recording, (4, 5, 7), failed=(1,))
        for recording in ("b", "a")
        for name in METHODS
    ]
    write_results(path, cases, PUBLISHED)
    return path


@pytest.mark.parametrize(
    "shape",
    [
        (1, 1, 1),
        (70, 5, 12),
        *(pytest.param(shape, marks=pytest.mark.slow) for shape in ((3, 10, 10), (2, 1, 8))),
    ],
)
def test_written_results_are_read_unchanged(tmp_path: Path, shape: tuple[int, int, int]) -> None:
    """Names out of alphabetical order: the order of the configuration must survive."""
    known = {"z": {"truth": True, "start_time": "2026-05-04T09:30:00+02:00"}, "b": {"truth": False}}
    cases = [
        invented_case(name, stem, shape, **known[stem])
        for stem in known
        for name in reversed(METHODS)
    ]
    cases[0] = dataclasses.replace(
        cases[0], costs={"misfit": np.ones(shape[0]), "gradient": np.zeros(shape[0])}
    )
    write_results(tmp_path / "r.h5", cases, PUBLISHED)
    results = read_results(tmp_path / "r.h5")
    assert results.recordings() == ("z", "b") and results.published == PUBLISHED
    for stored, expected in zip(results.cases, cases, strict=True):
        for item in dataclasses.fields(CaseResult):
            np.testing.assert_equal(
                getattr(stored, item.name), getattr(expected, item.name), err_msg=item.name
            )


def test_a_failed_frame_holds_nan_and_a_sentence(written: Path) -> None:
    case = read_results(written).cases[0]
    assert np.isnan(case.cell_resistance[1]).all()
    assert case.status[1] == "stopped: too many iterations"
    with pytest.raises(
        InputError, match="/entry/b/LSM/cell_resistance must be numbers where solved is 1, and NaN"
    ):
        dataclasses.replace(case, solved=np.ones(4, dtype=bool))


@pytest.mark.slow
def test_the_same_cases_give_the_same_bytes(tmp_path: Path) -> None:
    code = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "from support import METHODS, invented_case\nfrom lampest import write_results\n"
        "write_results(sys.argv[2], [invented_case(name, failed=(1,)) for name in METHODS])"
    )
    for name in ("one.h5", "two.h5"):
        subprocess.run(
            [sys.executable, "-c", code, str(Path(__file__).parents[1]), tmp_path / name],
            check=True,
        )
    assert (tmp_path / "one.h5").read_bytes() == (tmp_path / "two.h5").read_bytes()


@pytest.mark.parametrize("engine", ["h5netcdf", pytest.param("netcdf4", marks=pytest.mark.slow)])
def test_xarray_opens_a_results_file_unchanged(written: Path, engine: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what the libraries say of each other at import
        xarray = pytest.importorskip("xarray")
        pytest.importorskip("netCDF4" if engine == "netcdf4" else engine)
    case = read_results(written).of("a")[2]
    with xarray.open_dataset(written, group="/entry/a/LSR-dCR", engine=engine) as data:
        assert data["cell_resistance"].dims == ("time", "row", "column")
        assert data["cell_resistance"].attrs["units"] == "ohm"
        assert data.attrs["signal"] == "cell_resistance"
        np.testing.assert_array_equal(data["cell_resistance"], case.cell_resistance)
        np.testing.assert_array_equal(data["time"], case.time)
        assert str(data["status"].values.astype(str)[0]) == case.status[0]
    with xarray.open_dataset(written, group="/entry/a/recording", engine=engine) as data:
        np.testing.assert_array_equal(data["resistance"], case.measured)


def test_every_text_is_fixed_ascii_and_every_dataset_has_units(written: Path) -> None:
    assert written.read_bytes()[8] == 3, (
        "superblock of the format 1.10, the oldest with checksums of its own"
    )
    names = []

    def look(name: str, node: h5py.Group | h5py.Dataset) -> None:
        names.append(name)
        for attribute in node.attrs:
            if attribute in ("DIMENSION_LIST", "REFERENCE_LIST"):
                continue  # how HDF5 attaches axes
            kind = node.attrs.get_id(attribute).dtype
            assert h5py.check_vlen_dtype(kind) is None and h5py.check_string_dtype(kind) != "O", (
                name,
                attribute,
            )
            assert kind.kind in "Siuf", (name, attribute, kind)
        if isinstance(node, h5py.Dataset):
            assert node.dtype.kind in "Siuf", name
            assert {"units", "long_name"} <= set(node.attrs), name
            if not node.is_scale:
                assert all(len(axis) == 1 for axis in node.dims), name

    with h5py.File(written) as file:
        file.visititems(look)
    assert "entry/a/LSM/cost/misfit" in names
    assert len(names) > 20 and all(
        part.isidentifier() for name in names for part in name.replace("-", "_").split("/")
    )


def test_a_full_disk_leaves_no_fragment_and_keeps_the_older_file(
    tmp_path: Path, written: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = written.read_bytes()
    full = mock.Mock(side_effect=OSError(28, "No space left on device"))
    for place, name in ((os, "fsync"), (Path, "write_bytes")):
        with (
            monkeypatch.context() as patch,
            pytest.raises(InputError, match="No space left on device"),
        ):
            patch.setattr(place, name, full)
            write_results(tmp_path / "new.h5" if place is os else written, [invented_case()])
        assert written.read_bytes() == original and list(tmp_path.iterdir()) == [written]


@pytest.mark.parametrize(
    "name",
    [
        "",
        ".",
        "..",
        "../x",
        "a/b",
        "/etc",
        " a",
        "a ",
        "x\n",
        "λ",
        "tab\t",
        "a\0b",
        "\x1b[31m",
        "x" * 201,
    ],
)
def test_names_that_cannot_be_groups_are_refused(name: str) -> None:
    for place in ("estimator", "recording"):
        with pytest.raises(InputError, match="cannot name") as refused:
            invented_case(**{place: name})
        assert str(refused.value).isprintable()
    with pytest.raises(InputError, match="cannot be called 'recording'"):
        invented_case("recording")


def test_inconsistent_cases_are_refused(tmp_path: Path) -> None:
    case = invented_case()
    with pytest.raises(InputError, match="two cases are called mouth × LSM"):
        write_results(tmp_path / "r.h5", [case, case])
    changes = {
        "scene": Scene(Panel(10, 10, 5.0), series_resistance_ohm=140.0),
        "start_time": "2026-05-05T09:30:00+02:00",
    }
    for name, value in changes.items():
        conflicting = invented_case("LSR-CR", **{name: value})
        with pytest.raises(
            InputError, match=rf"different recordings of the name mouth \({name} differs\)"
        ):
            write_results(tmp_path / "r.h5", [case, conflicting])
    assert list(tmp_path.iterdir()) == []


def test_results_hold_the_whole_scene(tmp_path: Path) -> None:
    faults = Faults(open=((0, 1),), dead_rows=(3,))
    water = Water(70.0)
    further = (faults, water, Temperature(-0.003, 20.0, 12.0), Systematic(0.01, 3.0))
    subject = MeasuredSubject("L7", "Petromyzon marinus", 420.0, 150.0)
    people = {
        "subject": subject,
        "experiment": Experiment("attachment", water_temperature_celsius=12.5),
    }
    scene = Scene(Panel(10, 10), TwoPointReadout(noise_lsb=0.5), 140.0, *further, **people)
    dataclasses.replace(Recording.load(LAMPREY), scene=scene).save(tmp_path / "recording.h5")
    assert Recording.load(tmp_path / "recording.h5").scene == scene
    write_results(tmp_path / "r.h5", [invented_case(method, scene=scene) for method in METHODS[:2]])
    assert [case.scene for case in read_results(tmp_path / "r.h5").cases] == [scene] * 2
    with h5py.File(tmp_path / "r.h5") as file:
        group = file["entry/mouth/recording"]
        assert group["scene"].shape == () and group["scene"].dtype.kind == "S"
    with pytest.raises(
        InputError, match=r"/entry/mouth/recording/resistance does not have the 4 × 5 cells"
    ):
        invented_case(scene=Scene(Panel(4, 5)))


def test_damaged_values_and_long_texts_are_detected(tmp_path: Path) -> None:
    """HDF5 keeps attributes of more than 4 kB where it has no checksum."""
    path = tmp_path / "r.h5"
    write_results(path, [invented_case(case_yaml="k" * 8000)])
    content = path.read_bytes()
    path.write_bytes(content.replace(b"k" * 4000, b"k" * 3999 + b"j", 1))
    with pytest.raises(InputError, match="case is damaged"):
        read_results(path)
    path.write_bytes(content)
    with h5py.File(path) as file:
        place = file["/entry/mouth/LSM/cell_resistance"].id.get_chunk_info(0).byte_offset + 40
    path.write_bytes(content[:place] + bytes([content[place] ^ 255]) + content[place + 1 :])
    with pytest.raises(InputError, match="/entry/mouth/LSM/cell_resistance is damaged"):
        read_results(path)


def test_a_case_of_other_results_in_its_place_is_refused_by_everything_that_reads(
    tmp_path: Path, lampest: Callable[..., Any]
) -> None:
    """Each of its values agrees with its own digest."""
    path = tmp_path / "r.h5"
    foreign_path = tmp_path / "other.h5"
    write_results(path, [invented_case("LSM")])
    write_results(foreign_path, [invented_case("LSR-CR")])
    with h5py.File(path, "a") as file, h5py.File(foreign_path) as source:
        del file["entry/mouth/LSM"]
        source.copy("entry/mouth/LSR-CR", file["entry/mouth"], "LSM")
    with pytest.raises(InputError, match="datasets were added, removed or exchanged"):
        read_results(path)
    for command in ("info", "plot", "compare", "check"):
        completed = lampest(command, path)
        assert completed.code == 2, command
        assert "datasets were added, removed or exchanged" in completed.err
    with h5py.File(path, "a") as file:
        del file.attrs["datasets_sha256"]
    assert len(read_results(path).cases) == 1, "as the page says of deliberate changes"
