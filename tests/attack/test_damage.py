"""Damaged files: they are read as they were written, or refused."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from attack.attack import HELD, Outcomes, Rng, Tries, attack, called, small_folder
from fuzz.mutants import good_recordings, good_results
from unclosed import unclosed_recording

from lampest import InputError, Panel, Recording, Scene, TwoPointReadout, read_results
from lampest.files.document import plain_content
from lampest.recording.board.record import repair

pytestmark = pytest.mark.slow
HARMS = ("bits", "bits", "end", "gap", "twice", "zeros")


def _harmed(rng: Rng, whole: bytes) -> bytes:
    """Some bits are turned, the end is cut off, or pages are lost, doubled or zero."""
    harm, begin, length = str(rng.choice(HARMS)), int(rng.integers(len(whole))), int(rng.choice((1, 17, 512, 4096)))
    if harm != "bits":
        rest = whole[begin + length :]
        parts = {"end": b"", "gap": rest, "twice": whole[begin:], "zeros": bytes(len(whole[begin:]) - len(rest)) + rest}
        return whole[:begin] + parts[harm]
    damaged = bytearray(whole)
    for bit in rng.integers(0, 8 * len(whole), int(rng.choice((1, 1, 1, 2, 8)))):
        damaged[bit // 8] ^= 1 << (bit % 8)
    return bytes(damaged)


def _damaged(reader: Callable[[Path], Any], make: Callable[[Path], bytes]) -> Tries:
    def tries(rng: Rng, folder: Path, count: int) -> Outcomes:
        whole, path = make(folder), folder / "a.h5"
        path.write_bytes(whole)
        meant = _content(reader(path))
        for _ in range(count):
            path.write_bytes(_harmed(rng, whole))
            yield _outcome(path, reader, meant)

    return tries


def _outcome(path: Path, reader: Callable[[Path], Any], meant: dict[str, Any]) -> str:
    try:
        read = _content(reader(path))
    except InputError as error:
        return HELD if str(error).startswith(str(path)) else f"the sentence does not name the file: {error}"
    differing = [name for name in meant | read if not _same(meant.get(name), read.get(name))]
    return f"read with another {', '.join(differing)}" if differing else HELD


def _content(source: Any) -> dict[str, Any]:
    """All of a recording or of results, name → plain value or array."""
    if isinstance(source, Recording):
        return {**vars(source), "scene": repr(source.scene), "acquisition": vars(source.acquisition)}
    content: dict[str, Any] = {"published": repr(plain_content(dict(source.published)))}
    for case in source.cases:
        for name, value in vars(case).items():
            content[f"{case.recording}/{case.estimator}/{name}"] = repr(value) if name == "scene" else value
    return content


def _same(first: Any, second: Any) -> bool:
    if isinstance(first, dict) and isinstance(second, dict):
        return first.keys() == second.keys() and all(_same(first[key], second[key]) for key in first)
    if isinstance(first, np.ndarray) and isinstance(second, np.ndarray):
        pair = [(array.dtype, array.shape, array.tobytes()) for array in (first, second)]
        return pair[0] == pair[1]
    return bool(first == second) or (first != first and second != second)


test_damage_of_a_recording_is_noticed = attack(140, 2900)(
    _damaged(Recording.load, lambda folder: good_recordings(folder)[0])
)
test_damage_of_results_is_noticed = attack(70, 2900)(_damaged(read_results, good_results))


@attack()
def test_a_flipped_bit_in_any_dataset_is_named(rng: Rng, folder: Path, count: int) -> Outcomes:
    made, places = small_folder(folder / "work"), dict[str, int]()
    with h5py.File(made / "small.h5") as file:
        file.visititems(
            lambda name, node: places.update({name: _place(node)}) if isinstance(node, h5py.Dataset) else None
        )
    whole, meant = (made / "small.h5").read_bytes(), called("info", "small.h5", folder=made)
    for name, place in places.items():
        damaged = bytearray(whole)
        damaged[place] ^= 16
        (made / "small.h5").write_bytes(damaged)
        words = ("small.h5", f"/{name} is damaged", "checksum")
        yield called("check", "small.h5", folder=made).refused(*words)
        described = called("info", "small.h5", folder=made)
        yield HELD if described.out == meant.out else described.refused(*words)


def _place(node: h5py.Dataset) -> int:
    """Where the values of a dataset begin in its file."""
    if node.chunks:
        return int(node.id.get_chunk_info(0).byte_offset + 9)
    if (begin := node.id.get_offset()) is not None:
        return int(begin)
    header = h5py.h5o.get_info(node.id).addr  # the values are in the metadata
    return Path(node.file.filename).read_bytes().index(node[()].tobytes(), header)


@attack(20, 400)
def test_a_damaged_unclosed_recording_is_refused_or_read_as_it_was(rng: Rng, folder: Path, count: int) -> Outcomes:
    """A killed recorder's file, damaged: refused or read as it was; repair keeps only what was written."""
    path = unclosed_recording(folder / "e.h5", Scene(Panel(3, 4), TwoPointReadout(), 140.0), 12, unloaded=3)
    whole, meant = path.read_bytes(), Recording.load(path)
    for _ in range(count):
        path.write_bytes(_harmed(rng, whole))
        outcome = _outcome(path, Recording.load, _content(meant))
        yield outcome if outcome != HELD else _repaired(path, meant)


def _repaired(path: Path, meant: Recording) -> str:
    damaged = path.read_bytes()
    try:
        frames, dropped = repair(path)
    except InputError:
        return HELD if path.read_bytes() == damaged else "repair refused, and changed the file"
    found = Recording.load(path)
    kept = found.acquisition.sequence
    if frames + dropped != len(meant.time) or len(kept) != frames:
        return f"repair kept {frames} and dropped {dropped} of {len(meant.time)} frames"
    same = all(_same(getattr(found, name), getattr(meant, name)[kept]) for name in ("recorded", "raw_sums", "time"))
    return HELD if same else "repair changed what it kept"
