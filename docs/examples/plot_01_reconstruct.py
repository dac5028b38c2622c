"""
Reconstruct a lamprey's mouth
=============================

Plain least squares on a shipped, simulated recording of a mouth of 35 mm.
The left map shows the measured change, blurred by crosstalk.
"""

import lampest

recording = lampest.datasets.load("lamprey_35mm")
found = lampest.reconstruct(recording, [lampest.Misfit()], formulation="reduced")
print(found.status[-1])
figure = found.plot()
