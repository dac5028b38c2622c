"""Recognition of a simulated load, and of a recording; no test stands here."""

import numpy as np

from lampest import Panel, Recording, Scene, Shape, Simulation, TwoPointReadout, simulate
from lampest.apps.recognition.detect.answer import Detected
from lampest.apps.recognition.detect.detection import Frames, Known, known_of, measured_frames
from lampest.apps.recognition.model_errors import ModelErrors
from lampest.apps.recognition.observation import Baseline, Observation
from lampest.inference.prepared import Prepared

PANEL = Panel(10, 10)
PATCH_MM = 6.0


def frame_under(load: Shape, panel: Panel) -> Observation:
    """One frame of a panel under a load, against three without."""
    recording = simulate(
        Simulation(1, 3, Scene(panel, TwoPointReadout(), 140.0), frames=1, loads=(load,))
    )
    readings = recording.readings()
    resting = readings[[0, 1, 2]].mean()
    baseline = Baseline.of(resting.value, resting.sigma, recording.scene, ModelErrors())
    return Observation(readings.value[3], readings.sigma[3], baseline, np.zeros(panel.shape), 1.0)


def known_before(recording: Recording) -> Known:
    """Return the state of recognition before the measured frames of a recording."""
    known = known_of(Prepared(recording))
    assert isinstance(known, Known)
    return known


def every_frame(recording: Recording, known: Known) -> Frames:
    """All frames of a recording, as `lampest detect` reads them."""
    return measured_frames(recording, known, np.ones(len(recording.time), dtype=bool))


def answered(recording: Recording) -> Detected:
    """Return the answer to a recording, as `lampest detect` does."""
    known = known_of(Prepared(recording))
    if isinstance(known, Detected):
        return known
    return known.answer(every_frame(recording, known))
