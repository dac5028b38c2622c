"""Terms of the cost function.

To add a term, write its class here, before `AnyTerm`, and name it there.
"""

from abc import abstractmethod
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, ClassVar, Literal

import casadi

from lampest.cost.given import Given
from lampest.cost.losses import Absolute, AnyLoss, Huber, Squared
from lampest.files.typed import (
    ByKind,
    Configuration,
    check_not_negative,
    check_positive_fields,
    kinds_of,
    members_by_kind,
    shipped,
)
from lampest.panel.panel import Array, Panel, difference_matrix

Reference = Literal["baseline", "previous"]


@dataclass(frozen=True, eq=False, kw_only=True)
class State(Given):
    """State of one frame as the input of a term's residual, symbolic or numeric.

    Every field is a column (cells, 1) in row-major order. For slices of rows and columns use
    `grid`.

    Attributes
    ----------
    panel : Panel
    cell_resistance : (cells, 1)
        r in ohm.
    reading : (cells, 1)
        Modelled reading y = f(r), in the readout's unit.

    All other fields are those that `Given` declares; None where they are not known.

    >>> import numpy as np
    >>> rest, loaded = np.array([[1000.0], [1000.0]]), np.array([[1000.0], [900.0]])
    >>> given = {"panel": lampest.Panel(1, 2), "reading": loaded, "previous": rest}
    >>> lampest.State(cell_resistance=loaded, **given).relative_change().ravel()
    array([  0., -10.])
    """

    panel: Panel
    cell_resistance: Any
    reading: Any

    def relative_change(self) -> Any:
        """Return 100·(r − r0)/r0 in percent; paper, equation (15)."""
        return 100 * (self.cell_resistance - self.previous) / self.previous

    def ratio(self, reference: Reference) -> Any:
        """Return r/r0, r0 of the baseline or of the previous frame, (cells, 1)."""
        return self.cell_resistance / getattr(self, reference)

    def log_steps(self, values: Any) -> Any:
        """Return log(x_b/x_a)/distance over pairs of `Panel.neighbours`, (pairs, 1) per pitch."""
        first, second, distance = self._at_neighbours(values)
        return casadi.log(second / first) / distance

    def grid(self, values: Any) -> Any:
        """Arrange a column of (cells, 1) as a matrix (rows, columns), symbolic or numeric."""
        rows, columns = self.panel.shape
        return casadi.reshape(values, columns, rows).T

    def gradient(self, values: Any) -> Any:
        """Return ∇x as one column; paper, section IV.D.

        A full rectangle has (2·cells, 1) differences, the row part before the column part. Listed
        cells have (pairs, 1): the difference of each pair of `Panel.neighbours` over its distance.
        """
        if self.panel.cells is None:
            return gradient_operator(*self.panel.shape) @ values
        first, second, distance = self._at_neighbours(values)
        return (second - first) / distance

    def _at_neighbours(self, values: Any) -> tuple[Any, Any, Array]:
        """Return the values of both cells of each pair of `Panel.neighbours`, and their distance.

        Each is (pairs, 1), the distance in pitches.
        """
        *cells, distance = self.panel.neighbours
        first, second = (values[numbers.tolist(), :] for numbers in cells)
        return first, second, distance[:, None]


@cache
def gradient_operator(rows: int, columns: int) -> casadi.DM:
    """Return the panel's finite differences of row-major columns, sparse (2·cells, cells)."""
    along_rows, along_columns = (
        casadi.sparsify(casadi.DM(difference_matrix(length))) for length in (rows, columns)
    )
    # (D ⊗ 1; 1 ⊗ D): D differences along a column, and along a row, of row-major values
    return casadi.vertcat(
        casadi.kron(along_rows, casadi.DM.eye(columns)),
        casadi.kron(casadi.DM.eye(rows), along_columns),
    )


Weight = float | Literal["auto"]


@dataclass(frozen=True)
class Term(Configuration):
    """A summand of the cost function: weight · loss(residual(state)).

    Attributes
    ----------
    weight : float or 'auto'
        λ; 'auto' if the data choose it.
    unit : str
        Unit of the residual, required of every class.
    reads_measurement : bool
        Whether the term is a data term; all others are penalties.
    needs_previous : bool
        Whether the term compares with the previous frame or the baseline.
    weighs_previous : bool
        Whether the term's variance contains the previous frame's error.
    convex_in_log : bool
        Whether the term is convex in log r for given previous frame and baseline.

    Raises ValueError unless the weight is finite and not negative, and for a class without a unit
    or with the `kind` of another term.

    >>> issubclass(lampest.Misfit, lampest.Term)
    True
    """

    reads_measurement: ClassVar[bool] = False
    needs_previous: ClassVar[bool] = False
    weighs_previous: ClassVar[bool] = False
    convex_in_log: ClassVar[bool] = False
    unit: ClassVar[str]
    weight: Weight = 1.0
    loss: AnyLoss = Squared()

    def __post_init__(self) -> None:
        _check_class(type(self))
        if self.weight != "auto":
            check_not_negative(self, "weight")

    @abstractmethod
    def residual(self, state: State) -> Any:
        """Return the residuals in `unit` as one column, (rows, 1) with any number of rows.

        Every row is a function of `state.cell_resistance` or `state.reading`. A matrix becomes a
        column by `casadi.vec`.
        """


