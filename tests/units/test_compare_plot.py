"""Tables and pictures of results: right numbers, every panel shape, the same bytes twice."""

import dataclasses
import json
from pathlib import Path

import pytest
from support import invented_case

from lampest import InputError, SweepPlot, plot_results
from lampest.cli.screen import print_table
from lampest.report.compare import Table
from lampest.runs.results import CaseResult, write_results


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
