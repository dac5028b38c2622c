"""Report of `lampest study weights`: table, curves and figure of every case with one penalty."""

import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis, XAxis
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation, LogLocator, NullLocator

from lampest.cost.terms import term_kind
from lampest.recording.recording import Recording
from lampest.report.plots.style import SMALL_POINT, TEXT_POINT, dressed, new_figure
from lampest.runs.config import Case, Run, read_run
from lampest.studies import study
from lampest.studies.weights import Choice, Tuned, WeightSubject, tune, why_not

LOOKS: dict[str, dict[str, Any]] = {
    "risk": {"color": "#0072B2", "ls": "-", "marker": "o"},
    "evidence": {"color": "#D55E00", "ls": "--", "marker": "s"},
    "Morozov": {"color": "#CC79A7", "ls": ":", "marker": "^"},
    "L-curve": {"color": "#E69F00", "ls": "-.", "marker": "v"},
    "given": {"color": "#7A5230", "ls": "-", "marker": "P", "name": "given in the file"},
    "best": {"color": "black", "ls": "-", "marker": "*", "name": "best in hindsight"},
}
PENALTY = "#56738C"  # the colour of its axis
LINE: dict[str, Any] = {"color": "black", "lw": 1.3, "zorder": 2.5}


def weights_figure(tuned: Tuned) -> Figure:
    """Draw evidence, risk, misfit, penalty and error over λ, and the L-curve, with the choice of every rule.

    Evidence and risk are drawn above their least values.
    """
    figure = new_figure(7.4)
    panels = figure.subplots(3, 2)
    panels[2, 1].remove()
    for axes, (title, draw), letter in zip(panels.flat, PANELS, "abcde", strict=False):
        axes.set_title(f"({letter}) {title}", fontsize=TEXT_POINT, loc="left")
        draw(axes, tuned)
    title = f"{tuned.subject.recording}, frame {tuned.subject.frame}: {tuned.subject.name}"
    figure.suptitle(title, fontsize=TEXT_POINT + 1)
    look: dict[str, Any] = {"fontsize": SMALL_POINT, "frameon": False, "ncols": 3}
    figure.legend(*panels[2, 0].get_legend_handles_labels(), loc="outside lower center", **look)
    return figure


def _label(tuned: Tuned, what: str, name: str) -> str:
    """Return a label with its unit."""
    unit = tuned.subject.units.get(what, "1")
    return f"{name} [{unit.replace('^2', '²').replace('ohm', 'Ω').replace('percent', '%').replace('/', ' / ')}]"


def _labels(tuned: Tuned) -> tuple[str, str]:
    scaled = "/s²" if tuned.subject.noisy else ""
    return _label(tuned, "misfit", f"misfit ρ{scaled}"), _label(tuned, "penalty", "penalty η")


def _over_weight(axes: Axes, tuned: Tuned, label: str) -> Any:
    """Draw the axis of λ with every choice; return λ at all points."""
    weights, subject = tuned.curves.values("weight"), tuned.subject
    axes.set_xscale("log")
    axes.set_xlim(weights[0] / 1.6, weights[-1] * 1.6)
    axes.xaxis.set_major_locator(LogLocator(numticks=9))
    axes.xaxis.set_minor_locator(NullLocator())
    dressed(axes, _label(tuned, "weight", f"weight λ of {term_kind(subject.cost.terms[subject.penalty])}"), label)
    for choice in tuned.choices:
        if choice.weight is not None:
            look, wide = LOOKS[choice.rule], 1.6 if choice.in_use else 0.9
            axes.axvline(choice.weight, color=look["color"], ls=look["ls"], lw=wide, alpha=0.9, zorder=1.5)
    return weights


