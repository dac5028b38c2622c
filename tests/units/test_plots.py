"""Kinds of pictures; a further one is a class in a script or a name in a package."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contracts.extensions import Histogram
from golden.outputs import invented
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from support import invented_case

from lampest import InputError, Panel, read_results, write_results
from lampest.cli.results import compare
from lampest.report.plots import PLOTS, plot_of, plot_results, style
from lampest.report.plots.maps import Tile, maps_figure, signed_scale
from lampest.runs.case import all_columns
from lampest.runs.columns import FRAMES, Column


@pytest.mark.slow
def test_every_kind_is_drawn_by_its_word(tmp_path: Path) -> None:
    swept = (
        replace(invented()[0], estimator=f"a{n}", swept_json=f'{{"weight": {n}.0}}')
        for n in range(2)
    )
    write_results(tmp_path / "r.h5", [*swept])
    for plot in PLOTS:
        assert plot_of(plot.kind) is plot and set(plot.needs) <= {
            column.name for column in all_columns()
        }
        (file,) = plot_results(tmp_path / "r.h5", show=plot.kind)
        assert file.name == f"{plot.kind}_mouth.png" and file.read_bytes().startswith(b"\x89PNG")


def test_a_plot_of_a_script_draws_a_column_of_a_script(tmp_path: Path) -> None:
    share = Column("share", FRAMES, "1", "a share", lambda done: None)
    plot: Any = type("SharePlot", (Histogram,), {"kind": "share", "needs": ("share",)})()
    write_results(tmp_path / "r.h5", [invented_case(extra={"share": np.ones(3)})], columns=(share,))
    assert plot_results(tmp_path / "r.h5", show=plot, columns=(share,)) == [
        tmp_path / "share_mouth.png"
    ]
    with pytest.raises(InputError, match=r"r\.h5: holds no share to draw, which needs share"):
        plot_results(tmp_path / "r.h5", show=plot)


def test_a_picture_is_laid_out_and_drawn_once(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = list[str]()

    def counted(owner: type, name: str) -> None:
        original = getattr(owner, name)

        def called(*arguments: Any, **named: Any) -> Any:
            calls.append(name)
            return original(*arguments, **named)

        monkeypatch.setattr(owner, name, called)

    counted(ConstrainedLayoutEngine, "execute")
    counted(Figure, "draw")
    counted(Axes, "get_tightbbox")
    tiles = [Tile(name, np.eye(3)) for name in "abc"]
    figure = maps_figure(tiles, Panel(3, 3), signed_scale([np.eye(3)], "b", 1.0))
    assert style.data_uri(figure).startswith("data:image/png")
    passes = 2  # of the layout, each of which measures the maps and their colour bar
    assert calls == ["execute", *passes * (len(tiles) + 1) * ["get_tightbbox"], "draw"]


def test_maps_have_ticks_where_numbers_stand_beside_them() -> None:
    tiles = [Tile(str(number), np.eye(4)) for number in range(5)]
    figure = maps_figure(tiles, Panel(4, 4), signed_scale([np.eye(4)], "b", 1.0))
    of_tiles = figure.axes[: len(tiles)]
    below = [axes.xaxis.get_tick_params() for axes in of_tiles]
    beside = [axes.yaxis.get_tick_params() for axes in of_tiles]
    assert [look["bottom"] for look in below] == [False, False, True, True, True]
    assert [look["labelbottom"] for look in below] == [False, False, True, True, True]
    assert [look["left"] for look in beside] == [True, False, False, True, False]


def test_a_table_and_its_page_read_a_results_file_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_results(tmp_path / "r.h5", [invented()[0]])
    read = list[Path]()

    def counted(path: Path, frames: range | None = None) -> Any:
        read.append(path)
        return read_results(path, frames=frames)

    monkeypatch.setattr("lampest.runs.results.read_results", counted)
    compare([tmp_path / "r.h5"], report=tmp_path / "page.html")
    assert read == [tmp_path / "r.h5"]
