"""Files and what every room needs of them: input errors, whole files, HDF5, YAML documents, sweeps, unions by kind."""