def _above_least(name: str, label: str) -> Callable[[Axes, Tuned], None]:
    """Return a function that draws a criterion above its least value, which a dot marks."""

    def draw(axes: Axes, tuned: Tuned) -> None:
        values = tuned.curves.values(name)
        weights = _over_weight(axes, tuned, _label(tuned, name, f"{label} − least"))
        if not np.isfinite(values).any():
            _words_instead(axes, "not known here")
            return
        above, least = values - np.nanmin(values), int(np.nanargmin(values))
        above[least] = np.min(above, where=above > 0, initial=np.nanmax(above))
        axes.plot(weights, above, **LINE)
        _logarithmic(axes.yaxis)
        axes.plot(weights[least], axes.get_ylim()[0], "o", color="black", ms=4, clip_on=False, zorder=3)

    return draw


def _words_instead(axes: Axes, words: str) -> None:
    look: dict[str, Any] = {"ha": "center", "va": "center", "backgroundcolor": "white"}
    axes.text(0.5, 0.5, words, transform=axes.transAxes, fontsize=TEXT_POINT, **look)
    axes.set_yscale("linear")
    axes.set_yticks([])


def _misfit(axes: Axes, tuned: Tuned) -> None:
    """Draw ρ and η on two axes."""
    misfit, penalty = _labels(tuned)
    weights = _over_weight(axes, tuned, misfit)
    axes.plot(weights, tuned.curves.values("misfit"), **LINE)
    if tuned.subject.noisy:
        axes.axhline(tuned.subject.count, color="0.4", lw=0.8, ls=":")
        look: dict[str, Any] = {"fontsize": SMALL_POINT, "va": "bottom", "color": "0.3"}
        axes.text(0.02, tuned.subject.count, "number of readings", transform=axes.get_yaxis_transform(), **look)
    right = axes.twinx()
    right.tick_params(labelsize=SMALL_POINT, which="both", colors=PENALTY)
    right.set_ylabel(f"{penalty} (dashed)", fontsize=TEXT_POINT, color=PENALTY)
    right.plot(weights, tuned.curves.values("penalty"), **LINE | {"color": PENALTY, "ls": "--"})
    _logarithmic(axes.yaxis, right.yaxis)


def _error(axes: Axes, tuned: Tuned) -> None:
    """Draw the true and the expected error."""
    values, risk = (tuned.curves.values(name) for name in ("error", "risk"))
    free = tuned.subject.data.measured.size - tuned.curves.values("bound_cells")
    expected = np.sqrt(np.maximum(risk, 0) / np.maximum(free, 1))
    weights = _over_weight(axes, tuned, "rms error of log r")
    if np.isfinite(values).any():
        axes.plot(weights, values, label="true", **LINE)
    if np.any(expected > 0):
        look = LINE | {"color": "0.5", "lw": 1.0, "label": "√(risk/cells)"}
        axes.plot(weights, np.where(expected > 0, expected, np.nan), **look)
    if not axes.get_legend_handles_labels()[0]:
        _words_instead(axes, "needs the truth, or the noise of the readings")
        return
    _logarithmic(axes.yaxis)
    axes.legend(fontsize=SMALL_POINT, edgecolor="none", framealpha=0.9, loc="best")


def _l_curve(axes: Axes, tuned: Tuned) -> None:
    misfit, penalty = _labels(tuned)
    dressed(axes, misfit, penalty)
    axes.plot(tuned.curves.values("misfit"), tuned.curves.values("penalty"), **LINE)
    for choice in tuned.choices:
        point = None if choice.weight is None else tuned.curves.at(choice.weight)
        place = ([], []) if point is None else ([point.misfit], [point.penalty])
        look = LOOKS[choice.rule] | {"lw": 1.6 if choice.in_use else 0.9, "ms": 5 if choice.rule != "best" else 8}
        excess = "" if choice.excess is None or choice.rule == "best" else f", error × {choice.excess:.3g}"
        text = "none" if choice.weight is None else f"{choice.weight:.2g}{excess}"
        name = f"{look.pop('name', choice.rule)}{' (in use)' if choice.in_use else ''}: {text}"
        axes.plot(*place, mec="white", mew=0.6, zorder=3, label=name, **look)
    _logarithmic(axes.xaxis, axes.yaxis)


