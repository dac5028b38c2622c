"""Recordings: their files, imports, boards and simulations, and their conversion to readings of a network."""
