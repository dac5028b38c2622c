"""Own parts of a program that a run file may name.

A part is a registered class, as a term is: a dataclass with a `kind`, derived from `ProgramPart`.
Installed packages add theirs by the entry point group `lampest.constraints`.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import casadi

from lampest.files.errors import InputError
from lampest.files.typed import ByKind, Configuration, check_positive_fields, members_by_kind

if TYPE_CHECKING:  # estimates without own parts load no program
    from lampest.formulation.program import Program

Cells = tuple[tuple[int, int], ...]
KILO = 1000.0  # ohm: rows of constraints are of order one


@dataclass(frozen=True)
class ProgramPart(Configuration):
    """Own unknowns, constraints and costs of the program of a frame.

    >>> lampest.KnownCells(cells=[[0, 1]], ohm=1000.0).cells
    ((0, 1),)
    """

    @abstractmethod
    def add_to(self, program: "Program") -> "Program":
        """Return the program with this part, by `subject_to`, `with_unknown` and `with_cost`."""


@dataclass(frozen=True)
class KnownCells(ProgramPart):
    """Cells of a known resistance, such as resistors of a calibration.

    Attributes
    ----------
    cells : tuple of pairs of int
        Row and column of each.
    ohm : float

    Raises ValueError unless the resistance is positive, and for no cells.

    >>> lampest.KnownCells(cells=[[0, 1]], ohm=1000.0).kind
    'known_cells'
    """

    cells: Cells
    ohm: float
    kind: Literal["known_cells"] = "known_cells"

    def __post_init__(self) -> None:
        check_positive_fields(self, "ohm")
        if not self.cells:
            raise ValueError("cells must name one or more that are known")

    def add_to(self, program: "Program") -> "Program":
        """Return the program with r/kΩ = ohm/1000 for each cell."""
        return program.subject_to(self.kind, _chosen(program, self.cells), self.ohm / KILO)


@dataclass(frozen=True)
class EqualCells(ProgramPart):
    """Cells that are one, such as those below a stiff plate.

    Attributes
    ----------
    cells : tuple of pairs of int
        Row and column of each, two or more.

    Raises ValueError for a single cell.

    >>> lampest.EqualCells(cells=[[0, 0], [0, 1]]).kind
    'equal_cells'
    """

    cells: Cells
    kind: Literal["equal_cells"] = "equal_cells"

    def __post_init__(self) -> None:
        if len(self.cells) < 2:
            raise ValueError("cells must name two or more that are equal")

    def add_to(self, program: "Program") -> "Program":
        """Return the program with r_k − r_0 = 0, in kΩ, for each cell k but the first."""
        cells = _chosen(program, self.cells)
        return program.subject_to(self.kind, cells[1:] - cells[0])


AnyPart = Annotated[KnownCells | EqualCells, ByKind("lampest.constraints")]


def _chosen(program: "Program", cells: Cells) -> Any:
    """Return some cells of a program in kΩ, (cells, 1).

    Raises InputError for a cell that the panel does not have, or that is named twice.
    """
    rows, columns = program.shape
    for row, column in cells:
        if not (0 <= row < rows and 0 <= column < columns):
            raise InputError(
                f"there is no cell [{row}, {column}] on a panel of {rows} × {columns} cells"
            )
    if len(set(cells)) < len(cells):
        raise InputError("a cell is named twice")
    matrix = program.cells()
    return casadi.vertcat(*(matrix[row, column] for row, column in cells)) / KILO


def part_types() -> dict[str, type[ProgramPart]]:
    """Return kind → class, first those of lampest, then those of installed packages.

    >>> sorted(lampest.part_types())
    ['equal_cells', 'known_cells']
    """
    return members_by_kind(AnyPart)
