"""`lampest export`: every format holds the content of a results file."""

import csv
import dataclasses
import json
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from support import invented_case

from lampest import (
    CaseResult,
    Experiment,
    Export,
    InputError,
    LoadedColumnsReadout,
    MeasuredSubject,
    export_results,
    read_results,
    write_results,
)

START = "2026-05-04T09:30:00+02:00"
Run = Callable[..., SimpleNamespace]


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """Two recordings, one with a failed frame and error bars.

    The other one is of another size without a truth.
    """
    failing = invented_case("LSM", "mouth", (3, 4, 5), failed=(1,), start_time=START)
    bars = np.indices((3, 4, 5)).sum(axis=0) / 7
    flags = np.zeros((3, 4, 5), dtype=np.uint8)
    bars[1] = np.nan
    flags[0, 1, 2] = 1
    maps = {"cell_resistance_errors": bars, "cell_resistance_lower": bars}
    maps["cell_resistance_upper"] = bars + np.inf
    pressures = {"pressure": bars, "pressure_errors": bars, "saturated": flags}
    cases = [
        dataclasses.replace(failing, **maps, extra=pressures),
        invented_case("LSR-gCR", "mouth", (3, 4, 5), start_time=START),
        invented_case("LSM", "other", (2, 3, 6), truth=False),
    ]
    write_results(tmp_path / "r.h5", cases)
    return tmp_path / "r.h5"


def exported(lampest: Run, results: Path, to: str, *words: Any) -> Path:
    """The file that the command says it wrote."""
    completed = lampest("export", results, "--to", to, *words)
    assert completed.code == 0, completed.err
    return Path(completed.out.splitlines()[0])


def shown(case: CaseResult, name: str) -> Any:
    """A flag with NaN where the frame failed."""
    return np.where(case.solved[:, None, None], getattr(case, name), np.nan)


def check_table(table: Any, results: Path) -> None:
    """A long table of all cases against the results themselves."""
    cases = read_results(results).cases
    assert len(table) == sum(case.measured.size for case in cases)
    for case in cases:
        lines = table[(table.recording == case.recording) & (table.estimator == case.estimator)]
        assert_array_equal(lines.cell_resistance_ohm, case.cell_resistance.ravel())
        assert_array_equal(lines.relative_change_percent, case.relative_change.ravel())
        for flag in ("open_cell", "at_lower_bound"):
            assert_array_equal(lines[flag].astype(float), shown(case, flag).ravel())
        assert_array_equal(lines.two_point_model_ohm, case.reading_model.ravel())
        assert_array_equal(lines.status, np.repeat(case.status, case.measured[0].size))
        assert_array_equal(lines.time_s, np.repeat(case.time, case.measured[0].size))
        x, y = (10 * np.indices(case.measured.shape)[axis].ravel() for axis in (2, 1))
        assert_array_equal(lines.x_mm, x)
        assert_array_equal(lines.y_mm, y)
        assert lines.truth_ohm.isna().all() == (case.truth is None)
        if case.pressure is None:
            assert lines.pressure_kPa.isna().all() and lines.saturated.isna().all()
        else:
            assert_array_equal(lines.pressure_kPa, case.pressure.ravel())
            assert_array_equal(lines.saturated.astype(float), shown(case, "saturated").ravel())


