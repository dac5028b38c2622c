"""
Outliers and robust losses
==========================

One reading is wrong by 40 %. Huber's loss limits its influence where a penalty adds information.
"""

from dataclasses import replace

import numpy as np

import lampest

recording = lampest.datasets.load("rod")
readings = recording.recorded.copy()
readings[-1, 2, 7] *= 1.4
spoilt = replace(recording, recorded=readings)
truth = recording.truth_cell_resistance[-1]
for loss in (lampest.Squared(), lampest.Huber(corner=3)):
    misfit = lampest.Misfit(weighting="noise", loss=loss)
    found = lampest.reconstruct(spoilt, [misfit, lampest.Gradient(weight="auto")], formulation="reduced")
    error = 100 * np.abs(found.cell_resistance[-1] / truth - 1)
    print(f"{type(loss).__name__}: cell error {np.median(error):.1f} % (median), {np.percentile(error, 95):.0f} % (95th percentile)")
found.plot("certainty")
