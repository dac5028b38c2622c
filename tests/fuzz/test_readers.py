"""Whatever a file holds: it is taken, or refused with one sentence.

`ATTACK_SEED=2 python -m pytest -m soak tests/fuzz tests/attack` tries other files, and many more.
"""

import io
import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from attack.attack import SEED
from fuzz.mutants import KINDS, RUN, Corpus, Mutant, corpus
from fuzz.readers import REFUSED, TAKEN, cleared, receive
from hypothesis import given, settings
from hypothesis import strategies as st

from lampest import InputError, LoadedColumnsReadout, Panel, Recording, Scene, import_file, read_run
from lampest.files.checksums import DATASETS
from lampest.files.document import MAX_SIZE, parse_document
from lampest.panel.readouts import TwoPointReadout
from lampest.runs.case import check_name

# Other files contain the time at which they were written.
TEXTS = ("run", "scene", "simulation", "setting", "table")
QUICK = settings(derandomize=True, deadline=None, database=None, max_examples=100)
FIELDS = (
    "ovf",
    "nan",
    "inf",
    "-",
    "OL",
    "",
    "x3",
    "time",
    "t [ms]",
    "r0c0",
    "R1C1",
    "row",
    "col",
    "value",
    "frame",
    "cell",
    "R [kOhm]",
    "12:34:56.789",
    "2025-01-31T12:00:00",
    "24.12.2025",
    "1,5",
    "1.234,5",
    "1e5",
    "-3",
    "0",
    "1",
    "2",
    "512",
    "0.3",
    "#",
    "% c",
    "Frame 3",
    "t=5",
    "c1",
    "r2",
    "MΩ",
    "[V]",
    '"a"',
    '"',
    "1_0",
    "0x1",
    "9" * 30,
    "1e999",
    "--",
    "a b",
    "\t",
    ";",
    "->",
    "[12:00:00] 5",
    "date",
    "2025-13-45",
    "(0, 3)",
    "k",
    "timestamp",
    "1700000000",
    "1e300",
    "4294967295",
    "[1, 2]",
    "\u2028",
    "\x1b",
)
odd_rows = st.lists(st.sampled_from(FIELDS), max_size=9)
numbers = (
    st.floats(200, 900).map("{:.2f}".format)
    | st.integers(200, 900).map(str)
    | st.sampled_from(FIELDS)
)
tables = st.sampled_from([1, 3, 4, 6, 7, 12]).flatmap(
    lambda width: st.lists(st.lists(numbers, min_size=width, max_size=width) | odd_rows, max_size=9)
)
KNOWN = (
    None,
    Scene(Panel(2, 3), TwoPointReadout()),
    Scene(Panel(2, 3), LoadedColumnsReadout(load_ohm=10_000.0)),
)
HOSTILE = {
    "object": "schema: !!python/object/apply:os.system ['touch owned']",
    "object in a list": "recordings: [!!python/name:os.system ]",
    "laughs": "a: &a [1,1,1,1,1,1,1,1,1,1]\n"
    + "".join(
        f"{chr(98 + i)}: &{chr(98 + i)} [{','.join(['*' + chr(97 + i)] * 10)}]\n" for i in range(9)
    ),
    "merges": "a: &a {x: 1}\n"
    + "".join(
        f"{chr(98 + i)}: &{chr(98 + i)} {{<<: [{','.join(['*' + chr(97 + i)] * 10)}]}}\n"
        for i in range(9)
    ),
    "itself": "&a {schema: *a}",
    "brackets": "a: " + "[" * 50_000,
    "braces": "{a: " * 20_000,
    "dashes": "- " * 20_000,
    "long": "a: [" + "1," * MAX_SIZE + "]",
    "hexadecimal": "schema: 0x" + "f" * 50_000,
    "decimal": "schema: " + "9" * 50_000,
    "anchor twice": "- &a 1\n- &a 2\n",
    "key of two lines": '"a\\nb": 1',
    "key that rings": '"\\a\\e[31m": 1',
    "half a sign": '"\\ud800": 1',
    "all folders": json.dumps({**RUN, "recordings": ["/**"]}),
    "all folders below": json.dumps({**RUN, "recordings": ["/usr/**.h5"]}),
    "no name": json.dumps({**RUN, "recordings": [""]}),
    "long name": json.dumps({**RUN, "recordings": ["a" * 5000 + "/*.h5"]}),
    "zero byte": json.dumps({**RUN, "recordings": ["a\0b.h5"]}),
    "no end of zeros": json.dumps({**RUN, "recordings": ["/dev/zero"]}),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


@pytest.fixture(scope="module")
def good(folder: Path) -> Corpus:
    seeds = corpus(folder)
    cleared(folder)
    return seeds


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_good_files_are_accepted(good: Corpus, folder: Path, kind: str) -> None:
    for content in good.files[kind]:
        assert receive(Mutant(kind, content), folder) == TAKEN


@pytest.mark.parametrize(
    "count", [pytest.param(40, marks=pytest.mark.slow), pytest.param(2500, marks=pytest.mark.soak)]
)
@pytest.mark.parametrize("kind", KINDS)
def test_mutated_files_are_accepted_or_refused(
    good: Corpus, folder: Path, kind: str, count: int
) -> None:
    """The number of an input stands for the same one in every process."""
    second_corpus = corpus(folder)
    cleared(folder)
    for number in np.random.default_rng(SEED).integers(2**31, size=count).tolist():
        mutant = good.mutant(number, kind)
        assert kind not in TEXTS or mutant == second_corpus.mutant(number, kind)
        assert receive(mutant, folder) in (TAKEN, REFUSED), number


@pytest.mark.parametrize(
    "scene",
    [
        pytest.param(scene, id=name, marks=[pytest.mark.slow] * (name != "divider"))
        for name, scene in zip(("none", "divider", "loaded"), KNOWN, strict=True)
    ],
)
@given(
    tables,
    st.sampled_from([",", ";", "\t", " ", ", "]),
    st.sampled_from(["\n", "\r\n", "\r"]),
    st.sampled_from(["utf-8", "utf-16", "utf-8-sig"]),
    st.sampled_from(["mark", "skip-frame", "refuse"]),
)
@QUICK
def test_any_table_is_accepted_or_refused_with_one_sentence(
    tmp_path_factory: pytest.TempPathFactory,
    scene: Scene | None,
    rows: list[list[str]],
    sign: str,
    end: str,
    encoding: str,
    missing: str,
) -> None:
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes(end.join(map(sign.join, rows)).encode(encoding))
    try:
        recording, notes = import_file(path, 2, 3, scene, missing=missing)
    except InputError as error:
        assert str(error).isprintable() and len(str(error)) < 1000
        return
    recording.readings()
    assert recording.recorded.shape[1:] == (2, 3) and np.all(np.diff(recording.time) > 0)
    assert all(note.isprintable() for note in notes)


@pytest.mark.slow
@given(st.text(max_size=40))
@QUICK
def test_any_name_is_usable_in_a_path_or_refused(name: str) -> None:
    """A name that is accepted is one part of a path and leads nowhere else."""
    try:
        check_name(name, "recording")
    except InputError:
        return
    inside = Path("/results") / name
    assert inside.parent == Path("/results") and inside.name == name == inside.resolve().name


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)
def test_hostile_yaml_is_refused(
    good: Corpus, folder: Path, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    assert receive(Mutant("run", text.encode()), folder) == REFUSED
    assert not (folder / "owned").exists()


def test_an_endless_file_as_a_run_is_refused() -> None:
    with pytest.raises(InputError, match="larger than"):
        read_run(Path("/dev/zero"))
    with pytest.raises(InputError, match="larger than"):
        parse_document("a" * (MAX_SIZE + 1), "text")


@pytest.mark.parametrize("frames", [10**9, 10**15])
@pytest.mark.parametrize("names", [("resistance", "time", "role", "sigma"), ("time",), ("role",)])
def test_a_recording_that_claims_many_frames_is_refused(
    good: Corpus, folder: Path, names: tuple[str, ...], frames: int
) -> None:
    """No memory of that size is touched."""
    stream = io.BytesIO(good.files["recording"][0])
    with h5py.File(stream, "a") as file:
        for name in (f"entry/two_point/{name}" for name in names):
            kind = file[name].dtype
            shape = (frames, 3, 4) if file[name].ndim > 1 else (frames,)
            del file[name]
            file.create_dataset(
                name, shape, kind, chunks=(1000, *shape[1:]), compression="gzip", fillvalue=1
            )
    assert receive(Mutant("recording", stream.getvalue()), folder) == REFUSED


def external(file: h5py.File, name: str) -> None:
    file.create_dataset(name, (3, 3, 4), "f8", external=[("other.h5", 0, 288)])


OUTSIDE = {
    "another file": lambda file, name: file.__setitem__(name, h5py.ExternalLink("other.h5", name)),
    "a device": lambda file, name: file.__setitem__(name, h5py.ExternalLink("/dev/zero", name)),
    "a link to a link": lambda file, name: file.__setitem__(name, h5py.SoftLink("/out")),
    "values elsewhere": external,
}


@pytest.mark.parametrize("link", OUTSIDE.values(), ids=OUTSIDE)
@pytest.mark.parametrize(
    "name", ["/entry/two_point/resistance", "/entry/scene", "/entry/acquisition"]
)
def test_readers_read_nothing_outside_the_file(
    good: Corpus, tmp_path: Path, link: Any, name: str
) -> None:
    path = tmp_path / "linked.h5"
    path.write_bytes(good.files["recording"][0])
    (tmp_path / "other.h5").write_bytes(good.files["recording"][0])
    with h5py.File(path, "a") as file:
        del file[name]
        file["out"] = h5py.ExternalLink("other.h5", name)
        link(file, name)
        del file.attrs[DATASETS]  # a file of other programs has no digest of its datasets
    with pytest.raises(InputError, match="another file"):
        Recording.load(path)
