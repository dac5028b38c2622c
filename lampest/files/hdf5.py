"""HDF5 by lampest's conventions: atomic files, digests, fixed-length ASCII, units.

All values have digests, and all datasets have units. Format v110 has checksums of all metadata,
including small values. Larger values are in chunks with Fletcher-32 checksums, and are compressed
unless their digits are noise. Each block of values has a digest
(`checksums.seal`), which every reading function verifies.
"""

import os
import re
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import h5py
import numpy as np
from h5py import Dataset, File, Group
from numpy.typing import NDArray

from lampest.files import checksums
from lampest.files.errors import InputError
from lampest.files.typed import as_double
from lampest.files.whole import check_room, is_locked, note_read, whole_file

FORMAT = ("v110", "v110")  # HDF5 1.10 of 2016: the oldest with checksums of all metadata
MAX_VALUES = 100_000_000  # values that are read at once; 0.8 GB (tests/attack)
MAX_TEXT_BYTES = 5_000_000  # of a text or an attribute (tests/attack)
UNPACKED: Mapping[str, Any] = {"fletcher32": True}
PACKED: Mapping[str, Any] = {**UNPACKED, "compression": "gzip", "shuffle": True}
CHUNK = 100_000  # values of a chunk, which contains whole frames
SAMPLE = 128  # values that show whether an array shrinks; they take a tenth of its compression
ALL = slice(None)

# Attributes of HDF5's dimension scales: references to the scales of each axis of a dataset, and the
# users of a scale, each a dataset and the number of an axis.
AXES = "DIMENSION_LIST"
AXES_TYPE = h5py.vlen_dtype(h5py.ref_dtype)
USERS = "REFERENCE_LIST"
USERS_TYPE = np.dtype([("dataset", h5py.ref_dtype), ("dimension", np.uint32)], align=True)
SIGNATURE = b"\x89HDF\r\n\x1a\n"
# Suffixes of `import_file`.
READABLE = (".csv", ".txt", ".log", ".tsv", ".xlsx", ".xlsm", ".npy", ".npz", ".mat")
# Keys that only one kind of YAML file has, and suffixes of other files: the kind, with the command
# that reads it.
DOCUMENTS = {
    "recordings": ", but a run file; lampest run reads it",
    "estimators": ", but a run file; lampest run reads it",
    "scene": ", but a simulation; lampest simulate makes a recording of it",
    "panel": ", but a scene; lampest import takes it with --scene",
}
FOREIGN = dict.fromkeys(
    (*READABLE, ".json", ".jsonl", ".parquet", ".feather"),
    "a file of another program; lampest import makes a recording of its readings",
) | dict.fromkeys((".png", ".pdf", ".svg", ".jpg"), "a picture")

P = ParamSpec("P")
R = TypeVar("R")


@contextmanager
def new_file(path: Path) -> Iterator[File]:
    """Yield a new file that appears under its name once it is complete and on disk.

    Raises as `whole_file`.
    """
    # Built in memory: the HDF5 library may crash the process if the disk is full, Python's own
    # files do not.
    with File(
        str(path), "w", libver=FORMAT, driver="core", backing_store=False, block_size=2**20
    ) as file:
        yield file
        checksums.seal(file)
        file.flush()
        image = file.id.get_file_image()
    with whole_file(path) as unfinished:
        unfinished.write_bytes(image)


@contextmanager
def new_large_file(path: Path, size: int) -> Iterator[File]:
    """Yield a new file that is too large for memory.

    The file is built on disk and appears once it is complete. `size` is the maximum size of the
    file in bytes. Raises InputError as `new_file`, or if the disk has less space.
    """
    from lampest.files.patient import PatientFile  # not for reading

    with whole_file(path) as unfinished:
        check_room(path, size)
        unfinished.unlink()
        with closing(PatientFile(unfinished)) as storage:
            if not storage.reserve(size) and storage.trouble is not None:
                raise storage.trouble
            with File(storage, "w", libver=FORMAT) as file:
                yield file
                checksums.seal(file)


