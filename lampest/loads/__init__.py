"""Loads on a panel: response curve, pressure, shapes, recognition."""
