"""Attacks on lampest: hostile files, names, values and places. `python -m tests.attack` tells which of them held."""
