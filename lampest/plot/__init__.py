"""Pictures of results; nothing here solves anything."""

from lampest.plot.contours import contours, plot_results, save

__all__ = ["contours", "plot_results", "save"]
