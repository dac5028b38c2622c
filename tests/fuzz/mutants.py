"""Inputs of every kind that are nearly right: number n is always the same input."""

import copy
import io
import json
import re
import struct
import zipfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import h5py
import numpy as np
from contracts.imports import written
from contracts.test_import import TABLES
from contracts.test_import_files import FILES
from ruamel.yaml import YAML
from support import invented_case
from unclosed import unclosed_recording

from lampest import (
    Panel,
    PublishedFigures,
    Recording,
    Scene,
    StepFigures,
    TwoPointReadout,
    write_results,
)
from lampest.files import hdf5
from lampest.recording.acquisition import Acquisition

# Suffix and styles of change of each kind of file.
KINDS = {
    "run": (".yaml", ("text", "meaning", "meaning", "bytes")),
    "scene": (".yaml", ("text", "meaning", "bytes")),
    "simulation": (".yaml", ("text", "meaning", "meaning", "bytes")),
    "setting": (".txt", ("text", "bytes")),
    "recording": (".h5", ("bytes", "nodes", "nodes")),
    "results": (".h5", ("bytes", "nodes", "nodes")),
    "table": (".csv", ("text", "text", "bytes")),
    "numpy": (".npy", ("bytes", "text")),
    "matlab": (".mat", ("bytes",)),
    "excel": (".xlsx", ("bytes", "parts", "parts")),
    "arrays": (".npz", ("bytes", "parts")),
    "matlab_hdf5": (".mat", ("bytes",)),
}
Shape = tuple[int, ...]
IMPORTED = ("table", "numpy", "matlab", "excel", "arrays", "matlab_hdf5")
DOCUMENTS = """
run:
  schema: 1
  recordings: [small.h5]
  estimators:
    LSM: {terms: {misfit: {}}, bounds: {lower: 1}}
    LSR-CR: {terms: {misfit: {weighting: noise}, cell_resistance: {weight: 0.001}}}
    LSR-gdCR:
      terms: {misfit: {loss: {kind: huber, corner: 3}}, gradient_of_relative_change: {weight: 10}}
      formulation: reduced
  formulation: nodal
  solver: {tolerance: 1.0e-8, max_iterations: 300}
  bounds: {lower: measured, upper: resolution}
  sweep: {estimators.LSR-CR.terms.cell_resistance.weight: [0.0001, 0.001]}
  published: {LSM: {all: {time_s: 0.3, error_percent: 0.1}}}
scene:
  panel: {rows: 3, columns: 4, pitch_mm: 10}
  readout: {kind: two_point, supply_volt: 5, reference_ohm: 1000, adc_bits: 10, noise_lsb: 0.7}
  series_resistance_ohm: 140
simulation:
  schema: 1
  seed: 40
  cells: {resistance_ohm: 3050, spread: 0.2, patch_mm: 6}
  baseline_frames: 1
  frames: 2
  frame_period_s: 1.0
  loads: [{kind: rod, centre_mm: [15, 10], diameter_mm: 20, mass_g: {uniform: [80, 120]}}]
  unmodelled: {channel_spread_ohm: 3, reference_tolerance: 0.01, outlier_probability: 0.0001}
  output: 'made_{case:03d}_{seed}.h5'
  sweep: {seed: [1, 2]}
"""
CONTENT: dict[str, Any] = YAML(typ="safe").load(DOCUMENTS)
CONTENT["simulation"]["scene"] = CONTENT["scene"]
RUN = CONTENT["run"]
SCENE = CONTENT["scene"]
SETTINGS = (
    "solver.tolerance=1e-6",
    "estimators.LSM.bounds.lower=none",
    "recordings=[small.h5]",
    "bounds={upper: 1e9}",
)

