"""Plain warnings: what a user most often gets wrong, one sentence each, from the readings and their roles alone."""

from collections.abc import Iterator

import numpy as np

from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.recording.readings import Readings
from lampest.recording.recording import MEASURED, UNLOADED, Recording

STEPS = 16  # of the converter: a median reading that close to a rail is known to 6 % at best
MOVED = 0.01  # of a reading, and CLEARLY of its σ: what a load changes
CLEARLY = 6.0
SEVERAL = 5  # readings: a finger moves as many


def plain_warnings(recording: Recording, readings: Readings) -> Iterator[str]:
    """Sentences without a full stop; readings : of all frames."""
    unloaded, measured = recording.role == UNLOADED, recording.role == MEASURED
    if not unloaded.any():
        yield "no frame is unloaded (role 0), so changes and pressures are against the first measured frame"
    elif unloaded.sum() == 1:
        yield "only one frame is unloaded, so that nothing shows the noise: record five or more"
    yield from _at_a_rail(recording)
    if unloaded.any() and measured.any() and readings.sigma is not None:
        resting = readings[unloaded].mean()
        yield from _only_lighter(recording.scene.circuit, readings[measured], resting)


def _at_a_rail(recording: Recording) -> Iterator[str]:
    """Where the median reading is next to a rail of the converter."""
    readout, circuit = recording.scene.readout, recording.scene.circuit
    if readout is None or recording.sigma is not None:
        return
    with np.errstate(all="ignore"):
        volt = float(np.nanmedian(circuit.volt_from_recorded(recording.recorded)))
    steps = min(volt, readout.supply_volt - volt) / readout.lsb_volt
    if steps < STEPS:
        yield (
            f"the median reading, {np.nanmedian(recording.recorded):.3g} {circuit.unit}, is {max(steps, 0.0):.2g} "
            f"steps of the converter from a rail: are readings in {circuit.unit}, and is the scene's readout right?"
        )


def _only_lighter(circuit: Readout, frames: Readings, resting: Readings) -> Iterator[str]:
    """Where resistances only ever rise above the unloaded ones: something was taken off."""
    assert frames.sigma is not None
    values = frames.plain_values
    with np.errstate(all="ignore"):
        far = np.abs(values - resting.value) > CLEARLY * frames.sigma
        change: Array = np.log(circuit.apparent_resistance(values) / circuit.apparent_resistance(resting.value))
        risen, fallen = (int((far & (sign * change > MOVED)).any(axis=0).sum()) for sign in (1, -1))
    if risen >= SEVERAL and fallen == 0:
        yield "readings only ever show less load than the unloaded frames: did something lie on the panel then?"
