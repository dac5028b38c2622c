"""The cost of many panels of one shape at one point each, with derivatives: arrays whose first axis counts panels."""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from lampest.cost.cost import Cost
from lampest.cost.problem import Data
from lampest.panel.compiled import Compiled
from lampest.panel.network import SecondOrder
from lampest.panel.panel import Array
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.readouts.floating import FloatingNetwork, grounding

BLOCK = 8  # panels by which compiled functions grow: fewer sizes to compile
Numbers = NDArray[np.intp]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class PanelBatch:
    """cost : of each panel, whose weights stand here: (panels, terms). data : its first axis counts panels.

    place : of batches that are solved at the same time each has another: compiled functions keep their arguments.
    """

    cost: Cost
    weights: Array
    data: Data
    place: int = 0

    @staticmethod
    def serves(cost: Cost, data: Data) -> bool:
        """Whether a batch can minimise a cost: smooth losses, and readings of floating lines without wire."""
        if any(term.loss.enters == "dual" for term in cost.terms) or cost.frames != 1 or data.wiring is not None:
            return False
        entries = cost.functions.entries
        return isinstance(data.readout, TwoPointReadout) and entries.at_model is not None and not entries.crossed

    def some(self, panels: Numbers) -> "PanelBatch":
        """Return some of the panels."""
        given = replace(self.data.given, **{name: value[panels] for name, value in self.data.given.named()})
        data = replace(self.data, given=given, lower=self.data.lower[panels], upper=self.data.upper[panels])
        chosen = PanelBatch(self.cost, self.weights[panels], data, self.place)
        chosen.__dict__["ties"] = self.ties[panels]
        return chosen

    @cached_property
    def ties(self) -> Array:
        return self.data.ties if self.data.parts is not None else grounding(self.data.measured)

    def padded(self, values: Array) -> Array:
        """(panels, …) with the last one repeated until there are as many as a compiled function takes."""
        count = len(self.weights)
        missing = -count % BLOCK
        return np.concatenate([values, np.repeat(values[-1:], missing, axis=0)]) if missing else values

    @cached_property
    def named(self) -> dict[str, Array]:
        """What compiled functions are given, padded, (panels, size) each."""
        count = len(self.weights)
        known = dict(self.data.given.named())
        absent = {
            name: np.full((count, self.cost.panel.crossings), source.absent)
            for name, source in self.data.given.sources().items()
            if name not in known
        }
        flat = {name: np.reshape(value, (count, -1)) for name, value in known.items()}
        every = absent | flat | {"weights": self.weights, "dual": np.zeros((count, 0))}
        return {name: self.padded(values) for name, values in every.items()}

    @cached_property
    def log_bounds(self) -> tuple[Array, Array]:
        """(panels, cells) logarithms of the bounds."""
        count = len(self.weights)
        return np.log(self.data.lower).reshape(count, -1), np.log(self.data.upper).reshape(count, -1)


@lru_cache(maxsize=256)
def _mapped(function: Compiled, panels: int, place: int) -> Compiled:
    return function.mapped(panels)


