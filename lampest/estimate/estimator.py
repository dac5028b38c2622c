"""One method of estimation: which terms, which formulation, which bounds."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from math import isfinite
from typing import Any, ClassVar, Literal

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data
from lampest.cost.terms.term import Term
from lampest.estimate.efforts import AnyEffort, Converged, Truncated
from lampest.files.errors import InputError
from lampest.panel.divider import resolution_limit
from lampest.panel.network import uniform_factor
from lampest.panel.panel import Array, Panel
from lampest.panel.scene import Faults
from lampest.posterior.spectrum import Rule
from lampest.recording.readings import AT_MOST, Readings
from lampest.solvers.ipopt.formulations import Formulation, Nodal, PerPixel
from lampest.solvers.ipopt.ipopt import Ipopt
from lampest.solvers.newton.newton import Newton
from lampest.solvers.solution import Settings, Solver

Unknowns = Literal["cells", "oral_disc"]
FormulationName = Literal["per_pixel", "nodal", "reduced", "auto"]
FORMULATIONS: dict[str, Formulation] = {form.kind: form for form in (Nodal(), PerPixel())}
FARTHEST, NEAREST, SHORTED = 1e9, 1e-3, 1e-6
NODAL_CELLS, NODAL_PERIOD = 144, 0.5
BARRED_CELLS = 600  # on larger panels error bars take longer than the estimate


@dataclass(frozen=True)
class Bounds:
    """lower : 'measured' (r ≥ R_m, paper, equation (12)), a resistance in ohm, or 'none' (R_m/1000).

    upper : 'resolution' (r ≤ R²/σ, beyond which a cell cannot be told from an open one, though never below twice the
    cell of a uniform panel), a resistance in ohm, or 'none' (10⁹·R_m, where double precision sees no difference).

    Raises ValueError where a number is not positive and finite.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    lower: Literal["measured", "none"] | float = "measured"
    upper: Literal["resolution", "none"] | float = "resolution"

    def __post_init__(self) -> None:
        for name in ("lower", "upper"):
            value = getattr(self, name)
            if not isinstance(value, str) and not (isfinite(value) and value > 0):
                raise ValueError(f"{name} must be a word or a positive, finite number of ohm")

    def limits(self, measured: Array, sigma: Array | None) -> tuple[Array, Array]:
        """(lower, upper) of the cell resistance, ohm, for readings of any shape (…, rows, columns).

        Raises InputError where 'resolution' is asked for and σ is unknown, or where no room is left between them.
        """
        if isinstance(self.lower, str):
            lower = measured.copy() if self.lower == "measured" else measured * NEAREST
        else:
            lower = np.full_like(measured, self.lower)
        if self.upper == "resolution":
            if sigma is None:
                raise InputError(
                    "bounds.upper: resolution needs the noise of the readings; add a readout to the scene or sigma to "
                    "the recording, or set bounds.upper to a number of ohm or to none"
                )
            least = 2 * measured / uniform_factor(*measured.shape[-2:])
            upper = np.maximum(resolution_limit(measured, sigma), least)
        elif isinstance(self.upper, str):
            upper = measured * FARTHEST
        else:
            upper = np.full_like(measured, self.upper)
        if np.any(upper <= lower):
            index = tuple(int(part) for part in np.argwhere(upper <= lower)[0])
            raise InputError(
                f"bounds leave no room for cell {index[-2:]}: "
                f"lower {lower[index]:.6g} ohm, upper {upper[index]:.6g} ohm"
            )
        return lower, upper


