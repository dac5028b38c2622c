"""Damaged files: they are read as they were written, or refused."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from attack.attack import PASSED, SEED, Outcomes, Rng, Tries, attack, called, small_folder, unless
from fuzz.mutants import good_recordings, good_results
from support import invented_case
from unclosed import unclosed_recording

from lampest import (
    InputError,
    Panel,
    Recording,
    Scene,
    TwoPointReadout,
    read_results,
    write_results,
)
from lampest.apps.board.journal import repair
from lampest.files import hdf5
from lampest.files.checksums import BLOCKS, DATASETS, nodes_below
from lampest.files.document import plain_content

pytestmark = pytest.mark.slow
HARMS = ("bits", "bits", "end", "gap", "twice", "zeros")


def _harmed(rng: Rng, content: bytes) -> bytes:
    """Some bits are turned, the end is cut off, or pages are lost, doubled or zero."""
    harm = str(rng.choice(HARMS))
    begin = int(rng.integers(len(content)))
    length = int(rng.choice((1, 17, 512, 4096)))
    if harm != "bits":
        following = content[begin + length :]
        parts = {
            "end": b"",
            "gap": following,
            "twice": content[begin:],
            "zeros": bytes(len(content[begin:]) - len(following)) + following,
        }
        return content[:begin] + parts[harm]
    damaged = bytearray(content)
    for bit in rng.integers(0, 8 * len(content), int(rng.choice((1, 1, 1, 2, 8)))):
        damaged[bit // 8] ^= 1 << (bit % 8)
    return bytes(damaged)


def _damaged(reader: Callable[[Path], Any], make: Callable[[Path], bytes]) -> Tries:
    def tries(rng: Rng, folder: Path, count: int) -> Outcomes:
        content = make(folder)
        path = folder / "a.h5"
        path.write_bytes(content)
        meant = _content(reader(path))
        for _ in range(count):
            path.write_bytes(_harmed(rng, content))
            yield _outcome(path, reader, meant)

    return tries


def _outcome(path: Path, reader: Callable[[Path], Any], meant: dict[str, Any]) -> str:
    try:
        read = _content(reader(path))
    except InputError as error:
        return unless(
            str(error).startswith(str(path)), f"the sentence does not name the file: {error}"
        )
    differing = [name for name in meant | read if not _same(meant.get(name), read.get(name))]
    return f"read with another {', '.join(differing)}" if differing else PASSED


def _content(source: Any) -> dict[str, Any]:
    """All of a recording or of results, name → plain value or array."""
    if isinstance(source, Recording):
        return {
            **vars(source),
            "scene": repr(source.scene),
            "acquisition": source.acquisition and vars(source.acquisition),
        }
    content: dict[str, Any] = {"published": repr(plain_content(dict(source.published)))}
    for case in source.cases:
        for name, value in vars(case).items():
            content[f"{case.recording}/{case.estimator}/{name}"] = (
                repr(value) if name == "scene" else value
            )
    return content


def _same(first: Any, second: Any) -> bool:
    if isinstance(first, dict) and isinstance(second, dict):
        return first.keys() == second.keys() and all(
            _same(first[key], second[key]) for key in first
        )
    if isinstance(first, np.ndarray) and isinstance(second, np.ndarray):
        pair = [(array.dtype, array.shape, array.tobytes()) for array in (first, second)]
        return pair[0] == pair[1]
    return bool(first == second) or (first != first and second != second)


test_damage_of_a_recording_is_noticed = attack(140, 2900)(
    _damaged(Recording.load, lambda folder: good_recordings(folder)[0])
)
test_damage_of_results_is_noticed = attack(70, 2900)(_damaged(read_results, good_results))


@attack()
def test_check_names_the_dataset_with_a_flipped_bit(rng: Rng, folder: Path, count: int) -> Outcomes:
    work_folder = small_folder(folder / "work")
    places = dict[str, int]()
    with h5py.File(work_folder / "small.h5") as file:
        file.visititems(
            lambda name, node: (
                places.update({name: _place(node)}) if isinstance(node, h5py.Dataset) else None
            )
        )
    content = (work_folder / "small.h5").read_bytes()
    meant = called("info", "small.h5", folder=work_folder)
    for name, place in places.items():
        damaged = bytearray(content)
        damaged[place] ^= 16
        (work_folder / "small.h5").write_bytes(damaged)
        words = ("small.h5", f"/{name} is damaged", "checksum")
        yield called("check", "small.h5", folder=work_folder).refused(*words)
        described = called("info", "small.h5", folder=work_folder)
        yield PASSED if described.out == meant.out else described.refused(*words)


def _place(node: h5py.Dataset) -> int:
    """Where the values of a dataset begin in its file."""
    if node.chunks:
        return int(node.id.get_chunk_info(0).byte_offset + 9)
    if (begin := node.id.get_offset()) is not None:
        return int(begin)
    header = h5py.h5o.get_info(node.id).addr  # the values are in the metadata
    return Path(node.file.filename).read_bytes().index(node[()].tobytes(), header)


def _long_recording(
    path: Path, rng: Rng, shape: tuple[int, int, int], series_ohm: float = 0.0
) -> Path:
    """A recording of several chunks; smooth readings are packed, noisy ones are not."""
    role = np.ones(shape[0], dtype=np.uint8)
    role[:3] = 0
    values = rng.uniform(500, 5000, shape).round(9 * (shape[1] % 2))
    Recording(
        Scene(Panel(*shape[1:]), TwoPointReadout(), series_ohm),
        values,
        np.arange(float(shape[0])),
        role,
    ).save(path)
    return path


def _results(path: Path, rng: Rng, shape: tuple[int, int, int]) -> Path:
    write_results(path, [invented_case("LSM", "a", shape)])
    return path


@attack(8, 100)
def test_check_names_zeroed_exchanged_and_foreign_chunks(
    rng: Rng, folder: Path, count: int
) -> Outcomes:
    """HDF5's own checksums pass them: a Fletcher sum of zeros is zero, and it knows no position."""
    for number in range(count):
        make, load = ((_long_recording, Recording.load), (_results, read_results))[number % 2]
        rows, columns = rng.integers(2, 11, 2).tolist()
        shape = (int(rng.uniform(2, 3) * hdf5.CHUNK / (rows * columns)), rows, columns)
        path = make(folder / "a.h5", rng, shape)
        foreign_path = make(folder / "b.h5", rng, shape)
        meant = _content(load(path))
        with h5py.File(path, "r+") as file, h5py.File(foreign_path) as foreign:
            name = _harmed_chunk(rng, file, foreign)
        yield called("check", path).refused(name) or _outcome(path, load, meant)


