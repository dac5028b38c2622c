"""Files to import, their expected content, and the two checks of it."""

from collections.abc import Callable, Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lampest import (
    InputError,
    LoadedColumnsReadout,
    Panel,
    Recording,
    Scene,
    TwoPointReadout,
    import_file,
)

ROWS = 3
ROUNDING = 1e-12  # relative, and of times in thousands of seconds
COLUMNS = 5
FRAMES = np.random.default_rng(7).uniform(250, 600, (4, ROWS, COLUMNS)).round(3)
CODES = np.random.default_rng(7).integers(200, 900, (4, ROWS, COLUMNS))
DIVIDER = Scene(Panel(ROWS, COLUMNS), TwoPointReadout(), 140.0)
LOADED = Scene(
    Panel(ROWS, COLUMNS),
    LoadedColumnsReadout(load_ohm=10_000.0, supply_volt=3.3, adc_bits=12, readings=1),
)
VOLT_OF_CODES = CODES * 3.3 / 4096  # code c stands for c steps


def lines(values: Any, sign: str = ",", decimal: str = ".") -> list[str]:
    return [
        sign.join(str(value).replace(".", decimal) for value in np.ravel(line)) for line in values
    ]


def names(pattern: str, first: int = 0, sign: str = ",") -> str:
    return sign.join(
        pattern.format(r=row + first, c=column + first) for row, column in np.ndindex(ROWS, COLUMNS)
    )


def foreign_file(
    content: str | bytes | Iterable[str] | Callable[[Path], object],
    *notes: str,
    name: str = "m.csv",
    **options: Any,
) -> SimpleNamespace:
    """Return a file, the sentences of its import, and its expected content.

    content : a text, its lines, bytes, or a function that writes the file. expected, times, start,
    role : of the recording, where they are checked. absent : text of no sentence. options :
    arguments of the import.
    """
    parts = {part: options.pop(part, None) for part in ("times", "start", "role", "absent")}
    expected = options.pop("expected", FRAMES)
    plain = content if isinstance(content, str | bytes) or callable(content) else "\n".join(content)
    return SimpleNamespace(
        content=plain, notes=notes, name=name, expected=expected, how=options, **parts
    )


def written(folder: Path, file: SimpleNamespace) -> Path:
    path = folder / file.name
    content = file.content
    if callable(content):
        content(path)
    else:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def imported(folder: Path, file: SimpleNamespace) -> tuple[Recording, tuple[str, ...]]:
    return import_file(written(folder, file), **({"rows": ROWS, "columns": COLUMNS} | file.how))


def check_taken(file: SimpleNamespace, folder: Path) -> None:
    """Assert the expected frames, times and start of an import.

    The notes must contain all expected words.
    """
    recording, notes = imported(folder, file)
    assert all(any(words in note for note in notes) for words in file.notes), notes
    assert file.absent is None or not any(file.absent in note for note in notes)
    check_content(recording, file)


def check_saved(file: SimpleNamespace, folder: Path) -> None:
    """Assert that an import is the same after saving and loading."""
    recording, _ = imported(folder, file)
    recording.save(folder / "saved.h5")
    loaded = Recording.load(folder / "saved.h5")
    check_content(loaded, file)
    assert loaded.scene == recording.scene


def check_content(recording: Recording, file: SimpleNamespace) -> None:
    """Assert the expected frames, times, start and role of a recording."""
    if file.expected is not None:
        np.testing.assert_allclose(recording.recorded, file.expected, rtol=ROUNDING)
    if file.times is not None:
        np.testing.assert_allclose(recording.time, file.times, rtol=ROUNDING, atol=1e3 * ROUNDING)
    assert recording.start_time == file.start
    assert file.role is None or recording.role.tolist() == file.role


def check_refused(file: SimpleNamespace, folder: Path) -> None:
    """One sentence, which begins with the file unless `absent` says otherwise."""
    with pytest.raises(InputError) as caught:
        imported(folder, file)
    message = str(caught.value)
    assert "\n" not in message and all(words in message for words in file.notes), message
    assert file.absent or message.startswith(str(folder / file.name)), message
