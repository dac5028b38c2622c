"""The real numeric arrays of MATLAB's .mat files of version 7.3, which are HDF5."""

from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lampest.files import hdf5
from lampest.files.errors import InputError

MOST_AXES = 3


def arrays_of_level_7(path: Path) -> dict[str, NDArray[Any]]:
    """Name → array in MATLAB's shape (HDF5 has its axes in reverse); texts, structures and cells are left out.

    Raises InputError where the file is no HDF5, or an array is damaged or claims what it does not hold.
    """
    arrays = {}
    try:
        with hdf5.existing_file(path) as file:
            for name in hdf5.child_datasets(file, "/"):
                dataset = file[name]
                kind = hdf5.read_attribute(file, f"/{name}", "MATLAB_class")
                if dataset.dtype.kind not in "iuf" or kind == "char" or not 1 <= len(dataset.shape or ()) <= MOST_AXES:
                    continue
                if hdf5.read_attribute(file, f"/{name}", "MATLAB_empty"):
                    continue
                arrays[name] = hdf5.read_array(file, f"/{name}", len(dataset.shape)).T
    except InputError as error:
        raise InputError(f"{error}; save it with the option -v7 instead") from error
    return arrays
