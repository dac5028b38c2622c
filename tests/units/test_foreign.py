"""How files of others are understood: stamps, units of times and of values, the order of an array's frames."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from lampest import Array, InputError, Layout, LoadedColumnsReadout, import_file
from lampest.recording.foreign import importing
from lampest.recording.foreign.arrays import frames_of_arrays
from lampest.recording.foreign.unit import _fitting
from lampest.recording.foreign.words import clock_of, clock_of_numbers

# Two stamps, the second a second or a day later, with the order of the date and the start that they mean.
STAMPS = (
    ("2025-01-31", "2025-02-01", 86400, "2025-01-31T00:00:00", "year-month-day"),
    ("2025-01-31 12:00:00 AM", "2025-01-31 12:00:01 AM", 1, "2025-01-31T00:00:00", "year-month-day"),
    ("31.01.2025 12:30:00 pm", "31.01.2025 12:30:01 pm", 1, "2025-01-31T12:30:00", "day.month.year"),
    ("1/31/2025 11:59:59 PM", "2/1/2025 12:00:00 AM", 1, "2025-01-31T23:59:59", "month/day/year"),
    ("2025-01-31T09:05:00.5Z", "2025-01-31T09:05:01.5Z", 1, "2025-01-31T09:05:00.5Z", "year-month-day"),
)


def test_stamps_are_iso_dates_in_the_order_that_fits() -> None:
    for first, second, seconds, start, way in STAMPS:
        clock = clock_of((first, second), "time", str, comma=False, unit=None)
        zone = "" if start.endswith("Z") else ", no zone in the file"
        assert (clock.seconds.tolist(), clock.start) == ([0, seconds], start)
        assert clock.sentence == f"{way}, s from the first, which is {start}{zone}"
    day = clock_of(("23:59:58", "23:59:59", "00:00:01"), "time", str, comma=False, unit=None)
    assert (day.seconds.tolist(), day.start) == ([0, 1, 3], None)
    assert day.sentence == "time of day, s from the first; it began at 23:59:58, the date is not in the file"


def test_the_unit_of_times_follows_from_their_step_and_size() -> None:
    for values, name, unit, seconds, sentence in (
        ((0, 10, 20), "t", None, (0, 0.01, 0.02), "ms (guessed: whole numbers that grow by 10"),
        ((0, 9, 18), "t", None, (0, 9, 18), "s (assumed; --time-unit says otherwise)"),
        ((0, 10.5, 21), "t", None, (0, 10.5, 21), "s (assumed; --time-unit says otherwise)"),
        ((0, 10_000, 20_000), "t", None, (0, 0.01, 0.02), "us (guessed: whole numbers that grow by 10000"),
        ((0, 9_999, 19_998), "t", None, (0, 9.999, 19.998), "ms (guessed: whole numbers that grow by 9999"),
        ((0, 10, 20), "t", "us", (0, 1e-5, 2e-5), "us (as specified)"),
        ((0, 10, 20), "t_s", None, (0, 10, 20), "s"),
    ):
        clock = clock_of_numbers(np.array(values, dtype=float), name, str, unit)
        np.testing.assert_allclose(clock.seconds, seconds)
        assert clock.start is None and clock.sentence.startswith(sentence)
        assert len(clock.sentence) > len(sentence) or "guessed" not in sentence


# Values as they are in a file, the readout of the scene, and the units that they may have, with the reason.
LOADED_READOUT = LoadedColumnsReadout(load_ohm=10_000.0, supply_volt=3.3, adc_bits=12, readings=1)
FITTING: tuple[tuple[list[float], Any, list[str], str], ...] = (
    ([0.5], None, ["kohm"], "without a readout they are kohm below 1, ohm from 10 on"),
    ([1.0], None, ["ohm", "kohm"], "without a readout they are kohm below 1, ohm from 10 on"),
    ([10.0], None, ["ohm"], "without a readout they are kohm below 1, ohm from 10 on"),
    ([4095.0, 3.0], LOADED_READOUT, ["code"], "within 0 to 4095 of a 12-bit converter"),
    ([4096.0, 3.0], LOADED_READOUT, [], ""),
    ([3.3, 0.123], LOADED_READOUT, ["volt"], "within the converter's range of 3.3 V"),
    ([3300.0, 0.123], LOADED_READOUT, ["mV"], "within the converter's range of 3300 mV"),
    ([3300.1, 0.123], LOADED_READOUT, [], ""),
    ([3.0, 2.0], LOADED_READOUT, ["volt", "code"], "within the converter's range of 3.3 V"),
    ([100.5, 200.25], replace(LOADED_READOUT, readings=4), ["mV", "code"], "within the converter's range of 3300 mV"),
    ([100.1, 200.9], replace(LOADED_READOUT, readings=8), ["mV", "code"], "within the converter's range of 3300 mV"),
    ([100.6, 200.25], replace(LOADED_READOUT, readings=4), ["mV"], "within the converter's range of 3300 mV"),
)


def test_units_fit_by_the_range_and_the_steps_of_the_converter() -> None:
    for values, readout, units, reason in FITTING:
        allowed = ("ohm", "kohm") if readout is None else ("volt", "mV", "code")
        assert _fitting(np.array(values), allowed, readout) == (units, reason), values


def test_frames_of_an_array_are_in_order_and_a_value_is_named_by_its_place(tmp_path: Path) -> None:
    for shape in ((2, 3), (4, 2, 3), (5, 6), (2, 3, 4), (2, 2, 3)):
        array = 500.0 + np.arange(np.prod(shape)).reshape(shape)
        np.save(tmp_path / "m.npy", array)
        frames = frames_of_arrays(tmp_path / "m.npy", (2, 3), None)
        stacked = shape == (2, 3, 4)
        expected = (array.transpose(2, 0, 1) if stacked else array).reshape(-1, 2, 3)
        np.testing.assert_array_equal(frames.values, expected)
        (note,) = frames.notes
        assert note.startswith("array ") is False and ("(rows, columns, frames)" in note) == stacked
        place = np.argwhere(array == expected[-1, 1, 2])[0].tolist()
        assert frames.place(len(expected) - 1, 1, 2) == f"{tmp_path / 'm.npy'}[{', '.join(map(str, place))}]"


@dataclass(frozen=True)
class Numbers(Layout):
    kind: ClassVar[str] = "numbers"
    suffixes: ClassVar[tuple[str, ...]] = (".num",)

    def read(self, path: Path, rows: int, columns: int) -> tuple[Array, Array]:
        values = np.fromfile(path, dtype="<u2").reshape(-1, rows, columns) + 0.5
        return values, np.arange(len(values)) * 50


class Turned(Numbers):
    def read(self, path: Path, rows: int, columns: int) -> tuple[Array, Array]:
        return super().read(path, columns, rows)


def test_a_layout_is_named_or_known_by_the_suffix_of_its_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importing, "LAYOUTS", (Numbers(),))
    for name, layout in (("M.NUM", None), ("m.dat", "numbers"), ("m.num", "numbers"), ("m.dat", Numbers())):
        np.arange(500, 512, dtype="<u2").tofile(tmp_path / name)
        recording, notes = import_file(tmp_path / name, 2, 3, layout=layout)
        assert notes[0] == "layout numbers" and recording.recorded[1, 1, 2] == 511.5 and recording.time[1] == 0.05
        assert any(note.startswith("time: ms (guessed") for note in notes)
    with pytest.raises(InputError, match="layout numbers gives 2 × 3 × 2, not frames × 2 × 3"):
        import_file(tmp_path / "m.dat", 2, 3, layout=Turned())
    (tmp_path / "m.num").write_text("1,2,3\n")
    assert import_file(tmp_path / "m.num", 1, 3, unit="ohm", layout="r0c0,r0c2,r0c1")[0].recorded[0, 0, 1] == 3
