"""Reports of results: a page that needs no other file, and tables of presses."""

import dataclasses
from base64 import b64decode
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread
from support import METHODS, invented_case

from lampest import CaseResult, InputError, write_results
from lampest.apps.page.all_frames import MAX_FRAMES, all_frames
from lampest.apps.page.compared import Batch
from lampest.apps.page.page import report, write_report
from lampest.apps.recognition.detect.pressed import pressed_of
from lampest.cli.screen import print_table
from lampest.inference.estimated import estimated_lines
from lampest.report.compare import Table

SHAPE = (3, 10, 10)
DRAWS = 200  # the standard deviation of so many is known to 5 %
MAX_BYTES = 2_000_000  # of a page with its pictures


def batch(*cases: CaseResult) -> Batch:
    return Batch.of(["results.h5"], cases)


def certain(case: CaseResult) -> CaseResult:
    """With noise, error bars of 8 %, resolution and weights."""
    cells = case.cell_resistance
    change = case.relative_change
    half = 0.16 * np.abs(100 + case.relative_change)
    fields: dict[str, Any] = {
        "sigma": 0.01 * case.measured,
        "cell_resistance_errors": 0.08 * cells,
        "cell_resistance_lower": cells * np.exp(-0.16),
        "cell_resistance_upper": np.where(case.open_cell != 0, np.inf, cells * np.exp(0.16)),
        "relative_change_errors": half / 2,
        "relative_change_lower": change - half,
        "relative_change_upper": change + half,
        "resolution": np.where(case.solved[:, None, None], 0.7, np.nan) * np.ones(cells.shape),
        "data_share": np.where(case.solved[:, None, None], 0.8, np.nan) * np.ones(cells.shape),
    }
    pressures = {
        "saturated": case.open_cell,
        "pressure": np.where(case.solved[:, None, None], 3.0, np.nan) * np.ones(cells.shape),
    }
    return dataclasses.replace(case, **fields, extra=pressures)