NASTY_TEXTS = (
    "!!python/object/apply:os.system [touch owned]",
    "!!python/name:os.system",
    "!!binary aGk=",
    "!tag {a: 1}",
    "!!set {a}",
    "&a [*a, *a]",
    "*a",
    "&a {b: *a}",
    "<<: *a",
    "<<: {a: 1}",
    "- - - -",
    "? ",
    ": ",
    "{",
    "}",
    "[",
    "]",
    "'",
    '"',
    "|",
    ">",
    "%YAML 1.1",
    "---",
    "...",
    "\t",
    "\0",
    "\ufeff",
    "\x1b[31m",
    "\u2028",
    "\U0001f600",
    "\\ud800",
    '"\\ud800"',
    '"a\\nb"',
    "'a: b'",
    "null",
    "~",
    "true",
    "yes",
    ".nan",
    ".inf",
    "-.inf",
    "1e999",
    "-1e999",
    "1e-999",
    "0x" + "f" * 5000,
    "9" * 5000,
    "9" * 300,
    "0b101",
    "0o777",
    "1_000",
    "2001-01-01",
    "12:30:45",
    "-0.0",
    "1e3.5",
    "../../../../etc/passwd",
    "/dev/zero",
    "**",
    "**/*",
    "~root",
    "small.h5\\0",
    "[" * 2000,
    "{a: " * 800,
    "-\n" * 300,
    "a" * 3000,
    "con",
    ".",
    "..",
    "a/b",
    "#",
    "{uniform: [1, 2]}",
    "{uniform: [2, 1]}",
    "{uniform: .inf}",
    "{seed}",
    "{0.__class__}",
    "{seed:09d}",
    "%s%n",
    "$(id)",
)
NASTY_VALUES: tuple[Any, ...] = (
    None,
    True,
    False,
    0,
    1,
    -1,
    2**31,
    2**63,
    -(2**63) - 1,
    10**30,
    1e300,
    -1e300,
    1e-300,
    0.5,
    float("nan"),
    float("inf"),
    "",
    " ",
    "nodal",
    "none",
    "measured",
    "NaN",
    "a\nb",
    "a/b",
    "..",
    "../x",
    "x" * 500,
    "\x00",
    "\x1b[2J",
    "\ud800",
    "*",
    "**",
    "/dev/zero",
    "/proc/self/mem",
    "small.h5",
    "{case}",
    [],
    [[]],
    [0],
    [1, 2, 3],
    {},
    {"": 1},
    {"kind": "rod"},
    {"uniform": [0, 1]},
    {"a.b": 1},
    [None],
    {"misfit": {}},
    {"uniform": [1e11, 9e11]},
)
MAX_VALUES_READ = 100_000
BYTES = (
    b"\0",
    b"\xff",
    b"\xff" * 8,
    b"\0" * 8,
    b"\x7f\xff\xff\xff",
    struct.pack("<Q", 10**9),
    struct.pack("<I", 2**31),
)
ATTRIBUTES: tuple[Any, ...] = (
    None,
    0,
    -1,
    2**63,
    1e308,
    np.nan,
    "text",
    "é",
    np.bytes_(b"\xff\xfe"),
    [1, 2],
    ["a", "b"],
    np.zeros((2, 2)),
    h5py.Empty("f8"),
    "{}",
    "[]",
    '{"LSM": 5}',
    '{"LSM": {"all": {"time_s": -1}}}',
    '{"LSM": {"none": {}}}',
    "[" * 1000,
    True,
    1 + 1j,
    "x" * 60_000,
    np.array([b"a"], dtype=h5py.string_dtype()),
    np.zeros(2, [("a", "f8")]),
    "9" * 5000,
)


class Mutant(NamedTuple):
    """One input: the kind of its reader, and its bytes."""

    kind: str
    content: bytes


