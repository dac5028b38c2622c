"""Whether a file is what was written."""

from pathlib import Path

from lampest.files import hdf5
from lampest.recording.recording import FORMAT as RECORDING
from lampest.recording.stored import WHOLE, StoredRecording, opened
from lampest.runs.results import FORMAT, read_each

SEALED = "as written: {bytes} bytes in {datasets} datasets agree with their checksums"
UNSEALED = "readable, but without checksums: an older version or another program wrote it, or it was never closed"


def checked_sentence(path: Path) -> str:
    """Reads all of a file, and says what vouches for it.

    Raises InputError where a dataset is not what was written, with its path, or the file cannot be read.
    """
    with hdf5.existing_file(path) as file:
        form = hdf5.read_attribute(file, "/", "lampest_format")
    size, datasets = hdf5.checked(path)
    if form == FORMAT:
        for _ in read_each(path, WHOLE):
            pass
    elif form == RECORDING or not datasets:
        recording = opened(path)
        if isinstance(recording, StoredRecording):
            for part in recording.blocks():
                recording.part(part)
    return f"{path}: {SEALED.format(bytes=size, datasets=datasets) if datasets else UNSEALED}"
