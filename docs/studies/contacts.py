"""One to five contacts on the circuits that `lampest init` writes, as `lampest detect` finds them.

Run it with: python -m docs.studies.contacts [--recordings 200] [--seed 1] [--purpose mat]

Every recording has the starter's own scene, noise, channels and drift. Its loads are rods of 12 to
50 mm and 3 to 30 kPa at places of chance, at least two pitches apart. A contact is found if one is
detected within its radius, or a pitch; every further one is invented. A recording counts as right
where all contacts are found and none is invented.
"""

import argparse
from collections import defaultdict
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from lampest.apps.recognition.detect.answer import Detected
from lampest.apps.recognition.detect.detection import detect_recording
from lampest.files.document import read_document, validated
from lampest.panel.panel import Panel
from lampest.recording.shapes import Rod
from lampest.recording.simulation import Simulation, simulate
from lampest.runs.starter import MAT, SIMULATION, write_starter

CIRCUITS = (
    "two_mux",
    "parallel_mux",
    "pull_ups",
    "pull_downs",
    "grounded",
    "grounded_one",
    "amplifiers",
    "diodes",
)
SIDES = ((8, 8), (8, 12), (10, 10), (8, 24))
MAX_CONTACTS = 5
DIAMETER_MM = (12.0, 50.0)
PRESSURE_KPA = (3.0, 30.0)
GAP_PITCHES = 2.0  # between two rims: a cell that nothing touches divides contacts
TRIES = 200  # places of chance until the panel counts as full
GRAVITY = 9.81


@dataclass(frozen=True)
class Trial:
    """A recording with known contacts, and the answer to it."""

    circuit: str
    sides: tuple[int, int]
    rods: tuple[Rod, ...]
    detected: Detected

    @property
    def recognised(self) -> list[bool]:
        """Whether each rod has a contact within its radius, or a pitch."""
        places = [load.place for load in self.detected.attachments if load.present]
        return [
            any(
                np.hypot(x - rod.centre_mm[0], y - rod.centre_mm[1]) < max(rod.diameter_mm / 2, 10)
                for x, y in places
            )
            for rod in self.rods
        ]

    @property
    def invented(self) -> int:
        """Number of contacts beyond the recognised ones."""
        present = sum(load.present for load in self.detected.attachments)
        return max(present - sum(self.recognised), 0)

    @property
    def right(self) -> bool:
        """Whether every contact is recognised and none invented."""
        return all(self.recognised) and not self.invented


def rods_on(panel: Panel, count: int, rng: np.random.Generator) -> tuple[Rod, ...]:
    """Return up to `count` rods whose discs lie on the panel, apart from each other."""
    rods = list[Rod]()
    height, width = ((lines - 1) * panel.pitch_mm for lines in panel.shape)
    for _ in range(TRIES):
        if len(rods) == count:
            break
        largest = min(DIAMETER_MM[1], height)
        diameter = float(np.exp(rng.uniform(np.log(DIAMETER_MM[0]), np.log(largest))))
        x, y = (float(rng.uniform(diameter / 2, side - diameter / 2)) for side in (width, height))
        gaps = [
            np.hypot(x - rod.centre_mm[0], y - rod.centre_mm[1]) - (diameter + rod.diameter_mm) / 2
            for rod in rods
        ]
        if min(gaps, default=np.inf) < GAP_PITCHES * panel.pitch_mm:
            continue
        pressure = float(np.exp(rng.uniform(*np.log(PRESSURE_KPA))))
        mass = pressure * np.pi / 4 * diameter**2 / GRAVITY  # kPa · mm² = mN; over m/s²: g
        rods.append(Rod(centre_mm=(x, y), diameter_mm=diameter, mass_g=float(mass)))
    return tuple(rods)


@cache
def starter(circuit: str, sides: tuple[int, int], purpose: str | None) -> Simulation:
    """Return the simulation that `lampest init` writes."""
    with TemporaryDirectory() as folder:
        write_starter(Path(folder), circuit, *sides, purpose)
        document = read_document(Path(folder) / SIMULATION)
        simulation: Simulation = validated(document, Simulation)
    return simulation


def trial(number: int, seed: int, purpose: str | None) -> Trial:
    """Return the recording of a number with its answer."""
    rng = np.random.default_rng([seed, number])
    circuit = CIRCUITS[number % len(CIRCUITS)]
    sides = SIDES[int(rng.integers(len(SIDES)))]
    count = 1 + number // len(CIRCUITS) % MAX_CONTACTS
    simulation = starter(circuit, sides, purpose)
    rods = rods_on(simulation.scene.panel, count, rng)
    simulation = replace(simulation, loads=rods, seed=int(rng.integers(2**31)))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "contacts.h5"
        simulate(simulation, f"contacts_{number}").save(path)
        return Trial(circuit, sides, rods, detect_recording(path))


def main() -> None:
    """Print a row for each circuit, and a line for each recording that is not right."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--purpose", choices=(MAT,))
    options = parser.parse_args()
    rows = defaultdict[str, list[Trial]](list)
    for number in range(options.recordings):
        done = trial(number, options.seed, options.purpose)
        rows[done.circuit].append(done)
        if not done.right:
            rods = [(rod.centre_mm, rod.diameter_mm, rod.mass_g) for rod in done.rods]
            print(f"{number}: {done.circuit} {done.sides}: {done.detected.sentence}; {rods}")
    print("circuit        recordings  right  contacts  found  invented")
    for circuit, trials in rows.items():
        counts = (
            len(trials),
            sum(done.right for done in trials),
            sum(len(done.rods) for done in trials),
            sum(sum(done.recognised) for done in trials),
            sum(done.invented for done in trials),
        )
        print(
            f"{circuit:14} {counts[0]:10} {counts[1]:6} {counts[2]:9} {counts[3]:6} {counts[4]:9}"
        )


if __name__ == "__main__":
    main()