class Corpus(NamedTuple):
    """Good files: kind → their bytes."""

    files: dict[str, tuple[bytes, ...]]

    def mutant(self, number: int, kind: str) -> Mutant:
        """Return input `number` of a kind, with one to four changes of one style.

        The input is the same in every process.
        """
        rng = np.random.default_rng([number, list(KINDS).index(kind)])
        seeds = self.files[kind]
        style = str(rng.choice(KINDS[kind][1]))
        content = choose(seeds, rng)
        count = int(rng.integers(1, 5))
        if style == "meaning":
            return Mutant(kind, changed_tree(CONTENT[kind], count, rng))
        if style in ("nodes", "parts"):
            return Mutant(
                kind, (changed_nodes if style == "nodes" else changed_parts)(content, count, rng)
            )
        for _ in range(count):
            content = (changed_text if style == "text" else changed_bytes)(content, seeds, rng)
        return Mutant(kind, content)


def corpus(folder: Path) -> Corpus:
    """Good files of all kinds; small.h5, which runs name, is written into the folder."""
    recording, unfinished = good_recordings(folder)
    (folder / "small.h5").write_bytes(recording)
    return Corpus(
        {kind: good_imports(folder, kind) for kind in IMPORTED}
        | {
            "run": (
                text(RUN),
                text({**RUN, "recordings": ["*.h5"], "sweep": {"bounds.lower": [1, "none"]}}),
            ),
            "scene": (text(SCENE), text({"scene": SCENE})),
            "simulation": (text(CONTENT["simulation"]),),
            "setting": tuple(setting.encode() for setting in SETTINGS),
            "recording": (recording, without_checksums(good_recordings, folder)[0], unfinished),
            "results": (good_results(folder), without_checksums(good_results, folder)),
        }
    )


def text(content: Any) -> bytes:
    """YAML as a person may write it."""
    return "".join(
        f"{key}: {json.dumps(value)}\n".replace('"', "'") for key, value in content.items()
    ).encode()


def good_recordings(folder: Path) -> tuple[bytes, bytes]:
    """One with everything a recording can hold, and one whose recorder was killed."""
    rng = np.random.default_rng(2)
    count = np.arange(3)
    readout = TwoPointReadout()
    codes = rng.integers(4000, 8000, (3, 3, 4))
    scene = Scene(Panel(3, 4), readout, 140.0)
    Recording(
        scene,
        readout.recorded_from_volt(readout.volt_from_code(codes / 20)),
        count * 1.0,
        (count > 0).astype(np.uint8),
        sigma=np.full((3, 4), 5.0),
        truth_cell_resistance=rng.uniform(1e3, 1e4, (3, 3, 4)),
        truth_pressure=rng.uniform(0, 9, (3, 3, 4)),
        raw_sums=codes.astype(np.uint16),
        raw_readings=20,
        name="small",
        simulation="seed: 1\n",
        acquisition=Acquisition(
            count * 1.0, count, count, *[0 * count] * 3, np.array([0.5]), ("mark",)
        ),
    ).save(folder / "good.h5")
    unclosed_recording(folder / "killed.h5", scene, 3, 1)
    contents = [(folder / name).read_bytes() for name in ("good.h5", "killed.h5")]
    for name in ("good.h5", "killed.h5", "growing.h5"):
        (folder / name).unlink()
    return contents[0], contents[1]


def good_results(folder: Path) -> bytes:
    """Two estimators, one of them with a frame that failed, and published figures."""
    shape = (2, 3, 4)
    cases = [
        invented_case("LSM", "small", shape),
        invented_case("LSR-dCR", "small", shape, failed=(1,)),
    ]
    write_results(
        folder / "good.h5", cases, {"LSM": PublishedFigures(all=StepFigures(0.3, 0.1, 0.2, None))}
    )
    content = bytes((folder / "good.h5").read_bytes())
    (folder / "good.h5").unlink()
    return content


def without_checksums(make: Callable[[Path], Any], folder: Path) -> Any:
    """Return the files that `make` writes in the format of older versions or other programs."""
    with patch.object(hdf5, "FORMAT", ("earliest", "v110")):
        return make(folder)


