"""Pictures of results; nothing here solves anything. To add one: write its `Plot` into a file here, name it in PLOTS.

A package adds plots by naming them in the entry point group `lampest.plots`, a script by handing one to `plot_results`.
"""

from lampest.files.errors import InputError
from lampest.files.plugins import installed
from lampest.report.plots.certainty import CertaintyPlot
from lampest.report.plots.contours import ContourPlot
from lampest.report.plots.plot import Plot
from lampest.report.plots.pressure import PressurePlot

__all__ = ["PLOTS", "CertaintyPlot", "ContourPlot", "Plot", "PressurePlot", "plot_of"]
PLOTS: tuple[Plot, ...] = (ContourPlot(), CertaintyPlot(), PressurePlot())


def plot_of(kind: str) -> Plot:
    """The plot of that kind, of lampest or of an installed package. Raises InputError where there is none or two."""
    plots: tuple[Plot, ...] = (*PLOTS, *installed("lampest.plots", Plot))
    named = [plot for plot in plots if plot.kind == kind]
    if len(named) != 1:
        kinds = ", ".join(dict.fromkeys(plot.kind for plot in plots))
        raise InputError(f"there {'is no plot' if not named else 'are two plots'} '{kind}'; there are {kinds}")
    return named[0]
