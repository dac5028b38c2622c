"""Kinds of pictures: the union is walked, a further one is a class in a script or a name in a package; pressures."""

import dataclasses
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.testing import assert_allclose
from support import METHODS, invented_case

from lampest import CaseResult, ContourPlot, InputError, Panel, PressurePlot, Scene, Water, write_results
from lampest.loads.pressure import pressure_of
from lampest.loads.recognition.attachment import Attachment
from lampest.loads.recognition.breathing import Breathing
from lampest.panel.readouts import LoadedColumnsReadout, TwoPointReadout
from lampest.report.detect.answer import Detected
from lampest.report.plots import PLOTS, Plot, picture, plot_of, plot_results
from lampest.report.plots.maps import MapPainter, Scale, Tile, banded_scale
from lampest.report.plots.style import new_figure, save
from lampest.report.plots.timeline import timeline
from lampest.runs.case import COLUMNS
from lampest.runs.columns import FRAMES, Column

ADDON = """\
from dataclasses import dataclass
from lampest.report.plots import Plot
from lampest.report.plots.style import new_figure

@dataclass(frozen=True)
class Steps(Plot):
    kind = "steps"

    def draw(self, cases):
        figure = new_figure(3.0)
        axes = figure.subplots()
        for case in cases:
            axes.plot(case.time, case.iterations, label=case.estimator)
        axes.set_xlabel("time [s]")
        return figure

STEPS = Steps()
TWICE = type("Twice", (Steps,), {"kind": "contours"})()
"""


@pytest.mark.parametrize("plot", PLOTS, ids=lambda plot: plot.kind)
def test_every_kind_is_drawn_by_its_word(
    plot: Plot, disk: SimpleNamespace, lampest: Callable[..., SimpleNamespace]
) -> None:
    assert plot_of(plot.kind) is plot and set(plot.needs) <= {column.name for column in COLUMNS}
    disk.recording(disk.folder / "small.h5", disk.scene + "response: {kind: published}\n")
    sweep = "sweep: {estimators.bare.solver.tolerance: [1e-8, 1e-6]}\n"
    run = disk.run(disk.text + "  bare: {terms: {misfit: {}}, error_bars: false}\n" + sweep)
    assert lampest("run", run, "--out", disk.folder / "out", "--jobs", "1").code == 0
    ended = lampest("plot", disk.folder / "out" / "results.h5", "--show", plot.kind)
    progress = [re.match(r"lampest: \d+ of \d+ ", line) for line in ended.err.splitlines()]  # of a slow machine
    assert ended.code == 0 and all(progress), ended.err
    files = [Path(line) for line in ended.out.splitlines()]
    assert all(file.read_bytes().startswith(b"\x89PNG") for file in files)
    assert [file.name for file in files] == [f"{plot.kind}_small.png"]


def test_a_plot_of_a_package_is_asked_for_by_its_word(package: Callable[..., None], tmp_path: Path) -> None:
    write_results(tmp_path / "r.h5", [invented_case(method) for method in METHODS])
    package("lampest.plots", "addon:STEPS", ADDON)
    assert [file.name for file in plot_results(tmp_path / "r.h5", show="steps")] == ["steps_mouth.png"]
    with pytest.raises(InputError, match=r"no plot 'step'; there are contours, change, .*certainty, sweep, steps"):
        plot_results(tmp_path / "r.h5", show="step")


def test_two_plots_of_one_word_are_refused(package: Callable[..., None]) -> None:
    package("lampest.plots", "addon:TWICE", ADDON)
    with pytest.raises(InputError, match="there are two plots 'contours'"):
        plot_of("contours")


@dataclass(frozen=True)
class SharePlot(Plot):
    kind: ClassVar[str] = "share"
    needs: ClassVar[tuple[str, ...]] = ("share",)

    def draw(self, cases: Sequence[CaseResult]) -> Figure:
        figure = new_figure(2.0)
        figure.subplots().plot(cases[0].time, cases[0].extra["share"])
        return figure


def test_a_plot_of_a_script_draws_a_column_of_a_script(tmp_path: Path) -> None:
    share = Column("share", FRAMES, "1", "a share", lambda done: None)
    write_results(tmp_path / "r.h5", [invented_case(extra={"share": np.ones(3)})], columns=(share,))
    assert plot_results(tmp_path / "r.h5", show=SharePlot(), columns=(share,)) == [tmp_path / "share_mouth.png"]
    with pytest.raises(InputError, match=r"r\.h5: holds no share to draw, which needs share"):
        plot_results(tmp_path / "r.h5", show=SharePlot())


def painted(painter: MapPainter, tile: Tile) -> Axes:
    axes = new_figure(3.0).subplots()
    painter.draw(axes, tile)
    return axes


def maps_of(figure: Figure) -> list[Axes]:
    return [axes for axes in figure.axes if axes.get_title()]


def test_maps_of_resistance_say_their_unit_and_show_readings_as_they_were_recorded() -> None:
    case = invented_case()
    for reference, unit in ((1.0, "in reference resistors"), (1000.0, "[ohm]")):
        scene = replace(case.scene, readout=TwoPointReadout(reference_ohm=reference))
        figure = plot_of("resistance").draw((replace(case, scene=scene),))
        assert {f"reading {unit}", f"resistance {unit}"} <= {axes.get_ylabel() for axes in figure.axes}
    readout = LoadedColumnsReadout(polarity="down", supply_volt=5.0, load_ohm=35e3, drive_ohm=30)
    scene = replace(case.scene, readout=readout, series_resistance_ohm=0.0)
    pulled_up = replace(case, scene=scene, measured=np.full_like(case.measured, 1.5))
    shown = maps_of(plot_of("resistance").draw((pulled_up,)))[0]
    assert_allclose(shown.collections[1].get_array(), 3.5)


