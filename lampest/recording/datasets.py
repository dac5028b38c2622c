"""Recordings and files shipped with lampest.

A checkout has these files in `configs/` and `data/`, a wheel in `lampest/shipped/`.

>>> lampest.datasets.names()[-2:]
('ring', 'rod')
"""

from pathlib import Path

from lampest.files.errors import InputError
from lampest.recording.recording import Recording


def folder() -> Path:
    """Return the folder of `configs/` and `data/`."""
    package = Path(__file__).parents[1]
    return package / "shipped" if (package / "shipped").is_dir() else package.parent


def names() -> tuple[str, ...]:
    """Return the names of the shipped recordings in alphabetical order."""
    return tuple(sorted(file.stem for file in (folder() / "data").glob("*.h5")))


def load(name: str) -> Recording:
    """Return a shipped recording, simulated, with its scene and truth.

    Raises InputError for an unknown name.

    >>> lampest.datasets.load("lamprey_35mm").resistance.shape  # frames, rows, columns; ohm
    (24, 10, 10)
    """
    if name not in names():
        raise InputError(
            f"there is no recording {name!r} in lampest; there are {', '.join(names())}"
        )
    return Recording.load(folder() / "data" / f"{name}.h5")
