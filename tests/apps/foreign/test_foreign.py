"""Layouts of a user's own: named, or known by the suffix of their files."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from lampest import Array, InputError, Layout, import_file
from lampest.apps.foreign import importing
from lampest.apps.foreign.line_reader import LineReader


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


def test_a_layout_is_given_or_follows_from_the_file_suffix(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importing, "LAYOUTS", (Numbers(),))
    for name, layout in (
        ("M.NUM", None),
        ("m.dat", "numbers"),
        ("m.num", "numbers"),
        ("m.dat", Numbers()),
    ):
        np.arange(500, 512, dtype="<u2").tofile(tmp_path / name)
        recording, notes = import_file(tmp_path / name, 2, 3, layout=layout)
        assert (
            notes[0] == "layout numbers"
            and recording.recorded[1, 1, 2] == 511.5
            and recording.time[1] == 0.05
        )
        assert any(note.startswith("time: ms (guessed") for note in notes)
    with pytest.raises(InputError, match="layout numbers gives 2 × 3 × 2, not frames × 2 × 3"):
        import_file(tmp_path / "m.dat", 2, 3, layout=Turned())
    with pytest.raises(
        InputError, match="layout='number'` is no import format; did you mean numbers"
    ):
        import_file(tmp_path / "m.dat", 2, 3, layout="number")
    (tmp_path / "m.num").write_text("1,2,3\n")
    assert (
        import_file(tmp_path / "m.num", 1, 3, unit="ohm", layout="r0c0,r0c2,r0c1")[0].recorded[
            0, 0, 1
        ]
        == 3
    )


def test_infinite_numbers_among_readings_are_refused_without_a_warning(tmp_path: Path) -> None:
    """A field of infinite numbers has no steps by which it could be a time."""
    path = tmp_path / "m.csv"
    path.write_text("0,-1e999,0,1e999\novf,-1e999,1e999,1e999\n1e999,0,1e999,ovf\n")
    with pytest.raises(InputError, match=r"m\.csv"):
        import_file(path, 2, 3)


def test_days_of_excel_are_times_of_lines_that_come_one_after_the_other() -> None:
    """Frames every half a second, in days since 1899-12-30 with nine decimals."""
    reader = LineReader((2, 3))
    frames = [
        frame
        for number in range(20)
        for frame in reader.feed(
            f"{45_000 + number / 172_800:.9f},500,510,520,530,540,5{number:02}"
        )
    ]
    seconds = np.array([frame.seconds for frame in frames], dtype=float)
    assert len(frames) == 20 and np.allclose(seconds, np.arange(20) / 2, atol=1e-4)
