"""Panel: cells at crossings of rows and columns, their positions, neighbours and differences."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lampest.files.document import MAX_NUMBER, MIN_NUMBER
from lampest.files.process import check_memory
from lampest.files.typed import Configuration, check_positive_fields, check_ranges

Array = NDArray[np.floating[Any]]
Mask = NDArray[np.bool_]
Numbers = NDArray[np.intp]
Shape = tuple[int, ...]
MAX_PITCH_MM = 1e6  # mm: a kilometre, beyond any panel
MAX_CELLS = 1_000_000  # of a panel, or of the image of its modules (tests/units/test_claims.py)
# lines: matrices over fewer lines fit into 100 MB, and memory is not checked
MAX_UNCHECKED_LINES = 2000
PLACE_TOLERANCE = 1.01  # factor on squared distances: positions are written with three digits
# (row, column, x_mm, y_mm), or with z_mm
CellPlace = tuple[int, int, float, float] | tuple[int, int, float, float, float]


def check_line_memory(rows: int, columns: int) -> None:
    """Raise InputError if memory does not suffice for three matrices (lines, lines).

    L and Z are such matrices.
    """
    lines = rows + columns
    if lines > MAX_UNCHECKED_LINES:
        check_memory(24.0 * lines**2, f"a panel of {rows} × {columns} cells ({lines} lines)")


@dataclass(frozen=True)
class EachModule(Configuration):
    """Size of one module: numbers of row and column lines, and pitch_mm between its cells."""

    rows: int
    columns: int
    pitch_mm: float = 10.0


@dataclass(frozen=True)
class Modules(Configuration):
    """Arrangement of rows · columns equal modules; module (j, k) has the number j·columns + k.

    Attributes
    ----------
    rows, columns : int
        Numbers of modules.
    each : EachModule
        Size of every module.
    seam_mm : float
        Additional distance between neighbouring cells of two modules, in millimetre.
    coupled : bool
        Whether terms that compare neighbours act across the seams; the image then is one problem.
    """

    rows: int
    columns: int
    each: EachModule
    seam_mm: float = 0.0
    coupled: bool = False

    def __post_init__(self) -> None:
        if min(self.rows, self.columns, self.each.rows, self.each.columns) < 1:
            raise ValueError(
                "modules need at least one row and one column of modules, and of cells in each"
            )
        check_ranges(self, 0, MAX_PITCH_MM, "seam_mm")

    @property
    def count(self) -> int:
        """Number of modules."""
        return self.rows * self.columns

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of the whole image."""
        return self.rows * self.each.rows, self.columns * self.each.columns

    def place(self, number: int) -> tuple[int, int]:
        """Return (row, column) of the module of that number."""
        return divmod(number, self.columns)

    def cells(self, number: int) -> tuple[slice, slice]:
        """Return the rows and the columns of the image that a module has, as two slices."""
        row, column = self.place(number)
        rows = self.each.rows
        columns = self.each.columns
        return slice(row * rows, (row + 1) * rows), slice(column * columns, (column + 1) * columns)

    def split(self, image: NDArray[Any]) -> NDArray[Any]:
        """Return the modules of an image (…, rows, columns) as (…, modules, rows, columns)."""
        module = self.each
        shape = image.shape[:-2]
        blocks = image.reshape(*shape, self.rows, module.rows, self.columns, module.columns)
        return np.moveaxis(blocks, -3, -2).reshape(*shape, self.count, module.rows, module.columns)

    def joined(self, parts: NDArray[Any]) -> NDArray[Any]:
        """Return the image of parts (…, modules, rows, columns), the inverse of `split`."""
        module = self.each
        shape = parts.shape[:-3]
        blocks = parts.reshape(*shape, self.rows, self.columns, module.rows, module.columns)
        return np.moveaxis(blocks, -2, -3).reshape(*shape, *self.shape)

    def of_parts(self, frames: NDArray[Any]) -> NDArray[Any]:
        """Return images (…, rows, columns) whose numbers stand module by module in that shape."""
        module = self.each
        return self.joined(frames.reshape(*frames.shape[:-2], -1, module.rows, module.columns))