@dataclass(frozen=True)
class Misfit(Term):
    """f(r) − R_m in the readout's unit, or (f(r) − R_m)/σ where weighting is 'noise'.

    See the paper, equation (11).

    >>> lampest.Misfit().unit
    'ohm'
    """

    reads_measurement = True
    unit = "ohm"
    kind: Literal["misfit"] = "misfit"
    weight: float = 1.0
    weighting: Literal["plain", "noise"] = "plain"

    def residual(self, state: State) -> Any:
        """Return modelled minus measured readings, (cells, 1); zero for a bound that holds."""
        difference = state.reading - state.measured
        if state.side is not None:
            # Values: f(r) − R_m. Bounds: min(f(r) − R_m, 0) for side 1, max(f(r) − R_m, 0) for side
            # −1. Missing: 0.
            beyond = state.side * casadi.fmin(state.side * difference, 0)
            difference = state.seen * ((1 - state.side**2) * difference + beyond)
        return difference / state.sigma if self.weighting == "noise" else difference


@dataclass(frozen=True)
class CellResistance(Term):
    """r in ohm; LSR-CR, paper, equation (13).

    >>> lampest.CellResistance(weight=1e-3).unit
    'ohm'
    """

    unit = "ohm"
    kind: Literal["cell_resistance"] = "cell_resistance"
    weight: Weight = "auto"

    def residual(self, state: State) -> Any:
        """Return r, (cells, 1)."""
        return state.cell_resistance


@dataclass(frozen=True)
class RelativeChange(Term):
    """100·(r − r0)/r0 in percent; LSR-ΔCR, paper, equations (15) and (17).

    >>> lampest.RelativeChange(weight=10.0).weight
    10.0
    """

    needs_previous = True
    unit = "percent"
    kind: Literal["relative_change"] = "relative_change"
    weight: Weight = "auto"

    def residual(self, state: State) -> Any:
        """Return the relative change, (cells, 1)."""
        return state.relative_change()


@dataclass(frozen=True)
class Gradient(Term):
    """∇r in ohm per cell, row part and column part; LSR-∇CR, paper, equation (19).

    >>> lampest.Gradient().weight
    'auto'
    """

    unit = "ohm per cell"
    kind: Literal["gradient"] = "gradient"
    weight: Weight = "auto"

    def residual(self, state: State) -> Any:
        """Return finite differences of the cell resistance, (2·cells, 1)."""
        return state.gradient(state.cell_resistance)


@dataclass(frozen=True)
class GradientOfRelativeChange(Term):
    """∇(100·(r − r0)/r0) in percent per cell; LSR-∇ΔCR, paper, equations (21) and (23).

    >>> lampest.GradientOfRelativeChange(weight=10.0).unit
    'percent per cell'
    """

    needs_previous = True
    unit = "percent per cell"
    kind: Literal["gradient_of_relative_change"] = "gradient_of_relative_change"
    weight: Weight = "auto"

    def residual(self, state: State) -> Any:
        """Return finite differences of the relative change, (2·cells, 1)."""
        return state.gradient(state.relative_change())


@dataclass(frozen=True)
class TotalVariation(Term):
    """100·log(r_b/r_a) in percent per pitch, over all pairs a, b of neighbours.

    The term with its absolute loss is the anisotropic total variation of log r.
    Source: Rudin, Osher & Fatemi, Physica D 60, 1992.

    >>> lampest.TotalVariation().loss.kind
    'absolute'
    """

    convex_in_log = True
    unit = "percent"
    weight: Weight = "auto"
    loss: AnyLoss = Absolute()
    kind: Literal["total_variation"] = "total_variation"

    def residual(self, state: State) -> Any:
        """Return the logarithmic steps, (pairs, 1)."""
        return 100 * state.log_steps(state.cell_resistance)


@dataclass(frozen=True)
class LogGradient(Term):
    """ln(r_b/r_a) over all pairs a, b of neighbours, per pitch.

    The residual does not depend on the scale of r, and suits panels whose unloaded cells are open.

    >>> lampest.LogGradient().weight
    'auto'
    """

    unit = "1 per pitch"
    weight: Weight = "auto"
    kind: Literal["log_gradient"] = "log_gradient"

    def residual(self, state: State) -> Any:
        """Return the logarithmic steps, (pairs, 1)."""
        return state.log_steps(state.cell_resistance)


