"""Pictures of results; nothing here solves anything."""

from lampest.plot.contours import contours, save
from lampest.plot.results import plot_results

__all__ = ["contours", "plot_results", "save"]