@contextmanager
def existing_file(path: Path) -> Iterator[File]:
    """Yield a file opened for reading.

    Raises InputError if it is missing, no HDF5 file, truncated or damaged.
    """
    if os.path.isdir(path):  # noqa: PTH112 # Path.is_dir raises for a name that is too long
        raise InputError(f"{path}: a folder; name a file in it")
    if not os.path.isfile(path):  # noqa: PTH113 # as above
        raise InputError(f"{path}: no such file")
    note_read(path)
    try:
        with _opened(path) as file:
            yield file
    except (OSError, RuntimeError, KeyError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a readable HDF5 file{_instead(path, str(error))}") from error


def _instead(path: Path, error: str) -> str:
    """Return the kind of a file that HDF5 cannot open, and the command that reads it."""
    try:
        with path.open("rb") as stream:
            begin = stream.read(100_000)
    except OSError:
        begin = SIGNATURE
    text = begin.decode("utf-8", errors="replace")
    if begin.startswith(SIGNATURE):
        sizes = re.search(r"truncated file: eof = (\d+), .*stored_eof = (\d+)", error)
        cut = f": it is cut off, {sizes[1]} of {sizes[2]} bytes are there" if sizes else ""
        return cut or f" ({' '.join(error.split())})"
    if not begin:
        return ": it is empty"
    suffix = path.suffix.lower()
    if suffix in (".h5", ".hdf5"):
        return ": it does not begin as one does; it is damaged, or another kind of file"
    keys = re.findall(r"^([a-z_]+):", text, re.MULTILINE) if suffix in (".yaml", ".yml") else ()
    kinds = (kind for key, kind in DOCUMENTS.items() if key in keys)
    return next(kinds, f", but {FOREIGN.get(suffix, 'another kind of file')}")


def format_of(path: Path) -> str:
    """Return the format in a file's attributes, '' for none.

    Raises InputError as `existing_file`.
    """
    with existing_file(path) as file:
        form = read_attribute(file, "/", "lampest_format")
    return form if isinstance(form, str) else ""


@contextmanager
def _opened(path: Path) -> Iterator[File]:
    """Yield a file opened for reading, also if its writer was killed or is still writing."""
    with ExitStack() as stack:
        try:
            file = File(path, "r")
        except OSError as error:
            suspected = "already open for" in str(error) or "truncated file" in str(error)
            if not suspected or not checksums.is_left_open(path):
                raise
            # While the recorder is alive, HDF5 waits (SWMR) until it has corrected a wrong
            # checksum.
            alive = is_locked(path)
            file = File(
                path if alive else stack.enter_context(checksums.Closed(path)), "r", swmr=alive
            )
        yield stack.enter_context(file)


def checked(path: Path) -> tuple[int, checksums.Integrity]:
    """Read all of a file, and verify its checksums.

    Raises InputError with the path of a damaged dataset, and if bytes follow the end of a file of
    lampest's.

    Returns
    -------
    size : int
        Size of the file in bytes.
    integrity : checksums.Integrity
        Number of datasets, and paths of those without checksums.
    """
    with existing_file(path) as file:
        integrity = checksums.read_through(file)
    if not integrity.without_checksum and (beyond := checksums.bytes_beyond(path)):
        raise InputError(
            f"{path}: {beyond} bytes stand behind the end of the file as it was written"
        )
    return path.stat().st_size, integrity


def ascii_array(values: Any) -> Any:
    """Return text as fixed-length ASCII; '?' in place of other characters."""
    if isinstance(values, str):
        return np.bytes_(values.encode("ascii", "replace"))
    return np.array([value.encode("ascii", "replace") for value in values], dtype="S")


def set_attributes(node: Any, **attributes: Any) -> None:
    """Write attributes, text as fixed-length ASCII.

    The SHA-256 of a large attribute is written as a further attribute `<name>_sha256`.
    """
    for name, value in attributes.items():
        held = ascii_array(value) if isinstance(value, str | list) else value
        checksums.set_attribute(node.id, name, np.asarray(held))


def write_dataset(
    group: Group,
    name: str,
    data: Any,
    units: str,
    long_name: str,
    scales: tuple[str, ...] = (),
    **further: Any,
) -> None:
    """Write a dataset with its units, its long name, and dimension scales.

    The scales are of the same group ('' for none). `further` are other attributes, such as the
    meanings of flags.
    """
    data = np.asarray(data)
    if data.shape and data.size > 64:  # fewer are not worth compression
        packing = PACKED
        if data.dtype.kind == "f":
            # A sample of real numbers shows whether compression is worth its time: above two thirds
            # of the size, it takes twenty times the time of writing for little gain.
            places = np.linspace(0, data.size - 1, min(data.size, SAMPLE), dtype=int)
            sample = np.ascontiguousarray(data).reshape(-1)[places]
            planes = sample.view(np.uint8).reshape(len(sample), -1).T.tobytes()
            packing = PACKED if len(zlib.compress(planes, 1)) < 2 / 3 * len(planes) else UNPACKED
        dataset = group.create_dataset(name, data=data, chunks=chunk_of(data.shape), **packing)
        checksums.set_digests(dataset, data)
    else:
        dataset = write_plain(group, name, data)
    set_attributes(dataset, units=units, long_name=long_name, **further)
    if any(scales):
        attach_scales(group, {name: scales})


def chunk_of(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the shape of a chunk of whole frames of a dataset."""
    return max(1, min(shape[0], CHUNK // int(np.prod(shape[1:])))), *shape[1:]


def attach_scales(group: Group, axes: Mapping[str, tuple[str, ...]]) -> None:
    """Attach scales to the axes of datasets, given by path in the group.

    Every axis has a name, '' without a scale. The attributes of HDF5's specification are written at
    once; `h5py.h5ds` writes them anew for every axis. No dataset is opened: to open a chunked one
    takes as long as to write its attribute.
    """
    node = group.id
    used = (name for path, names in axes.items() for name in (path, *names) if name)
    places = {name: name.encode() for name in used}
    references = {
        name: h5py.h5r.create(node, place, h5py.h5r.OBJECT) for name, place in places.items()
    }
    users: dict[str, list[tuple[Any, int]]] = {}
    kinds = checksums.types_of(AXES_TYPE)
    for path, names in axes.items():
        scales = np.empty(len(names), dtype=AXES_TYPE)
        for axis, name in enumerate(names):
            scales[axis] = np.array([references[name]] if name else [], dtype=h5py.ref_dtype)
            if name:
                users.setdefault(name, []).append((references[path], axis))
        checksums.set_attribute(node, AXES, scales, kinds, places[path])
    kinds = checksums.types_of(USERS_TYPE)
    for name, added in users.items():
        earlier = checksums.attribute(node, USERS, places[name])
        entries = np.array([*([] if earlier is None else earlier.tolist()), *added], USERS_TYPE)
        checksums.set_attribute(node, USERS, entries, kinds, places[name])


def write_plain(group: Group, name: str, data: NDArray[Any]) -> Dataset:
    """Write an uncompressed dataset, within the metadata if it is small; also scalars."""
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_obj_track_times(False)  # times would make equal contents different files
    if data.nbytes <= 60_000:  # HDF5's limit is 64 KiB; h5py itself cannot request it for scalars
        properties.set_layout(h5py.h5d.COMPACT)
    links = h5py.h5p.create(h5py.h5p.LINK_CREATE)
    links.set_create_intermediate_group(True)
    scalar = h5py.h5s.create(h5py.h5s.SCALAR)
    space = h5py.h5s.create_simple(data.shape) if data.shape else scalar
    kind = checksums.types_of(data.dtype)[0]
    dataset = Dataset(h5py.h5d.create(group.id, name.encode(), kind, space, properties, links))
    if data.size:
        dataset[...] = data
        checksums.set_digests(dataset, data)
    return dataset


def write_scale(group: Group, name: str, data: Any, units: str, long_name: str) -> None:
    """Write a dimension scale: a one-dimensional dataset that other datasets attach."""
    write_dataset(group, name, data, units, long_name)
    group[name].make_scale(name)


def write_text(group: Group, name: str, text: str) -> None:
    """Write a text as a fixed-length ASCII scalar."""
    write_plain(group, name, np.asarray(ascii_array(text)))


def _located(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function of a file and a path whose errors name both."""

    @wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> R:
        with checksums.located(cast(File, args[0]), str(args[1])):
            return function(*args, **kwargs)

    return called


@_located
def has(file: File, path: str) -> bool:
    """Return whether a group or dataset exists.

    Raises InputError if it is damaged, or a link to another file.
    """
    return _node_or_none(file, path) is not None


@_located
def shape_of(file: File, path: str) -> tuple[int, ...]:
    """Return the lengths of a dataset's axes. Raises InputError if it is absent or empty."""
    shape = _node(file, path, Dataset).shape
    if shape is None:
        raise InputError(f"{file.filename}: {path} is missing")
    return tuple(map(int, shape))


def length_of(file: File, path: str) -> int:
    """Return the length of a dataset's first axis.

    Raises InputError if it is absent or has no axis.
    """
    if shape := shape_of(file, path):
        return shape[0]
    raise InputError(f"{file.filename}: {path} is a single value")


@_located
def read_array(
    file: File,
    path: str,
    dimensions: int | tuple[int, ...],
    shape: tuple[int, ...] = (),
    part: slice = ALL,
    kind: Any = None,
) -> Any:
    """Return the values of a numeric dataset, or of a part of it.

    Parameters
    ----------
    file : File
    path : str
    dimensions : int or tuple of int
        Permitted numbers of dimensions.
    shape : tuple of int
        Required shape of the whole dataset; () for any.
    part : slice
        Part of the first axis that is read.
    kind : integer type, or None
        Type of the result; None for the stored one.

    Raises
    ------
    InputError
        If the dataset is absent, of another shape, damaged, absurdly large, or does not fit the
        integer type.
    """
    dataset = _node(file, path, Dataset)
    requested = (dimensions,) if isinstance(dimensions, int) else dimensions
    if dataset.shape is None or dataset.ndim not in requested or dataset.dtype.kind not in "iuf":
        numbers = " or ".join(map(str, requested))
        raise InputError(f"{file.filename}: {path} must be numeric with {numbers} dimensions")
    if shape and dataset.shape != shape:
        actual, required = (" × ".join(map(str, sizes)) for sizes in (dataset.shape, shape))
        raise InputError(f"{file.filename}: {path} is {actual}, not {required}")
    size = len(range(*part.indices(len(dataset)))) * int(np.prod(dataset.shape[1:]))
    if size > MAX_VALUES:
        raise InputError(
            f"{file.filename}: {path} claims {size} values; more than {MAX_VALUES} are not read"
        )
    # a part is of a whole
    checksums.check_chunks(dataset)
    stored = dataset.id.get_storage_size()
    claimed = dataset.size * dataset.dtype.itemsize
    # Deflate compresses to a 1032nd at best; a larger claim has no stored values behind it.
    if claimed > max(64_000_000, 1100 * stored):
        raise InputError(f"{file.filename}: {path} claims {claimed} bytes, but holds only {stored}")
    values = as_double(checksums.read_verified(dataset, part))
    if kind is None:
        return values
    if values.dtype.kind == "f" or not np.array_equal(values.astype(kind), values):
        raise InputError(
            f"{file.filename}: {path} must be whole numbers within the range of {np.dtype(kind)}"
        )
    return values.astype(kind)


@_located
def read_text(file: File, path: str) -> str:
    """Return a scalar text. Raises InputError if it is absent or no text."""
    dataset = _node_or_none(file, path, Dataset)
    if dataset is None or dataset.shape != () or dataset.dtype.kind not in "SO":
        raise InputError(f"{file.filename}: {path} is missing or no text")
    if dataset.dtype.itemsize > MAX_TEXT_BYTES:
        raise InputError(f"{file.filename}: {path} claims a text of {dataset.dtype.itemsize} bytes")
    return _text(checksums.read_verified(dataset))


@_located
def read_texts(
    file: File, path: str, length: int | None = None, part: slice = ALL
) -> tuple[str, ...]:
    """Return a list of fixed-length texts, or a part of it.

    Raises InputError if the dataset is absent, of another length, or something else.
    """
    dataset = _node_or_none(file, path, Dataset)
    shape: Any = getattr(dataset, "shape", None)
    fits = shape and not shape[1:] and length in (None, *shape)
    if not fits or dataset.dtype.kind != "S":
        raise InputError(
            f"{file.filename}: {path} is missing or not {length or 'some'} texts of a fixed length"
        )
    claimed = dataset.dtype.itemsize * len(range(*shape)[part])
    if claimed > MAX_TEXT_BYTES:
        raise InputError(f"{file.filename}: {path} claims texts of {claimed} bytes")
    return tuple(map(_text, checksums.read_verified(dataset, part)))


def read_attribute(file: File, path: str, name: str) -> Any:
    """Return an attribute, text as str; None if it is absent.

    Raises InputError if it cannot be read.
    """
    with checksums.located(file, f"{path}@{name}"):
        attributes = _node(file, path).attrs
        held = attributes.get_id(name) if name in attributes else None
        if held is None or held.shape is None:
            return None
        if held.get_storage_size() > MAX_TEXT_BYTES:
            raise InputError(
                f"{file.filename}: {path}@{name} is larger than {MAX_TEXT_BYTES} bytes"
            )
        if held.dtype.kind == "O" and held.shape:
            raise InputError(
                f"{file.filename}: {path}@{name} is a list of texts without a fixed length"
            )
        value = attributes[name]
        checksums.check_digest(attributes, value, name)
        return _text(value) if isinstance(value, bytes | str) else value


def read_number(file: File, path: str, name: str, otherwise: float | None = None) -> float:
    """Return a numeric attribute; `otherwise` if it is absent or NaN.

    Raises InputError if it is not finite.
    """
    value = read_attribute(file, path, name)
    number = np.shape(value) == () and np.asarray(value).dtype.kind in "iuf"
    if otherwise is not None and (value is None or (number and np.isnan(value))):
        return otherwise
    if not number or not np.isfinite(value):
        raise InputError(f"{file.filename}: {path}@{name} is missing or no finite number")
    return float(value)


@_located
def attribute_names(file: File, path: str) -> list[str]:
    """Return the names of a node's attributes. Raises InputError if the node is absent."""
    return [str(name) for name in _node(file, path).attrs]


@_located
def children(file: File, path: str, kind: type = Dataset) -> list[str]:
    """Return the names of the datasets, or groups, in a group, alphabetically.

    Raises InputError if it is no group.
    """
    group = _node(file, path)
    if not isinstance(group, Group):
        raise InputError(f"{file.filename}: {path} is no group")
    return [name for name in group if _node_or_none(file, f"{path}/{name}", kind) is not None]


@_located
def datasets(file: File, path: str) -> dict[str, Dataset]:
    """Return all datasets below a group by their paths, without a leading slash.

    Links, and datasets whose values are in other files, are left out. Raises InputError if a part
    of the file is damaged.
    """
    found = {}

    def take(name: str, node: Any) -> None:
        if isinstance(node, Dataset) and not (node.is_virtual or node.external):
            found[name] = node

    file[path].visititems(take)  # each object once, by hard links alone
    return found


def _node(file: File, path: str, kind: type = object) -> Any:
    """Return the group or dataset at a path. Raises InputError if there is none of this kind."""
    node = _node_or_none(file, path, kind)
    if node is None:
        raise InputError(f"{file.filename}: {path} is missing")
    return node


def _node_or_none(file: File, path: str, kind: type = object) -> Any:
    """Return the group or dataset at a path, None if absent or of another kind.

    Raises InputError for links.
    """
    node = file
    for part in filter(None, path.split("/")):
        name = part.encode()
        # `exists` raises for a damaged group, for which `get` would return None.
        if not isinstance(node, Group) or not node.id.links.exists(name):
            return None
        if node.id.links.get_info(name).type != h5py.h5l.TYPE_HARD:
            raise InputError(
                f"{file.filename}: {path} is a link, perhaps to another file, which is not followed"
            )
        node = node[part]
    if isinstance(node, Dataset) and (node.is_virtual or node.external):
        raise InputError(
            f"{file.filename}: {path} has its values in another file, which is not read"
        )
    return node if isinstance(node, kind) else None


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
