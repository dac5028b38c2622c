"""Cells of a block that reproduce the block's own readings, for any readout."""

import numpy as np
from numpy.typing import NDArray

from lampest.panel.network import Block, Network
from lampest.panel.panel import Array

MOST_STEPS, MOST_HALVINGS = 30, 12  # as the convex fit of two-point readings; 2⁻¹² of a step is beyond any use
LONGEST_STEP = 1.5  # of log r: beyond, a reading's slope says nothing of where it leads
FITTED = 1e-9  # of the largest reading


def newton_fitted(network: Network, block: Block, measured: Array, least: Array, chosen: NDArray[np.bool_]) -> Network:
    """Newton's method for y(u) = measured over the chosen cells of the block, u = log r, steps halved until better.

    measured, least : (rows, columns) of the block: readings, and the least conductance in siemens.
    """
    whole = np.zeros(network.conductance.shape, dtype=bool)
    whole[block] = chosen
    cells = np.flatnonzero(whole)
    missed = (measured - network.reading()[block])[chosen]
    for _ in range(MOST_STEPS):
        size = float(np.abs(missed).max(initial=0.0))
        if size <= FITTED * float(np.abs(measured).max()):
            break
        step = np.linalg.lstsq(network.sensitivity(cells, cells), missed, rcond=None)[0]
        step *= min(1.0, LONGEST_STEP / float(np.abs(step).max(initial=1e-300)))
        for halving in range(MOST_HALVINGS):
            conductance = network.conductance[block].copy()
            conductance[chosen] *= np.exp(-step * 0.5**halving)
            there = network.changed(block, np.maximum(conductance, least))
            left = (measured - there.reading()[block])[chosen]
            if float(np.abs(left).max(initial=0.0)) < size:
                break
        else:
            break
        network, missed = there, left
    return network
