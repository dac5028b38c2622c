"""Figure of the curves over a penalty's weight, with the choice of every rule."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from docs.studies.weight_curves import Curves
from lampest.cost.terms import term_kind
from lampest.panel.panel import Array
from lampest.report.plots.style import SMALL_POINT, TEXT_POINT, dressed, new_figure

LOOKS: dict[str, dict[str, Any]] = {
    "risk": {"color": "#0072B2", "ls": "-", "marker": "o"},
    "evidence": {"color": "#D55E00", "ls": "--", "marker": "s"},
    "Morozov": {"color": "#CC79A7", "ls": ":", "marker": "^"},
    "L-curve": {"color": "#E69F00", "ls": "-.", "marker": "v"},
    "given": {"color": "#7A5230", "ls": "-", "marker": "P", "name": "given in the file"},
    "best": {"color": "black", "ls": "-", "marker": "*", "name": "best in hindsight"},
}
PENALTY = "#56738C"  # the colour of its axis


def weights_figure(curves: Curves) -> Figure:
    """Draw evidence, risk, misfit, penalty and error over λ, and the L-curve.

    The choice of every rule is drawn, too. Evidence and risk are drawn above their least values.
    """
    subject = curves.subject
    count = curves.subject.count
    units = {
        name: unit.replace("^2", "²")
        .replace("ohm", "Ω")
        .replace("percent", "%")
        .replace("/", " / ")
        for name, unit in subject.units.items()
    }
    misfit = f"misfit ρ{'/s²' if subject.data.noise_known else ''} [{units['misfit']}]"
    penalty = f"penalty η [{units['penalty']}]"
    free = subject.data.measured.size - curves.values("bound_cells")
    expected = np.sqrt(np.maximum(curves.values("risk"), 0) / np.maximum(free, 1))
    noise = (
        {"number of readings": np.full(len(free), float(count))} if subject.data.noise_known else {}
    )
    panels: list[tuple[str, str, dict[str, Array]]] = [
        ("evidence", "−2 log evidence − least [1]", {"": _above_least(curves.values("evidence"))}),
        (
            "expected error, Σ(log r̂ − log r)²",
            "risk − least [1]",
            {"": _above_least(curves.values("risk"))},
        ),
        ("misfit and penalty", misfit, {"misfit": curves.values("misfit"), **noise}),
        (
            "error of the estimate",
            "rms error of log r",
            {"true": curves.values("error"), "√(risk/cells)": expected},
        ),
    ]
    figure = new_figure(7.4)
    grid = figure.subplots(3, 2)
    grid[2, 1].remove()
    weight = (
        f"weight λ of {term_kind(subject.search.cost.terms[subject.penalty])} [{units['weight']}]"
    )
    for axes, (_, label, lines) in zip(grid.flat, panels, strict=False):
        dressed(axes, weight, label)
        _over_weight(axes, curves, lines)
    right = grid[1, 0].twinx()
    right.tick_params(labelsize=SMALL_POINT, which="both", colors=PENALTY)
    right.set_ylabel(f"{penalty} (dashed)", fontsize=TEXT_POINT, color=PENALTY)
    right.plot(curves.values("weight"), curves.values("penalty"), "--", color=PENALTY, lw=1.3)
    right.set_yscale("log")
    dressed(grid[2, 0], misfit, penalty)
    _l_curve(grid[2, 0], curves)
    for axes, (title, *_), letter in zip(grid.flat, [*panels, ("L-curve",)], "abcde", strict=False):
        axes.set_title(f"({letter}) {title}", fontsize=TEXT_POINT, loc="left")
    title = f"{subject.case.recording}, frame {subject.frame}: {subject.case.name}"
    figure.suptitle(title, fontsize=TEXT_POINT + 1)
    look: dict[str, Any] = {"fontsize": SMALL_POINT, "frameon": False, "ncols": 3}
    figure.legend(*grid[2, 0].get_legend_handles_labels(), loc="outside lower center", **look)
    return figure


def _above_least(values: Array) -> Array:
    """Return values above the least one, which stands at the next larger one."""
    above = values - np.nanmin(values, initial=np.inf)
    above[above == 0] = np.min(above, where=above > 0, initial=np.inf)
    return above


def _over_weight(axes: Axes, curves: Curves, lines: dict[str, Array]) -> None:
    """Draw lines by their names over λ, with a vertical line for every choice."""
    weights = curves.values("weight")
    axes.set(xscale="log", yscale="log", xlim=(weights[0] / 1.6, weights[-1] * 1.6))
    axes.xaxis.set_major_locator(LogLocator(numticks=9))
    axes.xaxis.set_minor_locator(NullLocator())
    known = {
        name: values for name, values in lines.items() if np.any(np.isfinite(values) & (values > 0))
    }
    for (name, values), colour in zip(known.items(), ("black", "0.5"), strict=False):
        axes.plot(
            weights, np.where(values > 0, values, np.nan), color=colour, lw=1.2, label=name or None
        )
    if not known:
        look: dict[str, Any] = {
            "ha": "center",
            "transform": axes.transAxes,
            "backgroundcolor": "white",
        }
        axes.text(
            0.5, 0.5, "needs the truth, or the noise of the readings", fontsize=TEXT_POINT, **look
        )
    if any(known):
        axes.legend(fontsize=SMALL_POINT, edgecolor="none", framealpha=0.9, loc="best")
    for choice in curves.choices:
        if choice.weight is not None:
            wide = 1.6 if choice.in_use else 0.9
            style = LOOKS[choice.rule]
            axes.axvline(
                choice.weight, color=style["color"], ls=style["ls"], lw=wide, alpha=0.9, zorder=1.5
            )


def _l_curve(axes: Axes, curves: Curves) -> None:
    """Draw penalty over misfit, with a mark for every choice."""
    axes.set(xscale="log", yscale="log")
    axes.plot(curves.values("misfit"), curves.values("penalty"), color="black", lw=1.3)
    for choice in curves.choices:
        point = None if choice.weight is None else curves.at(choice.weight)
        place = ([], []) if point is None else ([point.misfit], [point.penalty])
        look = LOOKS[choice.rule] | {
            "lw": 1.6 if choice.in_use else 0.9,
            "ms": 5 if choice.rule != "best" else 8,
        }
        excess = (
            ""
            if choice.excess is None or choice.rule == "best"
            else f", error × {choice.excess:.3g}"
        )
        text = "none" if choice.weight is None else f"{choice.weight:.2g}{excess}"
        name = f"{look.pop('name', choice.rule)}{' (in use)' if choice.in_use else ''}: {text}"
        axes.plot(*place, mec="white", mew=0.6, zorder=3, label=name, **look)
