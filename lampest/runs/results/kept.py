"""A case's result as a batch keeps it until results.h5 is written: two datasets, in a millisecond.

What holds more than MOST_PACKED bytes is kept as a results file of its own.
"""

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from lampest.files import hdf5
from lampest.files.document import adapter, plain_content
from lampest.files.errors import InputError
from lampest.panel.scene import Scene
from lampest.recording.stored import too_long
from lampest.runs.case import CaseResult, StoredCase
from lampest.runs.columns import all_columns
from lampest.runs.results.reader import read_results, stored_cases
from lampest.runs.results.writer import write_results

FORMAT = "case/1"
MOST_PACKED = 2**20  # bytes
ARRAY = "array"  # the key of what stands for an array: its type, its shape, where it begins in `values`


def write_kept(path: Path, result: CaseResult) -> None:
    """Keep a case, whole or not at all.

    A packed one is not waited for until it is on the disk: its checksums tell whether it is whole, and it is solved
    again where a power failure cost it. Raises InputError where the place cannot be written.
    """
    parts: list[bytes] = []
    text = json.dumps({field.name: _plain(getattr(result, field.name), parts) for field in fields(result)})
    values = b"".join(parts)
    if len(text) + len(values) > MOST_PACKED:
        write_results(path, [result])
        return
    with hdf5.new_file(path, durable=False) as file:
        hdf5.set_attributes(file, lampest_format=FORMAT)
        hdf5.write_plain(file, "case", np.asarray(hdf5.ascii_array(text)))
        hdf5.write_plain(file, "values", np.frombuffer(values, dtype=np.uint8))


def read_kept(path: Path, case_id: str) -> CaseResult | StoredCase | None:
    """The case of that name in a file that keeps one, None where it is of another. Raises InputError where damaged.

    A case of a recording that is too long for memory stays where it is.
    """
    with hdf5.existing_file(path) as file:
        packed = hdf5.read_attribute(file, "/", "lampest_format") == FORMAT
        if packed:
            text, values = hdf5.read_text(file, "/case"), hdf5.read_array(file, "/values", 1).tobytes()
    if not packed:
        held = next((case for case in stored_cases(path) if case.case_id == case_id), None)
        if held is None or too_long(held.frames, held.cells):
            return held
        return next((case for case in read_results(path).cases if case.case_id == case_id), None)
    try:
        found = {name: _held(value, values) for name, value in json.loads(text).items()}
        scene: Scene = adapter(Scene).validate_python(found.pop("scene"))
        case = CaseResult(**found, scene=scene)
    except (ValueError, TypeError, LookupError) as error:
        raise InputError(f"{path}: keeps no case ({error})") from error
    case.check(all_columns())
    return case if case.case_id == case_id else None


def _plain(value: Any, parts: list[bytes]) -> Any:
    """What JSON can say of a field's value; the bytes of arrays go to `parts`."""
    if isinstance(value, np.ndarray):
        begin = sum(map(len, parts))
        parts.append(value.tobytes())
        return {ARRAY: [value.dtype.str, value.shape, begin]}
    if isinstance(value, dict):
        return {name: _plain(item, parts) for name, item in value.items()}
    return plain_content(value) if isinstance(value, Scene) else value


def _held(value: Any, values: bytes) -> Any:
    """The reverse; a list of texts as a tuple."""
    if isinstance(value, list):
        return tuple(value)
    if not isinstance(value, dict):
        return value
    if value.keys() != {ARRAY}:
        return {name: _held(item, values) for name, item in value.items()}
    kind, shape, begin = value[ARRAY]
    if np.dtype(kind).kind not in "biuf":
        raise ValueError(f"an array of {kind}")
    return np.frombuffer(values, kind, int(np.prod(shape)), begin).reshape(shape)
