"""Recordings of a panel on which known loads lay one after the other, or several at once."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lampest import Course, Panel, Recording, Rod, Scene, Shape, TwoPointReadout, Unmodelled
from lampest.apps.calibration.known_loads import KnownLoad
from lampest.panel.response import AnyResponse
from lampest.recording.simulation.measure import measured
from lampest.recording.simulation.simulation import Simulation, cells_under, pressure_at
from tests.estimates import recording_of

RESTING = 4


@dataclass(frozen=True)
class Bench:
    """A panel on a bench.

    spread : of the cells' answers. response : what the film truly does. frames : of each load.

    repeat : standard deviation of the logarithm of a factor on each cell's answer, drawn anew for
        each load.
    """

    seed: int
    panel: Panel = field(default_factory=lambda: Panel(8, 8))
    spread: float = 0.2
    repeat: float = 0.05
    response: AnyResponse | None = None
    frames: int = 2

    @property
    def scene(self) -> Scene:
        """Scene of the estimator, without the deviations of the film."""
        return Scene(self.panel, TwoPointReadout(readings=20, noise_lsb=0.7), 140.0)

    def recorded(
        self, loads: Sequence[Sequence[Shape]], name: str, scene: Scene | None = None
    ) -> Recording:
        """Each group of loads for some frames, after unloaded ones, with the true pressure."""
        rng = np.random.default_rng([self.seed, len(loads), len(name)])
        still = np.arange(RESTING + self.frames, dtype=float)
        spread = Unmodelled(response_spread=self.spread)
        plain = Simulation(1, self.seed, self.scene, baseline_frames=RESTING, frames=self.frames)
        plain = replace(
            plain, course=Course(approach_s=0.0), response=self.response, unmodelled=spread
        )
        cells = []
        pressure = []
        for group in loads:
            simulation = replace(plain, loads=tuple(group))
            under = cells_under(simulation, still)
            repetition = np.exp(self.repeat * rng.standard_normal(self.panel.shape))
            cells.append(under[:1] * (under[RESTING:] / under[:1]) ** repetition)
            pressure.append(pressure_at(simulation, still - RESTING)[RESTING:])
        resting = np.repeat(under[:1], RESTING, axis=0)
        truth = {"truth_cell_resistance": np.concatenate([resting, *cells])}
        truth["truth_pressure"] = np.concatenate([0 * resting, *pressure])
        noise = (Unmodelled(), self.seed + len(name), 1.0, ())
        recorded, _ = measured(self.scene, truth["truth_cell_resistance"], *noise)
        return recording_of(scene or self.scene, recorded, RESTING, name=name, **truth)

    def frames_of(self, number: int) -> tuple[int, int]:
        """The first and the last frame of a group of loads."""
        first = RESTING + number * self.frames
        return first, first + self.frames - 1


def rod(x: float, y: float, diameter: float, kpa: float) -> Rod:
    """A rod that presses with so much."""
    return Rod(centre_mm=(x, y), diameter_mm=diameter, mass_g=kpa * np.pi / 4 * diameter**2 / 9.81)


def moved_over(
    bench: Bench, kpa: Sequence[float], diameter: float, step: float
) -> tuple[list[list[Shape]], list[KnownLoad]]:
    """Return rods moved over the panel in steps, half a mm off, and their known loads."""
    rng = np.random.default_rng([bench.seed, 5])
    xs, ys = (np.arange(0, 10.0 * (count - 1) + 0.1, step) for count in bench.panel.shape[::-1])
    places = [(pressure, float(x), float(y)) for pressure in kpa for x in xs for y in ys]
    groups: list[list[Shape]] = []
    known = []
    for number, (pressure, x, y) in enumerate(places):
        groups.append([rod(*map(float, rng.normal((x, y), 0.5)), diameter, pressure)])
        mass = rod(x, y, diameter, pressure).mass_g
        known.append(
            KnownLoad(
                frames=bench.frames_of(number), mass_g=mass, x_mm=x, y_mm=y, diameter_mm=diameter
            )
        )
    return groups, known
