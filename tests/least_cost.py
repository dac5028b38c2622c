"""The cost of an estimate and its minimum, stated a second time in plain NumPy and SciPy.

The module holds no test and shares no code with the package: potentials by one dense inverse, all
derivatives as matrices, SciPy's trust region. Cells are u = log r, flat, one frame after the other.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Circuit:
    """A circuit whose rows are driven.

    kind : two_point, loaded, grounded, grounded_one or virtual. joined : groups of lines.

    drive, sense, load : ohm, of which a kind takes what it has; load is the feedback's of virtual.
        supply : volt.
    """

    kind: str
    joined: tuple[tuple[int, ...], ...] = ()
    drive: float = 0.0
    sense: float = 0.0
    load: float = 1.0
    supply: float = 1.0

    def impedance(self, conductance: Array) -> Array:
        """Z (lines, lines) of cells (rows, columns) siemens."""
        rows, columns = conductance.shape
        node = np.arange(rows + columns)
        for group in self.joined:
            node[list(group)] = group[0]
        ends = np.stack([np.repeat(node[:rows], columns), np.tile(node[rows:], rows)])
        matrix = np.zeros((rows + columns, rows + columns))
        for first, second, sign in ((0, 0, 1), (1, 1, 1), (0, 1, -1), (1, 0, -1)):
            np.add.at(matrix, (ends[first], ends[second]), sign * conductance.ravel())
        for line, tie in enumerate(self._ties(rows, columns)):
            matrix[node[line], node[line]] += tie
        used = np.unique(node)
        if self.kind == "two_point":
            used = np.delete(used, np.argmax(np.diag(matrix)[used]))
        small = np.zeros_like(matrix)
        small[np.ix_(used, used)] = np.linalg.inv(matrix[np.ix_(used, used)])
        return small[np.ix_(node, node)]

    def _ties(self, rows: int, columns: int) -> Array:
        driven, sensed = {
            "two_point": (0.0, 0.0),
            "loaded": (0.0, 1 / self.load),
            "grounded": (1 / (self.drive or 1), 1 / (self.sense + self.load)),
            "grounded_one": (1 / (self.drive or 1), 0.0),
            "virtual": (1 / (self.drive or 1), 1 / (self.sense or 1)),
        }[self.kind]
        return np.repeat([driven, sensed], [rows, columns])

    def reading(self, cells: Array) -> tuple[Array, Array]:
        """(y (rows, columns), ∂y/∂u (cells, cells)) of cells (rows, columns) ohm."""
        rows, columns = cells.shape
        impedance = self.impedance(1 / cells)
        row = np.repeat(np.arange(rows), columns)
        column = rows + np.tile(np.arange(columns), rows)
        own = impedance[row, row]
        column_impedance = impedance[column, column]
        mutual = impedance[row, column]
        ones = np.ones_like(own)
        zero = np.zeros_like(own)
        total = self.sense + self.load
        if self.kind == "two_point":
            value = own + column_impedance - 2 * mutual
            slopes = (ones, ones, -2 * ones)
        elif self.kind == "loaded":
            value = self.supply * mutual / (self.drive + own)
            slopes = (-value / (self.drive + own), zero, self.supply / (self.drive + own))
        elif self.kind == "virtual":
            gain = self.supply * self.load / (self.drive * self.sense)
            value = gain * mutual
            slopes = (zero, zero, gain * ones)
        else:
            gain = self.supply * self.load / (self.drive * total)
            loaded = 1 + column_impedance / total if self.kind == "grounded_one" else ones
            value = gain * mutual / loaded
            slopes = (zero, -value / loaded / total * (self.kind == "grounded_one"), gain / loaded)
        drop = impedance[:, row] - impedance[:, column]
        by_cell = sum(
            slope[:, None] * pair
            for slope, pair in zip(
                slopes, (drop[row] ** 2, drop[column] ** 2, drop[row] * drop[column]), strict=True
            )
        )
        return value.reshape(cells.shape), by_cell / cells.ravel()


TWO_POINT = Circuit("two_point")


def nabla(rows: int, columns: int) -> Array:
    """MATLAB's gradient as a matrix (2·cells, cells), down the rows and then along the columns."""
    units = np.eye(rows * columns).reshape(-1, rows, columns)
    parts = [
        np.gradient(units, axis=axis) if units.shape[axis] > 1 else 0 * units for axis in (1, 2)
    ]
    return np.concatenate([part.reshape(len(units), -1) for part in parts], axis=1).T


def edges(rows: int, columns: int) -> Array:
    """Differences of all pairs of neighbours, (pairs, cells)."""
    number = np.arange(rows * columns).reshape(rows, columns)
    pairs = [(number[:-1], number[1:]), (number[:, :-1], number[:, 1:])]
    unit = np.eye(number.size)
    return np.concatenate([unit[second.ravel()] - unit[first.ravel()] for first, second in pairs])


