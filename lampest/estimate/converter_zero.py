"""Voltage of code 0 of a converter, from the readings of open cells.

An open cell reads the potential in which its load ends. Where several channels of the unloaded
panel stand at one lowest code, this code stands for that potential.
"""

from dataclasses import replace

import numpy as np

from lampest.panel.readouts.characteristic import Characteristic
from lampest.panel.readouts.divider import Divider
from lampest.panel.readouts.driven import DrivenCircuit
from lampest.panel.sizes import ESTIMATED
from lampest.recording.recording import UNLOADED, Recording

ZERO = "readout.converter.zero_volt"
MIN_OPEN = 6  # channels at the lowest code
TOGETHER = 1.0  # steps within which they stand


def with_converter_ends(
    recording: Recording,
) -> tuple[Recording, tuple[float, float] | None]:
    """Return the recording with a number for `zero_volt: estimated`, and this number with its sd.

    None where its frames show none; the end of the scene without the key is taken then.
    """
    readout = recording.scene.readout
    converter = None if readout is None else readout.converter
    if readout is None or not isinstance(converter, Characteristic):
        return recording, None
    if converter.zero_volt != ESTIMATED:
        return recording, None
    zero = _zero_of_open_cells(recording)
    ends = replace(converter, zero_volt=readout.zero_volt if zero is None else zero[0])
    if zero is not None and converter.full_volt is None:
        # An offset moves both ends
        ends = replace(ends, full_volt=readout.full_scale_volt + zero[0])
    known = replace(readout, converter=ends)
    codes = readout.steps_from_volt(readout.volt_from_recorded(recording.recorded))
    recorded = known.recorded_from_volt(known.volt_from_code(codes))
    return replace(
        recording, recorded=recorded, scene=replace(recording.scene, readout=known)
    ), zero


def _zero_of_open_cells(recording: Recording) -> tuple[float, float] | None:
    """Return the voltage of code 0 and its standard deviation; None where no cell is open."""
    readout = recording.scene.readout
    unloaded = recording.role == UNLOADED
    if readout is None or not unloaded.any() or readout.code_sign < 0:
        return None
    if isinstance(readout, DrivenCircuit) and not readout.mirrored:
        at_open = readout.recorded_reference_volt
    elif isinstance(readout, Divider) and readout.measured_across == "reference":
        at_open = 0.0
    else:
        return None
    volt = readout.volt_from_recorded(recording.recorded[unloaded])
    codes = readout.steps_from_volt(volt)
    channels = codes.mean(axis=0)
    channels = channels[np.isfinite(channels)]
    lowest = channels[channels <= channels.min(initial=np.inf) + TOGETHER]
    if len(lowest) < MIN_OPEN or lowest.mean() < 0.5:  # those at the rail are bounds
        return None
    spread = max(float(lowest.std()), 0.1) / np.sqrt(len(lowest))
    return (
        at_open - readout.lsb_volt * float(lowest.mean()),
        readout.lsb_volt * spread,
    )
