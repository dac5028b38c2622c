"""What studies have in common in their YAML files: methods, panels of several sizes, a lamprey's mouth."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeVar

from lampest.cost.terms import CellResistance, Gradient, GradientOfRelativeChange, Misfit, RelativeChange, Term
from lampest.estimate.estimator import Bounds
from lampest.files.typed import Configuration, check_range
from lampest.loads.shapes import OralDisc
from lampest.recording.simulation.simulation import Course
from lampest.runs.config import Terms, terms_of

LARGEST_SIDE = 1000  # of a simulated panel
SERIES_OHM = 140  # two multiplexer channels, as in the shipped scenes
Shape = tuple[int, int]
Sizes = tuple[int | Shape, ...]  # sides of square panels, or [rows, columns]
PAPER: dict[str, tuple[Term, ...]] = {  # the paper's five methods with its weights
    "LSM": (Misfit(),),
    "LSR-CR": (Misfit(), CellResistance(weight=1e-3)),
    "LSR-dCR": (Misfit(), RelativeChange(weight=10)),
    "LSR-gCR": (Misfit(), Gradient(weight=1e-3)),
    "LSR-gdCR": (Misfit(), GradientOfRelativeChange(weight=10)),
}
BREATHING = Course(start_s=-0.8, approach_s=0.6, attachment_s=2, breathing_hz=1.15, breathing_depth=0.1)


@dataclass(frozen=True)
class StudyMethod(Configuration):
    """The terms of one method, as in a run's file. Raises ValueError without a term."""

    terms: Terms  # type: ignore[valid-type]

    def __post_init__(self) -> None:
        if not self.parts:
            raise ValueError("a method needs at least one term")

    @property
    def parts(self) -> tuple[Term, ...]:
        """The terms, in order."""
        return terms_of(self.terms)


@dataclass(frozen=True)
class SquaredMethod(StudyMethod):
    """Squared losses alone. Raises ValueError for a loss that is no least-squares problem."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not all(term.loss.squared for term in self.parts):
            raise ValueError("only squared losses can be compared with a least-squares solver")


@dataclass(frozen=True)
class BoundedMethod(StudyMethod):
    """Terms, and bounds of its own."""

    bounds: Bounds = Bounds()


Method = TypeVar("Method", bound=StudyMethod)


def paper_methods(kind: type[Method]) -> dict[str, Method]:
    """The five methods of the paper with its weights."""
    return {name: kind(Terms(**{term.kind: term for term in terms})) for name, terms in PAPER.items()}  # type: ignore[attr-defined]


def shapes_of(sizes: Sizes) -> tuple[Shape, ...]:
    """(rows, columns) of every panel."""
    return tuple((size, size) if isinstance(size, int) else size for size in sizes)


def check_sides(shapes: Iterable[Shape], low: int, high: int) -> None:
    """Raise ValueError unless all rows and columns lie in a range and no panel comes twice."""
    shapes = list(shapes)
    check_range("a panel's side", [side for shape in shapes for side in shape], low, high)
    if len(set(shapes)) < len(shapes):
        raise ValueError("sizes names a panel twice")


def lamprey_mouth(centre_mm: tuple[float, float], diameter_mm: float = 35.0) -> OralDisc:
    """That of the shipped recording of a lamprey, 35 mm wide with a rim of 6 mm, of any size at any place."""
    return OralDisc(
        kind="oral_disc",
        centre_mm=centre_mm,
        diameter_mm=diameter_mm,
        rim_width_mm=diameter_mm * 6 / 35,
        pressure_kpa=-12,
        rim_kpa=90,
        tilt=0.25,
        tilt_direction_deg=60,
    )
