"""A foreign file's frames, whatever kind of file it is; nothing is read that claims too much."""

from pathlib import Path

from lampest.files.errors import InputError
from lampest.recording.foreign.arrays import MATLAB_LAYOUTS, NUMPY_LAYOUTS, frames_of_arrays
from lampest.recording.foreign.data_lines import table_of_rows
from lampest.recording.foreign.excel_file import sheets_of
from lampest.recording.foreign.frames import MOST_BYTES, Frames
from lampest.recording.foreign.layout import frames_of
from lampest.recording.foreign.matlab_file import read_arrays
from lampest.recording.foreign.numpy_file import array_of_npy, arrays_of_npz
from lampest.recording.foreign.text_file import rows_of_text

NOT_READ = {".xls": "save it as .xlsx", ".ods": "save it as .xlsx or .csv", ".xlsb": "save it as .xlsx"}

NAMED = (".mat", ".npz", ".xlsx", ".xlsm")


def read_frames(path: Path, shape: tuple[int, int], variable: str | None) -> Frames:
    """The frames of a file by its suffix, text for any other than .xlsx, .xlsm, .npy, .npz and .mat.

    Raises InputError where it cannot be read, is too large, or does not fit the panel.
    """
    kind = path.suffix.lower()
    try:
        size = path.stat().st_size
        if not path.is_file():
            raise InputError(f"{path}: no file")
        if size > MOST_BYTES:
            raise InputError(f"{path}: {size} bytes, more than {MOST_BYTES} are not imported")
        if kind in NOT_READ:
            raise InputError(f"{path}: {kind} files are not read; {NOT_READ[kind]}")
        if variable is not None and kind not in NAMED:
            raise InputError(f"{path}: holds nothing by name; --variable is for {', '.join(NAMED)}")
        if kind in (".xlsx", ".xlsm"):
            return _of_sheets(path, shape, variable)
        if kind == ".npy":
            return frames_of_arrays(str(path), array_of_npy(path), shape, None, NUMPY_LAYOUTS, 0)
        if kind == ".npz":
            return frames_of_arrays(str(path), arrays_of_npz(path), shape, variable, NUMPY_LAYOUTS, 0)
        if kind == ".mat":
            return frames_of_arrays(str(path), read_arrays(path), shape, variable, MATLAB_LAYOUTS, 1)
        return frames_of(table_of_rows(rows_of_text(path)), shape)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error
    except MemoryError as error:
        raise InputError(f"{path}: claims more data than the memory holds") from error


def _of_sheets(path: Path, shape: tuple[int, int], wanted: str | None) -> Frames:
    """The one sheet that fits; where none does, what is wrong with the first."""
    fitting: dict[str, Frames] = {}
    wrong: list[InputError] = []
    for name, rows in sheets_of(path, wanted).items():
        try:
            fitting[name] = frames_of(table_of_rows(rows), shape)
        except InputError as error:
            wrong.append(error)
    if len(fitting) > 1:
        raise InputError(f"{path}: the sheets {', '.join(fitting)} would all fit; say which with --variable")
    if not fitting:
        raise wrong[0] if wrong else InputError(f"{path}: holds no values")
    return next(iter(fitting.values()))
