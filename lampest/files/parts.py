"""Concatenation of HDF5 groups from several files, dataset by dataset and part by part.

Parts bound the memory that a dataset takes.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from h5py import Dataset, File, Group

from lampest.files import checksums, hdf5
from lampest.files.checksums import BLOCKS, located, nodes_below, read_verified, verified_blocks

TIME = "time"  # axis along which parts are concatenated


class DatasetPlan(NamedTuple):
    """Plan of a concatenated dataset.

    Attributes
    ----------
    shape : tuple of int
        Shape of the dataset.
    packing : mapping
        Options of compression and checksums.
    dtype : dtype
    scales : tuple of str
        Paths of the scales of its axes.
    is_scale : bool
        Whether it is a scale itself.
    along : bool
        Whether its first axis is time.
    owner : Path
        Last file that contains it.
    """

    shape: tuple[int, ...]
    packing: Mapping[str, Any]
    dtype: Any
    scales: tuple[str, ...]
    is_scale: bool
    along: bool
    owner: Path


def join_parts(parts: Sequence[Path], target: Group, group: str) -> None:
    """Write the frames of one group of several files into a single group.

    The group of a single file is copied. Datasets without a time axis are those of the last file.
    Values that a part lacks, because it has no frame with them, are NaN, 0 or empty texts. Raises
    InputError if a file cannot be read.

    Parameters
    ----------
    parts : sequence of Path
        Files in temporal order.
    target : Group
        Group that is written.
    group : str
        Path of the group in the files.
    """
    # First pass: attributes, plans of all datasets, and the first frame of every part.
    plans: dict[str, DatasetPlan] = {}
    attributes: dict[str, dict[str, Any]] = {}
    begins = []
    for part in parts:
        with hdf5.existing_file(part) as file:
            begins.append(_lengths(plans))
            for path, node in _within(file, group):
                ties = ("DIMENSION_LIST", "REFERENCE_LIST", "CLASS", "NAME")  # of axes to datasets
                attributes[path] = {
                    name: node.attrs[name]
                    for name in node.attrs
                    if name not in ties and not name.startswith(BLOCKS)
                }
                if isinstance(node, Dataset):
                    plans[path] = _planned(node, part, plans.get(path))
                elif path:
                    target.require_group(path)
    # Create the concatenated datasets, then copy values part by part.
    joined = {path: plan for path, plan in plans.items() if plan.along and len(parts) > 1}
    for path, plan in joined.items():
        shape = (_lengths(plans)[path.split("/")[0]], *plan.shape[1:])
        fill = np.nan if plan.dtype.kind == "f" else None
        target.create_dataset(
            path, shape, plan.dtype, chunks=hdf5.chunk_of(shape), fillvalue=fill, **plan.packing
        )
    for part, begin in zip(parts, begins, strict=True):
        with hdf5.existing_file(part) as file:
            for path, node in _within(file, group):
                with located(file, f"{group}/{path}"):
                    if path in joined:
                        first = begin.get(path.split("/")[0], 0)
                        target[path][first : first + len(node)] = read_verified(node)
                    elif path in plans and plans[path].owner == part:
                        _copy(node, target, path)
    # Attributes and scales, once all datasets exist.
    for path, held in attributes.items():
        (target[path] if path else target).attrs.update(held)
        if path in plans and plans[path].is_scale:
            target[path].make_scale(path.rsplit("/", 1)[-1])
    for path, plan in plans.items():
        hdf5.attach_scales(
            target, {path: tuple(scale.removeprefix(f"{group}/") for scale in plan.scales)}
        )


def copy_group(source: Group, target: Group, name: str) -> None:
    """Copy a group of another file as it is stored, packed and with the digests of its values.

    The values are not read, so damage is copied as well; its digests show it.
    """
    h5py.h5o.copy(source.id, b".", target.id, name.encode())
    copied = target[name]
    # HDF5 copies references in attributes as empty ones: scales are attached anew. The few scales
    # name the datasets that use them, which takes less time than the axes of many datasets.
    paths = checksums.names_below(source)
    names = {h5py.h5o.open(source.id, path): path.decode() for path in paths}
    scales: dict[str, dict[int, str]] = {name: {} for name in names.values()}
    for node, scale in names.items():
        users = checksums.attribute(node, hdf5.USERS)
        if users is not None:
            h5py.h5a.delete(copied.id, hdf5.USERS.encode(), obj_name=scale.encode())
            for user, axis in users.tolist():
                scales[names[h5py.h5r.dereference(user, source.id)]][axis] = scale
    axes = {
        name: tuple(scales[name].get(axis, "") for axis in range(node.rank))
        for node, name in names.items()
        if scales[name]
    }
    hdf5.attach_scales(copied, axes)


def _copy(dataset: Dataset, target: Group, path: str) -> None:
    """Write a dataset's verified values into a new one, without attributes.

    The new one has the same type, layout and filters. HDF5's own copy without attributes overruns
    its memory where a header holds large ones, such as digests.
    """
    like = dataset.id.get_type(), dataset.id.get_space(), dataset.id.get_create_plist()
    copied = Dataset(h5py.h5d.create(target.id, path.encode(), *like))
    for place, values in verified_blocks(dataset):
        copied[place] = values


def _planned(dataset: Dataset, owner: Path, before: DatasetPlan | None) -> DatasetPlan:
    """Return the plan of a dataset extended by this part.

    Texts have the length of the longest one.
    """
    scales: tuple[str, ...] = ()
    if not dataset.is_scale:
        scales = tuple(str(dim[0].name) if len(dim) else "" for dim in dataset.dims)
    first_scale = dataset.name if dataset.is_scale else (*scales, "")[0]
    along = str(first_scale).endswith(f"/{TIME}")
    shape = tuple(dataset.shape)
    dtype = dataset.dtype
    packing = hdf5.PACKED if dataset.compression or not dataset.chunks else hdf5.UNPACKED
    if before is not None and along:
        shape = (before.shape[0] + shape[0], *shape[1:])
        packing = before.packing
        dtype = max(before.dtype, dtype, key=lambda kind: int(kind.itemsize))
    return DatasetPlan(shape, packing, dtype, scales, bool(dataset.is_scale), along, owner)


def _lengths(plans: Mapping[str, DatasetPlan]) -> dict[str, int]:
    """Return the number of frames so far by the first part of the path.

    An example of such a part is that of an estimator.
    """
    parts = ((path.split("/"), plan) for path, plan in plans.items())
    return {names[0]: plan.shape[0] for names, plan in parts if names[1:] == [TIME]}


def _within(file: File, group: str) -> Iterator[tuple[str, Any]]:
    """Yield (path relative to the group, node) of the group and of everything in it.

    Groups come before their members.
    """
    for path, node in nodes_below(file, group):
        yield path.removeprefix(group).lstrip("/"), node
