"""
A foot that walks on an insole
==============================

The real recording of the same insole as in the example before, during steps. Frames in which the
foot is in the air hold no reading, and are not solved.
"""

import lampest

recording = lampest.datasets.load("insole_walking")
print(recording)
edges = lampest.Huber(corner=0.3)  # edges of a contact count by size, not square
terms = [lampest.Misfit(weighting="noise"), lampest.LogGradient(weight="auto", loss=edges)]
estimate = lampest.reconstruct(recording, terms, formulation="reduced")
print(estimate)
figure = estimate.plot("resistance")
figure
