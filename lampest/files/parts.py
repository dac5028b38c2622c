"""Groups of HDF5 files from file to file, dataset by dataset and part by part, so that memory holds little of them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from lampest.files import hdf5

TIME = "time"  # the axis along which parts follow each other
CHUNK_VALUES = 100_000
OF_AXES = ("DIMENSION_LIST", "REFERENCE_LIST", "CLASS", "NAME")  # by which HDF5 ties axes to datasets


@dataclass(frozen=True)
class DatasetPlan:
    """A dataset as it is to be: shape, dtype, the paths of its axes' scales, attributes.

    is_scale : whether it is an axis itself. along : whether its first axis is time.
    """

    shape: tuple[int, ...]
    dtype: Any
    scales: tuple[str, ...]
    attributes: dict[str, Any]
    is_scale: bool
    along: bool

    @classmethod
    def of(cls, dataset: h5py.Dataset) -> "DatasetPlan":
        """As it is."""
        path = str(dataset.name)
        scales = tuple(str(dim[0].name) if len(dim) else "" for dim in dataset.dims) if not dataset.is_scale else ()
        time = path.endswith(f"/{TIME}") if dataset.is_scale else bool(scales) and scales[0].endswith(f"/{TIME}")
        return cls(tuple(dataset.shape), dataset.dtype, scales, _attributes(dataset), bool(dataset.is_scale), time)

    def longer(self, other: "DatasetPlan") -> "DatasetPlan":
        """With the frames of another part behind its own; texts as long as the longest."""
        longest = max(self.dtype, other.dtype, key=lambda dtype: int(dtype.itemsize))
        return replace(self, dtype=longest, shape=(self.shape[0] + other.shape[0], *self.shape[1:]))


def copy_group(source: h5py.Group, target: h5py.Group) -> None:
    """All of a group as it is stored, nothing unpacked, with its attributes and axes."""  # HDF5 would copy no axes
    for path, node in _below(source):
        if isinstance(node, h5py.Group):
            target.require_group(path)
        else:
            source.copy(node, target, path, without_attrs=True)
    _finish(target, str(source.name), _planned(source), _groups(source))


def join_parts(parts: Sequence[Path], target: h5py.Group, group: str) -> None:
    """A group of which every file holds some of the frames → one that holds all of them.

    What is not along time is the last one's. What a part lacks, because none of its frames could fill it, is NaN, 0 or
    an empty text there. Raises InputError where a file cannot be read.
    """
    plans: dict[str, DatasetPlan] = {}
    owners: dict[str, Path] = {}
    groups: dict[str, dict[str, Any]] = {}
    begins: list[dict[str, int]] = []
    for part in parts:
        with hdf5.existing_file(part) as file:
            begins.append({_parent(path): plan.shape[0] for path, plan in plans.items() if _is_time(path)})
            groups |= _groups(file[group])
            for path, found in _planned(file[group]).items():
                before = plans.get(path)
                plans[path] = before.longer(found) if before is not None and found.along else found
                owners[path] = part
    ends = {_parent(path): plan.shape[0] for path, plan in plans.items() if _is_time(path)}
    for path in filter(None, groups):
        target.require_group(path)
    for path, plan in plans.items():
        if plan.along:
            whole = replace(plan, shape=(ends[_parent(path)], *plan.shape[1:]))
            _make(target, path, whole, max(1, plan.shape[0] // len(parts)))
    for part, begin in zip(parts, begins, strict=True):
        with hdf5.existing_file(part) as file:
            for path, node in _below(file[group]):
                if path in plans and plans[path].along:
                    first = begin.get(_parent(path), 0)
                    target[path][first : first + len(node)] = node[()]
                elif owners.get(path) == part:
                    file.copy(node, target, path, without_attrs=True)
    _finish(target, group, plans, groups)


def _planned(source: h5py.Group) -> dict[str, DatasetPlan]:
    return {path: DatasetPlan.of(node) for path, node in _below(source) if isinstance(node, h5py.Dataset)}


def _groups(source: h5py.Group) -> dict[str, dict[str, Any]]:
    """Path → attributes of the group itself ('') and of those within."""
    within = {path: _attributes(node) for path, node in _below(source) if isinstance(node, h5py.Group)}
    return {"": _attributes(source)} | within


def _attributes(node: Any) -> dict[str, Any]:
    return {name: value for name, value in node.attrs.items() if name not in OF_AXES}


def _make(target: h5py.Group, path: str, plan: DatasetPlan, frames: int) -> None:
    """frames : of a part: a chunk that holds more is unpacked and packed again for every one of them."""
    length = max(1, CHUNK_VALUES // int(np.prod(plan.shape[1:], initial=1)))
    chunks = (min(length, frames), *plan.shape[1:])
    nothing = np.nan if plan.dtype.kind == "f" else None
    target.create_dataset(path, plan.shape, plan.dtype, chunks=chunks, fillvalue=nothing, **hdf5.PACKED)


def _finish(target: h5py.Group, root: str, plans: dict[str, DatasetPlan], groups: dict[str, dict[str, Any]]) -> None:
    """Attributes and axes; root : the path under which the scales' own are told."""
    for path, attributes in groups.items():
        (target.require_group(path) if path else target).attrs.update(attributes)
    for path, plan in plans.items():
        target[path].attrs.update(plan.attributes)
        if plan.is_scale:
            target[path].make_scale(path.rsplit("/", 1)[-1])
    for path, plan in plans.items():
        for axis, scale in enumerate(plan.scales):
            if scale:
                target[path].dims[axis].attach_scale(target[scale.removeprefix(f"{root}/")])


def _below(group: h5py.Group, before: str = "") -> Iterator[tuple[str, Any]]:
    """(path from the group on, node) of all that it holds, groups before what is in them."""
    for name in group:
        yield f"{before}{name}", group[name]
        if isinstance(group[name], h5py.Group):
            yield from _below(group[name], f"{before}{name}/")


def _parent(path: str) -> str:
    """The group of an estimator, or of what was measured: the first part of a path."""
    return path.split("/", 1)[0]


def _is_time(path: str) -> bool:
    return path.endswith(f"/{TIME}") and path.count("/") == 1
