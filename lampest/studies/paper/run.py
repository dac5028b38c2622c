"""What `lampest paper` does: solve, draw, write."""

from collections.abc import Callable
from pathlib import Path

from lampest.recording.datasets import folder as shipped_folder
from lampest.studies.paper.page import write_page
from lampest.studies.paper.published import published_numbers
from lampest.studies.paper.sides import all_sides


def write_paper(folder: Path, jobs: int | None, on_case: Callable[[int, int], None]) -> tuple[Path, ...]:
    """Solve, draw and write all of it into a folder; what was solved there before is taken from it.

    Returns the files. Raises InputError where a shipped file is missing, a case fails, or the folder cannot be written.
    """
    published = published_numbers()
    return write_page(folder, all_sides(shipped_folder(), folder, published, jobs, on_case), published)