@dataclass(frozen=True)
class LogRatio(Term):
    """100·log(r/r0) in percent, r0 the baseline or the previous frame.

    Suction and pressure of the same ratio have the same cost. With the squared loss the term is a
    Gaussian prior of log r; with the absolute loss few cells change, by any amount.
    Source: Tarantola, Inverse Problem Theory, 2005 (positive parameters by their logarithms).

    >>> lampest.LogRatio(weight=1.0).kind
    'log_ratio'
    """

    needs_previous = True
    convex_in_log = True
    unit = "percent"
    weight: Weight = "auto"
    loss: AnyLoss = Absolute()
    kind: Literal["log_ratio"] = "log_ratio"
    reference: Reference = "baseline"

    def residual(self, state: State) -> Any:
        """Return the logarithmic ratio, (cells, 1)."""
        return 100 * casadi.log(state.ratio(self.reference))


@dataclass(frozen=True)
class TotalVariationOfChange(Term):
    """100·log((r/r0)_b/(r/r0)_a) in percent per pitch, over all pairs a, b of neighbours.

    The `reference` names r0. The term with its absolute loss is the anisotropic total variation of
    log r/r0; see `TotalVariation`.

    >>> lampest.TotalVariationOfChange().loss.kind
    'absolute'
    """

    needs_previous = True
    convex_in_log = True
    unit = "percent"
    weight: Weight = "auto"
    loss: AnyLoss = Absolute()
    kind: Literal["total_variation_of_change"] = "total_variation_of_change"
    reference: Reference = "baseline"

    def residual(self, state: State) -> Any:
        """Return logarithmic steps of the change between neighbouring cells, (pairs, 1)."""
        return 100 * state.log_steps(state.ratio(self.reference))


@dataclass(frozen=True)
class Arrival(Term):
    """(log r − log r0)/√(sd0² + q²), r0 the previous frame.

    The standard deviation sd0 is that of log r0. The standard deviation q, `walk_percent` in
    percent, is that of a cell's own change from one frame to the next, without steps that all
    readings share (`lampest.panel.readouts.floating.common_step`). The term makes the estimate an
    extended Kalman filter with bounds that uses the diagonal of the covariance; Huber's loss allows
    single cells to jump.
    The right weight is 1 with misfit.weighting: noise, and σ² ohm² with plain readings of equal
    noise σ.
    Raises ValueError unless q is positive and finite.
    Sources: Rao, Rawlings & Mayne, IEEE Trans. Automat. Contr. 48, 2003 (arrival cost); Masreliez &
    Martin, IEEE Trans. Automat. Contr. 22, 1977 (robust Kalman filter).

    >>> lampest.Arrival(weight=1.0).kind
    'arrival'
    """

    needs_previous = True
    weighs_previous = True
    convex_in_log = True
    unit = "standard deviations"
    weight: float = 1.0
    loss: AnyLoss = Huber(corner=1.25)
    kind: Literal["arrival"] = "arrival"
    walk_percent: float = 2.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive_fields(self, "walk_percent")

    def residual(self, state: State) -> Any:
        """Return the logarithmic change in standard deviations, (cells, 1)."""
        # sd0² + q², with q in percent
        variance = state.previous_deviation**2 + (self.walk_percent / 100) ** 2
        return casadi.log(state.ratio("previous")) / casadi.sqrt(variance)


AnyTerm = Annotated[
    Misfit
    | CellResistance
    | RelativeChange
    | Gradient
    | GradientOfRelativeChange
    | LogGradient
    | TotalVariation
    | LogRatio
    | TotalVariationOfChange
    | Arrival,
    ByKind("lampest.terms"),
]


@cache
def _check_class(term: type[Term]) -> None:
    """Raise ValueError unless a class of terms has a unit, and a `kind` that no other term has."""
    if not isinstance(getattr(term, "unit", None), str):
        raise ValueError(
            f"{term.__name__} has no unit: "
            "declare it in the class, such as unit: ClassVar[str] = 'ohm'"
        )
    for member in shipped(AnyTerm):
        if member is not term and not set(kinds_of(member)).isdisjoint(kinds_of(term)):
            raise ValueError(
                f"{term.__name__} has the kind '{kinds_of(member)[0]}' of {member.__name__}: "
                "choose another"
            )


def term_kind(term: Term) -> str:
    """Return the word that names the term in YAML and results."""
    return str(getattr(term, "kind", type(term).__name__))


def term_types() -> dict[str, type[Term]]:
    """Return kind → class, first of the members of the union, then of installed packages.

    >>> sorted(lampest.term_types())[:2]
    ['arrival', 'cell_resistance']
    """
    return members_by_kind(AnyTerm)
