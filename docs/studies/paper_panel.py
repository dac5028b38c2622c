"""Which scene gives the paper's numbers, found by search.

The numbers are twelve ranges of figure 8 and seven mean errors of table I.

Fitted are the measured map, LSR-CR, LSR-ΔCR and the error of LSM; predicted are both methods with a
gradient and the range of LSM. The rise of both relative methods has to be within the disc, as
section VI.A says. Frames are simulated as `lampest simulate` does and solved as the paper did
(`lsqnonlin` in kind).

    python -m docs.studies.paper_panel --seconds 900 --seed 1
    python -m docs.studies.paper_panel --check configs/paper_35mm.yaml --seeds 20

The first command searches and prints every better scene, the second one tries a scene with other
seeds.
"""

import argparse
import dataclasses
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docs.studies.as_published import METHODS, WEIGHTS, Weights, left_by_solver
from docs.studies.paper_figures import FILE, read_published
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.scene import Scene
from lampest.recording.recording import MEASURED, UNLOADED
from lampest.recording.shapes import Block, OralDisc
from lampest.recording.simulation import read_simulations
from lampest.recording.simulation.measure import Unmodelled
from lampest.recording.simulation.simulation import Cells, Course, Simulation, simulate

# What is searched: name → least, most, and whether by its logarithm.
BOX: Mapping[str, tuple[float, float, bool]] = {
    "spread": (0.2, 1.3, False),  # standard deviation of the logarithm of unloaded cells
    "x": (37.0, 53.0, False),  # mm
    "y": (37.0, 53.0, False),
    "rim_mm": (3.0, 9.0, False),
    "disc_kpa": (-30.0, -3.0, False),
    "rim_kpa": (15.0, 235.0, True),
    "tilt": (0.0, 0.9, False),
    "response_spread": (0.0, 0.4, False),
    "body_kpa": (0.0, 0.3, False),  # on every cell: what all cells share between baseline and frame
    "static": (0.02, 0.15, True),  # error of each reading, the same in all frames, logarithm
    "series": (0.0, 60.0, False),  # ohm that the scene omits; 3.05 kohm cells
    "channels": (0.0, 10.0, False),  # ohm, standard deviation between channels
    "start": (1.0, 5.0, True),  # over R_m
    "breathing": (0.0, 0.4, False),
    "relative": (1e-5, 30.0, True),  # λ on changes in percent; 10 on fractions is 1e-3
}
SEEDS = (1, 2, 3)
PARENTS = 30
FITTED = ("measured", "LSM", "LSR-CR", "LSR-dCR")
PREDICTED = (("LSM", "low"), ("LSM", "high"))


def simulation_of(numbers: Mapping[str, float], seed: int, frames: int = 2) -> Simulation:
    """The scene that the numbers describe."""
    mouth = OralDisc(
        centre_mm=(numbers["x"], numbers["y"]),
        diameter_mm=35.0,
        rim_width_mm=numbers["rim_mm"],
        pressure_kpa=numbers["disc_kpa"],
        rim_kpa=numbers["rim_kpa"],
        tilt=numbers["tilt"],
        tilt_direction_deg=60.0,
    )
    edge = 300.0
    body = Block(
        centre_mm=(45.0, 45.0),
        length_mm=edge,
        width_mm=edge,
        mass_g=numbers["body_kpa"] * edge**2 / 9.80665,
    )
    return Simulation(
        schema=1,
        seed=seed,
        scene=Scene(Panel(10, 10), TwoPointReadout()),
        cells=Cells(3050.0, numbers["spread"]),
        baseline_frames=1,
        frames=frames,
        loads=(mouth, body) if numbers["body_kpa"] > 1e-6 else (mouth,),
        course=Course(breathing_hz=1.15, breathing_depth=numbers["breathing"]),
        unmodelled=Unmodelled(
            series_resistance_ohm=numbers["series"],
            channel_spread_ohm=numbers["channels"],
            reading_error=numbers["static"],
            response_spread=numbers["response_spread"],
        ),
    )


def mouth_of(simulation: Simulation) -> OralDisc:
    """Its mouth."""
    return next(load for load in simulation.loads if isinstance(load, OralDisc))


def inside(mouth: OralDisc, panel: Panel) -> NDArray[np.bool_]:
    """Cells of which the centre lies within the rim."""
    x, y = panel.centres_mm()
    distance = np.hypot(x[None, :] - mouth.centre_mm[0], y[:, None] - mouth.centre_mm[1])
    return np.asarray(distance < mouth.diameter_mm / 2 - mouth.rim_width_mm)