def _logarithmic(*axes: Axis) -> None:
    """Set logarithmic scales with ticks at powers of ten, or at 1, 2, 5 within two decades."""
    for axis in axes:
        (axis.axes.set_xscale if isinstance(axis, XAxis) else axis.axes.set_yscale)("log")
        low, high = axis.get_view_interval()
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 100 * low else (1.0,), numticks=8))
        axis.set_major_formatter(LogFormatterSciNotation(minor_thresholds=(np.inf, np.inf)))
        axis.set_minor_locator(NullLocator())


PANELS: Sequence[tuple[str, Callable[[Axes, Tuned], None]]] = (
    ("evidence", _above_least("evidence", "−2 log evidence")),
    ("expected error, Σ(log r̂ − log r)²", _above_least("risk", "risk")),
    ("misfit and penalty", _misfit),
    ("error of the estimate", _error),
    ("L-curve", _l_curve),
)


def tuned(case: Case) -> list[Tuned] | str:
    """Tune a case with one penalty, or return why it cannot be tuned.

    Raises InputError if a rule requires an unknown noise.
    """
    recording = Recording.load(case.path)
    frames = 2 if case.estimator.relative else 1
    reason = why_not(case.estimator, frames * recording.scene.panel.crossings)
    if reason is not None:
        return reason
    subject = WeightSubject.of(case, recording)
    if subject is None:
        return "too little was read of every measured frame"
    cases = tune(subject)
    return [cases] if any(point.solved for point in cases.curves.points) else "it was solved for no weight"


def weight_rows(cases: study.Cases[Tuned]) -> list[study.Row]:
    """Return a row for every case and rule."""
    return [_row(tuned.subject, choice) for tuned in cases.measured for choice in tuned.choices]


def _row(subject: WeightSubject, choice: Choice) -> study.Row:
    return study.Row(
        recording=subject.recording,
        estimator=subject.name,
        frame=subject.frame,
        rule=choice.rule,
        in_use=int(choice.in_use),
        weight=choice.weight,
        weight_unit=subject.units["weight"],
        rms_log_error=choice.error,
        over_best=choice.excess,
    )


SCREEN: study.Screen = {
    "recording": "{recording}",
    "estimator": "{estimator}",
    "rule": "{rule}",
    "in use": lambda row: "*" * row.in_use,
    "λ": lambda row: study.text_of(row.weight, ".3g") or "none",
    "unit of λ": "{weight_unit}",
    "true error": "{rms_log_error:.4f}",
    "over the best": "{over_best:.3f}",
}


def _groups(cases: study.Cases[Tuned]) -> Iterator[study.RecordGroup]:
    """Yield the groups /entry/<recording>/<estimator>, with the curves, and their subgroups `choices`."""
    for tuned in cases.measured:
        subject, path = tuned.subject, f"{tuned.subject.recording}/{tuned.subject.name}"
        known = {"frame": subject.frame, "readings": subject.count, "noise_known": int(subject.noisy)}
        signal = "risk"
        yield study.RecordGroup(path, tuned.curves.points, signal, "weight", subject.units, known)
        yield study.RecordGroup(f"{path}/choices", tuned.choices, "weight", units=subject.units)


STUDY: study.Study[Run, study.Cases[Tuned]] = study.Study(
    "tune",
    "cases",
    "tune.yaml",
    read_run,
    lambda run, on_step: study.of_cases(tuned, run, on_step, "tune"),
    rows=weight_rows,
    screen=SCREEN,
    form="tune/3",
    records=_groups,
    figures=lambda cases: {
        re.sub(r"[^\w.@=,+-]", "_", f"tune_{tuned.subject.recording}_{tuned.subject.name}"): weights_figure(tuned)
        for tuned in cases.measured
    },
    left_out=lambda cases: cases.left_out,
)