def test_pandas_reads_the_csv_export(
    lampest: Run, results: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import pandas

    path = exported(lampest, results, "csv")
    assert path == results.with_suffix(".csv")
    table = pandas.read_csv(path)
    check_table(table, results)
    written = path.read_bytes()
    monkeypatch.setitem(sys.modules, "pandas", None)
    assert export_results(results, "csv")[0].read_bytes() == written, (
        "nor is pandas needed to write it"
    )


def test_csv_quotes_names_that_spreadsheets_would_compute(lampest: Run, tmp_path: Path) -> None:
    names = {"=cmd|'C calc'!A0": "+1", "-2+3": "@SUM(A1)"}
    cases = [
        invented_case(estimator, recording, (2, 3, 4)) for recording, estimator in names.items()
    ]
    write_results(tmp_path / "r.h5", cases)
    table = exported(lampest, tmp_path / "r.h5", "csv")
    assert lampest("compare", tmp_path / "r.h5", "--csv", tmp_path / "c.csv").code == 0
    expected = {f"'{name}" for name in (*names, *names.values())}
    for path in (table, tmp_path / "c.csv"):
        with path.open(newline="") as lines:
            assert expected <= {field for line in csv.reader(lines) for field in line}
    with (tmp_path / "c.csv").open(newline="") as lines:
        assert not [
            field
            for line in csv.reader(lines)
            for field in line
            if field.startswith(("=", "+", "@"))
        ]


@pytest.mark.slow
def test_pyarrow_and_pandas_read_the_parquet_export(
    lampest: Run, results: Path, tmp_path: Path
) -> None:
    import pandas
    from pyarrow import parquet

    path = exported(lampest, results, "parquet", "--out", tmp_path / "new" / "mine.parquet")
    check_table(pandas.read_parquet(path), results)
    schema = parquet.read_schema(path)
    assert schema.field("time_s").metadata == {b"units": b"s", b"long_name": b"time of the frame"}
    assert json.loads(schema.field("solved").metadata[b"flags"]) == {"0": "failed", "1": "solved"}
    assert str(schema.field("saturated").type) == "uint8", (
        "a flag that some cases lack stays a flag"
    )
    assert json.loads(schema.metadata[b"lampest"])[0]["start_time"] == START
    volt = invented_case("LSM", "volts", (2, 3, 4))
    scene = dataclasses.replace(
        volt.scene, readout=LoadedColumnsReadout(load_ohm=1000.0), series_resistance_ohm=0.0
    )
    write_results(
        tmp_path / "r.h5",
        [invented_case("LSM", "ohms", (2, 3, 4)), dataclasses.replace(volt, scene=scene)],
    )
    table = pandas.read_parquet(
        export_results(tmp_path / "r.h5", "parquet", tmp_path / "both.parquet")[0]
    )
    assert table[table.recording == "ohms"].measured_volt.isna().all(), (
        "readings in volt are a column of their own"
    )
    assert_array_equal(table[table.recording == "volts"].measured_volt, volt.measured.ravel())


def test_scipy_reads_the_mat_export(lampest: Run, results: Path) -> None:
    from scipy.io import loadmat

    path = exported(lampest, results, "mat")
    assert path == results.with_suffix(".mat")
    held = loadmat(path, simplify_cells=True)["cases"]
    for saved, case in zip(held, read_results(results).cases, strict=True):
        assert (saved["recording"], saved["estimator"]) == (case.recording, case.estimator)
        assert_array_equal(saved["cell_resistance"], case.cell_resistance)
        assert_array_equal(saved["open_cell"], shown(case, "open_cell"))
        assert_array_equal(saved["two_point_model"], case.reading_model)
        assert_array_equal(saved["cost_misfit"], case.costs["misfit"])
        assert tuple(saved["status"]) == case.status
        assert_array_equal(saved["x"], 10 * np.arange(case.measured.shape[2]))
        rows, columns = case.measured.shape[1:]
        assert_array_equal(saved["row"], np.arange(rows))
        assert_array_equal(saved["column"], np.arange(columns))
        assert ("pressure" in saved) == (case.pressure is not None)
        assert (saved["units"]["cell_resistance"], saved["units"]["x"]) == ("ohm", "mm")
        assert saved["long_name"]["cell_resistance"] == "estimated cell resistance"
        assert list(saved["flags"]["solved"]["meanings"]) == ["failed", "solved"]
        assert all(name.isidentifier() and len(name) < 64 for name in saved), (
            "Octave and MATLAB take no other names"
        )
    assert held[0]["start_time"] == START


@pytest.mark.slow
def test_xarray_reads_the_zarr_export(lampest: Run, results: Path) -> None:
    import xarray
    from zarr.storage import ZipStore

    path = exported(lampest, results, "zarr")
    assert path.name == "r.zarr.zip"
    with ZipStore(path, mode="r") as store, xarray.open_datatree(store, engine="zarr") as tree:
        for case in read_results(results).cases:
            xarray.testing.assert_identical(
                tree[f"{case.recording}/{case.estimator}"].to_dataset(), case.to_xarray()
            )
        group = tree["mouth/LSM"]
        assert (
            group["cell_resistance"].attrs["units"] == "ohm" and group["x"].attrs["units"] == "mm"
        )
        assert group["open_cell"].attrs["flag_meanings"] == "conducts cannot_be_told_from_open"
        assert group["saturated"].isnull().any(["row", "column"]).values.tolist() == [
            False,
            True,
            False,
        ]
        assert "two_point_model" in group and "reading_model" not in group
        assert group.attrs["start_time"] == START


def test_export_names_a_missing_library(results: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    needed = (
        ("pyarrow", "parquet"),
        ("zarr.storage", "zarr"),
        ("xarray", "zarr"),
        ("pynwb", "nwb"),
    )
    for library, to in needed:
        remedy = rf"^{library} is not installed; pip install 'lampest\[export\]' brings it$"
        with monkeypatch.context() as without:
            without.setitem(sys.modules, library, None)
            with pytest.raises(InputError, match=remedy):
                export_results(results, to, recording="mouth")
        assert [path.name for path in results.parent.iterdir()] == ["r.h5"]


def test_a_failed_export_leaves_no_file(results: Path) -> None:
    class Broken(Export):
        kind = "broken"
        suffix = ".txt"
        beside = ".more"

        def write(self, cases: Any, name: str, path: Path, beside: Path | None) -> None:
            path.write_text("half")
            raise InputError(f"{name}: no")

    with pytest.raises(InputError, match=r"r\.txt: no"):
        export_results(results, Broken())
    assert [path.name for path in results.parent.iterdir()] == ["r.h5"]


@pytest.mark.long
def test_pynwb_reads_the_nwb_export_with_subject_and_start(lampest: Run, tmp_path: Path) -> None:
    from pynwb import read_nwb, validate

    case = invented_case("LSM", "mouth", (2, 3, 4))
    scene = dataclasses.replace(
        case.scene,
        subject=MeasuredSubject(
            id="L7", species="Petromyzon marinus", length_mm=420.0, mass_g=150.0
        ),
        experiment=Experiment(
            title="attachment", experimenter="Doe, Jane", water_temperature_celsius=12.5
        ),
    )
    write_results(tmp_path / "r.h5", [dataclasses.replace(case, scene=scene)])
    path = exported(lampest, tmp_path / "r.h5", "nwb", "--start", START)
    assert not validate(path=str(path))
    session = read_nwb(str(path))
    assert session.session_start_time.isoformat() == START and session.session_id == "mouth"
    module = session.processing["LSM"]
    series = module["cell_resistance"]
    assert_array_equal(session.acquisition["measured"].data[:], case.measured)
    assert_array_equal(series.data[:], case.cell_resistance)
    assert_array_equal(series.timestamps[:], case.time)
    assert series.unit == "ohm" and "1: cannot be told from open" in module["open_cell"].description
    assert_array_equal(module["open_cell"].data[:], shown(case, "open_cell"))
    assert_array_equal(module["two_point_model"].data[:], case.reading_model)
    assert tuple(module["frames"]["status"].data[:]) == case.status
    cells = module["cells"].to_dataframe()
    assert_array_equal(cells.baseline_resistance, case.baseline_resistance.ravel())
    assert_array_equal(cells.x_mm, 10 * cells.column)
    assert (session.subject.subject_id, session.subject.species) == ("L7", "Petromyzon marinus")
    assert (session.subject.weight, session.subject.description) == ("0.15 kg", "420 mm long")
    assert session.experiment_description == "attachment; water at 12.5 degrees Celsius"
    assert session.experimenter == ("Doe, Jane",)
    described = module.description.splitlines()
    assert (
        described[:2] == ["recording: mouth", "estimator: LSM"]
        and "lampest_version: 0.1.0" in described
    )
    assert "scene:" not in "".join(described) and "rows: 3" in session.notes
    session.read_io.close()