def figures_of(
    simulation: Simulation, weights: Weights, methods: Sequence[str]
) -> dict[tuple[str, str], float]:
    """(method, figure) → ours, in the units of the paper.

    The figure is 'low', 'high', 'all', 'initial', 'following' or their 'sd'.
    """
    recording = simulate(simulation)
    resting = recording.recorded[recording.role == UNLOADED].mean(axis=0)
    frames = recording.recorded[recording.role == MEASURED]
    measured = 100 * (frames[0] / resting - 1)
    results = {
        ("measured", "low"): float(measured.min()),
        ("measured", "high"): float(measured.max()),
    }
    for method in methods:
        if method == "measured":
            continue
        left = left_by_solver(method, simulation.scene.panel, resting, frames, weights)
        results[method, "low"], results[method, "high"] = (
            float(left.change[0].min()),
            float(left.change[0].max()),
        )
        if left.joint:
            within = inside(mouth_of(simulation), simulation.scene.panel)
            results[method, "inside"] = float(left.change[0][within].max(initial=-100.0))
        parts = (
            {"initial": left.data_error[:1], "following": left.data_error[1:]}
            if left.joint
            else {"all": left.data_error}
        )
        for steps, error in parts.items():
            results[method, steps], results[method, f"{steps} sd"] = (
                float(error.mean()),
                float(error.std(ddof=1)),
            )
        results[method, "evaluations"] = float(left.evaluations.mean())
    return results


def published() -> dict[tuple[str, str], float]:
    """The same of the paper, standard deviations included."""
    numbers = read_published(FILE)
    results: dict[tuple[str, str], float] = {}
    for record in numbers.ranges:
        results[record.method, "low"], results[record.method, "high"] = record.low, record.high
        if METHODS.get(record.method, ("", False))[1]:
            results[record.method, "inside"] = record.high
    for row in numbers.errors:
        results[row.method, row.steps], results[row.method, f"{row.steps} sd"] = (
            row.error_percent,
            row.error_sd_percent,
        )
    return results


def off(ours: Mapping[tuple[str, str], float], methods: Sequence[str]) -> Array:
    """Return the distance of these methods' numbers from the published ones, in quarters of them.

    Deviations count half.

    Without both gradient methods, what is to be predicted is left out.
    """
    distances: list[float] = []
    for (method, what), target in published().items():
        if method not in methods or (methods == FITTED and (method, what) in PREDICTED):
            continue
        value = ours[method, what]
        if what in ("low", "high") and target < 0:
            # Falls by nearly all are also held against what is left: −94 and −99.9 % are not alike.
            distances.append((value - target) / (0.25 * abs(target)))
            if target < -50:
                distances[-1] += float(np.log((100.01 + value) / (100.01 + target))) / 3
        else:
            half = 0.5 if what.endswith("sd") else 1.0
            distances.append(half * float(np.log(max(value, 1e-3) / target)) / float(np.log(1.25)))
    return np.abs(distances)


def reproduced(ours: Mapping[tuple[str, str], float]) -> dict[tuple[str, str], bool]:
    """Which of the nineteen numbers lie within a quarter of the published one."""
    requested = {
        key: value for key, value in published().items() if not key[1].endswith(("sd", "inside"))
    }
    return {key: abs(ours[key] - value) <= 0.25 * abs(value) for key, value in requested.items()}


def numbers_at(place: Array) -> dict[str, float]:
    """Numbers of a place in the unit cube."""
    results = {}
    for part, (name, (least, most, logarithmic)) in zip(place, BOX.items(), strict=True):
        results[name] = float(
            least * (most / least) ** part if logarithmic else least + (most - least) * part
        )
    return results


def place_of(numbers: Mapping[str, float]) -> Array:
    """The place of numbers, kept within the cube."""
    results = []
    for name, (least, most, logarithmic) in BOX.items():
        value = numbers[name]
        part = (
            np.log(value / least) / np.log(most / least)
            if logarithmic
            else (value - least) / (most - least)
        )
        results.append(part)
    return np.clip(np.array(results), 0, 1)


def distance(place: Array, fitted: Sequence[str], bound: float) -> float:
    """Mean distance over the seeds, in quarters; given up where it is far above `bound`."""
    numbers = numbers_at(place)
    means = []
    weights = Weights(relative=numbers["relative"], start=numbers["start"])
    for seed in SEEDS:
        try:
            ours = figures_of(simulation_of(numbers, seed), weights, fitted)
            means.append(float(np.mean(np.minimum(off(ours, fitted), 12.0))))
        except (ValueError, np.linalg.LinAlgError):
            means.append(12.0)
        if np.mean(means) > 2 * bound:
            break
    return float(np.mean(means))


