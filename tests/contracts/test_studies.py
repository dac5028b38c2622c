"""The contract of every study: a table, samples with units, pictures, a sentence for a mistake."""

import csv
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import h5py
import pytest

Command = Callable[..., SimpleNamespace]
Row = dict[str, str]
ROOT = Path(__file__).parents[2]
MIN_COVERAGE_PERCENT = 80  # of 95 % intervals of 180 cells
# χ² over its degrees of freedom, with threefold noise and without
LOUD = 5
QUIET = 2
WRITTEN = 1e-4  # relative, of a share in the table
# percent, of plain least squares
MAX_DATA_ERROR = 0.05
PUBLISHED_DATA_ERROR = 1.33

BENCH = "schema: 1\nsizes: [3]\nframes: 1\nrepeats: 1\nlimits: {nodal: 3}\n"
EXTREMES = "schema: 1\ngrid: {sizes: [[2, 3]], decades: [1], noise: [0]}\nstructured: {sizes: []}\n"
WEIGHTS = (
    "schema: 1\nrecordings: [small.h5]\nestimators:\n  g: {terms: {misfit: {}, gradient: {weight: "
    "auto}}}\n"
    "  d: {terms: {misfit: {weighting: noise}, relative_change: {weight: 10}}}\n"
)
GRADIENT_ALONE = WEIGHTS.split("  d:")[0]
AUDIT = """schema: 1
simulation:
  schema: 1
  seed: 3
  scene:
    panel: {rows: 6, columns: 5}
    response: {kind: published}
    readout: {kind: two_point, adc_bits: 12, noise_lsb: 1}
    series_resistance_ohm: 140
  baseline_frames: 5
  frames: 2
  loads: [{kind: rod, centre_mm: [20, 25], diameter_mm: 20, mass_g: 200}]
seeds: 3
estimators: {LSM: {terms: {misfit: {}}}}
effects:
  nothing: {}
  noise 3: {noise_factor: 3}
executor: {kind: serial}
"""
SETTINGS = {
    "bench": BENCH + "estimators: {mine: {terms: {misfit: {}, gradient: {weight: 2}}}}\n",
    "extremes": EXTREMES + "estimators: {mine: {terms: {misfit: {}}}}\n",
    "tradeoff": "schema: 1\nrecordings: [small.h5]\nestimators: {LSM: {terms: {misfit: {}}}}\n"
    "formulations: [scaled, reduced]\nframes: 2\nrepeats: 1\n",
    "weights": WEIGHTS
    + "  both: {terms: {misfit: {}, gradient: {weight: auto}, cell_resistance: {weight: auto}}}\n",
    "audit": AUDIT,
}
SCRIPTS = ("audit", "weights")  # of pages; the others are commands
UNKNOWN_NOISE = "panel: {rows: 3, columns: 4, pitch_mm: 10}\nseries_resistance_ohm: 140\n"
GROUPS = {  # of the measurements in the HDF5 file
    "bench": "frames",
    "extremes": "solves",
    "tradeoff": "frames",
    "weights": "small/g",
    "audit": "recordings",
}


def started(folder: Path, *words: str) -> SimpleNamespace:
    """Run Python as a user does; return code, out and err."""
    environment = {**os.environ, "COLUMNS": "100", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, *words]
    completed = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=600, env=environment
    )
    return SimpleNamespace(code=completed.returncode, out=completed.stdout, err=completed.stderr)


def studied(
    lampest: Command, disk: SimpleNamespace, study: str, text: str, *words: str
) -> tuple[SimpleNamespace, Path]:
    """Run a study, or the script of a page, on a file of that text.

    Return how it ended, and its folder.
    """
    file = disk.run(text, f"{study}.yaml")
    out = disk.folder / "out"
    if study in SCRIPTS:
        script = f"docs.studies.{study}"
        return started(disk.folder, "-m", script, str(file), "--out", "out", *words), out
    return lampest("study", study, file, "--out", out, *words), out


def table_of(file: Path) -> list[Row]:
    with file.open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.slow
