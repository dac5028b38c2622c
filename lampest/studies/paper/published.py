"""What the paper publishes as numbers, figure by figure, read from the one file that holds them."""

from dataclasses import dataclass
from importlib.resources import files
from typing import Any, ClassVar, Literal, cast

from lampest.files.document import parse_document, validated
from lampest.report.compare import Steps
from lampest.runs.terms import FORBID

FILE = "published.yaml"


@dataclass(frozen=True)
class ChangeAt:
    """ΔR/R₀ of a cell in percent at a pressure in kPa."""

    __pydantic_config__: ClassVar[Any] = FORBID
    kpa: float
    percent: float


@dataclass(frozen=True)
class SlopeOver:
    """δ(ΔR/R₀)/δP per kPa between two pressures in kPa."""

    __pydantic_config__: ClassVar[Any] = FORBID
    from_kpa: float
    to_kpa: float
    per_kpa: float


@dataclass(frozen=True)
class PublishedResponse:
    """Figure 1-e: a flat cell under pressure, and its inset."""

    __pydantic_config__: ClassVar[Any] = FORBID
    place: str
    changes: tuple[ChangeAt, ...]
    slopes: tuple[SlopeOver, ...]


@dataclass(frozen=True)
class BentCell:
    """A bent cell: unloaded resistance, and ΔR/R₀ in percent at 40 kPa."""

    __pydantic_config__: ClassVar[Any] = FORBID
    curvature_per_m: float
    ohm: float
    percent: float
    radius_mm: float | None = None


@dataclass(frozen=True)
class PublishedBending:
    """Figure 2."""

    __pydantic_config__: ClassVar[Any] = FORBID
    place: str
    cells: tuple[BentCell, ...]


@dataclass(frozen=True)
class LoadMap:
    """A map of figure 6: what was on the panel; recording : the shipped one of it."""

    __pydantic_config__: ClassVar[Any] = FORBID
    letter: str
    recording: str
    condition: str


@dataclass(frozen=True)
class PublishedLoads:
    """Figure 6."""

    __pydantic_config__: ClassVar[Any] = FORBID
    place: str
    maps: tuple[LoadMap, ...]


@dataclass(frozen=True)
class RangeMap:
    """A map of figure 8: smallest and largest relative change in percent."""

    __pydantic_config__: ClassVar[Any] = FORBID
    letter: str
    method: str
    low: float
    high: float


@dataclass(frozen=True)
class PublishedRanges:
    """Figure 8."""

    __pydantic_config__: ClassVar[Any] = FORBID
    place: str
    maps: tuple[RangeMap, ...]


@dataclass(frozen=True)
class MouthMap:
    """A map of figure 9: `cells` by `cells` of the grid are covered."""

    __pydantic_config__: ClassVar[Any] = FORBID
    letter: str
    diameter_mm: float
    cells: int


@dataclass(frozen=True)
class PublishedMouths:
    """Figure 9."""

    __pydantic_config__: ClassVar[Any] = FORBID
    place: str
    method: str
    maps: tuple[MouthMap, ...]


@dataclass(frozen=True)
class ErrorRow:
    """A row of table I: time of a step in s, and |f(r) − R_m|/R_m in percent, mean and standard deviation."""

    __pydantic_config__: ClassVar[Any] = FORBID
    method: str
    steps: Steps
    time_s: float
    error_percent: float
    error_sd_percent: float
    time_sd_s: float | None = None


@dataclass(frozen=True)
class PublishedErrors:
    """Table I."""

    __pydantic_config__: ClassVar[Any] = FORBID
    place: str
    rows: tuple[ErrorRow, ...]


@dataclass(frozen=True)
class Published:
    """All of it."""

    __pydantic_config__: ClassVar[Any] = FORBID
    schema: Literal[1]
    response: PublishedResponse
    bending: PublishedBending
    loads: PublishedLoads
    ranges: PublishedRanges
    mouths: PublishedMouths
    errors: PublishedErrors


def published_numbers() -> Published:
    """The numbers of the package's own file."""
    text = files("lampest.studies.paper").joinpath(FILE).read_text(encoding="utf-8")
    return cast(Published, validated(parse_document(text, FILE), Published))
