"""Foundations of every room: input errors, whole files, HDF5, YAML documents, sweeps, unions by kind."""
