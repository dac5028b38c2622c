"""Firmware → pseudo-terminal → record → file → cells, compared with the truth."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import serial
from apps.board.bench import bench, loaded_scene, random_cells, scene

from lampest import (
    MEASURED,
    UNLOADED,
    Array,
    Recording,
    import_file,
    two_point_resistance,
)
from lampest.apps.board.record import record
from lampest.apps.board.sample import Listening
from tests.netlist import impedance_of

# Of 2,000 readings: three standard errors of their spread are 5 %; the mean of rounded codes is off
# by a share of a code, too.
MEAN_ERROR = 0.1
SPREAD_ERROR = 0.06
NOISE_ERROR_LSB = 0.04  # the same of 0.7 LSB
CARRIED_CODES = 50  # e^-0.5 of a step between cells of 10 ohm and 1 kilohm is some 250
MILLISECOND_S = 1e-3  # of the board's clock
YEAR_2023_S = 1.7e9  # seconds since 1970
CODE_ERROR = 0.02  # relative, of readings of 10 bits


@pytest.mark.slow
def test_readings_scatter_around_the_truth_as_their_sigma_says(tmp_path: Path) -> None:
    cells = np.repeat(random_cells(np.random.default_rng(5), 1), 20, axis=0)
    with bench(tmp_path, cells) as board:
        summary = record(
            Listening((board.port,), scene=scene(), baseline=12), tmp_path / "r.h5", frames=20
        )
    recording = Recording.load(summary.path)
    deviation = (recording.resistance - two_point_resistance(cells) - 140) / recording.sigma
    assert abs(deviation.mean()) < MEAN_ERROR
    assert deviation.std() == pytest.approx(1, abs=SPREAD_ERROR)
    assert summary.noise_lsb == pytest.approx(0.7, abs=NOISE_ERROR_LSB)
    assert recording.role.tolist() == [UNLOADED] * 12 + [MEASURED] * 8


@pytest.mark.slow
def test_a_slowly_settling_line_carries_the_previous_cell_into_the_reading(tmp_path: Path) -> None:
    """The simulated line has a time constant."""
    cells = np.full((1, 2, 2), 1000.0)
    cells[0, 0, 0] = 10.0
    sums = []
    for settle_us in (2, 100):
        (tmp_path / str(settle_us)).mkdir()
        with bench(
            tmp_path / str(settle_us), cells, "--noise-lsb", 0, "--settle-us", settle_us
        ) as board:
            record(
                Listening((board.port,), scene=scene(2, 2, 1)),
                tmp_path / f"{settle_us}.h5",
                frames=2,
            )
        sums.append(Recording.load(tmp_path / f"{settle_us}.h5").raw_sums)
    first, late = (np.asarray(frame[1], dtype=float) for frame in sums)
    assert late[0, 1] > first[0, 1] + CARRIED_CODES


@pytest.mark.slow
def test_a_file_names_clocks_numbers_and_events_of_its_frames(tmp_path: Path) -> None:
    cells = random_cells(np.random.default_rng(1), 1, 4, 3)
    presses = iter(["", "", "x", "", "ab"])
    with bench(tmp_path, cells) as board:
        record(
            Listening((board.port,), scene=scene(4, 3), period=0.5),
            tmp_path / "r.h5",
            frames=5,
            keys=lambda: next(presses),
        )
    recording = Recording.load(tmp_path / "r.h5")
    np.testing.assert_allclose(recording.time, [0, 0.5, 1, 1.5, 2], atol=2 * MILLISECOND_S)
    assert recording.acquisition.sequence.tolist() == [0, 1, 2, 3, 4]
    assert np.all(np.diff(recording.acquisition.device_ms.astype(int)) >= 500 - 1)
    assert (
        np.all(np.diff(recording.acquisition.host_time) >= 0)
        and recording.acquisition.host_time[0] > YEAR_2023_S
    )
    assert not recording.acquisition.lost.any() and not recording.acquisition.missed.any()
    assert recording.acquisition.event_label == ("x", "a", "b")
    np.testing.assert_allclose(recording.acquisition.event_time, recording.time[[2, 4, 4]])
    with h5py.File(tmp_path / "r.h5") as file:
        assert "lampest_unfinished" not in file.attrs
        assert file["entry/acquisition/lost"].attrs["units"] == b"1"


@pytest.mark.slow
def test_the_lines_of_the_example_match_the_panel(tmp_path: Path) -> None:
    cells = np.full((10, 10), 3000.0)
    cells[2, 7] = 300.0
    with (
        bench(tmp_path, cells[None], sketch="print_table") as board,
        serial.Serial(board.port, timeout=30) as port,
    ):
        lines = [port.readline() for _ in range(3)]
    log = tmp_path / "monitor.log"
    log.write_bytes(b"".join(lines))
    recording, _ = import_file(log, scene=scene(), unit="code")
    assert recording.recorded.shape == (3, 10, 10)
    expected = two_point_resistance(cells) + 140
    np.testing.assert_allclose(recording.recorded[-1], expected, rtol=CODE_ERROR)
    assert np.unravel_index(np.argmin(recording.recorded[-1]), (10, 10)) == (2, 7)


# Both wirings.

WIRINGS = {"two_point": scene, "loaded_columns": loaded_scene}


@pytest.mark.long
@pytest.mark.parametrize("wiring", WIRINGS)
def test_a_recording_without_a_scene_takes_that_of_the_board(tmp_path: Path, wiring: str) -> None:
    with bench(tmp_path, random_cells(np.random.default_rng(2), 1), wiring=wiring) as board:
        summary = record(Listening((board.port,)), tmp_path / "r.h5", seconds=2)
    recording = Recording.load(tmp_path / "r.h5")
    known = scene(series_resistance_ohm=0) if wiring == "two_point" else loaded_scene()
    assert (
        summary.scene
        == recording.scene
        == replace(known, readout=replace(known.readout, noise_lsb=None))
    )
    assert recording.recorded.shape == (2, 10, 10)


def node_voltages(cells: Array, drive_ohm: Array, load_ohm: Array) -> Array:
    """Return the voltages (rows, columns) of all columns while each row is driven.

    Kirchhoff's current law gives them node by node.
    """
    volts = np.zeros(cells.shape)
    for row, ohm in enumerate(drive_ohm):
        ties = np.concatenate([np.arange(len(cells)) == row, np.ones(len(load_ohm))])
        impedance = impedance_of(
            cells, scene(*cells.shape), ties / np.concatenate([drive_ohm, load_ohm])
        )
        volts[row] = 5 / ohm * impedance[len(cells) :, row]
    return volts


@pytest.mark.long
@pytest.mark.parametrize(
    ("wiring", "rows", "columns", "readings"),
    [
        *(("two_point", *sizes) for sizes in ((1, 1, 1), (3, 7, 64), (16, 16, 4), (2, 16, 5))),
        *(
            ("loaded_columns", *sizes)
            for sizes in ((1, 1, 1), (3, 8, 64), (16, 16, 4), (5, 11, 20))
        ),
    ],
)
def test_noise_free_readings_of_any_size_are_exact_to_the_converter(
    tmp_path: Path, wiring: str, rows: int, columns: int, readings: int
) -> None:
    """Sums equal readings · ⌊1024·V/5⌋ for all channels, inputs (A8 to A15 too) and switches."""
    rng = np.random.default_rng(rows)
    cells = random_cells(rng, 3, rows, columns)
    volts = 5 * 1000 / (two_point_resistance(cells) + 140 + 1000)
    options = ("--noise-lsb", 0)
    if wiring == "loaded_columns":
        drive = np.round(rng.uniform(40, 160, rows), 1)
        load = np.round(rng.uniform(9_000, 11_000, columns), 0)
        options += ("--row-ohm", ",".join(map(str, drive)), "--load-ohm", ",".join(map(str, load)))
        volts = np.array([node_voltages(frame, drive, load) for frame in cells])
    with bench(tmp_path, cells, *options, wiring=wiring) as board:
        record(
            Listening((board.port,), scene=WIRINGS[wiring](rows, columns, readings)),
            tmp_path / "r.h5",
            frames=3,
        )
    recording = Recording.load(tmp_path / "r.h5")
    assert recording.raw_readings == readings
    np.testing.assert_array_equal(recording.raw_sums, readings * np.floor(1024 * volts / 5 + 0.5))
