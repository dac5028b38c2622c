"""
Reconstruct a lamprey's mouth
=============================

A shipped, simulated recording of a mouth of 35 mm. The readings are blurred by crosstalk. The
estimate shows the rim, which presses, and the centre, which sucks. The report summarises the fit.
"""

import lampest

recording = lampest.datasets.load("lamprey_35mm")
terms = [lampest.Misfit(weighting="noise"), lampest.LogGradient()]
estimate = lampest.reconstruct(recording, terms)
print(estimate.fit_report())
figure = estimate.plot("change")
figure
