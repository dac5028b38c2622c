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


def _declarations() -> str:
    return (library_folder() / "lampest_estimate.h").read_text(encoding="utf-8")


def constants_fields() -> list[str]:
    """Return the fields of lampest_constants in the order of their declaration."""
    above, _, _ = _declarations().partition("} lampest_constants;")
    declared = re.sub(r"/\*.*?\*/", "", above.rpartition("typedef struct {")[2], flags=re.DOTALL)
    return re.findall(r"(\w+)[,;]", declared)


def library_version() -> int:
    """Return LAMPEST_ESTIMATE_VERSION, 10,000 major + 100 minor + patch.

    Constants must name the same version.
    """
    match = re.search(r"^#define LAMPEST_ESTIMATE_VERSION (\d+)$", _declarations(), re.MULTILINE)
    assert match is not None
    return int(match[1])
