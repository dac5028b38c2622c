"""What `lampest paper` does: solve, draw, write."""

from collections.abc import Callable
from pathlib import Path

from lampest.studies.paper.page import write_page
from lampest.studies.paper.published import published_numbers
from lampest.studies.paper.sides import all_sides


def shipped_folder() -> Path:
    """Where `configs/` and `data/` stand: within an installed package, or beside that of a checkout."""
    package = Path(__file__).parents[2]
    inside = package / "shipped"
    return inside if inside.is_dir() else package.parent


def write_paper(folder: Path, jobs: int | None, on_case: Callable[[int, int], None]) -> tuple[Path, ...]:
    """Solve, draw and write all of it into a folder; what was solved there before is taken from it.

    Returns the files. Raises InputError where a shipped file is missing, a case fails, or the folder cannot be written.
    """
    published = published_numbers()
    return write_page(folder, all_sides(shipped_folder(), folder, published, jobs, on_case), published)
