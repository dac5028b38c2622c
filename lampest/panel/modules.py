"""A sensing surface of equal modules: panels of their own beside each other, whose images make one image.

Lines end at a module's border, so that no current crosses a seam: each module is a network, and each has its readings.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lampest.files.typed import Validated

Place = tuple[int, int]


@dataclass(frozen=True)
class EachModule(Validated):
    """What one module is: rows, columns of lines, and pitch_mm between its cells."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    rows: int
    columns: int
    pitch_mm: float = 10.0


@dataclass(frozen=True)
class Modules(Validated):
    """rows · columns modules, each as `each` says; module (j, k) has the number j·columns + k.

    seam_mm : what lies between neighbouring cells of two modules beside the pitch, in millimetre.

    Raises ValueError where a number is out of range.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    rows: int
    columns: int
    each: EachModule
    seam_mm: float = 0.0

    def __post_init__(self) -> None:
        if min(self.rows, self.columns, self.each.rows, self.each.columns) < 1:
            raise ValueError("modules need at least one row and one column of modules, and of cells in each")
        if not 0 <= self.seam_mm <= 1e6:
            raise ValueError("seam_mm must be zero or positive, and finite: at most 1e+06")

    @property
    def count(self) -> int:
        """How many modules there are."""
        return self.rows * self.columns

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of the whole image's cells."""
        return self.rows * self.each.rows, self.columns * self.each.columns

    def place(self, number: int) -> Place:
        """(row, column) of a module of that number."""
        return divmod(number, self.columns)

    def cells(self, number: int) -> tuple[slice, slice]:
        """Where the cells of a module stand in the image."""
        row, column = self.place(number)
        rows, columns = self.each.rows, self.each.columns
        return slice(row * rows, (row + 1) * rows), slice(column * columns, (column + 1) * columns)

    def split(self, image: NDArray[Any]) -> NDArray[Any]:
        """(…, rows, columns) of the image → (…, modules, rows, columns) of each."""
        each, shape = self.each, image.shape[:-2]
        blocks = image.reshape(*shape, self.rows, each.rows, self.columns, each.columns)
        return np.moveaxis(blocks, -3, -2).reshape(*shape, self.count, each.rows, each.columns)

    def joined(self, parts: NDArray[Any]) -> NDArray[Any]:
        """The inverse of `split`."""
        each, shape = self.each, parts.shape[:-3]
        blocks = parts.reshape(*shape, self.rows, self.columns, each.rows, each.columns)
        return np.moveaxis(blocks, -2, -3).reshape(*shape, *self.shape)
