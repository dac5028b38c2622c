"""Tables and pictures of results: right numbers, every panel shape, the same bytes twice."""

import csv
import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from support import METHODS, invented_case

from lampest import InputError, Panel, Recording, Scene, SweepPlot, plot_results
from lampest.cli.screen import print_table
from lampest.report.compare import Table, compare, compare_files, comparison, legend, screen_blocks, write_csv
from lampest.report.info import describe
from lampest.report.strongest import strongest_index
from lampest.runs.results import CaseResult, PublishedFigures, Results, StepFigures, write_results

PUBLISHED = {
    "LSM": PublishedFigures(all=StepFigures(16.45, 0.40, 1.33, 1.29)),
    "LSR-dCR": PublishedFigures(initial=StepFigures(58.63, None, 1.19, 1.18), following=StepFigures(8.05, 0.88)),
}


def test_what_no_result_holds_has_no_column_and_no_note() -> None:
    failed = invented_case("LSR-CR", failed=(0, 1, 2))
    rows = compare(Results((invented_case(truth=False), failed), PUBLISHED))
    (block,) = screen_blocks(rows)
    assert not any("published" in header for header in block.headers)
    assert dict(zip(block.headers, block.cells[1], strict=True))["time [ms]"] == ""
    rows = compare(Results((invented_case(truth=False, solve_time=np.full(3, 1e-7)),)))
    bare = screen_blocks(rows, published=True)
    assert not any("cell error" in header or "published" in header for header in bare[0].headers)
    assert not any("published" in note or "truth" in note for note in legend(rows, bare))
    assert dict(zip(bare[0].headers, bare[0].cells[0], strict=True))["time [ms]"] == "< 0.001"
    assert screen_blocks([]) == []


def test_the_table_fits_a_hundred_columns_with_whole_names(capsys: pytest.CaptureFixture[str]) -> None:
    long = "LSR-gCR@gradient.weight=0.001"
    cases = [invented_case(name, stem) for stem in ("lamprey_35mm", "lamprey_25mm") for name in (*METHODS, long)]
    blocks = screen_blocks(compare(Results(tuple(cases), PUBLISHED)))
    assert [block.title.split(":")[0] for block in blocks] == ["lamprey_35mm", "lamprey_25mm"]
    for block in blocks:
        print_table(block)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 100 and not any("…" in line for line in lines)
    names = next(line.index("solved") for line in lines if "solved" in line)
    assert long in "".join(line[:names].strip() for line in lines)
    for name in METHODS:
        assert any(line.startswith((f" {name} ", f" {name}, paper's λ ")) for line in lines)


@pytest.mark.slow
def test_pictures_go_where_they_are_asked_to(tmp_path: Path) -> None:
    write_results(tmp_path / "one.h5", [invented_case("LSM", shape=(1, 3, 3))])
    write_results(tmp_path / "two.h5", [invented_case("LSM", stem, (1, 3, 3)) for stem in ("a", "b")])
    assert plot_results(tmp_path / "one.h5") == [tmp_path / "contours_mouth.png"]
    assert plot_results(tmp_path / "one.h5", tmp_path / "x.png") == [tmp_path / "x.png"]
    names = [path.name for path in plot_results(tmp_path / "two.h5", tmp_path / "new")]
    assert names == ["contours_a.png", "contours_b.png"] and (tmp_path / "new" / "contours_b.png").exists()
    chosen = plot_results(tmp_path / "two.h5", tmp_path / "x.png", recordings=["b"])
    assert chosen == [tmp_path / "x.png"] and chosen[0].read_bytes() == (tmp_path / "new/contours_b.png").read_bytes()
    for out, given, sentence in (
        ("x.png", {}, r"2 \(a, b\): choose a recording, or name a folder"),
        ("x.png", {"recordings": ["c"]}, "no recording is called 'c'; there are a, b"),
        ("x.bmp", {"recordings": ["a"]}, r"written as \.png, \.svg or \.pdf"),
        ("x.png", {"recordings": ["a"], "frame": 3}, "frame 3 has no results; there are frames 5 to 5"),
    ):
        with pytest.raises(InputError, match=sentence):
            plot_results(tmp_path / "two.h5", tmp_path / out, **given)


def test_results_without_a_solved_frame_are_compared_and_others_call_their_optima_local(tmp_path: Path) -> None:
    case = invented_case("LSM", failed=(0, 1, 2))
    write_results(tmp_path / "r.h5", [dataclasses.replace(case, baseline_resistance=np.full((10, 10), np.nan))])
    assert plot_results(tmp_path / "r.h5")
    (row,) = compare_files([tmp_path / "r.h5"])
    assert row["frames solved"] == 0 and row["data error mean [%]"] is None and row["worst KKT residual"] is None
    assert any("solved 0/3" in line for line in describe(tmp_path / "r.h5"))
    words = ("optimum verified", "an optimum, but a plateau", "approximate, as the formulation asks; not an optimum")
    cases = {"LSM": {"status": words}, "linearised": {"status": words[2:] * 3}, "old": {"starts": None}}
    starts = {"starts": np.array([1, 4, 9])}
    write_results(tmp_path / "s.h5", [invented_case(name, **starts | about) for name, about in cases.items()])
    told = "\n".join(describe(tmp_path / "s.h5"))
    assert "solved 3/3, verified local optima, best of 1 to 4 starts a frame  r " in told
    assert told.count("local optima") == 1
    half = [invented_case(name, failed=(2,) if name == "LSM" else ()) for name in METHODS]
    assert strongest_index(half[1:]) == 2 and strongest_index(half) == 1, "of the frames that most estimators solved"