def search(
    seconds: float, seed: int, fitted: Sequence[str], first: Sequence[Mapping[str, float]]
) -> None:
    """Try random places, then differences and small steps of the best ones.

    Each new best place is printed.
    """
    rng = np.random.default_rng(seed)
    started = time.monotonic()
    pool: list[tuple[float, Array]] = []
    waiting = [place_of(numbers) for numbers in first]
    tried = 0
    while time.monotonic() - started < seconds:
        tried += 1
        if waiting:
            place = waiting.pop(0)
        elif first and tried <= 25:
            place = np.clip(place_of(first[0]) + 0.12 * rng.standard_normal(len(BOX)), 0, 1)
        elif tried <= 60 and not first:
            place = rng.random(len(BOX))
        else:
            record, two, three = (
                pool[min(int(rng.exponential(3)), len(pool) - 1)][1] for _ in range(3)
            )
            step = rng.normal(0, 0.08 * rng.random(), len(BOX)) * (rng.random(len(BOX)) < 0.4)
            place = record + 0.6 * (two - three) * (rng.random() < 0.7) + step
            place = np.clip(
                np.where(place < 0, -place, np.where(place > 1, 2 - place, place)), 0, 1
            )
        bound = pool[min(7, len(pool) - 1)][0] if pool else 12.0
        pool.append((distance(place, fitted, bound), place))
        pool.sort(key=lambda entry: entry[0])
        del pool[PARENTS:]
        if pool[0][1] is place:
            numbers = {name: float(f"{value:.4g}") for name, value in numbers_at(place).items()}
            print(
                tried,
                f"{time.monotonic() - started:.0f} s",
                f"{pool[0][0]:.3f}",
                json.dumps(numbers),
                flush=True,
            )


def check(file: Path, seeds: int, weights: Weights) -> None:
    """Print every number of a shipped scene with its own seed, and its range over others.

    The effect of each unmodelled part is printed, too.
    """
    ((_, stated),) = read_simulations(file)
    stated = dataclasses.replace(stated, frames=min(stated.frames, 3))
    runs = _seeds(stated, weights, seeds)
    for (method, what), target in published().items():
        own, *drawn = (run[method, what] for run in runs)
        within = np.mean([abs(value - target) <= 0.25 * abs(target) for value in drawn])
        spread = f"{np.median(drawn):9.4g} ({min(drawn):.4g} to {max(drawn):.4g})"
        print(
            f"{method:9} {what:13} paper {target:9.5g} own seed {own:9.4g} others {spread} within "
            f"{100 * within:.0f} %"
        )
    print("evaluations:", {method: runs[0][method, "evaluations"] for method in METHODS})
    print("within a quarter, of 19:", [sum(reproduced(run).values()) for run in runs])
    for name, (simulation, with_weights) in _without(stated, weights).items():
        varied = _seeds(simulation, with_weights, min(seeds, 4))
        counts = [sum(reproduced(run).values()) for run in varied]
        lost = [
            " ".join(key)
            for key, good in reproduced(varied[0]).items()
            if not good and reproduced(runs[0])[key]
        ]
        print(f"{name}: {counts}; lost with its own seed: {', '.join(lost) or 'none'}", flush=True)


def _seeds(
    simulation: Simulation, weights: Weights, seeds: int
) -> list[dict[tuple[str, str], float]]:
    """Return the figures of `seeds` + 1 seeds, that of the simulation first."""
    methods = ("measured", *METHODS)
    return [
        figures_of(dataclasses.replace(simulation, seed=simulation.seed + more), weights, methods)
        for more in range(seeds + 1)
    ]


def _without(simulation: Simulation, weights: Weights) -> dict[str, tuple[Simulation, Weights]]:
    """Return variants of the simulation, one thing different in each."""
    hidden = simulation.unmodelled
    mouth = mouth_of(simulation)
    changed: dict[str, Unmodelled] = {
        "no static error": dataclasses.replace(hidden, reading_error=0.0),
        "static error twice": dataclasses.replace(
            hidden, reading_error=2 * (hidden.reading_error or 0.0)
        ),
        "no series resistance": dataclasses.replace(
            hidden, series_resistance_ohm=0.0, channel_spread_ohm=0.0
        ),
        "140 ohm in series": dataclasses.replace(hidden, series_resistance_ohm=140.0),
        "noise 10 times instead": dataclasses.replace(hidden, reading_error=0.0, noise_factor=10.0),
    }
    varied = {
        name: (dataclasses.replace(simulation, unmodelled=record), weights)
        for name, record in changed.items()
    }
    varied["cells alike (spread 0.2)"] = (
        dataclasses.replace(simulation, cells=Cells(3050.0, 0.2)),
        weights,
    )
    varied["nothing on the other cells"] = dataclasses.replace(simulation, loads=(mouth,)), weights
    for name, relative in (("changes in percent: 10", 10.0), ("100 outside the square: 0.1", 0.1)):
        varied[f"weight on {name}"] = simulation, dataclasses.replace(weights, relative=relative)
    return varied


def main() -> None:
    """Search or check."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=900.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--all", action="store_true", help="fit on all numbers instead of some")
    parser.add_argument(
        "--first", type=json.loads, default=[], help="scenes to begin with, as printed, in a list"
    )
    parser.add_argument("--check", type=Path)
    parser.add_argument("--seeds", type=int, default=10)
    requested = parser.parse_args()
    if requested.check:
        check(requested.check, requested.seeds, WEIGHTS)
    else:
        search(
            requested.seconds,
            requested.seed,
            ("measured", *METHODS) if requested.all else FITTED,
            requested.first,
        )


if __name__ == "__main__":
    main()
