"""One method of estimation: which terms, which formulation, which bounds."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from lampest.cost.terms import Term
from lampest.estimate.methods import MethodName, named_method
from lampest.estimate.methods.method import Method
from lampest.estimate.objective import AutoWeight as AutoWeight
from lampest.estimate.objective import Bounds as Bounds
from lampest.estimate.objective import Objective, checked_terms
from lampest.files.errors import InputError, in_words
from lampest.loads.pressure import Tare
from lampest.panel.panel import Panel
from lampest.panel.scene import Scene
from lampest.panel.trust_region import MATRIX_CELLS
from lampest.recording.readings import Readings
from lampest.solvers.solution import Settings, Solver


@dataclass(frozen=True)
class Estimator(Objective):
    """Terms, the method that minimises them, its settings, and bounds.

    Raises InputError without a data term, for a formulation that does not exist or does not fit the terms, where a term
    weighs the previous frame by its error bars and there can be none, or where a part is of another class.

    Attributes
    ----------
    formulation : MethodName or Method
        How the estimate is computed, a word or a method with its options.
    error_bars : 'auto' or bool
        Whether estimates get them; 'auto': on panels of up to 600 cells, or where a term needs them. Only verified
        optima of readings whose noise is known can have them.
    auto_weight : AutoWeight
        How weights are chosen that the terms leave open.
    tare : Tare or None
        When the zero of pressures is taken anew, because nothing touches the panel; None: never.
    weight_sigma : tuple of float
        See `Objective`; set where weights are chosen.

    >>> lampest.Estimator((lampest.Misfit(),), formulation="reduced").relative
    False
    """

    terms: tuple[Term, ...]
    formulation: MethodName | Method = "auto"
    solver: Settings = Settings()
    bounds: Bounds = Bounds()
    error_bars: Literal["auto"] | bool = "auto"
    auto_weight: AutoWeight = AutoWeight()
    tare: Tare | None = None
    weight_sigma: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "terms", checked_terms(self.terms))  # a list cannot be hashed
        for name, kind in (("solver", Settings), ("bounds", Bounds), ("auto_weight", AutoWeight)):
            if not isinstance(getattr(self, name), kind):
                raise InputError(f"{name} must be {kind.__name__}(...), not {in_words(getattr(self, name))}")
        if not isinstance(self.tare, Tare | None):
            raise InputError(f"tare must be Tare(...) or None, not {in_words(self.tare)}")
        if self.error_bars not in ("auto", True, False):
            raise InputError(f"error_bars must be 'auto', True or False, not {in_words(self.error_bars)}")
        self.method.check(self.terms)
        if self.weighs_previous and (self.error_bars is False or not self.method.optimum):
            raise InputError(
                "arrival weighs frames by their error bars: it needs error_bars, and an optimum to have them"
            )
        if self.automatic and self.auto_weight.per == "frame" and not self.method.optimum:
            raise InputError("auto_weight.per: frame needs a formulation that ends at an optimum")

    @cached_property
    def method(self) -> Method:
        """The method that the formulation's word names."""
        return named_method(self.formulation)

    @property
    def joint_start(self) -> bool:
        """Whether the baseline is solved together with the first frame."""
        return self.method.joint_start(self)

    @property
    def uses_previous(self) -> bool:
        """Whether estimates depend on those of earlier frames by more than where their search begins."""
        return self.relative or not self.method.optimum

    def has_error_bars(self, readings: Readings) -> bool:
        """Whether estimates of such readings get error bars."""
        rows, columns = readings.value.shape[-2:]
        few = rows * columns <= MATRIX_CELLS or self.weighs_previous
        requested = self.error_bars if isinstance(self.error_bars, bool) else few
        return requested and self.method.optimum and readings.sigma is not None

    def effort(self, panel: Panel) -> tuple[float, float]:
        """(s, bytes) of a first frame with penalties, about; zeros where less is asked for.

        Gradients took 12 s and 275 MB at 100 × 100 cells, 80 s and 787 MB at 280 × 280; one core of 2026.
        """
        each = panel if panel.modules is None else panel.modules.each
        penalised = self.method.optimum and any(not term.reads_measurement for term in self.terms)
        size = penalised * each.rows * each.columns / 10_000
        return 12 * size**1.1, 1e8 * size

    def check(self, scene: Scene) -> None:
        """Raise InputError where the formulation cannot serve the scene."""
        self.method.check_scene(scene)

    def problem(self, scene: Scene, frames: int, period: float, *, partial: bool = False) -> Solver:
        """Return the solver for one frame, or for two jointly, `period` seconds apart.

        It is built once per process.
        """
        return self.method.solver(self.cost(scene, frames, partial=partial), scene, self.solver, period)