def _harmed_chunk(rng: Rng, file: h5py.File, foreign: h5py.File) -> str:
    """Zero, exchange or replace a chunk with a right Fletcher sum.

    Return the path of its dataset.
    """
    nodes = dict(nodes_below(file, "/"))
    long = [
        name for name, node in nodes.items() if getattr(node, "chunks", None) and np.any(node[-1])
    ]
    harms = [(name, harm) for name in long for harm in ("zeroed", "exchanged", "foreign")]
    while True:
        name, harm = harms[rng.integers(len(harms))]
        node = nodes[name]
        original = nodes[name][()]
        places = [
            node.id.get_chunk_info(index).chunk_offset for index in range(node.id.get_num_chunks())
        ]
        first = places[int(rng.integers(len(places)))]
        last = places[-1]
        if harm == "zeroed":  # with the sum alone, because zeros cannot be unpacked
            packing = node.id.get_create_plist()
            filters = [packing.get_filter(index)[0] for index in range(packing.get_nfilters())]
            mask = sum(
                1 << index
                for index, kind in enumerate(filters)
                if kind != h5py.h5z.FILTER_FLETCHER32
            )
            node.id.write_direct_chunk(
                last, bytes(int(np.prod(node.chunks)) * node.dtype.itemsize + 4), mask
            )
        elif harm == "exchanged":
            held = [node.id.read_direct_chunk(place) for place in (first, last)]
            for place, (mask, values) in zip((last, first), held, strict=True):
                node.id.write_direct_chunk(place, values, mask)
        else:
            mask, values = foreign[name].id.read_direct_chunk(first)
            node.id.write_direct_chunk(first, values, mask)
        try:
            if np.array_equal(node[()], original):
                continue
        except OSError:  # noticed by HDF5 itself
            pass
        return name


