"""Shapes of a user's own, in no union: simulated, and recognised among the others."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import exp, log, sqrt
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from laws.recognised import verdict_on

from lampest import Array, Panel, Recording, Rod, Scene, Shape, Simulation, simulate
from lampest.apps.recognition.candidates import LOADS
from lampest.files.levels import MAX_MEAN_SQUARE
from lampest.recording.shapes.disc import Disc, contact_of_weight
from lampest.recording.shapes.kinds import RoundCandidate
from lampest.recording.shapes.shape import Candidate, Prior, Template, centre_priors

PANEL = Panel(10, 10)
FINE_PANEL = Panel(180, 180, 0.5)


@dataclass(frozen=True, eq=False, kw_only=True)
class SquareCandidate(Candidate):
    """A square with its edges along rows and columns: φ = (x, y, ln a, ln p)."""

    label: str = "square"
    templates: tuple[Template, ...] = (Template(40.0, faint=True), Template(56.0, faint=True))

    def priors(self, panel: Panel) -> Mapping[str, Prior]:
        return centre_priors(panel) | {
            "edge": Prior(log(30), 0.35, step=0.2),
            "contact": Prior(log(8), 1.0),
        }

    def pressure(self, panel: Panel, patch_mm: float, parameters: Array) -> tuple[Array, Array]:
        edge = exp(parameters[2])
        contact = exp(parameters[3])
        (along, by_x, x_edge), (down, by_y, y_edge) = (
            covered_share(centres - centre, edge / 2, patch_mm)
            for centres, centre in zip(panel.centres_mm(), parameters[:2], strict=True)
        )
        pressure = contact * np.outer(down, along)
        by_edge = contact * edge / 2 * (np.outer(y_edge, along) + np.outer(down, x_edge))
        return pressure, np.stack(
            [contact * np.outer(down, by_x), contact * np.outer(by_y, along), by_edge, pressure]
        )

    def start(self, disc: Disc) -> Array:
        return np.array(
            [
                disc.x_mm,
                disc.y_mm,
                log(disc.diameter_mm * sqrt(np.pi) / 2),
                log(max(disc.rim_kpa, 0.1)),
            ]
        )

    def report(self, parameters: Array) -> dict[str, tuple[float, Array]]:
        edge = exp(parameters[2])
        unit = np.eye(4)
        places = {
            name: (float(parameters[axis]), unit[axis])
            for axis, name in enumerate(("x_mm", "y_mm"))
        }
        return places | {"edge_mm": (edge, edge * unit[2])}


def covered_share(centres: Array, half: float, patch_mm: float) -> tuple[Array, Array, Array]:
    """Return the share of patches about `centres` within −half and half, and its two slopes.

    The slopes are those by the square's centre and by `half`.
    """
    low = centres - patch_mm / 2
    high = centres + patch_mm / 2
    length = np.minimum(half, high) - np.maximum(-half, low)
    upper = (half < high) & (length > 0)
    lower = (-half > low) & (length > 0)
    return (
        np.maximum(length, 0) / patch_mm,
        (upper * 1.0 - lower) / patch_mm,
        (upper * 1.0 + lower) / patch_mm,
    )


@dataclass(frozen=True, kw_only=True)
class Square(Shape):
    """A square that presses, and its candidate; in no union either."""

    candidate: ClassVar[Candidate] = SquareCandidate()
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


@pytest.mark.slow
def test_an_own_candidate_is_recognised_instead_of_a_disc() -> None:
    loads = (*(load for load in LOADS if isinstance(load, RoundCandidate)), Square.candidate)
    verdict = verdict_on(Square(centre_mm=(45.5, 44.5), edge_mm=50.0, mass_g=1500.0), loads)
    assert verdict.best.candidate.label == "square" and verdict.goodness < MAX_MEAN_SQUARE
    reported = verdict.best.candidate.report(verdict.best.parameters)
    for name, true in {"x_mm": 45.5, "y_mm": 44.5, "edge_mm": 50.0}.items():
        value, slopes = reported[name]
        assert abs(value - true) < max(4 * np.sqrt(slopes @ verdict.best.covariance @ slopes), 0.5)
    rod = Rod(kind="rod", centre_mm=(45.0, 45.0), diameter_mm=40.0, mass_g=680.0)
    assert verdict_on(rod, loads).best.candidate.label == "rod"
