"""One multiplexer and loaded columns: from the simulated board's pins to the file, the cells, the page."""

import ctypes
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from board.bench import FIRMWARE, bench, built, lampest, loaded_scene, scene, some_cells
from support import live_pictures

from lampest import InputError, Misfit, Recording, Scene
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import reconstruct
from lampest.files.document import to_yaml
from lampest.panel.panel import Array
from lampest.recording.board.protocol import Hello, Receiver, message
from lampest.recording.board.record import record
from lampest.recording.board.stream import declared_readout, scene_of
from lampest.recording.recording import UNLOADED
from lampest.report.live.run import LiveBoard, recorded_from_board
from tests.bodies import hello_body

WIRING = "loaded_columns"
SHIPPED = Path(__file__).parents[2] / "data" / "lamprey_35mm.h5"


def node_voltages(cells: Array, drive_ohm: Array, load_ohm: Array) -> Array:
    """Volts of every column while each row is driven, (rows, columns): Kirchhoff's current law, node by node."""
    rows, columns = cells.shape
    found = np.zeros((rows, columns))
    for driven in range(rows):
        law, current = np.zeros((rows + columns, rows + columns)), np.zeros(rows + columns)
        for row in range(rows):
            for column in range(columns):
                one, other, siemens = row, rows + column, 1 / cells[row, column]
                law[one, one] += siemens
                law[other, other] += siemens
                law[one, other] -= siemens
                law[other, one] -= siemens
        law[driven, driven] += 1 / drive_ohm[driven]
        current[driven] = 5 / drive_ohm[driven]
        for column in range(columns):
            law[rows + column, rows + column] += 1 / load_ohm[column]
        found[driven] = np.linalg.solve(law, current)[rows:]
    return found


@pytest.mark.parametrize(("rows", "columns", "readings"), [(1, 1, 1), (3, 8, 64), (16, 16, 4), (5, 11, 20)])
def test_every_code_is_that_of_the_node_equations(tmp_path: Path, rows: int, columns: int, readings: int) -> None:
    """Without noise sums are readings · ⌊1024·V/5⌋: every row, input (A8 to A15 too) and byte is where it belongs."""
    rng = np.random.default_rng(rows)
    cells, drive = some_cells(rng, 2, rows, columns), np.round(rng.uniform(40, 160, rows), 1)
    load = np.round(rng.uniform(9_000, 11_000, columns), 0)
    options = ("--row-ohm", ",".join(map(str, drive)), "--load-ohm", ",".join(map(str, load)), "--noise-lsb", 0)
    with bench(tmp_path, cells, *options, wiring=WIRING) as board:
        record(board.port, tmp_path / "r.h5", frames=2, scene=loaded_scene(rows, columns, readings))
    found = Recording.load(tmp_path / "r.h5")
    codes = [np.floor(1024 * node_voltages(frame, drive, load) / 5) for frame in cells]
    np.testing.assert_array_equal(found.raw_sums, readings * np.array(codes))


@pytest.mark.slow
def test_from_the_board_to_the_cells_by_the_commands(tmp_path: Path) -> None:
    """The shipped lamprey on the loaded board: record → /entry/readings in volt → run → the truth."""
    shipped = Recording.load(SHIPPED)
    truth, out = shipped.truth_cell_resistance, tmp_path / "r.h5"
    assert truth is not None
    baseline = int(np.sum(shipped.role == UNLOADED))
    (tmp_path / "scene.yaml").write_text(to_yaml(loaded_scene()))
    with bench(tmp_path, truth, wiring=WIRING) as board:
        words = ("--port", board.port, "--out", out, "--scene", tmp_path / "scene.yaml", "--baseline", baseline)
        said, complained = lampest("record", *words, "--count", len(truth))
    assert said.startswith(f"{len(truth)} frames, 0 lost") and complained == ""
    with h5py.File(out) as file:
        assert file["entry"].attrs["default"] == b"readings"
        assert file["entry/readings"].attrs["signal"] == b"volt"
        assert file["entry/readings/volt"].attrs["units"] == b"volt"
    recording = Recording.load(out)
    assert recording.scene == loaded_scene()
    (tmp_path / "run.yaml").write_text("schema: 1\nrecordings: [r.h5]\nestimators: {LSM: {terms: {misfit: {}}}}\n")
    lampest("run", tmp_path / "run.yaml", "--out", tmp_path / "results", "--set", "formulation=reduced")
    found = reconstruct(recording, Estimator((Misfit(),), "reduced"))
    error = np.abs(found.cell_resistance / truth[found.frame] - 1)
    assert np.median(error) < 0.02
    naive = np.abs(
        recording.scene.circuit.apparent_resistance(recording.recorded[found.frame]) / truth[found.frame] - 1
    )
    assert np.median(naive) > 5 * np.median(error)