@dataclass(frozen=True)
class AutoWeight:
    """How `weight: auto` is chosen.

    rule : 'risk', the least expected error of log r; 'evidence', the most probable weight; 'press', the best prediction
    of every reading from all others. By default risk, or press where the noise of the readings is unknown.
    per : 'recording', one weight from its strongest frame; 'frame', one for every frame.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    rule: Rule | None = None
    per: Literal["recording", "frame"] = "recording"


@dataclass(frozen=True)
class Estimator:
    """Terms, formulation, solver settings, bounds and effort.

    error_bars : whether estimates get them; 'auto': on panels of up to 600 cells, or where a term needs them. Only
    verified optima of readings whose noise is known can have them.
    auto_weight : how weights are chosen that the terms leave open.
    unknowns : the cells; or the few numbers of an oral disc that makes them, fitted to the readings (the misfit alone).

    Raises ValueError without a term, where a weight is left open and there is no misfit, or where a term weighs the
    previous frame by its error bars and there can be none.
    """

    terms: tuple[Term, ...]
    formulation: FormulationName = "nodal"
    solver: Settings = Settings()
    bounds: Bounds = Bounds()
    effort: AnyEffort = Converged()
    error_bars: Literal["auto"] | bool = "auto"
    auto_weight: AutoWeight = AutoWeight()
    unknowns: Unknowns = "cells"

    def __post_init__(self) -> None:
        if not self.terms:
            raise ValueError("an estimator needs at least one term")
        if self.automatic and not any(term.reads_measurement for term in self.terms):
            raise ValueError("weight: auto needs the term misfit")
        if self.unknowns == "oral_disc" and not all(term.reads_measurement for term in self.terms):
            raise ValueError("unknowns: oral_disc has the term misfit alone; the disc leaves nothing to penalise")
        if self.unknowns == "oral_disc" and not isinstance(self.effort, Converged):
            raise ValueError("unknowns: oral_disc needs effort: converged")
        if self.weighs_previous:
            if self.error_bars is False or not self._of_cells:
                raise ValueError("arrival weighs frames by their error bars: it needs error_bars and effort: converged")
            if not any(term.reads_measurement for term in self.terms):
                raise ValueError("arrival needs the term misfit")
        if self.automatic and self.auto_weight.per == "frame" and not isinstance(self.effort, Converged):
            raise ValueError("auto_weight.per: frame needs effort: converged")

    @property
    def automatic(self) -> bool:
        """Whether a weight is still to be chosen."""
        return any(term.weight == "auto" for term in self.terms)

    def with_weights(self, weights: Iterable[float]) -> "Estimator":
        """The same with these weights of the terms, in their order."""
        pairs = zip(self.terms, weights, strict=True)
        return replace(self, terms=tuple(replace(term, weight=float(weight)) for term, weight in pairs))

    @property
    def relative(self) -> bool:
        """Whether a term reads the previous frame."""
        return any(term.needs_previous for term in self.terms)

    @property
    def weighs_previous(self) -> bool:
        """Whether a term reads how well the previous frame is known."""
        return any(term.weighs_previous for term in self.terms)

    @property
    def _of_cells(self) -> bool:
        """Whether estimates are optima over the cells, which error bars are for."""
        return self.unknowns == "cells" and isinstance(self.effort, Converged)

    @property
    def joint_start(self) -> bool:
        """Whether the baseline is solved together with the first frame, as the paper does for relative methods.

        Not where frames are weighed by what is known of the one before, which for the first one is the baseline.
        """
        return self.relative and not self.weighs_previous and isinstance(self.effort, Converged | Truncated)

    @property
    def absolute_terms(self) -> tuple[Term, ...]:
        """The terms that need no previous frame."""
        return tuple(term for term in self.terms if not term.needs_previous)

    def barred(self, readings: Readings) -> bool:
        """Whether estimates of such readings get error bars."""
        rows, columns = readings.resistance.shape[-2:]
        few = rows * columns <= BARRED_CELLS or self.weighs_previous
        asked = self.error_bars if isinstance(self.error_bars, bool) else few
        return asked and self._of_cells and readings.sigma is not None

    def needs_sigma(self) -> bool:
        """Whether a term divides by the readings' standard deviation."""
        return any(getattr(term, "weighting", "plain") == "noise" for term in self.terms)

    def data(
        self,
        readings: Readings,
        previous: Array | None = None,
        faults: Faults | None = None,
        baseline: Array | None = None,
        previous_deviation: Array | None = None,
    ) -> Data:
        """What one solve is given, from readings (frames, rows, columns). Raises InputError as `Bounds.limits`."""
        measured, sigma = readings.resistance, readings.sigma
        if sigma is None and self.needs_sigma():
            raise InputError("misfit.weighting: noise needs a readout in the scene or sigma in the recording")
        if sigma is None and self.weighs_previous:
            raise InputError("arrival needs the noise: a readout in the scene or sigma in the recording")
        lower, upper = self.bounds.limits(measured, sigma)
        if readings.partial:
            lower = np.where((readings.side == AT_MOST) | (readings.seen == 0), measured * NEAREST, lower)
            upper = np.where((readings.side != 0) | (readings.seen == 0), measured * FARTHEST, upper)
        if faults is not None:
            panel = Panel(*measured.shape[-2:])
            typical = np.exp(np.mean(np.log(measured), axis=(-2, -1), keepdims=True))
            for broken, factor in ((faults.open_cells(panel), FARTHEST), (faults.shorted_cells(panel), SHORTED)):
                lower, upper = (np.where(broken, typical * factor, bound) for bound in (lower, upper))
        noise = np.ones_like(measured) if sigma is None else sigma
        marks = (readings.side, readings.seen) if readings.partial else None
        return Data(measured, noise, lower, upper, previous, marks, baseline, previous_deviation)

    def problem(self, panel: Panel, frames: int, period: float, doubts: "Doubts | None" = None) -> Solver:
        """The solver for one frame, or for two jointly, `period` seconds apart; built once per process and kept.

        formulation 'auto' is nodal on panels of up to 144 cells with at most two frames a second, else reduced.
        """
        small = panel.cells <= NODAL_CELLS and period >= NODAL_PERIOD
        named = self.effort.kind if isinstance(self.effort, Converged) else "reduced"
        formulation = self.formulation if named == "converged" else named
        if formulation == "auto":
            formulation = "nodal" if small else "reduced"
        return _solver(self.cost(panel, frames, doubts), formulation, self.solver)

    def cost(self, panel: Panel, frames: int, doubts: "Doubts | None" = None) -> Cost:
        """The terms over one frame, or over two jointly, of a panel; what is in doubt is left out."""
        faulty, partial = ((), False) if doubts is None else (doubts.faulty, doubts.partial)
        return Cost(Panel(*panel.shape), self.terms, frames, faulty, partial)


@dataclass(frozen=True)
class Doubts:
    """What makes a cost differ from that of a sound panel: numbers of broken cells, and whether readings are bounds."""

    faulty: tuple[int, ...]
    partial: bool

    @classmethod
    def of(cls, panel: Panel, faults: Faults | None, data: Data) -> "Doubts | None":
        """None for a sound panel and plain readings."""
        if faults is None and data.marks is None:
            return None
        broken = np.zeros(0) if faults is None else faults.open_cells(panel) | faults.shorted_cells(panel)
        return cls(tuple(int(cell) for cell in np.flatnonzero(broken)), data.marks is not None)


@lru_cache(maxsize=32)
def _solver(cost: Cost, formulation: str, settings: Settings) -> Solver:
    if formulation in FORMULATIONS:
        return Ipopt(cost, FORMULATIONS[formulation], settings)
    return Newton(cost, settings)
