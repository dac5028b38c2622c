"""What a result follows from: the content of input files and the versions of libraries."""

import hashlib
from functools import cache
from importlib.metadata import version
from pathlib import Path

from lampest.files.errors import InputError

LIBRARIES = ("lampest", "casadi", "numpy", "h5py")


def library_versions(*further: str) -> dict[str, str]:
    """Return the versions of the libraries that determine results, and of further ones."""
    return {library: _version(library) for library in (*LIBRARIES, *further)}


_version = cache(version)  # the metadata of a package take a millisecond to read


@cache
def code_digest() -> str:
    """Return the SHA-256 of lampest's modules, which a working copy changes within a version."""
    modules = sorted(Path(__file__).parents[1].rglob("*.py"))
    return hashlib.sha256(b"".join(module.read_bytes() for module in modules)).hexdigest()


def digest(path: Path) -> str:
    """Return the SHA-256 of a file. Raises InputError if it is unreadable."""
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