@attack(4, 40)
def test_check_notices_exchanged_and_foreign_datasets(
    rng: Rng, folder: Path, count: int
) -> Outcomes:
    """Each is as it was written, but not all of them together."""
    for _ in range(count):
        path, foreign_path = (
            _long_recording(folder / name, rng, (20, 3, 4)) for name in ("a.h5", "b.h5")
        )
        with h5py.File(path, "r+") as file, h5py.File(foreign_path) as foreign:
            group = file["entry/two_point"]
            if rng.random() < 0.5:
                group.move("x", "z")
                group.move("y", "x")
                group.move("z", "y")
            else:
                del group["resistance"]
                foreign.copy("entry/two_point/resistance", group)
        yield called("check", path).refused("datasets were added, removed or exchanged")


def test_the_header_of_another_recording_is_refused_by_every_reader(tmp_path: Path) -> None:
    """A sector of 512 bytes has the scene; a run took that of the other recording."""
    path, foreign_path = (
        _long_recording(tmp_path / f"{name}.h5", np.random.default_rng(SEED), (20, 3, 4), series)
        for name, series in (("a", 100.0), ("b", 200.0))
    )
    content = path.read_bytes()
    foreign = foreign_path.read_bytes()
    assert len(content) == len(foreign)
    refused = 0
    for first in range(0, 4096, 512):
        path.write_bytes(content[:first] + foreign[first : first + 512] + content[first + 512 :])
        try:
            assert np.all(Recording.load(path).scene.series_ohm == 100.0), first
        except InputError as error:
            assert "datasets were added, removed or exchanged" in str(error)
            assert called("info", path).code == 2
            refused += 1
    assert refused


def test_the_documented_edit_of_values_leaves_a_file_that_check_accepts(tmp_path: Path) -> None:
    path = _long_recording(tmp_path / "a.h5", np.random.default_rng(SEED), (20, 3, 4))
    with h5py.File(path, "r+") as file:
        dataset = file["entry/two_point/resistance"]
        dataset[0, 0, 0] = 1234.5
        del dataset.attrs[BLOCKS], file.attrs[DATASETS]
    completed = called("check", path)
    assert completed.code == 0 and "/entry/two_point/resistance" in completed.out
    assert Recording.load(path).recorded[0, 0, 0] == 1234.5


@pytest.mark.parametrize("growing", [{}, {"maxshape": (None,)}])
def test_check_does_not_visit_a_billion_declared_chunks(
    tmp_path: Path, growing: dict[str, Any]
) -> None:
    """HDF5 counted them for minutes, and Python for hours."""
    path = _long_recording(tmp_path / "a.h5", np.random.default_rng(SEED), (20, 3, 4))
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        file["entry"].create_dataset("mine", (10**9,), "f8", chunks=(1,), **growing)
    completed = called("check", path)
    assert completed.code == 2 and "/entry/mine is damaged (it declares 1000000000 chunks" in (
        completed.err
    )


