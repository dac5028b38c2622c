"""The files of the C library, and its version."""

import re
from pathlib import Path

from lampest.recording.datasets import folder


def library_folder() -> Path:
    """Return the folder of the C library."""
    return folder() / "firmware" / "lampest_estimate"


def sources() -> tuple[Path, ...]:
    """Return the files of the C library."""
    return tuple(sorted([*library_folder().glob("*.c"), *library_folder().glob("*.h")]))


def library_version() -> int:
    """Return LAMPEST_ESTIMATE_VERSION, 10,000 major + 100 minor + patch.

    Constants must name the same version.
    """
    text = (library_folder() / "lampest_estimate.h").read_text(encoding="utf-8")
    match = re.search(r"^#define LAMPEST_ESTIMATE_VERSION (\d+)$", text, re.MULTILINE)
    assert match is not None
    return int(match[1])
