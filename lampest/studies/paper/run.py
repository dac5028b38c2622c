"""What `lampest paper` does: solve what is planned, draw, write."""

from collections.abc import Callable
from pathlib import Path

from lampest.studies.paper.page import write_page
from lampest.studies.paper.published import published_numbers
from lampest.studies.paper.side import SceneSet, solved


def shipped_folder() -> Path:
    """Where `configs/` and `data/` stand: within an installed package, or beside that of a checkout."""
    package = Path(__file__).parents[2]
    inside = package / "shipped"
    return inside if inside.is_dir() else package.parent


def scene_sets(shipped: Path) -> tuple[SceneSet, ...]:
    """The sets of scenes, in the order of the page; shipped : the folder that holds `configs/` and `data/`."""
    return (
        SceneSet(
            "clean scenes",
            "clean",
            "The shipped recordings: readings within half a percent of the circuit, series resistance told and taken "
            "off for the estimates (not in maps of measured resistance, as in the paper), optima verified.",
            shipped / "configs" / "table1.yaml",
        ),
    )


def write_paper(shipped: Path, folder: Path, jobs: int | None, on_case: Callable[[int, int], None]) -> tuple[Path, ...]:
    """Solve, draw and write all of it into a folder; what was solved there before is taken from it.

    Returns the files. Raises InputError where a shipped file is missing, a case fails, or the folder cannot be written.
    """
    published = published_numbers()
    sides = [solved(scenes, published, folder, shipped / "data", jobs, on_case) for scenes in scene_sets(shipped)]
    return write_page(folder, sides, published)
