"""A shape of a user's own, in no union, is simulated."""

from dataclasses import dataclass
from math import sqrt
from pathlib import Path

import numpy as np
import pytest

from lampest import Array, Panel, Recording, Scene, Shape, Simulation, simulate
from lampest.recording.shapes.disc import contact_of_weight

PANEL = Panel(10, 10)
FINE_PANEL = Panel(180, 180, 0.5)


@dataclass(frozen=True, kw_only=True)
class Square(Shape):
    """A square that presses."""

    edge_mm: float
    mass_g: float

    @property
    def reach_mm(self) -> float:
        return self.edge_mm / sqrt(2)

    def pressure_at(self, x: Array, y: Array) -> tuple[Array, Array]:
        under = np.maximum(np.abs(x), np.abs(y)) < self.edge_mm / 2
        return under * contact_of_weight(self.mass_g, self.edge_mm**2), np.zeros_like(x)


def test_an_own_shape_is_simulated(tmp_path: Path) -> None:
    load = Square(centre_mm=(45.0, 45.0), edge_mm=40.0, mass_g=1500.0, tilt=0.2)
    contact, suction = load.mean_pressure(FINE_PANEL, FINE_PANEL.pitch_mm)
    assert (
        contact.sum() * FINE_PANEL.pitch_mm**2 == pytest.approx(1500 * 9.81, rel=0.01)
        and not suction.any()
    )
    simulate(Simulation(1, 1, Scene(PANEL), frames=2, loads=(load,))).save(tmp_path / "square.h5")
    recording = Recording.load(tmp_path / "square.h5")
    np.testing.assert_allclose(recording.truth_pressure[-1], load.mean_pressure(PANEL, 6.0)[0])
    pressed = recording.truth_pressure[-1] > 6
    assert (pressed.any(axis=1).sum(), pressed.any(axis=0).sum()) == (4, 4)