def test_live_and_the_file_agree(tmp_path: Path) -> None:
    truth = np.repeat(some_cells(np.random.default_rng(8), 1, 6, 7), 4, axis=0)
    truth[1:, 2:4, 2:5] *= np.array([0.3, 0.2, 0.1])[:, None, None]
    known, estimator, out = loaded_scene(6, 7), Estimator((Misfit(),), "reduced"), tmp_path / "r.h5"
    with bench(tmp_path, truth, wiring=WIRING) as board:
        pictures = live_pictures(
            estimator,
            1,
            lambda engine: recorded_from_board(engine, LiveBoard((board.port,), known, 1, None, out), 4),
        )
    found = reconstruct(Recording.load(out), estimator)
    assert [picture.status for picture in pictures] == ["optimum verified"] * 3
    ratio = np.array([1 + picture.relative_change / 100 for picture in pictures])
    np.testing.assert_allclose(ratio, found.cell_resistance / found.baseline_resistance, rtol=1e-7)


def test_without_a_scene_the_board_is_believed(tmp_path: Path) -> None:
    with bench(tmp_path, some_cells(np.random.default_rng(2), 1), wiring=WIRING) as board:
        done = record(board.port, tmp_path / "r.h5", frames=2)
    assert done.scene == Recording.load(tmp_path / "r.h5").scene == loaded_scene(noise_lsb=None)


@pytest.mark.parametrize(("wiring", "told"), [(WIRING, scene(4, 4)), ("two_point", loaded_scene(4, 4))])
def test_a_scene_of_the_other_circuit_is_refused_in_one_sentence(tmp_path: Path, wiring: str, told: Scene) -> None:
    (tmp_path / "scene.yaml").write_text(to_yaml(told))
    assert told.readout is not None
    with bench(tmp_path, some_cells(np.random.default_rng(2), 1, 4, 4), wiring=wiring) as board:
        words = ("--port", board.port, "--out", tmp_path / "r.h5", "--scene", tmp_path / "scene.yaml", "--count", 1)
        _, complained = lampest("record", *words, code=2)
    sentence = f"the scene's readout.kind is {told.readout.kind}, but the board says that it is wired as {wiring}"
    assert sentence in complained and complained.count("\n") == 1
    assert not (tmp_path / "r.h5").exists()


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"driven": "columns"}, "readout.driven is columns, but the board says rows"),
        ({"polarity": "down"}, "readout.polarity is down, but the board says up"),
        ({"supply_volt": 3.3}, "readout.supply_volt is 3.3, but the board says 5 "),
        ({"load_ohm": 1000.0}, "readout.load_ohm is 1000, but the board says 10000"),
        ({"load_ohm": (10_000.0,) * 9 + (12_000.0,)}, "readout.load_ohm is 12000, but the board says 10000"),
    ],
)
def test_what_scene_and_board_say_differently_is_named(changes: dict[str, object], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        scene_of(hello(), loaded_scene(**changes))


def test_a_calibrated_scene_fits_the_board_that_it_was_made_with() -> None:
    known = loaded_scene(load_ohm=tuple(np.linspace(9_700, 10_300, 10)), drive_ohm=tuple(np.linspace(60, 90, 10)))
    assert scene_of(hello(), known) is known


def hello() -> Hello:
    """What the board of this wiring says, of its own C."""
    library = ctypes.CDLL(str(built(WIRING) / "libprotocol.so"))
    library.lampest_start_settings.restype = Settings
    settings, room = library.lampest_start_settings(), ctypes.create_string_buffer(64)
    size = library.lampest_hello(ctypes.byref(settings), room)
    (found,) = Receiver().feed(message(room.raw[:size]))[1]
    assert isinstance(found, Hello)
    assert hello_body(found) == room.raw[:size]
    return found


class Settings(ctypes.Structure):
    """lampest_settings_t"""

    _fields_ = [
        *((name, ctypes.c_uint8) for name in ("rows", "columns", "readings", "running")),
        ("settle_us", ctypes.c_uint16),
        ("period_us", ctypes.c_uint32),
    ]


def test_the_wiring_is_part_of_what_the_board_says() -> None:
    found = hello()
    assert (found.wiring, found.reference_milliohm, found.drive_milliohm) == (WIRING, 10_000_000, 70_000)
    assert declared_readout(found) == loaded_scene(noise_lsb=None).readout


def test_a_board_that_says_nothing_of_its_wiring_has_two_multiplexers() -> None:
    """HELLO as every earlier firmware sent it, 29 bytes; and nothing is made of a wiring never heard of."""
    old = replace(hello(), wiring="two_point", drive_milliohm=0)
    assert len(hello_body(old)) == 29
    assert Receiver().feed(message(hello_body(old)))[1] == (old,)
    unknown = hello_body(hello())[:29] + bytes([9, 0, 0, 0, 0])
    assert not any(isinstance(item, Hello) for item in Receiver().feed(message(unknown))[1])


def test_platformio_builds_both_wirings() -> None:
    assert "-DLAMPEST_WIRING=LAMPEST_LOADED_COLUMNS" in (FIRMWARE / "platformio.ini").read_text()
