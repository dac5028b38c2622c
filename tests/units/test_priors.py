"""Priors of numbers stand once, in the files of their effects."""

import json
import subprocess
import sys

import pytest

from lampest.apps.recognition.model_errors import ModelErrors
from lampest.inference.assumptions import ASSUMED

# In a fresh process priors have other values before anything reads them.
CHANGED = """
import json

import lampest.panel.response
lampest.panel.response.TYPICAL_RESPONSE_SD = 0.77
from lampest.panel.effects import channels
from lampest.panel.effects import converter_curve
from lampest.panel.effects import reference
from lampest.panel.effects import series
from lampest.panel.effects import wire

channels.ChannelSpread.prior = 7.0
channels.TYPICAL_OHM, channels.WORST_OHM = 71.0, 171.0
converter_curve.ConverterCurve.prior = 0.7
reference.ReferenceTolerance.prior = 0.017
lampest.panel.effects.E24_TOLERANCE = 0.07
series.SeriesTolerance.prior = 37.0
wire.WirePerCell.prior = 0.27

from lampest.panel.effects import converter_memory
converter_memory.KeptShare.prior = 0.037

import lampest
from lampest.apps.calibration import channels as of_channels
from lampest.apps.calibration import circuit_fit, resistors
from lampest.apps.recognition.model_errors import ModelErrors
from lampest.inference.circuits import parameters
from lampest.panel.sizes import Systematic
from lampest.panel.effects import systematic_of

names = (
    "channel_spread_ohm", "inl_lsb", "reference_tolerance", "series_tolerance_ohm",
    "wire_ohm_per_cell",
)
panel = lampest.Panel(2, 3)
scenes = [
    lampest.Scene(panel, lampest.TwoPointReadout(), systematic=systematic)
    for systematic in (None, Systematic(**dict.fromkeys(names, "estimated")), "typical")
]
estimated, typical = (systematic_of(scene) for scene in scenes[1:])
print(json.dumps({
    "estimated": [getattr(estimated, name) for name in names],
    "typical": [getattr(typical, name) for name in (*names, "response_sd")],
    "calibrated channels": of_channels.prior_sizes(scenes[0]).channel_spread_ohm,
    "calibrated memory": circuit_fit.EXPECTED["converter_memory"][1],
    "calibrated wire": [
        circuit_fit.EXPECTED[f"lines.{line}_ohm_per_cell"][1] for line in ("row", "column")
    ],
    "tried memory": parameters.LINEAR_MEMORY,
    "calibrated resistors": [
        circuit_fit.TYPICAL_OHM, circuit_fit.WORST_OHM, resistors.WORST_OHM,
        circuit_fit.E24_TOLERANCE, resistors.E24_TOLERANCE,
    ],
    "recognition": ModelErrors().channel_ohm,
}))
"""


@pytest.mark.slow
def test_scenes_calibrations_and_recognition_read_priors_from_the_effects_files() -> None:
    completed = subprocess.run(
        [sys.executable, "-c", CHANGED], capture_output=True, text=True, check=True
    )
    assert json.loads(completed.stdout) == {
        "estimated": [7.0, 0.7, 0.017, 37.0, 0.27],
        "typical": [0.0, 0.7, 0.017, 37.0, 0.27, 0.77],
        "calibrated channels": 7.0,
        "calibrated memory": 0.037,
        "calibrated wire": [0.27, 0.27],
        "tried memory": 0.037,
        "calibrated resistors": [71.0, 171.0, 171.0, 0.07, 0.07],
        "recognition": 7.0,
    }


def test_the_creep_of_a_cell_is_one_number_for_recognition_and_inference() -> None:
    assert abs(ModelErrors().resting_sd(seconds=40.0) / ASSUMED.creep - 1) < 0.01
