"""Forces of two or three fresh touches, naive and after `calibrate --loads`.

Run it with: python -m docs.studies.loads --panels 6 --seed 2001

Panels of 8 × 8 cells whose gains scatter by a fifth. A rod of 30 mm is put on places a pitch apart
(one point: 5 kPa), or 17.5 mm apart with 1, 3, 9 and 20 kPa; it stands 0.5 mm beside its place.
Fresh touches are rods of 15 to 25 mm and 2 to 20 kPa. `repeat` is by how much a cell answers
otherwise each time. Errors are those of the force on the cells of a touch, in percent of what the
same cells truly felt; `weight` is against the rod's weight, of which cells a pitch apart see only
samples. `held` is how many pressures of touched cells lie within their 95 % intervals.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lampest.apps.calibration.known_loads import KnownLoads
from lampest.apps.calibration.loads import calibrate_loads
from lampest.cost.terms import Misfit
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import reconstruct
from lampest.panel.panel import Array, Panel
from lampest.panel.response import PowerResponse, PublishedResponse
from lampest.panel.scene import Scene
from lampest.recording.shapes import Rod
from lampest.recording.shapes.shape import Shape
from tests.known_loads import RESTING, Bench, moved_over, rod

FILMS = {"published": None, "power 0.8": PowerResponse(exponent=0.8, scale_kpa=2.0)}
LOADS = {"one point": ([5.0], 10.0), "four pressures": ([1.0, 3.0, 9.0, 20.0], 17.5)}
FRESH = 10
COLUMNS = ("mean", "median", "90 %", "weight", "held")


def touches(rng: np.random.Generator, panel: Panel, count: int) -> list[Shape]:
    """Rods that do not overlap, of 15 to 25 mm and 2 to 20 kPa."""
    rods: list[Rod] = []
    while len(rods) < count:
        diameter = float(rng.uniform(15, 25))
        ends = [(10.0 * (count - 1) - diameter / 2) for count in panel.shape[::-1]]
        x, y = (float(rng.uniform(diameter / 2, end)) for end in ends)
        apart = [np.hypot(x - placed.centre_mm[0], y - placed.centre_mm[1]) for placed in rods]
        if all(
            far > (diameter + placed.diameter_mm) / 2 + 10
            for far, placed in zip(apart, rods, strict=True)
        ):
            rods.append(rod(x, y, diameter, float(np.exp(rng.uniform(np.log(2), np.log(20))))))
    return list(rods)


def forces(pressure: Array, loads: Sequence[Shape], panel: Panel) -> Array:
    """Σ p·pitch² over the cells within 6 mm of each load, newton."""
    columns, rows = panel.centres_mm()
    newton = []
    for load in loads:
        far = np.hypot(columns[None] - load.centre_mm[0], rows[:, None] - load.centre_mm[1])
        newton.append(pressure[far < load.reach_mm + 6].sum() * panel.pitch_mm**2 * 1e-3)
    return np.array(newton)


def measured_forces(bench: Bench, scene: Scene, groups: list[list[Shape]]) -> Array:
    """Return |error| of the forces, the same against the weights, and the share of held pressures.

    The shape is (touches, figures).
    """
    recording = bench.recorded(
        groups, "fresh", replace(scene, response=scene.response or PublishedResponse())
    )
    results = reconstruct(recording, Estimator((Misfit(),), "reduced"))
    truth = recording.truth_pressure
    assert truth is not None and results.pressure is not None
    assert results.pressure_lower is not None and results.pressure_upper is not None
    rows = []
    for number, group in enumerate(groups):
        first, _ = bench.frames_of(number)
        at = first - RESTING
        applied = truth[first]
        felt = applied > 0.5
        held = ((results.pressure_lower[at] <= applied) & (applied <= results.pressure_upper[at]))[
            felt
        ].mean()
        newton = forces(results.pressure[at], group, bench.panel)
        weights = np.array([load.mass_g * 9.81e-3 for load in group if isinstance(load, Rod)])
        off = np.abs(newton / forces(applied, group, bench.panel) - 1), np.abs(newton / weights - 1)
        rows.append(np.stack([*off, np.full(len(group), held)], axis=1))
    return np.concatenate(rows)


def figures(errors: Array) -> str:
    """A line of the table, percent."""
    off, weight, held = errors.T
    numbers = (off.mean(), np.median(off), np.percentile(off, 90), weight.mean(), held.mean())
    return " ".join(f"{100 * number:7.1f}" for number in numbers)


def study(panels: int, seed: int, film: str, plan: str, repeat: float) -> None:
    """Print both lines of a film and a plan of loads."""
    kpa, step = LOADS[plan]
    errors: dict[str, list[Array]] = {"naive": [], "calibrated": []}
    for number in range(panels):
        bench = Bench(seed + number, repeat=repeat, response=FILMS[film])
        groups, known = moved_over(bench, kpa, 30.0, step)
        results = calibrate_loads(
            [bench.recorded(groups, "loads")], KnownLoads(schema=1, loads=tuple(known)), 0.01
        )
        rng = np.random.default_rng(seed + 1000 + number)
        fresh = [touches(rng, bench.panel, int(rng.integers(2, 4))) for _ in range(FRESH)]
        for name, scene in (("naive", bench.scene), ("calibrated", results.scene)):
            errors[name].append(measured_forces(bench, scene, fresh))
    means = {name: np.concatenate(parts) for name, parts in errors.items()}
    for name, parts in means.items():
        print(f"{film:10} {plan:14} {100 * repeat:6.0f} % {name:10} {figures(parts)}")
    better = 1 - means["calibrated"][:, 0].mean() / means["naive"][:, 0].mean()
    print(f"{'':34} better by {100 * better:.1f} %")


def main() -> None:
    """Every film, plan and repeatability."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--panels", type=int, default=6)
    parser.add_argument("--seed", type=int, default=2001)
    chosen = parser.parse_args()
    print(
        f"{'film':10} {'loads':14} {'repeat':8} {'':10} "
        + " ".join(f"{name:>7}" for name in COLUMNS)
    )
    for film in FILMS:
        for plan in LOADS:
            for repeat in (0.02, 0.05):
                study(chosen.panels, chosen.seed, film, plan, repeat)


if __name__ == "__main__":
    main()
