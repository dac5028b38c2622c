"""`lampest study paper`: solve, draw, write; beside the published numbers."""

from collections.abc import Callable
from pathlib import Path

from lampest.recording.datasets import folder as shipped_folder
from lampest.studies.paper.page import write_page
from lampest.studies.paper.published import published_numbers
from lampest.studies.paper.sides import all_sides
from lampest.studies.study import Reported


def write_paper(numbers: Path | None, folder: Path, jobs: int | None, on_case: Callable[[int, int], None]) -> Reported:
    """Solve, draw and write all of it into a folder; what was solved there before is taken from it.

    Raises InputError where a shipped file is missing, a case fails, or the folder cannot be written.
    """
    published = published_numbers(numbers)
    return Reported((), write_page(folder, all_sides(shipped_folder(), folder, published, jobs, on_case), published))
