"""How often the model check calls a right circuit wrong, and how often it notices a wrong one.

    python -m docs.studies.model_check [--matched N] [--wrong N] [--first SEED]
                                       [--sides N ...] [--bits N ...]

Scenes are drawn anew: 4 × 4 to 18 × 18 cells, both sides driven, converters of 8 to 16 bits with 0
to 3 LSB of noise, loads of every shape or none, faults and saturated readings among them. Truth
comes from the simulation alone.
"""

import argparse
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

import lampest
from lampest import LoadedColumnsReadout, Recording, Scene, Simulation, TwoPointReadout
from lampest.audit.advice import Audit
from lampest.files.levels import SIGNIFICANCE
from lampest.inference.circuits.alternatives import Alternative
from lampest.inference.circuits.explanation import Explanation
from lampest.inference.circuits.model_check import ModelCheck, Question
from lampest.inference.prepared import Prepared
from lampest.recording.simulation.measure import measured

# evidence; its noise is some ± 2 √evidence
SHOWN = ", where the data can show it"
SHOWN_FROM = 100.0
A_CELL = 12.0  # −2 ln evidence that a moved cell costs where its change is known to 1 %
SIDES = (4, 6, 8, 10, 12, 16, 18)


def converter(random: np.random.Generator) -> dict[str, float]:
    """Return the converter of any of these boards."""
    bits = int(random.choice([8, 10, 12, 16]))
    return {
        "supply_volt": float(random.choice([3.3, 5.0])),
        "adc_bits": bits,
        "readings": int(random.choice([1, 4, 20])),
        "noise_lsb": float(random.uniform(0, 3)),
    }


def two_point(random: np.random.Generator, panel: lampest.Panel) -> Scene:
    """With multiplexers in series, or without."""
    across = str(random.choice(["reference", "sensor"]))
    reference = float(random.choice([470.0, 1000.0, 2200.0]))
    readout = TwoPointReadout(**converter(random), reference_ohm=reference, measured_across=across)
    return Scene(panel, readout, series_resistance_ohm=float(random.choice([0.0, 140.0, 300.0])))


def loaded_columns(random: np.random.Generator, panel: lampest.Panel) -> Scene:
    """Driven from either side, up or down."""
    readout = LoadedColumnsReadout(
        **converter(random),
        driven=str(random.choice(["rows", "columns"])),
        polarity=str(random.choice(["up", "down"])),
        load_ohm=float(random.choice([1000.0, 3300.0, 10000.0])),
        drive_ohm=float(random.choice([0.0, 100.0, 1080.0])),
    )
    return Scene(panel, readout)


def driven(random: np.random.Generator, panel: lampest.Panel) -> Scene:
    """Idle lines of either side at ground, behind a resistor, or floating.

    Loads are of one line, or of groups.
    """
    states = [0.0, 50.0, 3300.0, float("inf")]
    side = str(random.choice(["rows", "columns"]))
    sensed = panel.columns if side == "rows" else panel.rows
    keys: dict[str, Any] = {
        "driven": side,
        "polarity": str(random.choice(["up", "down"])),
        "load_ohm": float(random.choice([1000.0, 3300.0, 10000.0])),
        "drive_ohm": float(random.choice([0.0, 50.0, 470.0])),
        "idle_ohm": float(random.choice(states)),
        "idle_load_ohm": float(random.choice(states)),
    }
    if sensed % 2 == 0 and random.random() < 0.25:
        lines = np.arange(sensed).reshape(2, -1).tolist()
        keys["groups"] = tuple(tuple(group) for group in lines)
    return Scene(panel, lampest.DrivenReadout(**converter(random), **keys))


def loads(random: np.random.Generator, panel: lampest.Panel) -> tuple[lampest.Shape, ...]:
    """One of any shape, in the middle half of the panel; or none."""
    size = np.array([panel.columns - 1, panel.rows - 1]) * panel.pitch_mm
    centre = tuple(float(part) for part in size * random.uniform(0.3, 0.7, 2))
    shapes: list[tuple[lampest.Shape, ...]] = [
        (),
        (lampest.Rod(centre_mm=centre, diameter_mm=30, mass_g=float(random.uniform(100, 2000))),),
        (lampest.Ring(centre_mm=centre, outer_diameter_mm=35, inner_diameter_mm=27, mass_g=850),),
        (
            lampest.SuctionCup(
                centre_mm=centre, outer_diameter_mm=35, inner_diameter_mm=27, pressure_kpa=-10
            ),
        ),
        (
            lampest.OralDisc(
                centre_mm=centre, diameter_mm=30, rim_width_mm=6, pressure_kpa=-8, rim_kpa=60
            ),
        ),
        (lampest.Block(centre_mm=centre, length_mm=60, width_mm=25, mass_g=1500),),
    ]
    return shapes[int(random.integers(len(shapes)))]


