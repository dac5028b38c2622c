"""Withheld readings are predicted better than by interpolation."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import lampest
from docs.studies import real
from docs.studies.withheld import predictions
from lampest import Panel, Scene, TwoPointReadout, read_run

READOUT = TwoPointReadout(adc_bits=12, readings=1, noise_lsb=1.0, reference_ohm=500.0)
RUN = """schema: 1
recordings: [mine.h5]
estimators:
  smooth: {terms: {misfit: {weighting: noise}, log_gradient: {weight: 30.0}}, formulation: reduced}
"""


def recorded(folder: Path) -> lampest.Recording:
    """Smooth loads that go over a panel."""
    panel, rng = Panel(7, 7, 8.0), np.random.default_rng(4)
    x, y = panel.places_mm
    at = np.linspace(10, 40, 6)
    cells = np.stack([2000 * np.exp(-2.5 * np.exp(-((x - here) ** 2 + (y - 24) ** 2) / 400)) for here in at])
    codes = READOUT.volt_from_recorded(READOUT.exact_reading(cells)) / READOUT.lsb_volt
    codes = np.round(codes + rng.standard_normal(codes.shape))
    role, time = np.ones(len(at), dtype=np.uint8), np.arange(len(at), dtype=float)
    recording = lampest.Recording(
        Scene(panel, READOUT), READOUT.recorded_from_volt(codes * READOUT.lsb_volt), time, role
    )
    recording.save(folder / "mine.h5")
    (folder / "run.yaml").write_text(RUN)
    return replace(recording, name="mine")


def test_withheld_readings_are_predicted_better_than_by_interpolation(tmp_path: Path) -> None:
    recording = recorded(tmp_path)
    (case,) = read_run(tmp_path / "run.yaml").cases
    found = [one for one in predictions(recording, case, 0.1, 1, 0) if one.factor == 1]
    assert len(found) == 6 and all(one.solved and one.readings == 5 for one in found)
    assert np.median([one.error / one.interpolated for one in found]) < 0.5
    assert np.median([one.hidden for one in found]) > 2


@pytest.mark.slow
def test_the_table_of_real_recordings_has_a_row_for_every_method(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    estimators = {name: real.ESTIMATORS[name] for name in ("`log_gradient`", "`cell_resistance`")}
    monkeypatch.setattr(real, "ESTIMATORS", estimators)
    study = real.Withheld.of(recorded(tmp_path), 0.1, 3)
    rows = {row.method: row for row in real.rows(study)}
    assert list(rows) == [*real.OTHERS, *estimators] and all(row.solved == 1 for row in rows.values())
    assert np.isnan(study.recording.recorded[study.held]).all() and study.held.sum() == 6 * 5
    assert rows["interpolation"].ratio == 1
    ours = rows["`log_gradient`"]
    assert ours.ratio < 0.5 and ours.covered > 0.8 and ours.weight_sigma < 1
    assert all(rows[name].ratio < 1 for name in ("fixed point (Medrano-Sánchez)", "truncated inversion, best rank"))
    assert ours.ratio < min(row.ratio for row in rows.values() if row is not ours)
