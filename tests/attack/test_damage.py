"""Damaged files: what is read from them is what was written, or nothing is."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from attack.attack import HELD, Outcomes, Rng, Tries, attack, called, command, small_folder
from fuzz.mutants import good_recordings, good_results, without_checksums
from unclosed import unclosed_recording

from lampest import InputError, Panel, Recording, Scene, TwoPointReadout, read_results
from lampest.files.document import plain_content
from lampest.recording.board.record import repair

pytestmark = pytest.mark.slow
Reader = Callable[[Path], Any]
BITS_AT_ONCE = (1, 1, 1, 2, 8)
MOST_ADDRESSES = 3_000_000_000
FILES_AT_ONCE = 40  # of one command, which has two minutes for them however busy the machine is


def _flipped(name: str, reader: Reader, make: Callable[[Path], bytes]) -> Tries:
    def tries(rng: Rng, folder: Path, count: int) -> Outcomes:
        """A few bits of a file are turned: it is refused in a sentence, or read as what was written."""
        whole, path = make(folder), folder / name
        path.write_bytes(whole)
        meant = said(reader(path))
        for _ in range(count):
            damaged, bits = bytearray(whole), int(rng.choice(BITS_AT_ONCE))
            for bit in rng.integers(0, 8 * len(whole), bits):
                damaged[bit // 8] ^= 1 << (bit % 8)
            path.write_bytes(bytes(damaged))
            yield _outcome(path, reader, meant)

    return tries


def _cut(name: str, reader: Reader, make: Callable[[Path], bytes]) -> Tries:
    def tries(rng: Rng, folder: Path, count: int) -> Outcomes:
        """A file that ends early, lost a page in its middle, or has one twice."""
        whole, path = make(folder), folder / name
        path.write_bytes(whole)
        meant = said(reader(path))
        for _ in range(count):
            begin, length = int(rng.integers(0, len(whole))), int(rng.choice((1, 17, 512, 4096)))
            rest = whole[begin + length :]
            harm = str(rng.choice(("end", "gap", "twice", "zeros")))
            between = {"end": b"", "gap": rest, "twice": whole[begin:], "zeros": bytes(length) + rest}[harm]
            path.write_bytes(whole[:begin] + between)
            yield _outcome(path, reader, meant)

    return tries


def _outcome(path: Path, reader: Reader, meant: dict[str, Any]) -> str:
    try:
        read = said(reader(path))
    except InputError as error:
        return HELD if str(error).startswith(str(path)) else f"the sentence does not name the file: {error}"
    other = [name for name in meant if not _same(meant[name], read.get(name))]
    return f"read as another {', '.join(other)}" if other or len(meant) != len(read) else HELD


def said(thing: Any) -> dict[str, Any]:
    """All that a recording or results say, name → plain value or array."""
    if isinstance(thing, Recording):
        return {**vars(thing), "scene": repr(thing.scene), "acquisition": _plain(thing.acquisition)}
    found: dict[str, Any] = {"published": repr(plain_content(dict(thing.published)))}
    for case in thing.cases:
        for name, value in vars(case).items():
            found[f"{case.recording}/{case.estimator}/{name}"] = repr(value) if name == "scene" else value
    return found


def _plain(thing: Any) -> Any:
    return None if thing is None else dict(vars(thing))


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_same(one[key], other[key]) for key in one)
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes()
    return bool(one == other) or (one != one and other != other)


def _recording(folder: Path) -> bytes:
    return good_recordings(folder)[0]


def _unsealed(folder: Path) -> bytes:
    return bytes(without_checksums(good_recordings, folder)[0])


@attack()
def test_files_without_checksums_are_read_and_named_so(rng: Rng, folder: Path, count: int) -> Outcomes:
    made = small_folder(folder / "work")
    for name in ("small.h5", "results.h5"):
        ended = called("check", name, folder=made)
        yield HELD if ended.code == 0 and "as written" in ended.out else ended.said(f"{name} is not as written")
        with h5py.File(made / name, "a") as file:
            file["note"] = "mine"
        ended = called("check", name, folder=made)
        yield HELD if ended.code == 0 and "without checksums" in ended.out else ended.said(f"{name} is not read")
        yield HELD if called("info", name, folder=made).code == 0 else f"{name}: info refuses"


@attack()
def test_a_flipped_bit_in_any_dataset_is_named(rng: Rng, folder: Path, count: int) -> Outcomes:
    made = small_folder(folder / "work")
    with h5py.File(made / "small.h5") as file:
        places: dict[str, int] = {}
        file.visititems(
            lambda name, node: places.update({f"/{name}": place}) if (place := _place(node)) is not None else None
        )
    whole, meant = (made / "small.h5").read_bytes(), called("info", "small.h5", folder=made)
    for name, place in places.items():
        damaged = bytearray(whole)
        damaged[place] ^= 16
        (made / "small.h5").write_bytes(damaged)
        yield called("check", "small.h5", folder=made).refused("small.h5", f"{name} is damaged", "checksum")
        told = called("info", "small.h5", folder=made)
        yield HELD if told.out == meant.out else told.refused("small.h5", f"{name} is damaged", "checksum")


def _place(node: Any) -> int | None:
    """Where the values of a dataset begin in its file."""
    if not isinstance(node, h5py.Dataset):
        return None
    if node.chunks:
        return node.id.get_chunk_info(0).byte_offset + 9
    if (begin := node.id.get_offset()) is not None:
        return begin
    header = h5py.h5o.get_info(node.id).addr  # the values are in the metadata
    return Path(node.file.filename).read_bytes().index(node[()].tobytes(), header)


@attack(0, 400)
def test_damaged_sizes_in_files_without_checksums_crash_nothing(rng: Rng, folder: Path, count: int) -> Outcomes:
    """Bits turned in a file of an older version, read with little memory: a sentence or its numbers, never a crash."""
    whole = _unsealed(folder)
    structure = [place for place in range(len(whole)) if whole[place] not in (0, 255)][:6000]
    for first in range(0, count, FILES_AT_ONCE):
        names = [f"{number}.h5" for number in range(first, min(first + FILES_AT_ONCE, count))]
        for name in names:
            damaged = bytearray(whole)
            damaged[int(rng.choice(structure))] ^= 1 << int(rng.integers(8))
            (folder / name).write_bytes(damaged)
        ended = command("check", *names, folder=folder, seconds=120, addresses=MOST_ADDRESSES)
        fine = ended.code in (0, 2) and "Traceback" not in ended.err and ended.peak < 1e9
        for name in names:
            (folder / name).unlink(missing_ok=True)
            yield HELD if fine else ended.said("an older file, damaged")


@attack(20, 400)
def test_a_damaged_unclosed_recording_is_refused_or_read_as_it_was(rng: Rng, folder: Path, count: int) -> Outcomes:
    """A killed recorder's file, damaged: refused or read as it was; repair keeps only what was written."""
    path = unclosed_recording(folder / "e.h5", Scene(Panel(3, 4), TwoPointReadout(), 140.0), 12, unloaded=3)
    whole, meant = path.read_bytes(), Recording.load(path)
    for _ in range(count):
        damaged, harm = bytearray(whole), str(rng.choice(("bit", "bit", "tail", "page")))
        if harm == "bit":
            damaged[int(rng.integers(len(whole)))] ^= 1 << int(rng.integers(8))
        else:
            begin = int(rng.integers(len(whole)))
            end = len(whole) if harm == "tail" else min(begin + 512, len(whole))
            damaged[begin:end] = bytes(end - begin)
        path.write_bytes(damaged)
        outcome = _outcome(path, Recording.load, said(meant))
        yield outcome if outcome != HELD else _repaired(path, meant)


def _repaired(path: Path, meant: Recording) -> str:
    left = path.read_bytes()
    try:
        frames, dropped = repair(path)
    except InputError:
        return HELD if path.read_bytes() == left else "repair refused, and changed the file"
    found = Recording.load(path)
    kept = found.acquisition.sequence
    if frames + dropped != len(meant.time) or len(kept) != frames:
        return f"repair kept {frames} and dropped {dropped} of {len(meant.time)} frames"
    same = found.recorded.tobytes() == meant.recorded[kept].tobytes()
    same = (
        same and np.array_equal(found.raw_sums, meant.raw_sums[kept]) and np.array_equal(found.time, meant.time[kept])
    )
    return HELD if same else "repair changed what it kept"


test_flipped_bits_of_a_recording_are_noticed = attack(100, 2500)(_flipped("a.h5", Recording.load, _recording))


test_flipped_bits_of_results_are_noticed = attack(50, 2500)(_flipped("b.h5", read_results, good_results))


test_lost_or_doubled_pages_of_a_recording_are_noticed = attack(40, 400)(_cut("c.h5", Recording.load, _recording))


test_lost_or_doubled_pages_of_results_are_noticed = attack(20, 400)(_cut("d.h5", read_results, good_results))