def sound(seed: int, *, drifts: bool = True) -> tuple[str, Recording] | None:
    """Return a fully specified recording, or None if no such panel can be simulated or read.

    A third of the panels drift by a percent a minute, which the scene does not name; none does
    without `drifts`.
    """
    random = np.random.default_rng([seed, 1])
    rows, columns = random.choice(SIDES, 2).tolist()
    panel = lampest.Panel(rows, columns, 10.0)
    kind = [two_point, loaded_columns, driven][seed % 3]
    scene = kind(random, panel)
    what = kind.__name__
    cells = lampest.Cells(
        float(random.choice([800.0, 3050.0, 30000.0])), float(random.choice([0.1, 0.3, 1.0]))
    )
    drift = float(random.choice([0.0, 0.0, 0.01]))
    creep = lampest.Unmodelled(drift_per_minute=drift if drifts else 0.0)
    simulation = Simulation(
        1, seed, scene, cells, frames=3, loads=loads(random, panel), unmodelled=creep
    )
    recording = lampest.simulate(simulation)
    if random.random() < 0.3:
        what = what + ", faults"
        recording = broken(recording, faults(random, panel), seed)
    try:
        recording.readings()
    except lampest.InputError:
        return None
    return what, recording


def broken(recording: Recording, known: lampest.Faults, seed: int) -> Recording:
    """The same panel measured with cells that are broken as its scene will tell."""
    assert recording.truth_cell_resistance is not None
    cells = recording.truth_cell_resistance.copy()
    panel = recording.scene.panel
    cells[:, known.open_cells(panel)] = 1e12
    cells[:, known.shorted_cells(panel)] = 1e-3
    recorded, _ = measured(recording.scene, cells, lampest.Unmodelled(), seed)
    return replace(
        recording, scene=replace(recording.scene, faults=known), recorded=recorded, raw_sums=None
    )


def faults(random: np.random.Generator, panel: lampest.Panel) -> lampest.Faults:
    """An open cell, a short or a dead row."""
    row = int(random.integers(panel.rows))
    column = int(random.integers(panel.columns))
    several = ({"open": ((row, column),)}, {"shorted": ((row, column),)}, {"dead_rows": (row,)})
    return lampest.Faults(**several[int(random.integers(3))])


def wrong(seed: int, side: int, bits: int, exact: bool = False) -> Iterator[tuple[str, Recording]]:
    """Recordings of a loaded panel of side × side cells under scenes that tell another circuit.

    exact : without noise.
    """
    random = np.random.default_rng([seed, 2])
    panel = lampest.Panel(side, side, 10.0)
    stated = {"supply_volt": 3.3, "adc_bits": bits, "readings": 4, "noise_lsb": 1.0}
    read = TwoPointReadout(**stated, reference_ohm=1000.0)
    divider = TwoPointReadout(**stated, reference_ohm=10000.0)
    loaded = LoadedColumnsReadout(**stated, load_ohm=10000.0, drive_ohm=1080.0)
    shapes = ()
    while not shapes:
        shapes = loads(random, panel)

    def taken(scene: Scene) -> Recording:
        recording = lampest.simulate(Simulation(1, seed, scene, frames=3, loads=shapes))
        if not exact:
            return recording
        assert recording.truth_cell_resistance is not None
        recorded = scene.circuit.to_recorded(
            scene.circuit.exact_reading(recording.truth_cell_resistance), scene
        )
        return replace(recording, recorded=recorded, raw_sums=None)

    def retold(
        recording: Recording, scene: Scene, convert: Callable[[np.ndarray], np.ndarray]
    ) -> Recording:
        return replace(recording, scene=scene, recorded=convert(recording.recorded), raw_sums=None)

    plain = taken(Scene(panel, read, series_resistance_ohm=140.0))
    yield "series of 140 ohm forgotten", retold(plain, Scene(panel, read), lambda ohm: ohm)
    volts = taken(Scene(panel, loaded))
    naive = retold(volts, Scene(panel, divider), lambda volt: 10000.0 * (3.3 / volt - 1))
    yield "loaded columns told as two_point", naive
    swapped = replace(loaded, driven="columns")
    yield "rows and columns swapped", retold(volts, Scene(panel, swapped), lambda volt: volt)
    both = taken(Scene(panel, divider))
    ideal = replace(loaded, drive_ohm=0.0)
    yield (
        "two_point told as loaded columns",
        retold(both, Scene(panel, ideal), lambda ohm: 33000.0 / (ohm + 10000.0)),
    )


