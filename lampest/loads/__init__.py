"""What presses or sucks on a panel: response curve, pressure, shapes, recognition."""
