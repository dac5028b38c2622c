"""Estimators: terms, formulation, bounds and settings of one method of estimation."""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from lampest.cost.losses import Huber, Student
from lampest.cost.terms import LogRatio, Misfit, State, Term, term_kind
from lampest.estimate.methods import MethodName, named_method
from lampest.estimate.methods.method import Method
from lampest.estimate.weights import AutoWeight, Objective
from lampest.files.applications import applications, loaded
from lampest.files.errors import InputError, in_words
from lampest.files.typed import Configuration, check_range
from lampest.formulation.constraints import AnyPart
from lampest.panel.panel import Mask, Panel
from lampest.panel.readouts.starts import USUAL_OHM, unseen_scales
from lampest.panel.scene import Scene
from lampest.panel.trust_region import MATRIX_CELLS
from lampest.recording.readings import Readings, strongest_frame
from lampest.solvers.posed import Bounds
from lampest.solvers.solution import Settings, Solver

# Cells up to which `strongest` is verified: beyond, the witness takes longer than all solves of a
# short recording (docs/studies/speed.md).
MAX_VERIFIED_CELLS = 144
# Student's t with 15 degrees of freedom, and nearly the variance of the noise: c² = ν + 1.
ROBUST = Student(corner=4.0)
CONSTRAINED = "lampest.estimate.methods.constrained:ConstrainedMethod"
DECADES = 1.0  # standard deviation of the panel's mean log10 r: usual films have 100 ohm to 1 Mohm
RESTING_PERCENT = 50.0  # standard deviation of 100 ln r/r0 of a cell that rests
CORNER_PERCENT = 10.0  # of 100 ln r/r0: cells that change by more pull no harder


@dataclass(frozen=True)
class Verify(Configuration):
    """Frames that IPOPT solves again on the nodal program, from another start.

    Attributes
    ----------
    frames : 'none', 'strongest', 'all' or float
        'strongest' is the frame of the largest change from rest, on panels of up to 144 cells; a
        number is the share of the frames, evenly spread.

    Raises ValueError unless a share lies between 0 and 1.

    >>> lampest.Verify("strongest").frames
    'strongest'
    """

    frames: Literal["none", "strongest", "all"] | float = "none"

    def __post_init__(self) -> None:
        if not isinstance(self.frames, str) and not 0 < self.frames <= 1:
            raise ValueError("frames must be none, strongest, all, or a share between 0 and 1")

    def chosen(self, readings: Readings, resting: Readings) -> Mask:
        """Return which of the measured frames are verified, boolean (frames,).

        Parameters
        ----------
        readings : Readings
            The measured frames, (frames, rows, columns).
        resting : Readings
            The unloaded ones, (rows, columns).
        """
        count = len(readings.value)
        chosen = np.zeros(count, dtype=bool)
        if self.frames == "strongest":
            if count and resting.value.size <= MAX_VERIFIED_CELLS:
                strongest = strongest_frame(readings.plain_values, resting.value, np.arange(count))
                chosen[strongest] = True
        elif self.frames != "none":
            share = 1.0 if self.frames == "all" else self.frames
            several = min(max(1, round(share * count)), count)
            chosen[np.linspace(0, count - 1, several).astype(int)] = True
        return chosen


def checked_terms(terms: Sequence[Term]) -> tuple[Term, ...]:
    """Return the terms as a tuple.

    Raises InputError unless they are a list or tuple of terms with at least one data term.
    """
    if not isinstance(terms, list | tuple):
        raise InputError(
            f"terms must be a list such as [Misfit(), Gradient()], not {in_words(terms)}"
        )
    for term in terms:
        if not isinstance(term, Term):
            raise InputError(f"terms must hold objects such as Misfit(), not {in_words(term)}")
    if not terms:
        raise InputError("an estimator needs at least one term")
    if not any(term.reads_measurement for term in terms):
        named = " + ".join(map(term_kind, terms))
        raise InputError(
            f"{named} needs the term misfit: without it nothing reads what was measured"
        )
    return tuple(terms)


