"""What an estimator made of every frame, and how each of its solves ended."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from lampest.cost.terms import Term, term_kind
from lampest.panel.panel import Array
from lampest.runs.columns.checks import not_negative, not_zero_or_less, numbers_if_solved, whole_frames_if_solved
from lampest.runs.columns.column import CELLS, FRAMES, MAPS, Column, Figures, of_steps

if TYPE_CHECKING:
    from lampest.estimate.estimates import Estimates

UNITS = {"_mm": "mm", "_kpa": "kPa"}

ESTIMATE = (
    Column(
        "cell_resistance",
        MAPS,
        "ohm",
        "estimated cell resistance",
        lambda done: done.cell_resistance,
        (numbers_if_solved, not_zero_or_less),
    ),
    Column(
        "relative_change",
        MAPS,
        "percent",
        "cell resistance against its baseline",
        lambda done: done.relative_change,
        (whole_frames_if_solved,),
    ),
    Column(
        "reading_model",
        MAPS,
        "ohm",
        "two-point resistance of the estimated cells",
        of_steps(lambda step: step.solution.reading[-1]),
        (numbers_if_solved, not_negative),
        dataset="two_point_model",
        as_volt=("reading_model", "what is read of the estimated cells"),
    ),
    Column(
        "open_cell",
        MAPS,
        "1",
        "1: cannot be told from an open cell",
        lambda done: done.open_cell,
        dtype=np.uint8,
        flags=((0, "conducts"), (1, "cannot_be_told_from_open")),
    ),
    Column(
        "at_lower_bound",
        MAPS,
        "1",
        "1: cell resistance stands at its lower bound",
        lambda done: done.at_lower_bound,
        dtype=np.uint8,
        flags=((0, "above_lower_bound"), (1, "at_lower_bound")),
    ),
    Column(
        "baseline_resistance",
        CELLS,
        "ohm",
        "estimated unloaded cell resistance",
        lambda done: done.baseline_resistance,
    ),
    Column("status", FRAMES, "1", "how the solve ended", lambda done: done.status, dtype=str),
    Column(
        "iterations",
        FRAMES,
        "1",
        "iterations of the solver",
        of_steps(lambda step: step.solution.iterations),
        dtype=np.int64,
    ),
    Column(
        "starts",
        FRAMES,
        "1",
        "starts of the solve; the estimate is the lowest local optimum that they reached",
        of_steps(lambda step: step.solution.starts),
        dtype=np.int64,
    ),
    Column("solve_time", FRAMES, "s", "wall time of the solve", of_steps(lambda step: step.seconds)),
    Column("objective", FRAMES, "1", "value of the cost function", of_steps(lambda step: step.solution.objective)),
    Column(
        "kkt_residual",
        FRAMES,
        "1",
        "violation of the optimality conditions",
        of_steps(lambda step: step.solution.kkt_residual),
    ),
    Column(
        "solved",
        FRAMES,
        "1",
        "1: solved, 0: failed",
        lambda done: done.solved,
        dtype=bool,
        flags=((0, "failed"), (1, "solved")),
    ),
)


def _costs(done: Estimates) -> dict[str, Array]:
    """Term → its part of the cost."""
    return {
        name: np.array([step.solution.costs[number] for step in done.steps])
        for number, name in enumerate(_names(done.estimator.terms))
    }


def _weights(done: Estimates) -> dict[str, Array]:
    """Term → its weight."""
    return {
        name: np.array([step.weights[number] for step in done.steps])
        for number, name in enumerate(_names(done.estimator.terms))
    }


def _names(terms: Sequence[Term]) -> list[str]:
    """The kind of every term; `kind_2` and so on for further ones of a kind, which only a script can give."""
    kinds = [term_kind(term) for term in terms]
    before = [kinds[:number].count(kind) for number, kind in enumerate(kinds)]
    return [f"{kind}_{count + 1}" if count else kind for kind, count in zip(kinds, before, strict=True)]


def _disc(done: Estimates) -> dict[str, Array]:
    """Every number of the discs and its standard deviation; NaN where a frame failed. None without any disc."""
    discs = [step.disc for step in done.steps]
    first = next((disc for disc in discs if disc is not None), None)
    numbers = {}
    for name in () if first is None else first.disc._fields:
        for end, part in (("", "disc"), ("_errors", "disc_errors")):
            values = [np.nan if disc is None else getattr(getattr(disc, part), name) for disc in discs]
            numbers[name + end] = np.array(values, dtype=float)
    return numbers


def _contacts(done: Estimates) -> dict[str, Array]:
    """Every line's contact and its standard deviation, the same in every frame; none where the scene names none."""
    if done.contacts is None:
        return {}
    shape, every = done.recording.scene.panel.shape, np.ones(len(done.steps))
    lines = [f"{side}_{line}" for side, count in zip(("row", "column"), shape, strict=True) for line in range(count)]
    ohm, errors = done.contacts.mean(shape), done.contacts.deviation(shape)
    return dict(zip(lines, np.outer(ohm, every), strict=True)) | {
        f"{line}_errors": error * every for line, error in zip(lines, errors, strict=True)
    }


MISFIT = {
    "chi_square": "sum of squared residuals over their noise",
    "degrees_of_freedom": "readings less what the estimate follows of them",
    "tail": "probability of as large a chi square by noise alone",
    "worst_row": "row that holds most of chi square",
    "worst_row_share": "share of that row",
    "worst_column": "column that holds most of chi square",
    "worst_column_share": "share of that column",
}

FIGURES = (
    Figures(
        "contacts",
        "contact",
        _contacts,
        lambda name: "ohm",
        lambda name: (
            f"{'standard deviation of the ' if name.endswith('_errors') else ''}contact resistance of "
            f"{name.removesuffix('_errors').replace('_', ' ')}"
        ),
    ),
    Figures("costs", "cost", _costs, lambda name: "1", lambda name: f"cost of the term {name}"),
    Figures("weights", "weight", _weights, lambda name: "1", lambda name: f"weight of the term {name}"),
    Figures(
        "disc",
        "disc",
        _disc,
        lambda name: next((unit for end, unit in UNITS.items() if name.removesuffix("_errors").endswith(end)), "1"),
        lambda name: f"oral disc: {name.replace('_', ' ')}",
    ),
    Figures("misfit", "model_check", lambda done: done.misfit, lambda name: "1", lambda name: MISFIT.get(name, name)),
)
