"""Recordings: their files, imports, boards and simulations.

Also their conversion to readings of a network.
"""
