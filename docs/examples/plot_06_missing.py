"""
Missing readings
================

Five readings are missing in every frame. A penalty fills the cells in, and their error bars show
how little is known.
"""

from dataclasses import replace

import numpy as np

import lampest

recording = lampest.datasets.load("rod")
readings = recording.recorded.copy()
missing = np.zeros(readings.shape[1:], dtype=bool)
missing[[1, 2, 4, 7, 8], [3, 7, 4, 0, 6]] = True
readings[:, missing] = np.nan
terms = [lampest.Misfit(), lampest.Gradient(weight="auto")]
estimate = lampest.reconstruct(replace(recording, recorded=readings), terms, formulation="reduced")
error = 100 * estimate.cell_resistance_errors[-1] / estimate.cell_resistance[-1]
print(f"median error bar of measured cells: {np.median(error[~missing]):.1f} %")
print(f"median error bar of missing cells: {np.median(error[missing]):.1f} %")
figure = estimate.plot("certainty")
figure