def test_a_description_shows_what_fits_the_screen_and_no_foreign_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    for rows, columns in ((30, 14), (60, 300)):
        values = np.linspace(300, 400, 2 * rows * columns).reshape(2, rows, columns)
        recording = Recording(Scene(Panel(rows, columns)), values, np.arange(2.0), np.array([0, 1], dtype=np.uint8))
        recording.save(tmp_path / f"{rows}.h5")
    lines = describe(tmp_path / "30.h5")
    assert any(line.endswith("#" * 28) for line in lines), "all columns are shown"
    assert describe(tmp_path / "60.h5")[-1] == "(the first 48 of 60 rows and 97 of 300 columns)"
    (tmp_path / "text.h5").write_text("text", encoding="utf-8")
    with pytest.raises(InputError, match="not a readable HDF5 file"):
        describe(tmp_path / "text.h5")


@pytest.mark.parametrize("sources", [1, 3])
def test_a_wide_table_folds_its_texts_and_keeps_its_figures(sources: int, capsys: pytest.CaptureFixture[str]) -> None:
    numbers = range(5 if sources == 1 else 7)
    headers = ("recording", "what", "nothing", *(f"number {number} [kPa]" for number in numbers))
    figures = [f"{-1.5 * number:.1f} ± {number}.25" for number in range(len(headers) - 3)]
    rows = tuple((f"panel_{source}", "ring or rod or lamprey or cup", "", *figures) for source in range(sources))
    print_table(Table(headers, rows))
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= 100 and "nothing" not in text and "…" not in text
    assert all(text.count(figure) >= sources for figure in figures), "figures are whole"
    assert text.count("lamprey") == sources and "or lamprey or cup" not in text
    titles = [line for line in text.splitlines() if line.endswith(":")]
    assert titles == ([f"panel_{source}:" for source in range(sources)] if sources > 1 else [])
    print_table(Table(("", "figure", "a"), (("x", "1 ± 2", ""), ("two words", "3", ""))))
    lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
    assert lines == ["", "figure", "─" * 17, "x          1 ± 2", "two words  3", ""]


def swept(name: str, **values: float) -> CaseResult:
    keys = {f"{key}.weight": value for key, value in values.items()}
    full = "@".join(filter(None, (name, ",".join(f"{key}={value}" for key, value in keys.items()))))
    return dataclasses.replace(invented_case(full), swept_json=json.dumps(keys) if keys else "")


SWEPT = [
    swept("plain"),
    *(swept("smooth", gradient=weight) for weight in (1e-8, 1e-6, 1e-4)),
    *(swept("both", gradient=weight, log_ratio=other) for weight in (1e-8, 1e-6) for other in (0.1, 1.0)),
]


def test_the_table_has_a_row_a_case_and_a_column_for_each_swept_key(tmp_path: Path) -> None:
    write_results(tmp_path / "r.h5", SWEPT)
    rows = compare_files([tmp_path / "r.h5"])
    (block,) = screen_blocks(rows)
    assert block.headers[:3] == ("estimator", "gradient weight", "log_ratio weight")
    expected = [("plain", "", ""), *(("smooth", weight, "") for weight in ("1e-08", "1e-06", "0.0001"))]
    assert [cells[:3] for cells in block.cells][:4] == expected and len(block.cells) == 8
    write_csv(tmp_path / "t.csv", rows)
    lines = list(csv.DictReader((tmp_path / "t.csv").read_text(encoding="utf-8").splitlines()))
    with pytest.raises(InputError, match="cannot be written"):
        write_csv(tmp_path / "r.h5" / "t.csv", rows)
    assert [line["gradient.weight"] for line in lines][:3] == ["", "1e-08", "1e-06"]
    assert [line["log_ratio.weight"] for line in lines][3:6] == ["", "0.1", "1.0"]
    frame = comparison(tmp_path / "r.h5")
    assert len(frame) == 8 and list(frame["gradient.weight"])[1:4] == [1e-8, 1e-6, 1e-4]
    assert frame.columns.tolist() == list(lines[0])
    many = [dataclasses.replace(case, recording=f"mouth{number}") for number in range(7) for case in SWEPT]
    (summary,) = screen_blocks(compare(Results(tuple(many))))
    assert len(summary.cells) == 8 and summary.headers[1] == "gradient weight"


@pytest.mark.slow
def test_results_with_swept_numbers_are_plotted_over_them(tmp_path: Path) -> None:
    write_results(tmp_path / "r.h5", SWEPT)
    write_results(tmp_path / "plain.h5", SWEPT[:1])
    assert [path.name for path in plot_results(tmp_path / "r.h5")] == ["sweep_mouth.png"]
    assert [path.name for path in plot_results(tmp_path / "r.h5", frame=6)] == ["contours_mouth_frame6.png"]
    assert [path.name for path in plot_results(tmp_path / "plain.h5")] == ["contours_mouth.png"]
    lines = {str(line.get_label()): line for line in SweepPlot().draw(SWEPT).axes[0].get_lines()}
    assert list(lines) == ["plain", "smooth", "both, log_ratio.weight 0.1", "both, log_ratio.weight 1.0"]
    assert list(lines["smooth"].get_xdata()) == [1e-8, 1e-6, 1e-4]
    with pytest.raises(InputError, match="holds no sweep to draw"):
        plot_results(tmp_path / "plain.h5", show="sweep")
