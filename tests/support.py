"""Helpers of several tests: invented but consistent results, live without haste, code of pages."""

import dataclasses
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from lampest import Array, CaseResult, Estimator, Panel, Scene
from lampest.apps.live.engine import Engine, FrameSource
from lampest.apps.live.message import Picture
from lampest.apps.live.watcher import Scan

METHODS = ("LSM", "LSR-CR", "LSR-dCR", "LSR-gCR", "LSR-gdCR")


def mouth(rows: int, columns: int, frames: int, pitch_mm: float = 10.0) -> Array:
    """Relative change in percent under a mouth of 35 mm that grips harder from frame to frame."""
    y, x = np.meshgrid(np.arange(rows) * pitch_mm, np.arange(columns) * pitch_mm, indexing="ij")
    distance = np.hypot(x - 0.45 * (columns - 1) * pitch_mm, y - 0.55 * (rows - 1) * pitch_mm)
    pattern = -92 * np.exp(-(((distance - 17) / 6) ** 2)) + 320 * np.exp(-((distance / 8) ** 2))
    return pattern * np.linspace(0.4, 1, frames)[:, None, None]


def invented_case(
    estimator: str = "LSM",
    recording: str = "mouth",
    shape: tuple[int, int, int] = (3, 10, 10),
    truth: bool = True,
    failed: tuple[int, ...] = (),
    **changes: Any,
) -> CaseResult:
    """A case as a solver could have left it; the noise is fixed by the names."""
    frames, rows, columns = shape
    shared = np.random.default_rng(sum(map(ord, recording)))
    own = np.random.default_rng(sum(map(ord, estimator + recording)))
    baseline = 3050 * (1 + 0.03 * shared.standard_normal((rows, columns)))
    cells = baseline * (1 + mouth(rows, columns, frames) / 100)
    measured_baseline = baseline * (rows + columns - 1) / (rows * columns)
    change = mouth(rows, columns, frames)
    measured = measured_baseline * (1 + 0.3 * np.minimum(change, 20) / 100)
    estimate = cells * np.exp(0.08 * own.standard_normal(shape))
    model = measured * (1 + 0.01 * own.standard_normal(shape))
    solved = np.ones(frames, dtype=bool)
    solved[list(failed)] = False
    for values in (estimate, model):
        values[~solved] = np.nan
    case = CaseResult(
        recording=recording,
        estimator=estimator,
        case_id="0123456789abcdef",
        case_yaml="terms:\n  misfit: {}\n",
        versions={"lampest": "0.1.0", "casadi": "3.7.2", "numpy": "2.0.0", "h5py": "3.12.0"},
        scene=Scene(Panel(rows, columns), series_resistance_ohm=140.0),
        frame=np.arange(5, 5 + frames),
        time=np.arange(5, 5 + frames) * 1.0,
        measured=measured,
        measured_baseline=measured_baseline,
        cell_resistance=estimate,
        relative_change=(estimate / baseline - 1) * 100,
        reading_model=model,
        open_cell=((estimate > 3.6 * baseline) & solved[:, None, None]).astype(np.uint8),
        at_lower_bound=np.zeros(shape, dtype=np.uint8),
        baseline_resistance=baseline,
        status=tuple(
            "solved to the tolerance" if good else "stopped: too many iterations" for good in solved
        ),
        iterations=own.integers(5, 30, frames),
        solve_time=own.uniform(0.1, 0.3, frames),
        objective=own.uniform(1, 2, frames),
        kkt_residual=10.0 ** own.uniform(-12, -9, frames),
        costs={"misfit": own.uniform(0, 1, frames)},
        weights={term: np.full(frames, 0.5) for term in ("misfit", "gradient")},
        baseline_status="solved to the tolerance",
        baseline_solve_time=0.2,
        joint_start=estimator in ("LSR-dCR", "LSR-gdCR"),
        solved=solved,
        truth=cells if truth else None,
        truth_baseline=baseline if truth else None,
    )
    return dataclasses.replace(case, **changes)


class Patient(Engine):
    """An engine that solves each frame before it takes the next, and keeps all pictures."""

    def __init__(self, estimator: Estimator, baseline: int) -> None:
        super().__init__("test", "test", estimator, baseline)
        self.pictures: list[Picture] = []

    def take(self, source: FrameSource, scan: Scan) -> None:
        super().take(source, scan)
        while self._solving is not None and self._arrivals._news.number > len(self.pictures):
            picture = self.shown.item.picture
            if picture is not None and picture.number == self.shown.item.frames:
                self.pictures.append(picture)
            elif self._solving.done():
                self._solving.result()
            time.sleep(1e-3)


def live_pictures(
    estimator: Estimator, baseline: int, feed: Callable[[Engine], None]
) -> list[Picture]:
    """Return the pictures of an engine after a feed.

    The first `baseline` frames are unloaded if the feed does not mark them.
    """
    with Patient(estimator, baseline) as engine:
        feed(engine)
        engine.finish()
        return engine.pictures


def block_of(page: Path, language: str) -> str:
    """A page's only block of code in a language."""
    (block,) = re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    return block


def until(condition: Callable[[], object], seconds: float = 60.0) -> None:
    """Wait for a condition, which must come true."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never came"
        time.sleep(0.01)
