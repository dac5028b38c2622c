"""Whatever a file holds: it is taken, or refused with one sentence.

The long version: python -m tests.fuzz --inputs 100000 --jobs 2.
"""

import io
import json
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from fuzz.mutants import KINDS, RUN, SUFFIXES, Corpus, Mutant, corpus
from fuzz.readers import FINE, REFUSED, cleared, receive
from hypothesis import given, settings
from hypothesis import strategies as st

from lampest.files.document import MAX_SIZE, parse_document
from lampest.files.errors import InputError
from lampest.recording.recording import Recording
from lampest.runs.case import check_name
from lampest.runs.config import read_run

ROOT = Path(__file__).parents[2]
QUICK = settings(derandomize=True, deadline=None, database=None, max_examples=100)
FEW = settings(QUICK, max_examples=25)
words = st.sampled_from([*RUN, *RUN["estimators"], "terms", "misfit", "weight", "kind", "lower", "<<", "*a", "&a"])
scalars = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20) | words
trees = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(words | st.text(max_size=8), inner, max_size=4)
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


@pytest.fixture(scope="module")
def good(folder: Path) -> Corpus:
    found = corpus(folder)
    cleared(folder)
    return found


@pytest.mark.parametrize("kind", SUFFIXES)
def test_good_files_are_taken(good: Corpus, folder: Path, kind: str) -> None:
    for content in good.files[kind]:
        assert receive(Mutant(kind, content), folder) == FINE


@pytest.mark.slow
@pytest.mark.parametrize("kind", SUFFIXES)
def test_nearly_good_files_are_taken_or_refused_in_one_sentence(good: Corpus, folder: Path, kind: str) -> None:
    outcomes = Counter(receive(good.mutant(number, kind), folder) for number in range(40))
    assert set(outcomes) == {FINE, REFUSED}


def test_numbers_stand_for_inputs(good: Corpus, folder: Path) -> None:
    again = corpus(folder)
    cleared(folder)
    for number in range(3 * len(KINDS)):
        if KINDS[number % len(KINDS)] in ("run", "scene", "simulation", "setting", "table"):
            assert good.mutant(number) == again.mutant(number)


@pytest.mark.slow
@given(trees)
@QUICK
def test_any_tree_as_a_run_is_taken_or_refused(good: Corpus, folder: Path, tree: Any) -> None:
    run = Mutant("run", json.dumps({**RUN, "estimators": tree}).encode())
    simulation = Mutant("simulation", json.dumps({"schema": 1, "seed": 1, "scene": tree}).encode())
    assert {receive(mutant, folder) for mutant in (run, simulation)} <= {FINE, REFUSED}


@pytest.mark.slow
@given(st.binary(max_size=200) | st.text(max_size=200).map(lambda text: text.encode("utf-8", "surrogatepass")))
@FEW
def test_any_bytes_as_any_file_are_taken_or_refused(good: Corpus, folder: Path, content: bytes) -> None:
    assert {receive(Mutant(kind, content), folder) for kind in SUFFIXES} <= {FINE, REFUSED}


@given(st.text(max_size=40))
@QUICK
def test_any_name_is_a_part_of_a_path_or_refused(name: str) -> None:
    """A name that is accepted is one part of a path and leads nowhere else."""
    try:
        check_name(name, "recording")
    except InputError:
        return
    inside = Path("/results") / name
    assert inside.parent == Path("/results") and inside.name == name == inside.resolve().name


@pytest.mark.parametrize(
    "name", ["..", ".", "../x", "a/b", "/etc", "", " x", "x\n", "x" * 201, "ü", "\x00", "\x1b[31m"]
)
def test_names_that_lead_elsewhere(name: str) -> None:
    with pytest.raises(InputError) as refused:
        check_name(name, "recording")
    assert str(refused.value).isprintable()


