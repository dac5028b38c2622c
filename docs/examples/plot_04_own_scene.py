"""
Simulate your own panel
=======================

A scene describes the panel and its electronics. A simulation adds loads and noise, and keeps the
truth.
"""

import lampest

scene = lampest.Scene(
    panel=lampest.Panel(rows=8, columns=12, pitch_mm=10),
    readout=lampest.TwoPointReadout(reference_ohm=1000, adc_bits=12, readings=20, noise_lsb=0.7),
)
rod = lampest.Rod(centre_mm=(50, 40), diameter_mm=30, mass_g=500)
recording = lampest.simulate(
    lampest.Simulation(schema=1, seed=7, scene=scene, baseline_frames=3, frames=5, loads=(rod,))
)
estimate = lampest.reconstruct(recording, [lampest.Misfit()], formulation="reduced")
figure = estimate.plot()
figure