@pytest.mark.parametrize("study", SETTINGS)
def test_a_study_writes_its_table_its_samples_with_units_and_its_pictures(
    study: str, disk: SimpleNamespace, lampest: Command
) -> None:
    completed, out = studied(lampest, disk, study, SETTINGS[study])
    left_out = "small/both left out: it has 2 penalty terms, not one" if study == "weights" else ""
    assert (
        completed.code == 0
        and left_out in completed.err
        and (bool(completed.err) == bool(left_out) or study in SCRIPTS)
    ), completed.err
    shown = completed.out.split("cells, change, press.")[0].splitlines()
    assert max(len(line.rstrip()) for line in shown) <= 100 + len(str(disk.folder))
    stem = out / {"weights": "tune"}.get(study, study)
    with h5py.File(stem.with_suffix(".h5")) as file:
        group = file[f"entry/{GROUPS[study]}"]
        datasets = {
            name: values for name, values in group.items() if isinstance(values, h5py.Dataset)
        }
        for name, values in datasets.items():
            assert values.attrs["units"] and values.attrs["long_name"], name
        assert len({len(values) for values in datasets.values()}) == 1
        if study == "audit":
            undisturbed, noisy = table_of(stem.with_suffix(".csv"))
            assert (undisturbed["effect"], undisturbed["verdict"]) in (
                ("nothing", "covered"),
                ("nothing", "wide"),
            )
            assert (noisy["reported"], noisy["verdict"]) == ("3", "reported") and float(
                noisy["cells"]
            ) > MIN_COVERAGE_PERCENT
            assert float(noisy["chi_square"]) > LOUD > QUIET > float(undisturbed["chi_square"])
            assert "measured in unloaded frames; the scene specifies" in completed.out
            held = group["cells_covered"][3:].sum()
            cells = group["cells"][3:].sum()
            assert cells == 3 * 2 * 30 and 100 * held / cells == pytest.approx(
                float(noisy["cells"]), rel=WRITTEN
            )
    pictures = [*out.glob("*.png")]
    assert bool(pictures) == (study in ("tradeoff", "weights"))
    assert all(picture.read_bytes().startswith(b"\x89PNG") for picture in pictures)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("noise_factor", "noise_facto", "audit.yaml:17:"),
        pytest.param("seeds: 3", "seeds: 0", "audit.yaml", marks=pytest.mark.slow),
        pytest.param(
            "baseline_frames: 5", "baseline_frames: 1", "audit.yaml", marks=pytest.mark.slow
        ),
    ],
)
def test_a_mistake_in_the_file_of_a_script_gives_one_sentence(
    disk: SimpleNamespace, lampest: Command, old: str, new: str, place: str
) -> None:
    completed, out = studied(lampest, disk, "audit", AUDIT.replace(old, new))
    assert (
        completed.code == 2
        and place in completed.err
        and len(completed.err.strip().splitlines()) == 1
        and not out.exists()
    )


@pytest.mark.slow
def test_weights_without_noise_and_truth_are_chosen_by_risk(
    disk: SimpleNamespace, lampest: Command
) -> None:
    path = disk.recording(disk.folder / "small.h5", scene=UNKNOWN_NOISE)
    with h5py.File(path, "a") as file:
        del file["entry/truth"]
    text = GRADIENT_ALONE + "bounds: {upper: none}\n"
    completed, out = studied(lampest, disk, "weights", text + "auto_weight: {rule: evidence}\n")
    assert (
        completed.code == 2
        and "auto_weight.rule: evidence needs the noise" in completed.err
        and not out.exists()
    )
    completed, out = studied(lampest, disk, "weights", text)
    assert completed.code == 0, completed.err
    rules = {row["rule"]: row for row in table_of(out / "tune.csv")}
    assert set(rules) == {"risk", "Morozov", "L-curve"}
    assert rules["risk"]["in_use"] == "1" and rules["Morozov"]["weight"] == ""
    assert {row["rms_log_error"] for row in rules.values()} == {""}


@pytest.mark.slow
def test_settings_of_the_command_override_the_file_of_a_study(
    disk: SimpleNamespace, lampest: Command
) -> None:
    setting = ("--set", "estimators.g.terms.gradient.weight=0.002")
    completed, out = studied(lampest, disk, "weights", GRADIENT_ALONE, *setting)
    assert completed.code == 0, completed.err
    (given,) = (row for row in table_of(out / "tune.csv") if row["rule"] == "given")
    assert float(given["weight"]) == 0.002


@pytest.mark.slow
def test_the_papers_page_is_self_contained_and_its_scenes_give_its_numbers(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    completed = started(tmp_path, "-m", "docs.studies.paper", "--out", "out", "--jobs", "1")
    assert completed.code == 0, completed.err
    assert all((tmp_path / line).is_file() for line in completed.out.splitlines())
    page = (folder / "paper.html").read_text(encoding="utf-8")
    text = re.sub(r"base64,[\w+/=]+", "", page)  # whose letters may spell anything
    assert (
        "http" not in text.replace("https://www.w3.org", "")
        and page.count("data:image/png;base64,") >= 5
    )
    assert all(
        part in page for part in ("Fig. 1-e", "Fig. 2-a", "Fig. 6", "Fig. 8", "Fig. 9", "Table I")
    )
    assert {file.stem.split("_")[0] for file in folder.glob("*.png")} == {
        "fig1e",
        "fig2",
        "fig6",
        "fig8",
        "fig9",
    }
    rows = table_of(folder / "numbers.csv")
    simulated = {(row["figure"], row["quantity"]): float(row["clean scenes"]) for row in rows}
    # The two mouths cover as many cells as published; plain least squares follows its readings far
    # more closely.
    assert [simulated[key] for key in simulated if key[0].startswith("Fig. 9")] == [4, 4, 3, 3]
    assert (
        simulated["Table I", "LSM, all steps: data error"] < MAX_DATA_ERROR < PUBLISHED_DATA_ERROR
    )
    assert simulated["Fig. 8-a", "measured, smallest change"] == pytest.approx(-63, abs=1.5), (
        "series resistance included"
    )
