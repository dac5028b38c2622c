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
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from support import METHODS, invented_case

from lampest import CaseResult, InputError, Panel, PressurePlot, Scene, Water, write_results
from lampest.loads.pressure import pressure_of
from lampest.loads.recognition.attachment import Attachment
from lampest.loads.recognition.breathing import Breathing
from lampest.report.detect.answer import Detected
from lampest.report.plots import PLOTS, Plot, picture, plot_of, plot_results
from lampest.report.plots.maps import MapPainter, Scale, Tile
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


def test_every_kind_is_drawn_by_its_word(disk: SimpleNamespace, lampest: Callable[..., SimpleNamespace]) -> None:
    disk.recording(disk.folder / "small.h5", disk.scene + "response: {kind: published}\n")
    sweep = "sweep: {estimators.bare.solver.tolerance: [1e-8, 1e-6]}\n"
    run = disk.run(disk.text + "  bare: {terms: {misfit: {}}, error_bars: false}\n" + sweep)
    assert lampest("run", run, "--out", disk.folder / "out", "--jobs", "1").code == 0
    for plot in PLOTS:
        assert plot_of(plot.kind) is plot and set(plot.needs) <= {column.name for column in COLUMNS}
        ended = lampest("plot", disk.folder / "out" / "results.h5", "--show", plot.kind)
        progress = [re.match(r"lampest: \d+ of \d+ ", line) for line in ended.err.splitlines()]  # of a slow machine
        assert ended.code == 0 and all(progress), ended.err
        (file,) = map(Path, ended.out.splitlines())
        assert file.name == f"{plot.kind}_small.png" and file.read_bytes().startswith(b"\x89PNG")


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


def test_what_is_no_number_is_grey() -> None:
    painter = MapPainter(Panel(1, 2), Scale(Normalize(0, 1), colormaps["YlGnBu"], "resolution"))
    axes = new_figure(3.0).subplots()
    painter.draw(axes, Tile("", np.array([[0.5, np.nan]])))
    _, cells = axes.collections
    assert cells.get_array().mask.tolist() == [False, True]
    assert cells.get_cmap().get_bad().tolist() == pytest.approx([0.88, 0.88, 0.88, 1.0])


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
