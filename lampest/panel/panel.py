"""The panel: rows × columns of cells, their numbering, and finite differences over them."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lampest.files.document import LARGEST, SMALLEST
from lampest.files.memory import check_memory
from lampest.panel.modules import Modules

Array = NDArray[np.floating[Any]]
LEAST_PITCH_MM, MOST_PITCH_MM = 1e-3, 1e6  # a transistor's width, a street's length
MANY_LINES = 2000  # fewer fit into 100 MB


@dataclass(frozen=True)
class Panel:
    """A matrix of rows · columns cells; cell (j, k) joins row j and column k and has the number j·columns + k.

    Parameters
    ----------
    rows, columns : number of lines on either side, at least 1.
    pitch_mm : distance between neighbouring cells in millimetre; positions and pictures use it, equations do not.
    modules : the panels that this one is an image of, which say rows, columns and pitch; None: a panel of one network.

    Raises ValueError where a number is out of range.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    rows: int = 0
    columns: int = 0
    pitch_mm: float = 10.0
    modules: Modules | None = None

    def __post_init__(self) -> None:
        if self.modules is not None:
            (rows, columns), pitch = self.modules.shape, self.modules.each.pitch_mm
            if (self.rows or rows, self.columns or columns) != (rows, columns):
                raise ValueError(f"the modules make {rows} × {columns} cells, not {self.rows} × {self.columns}")
            for name, value in (("rows", rows), ("columns", columns), ("pitch_mm", pitch)):
                object.__setattr__(self, name, value)
        if self.rows < 1 or self.columns < 1:
            raise ValueError("a panel needs at least one row and one column")
        if not LEAST_PITCH_MM <= self.pitch_mm <= MOST_PITCH_MM:
            raise ValueError(
                f"pitch_mm must be positive and finite, a length between {LEAST_PITCH_MM:g} and {MOST_PITCH_MM:g} mm"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.rows, self.columns

    @property
    def cells(self) -> int:
        """rows · columns."""
        return self.rows * self.columns

    def check_memory(self, matrices: int = 3) -> None:
        """Raise InputError where there is no room for so many matrices (lines, lines) over the panel's lines.

        matrices : the impedance, what it is solved from, and room to solve it.
        """
        if self.rows + self.columns > MANY_LINES:
            check_memory(
                8.0 * matrices * (self.rows + self.columns) ** 2,
                f"a panel of {self.rows} × {self.columns} cells ({self.rows + self.columns} lines)",
            )

    def centres_mm(self) -> tuple[Array, Array]:
        """x_k = k·pitch and y_j = j·pitch, and the seams before them: positions of columns and rows in millimetre."""
        x, y = np.arange(self.columns), np.arange(self.rows)
        if self.modules is None:
            return x * self.pitch_mm, y * self.pitch_mm
        each, seam = self.modules.each, self.modules.seam_mm
        return x * self.pitch_mm + x // each.columns * seam, y * self.pitch_mm + y // each.rows * seam

    @property
    def extent_mm(self) -> tuple[float, float]:
        """Width and height, millimetre: half a pitch beyond the outermost cells."""
        x, y = self.centres_mm()
        return float(x[-1]) + self.pitch_mm, float(y[-1]) + self.pitch_mm

    @property
    def networks(self) -> tuple["Panel", ...]:
        """The panels that are networks of their own: itself, or its modules."""
        if self.modules is None:
            return (self,)
        each = self.modules.each
        return (Panel(each.rows, each.columns, each.pitch_mm),) * self.modules.count

    def row_gradient(self) -> Array:
        """D with (D x)_j = (x_{j+1} − x_{j−1})/2 inside and one-sided at the ends, (rows, rows), per unit cell."""
        return difference_matrix(self.rows)

    def column_gradient(self) -> Array:
        """The same along a row, (columns, columns): the gradient of a matrix X is (D_row X, X D_columnᵀ)."""
        return difference_matrix(self.columns)


def beyond_any_panel(values: Array) -> NDArray[np.bool_]:
    """Where a number, neither zero, infinite nor missing, is so small or so large that its square has no digits."""
    size = np.abs(values)
    beyond: NDArray[np.bool_] = np.isfinite(values) & (values != 0) & ((size < SMALLEST) | (size > LARGEST))
    return beyond


def as_panels_have(values: Array) -> Array:
    """Zero for numbers that are smaller than any panel's, infinity with their sign for larger ones; else themselves."""
    if not np.any(beyond := beyond_any_panel(values)):
        return values
    return np.where(beyond, np.where(np.abs(values) < SMALLEST, 0.0, np.copysign(np.inf, values)), values)


def difference_matrix(length: int) -> Array:
    """D (length, length): central differences inside, one-sided at the border, zero for a single point.

    Source: MATLAB's `gradient` with unit spacing, which the paper's equations (19)-(24) use.
    """
    difference = np.zeros((length, length))
    if length == 1:
        return difference
    inner = np.arange(1, length - 1)
    difference[inner, inner + 1] = 0.5
    difference[inner, inner - 1] = -0.5
    difference[0, :2] = -1.0, 1.0
    difference[-1, -2:] = -1.0, 1.0
    return difference
