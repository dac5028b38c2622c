"""How often lines in another order are found, and how often the right order is doubted.

Run it with: python -m docs.studies.orders [--recordings 8] [--seed 7901] [--sides 8 10 16]

Recordings have the circuits of `tests.panels`, films that scatter by 0 to 30 %, three to eight
unloaded frames and six to 19 measured ones. Loads stand, sway or move. The table counts recordings
with a finding on the order: of those in the right order (*doubted*), and of those in another one.
"""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lampest import Panel
from lampest.audit.order import order_findings
from lampest.panel.panel import Array
from lampest.recording.recording import Recording
from tests.panels import Plan, recorded

Lines = NDArray[np.intp]
FINE = 3  # points across a cell at which a pressure is taken


@dataclass(frozen=True)
class Loaded(Plan):
    """A plan under a load whose picture is a function of places.

    Attributes
    ----------
    shape : str
        Key of `SHAPES`.
    """

    shape: str = "rod"

    def loaded(self) -> Array:
        """Return cells of every frame, (frames, rows, columns) ohm."""
        rng = np.random.default_rng([self.seed, 1])
        picture = SHAPES[self.shape](rng, min(self.cells.shape))
        place = rng.uniform(0.25, 0.75, 2)
        way = rng.uniform(-0.2, 0.2, 2) if self.load == "moves" else np.zeros(2)
        strength = rng.uniform(0.4, 2.0)
        frames = [self.cells] * self.unloaded
        for frame in range(self.measured):
            share = frame / max(self.measured - 1, 1)
            amount = strength * (1 + 0.05 * np.sin(frame) * (self.load == "sways"))
            centre = (place + share * way) * np.array(self.cells.shape)
            points = ((np.arange(FINE * count) + 0.5) / FINE for count in self.cells.shape)
            down, across = (line - at for line, at in zip(points, centre, strict=True))
            fine = picture(down[:, None], across[None, :])
            rows, columns = self.cells.shape
            of_cells = fine.reshape(rows, FINE, columns, FINE).mean(axis=(1, 3))
            frames.append(self.cells * np.exp(-amount * of_cells))
        return np.array(frames)


Picture = Callable[[Array, Array], Array]


def rod(rng: np.random.Generator, side: int) -> Picture:
    """Return a rod's pressure: a disc of 1 to 4 cells across."""
    radius = rng.uniform(0.5, min(2.0, side / 4))
    return lambda down, across: (np.hypot(down, across) < radius).astype(float)


def smooth(rng: np.random.Generator, side: int) -> Picture:
    """Return a Gaussian of an eighth to a third of the panel, such as a cushion's."""
    width = side * rng.uniform(0.12, 0.33)
    return lambda down, across: np.exp(-(down**2 + across**2) / (2 * width**2))


def palm(rng: np.random.Generator, side: int) -> Picture:
    """Return a palm over all cells, with a ball, a heel, and uneven skin."""
    places = rng.uniform(-0.4, 0.4, (3, 2)) * side
    widths = rng.uniform(0.15, 0.4, 3) * side
    phases = rng.uniform(0, 2 * np.pi, 2)

    def pressure(down: Array, across: Array) -> Array:
        balls = sum(
            np.exp(-((down - y) ** 2 + (across - x) ** 2) / (2 * width**2))
            for (y, x), width in zip(places, widths, strict=True)
        )
        uneven = 0.1 * np.sin(1.7 * down + phases[0]) * np.sin(1.9 * across + phases[1])
        return np.asarray(0.3 + 0.6 * balls + uneven)

    return pressure


def mouth(rng: np.random.Generator, side: int) -> Picture:
    """Return a mouth: a rim that presses, and cells within that suction opens."""
    radius = rng.uniform(1.2, side / 3.5)
    rim = rng.uniform(0.4, 0.9)
    suction = rng.uniform(0.2, 0.8)

    def pressure(down: Array, across: Array) -> Array:
        far = np.hypot(down, across)
        return (np.abs(far - radius) < rim) - suction * (far < radius - rim)

    return pressure


def hand(rng: np.random.Generator, side: int) -> Picture:
    """Return a hand: a palm and four fingers, turned by any angle."""
    turn = rng.uniform(0, 2 * np.pi)
    size = side / 10
    gaps = rng.uniform(1.0, 1.4) * size

    def pressure(down: Array, across: Array) -> Array:
        along = down * np.cos(turn) + across * np.sin(turn)
        aside = -down * np.sin(turn) + across * np.cos(turn)
        of_palm = np.hypot((along + 1.5 * size) / 1.5, aside / 2) < size
        of_fingers = [
            (np.abs(aside - (finger - 1.5) * gaps) < 0.35 * size)
            & (along > 0.5 * size)
            & (along < (3.5 - 0.4 * abs(finger - 1.3)) * size)
            for finger in range(4)
        ]
        return np.asarray(of_palm | np.any(of_fingers, axis=0), float)

    return pressure


