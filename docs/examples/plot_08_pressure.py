"""
From resistance to pressure
===========================

The film's response curve converts a change of resistance to pressure. Cells beyond the curve are
flagged as saturated.
"""

import lampest

recording = lampest.datasets.load("lamprey_25mm")
estimate = lampest.reconstruct(
    recording, [lampest.Misfit(), lampest.Gradient(weight="auto")], formulation="reduced"
)
print(
    f"largest pressure {estimate.pressure[-1].max():.0f} kPa, largest suction "
    f"{estimate.pressure[-1].min():.0f} kPa"
)
print(f"{estimate.saturated[-1].sum()} cells are saturated")
figure = estimate.plot("pressure")
figure
