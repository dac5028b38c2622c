"""Whether a file is what was written."""

from pathlib import Path

from lampest.files import hdf5
from lampest.files.errors import InputError
from lampest.files.seal import check_seal
from lampest.recording.recording import FORMAT as RECORDING
from lampest.recording.stored import WHOLE, StoredRecording, opened
from lampest.runs.results import FORMAT, read_each

SEALED = "as written: {bytes} bytes in {pieces} pieces agree with their checksums"
UNSEALED = "readable, but without checksums: an older version or another program wrote it, or it was never closed"


def checked_sentence(path: Path) -> str:
    """Reads all of a file, and says what vouches for it.

    Raises InputError where a piece is not what was written, with the path of the dataset, or the file cannot be read.
    """
    with hdf5.existing_file(path) as file:
        form = hdf5.read_attribute(file, "/", "lampest_format")
    try:
        pieces = check_seal(path, everything=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    if form == FORMAT:
        for _ in read_each(path, WHOLE):
            pass
    elif form == RECORDING or not pieces:
        recording = opened(path)
        if isinstance(recording, StoredRecording):
            for part in recording.blocks():
                recording.part(part)
    said = SEALED.format(bytes=sum(piece.length for piece in pieces), pieces=len(pieces)) if pieces else UNSEALED
    return f"{path}: {said}"