HOSTILE = {
    "object": "schema: !!python/object/apply:os.system ['touch owned']",
    "object in a list": "recordings: [!!python/name:os.system ]",
    "laughs": "a: &a [1,1,1,1,1,1,1,1,1,1]\n"
    + "".join(f"{chr(98 + i)}: &{chr(98 + i)} [{','.join(['*' + chr(97 + i)] * 10)}]\n" for i in range(9)),
    "merges": "a: &a {x: 1}\n"
    + "".join(f"{chr(98 + i)}: &{chr(98 + i)} {{<<: [{','.join(['*' + chr(97 + i)] * 10)}]}}\n" for i in range(9)),
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


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)
def test_hostile_yaml_is_refused(good: Corpus, folder: Path, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    assert receive(Mutant("run", text.encode()), folder) == REFUSED
    assert not (folder / "owned").exists()


def test_an_endless_file_as_a_run_is_refused() -> None:
    with pytest.raises(InputError, match="larger than"):
        read_run(Path("/dev/zero"))
    with pytest.raises(InputError, match="larger than"):
        parse_document("a" * (MAX_SIZE + 1), "text")


@pytest.mark.parametrize("frames", [10**9, 10**15])
@pytest.mark.parametrize("dataset", ["resistance", "time", "role"])
def test_recording_that_claims_many_frames(good: Corpus, folder: Path, dataset: str, frames: int) -> None:
    """It is refused, and nothing of that size is touched."""
    claims = io.BytesIO(good.files["recording"][0])
    with h5py.File(claims, "a") as file:
        for name in (dataset,) if dataset != "resistance" else ("resistance", "time", "role", "sigma"):
            shape = (frames, 3, 4) if name in ("resistance", "sigma") else (frames,)
            kind = file[f"entry/two_point/{name}"].dtype
            del file[f"entry/two_point/{name}"]
            file.create_dataset(
                f"entry/two_point/{name}", shape, kind, chunks=(1000, *shape[1:]), compression="gzip", fillvalue=1
            )
    assert receive(Mutant("recording", claims.getvalue()), folder) == REFUSED


OUTSIDE = {
    "another file": lambda file, name: h5py.ExternalLink("other.h5", name),
    "a device": lambda file, name: h5py.ExternalLink("/dev/zero", name),
    "a link to a link": lambda file, name: h5py.SoftLink("/out"),
}


@pytest.mark.parametrize("link", OUTSIDE.values(), ids=OUTSIDE)
@pytest.mark.parametrize("name", ["/entry/two_point/resistance", "/entry/scene", "/entry/acquisition"])
def test_nothing_outside_the_file_is_read(good: Corpus, tmp_path: Path, link: Any, name: str) -> None:
    path = tmp_path / "linked.h5"
    path.write_bytes(good.files["recording"][0])
    (tmp_path / "other.h5").write_bytes(good.files["recording"][0])
    with h5py.File(path, "a") as file:
        del file[name]
        file["out"] = h5py.ExternalLink("other.h5", name)
        file[name] = link(file, name)
    with pytest.raises(InputError, match="another file"):
        Recording.load(path)


def test_no_values_of_other_files_are_read(good: Corpus, tmp_path: Path) -> None:
    path, values = tmp_path / "linked.h5", tmp_path / "values"
    np.full((3, 3, 4), 1500.0).tofile(values)
    path.write_bytes(good.files["recording"][0])
    with h5py.File(path, "a") as file:
        del file["entry/two_point/resistance"]
        file.create_dataset("entry/two_point/resistance", (3, 3, 4), "f8", external=[(str(values), 0, 288)])
    with pytest.raises(InputError, match="in another file"):
        Recording.load(path)


@pytest.mark.slow
def test_command_of_the_long_version() -> None:
    command = [sys.executable, "-m", "tests.fuzz", "--inputs", "42"]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert ended.stdout.startswith("42 inputs in ")
    assert ended.stdout.endswith("0 faults\n")
