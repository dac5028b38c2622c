"""Objectives: an estimator as its method sees it."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from lampest.cost.cost import Cost
from lampest.cost.given import Background
from lampest.cost.problem import Data
from lampest.cost.terms import Term, term_kind
from lampest.files.errors import InputError, in_words
from lampest.files.typed import Configuration, check_range
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings, strongest_frame
from lampest.solvers.posed import Bounds, cost_of_solve, data_of_solve
from lampest.solvers.solution import Settings

# Cells up to which `strongest` is verified: beyond, the witness takes longer than all solves of a
# short recording (docs/studies/speed.md).
MAX_VERIFIED_CELLS = 144
Rule = Literal["risk", "evidence"]  # function of a weight that its choice minimises


@dataclass(frozen=True)
class AutoWeight(Configuration):
    """Settings of `weight: auto`.

    Attributes
    ----------
    rule : Rule or None
        'risk' minimises the expected error of log r, with the reference estimate as the truth.
        'evidence' takes the most probable weight. By default risk, and evidence for panels with
        more than 400 cells.
    per : 'recording' or 'frame'
        'recording' chooses one weight from the strongest frame; 'frame' chooses one for every
        frame.

    >>> lampest.AutoWeight().per
    'recording'
    """

    rule: Rule | None = None
    per: Literal["recording", "frame"] = "recording"


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

    def chosen(self, readings: Readings, resting: Readings) -> NDArray[np.bool_]:
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
        if self.frames == "all":
            chosen[:] = True
        elif self.frames == "strongest":
            if count and readings.value[0].size <= MAX_VERIFIED_CELLS:
                chosen[strongest_frame(readings.plain_values, resting.value, np.arange(count))] = (
                    True
                )
        elif not isinstance(self.frames, str):
            chosen[np.linspace(0, count - 1, max(1, round(self.frames * count))).astype(int)] = (
                count > 0
            )
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
class Objective:
    """Fields of an `Estimator`, and the costs that they state, whatever the method.

    The fields are described in `Estimator`.
    """

    terms: tuple[Term, ...]
    formulation: Any = "auto"
    solver: Settings = Settings()
    bounds: Bounds = Bounds()
    error_bars: Literal["auto"] | bool = "auto"
    auto_weight: AutoWeight = AutoWeight()
    tare: Tare | None = None
    verify: Verify = Verify()
    weight_sigma: tuple[float, ...] = ()
    prior_variance: tuple[float, ...] = ()

    def with_terms(self, terms: tuple[Term, ...]) -> Self:
        """Return the objective of an optimum with other terms.

        Terms that stay keep the deviation of their weight.
        """

        def of_terms(values: tuple[float, ...]) -> tuple[float, ...]:
            of_term = dict(zip(self.terms, values, strict=False))
            return tuple(of_term.get(term, np.nan) for term in terms) if of_term else ()

        return replace(
            self,
            terms=terms,
            formulation="reduced",
            weight_sigma=of_terms(self.weight_sigma),
            prior_variance=of_terms(self.prior_variance),
        )

    @property
    def automatic(self) -> bool:
        """Whether a weight is still to be chosen."""
        return any(term.weight == "auto" for term in self.terms)

    def with_weights(
        self,
        weights: Iterable[float],
        sigma: tuple[float, ...] = (),
        variance: tuple[float, ...] = (),
    ) -> Self:
        """Return the objective with these weights of the terms, in their order.

        `sigma` becomes its `weight_sigma`, and `variance` its `prior_variance`.
        """
        terms = zip(self.terms, weights, strict=True)
        return replace(
            self,
            terms=tuple(replace(term, weight=float(weight)) for term, weight in terms),
            weight_sigma=sigma,
            prior_variance=variance,
        )

    @property
    def relative(self) -> bool:
        """Whether a term depends on the previous frame."""
        return any(term.needs_previous for term in self.terms)

    @property
    def penalised(self) -> bool:
        """Whether a penalty term determines cells that have no reading."""
        return not all(term.reads_measurement for term in self.terms)

    @property
    def weighs_previous(self) -> bool:
        """Whether a term depends on the uncertainty of the previous frame."""
        return any(term.weighs_previous for term in self.terms)

    @property
    def absolute_terms(self) -> tuple[Term, ...]:
        """The terms that need no previous frame."""
        return tuple(term for term in self.terms if not term.needs_previous)

    def data(self, readings: Readings, background: Background) -> Data:
        """Return the data of one solve, see `lampest.solvers.posed.data_of_solve`."""
        return data_of_solve(self.terms, self.bounds, readings, background)

    def cost(self, scene: Scene, frames: int, *, partial: bool = False) -> Cost:
        """Return the terms over one or two frames, see `lampest.solvers.posed.cost_of_solve`."""
        return cost_of_solve(self.terms, scene, frames, partial=partial)
