"""
Add a penalty and choose its weight
===================================

A gradient penalty expects neighbouring cells to be alike.
``weight="auto"`` chooses its weight from the noise of the readings.
"""

import numpy as np

import lampest

recording = lampest.datasets.load("rod")
truth = recording.truth_cell_resistance[recording.role == lampest.MEASURED]
for name, terms in {
    "plain least squares": [lampest.Misfit()],
    "gradient penalty, chosen weight": [lampest.Misfit(), lampest.Gradient(weight="auto")],
}.items():
    estimate = lampest.reconstruct(recording, terms, formulation="reduced")
    error = 100 * np.median(np.abs(estimate.cell_resistance / truth - 1))
    print(f"{name}: median cell error {error:.1f} %")
figure = estimate.plot()
figure
