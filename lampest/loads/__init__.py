"""What presses or sucks on a panel: response curve, pressure, shapes and their footprints, recognition."""
