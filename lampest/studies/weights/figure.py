"""What `weight: auto` did: everything over the weight of the penalty, and where every rule stands."""

import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import LogFormatterSciNotation, LogLocator, NullLocator

from lampest.report.plots.style import SMALL_POINT, TEXT_POINT, new_figure
from lampest.studies.weights.choices import Tuned
from lampest.studies.weights.curves import squared

LOOKS: dict[str, dict[str, Any]] = {
    "risk": {"color": "#0072B2", "ls": "-", "marker": "o"},
    "evidence": {"color": "#D55E00", "ls": (0, (5, 1.5)), "marker": "s"},
    "press": {"color": "#009E73", "ls": (0, (4, 1.2, 1, 1.2)), "marker": "D", "name": "PRESS"},
    "Morozov": {"color": "#CC79A7", "ls": (0, (1, 1)), "marker": "^"},
    "L-curve": {"color": "#E69F00", "ls": (0, (3, 1, 1, 1, 1, 1)), "marker": "v"},
    "given": {"color": "#7A5230", "ls": (0, (8, 2)), "marker": "P", "name": "given in the file"},
    "best": {"color": "black", "ls": "-", "marker": "*", "name": "best in hindsight"},
}
PENALTY = "#56738C"  # the colour of its axis


def file_name(one: Tuned) -> str:
    """<recording>_<estimator> as part of a file's name."""
    return re.sub(r"[^\w.@=,+-]", "_", f"{one.subject.recording}_{one.subject.name}")


def weights_figure(one: Tuned) -> Figure:
    """Five panels over log λ, and the L-curve; a line, or a sign, for the choice of every rule.

    Evidence, risk and PRESS stand above their least values; what has no known noise or truth says so.
    """
    figure = new_figure(7.4)
    panels = figure.subplots(3, 2)
    for axes, (title, draw), letter in zip(panels.flat, PANELS, "abcdef", strict=True):
        axes.tick_params(labelsize=SMALL_POINT, which="both")
        axes.grid(True, which="major", color="0.92", lw=0.5)
        axes.set_axisbelow(True)
        axes.set_title(f"({letter}) {title}", fontsize=TEXT_POINT, loc="left")
        draw(axes, one)
    title = f"{one.subject.recording}, frame {one.subject.frame}: {one.subject.name}"
    figure.suptitle(title, fontsize=TEXT_POINT + 1)
    handles, labels = panels[2, 1].get_legend_handles_labels()
    look: dict[str, Any] = {"fontsize": SMALL_POINT, "frameon": False, "ncols": 3}
    figure.legend(handles, labels, loc="outside lower center", **look)
    return figure


def _shown(unit: str) -> str:
    """A unit in print."""
    return unit.replace("^2", "²").replace("ohm", "Ω").replace("percent", "%").replace("/", " / ")


def _misfit_label(one: Tuned) -> str:
    subject = one.subject
    return f"misfit {'ρ/s² [1]' if subject.noisy else f'ρ [{_shown(squared(subject.misfit_unit))}]'}"


def _penalty_label(one: Tuned) -> str:
    return f"penalty η [{_shown(squared(one.subject.penalty_unit))}]"


def _over_weight(axes: Axes, one: Tuned, label: str, values: Any = None) -> None:
    """The axis of λ with every choice, and one curve over it, or several by their axis scale."""
    weights = one.curves.values("weight")
    axes.set_xscale("log")
    axes.set_xlim(weights[0] / 1.6, weights[-1] * 1.6)
    axes.xaxis.set_major_locator(LogLocator(numticks=9))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xlabel(f"weight λ of {one.subject.kind} [{_shown(one.subject.weight_unit)}]", fontsize=TEXT_POINT)
    axes.set_ylabel(label, fontsize=TEXT_POINT)
    for choice in one.choices:
        if choice.weight is not None:
            look, wide = LOOKS[choice.rule], 1.6 if choice.in_use else 0.9
            axes.axvline(choice.weight, color=look["color"], ls=look["ls"], lw=wide, alpha=0.9, zorder=1.5)
    if values is not None:
        axes.plot(weights, values, color="black", lw=1.3, zorder=2.5)


