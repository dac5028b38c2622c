"""Whatever is wrong with what a user gives: exit code 2, one sentence that names the place, nothing written."""

import errno
import gc
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest
from contracts.test_studies import BENCH, EXTREMES, GRADIENT_ALONE
from support import invented_case

from lampest import write_results
from tests.small_files import RUN, TRADEOFF

Command = Callable[..., SimpleNamespace]
LAMPREY = Path(__file__).parents[2] / "data" / "lamprey_25mm.h5"
START = "2026-05-04T09:30:00+02:00"


def content(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def refused(lampest: Command, disk: SimpleNamespace) -> Callable[..., None]:
    """Whether a command is refused: code 2, one line on standard error that holds the words, files as they were."""

    def check(*arguments: Any, words: tuple[str, ...], begin: str = "") -> None:
        before = content(disk.folder)
        ended = lampest(*arguments)
        assert (ended.code, ended.out) == (2, ""), ended.err
        assert ended.err.startswith(f"lampest: {begin}"), ended.err
        assert ended.err.count("\n") == 1 and ended.err.endswith("\n") and "Traceback" not in ended.err
        assert all(word in ended.err for word in words), ended.err
        assert content(disk.folder) == before

    return check


def recorded(**changes: Any) -> Callable[[SimpleNamespace], Any]:
    return lambda disk: disk.recording(disk.folder / "small.h5", **changes)


def without(dataset: str) -> Callable[[SimpleNamespace], Any]:
    def delete(disk: SimpleNamespace) -> None:
        with h5py.File(disk.folder / "small.h5", "a") as file:
            del file[dataset]

    return delete


def scene_with(old: str, new: str) -> Callable[[SimpleNamespace], Any]:
    return lambda disk: disk.recording(disk.folder / "small.h5", scene=disk.scene.replace(old, new))


def written(content: bytes | None) -> Callable[[SimpleNamespace], Any]:
    """Something else in place of the recording: bytes, or None for a folder."""

    def replace(disk: SimpleNamespace) -> None:
        path = disk.folder / "small.h5"
        path.unlink()
        path.mkdir() if content is None else path.write_bytes(content)

    return replace


def truncated(disk: SimpleNamespace) -> None:
    path = disk.folder / "small.h5"
    os.truncate(path, path.stat().st_size // 2)


MEASURED = "/entry/two_point"
NOTHING = {"resistance": np.empty((0, 3, 4)), "time": np.empty(0), "role": np.empty(0, np.uint8)}
RECORDINGS: dict[str, tuple[Callable[[SimpleNamespace], Any], tuple[str, ...]]] = {
    "no such file": (lambda disk: (disk.folder / "small.h5").unlink(), ("no such file",)),
    "not HDF5": (written(b"12, 13\n"), ("not a readable HDF5 file",)),
    "no frames": (recorded(**NOTHING), (f"{MEASURED}/resistance", "at least one frame")),
    "no measured frame": (recorded(role=np.zeros(3, np.uint8)), ("small", "measured")),
    "another panel": (
        recorded(resistance=np.full((3, 4, 3), 1500.0)),
        (f"{MEASURED}/resistance is 3 × 4 × 3", "3 × 4"),
    ),
    "text for numbers": (recorded(resistance=np.full((3, 3, 4), b"many")), (f"{MEASURED}/resistance",)),
    "times of other length": (recorded(time=np.arange(4.0)), (f"{MEASURED}/time",)),
    "roles beyond 0 and 1": (recorded(role=np.array([0, 1, 2], np.uint8)), (f"{MEASURED}/role",)),
    "sigma of zero": (recorded(sigma=np.zeros((3, 4))), (f"{MEASURED}/sigma[0, 0]", "positive")),
    "no scene": (without("/entry/scene"), ("/entry/scene",)),
    "misspelt scene": (scene_with("pitch_mm", "pich_mm"), ("/entry/scene:1:", "pich_mm", "no such key")),
    "impossible scene": (scene_with("140", "-140"), ("/entry/scene:", "series_resistance_ohm must be")),
}


@pytest.mark.parametrize(("spoil", "words"), RECORDINGS.values(), ids=RECORDINGS)
def test_a_fault_in_a_recording_is_one_sentence(
    disk: SimpleNamespace,
    refused: Callable[..., None],
    spoil: Callable[[SimpleNamespace], Any],
    words: tuple[str, ...],
) -> None:
    spoil(disk)
    refused("run", disk.folder / "run.yaml", "--out", disk.folder / "out", "--jobs", "1", words=words)
    assert not (disk.folder / "out").exists()


def below(line: str, *further: str) -> str:
    return "\n".join((line, *further))


SIMULATION = """\
schema: 1
seed: 4
scene:
  panel: {rows: 4, columns: 3, pitch_mm: 10}
  readout: {kind: two_point}
  series_resistance_ohm: 140
frames: 2
loads:
  - {kind: oral_disc, centre_mm: [10, 10], diameter_mm: 25, rim_width_mm: 4, pressure_kpa: -10}
  - {kind: rod, centre_mm: [20, 0], diameter_mm: 10, mass_g: 50}
"""
FIRST, FRAMES, SERIES = "schema: 1", "frames: 2", "  series_resistance_ohm: 140"
# The command, its file in order, and of each fault: what is replaced by what, line:column of the complaint, its words.
DOCUMENTS: dict[str, tuple[str, tuple[tuple[str, str, str, str], ...]]] = {
    "run": (
        RUN,
        (
            ("recordings: [", "recordigns: [", "2:1", "recordigns: no such key"),
            ("LSM: {terms:", "LSM: {term:", "4:9", "term: no such key"),
            ("weight: 1e-3", "wieght: 1e-3", "8:25", "wieght: no such key"),
            ("  LSR-dCR", "  LSM", "9:3", "duplicate key"),
            ("weight: 1e-3", "weight: 1e-3, weight: 2", "8:39", "duplicate key"),
            ("weight: 1e-3", "weight: '1e-3'", "8:25", "number"),
            ("[small.h5]", "small.h5", "2:1", "array"),
            ("[small.h5]", "[5]", "2:14", "string"),
            ("weight: 1e-3", "weight: -1e-3", "8:7", "weight must be zero or positive"),
            ("weight: 1e-3", "weight: .nan", "8:", "weight"),
            ("schema: 1", "schema: 2", "1:1", "1"),
            ("schema: 1\n", "", "1:1", "schema"),
            ("[small.h5]", "[]", "1:1", "at least one file"),
            ("{terms: {misfit: {}}}", "{terms: {}}", "4:3", "at least one term"),
            ("schema: 1", "schema: 1\nformulation: nodel", "2:1", "nodal"),
            ("schema: 1", "schema: 1\nsolver: {tolerance: 0}", "2:1", "tolerance must lie"),
            ("schema: 1", "schema: 1\nsolver: {max_iterations: 2.5}", "2:10", "integer"),
            ("schema: 1", "schema: 1\nbounds: {lower: -5}", "2:1", "lower must be"),
            ("schema: 1", "schema: 1\nbounds: {upper: resolved}", "2:10", "upper"),
            ("weight: 1e-3", "loss: {kind: hubert, corner: 1}", "8:", "loss"),
            ("weight: 1e-3", "loss: {kind: huber}", "8:", "corner"),
            ("recordings: [", "recordings: [[", "", ""),
            ("recordings: [", "\trecordings: [", "2:1", "tab"),
            ("[small.h5]", "!!python/object:os.system [small.h5]", "", ""),
            ("schema: 1", "schema: 1\nsweep: {solver.tolernace: [1e-8]}", "2:9", "tolernace"),
            ("schema: 1", "schema: 1\nsweep: {solver.tolerance: 1e-8}", "2:9", "list"),
            ("schema: 1", "schema: 1\nbounds: {upper: 10}", "", "no room"),
            ("small.h5", "smal*.hdf", "", "no file matches"),
            ("LSM:", "a/b:", "4:3", "'a/b'"),
            *(
                (FIRST, below(FIRST, f"solver: {{time_limit_s: {limit}}}"), "", "time_limit_s")
                for limit in ("0", "-1", ".nan", ".inf", "soon")
            ),
            *(
                (FIRST, below(FIRST, f"executor: {{{executor}}}"), place, words)
                for executor, place, words in (
                    ("kind: procesess", "2:1", "executor: "),
                    ("workers: 2", "2:1", "executor: Input should be a mapping with a 'kind'\n"),
                    ("kind: processes, workers: 0", "", "workers must lie between 1 and 10000"),
                    ("kind: serial, workers: 2", "", "executor.workers: no such key"),
                    ("kind: dask, address: 'tcp://a:1', workers: 2", "", "address names a cluster that runs"),
                    ("kind: dask, scheduler_file: /dev/zero", "", "executor.scheduler_file: /dev/zero: is no regular"),
                )
            ),
            (FIRST, below(FIRST, "sweep: {executor.workers: [1, 2]}"), "2:9", "where cases run changes no result, so"),
            ("estimators:", "estimatros:", "", "estimatros: no such key; did you mean estimators?"),
            ("LSM:", "recording:", "", "an estimator cannot be called 'recording'"),
            ("{misfit: {}}", "{gradient: {}}", "", "gradient needs the term misfit: without it nothing reads what was"),
        ),
    ),
    "simulate": (
        SIMULATION,
        (
            ("rim_width_mm: 4", "rim_width_mm: 4, tlit: 0.1", "9:78", "tlit: no such key"),
            ("mass_g: 50", "mass_g: 50, weight: 3", "10:66", "weight: no such key; there are tilt, tilt_direction_deg"),
            ("mass_g: 50", "mass_g: -50", "10:5", "mass_g must be positive"),
            ("kind: rod", "kind: rodd", "10:5", "rodd"),
            ("pressure_kpa: -10", "pressure_kpa: 10", "9:5", "must be negative"),
            ("rim_width_mm: 4", "rim_width_mm: 14", "9:5", "below half the diameter"),
            ("seed: 4", "seed: -4", "1:1", "seed must lie"),
            ("mass_g: 50", "mass_g: {uniform: [5]}", "10:63", "two numbers"),
            ("mass_g: 50", "mass_g: {uniform: [9, 5]}", "10:63", "lower one first"),
            (FRAMES, below(FRAMES, "unmodelled: {outliers: 0.1}"), "8:14", "no such key"),
            (FRAMES, below(FRAMES, "unmodelled: {channel_spread_ohm: 10000}"), "", "makes a resistance negative"),
            (FRAMES, below(FRAMES, "course: {breathing_depth: 2}"), "8:1", "below 1"),
            (FRAMES, below(FRAMES, "course: {start_s: -1}"), "1:1", "after the last unloaded frame"),
            (FRAMES, below(FRAMES, "sweep: {sede: [1, 2]}"), "8:9", "sweep.sede"),
            (FRAMES, below(FRAMES, "sweep: {cells.spraed: [1, 2]}"), "8:9", "spraed: no such key"),
            (FRAMES, below(FRAMES, "sweep: {loads.2.mass_g: [1, 2]}"), "8:9", "no such place"),
            (FRAMES, below(FRAMES, "sweep: {loads.1.mass_g: [1, -2]}"), "8:29", "must be positive"),
            (FRAMES, below(FRAMES, "sweep: [5]"), "8:1", "mapping"),
            (FRAMES, below(FRAMES, "sweep: {seed: [1, 2]}", "output: same.h5"), "9:1", "two recordings"),
            (FRAMES, below(FRAMES, "output: 'a_{sede}.h5'"), "8:1", "none of case, seed"),
            (FRAMES, below(FRAMES, "output: 'a_{seed.__class__}.h5'"), "8:1", "braces"),
            (FRAMES, below(FRAMES, "output: a.txt"), "8:1", "end in .h5"),
            (
                FRAMES,
                below(FRAMES, "response: {kind: table, pressure_kpa: [0, 5], resistance_ohm: [1, 2]}"),
                "",
                "resistance_ohm must be positive, and fall",
            ),
            (FRAMES, below(FRAMES, "response: {kind: spline}"), "", "there is no kind spline in lampest"),
            (
                FRAMES,
                below(FRAMES, "response: {kind: power, exponent: 1, scale_kpa: 2, gain: [[1, 1]]}"),
                "",
                "response.gain must have 4 rows of 3",
            ),
            (SERIES, below(SERIES, "  film: {hysteresis: 0.2, creep: 0.06}"), "7:", "film.creep: no such key"),
            (SERIES, below(SERIES, "  film: {hysteresis: 0.9}"), "7:", "hysteresis must lie between 0 and 0.6"),
            (SERIES, below(SERIES, "  film: {creep_per_decade: often}"), "7:", "creep_per_decade"),
            (SERIES, below(SERIES, "  subject: {length_mm: 0}"), "7:", "length_mm must be positive and finite"),
            (SERIES, below(SERIES, "  experiment: {water_temperature_celsius: 290}"), "7:", "between -5 and 100"),
        ),
    ),
    "study bench": (
        BENCH,
        (
            ("sizes: [3]", "sizes: []", "", "must hold at least one"),
            ("sizes: [3]", "sizes: [1]", "", "a panel's side must lie between 2 and 1000"),
            ("sizes: [3]", "sizes: [3, [3, 3]]", "", "names a panel twice"),
            ("frames: 1", "frames: 0", "", "frames must lie between 1 and 1000"),
            ("repeats: 1", "recordings: 0", "", "recordings must lie between 1 and 1000"),
            ("repeats: 1", "budget_s: 0", "", "budget_s must lie between"),
            (
                "sizes: [3]\nframes: 1\nrepeats: 1\nmemory: [3]\nlimits: {nodal: 3}",
                "sizes: [3, [3, 30]]\nlimits: {reduced: 20}",
                "",
                "limits leave no solver for 3 × 30",
            ),
            ("nodal: 3", "noddal: 3", "6:10", "limits.noddal: no such key"),
            ("repeats: 1", "estimators: {A: {terms: {}}}", "", "a method needs at least one term"),
        ),
    ),
    "study extremes": (
        EXTREMES,
        (
            (EXTREMES, "schema: 1\ngrid: {sizes: []}\nstructured: {sizes: []}\n", "", "hold no scene"),
            ("[[2, 3]]", "[99]", "", "a panel's side must lie between 1 and 64"),
            ("decades: [1]", "decades: [99]", "", "decades must lie between 0 and 15"),
            ("noise: [0]", "noise: [-1]", "", "noise must lie between 0 and 100 percent"),
            ("noise: [0]", "seeds: -1", "", "seeds must lie between 0 and 1000"),
            (FIRST, below(FIRST, "estimators: {}"), "", "estimators must hold at least one"),
        ),
    ),
    "study tradeoff": (
        TRADEOFF,
        (
            (" reduced,", " redcued,", "9:", ""),
            ("steps: 2", "steps: 0", "", "formulations.3"),
            (" reduced,", "", "", "reduced"),
            ("scaled,", "naive,", "", "twice"),
            ("frames: 3", "frames: 1", "", "frames"),
            ("sizes: [8,", "sizes: [3,", "", "side"),
            ("  scenes: {clean: {}", "  scenes: {a/b: {}", "", "a/b"),
        ),
    ),
    "study weights": (
        GRADIENT_ALONE,
        ((", gradient: {weight: auto}", "", "", "nothing to tune"),),
    ),
}


@pytest.mark.parametrize(
    ("command", "old", "new", "place", "words"),
    [(command, *fault) for command, (_, faults) in DOCUMENTS.items() for fault in faults],
)
def test_a_fault_in_a_file_is_one_sentence_at_its_place(
    disk: SimpleNamespace, refused: Callable[..., None], command: str, old: str, new: str, place: str, words: str
) -> None:
    text, _ = DOCUMENTS[command]
    assert old in text
    path = disk.run(text.replace(old, new, 1))
    begin = f"{path}:{place}" if place else ""
    refused(*command.split(), path, "--out", disk.folder / "out", words=(words,), begin=begin)
    assert not (disk.folder / "out").exists()


# The words of a command in a folder with small.h5, run.yaml, results.h5 and m.csv, and those of its complaint.
COMMANDS = (
    ("run .", "directory"),
    ("run latin.yaml", "UTF-8"),
    ("run empty.yaml", "empty.yaml"),
    ("run twice.yaml --out out", "two files are called small"),
    ("run run.yaml --out out --set solver.tolerance", "PATH=VALUE"),
    ("run run.yaml --out out --set solver.tolernace=1e-6", "tolernace"),
    ("run run.yaml --out out --set recordings.0.x=1", "recordings.0.x"),
    ("run run.yaml --out out --set solver.tolerance=[1", "'[1'"),
    *((f"run run.yaml --out {place}", "cannot be written") for place in ("small.h5", "small.h5/below", "/proc/none")),
    *((f"{command} none.h5", "none.h5", "no such file") for command in ("info", "compare", "plot")),
    *((f"{command} run.yaml", "run.yaml", "not a readable HDF5 file") for command in ("info", "compare", "plot")),
    *((f"{command} small.h5", "small.h5", "no results file") for command in ("compare", "plot")),
    ("import m.csv --out m.h5", "how large is the panel? Say --rows and --columns, or give a --scene"),
    ("import m.csv --out m.h5 --rows 3 --columns 4 --period 0", "--period must be positive and finite"),
    ("import m.csv --out m.h5 --rows 3 --columns 4 --unit farad", "the unit 'farad' is unknown"),
    ("import m.csv --out m.h5 --rows 3 --columns 4 --missing drop", "'drop' is unknown"),
    ("import m.csv --out m.h5 --rows 3 --columns 4 --variable R", "m.csv: holds nothing by name; --variable is for "),
    ("export results.h5 --to xlsx", "there is no format 'xlsx'; there are csv, parquet, mat, zarr, nwb"),
    ("export results.h5 --to nwb", "an NWB file is one session: choose with --recording one of mouth, other"),
    ("export results.h5 --to nwb --recording other", "other says it nowhere: give it with --start"),
    ("export results.h5 --to nwb --recording other --start 2026-05-04T09:30", "without a zone"),
    ("export results.h5 --to csv --start yesterday", "'yesterday' is no date and time"),
    ("export results.h5 --to csv --start 2026-05-05", f"mouth says itself that it began at {START}"),
    ("export results.h5 --to csv --recording third", "no recording is called 'third'; there are mouth, other"),
    ("export results.h5 --to csv --out results.h5", "results.h5: is an input; give the output another name"),
    ("tare small.h5 --out t.h5 --frames 5", "FIRST:END"),
    ("tare small.h5 --out t.h5 --frames 60:70", "frames 0 to 2"),
    ("tare small.h5 --out t.h5 --frames 1:1", "some must be named"),
    *(
        (f"detect small.h5 --patch {patch}", "--patch must be positive and finite")
        for patch in ("0", "-6", "nan", "inf")
    ),
    ("live --recording nowhere.h5", "nowhere.h5"),
    ("live --recording LAMPREY --port /dev/null", "--recording: --port, --scene, --period and --out are for a board"),
    *((f"live --recording LAMPREY --speed {speed}", "--speed must be positive and finite") for speed in ("0", "nan")),
    ("live --recording LAMPREY --estimator best", "no estimator is called 'best'; there are smooth, LSM"),
    ("live --recording LAMPREY --http here", "not of the form HOST:PORT"),
    ("live --recording LAMPREY --publish carrier-pigeon", "begins with none of lsl, osc, mqtt, websocket"),
    ("live --recording LAMPREY --publish mqtt://localhost:port/x", "is no address"),
    ("live --recording LAMPREY --publish mqtt://127.0.0.1:1/x", "mqtt://127.0.0.1:1/x: no broker answers"),
    ("live --recording LAMPREY --publish mqtt://localhost/#", "is no topic to publish to"),
    ("live --recording LAMPREY --publish websocket://example.org", "'example.org' is no address"),
    ("live --recording LAMPREY --publish osc://nowhere.invalid", "osc://nowhere.invalid:9000/lampest: "),
)


@pytest.mark.filterwarnings("ignore:unclosed <socket:ResourceWarning")  # of paho's threads
@pytest.mark.parametrize("words", COMMANDS, ids=lambda words: words[0])
def test_words_of_a_command_that_cannot_be_are_one_sentence(
    disk: SimpleNamespace, refused: Callable[..., None], monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    monkeypatch.chdir(disk.folder)
    cases = [invented_case("LSM", "mouth", (3, 4, 5), start_time=START), invented_case("LSM", "other", (2, 3, 6))]
    write_results(disk.folder / "results.h5", cases)
    (disk.folder / "m.csv").write_text("1,2,3,4\n" * 3)
    (disk.folder / "latin.yaml").write_bytes("schema: 1 # Größe".encode("latin-1"))
    (disk.folder / "empty.yaml").write_text("")
    (disk.folder / "other").mkdir()
    shutil.copy("small.h5", "other")
    (disk.folder / "twice.yaml").write_text(disk.text.replace("[small.h5]", "[small.h5, other/small.h5]"))
    command, *complaint = words
    refused(*command.replace("LAMPREY", str(LAMPREY)).split(), words=tuple(complaint))
    gc.collect()


def full(monkeypatch: pytest.MonkeyPatch, suffix: str) -> None:
    """Nothing more can be written to files of that name."""
    write = Path.write_bytes

    def failing(self: Path, data: bytes) -> int:
        if suffix in self.name:
            write(self, data[: len(data) // 2])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(self, data)

    monkeypatch.setattr(Path, "write_bytes", failing)


def test_a_full_disk_keeps_what_fits(disk: SimpleNamespace, lampest: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cases that do not fit have failed. If only all of them together do not, they are collected once there is room."""
    run, out = disk.folder / "run.yaml", disk.folder / "out"
    for suffix, codes in ((".h5", (2, 3)), ("results.h5", (2,))):
        with monkeypatch.context() as patch:
            full(patch, suffix)
            ended = lampest("run", run, "--out", out, "--jobs", "1")
        assert ended.code in codes and "No space left" in ended.err and "Traceback" not in ended.err
        assert not list(out.rglob(f"*{suffix}*"))
    assert (ended.out, ended.err.count("\n")) == ("", 1) and "results.h5" in ended.err
    ended = lampest("run", run, "--out", out, "--jobs", "1")
    assert (ended.code, ended.err) == (0, "") and "0 cases solved, 3 were done before" in ended.out
    assert (out / "results.h5").is_file()