def evidence(exact: Recording) -> float:
    """Return the −2 log probability by which the truth exceeds the specified circuit.

    The readings are without noise. The figure is −2 ln evidence of the specified circuit, at σ of
    the mean frames, less A_CELL for each cell that moved, by more than 1 % beside the others; 0
    where those are half of the panel or more, or the fit fails.
    """
    cells = exact.truth_cell_resistance
    assert cells is not None
    unloaded = np.flatnonzero(exact.role == 0)
    measured = np.flatnonzero(exact.role == 1)
    change = np.log(cells[measured[0]] / cells[0])
    moved = np.abs(change - np.median(change)) > 0.01
    named = np.arange(len(exact.role))
    question = Question(
        Alternative(exact.scene, exact.recorded, exact.sigma),
        exact.role,
        unloaded,
        measured,
        1.0,
        named,
    )
    results = Explanation.of(question.specified, question, patient=True)
    if 2 * moved.sum() >= moved.size:
        return 0.0
    if (
        results is None
        or results.pair is None
        or min(fit.tail for fit in results.fits) < SIGNIFICANCE
    ):
        return float("inf")
    return results.pair.evidence.score - A_CELL * int(moved.sum())


def named(what: str, check: ModelCheck) -> bool:
    """Whether the sentence names the right circuit.

    On a square panel exchanged sides are transposed readings.
    """
    names = {
        "series of 140 ohm forgotten": ["series_resistance_ohm near"],
        "loaded columns told as two_point": ["loaded_columns, readout.driven: rows"],
        "rows and columns swapped": ["readout.driven: rows", "readings listed column by column"],
        "two_point told as loaded columns": ["two_point"],
    }
    return any(name in check.better for name in names[what])


def false_alarms(first: int, count: int) -> None:
    """Print how many matched recordings are called wrong, or get advice, by kind.

    Print their sentences as well.
    """
    seen = Counter[str]()
    alarms = Counter[str]()
    noisy = Counter[str]()
    advised = Counter[str]()
    seed = first
    while seen.total() < count:
        drawn = sound(seed)
        seed = seed + 1
        if drawn is None:
            continue
        what, recording = drawn
        audit = Audit(Prepared(recording))
        check = audit.prepared.check
        seen[what] += 1
        for finding in audit.advice:
            advised[f"{what}: {finding.line}"] += 1
        alarms[what] += check.explains is False
        noisy[what] += check.noise > 1
        if check.explains is False:
            rows, columns = recording.scene.panel.shape
            print(f"  seed {seed - 1}, {rows} × {columns}, {what}: {check.sentence}", flush=True)
        if seen.total() % 100 == 0:
            print(f"after {seen.total()}: {alarms.total()} called wrong", flush=True)
    for what in sorted(seen):
        print(f"{what:32} {alarms[what]:3} of {seen[what]} called wrong, {noisy[what]} too noisy")
    for what in sorted(advised):
        print(f"{what}: advised {advised[what]} times")
    print(
        f"false alarms: {alarms.total()} of {seen.total()} "
        f"({100 * alarms.total() / seen.total():.2f} %)",
        flush=True,
    )


def detections(first: int, count: int, sides: Sequence[int], bits: Sequence[int]) -> None:
    """Print the shares of wrong circuits that are noticed, and named.

    A line counts all of them, or those that the data can show.
    """
    for side, of_bits in product(sides, bits):
        noticed = Counter[str]()
        right = Counter[str]()
        tried = Counter[str]()
        for seed in range(first, first + count):
            both = zip(
                wrong(seed, side, of_bits), wrong(seed, side, of_bits, exact=True), strict=True
            )
            for (what, recording), (_, exact) in both:
                check = Prepared(recording).check
                shown = evidence(exact)
                for of in (what, what + SHOWN) if shown >= SHOWN_FROM else (what,):
                    tried[of] += 1
                    noticed[of] += check.explains is False
                    right[of] += named(what, check)
                if shown >= SHOWN_FROM and check.explains is not False:
                    print(
                        f"  missed: seed {seed}, {side} × {side}, {of_bits} bits, {what}, evidence "
                        f"{shown:.0f}"
                    )
        for what, total in sorted(tried.items()):
            shares = (
                f"noticed {100 * noticed[what] / total:5.1f} %, named "
                f"{100 * right[what] / total:5.1f} %"
            )
            print(f"{side:2} × {side:2}, {of_bits} bits, {what:52} {shares} of {total}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--matched", type=int, default=600)
    parser.add_argument("--wrong", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--bits", type=int, nargs="+", default=[10, 12])
    parser.add_argument("--sides", type=int, nargs="+", default=[6, 10, 16])
    asked = parser.parse_args()
    if asked.matched:
        false_alarms(asked.first, asked.matched)
    if asked.wrong:
        detections(asked.first, asked.wrong, asked.sides, asked.bits)
