"""Errors of pressures from a film's memory, and memories taken for a lamprey that has left.

Run it with: python -m docs.studies.film --recordings 34 --seed 1001

Films are drawn: hysteresis 10 to 30 % (24 % for pressures), creep 0.5 to 12 % for each decade, a
fifth from cell to cell (for pressures 5 % as well). For pressures a rod of 10 to 24 kPa is put on
and taken off a 10 × 10 panel; for recognition a lamprey lets go after 20 to 150 s and nothing
touches the panel for 300 frames. `--film silent` leaves the film out of the scene;
`specified` states it to a tenth.
"""

import argparse
from dataclasses import replace
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from lampest.apps.recognition.detect.detection import detect_recording
from lampest.cost.terms import Misfit
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import reconstruct
from lampest.panel.conditions import Water
from lampest.panel.panel import Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.response import Film, PublishedResponse
from lampest.panel.scene import Scene
from lampest.panel.sizes import Systematic
from lampest.recording.recording import Recording
from lampest.recording.shapes import OralDisc, Rod
from lampest.recording.simulation.measure import Unmodelled
from lampest.recording.simulation.simulation import Course, Simulation, simulate

AFTER = 300
PANEL = Panel(10, 10)
READOUT = TwoPointReadout(readings=20, noise_lsb=0.7)
SPECIFIED_FILMS = {
    "silent": lambda film: None,
    "all open": lambda film: Film("auto", "auto"),
    "creep open": lambda film: replace(film, creep_per_decade="auto"),
    "specified": lambda film: replace(film, deviation=0.1),
}


def film_of(rng: np.random.Generator, hysteresis: float | None = None, spread: float = 0.2) -> Film:
    """One film."""
    gap = float(rng.uniform(0.1, 0.3)) if hysteresis is None else hysteresis
    return Film(gap, float(rng.uniform(0.005, 0.12)), cell_spread=spread)


def pressed(
    rng: np.random.Generator, seed: int, film: Film, specified: Film | None, kpa: float
) -> Recording:
    """A rod put on in 15 s, left for 30 s, taken off in 15 s, and 50 s of rest."""
    place = rng.uniform(35, 55, 2)
    across = 45.0
    rod = Rod(
        kind="rod",
        centre_mm=(float(place[0]), float(place[1])),
        diameter_mm=across,
        mass_g=kpa * np.pi / 4 * across**2 / 9.81,
    )
    scene = Scene(
        PANEL,
        READOUT,
        140.0,
        systematic=Systematic(response_sd=0.05),
        film=specified,
        response=PublishedResponse(),
    )
    course = Course(approach_s=15, release_at_s=45, release_s=15)
    return simulate(Simulation(1, seed, scene, frames=110, loads=(rod,), course=course, film=film))


def pressures(count: int, seed: int) -> None:
    """Print errors in percent of the largest pressure; and how many intervals hold the truth.

    The errors are those of cells under the rod.
    """
    for spread, (name, tell) in product((0.05, 0.2), SPECIFIED_FILMS.items()):
        rng = np.random.default_rng(seed)
        errors = []
        held = []
        for number in range(count):
            film = film_of(rng, 0.24, spread)
            kpa = float(rng.uniform(10, 24))
            made = pressed(rng, seed + number, film, tell(film), kpa)
            results = reconstruct(made, Estimator((Misfit(),), "reduced"))
            assert made.truth_pressure is not None and results.pressure is not None
            assert results.pressure_lower is not None and results.pressure_upper is not None
            truth = made.truth_pressure[results.frame]
            under = truth.max(axis=0) > 0.2 * truth.max()
            errors.append(100 * np.abs(results.pressure - truth)[:, under] / truth.max())
            held.append(
                ((results.pressure_lower <= truth) & (truth <= results.pressure_upper))[:, under]
            )
        parts = {"loading": slice(0, 45), "unloading": slice(45, 60), "after": slice(62, None)}
        messages = [
            f"{part} {np.percentile(error, 95):.1f} (worst {error.max():.1f})"
            for part, error in (
                (part, np.concatenate([frames[at].ravel() for frames in errors]))
                for part, at in parts.items()
            )
        ]
        within = 100 * np.mean(np.concatenate([record.ravel() for record in held]))
        print(
            f"cells by {spread:4}, {name:10s} 95th percentile: {', '.join(messages)}; within "
            f"{within:.0f} %",
            flush=True,
        )


def left(
    rng: np.random.Generator, seed: int, film: Film, specified: Film | None
) -> tuple[Recording, int]:
    """A lamprey that lets go, and the first frame after that."""
    place = rng.uniform(25, 65, 2)
    mouth = OralDisc(
        kind="oral_disc",
        centre_mm=(float(place[0]), float(place[1])),
        diameter_mm=float(rng.uniform(25, 38)),
        rim_width_mm=5.5,
        pressure_kpa=-float(rng.uniform(4, 16)),
        rim_kpa=float(rng.uniform(40, 90)),
    )
    stays = int(rng.integers(20, 150))
    scene = Scene(
        PANEL,
        READOUT,
        140.0,
        water=Water(50.0),
        systematic=Systematic(0.01, channel_spread_ohm=3),
        film=specified,
    )
    course = Course(-0.8, 0.6, 2.0, 1.15, 0.1, float(stays), 1.0)
    unmodelled = Unmodelled(
        channel_spread_ohm=3,
        reference_tolerance=0.01,
        drift_per_minute=0.01,
        outlier_probability=1e-4,
    )
    plain = Simulation(
        1, seed, scene, frames=stays + 2 + AFTER, loads=(mouth,), course=course, film=film
    )
    return simulate(replace(plain, unmodelled=unmodelled)), stays + 2


def memories(count: int, seed: int, name: str) -> None:
    """Print counts of recognised mouths, delays of their release, and later false loads."""
    rng = np.random.default_rng(seed)
    seen = 0
    late = []
    again = 0
    with TemporaryDirectory() as folder:
        for number in range(count):
            film = film_of(rng)
            made, first = left(rng, seed + number, film, SPECIFIED_FILMS[name](film))
            made.save(Path(folder) / "left.h5")
            results = detect_recording(Path(folder) / "left.h5").attachments
            released = float(made.time[3 + first - 2])
            mouths = [
                record for record in results if record.sucks > 0.5 and record.since_s < released
            ]
            seen += bool(mouths)
            late += [record.until_s - released for record in mouths if record.until_s is not None]
            again += sum(record.since_s > released + 1 for record in results)
    print(
        f"{name}: {seen} of {count} mouths seen, {len(late)} released, {np.median(late):.1f} s "
        "after the truth in the "
        f"median and {np.max(late):.1f} s at most; {again} loads in {count * AFTER} frames after "
        "that"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--recordings", type=int, default=34)
    parser.add_argument("--seed", type=int, default=1001)
    parser.add_argument("--part", choices=("pressure", "release"))
    parser.add_argument("--film", choices=tuple(SPECIFIED_FILMS), default="silent")
    given = parser.parse_args()
    if given.part != "release":
        pressures(given.recordings, given.seed)
    if given.part != "pressure":
        memories(given.recordings, given.seed, given.film)
