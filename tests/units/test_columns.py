"""Columns of results; a further one is a line in a script or a name in a package."""

import dataclasses
from pathlib import Path

import h5py
import numpy as np
import pytest
from support import invented_case

import lampest
from lampest import InputError, read_results, write_results
from lampest.runs.columns import CELLS, FRAMES, Column, positive_or_infinite

LEAST_RESISTANCE = Column(
    "least_resistance", FRAMES, "ohm", "smallest cell", lambda done: None, (positive_or_infinite,)
)


def test_values_that_do_not_fit_their_column_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "r.h5"
    case = invented_case()
    for values, message in (
        (np.ones(2), "/entry/mouth/LSM/least_resistance is 2; the frames ask for 3"),
        (np.zeros(3), "/entry/mouth/LSM/least_resistance must be positive"),
    ):
        with pytest.raises(InputError, match=message):
            write_results(
                path,
                [dataclasses.replace(case, extra={"least_resistance": values})],
                columns=(LEAST_RESISTANCE,),
            )
    with pytest.raises(
        InputError, match="mouth × LSM: no column says what the extra 'least_resistance' is"
    ):
        write_results(path, [dataclasses.replace(case, extra={"least_resistance": np.ones(3)})])
    assert not path.exists()


def test_columns_of_an_application_are_attributes_of_a_case(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pressure = np.arange(300.0).reshape(3, 10, 10)
    write_results(tmp_path / "r.h5", [invented_case(extra={"pressure": pressure})])
    (case,) = read_results(tmp_path / "r.h5").cases
    np.testing.assert_array_equal(case.pressure, pressure)
    assert case.to_xarray().pressure.units == "kPa" and case.pressing is None
    with pytest.raises(AttributeError, match="no attribute 'presure'"):
        _ = case.presure
    monkeypatch.setattr("lampest.runs.case.installed", lambda group, kind: ())
    (case,) = read_results(tmp_path / "r.h5").cases
    assert case.column("pressure") is None and "pressure" not in case.variables()
    with pytest.raises(AttributeError, match="no attribute 'pressure'"):
        _ = case.pressure


def test_columns_hold_texts_and_truth_values(tmp_path: Path) -> None:
    words = Column("word", FRAMES, "1", "a word", lambda done: None, dtype=str)
    marks = Column("marked", CELLS, "1", "1: marked", lambda done: None, dtype=bool)
    case = invented_case(extra={"word": ("one", "two", "three"), "marked": np.eye(10, dtype=bool)})
    write_results(tmp_path / "r.h5", [case], columns=(words, marks))
    (stored,) = read_results(tmp_path / "r.h5", (words, marks)).cases
    assert stored.extra["word"] == ("one", "two", "three")
    np.testing.assert_array_equal(stored.extra["marked"], np.eye(10, dtype=bool))
    with h5py.File(tmp_path / "r.h5") as file:
        assert (
            file["entry/mouth/LSM/marked"].dtype == np.uint8
            and file["entry/mouth/LSM/word"].dtype.kind == "S"
        )


@pytest.mark.slow
def test_two_terms_of_one_kind_keep_their_costs(tmp_path: Path) -> None:
    scene = lampest.Scene(lampest.Panel(3, 4), lampest.TwoPointReadout())
    frames = 640.0 * np.exp(0.1 * np.random.default_rng(0).standard_normal((2, 3, 4)))
    recording = lampest.Recording(scene, frames, np.arange(2.0), np.array([0, 1], dtype=np.uint8))
    terms = [lampest.Misfit(), lampest.Gradient(weight=1e-3), lampest.Gradient(weight=1e-2)]
    lampest.reconstruct(recording, terms=terms).save(tmp_path / "two.h5", name="two")
    case = read_results(tmp_path / "two.h5").cases[0]
    assert set(case.costs) == {"misfit", "gradient", "gradient_2"}
    assert case.weights["gradient_2"][0] == 1e-2
    np.testing.assert_allclose(sum(cost[0] for cost in case.costs.values()), case.objective[0])
