"""
Crosstalk and sneak paths
=========================

The two-point reading of a uniform panel is R = r (M + N − 1)/(M N): at 10 × 10 only 19 % of the
cell. One pressed cell changes every reading of its row and column.
"""

import matplotlib.pyplot as plt
import numpy as np

import lampest

cells = np.full((10, 10), 3000.0)
uniform = np.asarray(lampest.two_point_resistance(cells))
print(f"a cell of 3,000 Ω reads {uniform[0, 0]:.0f} Ω")
cells[4, 6] = 100.0
change = 100 * (np.asarray(lampest.two_point_resistance(cells)) / uniform - 1)

figure, axes = plt.subplots()
image = axes.imshow(change, cmap="viridis")
axes.set(xlabel="column", ylabel="row", title="one cell pressed at row 4, column 6")
figure.colorbar(image, label="change of the reading [%]")