@pytest.mark.parametrize("readings", [-20, 1e9, 2.5])
def test_an_impossible_number_of_readings_is_refused(tmp_path: Path, readings: float) -> None:
    """A traceback where the recording was written again."""
    sums = np.full((4, 3, 4), 9000, dtype=np.uint16)
    recording = Recording(
        Scene(Panel(3, 4), TwoPointReadout(readings=20), 140.0),
        np.full((4, 3, 4), 700.0),
        np.arange(4.0),
        np.array([0, 1, 1, 1], dtype=np.uint8),
        raw_sums=sums,
        raw_readings=20,
    )
    path = tmp_path / "a.h5"
    recording.save(path)
    with h5py.File(path, "r+") as file:
        file["entry/raw"].attrs["readings"] = readings
    for words in (("info", path), ("tare", path, "--frames", "0:1", "--out", tmp_path / "b.h5")):
        completed = called(*words)
        assert completed.code == 2 and "/entry/raw@readings must be a whole number" in completed.err
    assert not (tmp_path / "b.h5").exists()


def test_check_names_datasets_without_digests_or_checksums(tmp_path: Path) -> None:
    """Files of older versions are read; `check` names the damage that checksums do not notice."""
    path = _long_recording(tmp_path / "a.h5", np.random.default_rng(SEED), (20, 3, 4))
    with h5py.File(path, "r+") as file:
        for _, node in nodes_below(file, "/"):
            for name in {BLOCKS, DATASETS} & {*node.attrs}:
                del node.attrs[name]
    completed = called("check", path)
    assert completed.code == 0 and "as written" not in completed.out
    assert "neither zeroed nor exchanged values (no digests: /entry/scene, " in completed.out
    assert len(Recording.load(path).time) == 20
    with h5py.File(path, "r+") as file:
        file["entry/mine"] = 1.0
    completed = called("check", path)
    assert (
        completed.code == 0
        and "readable, but without checksums" in completed.out
        and "/entry/mine" in completed.out
    )


@attack(20, 400)
def test_a_damaged_unclosed_recording_is_refused_or_read_unchanged(
    rng: Rng, folder: Path, count: int
) -> Outcomes:
    """A killed recorder's file, damaged: refused or read as it was."""
    path = unclosed_recording(
        folder / "e.h5", Scene(Panel(3, 4), TwoPointReadout(), 140.0), 12, unloaded=3
    )
    content = path.read_bytes()
    meant = Recording.load(path)
    for _ in range(count):
        path.write_bytes(_harmed(rng, content))
        outcome = _outcome(path, Recording.load, _content(meant))
        yield outcome if outcome != PASSED else _repaired(path, meant)


@attack(6, 200)
def test_repair_takes_no_frames_of_another_recording(
    rng: Rng, folder: Path, count: int
) -> Outcomes:
    """The end of a journal is that of another one of the same scene."""
    scene = Scene(Panel(3, 4), TwoPointReadout(), 140.0)
    for number in range(count):
        frames = int(rng.integers(20, 60))
        places = [folder / f"{number}{name}" for name in "ab"]
        for place in places:
            place.mkdir()
        path, foreign_path = (
            unclosed_recording(place / "e.h5", scene, frames, unloaded=3, seed=seed)
            for seed, place in enumerate(places)
        )
        meant = Recording.load(path)
        content = path.read_bytes()
        tail = foreign_path.read_bytes()
        cut = int(rng.integers(len(content) // 4, len(content)))
        path.write_bytes(content[:cut] + tail[cut:])
        outcome = _outcome(path, Recording.load, _content(meant))
        yield outcome if outcome != PASSED else _repaired(path, meant)


def _repaired(path: Path, meant: Recording) -> str:
    damaged = path.read_bytes()
    try:
        frames, dropped = repair(path)
    except InputError:
        return PASSED if path.read_bytes() == damaged else "repair refused, and changed the file"
    recording = Recording.load(path)
    sequence = recording.acquisition.sequence
    if frames + dropped != len(meant.time) or len(sequence) != frames:
        return f"repair kept {frames} and dropped {dropped} of {len(meant.time)} frames"
    unchanged = all(
        _same(getattr(recording, name), getattr(meant, name)[sequence])
        for name in ("recorded", "raw_sums", "time")
    )
    return PASSED if unchanged else "repair changed what it kept"
