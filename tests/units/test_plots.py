"""Kinds of pictures: the union is walked.

A further one is a class in a script or a name in a package.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contracts.extensions import Histogram
from golden.outputs import invented
from support import invented_case

from lampest import InputError, write_results
from lampest.report.plots import PLOTS, plot_of, plot_results
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