@dataclass(frozen=True)
class Tare(Configuration):
    """Take zero anew where nothing has touched the panel for a number of successive frames.

    Attributes
    ----------
    frames : int
        Number of frames, at least five: fewer do not distinguish noise from a load.
    drift_per_minute : float
        Standard deviation of ln r of a cell at rest for each minute since the last zero.

    >>> lampest.Tare().frames
    20
    """

    frames: int = 20
    drift_per_minute: float = 0.02

    def __post_init__(self) -> None:
        check_range("drift_per_minute", self.drift_per_minute, 0, 1)
        check_range("frames", self.frames, 5, 100_000)


@dataclass(frozen=True)
class Estimator(Objective):
    """Terms, the method that minimises them, its settings, and bounds.

    Raises InputError without a data term, for a formulation that does not exist or does not support
    the terms, where a term weighs the previous frame by its error bars and there can be none, or
    where a part is of another class.

    Attributes
    ----------
    terms : tuple of Term
    formulation : MethodName or Method
        The method that computes the estimate: its name, or a method with options.
    solver : Settings
    bounds : Bounds
    error_bars : 'auto' or bool
        Whether to compute error bars; 'auto': on panels of up to 600 cells, or where a term needs
        them. Only verified optima of readings with known noise can have them.
    auto_weight : AutoWeight
        Choice of the weights that the terms leave open.
    tare : Tare or None
        When to set the zero of pressures anew because nothing touches the panel; None: never.
    verify : Verify
        Frames that IPOPT solves again on the nodal program, from another start.
    constraints : tuple of ProgramPart, or None
        Own parts of the program of every frame; weights are chosen without them.
    weight_sigma : tuple of float
        Standard deviations of ln λ of chosen weights.

    >>> lampest.Estimator((lampest.Misfit(),), formulation="reduced").relative
    False
    """

    formulation: MethodName | Method = "auto"
    _: KW_ONLY
    error_bars: Literal["auto"] | bool = "auto"
    tare: Tare | None = None
    verify: Verify = Verify()
    constraints: tuple[AnyPart, ...] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "terms", checked_terms(self.terms))  # a list cannot be hashed
        for name, kind in (
            ("solver", Settings),
            ("bounds", Bounds),
            ("auto_weight", AutoWeight),
            ("verify", Verify),
        ):
            if not isinstance(getattr(self, name), kind):
                raise InputError(
                    f"{name} must be {kind.__name__}(...), not {in_words(getattr(self, name))}"
                )
        if not isinstance(self.tare, Tare | None):
            raise InputError(f"tare must be Tare(...) or None, not {in_words(self.tare)}")
        if self.tare is not None:
            applications().require("film", "tare")
        if self.error_bars not in ("auto", True, False):
            raise InputError(
                f"error_bars must be 'auto', True or False, not {in_words(self.error_bars)}"
            )
        self.method.check(self.terms)
        if self.weighs_previous and (self.error_bars is False or not self.method.optimum):
            raise InputError(
                "arrival weighs frames by their error bars: "
                "it needs error_bars, and an optimum to have them"
            )
        if self.automatic and self.auto_weight.per == "frame" and not self.method.optimum:
            raise InputError("auto_weight.per: frame needs a formulation that ends at an optimum")

    @cached_property
    def method(self) -> Method:
        """The method of the formulation, subject to the constraints."""
        method = named_method(self.formulation)
        if not self.constraints:
            return method
        constrained: Method = loaded(CONSTRAINED).of(method, self.constraints)
        return constrained

    @property
    def joint_start(self) -> bool:
        """Whether the baseline is solved together with the first frame."""
        return self.method.joint_start(self)

    @property
    def uses_previous(self) -> bool:
        """Whether estimates depend on earlier estimates, beyond the start of their search."""
        # A baseline that is solved alone is the same for all frames.
        compares = any(
            term.needs_previous and getattr(term, "reference", None) != "baseline"
            for term in self.terms
        )
        return compares or self.joint_start or not self.method.optimum

    def has_error_bars(self, readings: Readings) -> bool:
        """Return whether estimates of such readings have error bars."""
        rows, columns = readings.value.shape[-2:]
        few = rows * columns <= MATRIX_CELLS or self.weighs_previous
        requested = self.error_bars if isinstance(self.error_bars, bool) else few
        return requested and self.method.optimum and readings.sigma is not None

    def effort(self, panel: Panel) -> tuple[float, float]:
        """Return the approximate effort of a first frame with penalties, zero without penalties.

        Calibrated on gradient penalties: 12 s and 275 MB at 100 × 100 cells, 80 s and 787 MB at 280
        × 280, on one core of 2026.

        Returns
        -------
        seconds : float
        memory : float
            In bytes.
        """
        module = panel.layout.each
        penalised = self.method.optimum and self.penalised
        size = penalised * module.rows * module.columns / 10_000
        return 12 * size**1.1, 1e8 * size

    def check(self, scene: Scene) -> None:
        """Raise InputError where the formulation or a misfit does not support the scene."""
        self.method.check_scene(scene)
        self.for_outliers(scene)

    def for_outliers(self, scene: Scene) -> "Estimator":
        """Return the estimator with the losses that the scene requests.

        Squared misfits of `outliers: robust` have Student's loss, of corner 4 σ.

        Raises InputError where such a misfit is not weighted by the noise: its corner has no unit.
        """
        if scene.outliers != "robust":
            return self
        terms = list[Term]()
        for term in self.terms:
            if isinstance(term, Misfit) and term.loss.squared:
                if term.weighting != "noise":
                    raise InputError(
                        "outliers: robust needs misfit: {weighting: noise}, "
                        "or a loss that is stated there"
                    )
                term = replace(term, loss=ROBUST)
            terms.append(term)
        return replace(self, terms=tuple(terms))

    def in_scene(self, scene: Scene, readings: Readings) -> "Estimator":
        """Return the estimator with what its scene adds to the terms.

        These are the losses that the scene requests for outliers, and priors of the scales that no
        reading of its circuit shows. Methods that end at no optimum keep the scale of their start,
        and have no such priors. Terms that compare frames take the place of the prior of change.

        Parameters
        ----------
        scene : Scene
            That of one network.
        readings : Readings
            (…, rows, columns); their noise is the unit of a plain misfit.
        """
        estimator = self.for_outliers(scene)
        single = self.method.optimum and not self.method.needs_all_frames
        known = any(isinstance(term, UsualScale) for term in self.terms)
        unseen = unseen_scales(scene.circuit, *scene.panel.shape)
        if not (single and unseen) or known or readings.sigma is None:
            return estimator
        by_noise = any(getattr(term, "weighting", "plain") == "noise" for term in self.terms)
        sigma = readings.sigma[np.isfinite(readings.sigma)]
        square = 1.0 if by_noise else float(np.mean(sigma**2))
        priors: tuple[Term, ...] = (UsualScale(weight=square),)
        if not self.relative:
            weight = square / RESTING_PERCENT**2
            priors = (LogRatio(weight=weight, loss=Huber(corner=CORNER_PERCENT)), *priors)
        chosen = self.weight_sigma
        return replace(
            estimator,
            terms=(*estimator.terms, *priors),
            weight_sigma=chosen and (*chosen, *[np.nan] * len(priors)),
        )

    def problem(self, scene: Scene, frames: int, period: float, *, partial: bool = False) -> Solver:
        """Return the solver for one frame, or for two frames jointly; it is built once per process.

        Parameters
        ----------
        scene : Scene
        frames : int
            1 or 2.
        period : float
            Time between frames, s.
        partial : bool
            Whether readings may be bounds or missing.
        """
        return self.method.solver(
            self.cost(scene, frames, partial=partial), scene, self.solver, period
        )


@dataclass(frozen=True)
class UsualScale(Term):
    """Prior of scales that no reading of a circuit shows, ln(r/USUAL_OHM)/(DECADES·ln 10·√n).

    A factor on all cells of a column changes no reading of inputs without a resistor. Penalties
    would choose the factor by chance, and cells would drift to their bounds. Two weak priors choose
    it. The panel has usual cells, and the mean of log10 r of its n cells the standard deviation
    DECADES; and most cells do not change, so that the unloaded panel gives each column of a frame
    its scale. Readings outweigh both in all that they show.
    """

    convex_in_log = True
    unit = "standard deviations"
    kind: Literal["usual_scale"] = "usual_scale"
    weight: float = 1.0

    def residual(self, state: State) -> Any:
        """Return the logarithmic distance from usual cells, (cells, 1)."""
        deviation = DECADES * np.log(10) * np.sqrt(state.panel.crossings)
        return np.log(state.cell_resistance / USUAL_OHM) / deviation
