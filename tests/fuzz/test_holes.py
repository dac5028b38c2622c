"""Recordings riddled with what devices send in place of readings: an estimate, or NaN and a sentence, never a crash."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from lampest.cost.losses import Huber
from lampest.cost.terms import (
    Arrival,
    CellResistance,
    Gradient,
    LogRatio,
    Misfit,
    RelativeChange,
    Term,
    TotalVariation,
)
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods import MethodName
from lampest.files.errors import InputError
from lampest.panel.panel import Panel
from lampest.panel.readouts import LoadedColumnsReadout, TwoPointReadout
from lampest.panel.scene import Scene
from lampest.recording.simulation.simulation import Simulation, simulate
from lampest.report.reconstruction import Reconstruction

SENT = [np.nan, np.nan, np.inf, -np.inf, 0.0, -5.0, 1e-300, 100.0, 1e9]
SCENES = {
    "two_point": Scene(Panel(4, 5), TwoPointReadout(), 140.0),
    "unknown": Scene(Panel(4, 5)),
    "loaded_columns": Scene(Panel(4, 5), LoadedColumnsReadout(supply_volt=3.3, adc_bits=12, drive_ohm=100.0)),
}
TERMS: dict[str, tuple[Term, ...]] = {
    "LSM": (Misfit(),),
    "huber": (Misfit(weighting="noise", loss=Huber(corner=3.0)),),
    "cell_resistance": (Misfit(), CellResistance(weight=1e-3)),
    "relative_change": (Misfit(), RelativeChange(weight=10.0)),
    "gradient": (Misfit(), Gradient(weight="auto")),
    "total_variation": (Misfit(), TotalVariation(weight=1e-2)),
    "log_ratio": (Misfit(), LogRatio(weight=1e-2)),
    "arrival": (Misfit(weighting="noise"), Arrival()),
}
FORMULATIONS: list[MethodName] = [
    "nodal",
    "reduced",
    "per_pixel",
    "naive",
    "scaled",
    "linearised",
    "truncated",
]


@pytest.mark.slow
@pytest.mark.parametrize("name", TERMS)
@pytest.mark.parametrize("kind", SCENES)
def test_any_holes_leave_an_estimate_or_one_sentence(kind: str, name: str) -> None:
    scene, rng = SCENES[kind], np.random.default_rng([len(kind), len(name)])
    whole = simulate(Simulation(1, 3, SCENES["two_point"] if kind == "unknown" else scene, frames=2))
    for formulation in rng.choice(FORMULATIONS, 3, replace=False).tolist():
        values = whole.recorded.copy()
        hit = rng.random(values.shape) < rng.uniform(0.0, 0.6)
        values[hit] = rng.choice(SENT, hit.sum())
        if rng.random() < 0.3:
            values[rng.integers(len(values))] = np.nan
        made = replace(whole, scene=scene, recorded=values)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                found = Reconstruction.of(made, Estimator(TERMS[name], formulation))
            except InputError as error:
                assert "\n" not in str(error)
                continue
            found.result()
        cells = np.isfinite(found.cell_resistance).all(axis=(1, 2))
        assert np.array_equal(cells, found.solved)
        assert np.all(np.isnan(found.cell_resistance[~cells]))
        assert all(status for status in found.status)