def good_imports(folder: Path, kind: str) -> tuple[bytes, ...]:
    """The files of the import's tests that need no option, of one kind."""
    files = [
        file
        for file in (*TABLES.values(), *FILES.values())
        if not file.how and file.name == f"m{KINDS[kind][0]}"
    ]
    contents = []
    for path in (written(folder, file) for file in files):
        if kind not in ("matlab", "matlab_hdf5") or h5py.is_hdf5(path) == (kind == "matlab_hdf5"):
            contents.append(path.read_bytes())
        path.unlink()
    return tuple(contents)


def choose(choices: Any, rng: np.random.Generator) -> Any:
    """One thing of several."""
    return choices[int(rng.integers(len(choices)))]


def changed_bytes(content: bytes, seeds: tuple[bytes, ...], rng: np.random.Generator) -> bytes:
    """A cut, a hole, other bytes, a piece of another file, or another change of bytes.

    The other change is a large number where a size may stand, or a turned bit.
    """
    at = int(rng.integers(len(content) + 1))
    length = int(rng.integers(1, 64))
    donor = choose(seeds, rng)
    start = int(rng.integers(len(donor) + 1))
    kind = rng.integers(7)
    if kind < 2:
        return content[:at] + content[at + (length if kind else len(content)) :]
    if kind == 2:
        places = rng.integers(0, max(len(content), 1), 8).tolist()
        return bytes(
            int(rng.integers(256)) if place in places else byte
            for place, byte in enumerate(content)
        )
    if kind == 3:
        at = at // 8 * 8
        piece = choose(BYTES, rng)
    elif kind == 4:
        piece = bytes([byte ^ 1 << int(rng.integers(8)) for byte in content[at : at + 1]])
    else:
        piece = rng.bytes(length) if kind == 5 else donor[start : start + length]
    return content[:at] + piece + content[at + len(piece) :]