def _above_least(name: str, label: str) -> Callable[[Axes, Tuned], None]:
    """A panel of a rule's function, less its least value, on a logarithmic scale that holds zero."""

    def draw(axes: Axes, one: Tuned) -> None:
        values = one.curves.values(name)
        unit = squared(one.subject.misfit_unit) if name == "press" else "1"
        label_with_unit = f"{label} [{_shown(unit)}]"
        seen = np.isfinite(values)
        if not seen.any():
            _over_weight(axes, one, label_with_unit)
            _words_instead(axes, "needs the noise of the readings")
            return
        above = values - values[seen].min()
        positive = above[seen & (above > 0)]
        small, large = np.quantile(positive, (0.2, 1.0)) if len(positive) else (1.0, 1.0)
        first, last = int(np.floor(np.log10(small))), int(np.floor(np.log10(large)))
        axes.set_yscale("symlog", linthresh=10.0**first)
        _over_weight(axes, one, label_with_unit, above)
        axes.set_ylim(0, 1.5 * large)
        powers = range(first, last + 1, 1 + (last - first) // 6)
        axes.set_yticks([0.0, *(10.0**power for power in powers)], minor=False)
        axes.yaxis.set_minor_locator(NullLocator())
        least = one.curves.values("weight")[int(np.nanargmin(values))]
        axes.plot(least, 0, "o", color="black", ms=4, clip_on=False, zorder=3)

    return draw


def _words_instead(axes: Axes, words: str) -> None:
    """Words in place of a curve."""
    text = axes.text(0.5, 0.5, words, transform=axes.transAxes, ha="center", va="center", fontsize=TEXT_POINT)
    text.set_path_effects([withStroke(linewidth=3, foreground="white")])
    axes.set_yscale("linear")
    axes.set_yticks([])


def _misfit(axes: Axes, one: Tuned) -> None:
    """ρ and η, on two axes."""
    axes.set_yscale("log")
    _over_weight(axes, one, _misfit_label(one), one.curves.values("misfit"))
    if one.subject.noisy:
        count = one.subject.count
        axes.axhline(count, color="0.4", lw=0.8, ls=":")
        text: dict[str, Any] = {"fontsize": SMALL_POINT, "va": "bottom", "ha": "left", "color": "0.3"}
        note = axes.text(0.02, count * 1.2, "number of readings", transform=axes.get_yaxis_transform(), **text)
        note.set_path_effects([withStroke(linewidth=2, foreground="white")])
    other = axes.twinx()
    other.set_yscale("log")
    other.tick_params(labelsize=SMALL_POINT, which="both", colors=PENALTY)
    other.set_ylabel(f"{_penalty_label(one)} (dashed)", fontsize=TEXT_POINT, color=PENALTY)
    look: dict[str, Any] = {"color": PENALTY, "ls": "--", "lw": 1.3, "zorder": 2.5}
    other.plot(one.curves.values("weight"), one.curves.values("penalty"), **look)
    _few_ticks(axes.yaxis)
    _few_ticks(other.yaxis)


def _error(axes: Axes, one: Tuned) -> None:
    """The true error, and the expected one."""
    axes.set_yscale("log")
    weights, values, risk = (one.curves.values(name) for name in ("weight", "error", "risk"))
    free = one.subject.data.measured.size - one.curves.values("bound_cells")
    expected = np.sqrt(np.maximum(risk, 0) / np.maximum(free, 1))
    _over_weight(axes, one, "rms error of log r")
    if np.isfinite(values).any():
        axes.plot(weights, values, color="black", lw=1.3, zorder=2.5, label="true")
    if np.any(expected > 0):
        look: dict[str, Any] = {"color": "0.5", "lw": 1.0, "zorder": 2.5, "label": "√(risk/cells)"}
        axes.plot(weights, np.where(expected > 0, expected, np.nan), **look)
    if not axes.get_legend_handles_labels()[0]:
        _words_instead(axes, "needs the truth, or the noise of the readings")
        return
    _few_ticks(axes.yaxis)
    axes.legend(fontsize=SMALL_POINT, edgecolor="none", framealpha=0.9, loc="best")


def _l_curve(axes: Axes, one: Tuned) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel(_misfit_label(one).replace(" [1]", ""), fontsize=TEXT_POINT)
    axes.set_ylabel(_penalty_label(one), fontsize=TEXT_POINT)
    axes.plot(one.curves.values("misfit"), one.curves.values("penalty"), color="black", lw=1.3, zorder=2)
    for choice in one.choices:
        point = None if choice.weight is None else one.curves.at(choice.weight)
        place = ([], []) if point is None else ([point.misfit], [point.penalty])
        look = LOOKS[choice.rule] | {"lw": 1.6 if choice.in_use else 0.9, "ms": 5 if choice.rule != "best" else 8}
        excess = "" if choice.excess is None or choice.rule == "best" else f", error × {choice.excess:.3g}"
        text = "none" if choice.weight is None else f"{choice.weight:.2g}{excess}"
        name = f"{look.pop('name', choice.rule)}{' (in use)' if choice.in_use else ''}: {text}"
        axes.plot(*place, mec="white", mew=0.6, zorder=3, label=name, **look)
    _few_ticks(axes.xaxis)
    _few_ticks(axes.yaxis)


def _few_ticks(axis: Axis) -> None:
    """Logarithmic ticks at 1, 2, 5 where there are few powers of ten, else at those."""
    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 100 * low else (1.0,), numticks=8))
    axis.set_major_formatter(LogFormatterSciNotation(minor_thresholds=(np.inf, np.inf)))
    axis.set_minor_locator(NullLocator())


PANELS: Sequence[tuple[str, Callable[[Axes, Tuned], None]]] = (
    ("evidence", _above_least("evidence", "−2 log evidence − least")),
    ("expected error, Σ(log r̂ − log r)²", _above_least("risk", "risk − least")),
    ("prediction from all other readings", _above_least("press", "PRESS − least")),
    ("misfit and penalty", _misfit),
    ("error of the estimate", _error),
    ("L-curve", _l_curve),
)
