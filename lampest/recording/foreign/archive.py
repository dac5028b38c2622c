"""Zip files (.xlsx, .npz) whose parts are what they claim to be, before any of them is unpacked."""

import zipfile
from pathlib import Path

from lampest.files.errors import InputError
from lampest.recording.foreign.frames import MOST_BYTES

MOST_PARTS = 10_000


def check_archive(path: Path, kind: str) -> None:
    """Raise InputError where a file is no zip archive, or its parts claim more bytes than are imported.

    Python's reader of zip files gives no more of a part than it claims.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            parts = archive.infolist()
    except (zipfile.BadZipFile, ValueError, NotImplementedError, EOFError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: no readable {kind} file ({' '.join(str(error).split())})") from error
    claimed = sum(part.file_size for part in parts)
    if claimed > MOST_BYTES:
        raise InputError(f"{path}: unpacks to {claimed} bytes, more than {MOST_BYTES} are not imported")
    if len(parts) > MOST_PARTS:
        raise InputError(f"{path}: {len(parts)} parts, more than {MOST_PARTS} are not imported")
    if any(part.flag_bits & 1 for part in parts):
        raise InputError(f"{path}: is locked with a password")
