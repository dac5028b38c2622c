"""Foreign measurements: every format gives the same frames, every fault is one sentence with its place."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import scipy.io

from lampest import (
    Bounds,
    InputError,
    Layout,
    Misfit,
    Panel,
    Recording,
    Scene,
    SeriesPerLine,
    TwoPointReadout,
    VirtualGroundReadout,
    import_file,
    read_scene,
    reconstruct,
)

FRAMES = np.random.default_rng(7).uniform(250, 600, (4, 3, 5)).round(3)
ROWS, COLUMNS = 3, 5
SCENE = Scene(Panel(ROWS, COLUMNS), TwoPointReadout(), 140.0)


def table(path: Path, values: np.ndarray, delimiter: str = ",", header: str = "", **options: str) -> Path:
    np.savetxt(path, values, delimiter=delimiter, header=header, comments="", fmt="%.6f", **options)
    return path


def long_table(frames: np.ndarray, first: int = 0, frame: bool = True, swap: bool = False) -> np.ndarray:
    index = np.indices(frames.shape).reshape(3, -1)
    row, column = (index[2], index[1]) if swap else (index[1], index[2])
    fields = [row + first, column + first, frames.ravel()] + [index[0]] * frame
    return np.column_stack(fields)


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " ", "   "])
@pytest.mark.parametrize("header", [False, True])
@pytest.mark.parametrize("time", [False, True])
def test_a_table_of_one_frame_a_line_is_read(tmp_path: Path, delimiter: str, header: bool, time: bool) -> None:
    values = FRAMES.reshape(4, -1)
    names = ["time"] * time + [f"r{row}c{column}" for row in range(3) for column in range(5)]
    if time:
        values = np.column_stack([[0, 0.5, 1.25, 2], values])
    path = table(tmp_path / "m.csv", values, delimiter, delimiter.join(names) if header else "")
    recording, notes = import_file(path, ROWS, COLUMNS, baseline_frames=1)
    np.testing.assert_allclose(recording.resistance, FRAMES)
    np.testing.assert_array_equal(recording.time, [0, 0.5, 1.25, 2] if time else np.arange(4))
    np.testing.assert_array_equal(recording.role, [0, 1, 1, 1])
    assert any("header" in note for note in notes) == header
    assert any("row by row" in note for note in notes)


def test_layout_says_what_columns_without_a_header_are(tmp_path: Path) -> None:
    path = table(tmp_path / "m.csv", long_table(FRAMES)[:, [3, 2, 0, 1]])
    recording, notes = import_file(path, ROWS, COLUMNS, layout="frame, ohm, row, column")
    np.testing.assert_allclose(recording.resistance, FRAMES)
    assert any("one value a line as frame, value, row, column" in note for note in notes)
    spare = np.column_stack([FRAMES.reshape(4, -1)[:, :7], np.zeros(4), FRAMES.reshape(4, -1)[:, 7:]])
    names = [f"r{row}c{column}" for row in range(3) for column in range(5)]
    path = table(tmp_path / "spare.csv", spare)
    recording, _ = import_file(path, ROWS, COLUMNS, layout=",".join([*names[:7], "-", *names[7:]]))
    np.testing.assert_allclose(recording.resistance, FRAMES)


def test_a_layout_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    path = table(tmp_path / "m.csv", long_table(FRAMES))
    with pytest.raises(InputError, match="4 columns, but `layout` names 3"):
        import_file(path, ROWS, COLUMNS, layout="row,column,value")
    np.save(tmp_path / "m.npy", FRAMES)
    with pytest.raises(InputError, match="`layout` is for tables"):
        import_file(tmp_path / "m.npy", ROWS, COLUMNS, layout="row,column,value")


def test_the_signs_and_commas_of_spreadsheets_are_read(tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    lines = [";".join(f"{value:.3f}".replace(".", ",") for value in frame.ravel()) for frame in FRAMES]
    path.write_bytes("\ufeff# exported\r\n\r\n".encode() + "\r\n".join(lines).encode())
    recording, notes = import_file(path, ROWS, COLUMNS)
    np.testing.assert_allclose(recording.resistance, FRAMES)
    assert "decimal commas" in notes[0]
    path.write_text("\n".join(",".join(f'"{value}"' for value in frame.ravel()) for frame in FRAMES), encoding="utf-8")
    np.testing.assert_allclose(import_file(path, ROWS, COLUMNS)[0].resistance, FRAMES)


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("swap", [False, True])
def test_a_table_of_one_value_a_line_is_read(tmp_path: Path, first: int, swap: bool) -> None:
    lines = np.random.default_rng(1).permutation(long_table(FRAMES, first, swap=swap))
    path = table(tmp_path / "m.csv", lines)
    recording, notes = import_file(path, ROWS, COLUMNS, transpose=swap)
    np.testing.assert_allclose(recording.resistance, FRAMES)
    assert any(f"indices count from {first}" in note for note in notes)
    one = table(tmp_path / "one.csv", long_table(FRAMES[:1], first, False)[:, ::-1], header="Resistance [ohm],Col,ROW")
    np.testing.assert_allclose(import_file(one, ROWS, COLUMNS)[0].resistance, FRAMES[:1])


@pytest.mark.parametrize(
    ("array", "transpose"),
    [(FRAMES, False), (FRAMES.reshape(4, -1), False), (FRAMES.transpose(0, 2, 1), True), (FRAMES.astype("f4"), False)],
)
def test_numpy_arrays_are_read(tmp_path: Path, array: np.ndarray, transpose: bool) -> None:
    np.save(tmp_path / "m.npy", array)
    recording, notes = import_file(tmp_path / "m.npy", ROWS, COLUMNS, transpose=transpose)
    np.testing.assert_allclose(recording.resistance, FRAMES, rtol=1e-6)
    assert notes[0].startswith("read as (frames")
    np.save(tmp_path / "m.npy", array.reshape(4, *((5, 3) if transpose else (3, 5)))[0])
    np.testing.assert_allclose(
        import_file(tmp_path / "m.npy", ROWS, COLUMNS, transpose=transpose)[0].resistance, FRAMES[:1], rtol=1e-6
    )


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize(
    ("array", "said"),
    [
        (FRAMES.transpose(1, 2, 0), "(rows, columns, frames)"),
        (FRAMES, "(frames, rows, columns)"),
        (FRAMES[0], "(rows, columns)"),
    ],
)
def test_matlab_arrays_of_any_order_are_read(tmp_path: Path, array: np.ndarray, said: str, packed: bool) -> None:
    path = tmp_path / "m.mat"
    content = {"note": "text", "fs": 1.0, "s": {"a": array}, "z": array * 1j, "R": array, "i": np.arange(3)}
    scipy.io.savemat(path, content, do_compression=packed)
    recording, notes = import_file(path, ROWS, COLUMNS)
    np.testing.assert_array_equal(recording.resistance, FRAMES if array.ndim == 3 else FRAMES[:1])
    assert notes[0] == f"array R read as {said}"
    scipy.io.savemat(path, {"R": array, "S": array * 2})
    with pytest.raises(InputError, match="R, S would all fit; say which with `variable`"):
        import_file(path, ROWS, COLUMNS)
    assert import_file(path, ROWS, COLUMNS, variable="S")[0].resistance[0, 0, 0] == 2 * FRAMES[0, 0, 0]
    with pytest.raises(InputError, match="no numeric array 'T'; there are R, S"):
        import_file(path, ROWS, COLUMNS, variable="T")


@pytest.mark.parametrize("packed", [False, True])
def test_a_damaged_matlab_file_is_refused_in_one_sentence(tmp_path: Path, packed: bool) -> None:
    path = tmp_path / "m.mat"
    scipy.io.savemat(path, {"R": FRAMES.transpose(1, 2, 0)}, do_compression=packed)
    whole = path.read_bytes()
    for seed in range(300):
        generator = np.random.default_rng(seed)
        data = bytearray(whole[: generator.integers(120, len(whole))] if seed % 3 == 0 else whole)
        data[generator.integers(min(len(data), 300))] = generator.integers(256)
        path.write_bytes(data)
        try:
            assert import_file(path, ROWS, COLUMNS)[0].resistance.shape == FRAMES.shape
        except InputError as error:
            assert "\n" not in str(error)


def test_volts_and_codes_become_readings_or_one_sentence(tmp_path: Path) -> None:
    volts = 5.0 * 1000.0 / (FRAMES + 1000.0)  # across the reference: R = (Vcc − V)/V·Rref
    np.save(tmp_path / "v.npy", volts)
    recording, _ = import_file(tmp_path / "v.npy", ROWS, COLUMNS, SCENE, "volt")
    np.testing.assert_allclose(recording.resistance, FRAMES)
    assert recording.scene is SCENE
    np.save(tmp_path / "c.npy", np.floor(volts / 5 * 1024).astype(int))
    recording, _ = import_file(tmp_path / "c.npy", ROWS, COLUMNS, SCENE, "code")
    np.testing.assert_allclose(recording.resistance, FRAMES, rtol=0.005)
    for unit in ("volt", "code"):
        with pytest.raises(InputError, match=f"{unit} values need a scene with a readout"):
            import_file(tmp_path / "c.npy", ROWS, COLUMNS, None, unit)
    np.save(tmp_path / "m.npy", 1000 * volts)
    np.testing.assert_allclose(import_file(tmp_path / "m.npy", ROWS, COLUMNS, SCENE, "mV")[0].resistance, FRAMES)
    with pytest.raises(InputError, match="the unit 'V' is unknown; there are ohm, kohm, volt, mV, code"):
        import_file(tmp_path / "c.npy", ROWS, COLUMNS, SCENE, "V")
    codes = np.full((1, 3, 5), 500)
    codes[0, 1, 2] = 1024
    np.save(tmp_path / "c.npy", codes)
    with pytest.raises(InputError, match=r"c\.npy\[0, 1, 2\]: 1024 is no code of a 10-bit"):
        import_file(tmp_path / "c.npy", ROWS, COLUMNS, SCENE, "code")
    volts[2, 1, 3] = 5.5
    path = table(tmp_path / "v.csv", volts.reshape(4, -1))
    with pytest.raises(InputError, match=r"v\.csv:3:9: .*lies outside 0 to 5 V"):
        import_file(path, ROWS, COLUMNS, SCENE, "volt")


def test_what_is_at_a_rail_is_kept_as_a_bound(tmp_path: Path) -> None:
    codes = np.full((1, 3, 5), 500)
    codes[0, 0, :2] = 0, 1023
    np.save(tmp_path / "c.npy", codes)
    recording, notes = import_file(tmp_path / "c.npy", ROWS, COLUMNS, SCENE, "code")
    assert any(note.startswith("2 readings at or beyond a rail") for note in notes)
    np.testing.assert_array_equal(recording.readings().side[0, 0, :3], [1, -1, 0])
    volts = np.full((1, 3, 5), 2.5)
    volts[0, 0, :2] = 0, 5
    np.save(tmp_path / "v.npy", volts)
    np.testing.assert_array_equal(
        import_file(tmp_path / "v.npy", ROWS, COLUMNS, SCENE, "volt")[0].readings().side[0, 0, :3], [1, -1, 0]
    )
    ohm = np.full((1, 3, 5), 500.0)
    ohm[0, 0, :2] = np.inf, 0
    np.save(tmp_path / "r.npy", ohm)
    np.testing.assert_array_equal(
        import_file(tmp_path / "r.npy", ROWS, COLUMNS, SCENE, "ohm")[0].readings().side[0, 0, :3], [1, -1, 0]
    )


def lines_with(line: int, field: int, text: str) -> str:
    lines = [[f"{value}" for value in frame.ravel()] for frame in FRAMES]
    lines[line][field] = text
    return "\n".join(",".join(fields) for fields in lines)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no values"),
        ("\n# only a comment\n", "holds no values"),
        ("a,b,c\n", "holds a header but no values"),
        (
            "1,2\n3,4\n",
            ":1: 2 fields; 3 × 5 cells need 15, 16 with the time, or 3 or 4 for row, column",
        ),
        (lines_with(2, 6, "x3"), ":3:7: 'x3' is no number"),
        (lines_with(0, 6, "x3"), ":1:7: 'x3' is no number"),
        (lines_with(1, 3, ""), ":2:4: the reading of row 0, column 3 is missing"),
        (lines_with(1, 3, "1_000"), ":2:4: '1_000' is no number"),
        (lines_with(1, 3, "NaN"), ":2:4: the reading of row 0, column 3 is missing"),
        (lines_with(3, 14, "-2"), ":4:15: -2 must be a positive resistance in ohm"),
        (lines_with(3, 14, "1,2"), ":4: 16 fields, where line 1 has 15"),
        (lines_with(3, 14, '"1'), ":4: "),
        ("0,0,5\n0,0,6\n", ":2: the same cell as in line 1; several frames need a field"),
        ("0,0,5\n0,1,6\n", "row 0, column 2 is missing"),
        ("1,1,5\n3,6,6\n", ":2:2: column 6 is beyond the panel's 1 to 5"),
        ("0,0,5\n3,0,6\n", ":2:1: row 3 is beyond the panel's 0 to 2"),
        ("-1,0,5\n", ":1:1: row -1 is beyond"),
        ("0,0.5,5\n", ":1:2: 0.5 is no index"),
        ("frame,row,column,value\n4,0,0,5\n", "the reading of row 0, column 1 is missing"),
        (",".join(["1"] * 16) + "\n" + ",".join(["1"] * 16), ":2:1: times must be finite and grow"),
    ],
)
def test_a_fault_in_a_table_is_one_sentence_with_its_place(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "m.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        import_file(path, ROWS, COLUMNS, missing="refuse")
    assert str(caught.value).startswith(str(path)) and message in str(caught.value) and "\n" not in str(caught.value)


def test_one_value_for_each_listed_cell(tmp_path: Path) -> None:
    scene = Scene(Panel(3, 2, cells=((2, 0, 0.0, 15.0), (0, 1, 7.5, 0.0), (1, 1, 7.5, 7.5))))
    recording, notes = import_file(table(tmp_path / "m.csv", FRAMES[:, 0, :3]), scene=scene, unit="ohm")
    np.testing.assert_allclose(recording.recorded[:, [2, 0, 1], [0, 1, 1]], FRAMES[:, 0, :3])
    assert np.isnan(recording.recorded[:, 0, 0]).all() and any(
        "the order of the scene's list" in note for note in notes
    )


def test_the_place_of_a_transposed_value(tmp_path: Path) -> None:
    lines = long_table(FRAMES, 1, swap=True)
    lines[7, 2] = -1
    with pytest.raises(InputError, match=r"m\.csv:8:3: -1 must be a positive"):
        import_file(table(tmp_path / "m.csv", lines), ROWS, COLUMNS, transpose=True)


GARBAGE = np.random.default_rng(3).bytes(4000)


def sparse(path: Path) -> None:
    with path.open("wb") as handle:
        handle.truncate(600_000_000)


def boastful(path: Path) -> None:
    np.save(path, FRAMES)
    path.write_bytes(path.read_bytes().replace(b"(4, 3, 5), ", b"(400000000000, 3, 5), "))


@pytest.mark.parametrize(
    ("name", "make", "message"),
    [
        ("m.csv", lambda path: path.write_bytes(GARBAGE), "no text table"),
        ("m.csv", lambda path: path.write_bytes(b"1,2\n\xff\xfe,3"), ":2: no text table"),
        ("m.csv", lambda path: path.write_bytes(b"1" * 2_000_000), ":1: longer than"),
        ("m.csv", sparse, "more than 500000000 are not imported"),
        ("m.csv", Path.mkdir, "no file"),
        ("m.csv", lambda path: None, "No such file"),
        ("m.npy", lambda path: path.write_bytes(GARBAGE), "no readable .npy file"),
        ("m.npy", lambda path: path.write_bytes(b""), "no readable .npy file"),
        ("m.npy", lambda path: (np.save(path, FRAMES), os.truncate(path, 500)), "no readable .npy file"),
        ("m.npy", boastful, "no readable .npy file"),
        ("m.npy", lambda path: np.save(path, np.array([{}], dtype=object), allow_pickle=True), "no readable .npy"),
        ("m.npy", lambda path: np.save(path, FRAMES.astype(complex)), "no plain array of real numbers"),
        ("m.npy", lambda path: np.save(path, FRAMES.transpose(0, 2, 1)), "with `transpose` it would"),
        ("m.npy", lambda path: np.save(path, FRAMES[:, :2]), "is 4 × 2 × 5, which fits 3 × 5 cells in no way"),
        ("m.mat", lambda path: path.write_bytes(GARBAGE), "no readable .mat file"),
        ("m.mat", lambda path: path.write_bytes(b""), "no readable .mat file"),
        ("m.mat", lambda path: scipy.io.savemat(path, {"x": np.ones((2, 2))}), "the numeric arrays are: x (2 × 2)"),
        ("m.mat", lambda path: scipy.io.savemat(path, {"x": FRAMES * 1j}), "the numeric arrays are: none"),
        ("m.mat", lambda path: path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(600)), "save it with the option -v7"),
    ],
)
def test_a_fault_in_a_file_is_one_sentence(
    tmp_path: Path, name: str, make: Callable[[Path], object], message: str
) -> None:
    path = tmp_path / name
    make(path)
    with pytest.raises(InputError) as caught:
        import_file(path, ROWS, COLUMNS)
    assert str(path) in str(caught.value) and message in str(caught.value) and "\n" not in str(caught.value)


def test_what_is_asked_for_must_fit(tmp_path: Path) -> None:
    np.save(tmp_path / "m.npy", FRAMES)
    with pytest.raises(InputError, match="the scene's panel has 3 × 5 cells, not 5 × 3"):
        import_file(tmp_path / "m.npy", 5, 3, SCENE)
    with pytest.raises(InputError, match="5 baseline frames asked for, but the file holds 4 frames"):
        import_file(tmp_path / "m.npy", ROWS, COLUMNS, baseline_frames=5)
    with pytest.raises(InputError, match="a panel needs at least one row"):
        import_file(tmp_path / "m.npy", 0, 3)


def test_a_series_resistance_of_each_line_is_said(tmp_path: Path) -> None:
    np.save(tmp_path / "m.npy", FRAMES)
    scene = Scene(Panel(ROWS, COLUMNS), None, SeriesPerLine(tuple(70.0 + line for line in range(ROWS)), 71.0))
    _, notes = import_file(tmp_path / "m.npy", scene=scene, unit="ohm")
    assert any(f"series resistance rows from 70 to {69 + ROWS} ohm, columns 71 ohm" in note for note in notes)


def test_a_scene_file_describes_the_panel_of_an_import(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text("panel: {rows: 3, columns: 5}\nseries_resistance_ohm: 140\n", encoding="utf-8")
    assert read_scene(path) == Scene(Panel(3, 5), None, 140.0)
    path.write_text("seed: 1\nscene:\n  panel: {rows: 3, columns: 5}\n", encoding="utf-8")
    assert read_scene(path) == Scene(Panel(3, 5))
    path.write_text("seed: 1\nscene:\n  panel: {rows: 3, colums: 5}\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"scene\.yaml:3:"):
        read_scene(path)


def test_entries_of_a_scene_are_set_at_the_import(tmp_path: Path, lampest: Callable[..., Any]) -> None:
    scene, made = tmp_path / "scene.yaml", tmp_path / "m.h5"
    scene.write_text("panel: {rows: 3, columns: 5}\nseries_resistance_ohm: 140\n", encoding="utf-8")
    np.save(tmp_path / "m.npy", FRAMES)
    words = ("import", tmp_path / "m.npy", "--unit", "ohm", "--out", made)
    done = lampest(*words, "--scene", scene, "--set", "series_resistance_ohm=70", "--set", "panel.pitch_mm=4")
    assert done.code == 0, done.err
    assert Recording.load(made).scene == Scene(Panel(3, 5, 4.0), None, 70.0)
    made.unlink()
    wrong = lampest(*words, "--scene", scene, "--set", "panel.pitsch_mm=4")
    assert (wrong.code, made.exists()) == (2, False) and "pitsch_mm" in wrong.err
    nowhere = lampest(*words, "--rows", 3, "--columns", 5, "--set", "panel.pitch_mm=4")
    assert (nowhere.code, made.exists()) == (2, False) and "--scene" in nowhere.err


@pytest.mark.parametrize("ohm", ["1e29", "1e-9", "{rows: [140, 140, 1e29], columns: 70}"])
def test_a_series_resistance_that_no_wire_has_is_refused_where_it_stands(tmp_path: Path, ohm: str) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(f"panel: {{rows: 3, columns: 5}}\nseries_resistance_ohm: {ohm}\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"scene\.yaml:.*must lie between 1e-06 and 1e\+09 ohm"):
        read_scene(path)


def amplifiers(**volts: float) -> Scene:
    return Scene(Panel(ROWS, COLUMNS), VirtualGroundReadout(sense_ohm=70.0, feedback_ohm=4000.0, **volts))


def test_the_drive_and_the_converter_of_a_virtual_ground_have_voltages_of_their_own(tmp_path: Path) -> None:
    scene = amplifiers(drive_volt=0.5, converter_volt=2.5)
    truth = np.random.default_rng(2).uniform(1500, 6000, (1, ROWS, COLUMNS))
    volts = scene.circuit.exact_reading(truth)
    path = table(tmp_path / "v.csv", volts.reshape(1, -1))
    recording, notes = import_file(path, ROWS, COLUMNS, scene)
    assert any(note.startswith("unit volt, guessed") for note in notes)
    found = reconstruct(recording, [Misfit()], formulation="reduced", bounds=Bounds("none", "none"))
    np.testing.assert_allclose(found.cell_resistance, truth, rtol=1e-2)
    codes = np.floor(volts / 2.5 * 1024).astype(int)
    np.save(tmp_path / "c.npy", codes)
    np.testing.assert_allclose(import_file(tmp_path / "c.npy", scene=scene)[0].recorded, volts, atol=2.5 / 1024)
    both = amplifiers(supply_volt=5.0).circuit.exact_reading(truth)
    np.testing.assert_allclose(amplifiers(drive_volt=5.0).circuit.exact_reading(truth), both)
    with pytest.raises(ValueError, match="converter_volt must lie between"):
        amplifiers(converter_volt=0.0)


def test_volts_beyond_a_supply_that_is_the_drive_alone_are_no_millivolts(tmp_path: Path) -> None:
    scene = amplifiers(drive_volt=0.5, converter_volt=2.5)
    volts = scene.circuit.exact_reading(np.full((2, ROWS, COLUMNS), 2000.0))
    path = table(tmp_path / "v.csv", volts.reshape(2, -1))
    with pytest.raises(InputError, match=r"fit none of volt, mV, code in this scene, whose converter ends at 0.5 V"):
        import_file(path, scene=amplifiers(supply_volt=0.5))


def test_readings_that_mostly_stand_at_the_rail_of_a_shorted_cell_are_refused(tmp_path: Path) -> None:
    volts = np.full((2, ROWS, COLUMNS), 2.5)
    volts[0, 0] = 1.0
    path = table(tmp_path / "v.csv", volts.reshape(2, -1))
    with pytest.raises(InputError, match=r"25 of 30 readings stand at the rail .* is readout.converter_volt, 2.5 V"):
        import_file(path, scene=amplifiers(drive_volt=0.5, converter_volt=2.5), unit="volt")
    volts = np.full((2, ROWS, COLUMNS), 0.0)  # open cells, which an unloaded film has
    volts[0, 0] = 1.0
    recording, _ = import_file(table(tmp_path / "o.csv", volts.reshape(2, -1)), scene=amplifiers(), unit="volt")
    assert recording.recorded.shape == (2, ROWS, COLUMNS)


def test_an_array_becomes_the_recording_that_its_file_becomes(tmp_path: Path) -> None:
    volts = 5.0 * 1000.0 / (FRAMES + 1000.0)
    codes = np.floor(volts / 5 * 1024).astype(int)
    text = "panel: {rows: 3, columns: 5}\nreadout: {kind: two_point}\nseries_resistance_ohm: 140\n"
    (tmp_path / "scene.yaml").write_text(text, encoding="utf-8")
    for unit, values in (
        ("ohm", FRAMES),
        ("kohm", FRAMES / 1000),
        ("volt", volts),
        ("mV", 1000 * volts),
        ("code", codes),
    ):
        np.save(tmp_path / "m.npy", values)
        expected, _ = import_file(tmp_path / "m.npy", scene=SCENE, unit=unit, baseline_frames=2)
        for scene in (SCENE, tmp_path / "scene.yaml", str(tmp_path / "scene.yaml")):
            recording = Recording.from_array(values.tolist(), unit=unit, baseline=2, scene=scene, time=[0, 1, 2, 4])
            np.testing.assert_array_equal(recording.recorded, expected.recorded)
            np.testing.assert_array_equal(recording.role, [0, 0, 1, 1])
            np.testing.assert_array_equal(recording.time, [0, 1, 2, 4])
            assert recording.scene.panel == SCENE.panel
    plain = Recording.from_array(FRAMES)
    assert plain.scene == Scene(Panel(ROWS, COLUMNS)) and plain.time[-1] == 3 and np.all(plain.role == 1)
    assert reconstruct(Recording.from_array(FRAMES, baseline=1), [Misfit()]).solved.all()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"values": FRAMES[0]}, r"values must have the shape \(frames, rows, columns\) with at least one frame, not"),
        ({"values": FRAMES[:, :2], "scene": SCENE}, r"values must have the shape \(frames, 3, 5\) .*not \(4, 2, 5\)"),
        ({"values": FRAMES, "baseline": 5}, "baseline must be a number of frames from 0 to 4, not 5"),
        ({"values": FRAMES, "unit": "V"}, "the unit 'V' is unknown; there are ohm, kohm, volt, mV, code"),
        ({"values": FRAMES, "unit": "volt"}, "values: volt values need a scene with a readout"),
        (
            {"values": FRAMES, "unit": "volt", "scene": SCENE},
            r"values\[0, 0, 0\]: 468.* lies outside 0 to 5 V, the range",
        ),
        ({"values": FRAMES, "time": [0, 1]}, "time must hold one finite time for each frame"),
        ({"values": "m.csv"}, "values"),
    ],
)
def test_an_array_that_does_not_fit_is_refused_in_words_of_its_arguments(given: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        Recording.from_array(**given)
    assert "--" not in str(caught.value)


@dataclass(frozen=True)
class FramesInBytes(Layout):
    kind: ClassVar[str] = "frames_in_bytes"

    def read(self, path: Path, rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
        values = np.fromfile(path, dtype="<u2").reshape(-1, rows, columns)
        return values, np.arange(len(values)) * 50


def test_a_layout_of_ones_own_reads_what_it_knows(tmp_path: Path) -> None:
    codes = np.arange(300, 300 + 2 * ROWS * COLUMNS).astype("<u2").reshape(2, ROWS, COLUMNS)
    (tmp_path / "m.bin").write_bytes(codes.tobytes())
    recording, notes = import_file(tmp_path / "m.bin", scene=SCENE, unit="code", layout=FramesInBytes())
    np.testing.assert_allclose(recording.recorded, Recording.from_array(codes, unit="code", scene=SCENE).recorded)
    assert recording.time[-1] == 0.05 and notes[0] == "layout frames_in_bytes"
    assert any(note.startswith("time: ms (guessed") for note in notes)
    with pytest.raises(InputError, match=r"layout frames_in_bytes gives 2 × 5 × 3, not frames × 3 × 5"):
        import_file(tmp_path / "m.bin", scene=SCENE, unit="code", layout=Turned())


class Turned(FramesInBytes):
    def read(self, path: Path, rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
        return super().read(path, columns, rows)


@pytest.mark.parametrize("written", ["ROW{row}={line}", "R{row}: {line}", "row {row} = {line}"])
def test_rows_with_names_before_a_sign(tmp_path: Path, written: str) -> None:
    lines = [
        written.format(row=row, line=",".join(map(str, values))) for frame in FRAMES for row, values in enumerate(frame)
    ]
    (tmp_path / "m.log").write_text("\n".join(lines) + "\n", encoding="utf-8")
    recording, _ = import_file(tmp_path / "m.log", ROWS, COLUMNS)
    np.testing.assert_allclose(recording.resistance, FRAMES)