class Page(HTMLParser):
    """The page's tags, checked for balance, and its text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "link", "img", "input", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).replace("\N{NO-BREAK SPACE}", " ").split())

    def values(self, attribute: str) -> list[str]:
        return [str(given[attribute]) for _, given in self.tags if attribute in given]


@pytest.mark.slow
def test_a_page_is_self_contained_and_recommends_nothing_without_truth_and_noise() -> None:
    """Texts that come from files are text."""
    names = ("<script>alert(1)&", "a\"b'c", "$\\frac$ x^2", "{{ 7 * 191 }}", "y" * 190)
    known: dict[str, Any] = {"case_yaml": "</pre><b>&", "truth": False, "weights": {}}
    cases = [
        invented_case(name, "<img src=x onerror=alert(1)>", (2, 3, 3), **known) for name in names
    ]
    page = Page(report(batch(*cases)))
    assert [tag for tag, _ in page.tags].count("script") == 1  # that of the slider
    assert "alert(1)>" in page.text  # a name is text
    assert not {tag for tag, _ in page.tags} & {
        "iframe",
        "object",
        "embed",
        "base",
        "form",
    }
    assert (
        all(name in page.text for name in names[:4])
        and "</pre><b>&" in page.text
        and "1337" not in page.text
    )
    assert page.values("src") and all(uri.startswith("data:image/") for uri in page.values("src"))
    assert all(given.get("alt") for tag, given in page.tags if tag == "img")
    anchors = page.values("id")
    links = page.values("href")
    assert all(link.startswith(("#", "data:,")) for link in links) and len(anchors) == len(
        set(anchors)
    )
    assert {link[1:] for link in links if link[0] == "#"} <= {*anchors}
    assert (
        "which fewer than two of them have" in page.text
        and "cannot rank the estimators" in page.text
    )


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(1, 4, 4), (2, 1, 1), (2, 1, 7), (2, 7, 1), (2, 2, 30)])
def test_a_report_of_any_shape_is_written_despite_failures(shape: tuple[int, int, int]) -> None:
    """In one case no frame was solved; in another changes are NaN without an unloaded panel."""
    cases = [certain(invented_case(method, shape=shape)) for method in METHODS[:2]]
    cases.append(invented_case("failed", shape=shape, failed=tuple(range(shape[0]))))
    cases.append(invented_case("unsure", shape=shape, relative_change=np.full(shape, np.nan)))
    page = Page(report(batch(*cases)))
    assert all(case.estimator in page.text for case in cases)
    for word in (
        "95 % intervals: mean width",
        "resolution",
        "saturated cells",
        "pressure",
        "gradient λ = 0.5",
        "[ms]",
    ):
        assert word in page.text, word


@pytest.mark.slow
def test_a_slider_shows_the_maps_of_every_frame() -> None:
    """Frames stand in a strip one under another, in the order of the labels."""
    case = invented_case("LSM", shape=(4, 3, 5))
    shown = all_frames([case], place=2)
    assert shown is not None and shown.first == 2 and shown.shape == (3, 5) and not shown.left_out
    assert shown.labels == tuple(
        f"frame {n} at {time:.4g} s" for n, time in zip(case.frame, case.time, strict=True)
    )
    titles = [*shown.strips]
    assert titles == ["measured", "estimated: LSM", "truth"]
    images = [imread(BytesIO(b64decode(uri.split(",")[1]))) for uri in shown.strips.values()]
    assert all(image.shape == (4 * 3, 5, 4) for image in images)
    changes = [np.nan_to_num(case.relative_change), images[1].reshape(4, 3, 5, 4)]
    strongest = np.unravel_index(np.argmax(changes[0]), (4, 3, 5))
    assert changes[1][strongest][0] > changes[1][strongest][2]  # a rise is red
    page = Page(report(batch(case)))
    sliders = [given for tag, given in page.tags if tag == "input" and given.get("type") == "range"]
    assert [slider["max"] for slider in sliders] == ["3"]


@pytest.mark.slow
def test_a_slider_of_a_long_recording_leaves_frames_out_and_says_so() -> None:
    case = invented_case("LSM", shape=(MAX_FRAMES + 50, 2, 2))
    shown = all_frames([case], place=101)
    assert shown is not None and MAX_FRAMES <= len(shown.labels) <= MAX_FRAMES + 1
    assert shown.labels[shown.first].startswith(f"frame {case.frame[101]} ")
    assert "frames between the shown ones are left out" in Page(report(batch(case))).text


@pytest.mark.slow
def test_reports_are_reproducible_and_wrong_input_gives_one_sentence(tmp_path: Path) -> None:
    source = tmp_path / "results.h5"
    out = tmp_path / "report.html"
    write_results(
        source, [certain(invented_case(method, shape=(3, 4, 4))) for method in METHODS[:2]]
    )
    write_report([source], out)
    first = out.read_bytes()
    write_report([source], out)
    assert first == out.read_bytes() and len(first) < MAX_BYTES
    with pytest.raises(InputError, match="named twice"):
        write_report([source, tmp_path / "." / "results.h5"], out)
    with pytest.raises(InputError, match="cannot be written"):
        write_report([source], source / "report.html")
    write_results(tmp_path / "empty.h5", [])
    with pytest.raises(InputError, match="no results to report"):
        write_report([tmp_path / "empty.h5"], out)


def pressing(estimator: str = "LSM", **maps: np.ndarray) -> CaseResult:
    """Return an estimate in which 1 kPa presses clearly, without common errors but in `maps`."""
    known = {
        "pressure_common": np.zeros(SHAPE),
        "pressing": (maps["pressure"] > 1).astype(np.uint8),
    }
    return invented_case(estimator, shape=SHAPE, extra=known | maps)


def maps() -> tuple[np.ndarray, np.ndarray]:
    """kPa: nothing, then a block at rows 4 and 5, columns 6 to 8, then one cell in the corner."""
    pressure = np.full(SHAPE, 0.1)
    errors = np.full(SHAPE, 0.2)
    pressure[1, 4:6, 6:9] = 10.0, 12.0, 10.0
    pressure[2, 0, 0] = 8.0
    return pressure, errors


@pytest.mark.slow
def test_forces_of_noisy_maps_scatter_by_their_errors() -> None:
    pressure, errors = maps()
    rng = np.random.default_rng(4)
    forces = list[float]()
    for _ in range(DRAWS):
        noisy = pressure + errors * rng.standard_normal(SHAPE) * (pressure > 1)
        pressed = pressed_of(pressing(pressure=noisy, pressure_own=errors))
        forces.append(pressed.values[1, -1])
    assert np.std(forces) == pytest.approx(pressed.errors[1, -1], rel=4 / np.sqrt(2 * DRAWS))


@pytest.mark.parametrize("sources", [1, 3])
def test_a_wide_table_folds_its_texts_and_keeps_its_figures(
    sources: int, capsys: pytest.CaptureFixture[str]
) -> None:
    numbers = range(5 if sources == 1 else 7)
    headers = ("recording", "what", "nothing", *(f"number {number} [kPa]" for number in numbers))
    figures = [f"{-1.5 * number:.1f} ± {number}.25" for number in range(len(headers) - 3)]
    rows = tuple(
        (f"panel_{source}", "ring or rod or lamprey or cup", "", *figures)
        for source in range(sources)
    )
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
    print_table(Table(("", *map(str, range(30))), (("x", *["1.25 ± 0.25"] * 30),)))
    assert capsys.readouterr().out.count("1.25 ± 0.25") == 30, (
        "whole where no terminal is wide enough, too"
    )


@pytest.mark.parametrize(
    ("number", "deviation", "words"),
    [
        pytest.param(6.1e-11, 0.058, "0 ± 0.058", id="far below its deviation"),
        pytest.param(-3e-9, 0.01, "0 ± 0.01", id="negative and far below"),
        pytest.param(148.23, 0.32, "148.23 ± 0.32", id="far above its deviation"),
        pytest.param(1234.0, 120.0, "1230 ± 120", id="hundreds"),
        pytest.param(1e-6, 2e-7, "1e-06 ± 2e-07", id="small"),
        pytest.param(12.0, 0.0, "12 ± 0", id="without deviation"),
    ],
)
def test_a_determined_number_has_the_digits_of_its_deviation(
    number: float, deviation: float, words: str
) -> None:
    assert estimated_lines({"contacts": (number, deviation)}) == (f"contacts: {words} ohm",)


def test_lines_of_estimated_numbers_have_their_units_and_are_few() -> None:
    held = {
        "readout.passes_volt": (0.1, 4.25),
        "systematic.inl_lsb": (0.5, 0.123),
        "systematic.wire_ohm_per_cell": (0.2, 0.1),
        "leaks of row 3": (1e-4, 1e-5),
        "converter_memory": (0.04, 0.001),
    }
    assert estimated_lines(held) == (
        "readout.passes_volt: 0.1 to 4.25 V",
        "systematic.inl_lsb: 0.5 ± 0.12 LSB",
        "systematic.wire_ohm_per_cell: 0.2 ± 0.1 ohm a cell",
        "leaks of row 3: 0.0001 ± 1e-05 siemens",
        "converter_memory: 0.04 ± 0.001 (relative)",
    )
    of_modules = estimated_lines(
        {f"gain of module [0, {number}]": (0.1, 0.1) for number in range(20)}
    )
    assert (
        len(of_modules) == 13
        and of_modules[-1] == "8 more numbers, which the scene of the results holds"
    )
    assert estimated_lines(None) == ()


def test_optima_of_older_files_count_as_local_optima() -> None:
    case = invented_case(
        status=("optimum verified", "local optimum verified", "an optimum, but a plateau"),
        starts=np.array([1, 7, 3]),
        shape=(3, 2, 3),
    )
    assert case.local_optima == (3, 1, 7)
