"""Dead shorts without noise, over all circuits read in volts: every reading is met, or the status names the limit.

Readings come from the second statement of the circuits in `tests/least_cost.py`, which inverts: down to 10⁻⁶ ohm.
"""

from dataclasses import dataclass

import numpy as np
import pytest

from lampest import Array, Bounds, Estimator, Misfit, Panel, Readings, Scene, Solution, Status, Stream
from lampest.panel.readouts import GroundedReadout, LoadedColumnsReadout, Readout, VirtualGroundReadout
from tests.least_cost import Circuit

FINE = {"adc_bits": 32, "supply_volt": 5.0}  # so that no reading is at a rail
DRIVE, SENSE, LOAD = 50.0, 20.0, 1000.0


@dataclass(frozen=True)
class Kind:
    """A readout, and the same circuit stated anew."""

    readout: Readout
    circuit: Circuit


KINDS = {
    "loaded": Kind(
        LoadedColumnsReadout(drive_ohm=DRIVE, load_ohm=LOAD, **FINE), Circuit("loaded", (), DRIVE, 0.0, LOAD, 5.0)
    ),
    "grounded": Kind(
        GroundedReadout(drive_ohm=DRIVE, sense_ohm=SENSE, load_ohm=LOAD, **FINE),
        Circuit("grounded", (), DRIVE, SENSE, LOAD, 5.0),
    ),
    "one load": Kind(
        GroundedReadout(drive_ohm=DRIVE, sense_ohm=SENSE, load_ohm=LOAD, sense="one", **FINE),
        Circuit("grounded_one", (), DRIVE, SENSE, LOAD, 5.0),
    ),
    "virtual ground": Kind(
        VirtualGroundReadout(drive_ohm=DRIVE, sense_ohm=SENSE, feedback_ohm=10.0, **FINE),
        Circuit("virtual", (), DRIVE, SENSE, 10.0, 5.0),
    ),
}
SHORTS: dict[str, object] = {
    "cell": (2, 3),
    "two cells": ([0, 3], [1, 4]),
    "row": 2,
    "column": (slice(None), 4),
}


def with_short(where: object, ohm: float) -> Array:
    cells = 3000 * np.exp(0.2 * np.random.default_rng(3).standard_normal((6, 7)))
    cells[where] = ohm * np.exp(0.2 * np.random.default_rng(4).standard_normal(cells[where].shape))
    return np.asarray(cells)


def solved(kind: Kind, cells: Array, formulation: str) -> tuple[Solution, float]:
    """(solution, by what part of itself the reading that is met worst is off)."""
    volt, _ = kind.circuit.reading(cells)
    scene = Scene(Panel(*cells.shape), kind.readout)
    estimator = Estimator((Misfit(),), formulation=formulation, bounds=Bounds(upper="none"))
    baseline = Stream.begin(estimator, scene, 1.0, Readings.of(scene, volt)).baseline
    found = baseline.solution
    off = np.abs(kind.circuit.reading(found.cell_resistance[0])[0] / volt - 1).max() if found.solved else np.nan
    return found, float(off)


@pytest.mark.parametrize("formulation", ["reduced", "nodal"])
@pytest.mark.parametrize("short", ["cell", "two cells"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_shorted_cell_is_met(kind: str, short: str, formulation: str) -> None:
    """A third of a milliohm among kiloohms; no bound stands between the estimate and its readings."""
    found, off = solved(KINDS[kind], with_short(SHORTS[short], 3e-4), formulation)
    assert found.optimum and off < 1e-6
    assert not found.at_lower.any()


@pytest.mark.parametrize("formulation", ["reduced", "nodal"])
@pytest.mark.parametrize("ohm", [1.0, 3e-3, 1e-6])
@pytest.mark.parametrize("short", SHORTS)
@pytest.mark.parametrize("kind", KINDS)
def test_verified_is_met(kind: str, short: str, ohm: float, formulation: str) -> None:
    """Where the digits end the status is another one; it never says verified of a reading that is not met."""
    found, off = solved(KINDS[kind], with_short(SHORTS[short], ohm), formulation)
    assert found.solved and (found.status is not Status.OPTIMUM or off < 1e-6)
