"""Pictures of results; nothing here solves anything."""

from lampest.report.plots.contours import contours, save
from lampest.report.plots.results import plot_results

__all__ = ["contours", "plot_results", "save"]