def changed_parts(content: bytes, count: int, rng: np.random.Generator) -> bytes:
    """Changes within the parts of a zip file, which is whole itself."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    for _ in range(count):
        name = choose(list(parts), rng)
        change = changed_bytes if name.endswith(".npy") else changed_text
        parts[name] = change(parts[name], (parts[name],), rng)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, part in parts.items():
            archive.writestr(name, part)
    return stream.getvalue()


def changed_text(content: bytes, seeds: tuple[bytes, ...], rng: np.random.Generator) -> bytes:
    """A line twice, gone or moved; a word for another; or another change.

    The other change is a nasty text somewhere, or a change of bytes.
    """
    lines = content.split(b"\n")
    kind = rng.integers(7)
    words = [match.span() for match in re.finditer(rb"[^\s,:;\[\]{}']+", content)]
    nasty = choose(NASTY_TEXTS, rng).encode("utf-8", "surrogatepass")
    at, second = (int(place) for place in rng.integers(0, len(lines), 2))
    if kind == 0:
        lines.insert(at, lines[second])
    elif kind == 1:
        del lines[at]
    elif kind == 2:
        lines[at], lines[second] = lines[second], lines[at]
    elif kind in (3, 4) and words:
        start, end = choose(words, rng)
        first, last = choose(words, rng)
        return content[:start] + (nasty if kind == 3 else content[first:last]) + content[end:]
    elif kind == 5:
        place = int(rng.integers(len(content) + 1))
        return content[:place] + nasty + content[place:]
    else:
        return changed_bytes(content, seeds, rng)
    return b"\n".join(lines)


def changed_tree(tree: Any, count: int, rng: np.random.Generator) -> bytes:
    """Return a YAML document with changed values, keys and shapes, as JSON, which is YAML too."""
    tree = json.loads(json.dumps(tree))
    for _ in range(count):
        node, place = _somewhere(tree, rng)
        second_node, second_place = _somewhere(tree, rng)
        value = copy.deepcopy(choose(NASTY_VALUES, rng))
        kind = rng.integers(5)
        if kind == 0:
            node[place] = json.loads(json.dumps(second_node[second_place]))
        elif kind == 1 and isinstance(node, dict):
            node[str(value)[:40] if isinstance(value, str | float) else str(second_place)] = (
                node.pop(place)
            )
        elif kind == 2:
            del node[place]
        else:
            node[place] = value
        if not tree:
            break
    return json.dumps(tree, indent=int(rng.integers(3)), ensure_ascii=bool(rng.integers(2))).encode(
        "utf-8", "replace"
    )


def _somewhere(tree: Any, rng: np.random.Generator) -> tuple[Any, Any]:
    """A container within the tree and a key or index of it."""
    node = tree
    while True:
        key = choose(list(node) if isinstance(node, dict) else range(len(node)), rng)
        if not isinstance(node[key], dict | list) or not node[key] or rng.random() < 0.25:
            return node, key
        node = node[key]


def changed_nodes(content: bytes, count: int, rng: np.random.Generator) -> bytes:
    """Other types, shapes, values, links and attributes in an HDF5 file."""
    with h5py.File(io.BytesIO(content), "r+") as file:
        for _ in range(count):
            names: list[str] = []
            file.visit(names.append)
            impossible = (ValueError, TypeError, LookupError, OSError, RuntimeError, AttributeError)
            with suppress(*impossible), np.errstate(all="ignore"):
                changed_node(file, choose(names, rng), rng)
        file.flush()
        stream = io.BytesIO()
        with h5py.File(stream, "w") as fresh:
            fresh.attrs.update(file.attrs)
            for key in file:
                link = file.get(key, getlink=True)
                if isinstance(link, h5py.HardLink):
                    file.copy(key, fresh, expand_soft=False)
                else:
                    fresh[key] = link
        return stream.getvalue()


def _replaced(file: Any, name: str, data: Any = None, **options: Any) -> None:
    attributes = dict(file[name].attrs) if name in file else {}
    del file[name]
    dataset = file.create_dataset(name, data=data, **options)
    dataset.attrs.update(
        {key: attributes[key] for key in ("units", "long_name") if key in attributes}
    )


def _values(file: Any, name: str) -> Any:
    """Return the values of a dataset; a size that an earlier change claims is not read."""
    if file[name].size is None or file[name].size > MAX_VALUES_READ:
        raise ValueError(name)
    return np.asarray(file[name][()])


def changed_node(file: Any, name: str, rng: np.random.Generator) -> None:
    """Change one group or dataset, or an attribute of it or of a group that holds it."""
    node = file[name]
    kind = int(rng.integers(10))
    shape = node.shape if isinstance(node, h5py.Dataset) else (3,)
    if kind == 3 and node.size > MAX_VALUES_READ:
        _change_attribute(file, name, rng)
    elif kind < len(NODE_CHANGES):
        NODE_CHANGES[kind](file, name, shape, rng)
    else:
        _change_attribute(file, name, rng)


def _change_type(file: Any, name: str, shape: Shape, rng: np.random.Generator) -> None:
    """Store the same numbers as another type, or as something that is no number."""
    values = _values(file, name)
    types = ("f2", "f4", "f8", "g", "i1", "u8", ">f8", "S8", "c16", "b1", "V8")
    dtype = choose(types, rng)
    _replaced(file, name, np.zeros(values.shape, dtype) if dtype == "V8" else values.astype(dtype))


def _change_shape(file: Any, name: str, shape: Shape, rng: np.random.Generator) -> None:
    """Store one axis more or less, a longer or an empty one; a scalar; or nothing at all."""
    values = _values(file, name)
    shapes = (
        values[None],
        values[:0],
        values.ravel()[:1].reshape(()),
        np.concatenate([values, values]),
        values.T,
    )
    _replaced(file, name, choose((*shapes, values[..., 0], h5py.Empty("f8")), rng))


def _claim_frames(file: Any, name: str, shape: Shape, rng: np.random.Generator) -> None:
    """Claim up to a million million frames that are not there."""
    claimed = (10 ** int(rng.integers(3, 13)), *shape[1:])
    dtype = choose(("f8", "S16", "u1"), rng) if rng.random() < 0.3 else file[name].dtype
    _replaced(
        file,
        name,
        shape=claimed,
        dtype=dtype,
        chunks=(1024, *shape[1:]),
        compression="gzip",
        fillvalue=1,
    )


def _change_value(file: Any, name: str, shape: Shape, rng: np.random.Generator) -> None:
    """Store no number, an infinite, zero, negative, huge or tiny one: once or everywhere."""
    node = file[name]
    value = choose((np.nan, np.inf, -np.inf, 0, -1, 1e308, 5e-324, 2**63), rng)
    index = ... if rng.random() < 0.3 else tuple(int(rng.integers(size)) for size in shape)
    node[index] = np.asarray(value).astype(node.dtype)


def _store_text(file: Any, name: str, shape: Shape, rng: np.random.Generator) -> None:
    """Store a text: of variable length, long, not ASCII, nested YAML."""
    texts = (
        "text",
        "é" * 10,
        "x" * 100_000,
        "\n",
        "{" * 1000,
        "a: &a [*a]",
        json.dumps(SCENE),
        "!!python/object:os.system {}",
        choose(NASTY_TEXTS, rng).replace("\0", ""),
    )
    text = choose(texts, rng)
    is_variable = rng.random() < 0.5
    _replaced(file, name, text if is_variable else np.bytes_(text.encode("utf-8", "replace")))


def _store_link(file: Any, name: str, shape: Shape, rng: np.random.Generator) -> None:
    """Link to nowhere, to itself, to an ancestor, to another file or to the machine's files."""
    layout = h5py.VirtualLayout(shape=shape, dtype="f8")
    layout[...] = h5py.VirtualSource("small.h5", "/entry/two_point/resistance", shape=shape)
    outside = h5py.ExternalLink(choose(("/etc/passwd", "/dev/zero", "small.h5"), rng), f"/{name}")
    soft = map(h5py.SoftLink, ("/nowhere", f"/{name}", "/"))
    target = choose((*soft, h5py.ExternalLink("small.h5", "/entry"), outside, layout, None), rng)
    if target is None:
        _replaced(file, name, shape=shape, dtype="f8", external=[("/dev/zero", 0, 10**6)])
        return
    del file[name]
    if target is layout:
        file.create_virtual_dataset(name, layout)
    else:
        file[name] = target


