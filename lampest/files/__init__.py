"""Foundations of all packages: input errors, atomic files, HDF5, YAML documents, sweeps, kinds."""