@dataclass(frozen=True)
class Penalty:
    """weight·Σ ρ(residual) of a term by its kind.

    loss : squared, huber (with its corner) or absolute.

    against : 'baseline' or 'previous', of those that compare. scaled : a misfit in σ. walk : of
        arrival, of log r.
    """

    kind: str
    weight: float
    loss: str = "squared"
    corner: float = 1.0
    against: str = "previous"
    scaled: bool = False
    walk: float = 0.02


@dataclass(frozen=True, eq=False)
class LeastCost:
    """φ(u) of frames (frames, rows, columns).

    With two frames the first is the baseline and the second's previous one.

    measured, sigma, side, seen, lower, upper : (frames, rows, columns); previous, baseline,
    deviation : (rows, columns) of one frame, of terms that compare. faulty : (rows, columns), cells
    that no penalty may read.
    """

    circuit: Circuit
    terms: tuple[Penalty, ...]
    measured: Array
    sigma: Array
    side: Array
    seen: Array
    lower: Array
    upper: Array
    faulty: NDArray[np.bool_]
    previous: Array | None = None
    baseline: Array | None = None
    deviation: Array | None = None

    @classmethod
    def of(
        cls,
        data: Any,
        *terms: Penalty,
        circuit: Circuit = TWO_POINT,
        faulty: NDArray[np.bool_] | None = None,
    ) -> "LeastCost":
        """The cost of a problem that the package's data pose."""
        given = data.given
        shape = data.measured.shape
        side = np.zeros(shape) if given.side is None else given.side
        observed = np.ones(shape) if given.seen is None else given.seen
        faulty = np.zeros(shape[1:], dtype=bool) if faulty is None else faulty
        baseline = given.previous if given.baseline is None else given.baseline
        readings = (given.measured, given.sigma, side, observed, data.lower, data.upper)
        return cls(
            circuit, terms, *readings, faulty, given.previous, baseline, given.previous_deviation
        )

    def blocks(self, position: Array) -> Iterator[tuple[Penalty, Array, Array]]:
        """(term, residuals x, ∂x/∂u) of every term in every frame."""
        shape = self.measured.shape
        count = self.faulty.size
        places = position.reshape(shape[0], -1)
        for frame, place in enumerate(places):
            cells = np.exp(place)
            reading, response = self.circuit.reading(cells.reshape(shape[1:]))
            for term in self.terms:
                if term.kind == "misfit":
                    value, rows = self._misfit(term, frame, reading.ravel(), response)
                    yield term, value, self._placed(rows, frame, shape[0])
                    continue
                compares = term.kind not in ("cell_resistance", "gradient", "total_variation")
                if compares and shape[0] == 2 and frame == 0:
                    continue
                if compares:
                    reference = (
                        places[0] if shape[0] == 2 else np.log(self._reference(term)).ravel()
                    )
                    ratio = np.exp(place - reference)
                else:
                    reference = np.zeros(count)
                    ratio = cells
                log = term.kind in (
                    "log_ratio",
                    "total_variation",
                    "total_variation_of_change",
                    "arrival",
                )
                value, inner = (
                    (place - reference, np.ones(count)) if log else (ratio - compares, ratio)
                )
                factor, operator = self._operator(term)
                sound = ~np.any((operator != 0) & self.faulty.ravel(), axis=1)
                operator = factor * operator[sound]
                rows = self._placed(operator * inner, frame, shape[0])
                if compares and shape[0] == 2:
                    rows[:, :count] -= operator * inner
                yield term, operator @ value, rows

    def _placed(self, rows: Array, frame: int, frames: int) -> Array:
        blank = [np.zeros_like(rows)] * frames
        blank[frame] = rows
        return np.concatenate(blank, axis=1)

    def _reference(self, term: Penalty) -> Array:
        reference = self.baseline if term.against == "baseline" else self.previous
        assert reference is not None
        return reference

    def _operator(self, term: Penalty) -> tuple[Array | float, Array]:
        rows, columns = self.faulty.shape
        if term.kind in ("gradient", "gradient_of_relative_change"):
            return (1.0 if term.kind == "gradient" else 100.0), nabla(rows, columns)
        if term.kind.startswith("total_variation"):
            return 100.0, edges(rows, columns)
        if term.kind == "arrival":
            assert self.deviation is not None
            return 1.0, np.diag(1 / np.sqrt(self.deviation.ravel() ** 2 + term.walk**2))
        return (1.0 if term.kind == "cell_resistance" else 100.0), np.eye(rows * columns)

    def _misfit(
        self, term: Penalty, frame: int, reading: Array, response: Array
    ) -> tuple[Array, Array]:
        parts = (self.measured, self.sigma, self.side, self.seen)
        measured, sigma, side, observed = (part[frame].ravel() for part in parts)
        difference = reading - measured
        counts = observed * np.where(side == 0, 1.0, side * difference < 0)
        scale = counts / (sigma if term.scaled else 1.0)
        return difference * scale, response * scale[:, None]

    def value(self, position: Array) -> float:
        """φ."""
        return float(
            sum(term.weight * np.sum(loss(term, x, 0.0)[0]) for term, x, _ in self.blocks(position))
        )

    def blank(self) -> float:
        """Cost of the data terms where all readings are zero, the scale of a rounded misfit."""
        total = 0.0
        for term in self.terms:
            if term.kind == "misfit":
                x = self.seen * self.measured / (self.sigma if term.scaled else 1.0)
                total += term.weight * float(np.sum(loss(term, x, 0.0)[0]))
        return total

    def as_squares(self, position: Array, smooth: float) -> tuple[Array, Array]:
        """(f, ∂f/∂u) with Σ f² = φ, absolute losses rounded within `smooth`."""
        residuals = []
        slopes = []
        for term, x, rows in self.blocks(position):
            value, slope = loss(term, x, smooth)
            root = np.sqrt(np.maximum(value, 0))
            half = np.where(
                root > 0,
                slope / np.where(root > 0, 2 * root, 1),
                1.0 if term.loss != "absolute" else 0.0,
            )
            residuals.append(np.sqrt(term.weight) * np.sign(x) * root)
            slopes.append(
                np.sqrt(term.weight) * (np.sign(x) * np.sign(slope) * np.abs(half))[:, None] * rows
            )
        return np.concatenate(residuals), np.concatenate(slopes)

    def minimised(self, start: Array, max_steps: int = 100) -> Array:
        """u from SciPy's trust-region reflective method; absolute losses less and less rounded."""
        place = np.clip(start, np.log(self.lower).ravel(), np.log(self.upper).ravel())
        rough = [
            float(np.abs(x).max(initial=0))
            for term, x, _ in self.blocks(place)
            if term.loss == "absolute"
        ]
        if not rough:
            return self._nearer(place, 0.0, max_steps)
        for smooth in max(rough) * 10.0 ** -np.arange(1, 9):
            place = self._nearer(place, float(smooth), max(max_steps // 8, 10))
        return place

    def descended(self, start: Array, max_iterations: int = 300) -> Array:
        """u from SciPy's L-BFGS-B, by gradients alone; absolute losses are hardly rounded."""
        bounds = list(zip(np.log(self.lower).ravel(), np.log(self.upper).ravel(), strict=True))
        rough = [
            float(np.abs(x).max(initial=0))
            for term, x, _ in self.blocks(start)
            if term.loss == "absolute"
        ]
        smooth = 1e-6 * max(rough, default=0.0)

        def both(place: Array) -> tuple[float, Array]:
            residuals, slopes = self.as_squares(place, smooth)
            return float(residuals @ residuals), 2 * residuals @ slopes

        options = {"maxiter": max_iterations, "maxcor": 30, "ftol": 1e-15, "gtol": 0.0}
        return np.asarray(
            minimize(both, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options).x
        )

    def _nearer(self, place: Array, smooth: float, max_evaluations: int) -> Array:
        """One run of it; cells that bounds leave no room stay."""
        low = np.log(self.lower).ravel()
        high = np.log(self.upper).ravel()
        free = high > low + 1e-12
        position = place.copy()
        low = low[free]
        high = high[free]
        last: list[Any] = []

        def both(part: Array) -> tuple[Array, Array]:
            if not last or not np.array_equal(last[0], part):
                position[free] = part
                value, slope = self.as_squares(position, smooth)
                last[:] = part.copy(), (value, slope[:, free])
            pair: tuple[Array, Array] = last[1]
            return pair

        start = np.clip(place[free], low + 1e-9 * (high - low), high - 1e-9 * (high - low))
        options = {
            "bounds": (low, high),
            "ftol": 1e-14,
            "xtol": 1e-14,
            "gtol": 1e-14,
            "max_nfev": max_evaluations,
        }
        fit = least_squares(
            lambda part: both(part)[0], start, lambda part: both(part)[1], **options
        )
        position[free] = fit.x
        return position


def loss(term: Penalty, x: Array, smooth: float) -> tuple[Array, Array]:
    """(ρ(x), ρ'(x))."""
    if term.loss == "huber":
        inside = np.clip(x, -term.corner, term.corner)
        return inside * (2 * x - inside), 2 * inside
    if term.loss == "absolute":
        size = np.sqrt(x**2 + smooth**2)
        return size - smooth, np.divide(x, size, out=np.zeros_like(x), where=size > 0)
    return x**2, 2 * x
