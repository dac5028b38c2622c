"""Recordings: their files, imports, boards and simulations, and the only way from these to readings."""
