"""What `weight: auto` did: everything over the weight of the penalty, and where every rule stands."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import LogFormatterSciNotation, LogLocator, NullLocator

from lampest.panel.panel import Array
from lampest.report.plots.style import SMALL_POINT, TEXT_POINT, new_figure, save
from lampest.studies.weights.choices import Choice, Tuned
from lampest.studies.weights.subject import squared

LOOKS: dict[str, dict[str, Any]] = {
    "risk": {"color": "#0072B2", "ls": "-", "marker": "o"},
    "evidence": {"color": "#D55E00", "ls": (0, (5, 1.5)), "marker": "s"},
    "press": {"color": "#009E73", "ls": (0, (4, 1.2, 1, 1.2)), "marker": "D"},
    "Morozov": {"color": "#CC79A7", "ls": (0, (1, 1)), "marker": "^"},
    "L-curve": {"color": "#E69F00", "ls": (0, (3, 1, 1, 1, 1, 1)), "marker": "v"},
    "given": {"color": "#7A5230", "ls": (0, (8, 2)), "marker": "P"},
    "best": {"color": "black", "ls": "-", "marker": "*"},
}
NAMES = {"press": "PRESS", "given": "given in the file", "best": "best in hindsight"}


def plot_weights(tuned: Sequence[Tuned], folder: Path) -> list[Path]:
    """Draw every case into tune_<recording>_<estimator>.png in a folder; returns the files.

    Raises InputError where they cannot be written.
    """
    files = []
    for one in tuned:
        name = re.sub(r"[^\w.@=,+-]", "_", f"tune_{one.subject.recording}_{one.subject.name}.png")
        save(tune_figure(one), folder / name)
        files.append(folder / name)
    return files


def tune_figure(one: Tuned) -> Figure:
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


def _over_weight(axes: Axes, one: Tuned, label: str) -> None:
    """The axis of λ with every choice, and what stands over it."""
    axes.set_xscale("log")
    weights = one.curves.values("weight")
    axes.set_xlim(weights[0] / 1.6, weights[-1] * 1.6)
    axes.xaxis.set_major_locator(LogLocator(numticks=9))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xlabel(f"weight λ of {one.subject.kind} [{_shown(one.subject.weight_unit)}]", fontsize=TEXT_POINT)
    axes.set_ylabel(label, fontsize=TEXT_POINT)
    for choice in _placed(one):
        look = LOOKS[choice.rule]
        wide = 1.6 if choice.in_use else 0.9
        axes.axvline(choice.weight, color=look["color"], ls=look["ls"], lw=wide, alpha=0.9, zorder=1.5)


def _shown(unit: str) -> str:
    """A unit in print."""
    return unit.replace("^2", "²").replace("ohm", "Ω").replace("percent", "%").replace("/", " / ")


def _placed(one: Tuned) -> list[Any]:
    return [choice for choice in one.choices if choice.weight is not None]


def _curve(axes: Axes, one: Tuned, values: Array, **look: Any) -> None:
    drawn: dict[str, Any] = {"color": "black", "lw": 1.3, "zorder": 2.5} | look
    axes.plot(one.curves.values("weight"), values, **drawn)


def _above_least(name: str, label: str) -> Callable[[Axes, Tuned], None]:
    """A panel of a rule's function, less its least value."""

    def draw(axes: Axes, one: Tuned) -> None:
        values = one.curves.values(name)
        unit = squared(one.subject.misfit_unit) if name == "press" else "1"
        _over_weight(axes, one, f"{label} [{_shown(unit)}]")
        seen = np.isfinite(values)
        if not seen.any():
            _say(axes, "needs the noise of the readings")
            return
        above = values - values[seen].min()
        positive = above[seen & (above > 0)]
        small, large = np.quantile(positive, (0.2, 1.0)) if len(positive) else (1.0, 1.0)
        first, last = int(np.floor(np.log10(small))), int(np.floor(np.log10(large)))
        axes.set_yscale("symlog", linthresh=10.0**first)
        _curve(axes, one, above)
        axes.set_ylim(0, 1.5 * large)
        powers = range(first, last + 1, 1 + (last - first) // 6)
        axes.set_yticks([0.0, *(10.0**power for power in powers)], minor=False)
        axes.yaxis.set_minor_locator(NullLocator())
        least = int(np.nanargmin(values))
        axes.plot(one.curves.values("weight")[least], 0, "o", color="black", ms=4, clip_on=False, zorder=3)

    return draw


def _say(axes: Axes, words: str) -> None:
    """Words in place of a curve."""
    text = axes.text(0.5, 0.5, words, transform=axes.transAxes, ha="center", va="center", fontsize=TEXT_POINT)
    text.set_path_effects([withStroke(linewidth=3, foreground="white")])
    axes.set_yscale("linear")
    axes.set_yticks([])


def _misfit(axes: Axes, one: Tuned) -> None:
    """ρ and η, on two axes."""
    subject = one.subject
    unit = "1" if subject.noisy else _shown(squared(subject.misfit_unit))
    _over_weight(axes, one, f"misfit {'ρ/s²' if subject.noisy else 'ρ'} [{unit}]")
    axes.set_yscale("log")
    _curve(axes, one, one.curves.values("misfit"))
    if subject.noisy:
        axes.axhline(subject.count, color="0.4", lw=0.8, ls=":")
        text: dict[str, Any] = {"fontsize": SMALL_POINT, "va": "bottom", "ha": "left", "color": "0.3"}
        note = axes.text(0.02, subject.count * 1.2, "number of readings", transform=axes.get_yaxis_transform(), **text)
        note.set_path_effects([withStroke(linewidth=2, foreground="white")])
    other = axes.twinx()
    other.set_yscale("log")
    other.tick_params(labelsize=SMALL_POINT, which="both", colors="#56738C")
    other.set_ylabel(
        f"penalty η [{_shown(squared(subject.penalty_unit))}] (dashed)", fontsize=TEXT_POINT, color="#56738C"
    )
    _curve(other, one, one.curves.values("penalty"), color="#56738C", ls="--")
    _labelled(axes.yaxis)
    _labelled(other.yaxis)


def _error(axes: Axes, one: Tuned) -> None:
    """The true error, and the expected one."""
    _over_weight(axes, one, "rms error of log r")
    risk = one.curves.values("risk")
    free = one.subject.data.measured.size - one.curves.values("bound_cells")
    expected = np.sqrt(np.maximum(risk, 0) / np.maximum(free, 1))
    axes.set_yscale("log")
    values = one.curves.values("error")
    if np.isfinite(values).any():
        _curve(axes, one, values, label="true")
    if np.any(expected > 0):
        _curve(axes, one, np.where(expected > 0, expected, np.nan), color="0.5", lw=1.0, label="√(risk/cells)")
    if not axes.get_legend_handles_labels()[0]:
        _say(axes, "needs the truth, or the noise of the readings")
        return
    _labelled(axes.yaxis)
    axes.legend(fontsize=SMALL_POINT, edgecolor="none", framealpha=0.9, loc="best")


def _l_curve(axes: Axes, one: Tuned) -> None:
    subject = one.subject
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel(
        f"misfit {'ρ/s²' if subject.noisy else f'ρ [{_shown(squared(subject.misfit_unit))}]'}", fontsize=TEXT_POINT
    )
    axes.set_ylabel(f"penalty η [{_shown(squared(subject.penalty_unit))}]", fontsize=TEXT_POINT)
    axes.plot(one.curves.values("misfit"), one.curves.values("penalty"), color="black", lw=1.3, zorder=2)
    for choice in one.choices:
        point = None if choice.weight is None else one.curves.at(choice.weight)
        place = ([], []) if point is None else ([point.misfit], [point.penalty])
        look = LOOKS[choice.rule] | {"lw": 1.6 if choice.in_use else 0.9, "ms": 5 if choice.rule != "best" else 8}
        axes.plot(*place, mec="white", mew=0.6, zorder=3, label=_label(choice), **look)
    _labelled(axes.xaxis)
    _labelled(axes.yaxis)


def _labelled(axis: Axis) -> None:
    """Logarithmic ticks at 1, 2, 5 where there are few powers of ten, else at those."""
    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 100 * low else (1.0,), numticks=8))
    axis.set_major_formatter(LogFormatterSciNotation(minor_thresholds=(np.inf, np.inf)))
    axis.set_minor_locator(NullLocator())


def _label(choice: Choice) -> str:
    name = NAMES.get(choice.rule, choice.rule) + (" (in use)" if choice.in_use else "")
    if choice.weight is None:
        return f"{name}: none"
    excess = "" if choice.excess is None or choice.rule == "best" else f", error × {choice.excess:.3g}"
    return f"{name}: {choice.weight:.2g}{excess}"


PANELS: Sequence[tuple[str, Callable[[Axes, Tuned], None]]] = (
    ("evidence", _above_least("evidence", "−2 log evidence − least")),
    ("expected error, Σ(log r̂ − log r)²", _above_least("risk", "risk − least")),
    ("prediction from all other readings", _above_least("press", "PRESS − least")),
    ("misfit and penalty", _misfit),
    ("error of the estimate", _error),
    ("L-curve", _l_curve),
)
