"""
A foot that stands on an insole
===============================

A real recording that others published: 253 cells between rows and columns, read without
isolation. Its sources are in data/NOTICE.md.
"""

import lampest

recording = lampest.datasets.load("insole_standing")
print(recording)
edges = lampest.Huber(corner=0.3)  # edges of a contact count by size, not square
terms = [lampest.Misfit(weighting="noise"), lampest.LogGradient(weight="auto", loss=edges)]
estimate = lampest.reconstruct(recording, terms, formulation="reduced")
print(estimate)
figure = estimate.plot("resistance")
figure
