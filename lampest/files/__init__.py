"""Foundations: input errors, atomic files, HDF5, YAML documents, sweeps, unions by kind.

They are the foundations of all packages.
"""
