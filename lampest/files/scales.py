"""Dimension scales as the HDF5 library writes them, for many datasets of a group at once.

The library's own function writes the list of a scale's datasets anew for each of them, which is the square of their
number, and half of what a small case's results take.
"""

from collections.abc import Mapping
from functools import cache, lru_cache
from typing import Any

import h5py
import numpy as np
from h5py import h5a, h5d, h5r, h5s, h5t

# As the library lays out what it calls ds_list_t.
REFERENCE = np.dtype(
    {"names": ["dataset", "dimension"], "formats": [h5py.ref_dtype, "u4"], "offsets": [0, 8], "itemsize": 16}
)
LISTED, SERVED = b"DIMENSION_LIST", b"REFERENCE_LIST"


def attach_scales(group: h5py.Group, axes: Mapping[str, tuple[str, ...]]) -> None:
    """Attach to each dataset, by its path within the group, the scales of its axes there; '' for an axis without one.

    HDF5 Dimension Scale Specification, section 3: DIMENSION_LIST of a dataset names the scales of its axes,
    REFERENCE_LIST of a scale the datasets and axes that it serves. The datasets must have no scales yet.
    """
    place = group.id
    scales = {name: h5r.create(place, name.encode(), h5r.OBJECT) for names in axes.values() for name in names if name}
    serves: dict[str, list[tuple[Any, int]]] = {name: [] for name in scales}
    for path, names in axes.items():
        if not any(names):
            continue
        reference = h5r.create(place, path.encode(), h5r.OBJECT)
        listed = np.empty(len(names), dtype=h5py.vlen_dtype(h5py.ref_dtype))
        for axis, name in enumerate(names):
            listed[axis] = np.array([scales[name]] if name else [], dtype=h5py.ref_dtype)
            if name:
                serves[name].append((reference, axis))
        attribute = h5a.create(h5d.open(place, path.encode()), LISTED, _list_of_references(), _line(len(names)))
        attribute.write(listed)
    for name, served in serves.items():
        _append(h5d.open(place, name.encode()), served)


def _append(scale: h5d.DatasetID, served: list[tuple[Any, int]]) -> None:
    """Add what a scale serves to the list of it."""
    if h5a.exists(scale, SERVED):
        attribute = h5a.open(scale, SERVED)
        before = np.empty(attribute.shape, dtype=REFERENCE)
        attribute.read(before)
        served = [*map(tuple, before), *served]
        h5a.delete(scale, SERVED)
    attribute = h5a.create(scale, SERVED, _reference(), _line(len(served)))
    attribute.write(np.array(served, dtype=REFERENCE))


@cache
def _list_of_references() -> h5t.TypeID:
    return h5t.vlen_create(h5t.STD_REF_OBJ)


@cache
def _reference() -> h5t.TypeID:
    return h5t.py_create(REFERENCE, logical=True)


@lru_cache(maxsize=64)
def _line(length: int) -> h5s.SpaceID:
    return h5s.create_simple((length,))
