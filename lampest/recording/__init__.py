"""Recordings and the only way from file, board or simulation to readings."""
