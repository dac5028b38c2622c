"""The picture of pressure: every panel shape, open intervals, the same bytes twice, and what it refuses."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from support import invented_case

from lampest.files.errors import InputError
from lampest.loads.pressure import pressure_of
from lampest.panel.panel import Panel
from lampest.panel.scene import Scene, Water
from lampest.report.plots import picture
from lampest.report.plots.contours import PressurePlot
from lampest.report.plots.style import save
from lampest.runs.results import CaseResult


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
def test_pressures_of_every_shape_are_drawn(tmp_path: Path, shape: tuple[int, int, int], sd: float) -> None:
    case = case_with_pressure(shape, sd)
    for name in ("first.png", "second.png"):
        save(PressurePlot().draw((case,)), tmp_path / name)
    assert (tmp_path / "first.png").read_bytes() == (tmp_path / "second.png").read_bytes()


def test_units_and_frame_are_told() -> None:
    case = case_with_pressure()
    figure = PressurePlot(6).draw((case,))
    labels = [text for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel()) if text]
    labels += [figure.get_supxlabel(), figure.get_supylabel()]
    assert len(labels) == 4 and all("[" in label for label in labels)
    assert "frame 6 at 6 s" in figure.get_suptitle()


def test_nothing_to_draw_is_one_sentence() -> None:
    case = case_with_pressure()
    with pytest.raises(InputError, match="frame 99 has no results"):
        PressurePlot(99).draw((case,))
    with pytest.raises(InputError, match="holds no pressure"):
        picture((invented_case(),), "pressure")
