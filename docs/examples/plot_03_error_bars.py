"""
Error bars
==========

Each cell has a standard deviation and a 95 % interval. This script counts how many intervals cover
the simulated truth.
"""

import matplotlib.pyplot as plt
import numpy as np

import lampest

recording = lampest.datasets.load("ring")
estimate = lampest.reconstruct(recording, [lampest.Misfit()], formulation="reduced")
truth = recording.truth_cell_resistance[-1].ravel()
order = np.argsort(truth)
low = estimate.cell_resistance_lower[-1].ravel()
high = estimate.cell_resistance_upper[-1].ravel()
print(
    f"{100 * np.mean((low <= truth) & (truth <= high)):.0f} % of the 95 % intervals cover the truth"
)

figure, axes = plt.subplots()
axes.vlines(range(truth.size), low[order], high[order], lw=1, label="95 % interval")
axes.plot(truth[order], "k.", ms=3, label="truth")
axes.set(xlabel="cell, sorted by resistance", ylabel="resistance [Ω]", yscale="log")
axes.legend()