SHAPES: dict[str, Callable[[np.random.Generator, int], Picture]] = {
    "rod": rod,
    "smooth": smooth,
    "palm": palm,
    "mouth": mouth,
    "hand": hand,
}


def wrong_orders(rng: np.random.Generator, side: int) -> Iterator[tuple[str, Lines]]:
    """Yield names of other orders, and the numbers of readings as they arrive, (side, side)."""
    numbers = np.arange(side * side).reshape(side, side)
    lines = np.arange(side)

    def swapped(first: int, second: int) -> Lines:
        order = lines.copy()
        order[[first, second]] = second, first
        return order

    first = int(rng.integers(side - 1))
    yield "neighbours swapped", numbers[swapped(first, first + 1)]
    distant = int(rng.integers(side - side // 3))
    yield "distant rows swapped", numbers[swapped(distant, distant + side // 3)]
    yield "columns swapped", numbers[:, swapped(*rng.choice(side, 2, replace=False).tolist())]
    serpentine = numbers.copy()
    serpentine[1::2] = serpentine[1::2, ::-1]
    yield "serpentine", serpentine
    yield "interleaved", numbers[np.concatenate([lines[::2], lines[1::2]])]
    if side & (side - 1) == 0:
        bits = side.bit_length() - 1
        low, high = sorted(rng.choice(bits, 2, replace=False).tolist())
        differ = ((lines >> low) ^ (lines >> high)) & 1
        yield "address bits exchanged", numbers[lines ^ (differ << low) ^ (differ << high)]


def recordings(seed: int, count: int, side: int, shape: str) -> Iterator[Loaded]:
    """Yield plans of a side and a shape."""
    for number in range(count):
        own = int(np.random.SeedSequence([seed, side, number]).generate_state(1)[0])
        plan = Plan.drawn(own)
        rng = np.random.default_rng([own, 3])
        cells = np.median(plan.cells) * np.exp(
            rng.choice([0.0, 0.05, 0.15, 0.3]) * rng.standard_normal((side, side))
        )
        load = str(rng.choice(["stands", "sways", "moves"]))
        scene = replace(plan.scene, panel=Panel(side, side))
        yield Loaded(scene, cells, load, plan.unloaded, plan.measured, own, shape)


def judged(recording: Recording) -> str:
    """Return what the findings on the order say; '' without one."""
    readout = recording.scene.readout
    assert readout is not None
    volts = recording.scene.circuit.volt_from_recorded(recording.recorded)
    found = list(order_findings(recording, volts))
    return " ".join(f"{finding.text} {finding.remedy}" for finding in found)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=8, help="of each side and load")
    parser.add_argument("--seed", type=int, default=7901)
    parser.add_argument("--sides", type=int, nargs="+", default=[8, 10, 16])
    given = parser.parse_args()
    counts: dict[tuple[str, str], list[bool]] = {}
    for side in given.sides:
        for shape in SHAPES:
            for plan in recordings(given.seed, given.recordings, side, shape):
                codes = plan.codes()
                right = judged(recorded(plan.scene, codes, plan.unloaded))
                counts.setdefault(("doubted", shape), []).append(bool(right))
                if right:
                    print(f"doubted: {side} × {side}, {shape}, {plan.load}: {right}")
                rng = np.random.default_rng([plan.seed, 4])
                for name, order in wrong_orders(rng, side):
                    delivered = codes.reshape(len(codes), -1)[:, order]
                    words = judged(recorded(plan.scene, delivered, plan.unloaded))
                    counts.setdefault((name, shape), []).append(bool(words))
    print(f"| order | {' | '.join(SHAPES)} | all |\n|---|{'---|' * (len(SHAPES) + 1)}")
    for name in dict.fromkeys(name for name, _ in counts):
        cells = [counts[name, shape] for shape in SHAPES]
        cells.append([seen for of_shape in cells for seen in of_shape])
        row = (f"{sum(seen)} of {len(seen)}" for seen in cells)
        print(f"| {name} | {' | '.join(row)} |")


if __name__ == "__main__":
    main()
