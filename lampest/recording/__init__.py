"""Recordings: files, imports, boards, simulations, and conversion to readings of a network."""
