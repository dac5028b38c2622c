"""Groups of HDF5 files from file to file, dataset by dataset and part by part, so that memory holds little of them."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np

from lampest.files import hdf5
from lampest.files.checksums import nodes_below

TIME = "time"  # the axis along which parts follow each other


class DatasetPlan(NamedTuple):
    """A dataset as it is to be.

    Attributes
    ----------
    length : int
        Of its chunks, packing : of these.
    scales : tuple of str
        The paths of its axes'.
    is_scale : bool
        Whether it is an axis itself.
    along : bool
        Whether its first axis is time.
    owner : Path
        The last file that has it.
    """

    shape: tuple[int, ...]
    length: int
    packing: Mapping[str, Any]
    dtype: Any
    scales: tuple[str, ...]
    is_scale: bool
    along: bool
    owner: Path


def join_parts(parts: Sequence[Path], target: h5py.Group, group: str) -> None:
    """Return one group of all frames from groups of which every file holds some; of one file, its group.

    Datasets that are not along time are the last one's. Values that a part lacks, because none of its frames could fill
    them, are NaN, 0 or an empty text. Raises InputError where a file cannot be read.
    """
    plans: dict[str, DatasetPlan] = {}
    attributes: dict[str, dict[str, Any]] = {}
    begins: list[dict[str, int]] = []
    for part in parts:
        with hdf5.existing_file(part) as file:
            begins.append(_lengths(plans))
            for path, node in _within(file, group):
                ties = ("DIMENSION_LIST", "REFERENCE_LIST", "CLASS", "NAME")  # of axes to datasets
                attributes[path] = {name: value for name, value in node.attrs.items() if name not in ties}
                if isinstance(node, h5py.Dataset):
                    plans[path] = _planned(node, part, plans.get(path))
                elif path:
                    target.require_group(path)
    joined = {path: plan for path, plan in plans.items() if plan.along and len(parts) > 1}
    for path, plan in joined.items():
        shape = (_lengths(plans)[path.split("/", 1)[0]], *plan.shape[1:])
        nothing, chunks = np.nan if plan.dtype.kind == "f" else None, (plan.length, *shape[1:])
        target.create_dataset(path, shape, plan.dtype, chunks=chunks, fillvalue=nothing, **plan.packing)
    for part, begin in zip(parts, begins, strict=True):
        with hdf5.existing_file(part) as file:
            for path, node in _within(file, group):
                if path in joined:
                    first = begin.get(path.split("/", 1)[0], 0)
                    _append(target[path], node, first)
                elif path in plans and plans[path].owner == part:
                    file.copy(node, target, path, without_attrs=True)
    for path, held in attributes.items():
        (target[path] if path else target).attrs.update(held)
        if path in plans and plans[path].is_scale:
            target[path].make_scale(path.rsplit("/", 1)[-1])
    for path, plan in plans.items():
        hdf5.attach_scales(target, {path: tuple(scale.removeprefix(f"{group}/") for scale in plan.scales)})


def _append(target: h5py.Dataset, part: h5py.Dataset, first: int) -> None:
    """Return a part's values from frame `first` on; chunks that are the same there go over as they are packed."""
    length, names = target.chunks[0], ("chunks", "dtype", "compression")
    same = all(getattr(target, name) == getattr(part, name) for name in names)
    whole = len(part) - len(part) % length if same and first % length == 0 else 0
    for begin in range(0, whole, length):
        beside = (0,) * (target.ndim - 1)
        mask, packed = part.id.read_direct_chunk((begin, *beside))
        target.id.write_direct_chunk((first + begin, *beside), packed, mask)
    if whole < len(part):
        target[first + whole : first + len(part)] = part[whole:]


def _planned(dataset: h5py.Dataset, owner: Path, before: DatasetPlan | None) -> DatasetPlan:
    """Return the plan with the frames of this part behind those before; texts as long as the longest."""
    scales = () if dataset.is_scale else tuple(str(dim[0].name) if len(dim) else "" for dim in dataset.dims)
    along = f"{dataset.name if dataset.is_scale else (*scales, '')[0]}".endswith(f"/{TIME}")
    shape, dtype = dataset.shape, dataset.dtype
    length = 1 if not shape else dataset.chunks[0] if dataset.chunks else max(shape[0], 1)
    packing = hdf5.PACKED if dataset.compression or not dataset.chunks else hdf5.UNPACKED
    if before is not None and along:
        shape, length = (before.shape[0] + shape[0], *shape[1:]), max(before.length, length)
        packing = before.packing
        dtype = max(before.dtype, dtype, key=lambda kind: int(kind.itemsize))
    return DatasetPlan(tuple(shape), length, packing, dtype, scales, bool(dataset.is_scale), along, owner)


def _lengths(plans: Mapping[str, DatasetPlan]) -> dict[str, int]:
    """Estimator, or what was measured → frames so far."""
    times = {path: plan for path, plan in plans.items() if path.endswith(f"/{TIME}") and path.count("/") == 1}
    return {path.split("/", 1)[0]: plan.shape[0] for path, plan in times.items()}


def _within(file: h5py.File, group: str) -> Iterator[tuple[str, Any]]:
    """(path from the group on, node) of the group itself and all that it holds, groups before what is in them."""
    for path, node in nodes_below(file, group):
        yield path.removeprefix(group).lstrip("/"), node