def test_residuals_without_noise_are_percent_of_the_readings() -> None:
    case = replace(invented_case(), sigma=None, sigma_baseline=None)
    for factor, note in ((1.03, "rms 3.0 %"), (1.0, "rms < 0.001 %")):
        (axes,) = maps_of(plot_of("residuals").draw((replace(case, reading_model=case.measured * factor),)))
        assert axes.get_title() == f"LSM\n{note}"
        assert_allclose(axes.collections[1].get_array(), 100 * (factor - 1), atol=1e-9)


def test_contours_of_listed_cells_end_where_cells_are_apart() -> None:
    values, square = np.array([[-40.0, 20.0], [60.0, -80.0]]), ((0, 0, 0, 0), (0, 1, 10, 0), (1, 0, 0, 10))
    for far, contours in ((10, 1), (100, 1), (-1000, 0)):
        places = square if far > 0 else tuple((row, column, 50 * x, 50 * y) for row, column, x, y in square)
        panel = Panel(2, 2, cells=(*places, (1, 1, abs(far), abs(far))))
        drawn, plain = (
            painted(MapPainter(panel, banded_scale([values], "x"), contoured), Tile("", values)).collections
            for contoured in (True, False)
        )
        assert len(drawn) - len(plain) == contours


def test_what_is_no_number_is_grey_and_what_was_not_solved_says_so() -> None:
    painter = MapPainter(Panel(1, 2), Scale(Normalize(0, 1), colormaps["YlGnBu"], "resolution"))
    _, cells = painted(painter, Tile("", np.array([[0.5, np.nan]]))).collections
    assert cells.get_array().mask.tolist() == [False, True]
    assert cells.get_cmap().get_bad().tolist() == pytest.approx([0.88, 0.88, 0.88, 1.0])
    axes = painted(painter, Tile("", None))
    assert [text.get_text() for text in axes.texts] == ["not solved"] and not axes.collections
    figure = new_figure(3.0)
    painter.bar(figure, figure.subplots(), "right")
    assert figure.axes[1].get_ylabel() == "resolution"


def case_with_pressure(shape: tuple[int, int, int] = (3, 10, 10), sd: float = 0.1) -> CaseResult:
    case = invented_case(shape=shape, failed=(0,) if shape[0] > 1 else ())
    ratio = case.cell_resistance / case.baseline_resistance
    scene = Scene(Panel(*shape[1:]), water=Water(50.0))
    upper = np.where(case.open_cell != 0, np.inf, ratio * np.exp(1.96 * sd))
    found = pressure_of(ratio, ratio * np.exp(-1.96 * sd), upper, scene)
    return dataclasses.replace(
        case,
        pressure=found.pressure,
        pressure_lower=found.lower,
        pressure_upper=found.upper,
        pressure_errors=found.errors,
        saturated=found.saturated,
    )


@pytest.mark.parametrize(
    ("shape", "sd"), [((3, 10, 10), 0.1), ((1, 1, 1), 0.0), ((1, 1, 7), np.inf), ((2, 5, 1), 0.1), ((1, 24, 16), 1.0)]
)
def test_panels_of_every_shape_are_drawn_with_units_and_frame(
    tmp_path: Path, shape: tuple[int, int, int], sd: float
) -> None:
    case = case_with_pressure(shape, sd)
    for name in ("first.png", "second.png"):
        save(PressurePlot().draw((case,)), tmp_path / name)
    assert (tmp_path / "first.png").read_bytes() == (tmp_path / "second.png").read_bytes()
    figure = PressurePlot(5).draw((case,))
    labels = [text for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel()) if text]
    labels += [figure.get_supxlabel(), figure.get_supylabel()]
    assert len(labels) == 4 and all("[" in label for label in labels) and "frame 5 at 5 s" in figure.get_suptitle()
    for wrong, sentence in ((PressurePlot(99), "frame 99 has no results"), (PressurePlot(), "holds no pressure")):
        with pytest.raises(InputError, match=sentence):
            picture((case if wrong.frame else invented_case(),), wrong)
    for truth in (True, False):
        cases = tuple(invented_case(name, shape=shape, truth=truth) for name in METHODS[:2])
        titles = [axes.get_title().split("\n")[0] for axes in ContourPlot().draw(cases).axes if axes.get_title()]
        assert titles == ["measured", "LSM", "LSR-CR"] + ["truth"] * truth


def test_of_loads_that_have_all_left_a_timeline_shows_every_one() -> None:
    here = Attachment(0.99, 2.0, (30.0, 1.0), (20.0, 1.0), (35.0, 1.0), breath=Breathing(6.0))
    gone = replace(here, since_s=1.0, until_s=1.5, sucks=0.1, x_mm=(5.0, 1.0), diameter_mm=None)
    course, change = np.stack([np.linspace(0.5, 4, 8), np.arange(8.0)]), np.full((4, 6), np.log(1.5))
    for loads, widths, crosses in (((gone, here), [0.5, 2.0], 1), ((gone, replace(here, until_s=3.0)), [0.5, 1.0], 2)):
        known = {"course": course, "change": change, "panel": Panel(4, 6)}
        axes, places, *_ = timeline(Detected.of("mouth", loads, 4.0, **known)).get_axes()
        assert [band.get_width() for band in axes.patches] == widths and len(places.lines) == crosses
    bare = timeline(Detected.of("none", (), 4.0, course=course)).get_axes()[1]
    assert [text.get_text() for text in bare.texts] == ["nothing was there"] and not bare.axison