@dataclass(frozen=True, eq=False)
class Points:
    """A point of every panel of a batch. position : u = log r, (panels, cells)."""

    batch: PanelBatch
    position: Array
    network: FloatingNetwork

    @classmethod
    def at(cls, batch: PanelBatch, position: Array) -> "Points":
        """Solve the networks. Raises numpy.linalg.LinAlgError where a line is not connected."""
        cells = np.exp(position).reshape(batch.data.measured.shape)
        return cls(batch, position, FloatingNetwork.solve(1 / cells, batch.ties))

    def some(self, panels: Numbers) -> "Points":
        """Those of some panels, with what is known of them."""
        chosen = Points(self.batch.some(panels), self.position[panels], self.network.some(panels))
        for name in ("first", "hessian_values"):
            if name in self.__dict__:
                chosen.__dict__[name] = self.__dict__[name][panels]
        return chosen

    def _flat(self, maps: Array) -> Array:
        return maps.reshape(len(self.position), -1)

    def _maps(self, flat: Array) -> Array:
        return flat.reshape(self.network.conductance.shape)

    @cached_property
    def reading(self) -> Array:
        return self.network.reading()

    def called(self, function: Compiled) -> Array:
        """Return a function of the cost at every point, (panels, nonzeros)."""
        count = len(self.position)
        point = {"cell_resistance": self.network.cell_resistance, "reading": self.reading}
        given = self.batch.named | {name: self.batch.padded(self._flat(maps)) for name, maps in point.items()}
        size = len(given["reading"])
        values = _mapped(function, size, self.batch.place)(*(given[name] for name in function.names))
        return values.reshape(size, -1)[:count]

    @cached_property
    def first(self) -> Array:
        return self.called(self.batch.cost.functions.first)

    @cached_property
    def hessian_values(self) -> Array:
        """Nonzeros of the terms' second derivatives."""
        return self.called(self.batch.cost.functions.hessian)

    @property
    def costs(self) -> Array:
        """(panels, terms)."""
        return self.first[:, : self.batch.weights.shape[1]]

    @cached_property
    def objective(self) -> Array:
        """φ (panels)."""
        return np.asarray(self.costs.sum(axis=1))

    @cached_property
    def cost_scale(self) -> Array:
        """As `Evaluation.cost_scale` (panels)."""
        terms = self.batch.weights.shape[1]
        scale = self.first[:, terms : 2 * terms].sum(axis=1) / self.position.shape[1] + self.objective
        return np.asarray(np.where(scale == 0, 1.0, scale))

    @cached_property
    def direct(self) -> Array:
        """r·∂φ/∂r at fixed readings, (panels, cells)."""
        terms = 2 * self.batch.weights.shape[1]
        size = self.position.shape[1]
        return self.first[:, terms : terms + size] * self._flat(self.network.cell_resistance)

    @cached_property
    def second_order(self) -> SecondOrder:
        """Of ∂φ/∂y."""
        return self.network.second_order(self._maps(self.first[:, -self.position.shape[1] :]))

    @cached_property
    def gradient(self) -> Array:
        """∂φ/∂u, (panels, cells)."""
        return self.direct + self._flat(self.second_order.adjoint())

    @cached_property
    def residual(self) -> Array:
        """As `Evaluation.kkt_residual` (panels)."""
        lower, upper = self.batch.log_bounds
        target = np.clip(self.position - self.gradient / self.cost_scale[:, None], lower, upper)
        return np.asarray(np.abs(self.position - target).max(axis=1))

    @cached_property
    def free(self) -> Mask:
        """As `free_cells` (panels, cells)."""
        lower, upper = self.batch.log_bounds
        held: Mask = ((self.position <= lower) & (self.gradient > 0)) | ((self.position >= upper) & (self.gradient < 0))
        return (lower < upper) & ~held

    @cached_property
    def reading_weight(self) -> Array:
        """∂²φ/∂y², (panels, cells)."""
        entries = self.batch.cost.functions.entries
        weight = np.zeros_like(self.position)
        weight[:, entries.at_model] = self.hessian_values[:, entries.model]
        return weight

    def matrix(self) -> Array:
        """∇²φ in u, (panels, cells, cells)."""
        entries, cells = self.batch.cost.functions.entries, self._flat(self.network.cell_resistance)
        sensitivity, matrix = self.network.sensitivity(), self.second_order.matrix()
        matrix += (sensitivity * self.reading_weight[..., None]).swapaxes(-1, -2) @ sensitivity
        row, column = entries.at_cells
        matrix[:, row, column] += self.hessian_values[:, entries.cells] * cells[:, row] * cells[:, column]
        every = np.arange(self.position.shape[1])
        matrix[:, every, every] += 2 * self.direct
        return matrix
