"""
Reconstruct a lamprey's mouth
=============================

A shipped, simulated recording of a mouth of 35 mm. The readings are blurred by crosstalk. The
estimate shows the rim, which presses, and the centre, which sucks. The report summarises the fit.
"""

import lampest

recording = lampest.datasets.load("lamprey_35mm")
found = lampest.reconstruct(recording, [lampest.Misfit(weighting="noise"), lampest.LogGradient()])
print(found.fit_report())
figure = found.plot("change")
figure
