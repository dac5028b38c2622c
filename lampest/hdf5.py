"""HDF5 as lampest writes it: whole or not at all, readable by old libraries, fixed-length ASCII, units on everything."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from lampest.errors import InputError

MOST_VALUES = 200_000_000


@contextmanager
def new_file(path: Path) -> Iterator[h5py.File]:
    """A file that appears under its name only when it is complete and on the disk.

    Raises InputError where the folder cannot be written or the disk is full; nothing is left behind then.
    """
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with h5py.File(unfinished, "w") as file:
            yield file
        with open(unfinished, "rb") as handle:
            os.fsync(handle.fileno())
        os.replace(unfinished, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from error
    finally:
        unfinished.unlink(missing_ok=True)


@contextmanager
def existing_file(path: Path) -> Iterator[h5py.File]:
    """A file opened for reading. Raises InputError where it is missing, no HDF5 file, truncated or damaged."""
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        with h5py.File(path, "r") as file:
            yield file
    except (OSError, RuntimeError, KeyError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a readable HDF5 file ({' '.join(str(error).split())})") from error


def ascii_array(values: Any) -> Any:
    """Text as fixed-length ASCII; other signs are written as '?'."""
    if isinstance(values, str):
        return np.bytes_(values.encode("ascii", "replace"))
    return np.array([value.encode("ascii", "replace") for value in values], dtype="S")


def set_attributes(node: Any, **attributes: Any) -> None:
    """Attributes with text as fixed-length ASCII."""
    for name, value in attributes.items():
        node.attrs[name] = ascii_array(value) if isinstance(value, str | list) else value


def write_dataset(
    group: h5py.Group, name: str, data: Any, units: str, long_name: str, scales: tuple[str, ...] = ()
) -> None:
    """One dataset with its units, its name in words, and dimension scales from the same group ('' for none)."""
    data = np.asarray(data)
    packed = {"compression": "gzip", "shuffle": True, "fletcher32": True} if data.size > 64 else {}
    dataset = group.create_dataset(name, data=data, **packed)
    set_attributes(dataset, units=units, long_name=long_name)
    for axis, scale in enumerate(scales):
        if scale:
            dataset.dims[axis].attach_scale(group[scale])


def write_scale(group: h5py.Group, name: str, data: Any, units: str, long_name: str) -> None:
    """An axis: a one-dimensional dataset that others attach."""
    write_dataset(group, name, data, units, long_name)
    group[name].make_scale(name)


def write_text(group: h5py.Group, name: str, text: str) -> None:
    """A text as a fixed-length ASCII scalar."""
    group.create_dataset(name, data=ascii_array(text))


def read_array(file: h5py.File, path: str, dimensions: int) -> Any:
    """A numeric dataset of that many dimensions. Raises InputError where it is absent, of another shape, or absurdly large."""
    dataset = file.get(path)
    if not isinstance(dataset, h5py.Dataset):
        raise InputError(f"{file.filename}: {path} is missing")
    if dataset.ndim != dimensions or dataset.dtype.kind not in "iuf":
        raise InputError(f"{file.filename}: {path} must be numeric with {dimensions} dimensions")
    if dataset.size > MOST_VALUES:
        raise InputError(f"{file.filename}: {path} claims {dataset.size} values; more than {MOST_VALUES} are not read")
    return dataset[()]


def read_text(file: h5py.File, path: str) -> str:
    """A scalar text. Raises InputError where it is absent or no text."""
    dataset = file.get(path)
    if not isinstance(dataset, h5py.Dataset) or dataset.shape != () or dataset.dtype.kind not in "SO":
        raise InputError(f"{file.filename}: {path} is missing or no text")
    value = dataset[()]
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