def _exchange_kind(file: Any, name: str, shape: Shape, rng: np.random.Generator) -> None:
    """Store a group in place of a dataset, or a number in place of a group."""
    is_dataset = isinstance(file[name], h5py.Dataset)
    del file[name]
    if is_dataset:
        file.create_group(name)
    else:
        file.create_dataset(name, data=5.0)


def _remove_or_rename(file: Any, name: str, shape: Shape, rng: np.random.Generator) -> None:
    """Remove a node, or move it to a name that is no usual one."""
    if rng.random() < 0.5:
        del file[name]
        return
    new_name = choose(("..", ".", "a\nb", "x" * 300, "é", " ", "recording", "\x1b[31m"), rng)
    file.move(name, f"{name.rpartition('/')[0]}/{new_name}")


def _change_attribute(file: Any, name: str, rng: np.random.Generator) -> None:
    """Remove an attribute of a node or of a group that holds it, or give it another value."""
    parts = name.split("/")
    holder = choose(
        [file, *(file["/".join(parts[: depth + 1])] for depth in range(len(parts)))], rng
    )
    further = (
        "readings",
        "order",
        "published",
        "lampest_unfinished",
        "lampest_format",
        "joint_start",
    )
    attribute = choose([*holder.attrs, *further], rng)
    value = choose(ATTRIBUTES, rng)
    if value is None:
        del holder.attrs[attribute]
    else:
        holder.attrs[attribute] = value


NODE_CHANGES = (
    _change_type,
    _change_shape,
    _claim_frames,
    _change_value,
    _store_text,
    _store_link,
    _exchange_kind,
    _remove_or_rename,
)