@dataclass(frozen=True)
class Panel(Configuration):
    """Matrix of rows and columns.

    Cell (j, k) connects row j and column k and has the number j·columns + k.

    Attributes
    ----------
    rows, columns : int
        Number of lines on either side, at least 1.
    pitch_mm : float
        Distance between neighbouring cells in millimetre, for positions and pictures; no equation
        uses it.
    cells : tuple of (row, column, x_mm, y_mm) or (row, column, x_mm, y_mm, z_mm), or None
        Crossings with a cell, and their positions on a plane or in space. In a YAML file also the
        name of a table of these. None: every crossing has a cell, at the pitch.
    modules : Modules, or None
        Modules of which this panel is an image; they determine rows, columns and pitch. None: a
        panel of one network.

    Raises ValueError if a number is out of range, or if two cells have the same crossing or
    position.

    >>> lampest.Panel(2, 3, pitch_mm=8.0).shape
    (2, 3)
    """

    rows: int = 0
    columns: int = 0
    pitch_mm: float = 10.0
    cells: tuple[CellPlace, ...] | None = None
    modules: Modules | None = None

    def __post_init__(self) -> None:
        if self.modules is not None:
            rows, columns = self.modules.shape
            pitch = self.modules.each.pitch_mm
            if (self.rows or rows, self.columns or columns) != (rows, columns):
                raise ValueError(
                    f"the modules make {rows} × {columns} cells, not {self.rows} × {self.columns}"
                )
            for name, value in (("rows", rows), ("columns", columns), ("pitch_mm", pitch)):
                object.__setattr__(self, name, value)
            if self.cells is not None:
                raise ValueError("cells: of modules every crossing has a cell")
        if self.rows < 1 or self.columns < 1:
            raise ValueError("a panel needs at least one row and one column")
        if self.crossings > MAX_CELLS:
            raise ValueError(
                f"{self.rows} × {self.columns} cells are more than {MAX_CELLS}, the most that are "
                "accepted; lampest solves a frame of 10 × 10 cells in milliseconds, "
                "of 64 × 64 cells in up to some tenths of a second, of 100 × 100 cells in seconds"
            )
        check_positive_fields(self, "pitch_mm")
        # a transistor's width, a street's length
        check_ranges(self, 1e-3, MAX_PITCH_MM, "pitch_mm")
        cells = self.cells
        if cells is None:
            return
        for row, column, *place in cells:
            if not (0 <= row < self.rows and 0 <= column < self.columns):
                raise ValueError(f"cells: there is no crossing [{row}, {column}]")
            if not all(abs(at) <= MAX_PITCH_MM for at in place):
                raise ValueError(
                    f"cells: [{row}, {column}] must lie within {MAX_PITCH_MM:g} mm of the origin"
                )
        if not cells:
            raise ValueError("cells: a panel needs at least one cell")
        if len({len(cell) for cell in cells}) > 1:
            raise ValueError("cells: all have a z_mm, or none has one")
        if len({cell[:2] for cell in cells}) < len(cells):
            raise ValueError("cells: a crossing is listed twice")
        if len({cell[2:] for cell in cells}) < len(cells):
            raise ValueError("cells: two cells lie at one place")

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of lines (rows, columns)."""
        return self.rows, self.columns

    @property
    def crossings(self) -> int:
        """Number of crossings, rows · columns."""
        return self.rows * self.columns

    @cached_property
    def present(self) -> Mask:
        """Whether a crossing has a cell, boolean (rows, columns)."""
        present = np.full(self.shape, self.cells is None)
        for row, column, *_ in self.cells or ():
            present[row, column] = True
        return present

    def check_memory(self) -> None:
        """Raise InputError if memory does not suffice for three matrices (lines, lines)."""
        check_line_memory(self.rows, self.columns)

    def centres_mm(self) -> tuple[Array, Array]:
        """Return the positions of the lines, including seams.

        Returns
        -------
        x : array, shape (columns,)
            Positions x_k = k·pitch of columns in mm.
        y : array, shape (rows,)
            Positions y_j = j·pitch of rows in mm.
        """
        x = np.arange(self.columns)
        y = np.arange(self.rows)
        module = self.layout.each
        seam = self.layout.seam_mm
        return (
            x * self.pitch_mm + x // module.columns * seam,
            y * self.pitch_mm + y // module.rows * seam,
        )

    @property
    def extents_mm(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Extent of the cells' centres.

        Returns
        -------
        x, y : (float, float)
            Smallest and largest coordinate in mm.
        """
        x, y = ((float(np.nanmin(axis)), float(np.nanmax(axis))) for axis in self.places_mm)
        return x, y

    @cached_property
    def bare(self) -> "Panel":
        """The panel without pitch and modules, on which no cost depends."""
        bare = Panel(*self.shape) if self.cells is None else self
        return self if bare == self else bare

    @cached_property
    def layout(self) -> Modules:
        """The arrangement of the panel's modules; a panel of one network is one module."""
        if self.modules is None:
            return Modules(1, 1, EachModule(self.rows, self.columns, self.pitch_mm))
        return self.modules

    def has_module(self, place: tuple[int, int]) -> bool:
        """Return whether the panel is an image of modules, with one at (row, column)."""
        layout = self.modules
        return layout is not None and (
            0 <= place[0] < layout.rows and 0 <= place[1] < layout.columns
        )

    @property
    def network(self) -> "Panel":
        """The panel that is one network: itself, or each of its modules."""
        if self.modules is None:
            return self
        module = self.modules.each
        return Panel(module.rows, module.columns, module.pitch_mm)

    @cached_property
    def places_mm(self) -> Array:
        """Positions x and y of every cell in mm, (2, rows, columns).

        The value is NaN at crossings without a cell.
        """
        if self.cells is None:
            return np.stack(np.meshgrid(*self.centres_mm()))
        places = np.full((2, *self.shape), np.nan)
        for row, column, x, y, *_ in self.cells:
            places[:, row, column] = x, y
        return places

    @cached_property
    def heights_mm(self) -> Array | None:
        """Position z of every cell in mm, (rows, columns); None for a panel on a plane.

        The value is NaN at crossings without a cell.
        """
        if self.cells is None or len(self.cells[0]) < 5:
            return None
        heights = np.full(self.shape, np.nan)
        for row, column, _, _, *z in self.cells:
            heights[row, column] = z[0]
        return heights

    @cached_property
    def neighbours(self) -> tuple[Numbers, Numbers, Array]:
        """Pairs of neighbouring cells.

        Full rectangle: pairs along columns, then pairs along rows. Listed cells: pairs without
        another cell in the circle, in space the sphere, whose diameter connects them (the Gabriel
        graph, which is connected; Gabriel & Sokal, Systematic Zoology 18, 1969).

        Returns
        -------
        first, second : integer arrays, shape (pairs,)
            Numbers of the cells.
        distance : array, shape (pairs,)
            Distance of their centres in pitches.
        """
        if self.cells is None:
            numbers = np.arange(self.crossings).reshape(self.shape)
            first = np.concatenate([numbers[:-1].ravel(), numbers[:, :-1].ravel()])
            second = np.concatenate([numbers[1:].ravel(), numbers[:, 1:].ravel()])
            return first, second, np.ones(len(first))
        # Gabriel graph of the listed cells, with distances in pitches.
        cells = np.flatnonzero(self.present)
        axes = [*self.places_mm, *([] if self.heights_mm is None else [self.heights_mm])]
        places = np.stack([axis.ravel()[cells] for axis in axes], axis=-1)
        pairs = [
            (cell, near)
            for cell in range(len(cells))
            for near in circle_neighbours(places, cell).tolist()
        ]
        first, second = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
        distance = np.linalg.norm(places[first] - places[second], axis=-1) / self.pitch_mm
        return cells[first], cells[second], distance


