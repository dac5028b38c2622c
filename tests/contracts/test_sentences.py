"""Sentences about a beginner's mistakes, and about files that leave something open."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import lampest
from lampest import Panel, Recording, Scene, Simulation, TwoPointReadout, read_scene, simulate

Command = Callable[..., SimpleNamespace]

PANEL = "panel: {rows: 3, columns: 5, pitch_mm: 10}\n"
LOADED = (
    "{kind: loaded_columns, driven: rows, supply_volt: 3.3, load_ohm: 3300, drive_ohm: 70, "
    "adc_bits: 12, readings: 1}"
)
CODES = np.random.default_rng(1).integers(200, 900, (4, 3, 5))


@pytest.fixture
def codes(tmp_path: Path) -> Path:
    path = tmp_path / "codes.csv"
    path.write_text("\n".join(",".join(map(str, frame.ravel())) for frame in CODES))
    return path


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.yaml"
    path.write_text(f"{PANEL}readout: {LOADED}\n")
    return path


@pytest.fixture
def starter(tmp_path: Path, lampest: Command) -> Path:
    """The starter files; `lampest` runs in this process."""
    assert lampest("init", tmp_path / "mine", "--rows", 6, "--columns", 6).code == 0
    return tmp_path / "mine"


@pytest.mark.parametrize(
    ("assigned", "sentence"),
    [
        (
            "readout.load_ohm=3.3k",
            "readout.load_ohm: must be a number or a list, not '3.3k': write 3300",
        ),
        ("readout.load_ohm='3300'", "not '3300': write 3300, without quotation marks"),
        ("readout.load_ohm='1e3'", "not '1e3': write 1000, without quotation marks"),
        ("readout.load_ohm=4k7", "not '4k7': write 4700"),
        ("readout.load_ohm=10 kOhm", "not '10 kOhm'"),
        ("readout.load_ohm=1M", "not '1M': write 1000000"),
        ("readout.adc_bits=ten", "readout.adc_bits: must be a whole number, not 'ten'"),
        ("readout.adc_bits=10.5", "must be a whole number, not 10.5"),
        ("readout.driven=row", "must be 'rows' or 'columns', not 'row'; did you mean rows?"),
        ("readout.kind=loaded_column", "virtual_ground; did you mean loaded_columns?"),
        ("readout.lod_ohm=3300", "readout.lod_ohm: no such key; did you mean load_ohm?"),
        ("readout.noise_lsb=estimatd", "'estimated', not 'estimatd'; did you mean estimated?"),
        ("purpose=matt", "purpose: must be 'mat', not 'matt'; did you mean mat?"),
        ("systematic=typcal", "not 'typcal'; did you mean typical?"),
        (
            "series_resistance_ohm=140 ohm",
            "must be a number or a mapping, not '140 ohm': write 140",
        ),
        ("readout=5", "readout: must be a mapping with a 'kind', not 5"),
    ],
)
def test_the_error_of_a_wrong_value_names_valid_ones(
    assigned: str, sentence: str, codes: Path, scene: Path, lampest: Command
) -> None:
    completed = lampest(
        "import", codes, "--scene", scene, "--set", assigned, "--out", codes.with_suffix(".h5")
    )
    assert completed.code == 2 and sentence in completed.err and "Input should" not in completed.err


@pytest.mark.parametrize(
    "assigned", ["readout.driven=diagonals", "readout.kind=bridge", "purpose=insole"]
)
def test_a_word_that_resembles_no_known_one_has_no_suggestion(
    assigned: str, codes: Path, scene: Path, lampest: Command
) -> None:
    completed = lampest(
        "import", codes, "--scene", scene, "--set", assigned, "--out", codes.with_suffix(".h5")
    )
    assert completed.code == 2 and "did you mean" not in completed.err


def test_import_says_that_it_replaced_a_file(codes: Path, scene: Path, lampest: Command) -> None:
    out = codes.with_suffix(".h5")
    first, second = (lampest("import", codes, "--scene", scene, "--out", out) for _ in range(2))
    assert first.out.splitlines()[-1] == str(out)
    assert second.out.splitlines()[-1] == f"{out} (in place of the file that had this name)"


def test_import_calls_only_undetermined_entries_assumed(
    codes: Path, scene: Path, lampest: Command
) -> None:
    output = lampest("import", codes, "--scene", scene, "--out", codes.with_suffix(".h5")).out
    assert "polarity" not in output
    scene.write_text(f"{PANEL}readout: {LOADED.replace('adc_bits: 12, ', '')}\n")
    assert (
        "adc_bits: 10 assumed: the scene does not say"
        in lampest("import", codes, "--scene", scene, "--out", codes.with_name("second.h5")).out
    )


def test_infinite_resistances_without_a_readout_are_not_at_a_rail(tmp_path: Path) -> None:
    np.save(tmp_path / "m.npy", np.where(CODES.max() == CODES, np.inf, CODES))
    _, notes = lampest.import_file(tmp_path / "m.npy", 3, 5, unit="ohm")
    assert any("zero or infinite: kept as bounds" in note for note in notes) and not any(
        "rail" in n for n in notes
    )


def test_the_error_names_an_unknown_estimator_of_a_setting(starter: Path, lampest: Command) -> None:
    completed = lampest(
        "run", starter / "run.yaml", "--set", "estimators.smoth.terms.log_gradient.weight=1"
    )
    assert completed.code == 2
    assert "there is no estimator 'smoth'; did you mean smooth?" in completed.err
    unlike = lampest("run", starter / "run.yaml", "--set", "estimators.x.error_bars=false")
    assert "there is no estimator 'x'; there are no_penalty, smooth, few_changes" in unlike.err


@pytest.mark.slow
def test_numbers_that_a_recording_determines_are_information_and_no_warning(
    tmp_path: Path, lampest: Command
) -> None:
    scene = Scene(
        Panel(3, 4), TwoPointReadout(noise_lsb=0.7), 140.0, gain="estimated", ripple="estimated"
    )
    simulate(Simulation(1, 1, scene, baseline_frames=5, frames=2)).save(tmp_path / "mine.h5")
    (tmp_path / "run.yaml").write_text(
        "schema: 1\nrecordings: [mine.h5]\nestimators: {LSM: {terms: {misfit: {}}, error_bars: "
        "false}}\n"
    )
    number = r"[\d.e-]+ ± [\d.e-]+"
    ran = lampest("run", tmp_path / "run.yaml", "--out", tmp_path / "out", "--jobs", 1)
    assert re.search(rf"^estimated: mine: gain: {number} \(relative\)$", ran.out, re.MULTILINE)
    assert re.search(rf"^estimated: mine: ripple: {number} LSB$", ran.out, re.MULTILINE)
    for file in (tmp_path / "mine.h5", tmp_path / "out" / "results.h5"):
        info = lampest("info", file).out
        assert re.search(rf"^estimated +gain: {number} \(relative\)$", info, re.MULTILINE)
        assert not re.search(r"^warning.*(gain|ripple)", ran.out + info, re.MULTILINE)


@pytest.mark.slow
def test_info_states_the_numbers_of_single_modules_in_words(
    tmp_path: Path, lampest: Command
) -> None:
    (tmp_path / "plan.yaml").write_text(
        "schema: 1\nseed: 1\noutput: image.h5\nscene:\n"
        "  panel: {modules: {rows: 1, columns: 2, each: {rows: 3, columns: 3, pitch_mm: 10}, "
        "seam_mm: 3}}\n"
        "  readout: {kind: two_point, reference_ohm: 1000, adc_bits: 12, readings: 1, noise_lsb: "
        "1}\n"
        "  series_resistance_ohm: 140\n"
        "  modules: [{at: [0, 0], series_resistance_ohm: 150}, {at: [0, 1], faults: {dead_rows: "
        "[2]}}]\n"
    )
    assert lampest("simulate", tmp_path / "plan.yaml").code == 0
    info = lampest("info", tmp_path / "image.h5").out
    assert (
        "\nmodules    at [0, 0], series_resistance_ohm 150; at [0, 1], faults dead_rows [2]\n"
        in info
    )


def test_a_pattern_without_quotation_marks_is_explained_and_the_starter_file_shows_them(
    starter: Path, lampest: Command
) -> None:
    run = starter / "run.yaml"
    text = run.read_text()
    assert '"*.h5"' in text
    run.write_text(text.replace("[example.h5]", "[*.h5]"))
    completed = lampest("run", run)
    assert (
        completed.code == 2
        and "in YAML a * begins an alias: write such a text in quotation marks" in completed.err
    )
    run.write_text(text.replace("[example.h5]", '["*.h5"]'))
    assert len(lampest_cases(run)) == 3


def lampest_cases(run: Path) -> Any:
    return lampest.read_run(run).cases


@pytest.mark.slow
def test_info_names_the_reference_of_the_changes(tmp_path: Path, lampest: Command) -> None:
    from lampest import LogGradient, Misfit, Panel, Recording, Scene, TwoPointReadout, reconstruct

    values = np.random.default_rng(2).uniform(500, 600, (3, 4, 4))
    scene = Scene(Panel(4, 4), TwoPointReadout(), 0.0)
    for baseline, words in (
        (0, "change against the first measured frame:"),
        (1, "change against the unloaded panel:"),
    ):
        recording = Recording.from_array(values, unit="ohm", baseline=baseline, scene=scene)
        reconstruct(recording, [Misfit(weighting="noise"), LogGradient(weight=1.0)]).save(
            tmp_path / "results.h5"
        )
        assert words in lampest("info", tmp_path / "results.h5").out


@pytest.mark.slow
def test_noise_that_agrees_with_the_scene_is_not_reported(tmp_path: Path, lampest: Command) -> None:
    from lampest import LoadedColumnsReadout, Panel, Recording, Scene

    readout = LoadedColumnsReadout(load_ohm=3300.0, readings=1, noise_lsb=0.0)
    constant = np.tile(CODES[:1], (8, 1, 1)).astype(float)
    recording = Recording.from_array(
        constant, unit="code", baseline=6, scene=Scene(Panel(3, 5), readout)
    )
    recording.save(tmp_path / "m.h5")
    assert "noise 0 LSB, measured" not in lampest("info", tmp_path / "m.h5").out


@pytest.mark.slow
def test_counts_of_one_are_singular(starter: Path, lampest: Command) -> None:
    assert "10 bits, 1 reading, noise 1 LSB" in lampest("info", starter / "example.h5").out


OTHER_FILES = {
    "run.yaml": "a run file; lampest run reads it",
    "scene.yaml": "a scene; lampest import takes it with --scene",
    "simulation.yaml": "a simulation; lampest simulate makes a recording of it",
    "mine.csv": "a file of another program; lampest import makes a recording of its readings",
    "mine.png": "a picture",
    "mine.bin": "another kind of file",
    "empty.h5": "it is empty",
    "damaged.h5": "it does not begin as one does",
    "cut.h5": "it is cut off, 5000 of ",
}


def test_the_error_names_the_command_for_a_file_of_another_kind(
    starter: Path, lampest: Command
) -> None:
    example = (starter / "example.h5").read_bytes()
    contents = {"empty.h5": b"", "cut.h5": example[:5000]}
    for name, kind in OTHER_FILES.items():
        if not (starter / name).exists():
            (starter / name).write_bytes(contents.get(name, b"1,2,3\n"))
        for command in ("info", "plot"):
            completed = lampest(command, starter / name)
            assert completed.code == 2 and kind in completed.err, completed.err
            assert "synchronously" not in completed.err


def test_commands_distinguish_recordings_from_results(starter: Path, lampest: Command) -> None:
    assert (
        "a recording, lampest run computes results of it"
        in lampest("plot", starter / "example.h5").err
    )
    assert (
        "HDF5, a recording or results; lampest info describes it"
        in lampest("run", starter / "example.h5").err
    )
    assert "a folder; name a file in it" in lampest("info", starter).err


@pytest.mark.parametrize(
    ("keys", "excluded"),
    [
        pytest.param(
            "kind: grounded, sense: one",
            "leak_ohm ends of idle columns readout.idle_load_ohm",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "kind: grounded, sense: one, driven: columns, idle_load_ohm: 25",
            "leak_ohm",
            marks=pytest.mark.slow,
        ),
        pytest.param("kind: grounded, sense: all", "leak_ohm", marks=pytest.mark.slow),
        ("kind: two_point", "leak_ohm"),
    ],
)
def test_info_of_a_mat_names_the_ends_that_readings_seldom_show(
    keys: str, excluded: str, tmp_path: Path, lampest: Command
) -> None:
    path = tmp_path / "scene.yaml"
    recording = tmp_path / "mat.h5"
    for further in ("", "purpose: mat\n", "purpose: mat\nleak_ohm: {rows: 6000}\n"):
        path.write_text(f"{PANEL}readout: {{{keys}, adc_bits: 12}}\n{further}", encoding="utf-8")
        simulate(Simulation(1, 1, read_scene(path), frames=2)).save(recording)
        shown = " ".join(lampest("info", recording).out.split())
        recording.unlink()
        named = re.search("excluded (.+); readings seldom show them", shown)
        of_leaks = further == "purpose: mat\n"
        words = excluded.removeprefix("leak_ohm").strip() if not of_leaks else excluded
        assert (named is not None) is bool(words), further
        for word in words.split(" "):
            assert named is None or word in named[1]
        assert named is None or ("(leak_ohm)" in named[1]) is of_leaks


CIRCUITS = [
    "two_mux",
    "parallel_mux",
    "pull_ups",
    "pull_downs_on_columns",
    "pull_downs",
    "grounded",
    "grounded_one",
    "amplifiers",
    "diodes",
]


@pytest.mark.slow
@pytest.mark.parametrize(
    "circuit",
    ["grounded", *(pytest.param(circuit, marks=pytest.mark.slow) for circuit in CIRCUITS)],
)
def test_the_contact_of_a_starter_mat_is_detected_and_its_readings_have_no_errors(
    circuit: str, tmp_path: Path, lampest: Command
) -> None:
    """Cells that differ by 5 % pass for errors of the readings where crosstalk is small."""
    words = ("--readout", circuit, "--rows", 10, "--columns", 6, "--purpose", "mat")
    assert lampest("init", tmp_path / "mine", *words)
    path = tmp_path / "mine" / "example.h5"
    recording = Recording.load(path)
    scene = recording.scene
    systematic = replace(scene.systematic, reading_error="estimated")
    replace(recording, scene=replace(scene, systematic=systematic)).save(tmp_path / "asked.h5")
    about = lampest("info", tmp_path / "asked.h5").out
    shown = re.search(r"reading_error: (\S+) ± (\S+) \(relative\)", about)
    assert shown is not None
    size, deviation = map(float, shown.groups())
    assert size < max(0.002, deviation)
    detection = lampest("detect", path, "--no-check", "--out", tmp_path / "detections")
    assert re.search(r"contact since 5\.0 s at \(2[45], 45\) mm, 4 cells", detection.out)
