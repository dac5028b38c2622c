"""What the paper publishes as numbers, figure by figure, read from the one file that holds them."""

from importlib.resources import files
from pathlib import Path
from typing import Literal, NamedTuple, cast

from lampest.files.document import parse_document, read_document, validated
from lampest.report.compare import Steps

FILE = "published.yaml"


class ChangeAt(NamedTuple):
    """Figure 1-e: ΔR/R₀ of a flat cell in percent at a pressure in kPa."""

    kpa: float
    percent: float


class SlopeOver(NamedTuple):
    """Its inset: δ(ΔR/R₀)/δP per kPa between two pressures in kPa."""

    from_kpa: float
    to_kpa: float
    per_kpa: float


class BentCell(NamedTuple):
    """Figure 2, a bent cell: unloaded resistance, and ΔR/R₀ in percent at 40 kPa."""

    curvature_per_m: float
    ohm: float
    percent: float
    radius_mm: float | None = None


class LoadMap(NamedTuple):
    """A map of figure 6: what was on the panel; recording : the shipped one of it."""

    letter: str
    recording: str
    condition: str


class RangeMap(NamedTuple):
    """A map of figure 8: smallest and largest relative change in percent."""

    letter: str
    method: str
    low: float
    high: float


class MouthMap(NamedTuple):
    """A map of figure 9: `cells` by `cells` of the grid are covered."""

    letter: str
    diameter_mm: float
    cells: int


class ErrorRow(NamedTuple):
    """A row of table I: time of a step in s, and |f(r) − R_m|/R_m in percent, mean and standard deviation."""

    method: str
    steps: Steps
    time_s: float
    error_percent: float
    error_sd_percent: float
    time_sd_s: float | None = None


class Published(NamedTuple):
    """All of it; places : where in the paper, by subject."""

    schema: Literal[1]
    places: dict[str, str]
    changes: tuple[ChangeAt, ...]
    slopes: tuple[SlopeOver, ...]
    bent_cells: tuple[BentCell, ...]
    loads: tuple[LoadMap, ...]
    ranges: tuple[RangeMap, ...]
    mouth_method: str
    mouths: tuple[MouthMap, ...]
    errors: tuple[ErrorRow, ...]


def published_numbers(path: Path | None = None) -> Published:
    """The numbers of a file, the package's own by default. Raises InputError with line and column."""
    if path is not None:
        return cast(Published, validated(read_document(path), Published))
    text = files("lampest.studies.paper").joinpath(FILE).read_text(encoding="utf-8")
    return cast(Published, validated(parse_document(text, FILE), Published))