def circle_neighbours(places: Array, number: int) -> Numbers:
    """Return the cells with larger numbers that are neighbours of a cell in the Gabriel graph.

    Relative to the cell `number`, c lies in the circle or sphere with the diameter from 0 to b if
    c·c ≤ c·b. `places` are the positions of all cells, (cells, 2 or 3).
    """
    way = places - places[number]
    square = np.sum(way**2, axis=1)
    candidates = square > 0
    for nearest in np.argsort(square)[1:]:
        if not np.any(candidates & (square > square[nearest])):
            break
        # From the nearest cell c outwards: every b with c in its circle is no neighbour.
        within = square[nearest] <= PLACE_TOLERANCE * (way @ way[nearest])
        within[nearest] = False
        candidates &= ~within
    after = np.flatnonzero(candidates)
    return after[after > number]


def beyond_any_panel(values: Array) -> Mask:
    """Return whether numbers are outside the range of physical quantities.

    Zero, infinity and NaN are not.
    """
    size = np.abs(values)
    extreme = (values != 0) & ((size < MIN_NUMBER) | (size > MAX_NUMBER))
    return np.asarray(np.isfinite(values) & extreme)


def as_panels_have(values: Array) -> Array:
    """Return numbers limited to the range of physical quantities.

    Numbers below the range become zero, and numbers above it ±infinity.
    """
    beyond = beyond_any_panel(values)
    if not np.any(beyond):
        return values
    limit = np.where(np.abs(values) < MIN_NUMBER, 0.0, np.copysign(np.inf, values))
    return np.where(beyond, limit, values)


def difference_matrix(length: int) -> Array:
    """Return D (length, length) of finite differences.

    The differences are central inside and one-sided at the border; D is zero for a single point.
    The gradient of a matrix X is (D X, X Dᵀ). Source: MATLAB's `gradient` with unit spacing, which
    the paper's equations (19)-(24) use.
    """
    return np.zeros((1, 1)) if length == 1 else np.asarray(np.gradient(np.eye(length), axis=0))
