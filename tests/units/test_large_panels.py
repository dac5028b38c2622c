"""`lampest run` says beforehand how long a large panel takes; `--yes` insists."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import numpy as np
import pytest

from lampest import Estimator, Gradient, LinearisedMethod, Misfit, Panel, Recording, Scene, TwoPointReadout

Command = Callable[..., SimpleNamespace]
RUN = "{schema: 1, recordings: [r.h5], estimators: {E: {terms: {misfit: {}%s}}}}"


def large(folder: Path, size: int, more: str = ", gradient: {weight: 1}") -> Path:
    """A run of one frame of that many rows and columns."""
    scene = Scene(Panel(size, size), readout=TwoPointReadout(noise_lsb=0.7))
    values, role = np.full((2, size, size), 1500.0), np.array([0, 1], dtype=np.uint8)
    Recording(scene, values, np.arange(2.0), role).save(folder / "r.h5")
    (folder / "run.yaml").write_text(RUN % more)
    return folder / "run.yaml"


@pytest.mark.parametrize("size", [400, 1000])
def test_a_panel_beyond_patience_is_refused_before_anything_is_written(
    tmp_path: Path, lampest: Command, size: int
) -> None:
    done = lampest("run", large(tmp_path, size), "--out", tmp_path / "out")
    assert done.code == 2 and "min and" in done.err and "--yes" in done.err and not (tmp_path / "out").exists()


def test_a_panel_beyond_memory_is_refused(tmp_path: Path, lampest: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LAMPEST_MEMORY", "150MB")
    done = lampest("run", large(tmp_path, 150), "--out", tmp_path / "out")
    assert done.code == 2 and "MiB of memory" in done.err


@pytest.mark.parametrize(("size", "words"), [(400, ("--yes",)), (100, ())])
def test_who_insists_and_what_is_small_is_run(
    tmp_path: Path, lampest: Command, size: int, words: tuple[str, ...]
) -> None:
    with mock.patch("lampest.runs.batch.run_batch", side_effect=KeyboardInterrupt) as batch:
        lampest("run", large(tmp_path, size), "--out", tmp_path / "out", *words)
    assert batch.called


def test_less_work_has_less_effort() -> None:
    terms = (Misfit(), Gradient(weight=1.0))
    assert Estimator(terms).effort(Panel(400, 400))[0] > 200
    assert Estimator((Misfit(),)).effort(Panel(400, 400)) == (0, 0)
    assert Estimator(terms, LinearisedMethod()).effort(Panel(400, 400)) == (0, 0)
