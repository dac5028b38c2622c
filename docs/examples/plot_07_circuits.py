"""
The wrong circuit is wrong by factors
=====================================

The same codes, read once as loaded columns (right) and once as grounded drives (wrong).
The circuit check names the problem.
"""

from dataclasses import replace

import numpy as np

import lampest

right = lampest.LoadedColumnsReadout(
    load_ohm=3300, drive_ohm=100, adc_bits=12, readings=20, noise_lsb=1
)
wrong = lampest.GroundedReadout(
    sense="all", load_ohm=3300, drive_ohm=100, adc_bits=12, readings=20, noise_lsb=1
)
scene = lampest.Scene(panel=lampest.Panel(rows=8, columns=8, pitch_mm=10), readout=right)
ring = lampest.Ring(centre_mm=(35, 35), inner_diameter_mm=27, outer_diameter_mm=40, mass_g=800)
recording = lampest.simulate(
    lampest.Simulation(schema=1, seed=3, scene=scene, baseline_frames=5, frames=8, loads=(ring,))
)
truth = recording.truth_cell_resistance[recording.role == lampest.MEASURED]
for readout in (right, wrong):
    read = replace(recording, scene=replace(scene, readout=readout))
    estimate = lampest.reconstruct(read, [lampest.Misfit()], formulation="reduced")
    error = 100 * np.nanmedian(np.abs(estimate.cell_resistance / truth - 1))
    print(f"{readout.kind}: median cell error {error:.0f} %; {estimate.model_check.sentence}")
