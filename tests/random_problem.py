"""Random problems of estimation, and the least cost that anything finds of each.

No test stands here.

A problem is drawn from two numbers, a seed and its own: 1 × N and N × 1 to 24 × 24 cells, every
readout, noise of 0 to 10 %, weights of 1e-9 to 1e9, all terms and losses, known faults, wild
readings, rails and holes; a frame alone, a joint first pair, or a frame after others.
"""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from lampest import (
    Absolute,
    Data,
    Faults,
    GroundedReadout,
    Huber,
    LoadedColumnsReadout,
    Misfit,
    OptimalMethod,
    Panel,
    Readings,
    Squared,
    Step,
    VirtualGroundReadout,
    term_types,
)
from lampest.cost.cost import Cost
from lampest.estimate.estimator import Estimator
from lampest.estimate.stream import Stream
from lampest.files.errors import BROKEN
from lampest.panel.readouts import Readout, TwoPointReadout
from lampest.panel.scene import Scene
from lampest.solvers.by_ipopt import Ipopt
from lampest.solvers.multistart import evaluated
from lampest.solvers.posed import Bounds
from lampest.solvers.projected_newton import ProjectedNewton
from tests.least_cost import Array, Circuit, LeastCost, Penalty

SIZES = {"line": 0.1, "to 6": 0.3, "to 10": 0.3, "to 16": 0.2, "to 24": 0.1}
TERMS = {
    "misfit": 0.14,
    "cell_resistance": 0.12,
    "relative_change": 0.15,
    "gradient": 0.16,
    "gradient_of_relative_change": 0.14,
    "total_variation": 0.08,
    "log_ratio": 0.09,
    "total_variation_of_change": 0.06,
    "arrival": 0.06,
}
CIRCUITS = {"two_point": 0.5, "loaded": 0.2, "grounded": 0.1, "grounded_one": 0.1, "virtual": 0.1}
LOSSES = {"squared": Squared, "huber": Huber, "absolute": Absolute}
ABSOLUTE = ("misfit", "cell_resistance", "gradient", "total_variation")
ROUNDING_ERROR = 1e-12
MIN_STEP = 1e-14  # of ln r
# beyond, building a nodal program takes seconds, and so does a trust region
NODAL_CELLS = 64
SEVERAL_CELLS = 100
REGION_CELLS = 150  # a step of the trust region takes a second beyond


def chosen(random: np.random.Generator, shares: dict[str, float]) -> str:
    """A key, as often as its share says."""
    return str(random.choice(list(shares), p=np.array([*shares.values()]) / sum(shares.values())))


@dataclass(frozen=True, eq=False)
class RandomProblem:
    """A drawn problem: circuit and penalties, each twice, and frames (3, rows, columns) ohm.

    The panel rests in the first frame.
    """

    seed: int
    number: int
    circuit: Circuit
    scene: Scene
    penalties: tuple[Penalty, ...]
    cells: Array
    recorded: Array
    sigma: Array | None
    pushed: int
    about: str
    joint: bool = False

    @classmethod
    def drawn(cls, seed: int, number: int) -> "RandomProblem":
        """The problem of these two numbers."""
        random = np.random.default_rng([seed, number])
        shape = _shape(random)
        cells = _cells(random, shape)
        kind = chosen(random, CIRCUITS)
        faults = _faults(random, shape) if random.random() < 0.15 else None
        circuit, readout = _circuit(
            random, kind, float(np.exp(np.mean(np.log(cells)))), faults, shape[0]
        )
        actual = _with_faults(cells, faults)
        exact = np.stack([circuit.reading(frame)[0] for frame in actual])
        noise = 0.0 if random.random() < 0.15 else float(10 ** random.uniform(-4, -1))
        sigma = np.maximum(noise, 1e-4) * np.abs(exact)
        recorded = exact + noise * np.abs(exact) * random.standard_normal(exact.shape)
        troubles = _troubled(random, recorded, circuit)
        noise_known = random.random() < 0.8 or kind != "two_point"
        penalties = _penalties(random, noise_known, exact, sigma)
        pushed = int(random.integers(0, 3))
        words = (
            f"{shape[0]}×{shape[1]}",
            kind,
            f"noise {noise:.1e}{'' if noise_known else ' unstated'}",
            *(
                f"{penalty.kind}({penalty.weight:.1e}, {penalty.loss}"
                f"{', σ' if penalty.scaled else ''})"
                for penalty in penalties
            ),
            ("resting", "first frame", "second frame")[pushed],
            *troubles,
            "" if faults is None else "faults",
        )
        return cls(
            seed=seed,
            number=number,
            circuit=circuit,
            scene=Scene(Panel(*shape), readout, faults=faults),
            penalties=penalties,
            cells=cells,
            recorded=recorded,
            sigma=sigma if noise_known else None,
            pushed=pushed,
            about=", ".join(filter(None, words)),
        )

    @cached_property
    def estimator(self) -> Estimator:
        """The reduced one."""
        terms = []
        for penalty in self.penalties:
            loss = (
                Huber(corner=penalty.corner) if penalty.loss == "huber" else LOSSES[penalty.loss]()
            )
            options: dict[str, Any] = {"weight": penalty.weight, "loss": loss}
            if penalty.kind == "misfit":
                terms.append(Misfit(weighting="noise" if penalty.scaled else "plain", loss=loss))
                continue
            if penalty.kind in ("log_ratio", "total_variation_of_change"):
                options["reference"] = penalty.against
            terms.append(term_types()[penalty.kind](**options))
        bars = any(penalty.kind == "arrival" for penalty in self.penalties)
        bounds = Bounds() if self.sigma is not None else Bounds(upper="none")
        return Estimator(
            tuple(terms), OptimalMethod("reduced", joint=self.joint), bounds=bounds, error_bars=bars
        )

    @property
    def alone(self) -> Estimator:
        """Without the terms that compare, as a baseline that is asked for alone is solved."""
        return replace(self.estimator, terms=self.estimator.absolute_terms)

    @cached_property
    def _readings(self) -> list[Readings]:
        sigmas = [None] * 3 if self.sigma is None else list(self.sigma)
        return [Readings.of(self.scene, *pair) for pair in zip(self.recorded, sigmas, strict=True)]

    @cached_property
    def requested(self) -> tuple[Stream, Readings] | None:
        """The stream before the requested frame, and the frame, or None for the baseline."""
        stream = Stream.begin(self.estimator, self.scene, 1.0, self._readings[0])
        if self.pushed == 0 and stream.baseline is not None:
            return None
        for frame in range(1, self.pushed):
            stream, _ = stream.push(self._readings[frame])
        return stream, self._readings[max(self.pushed, 1)]

    @cached_property
    def data(self) -> Data:
        """Data of the requested solve."""
        if self.requested is None:
            state = Stream(self.estimator, self.scene, 1.0, self._readings[0]).without_comparisons()
            return self.estimator.method.data_and_start(state, self._readings[0])[0]
        stream, readings = self.requested
        return stream.data_and_start(readings)[0]

    @cached_property
    def cost(self) -> Cost:
        """Cost of the requested solve."""
        estimator = self.alone if self.requested is None else self.estimator
        return estimator.cost(self.scene, len(self.data.measured), partial=self.data.partial)

    def solved(self) -> Step:
        """That solve."""
        if self.requested is None:
            baseline = Stream.begin(self.estimator, self.scene, 1.0, self._readings[0]).baseline
            return baseline
        stream, readings = self.requested
        return stream.push(readings)[1]

    @cached_property
    def oracle(self) -> LeastCost:
        """The same problem in the second statement."""
        alone = self.requested is None
        faults = self.scene.faults
        terms = (penalty for penalty in self.penalties if not alone or penalty.kind in ABSOLUTE)
        panel = self.scene.panel
        broken = None if faults is None else faults.open_cells(panel) | faults.shorted_cells(panel)
        return LeastCost.of(self.data, *terms, circuit=self.circuit, faulty=broken)

    def excess(self, solution: Any) -> float:
        """Share of the cost of an estimate that another solver saves.

        Negative where each of them costs more.

        Misfits of exact readings are rounding, which is small against the cost of readings of zero.
        Cells that are equal but for their last bits are the same estimate, however heavy the
        absolute loss of these bits.
        """
        warnings.simplefilter("ignore")
        estimate = solution.cell_resistance
        position = np.log(estimate).ravel()
        own = self.oracle.value(position)
        with np.errstate(all="ignore"):
            ends = [
                place for place in self._ends(estimate) if np.abs(place - position).max() > MIN_STEP
            ]
            costs = [self.oracle.value(place) for place in ends if np.all(np.isfinite(place))]
        least = min((cost for cost in costs if np.isfinite(cost)), default=np.inf)
        return (own - least - ROUNDING_ERROR * self.oracle.blank()) / own

    def _ends(self, estimate: Array) -> Iterator[Array]:
        """Yield ends u, within the bounds, of other solvers from the estimate and other starts."""
        data = self.data
        random = np.random.default_rng([self.seed, self.number, 1])
        truth = self.cells[:2] if len(data.measured) == 2 else self.cells[self.pushed][None]
        low = np.log(data.lower).ravel()
        high = np.log(data.upper).ravel()
        size = truth.size
        scattered = [
            np.log(data.apparent_resistance).ravel() + random.uniform(0, 3, size) for _ in range(2)
        ]
        starts = [np.log(cells).ravel() for cells in (estimate, truth, data.uniform_start)]
        for start in [*starts, *scattered[: 1 if size <= SEVERAL_CELLS else 0]]:
            try:
                if size <= REGION_CELLS:
                    yield self.oracle.minimised(start, 100 if size <= SEVERAL_CELLS else 20)
                else:
                    yield self.oracle.descended(start)
            except (ValueError, ArithmeticError):
                continue
        solvers: list[tuple[Any, list[Array]]] = [
            (ProjectedNewton(self.cost, self.estimator.solver), scattered)
        ]
        if size <= NODAL_CELLS:
            nodal = Ipopt(
                self.cost,
                self.estimator.solver,
                self.scene.circuit,
                self.scene.wiring,
                "nodal",
            )
            solvers.append((nodal, [starts[1], np.log(data.start()).ravel()]))
        for solver, places in solvers:
            for place in places:
                try:
                    cells = np.exp(np.clip(place, low, high)).reshape(data.measured.shape)
                    outcome = solver.solve(data, evaluated(self.cost, data, cells))
                except BROKEN:
                    continue
                yield np.clip(np.log(outcome.cell_resistance).ravel(), low, high)


def shape_of(seed: int, number: int) -> tuple[int, int]:
    """The shape of the panel of a problem, without the rest of it."""
    return _shape(np.random.default_rng([seed, number]))


def _shape(random: np.random.Generator) -> tuple[int, int]:
    size = chosen(random, SIZES)
    if size == "line":
        length = int(random.integers(1, 25))
        return (1, length) if random.random() < 0.5 else (length, 1)
    low, high = {"to 6": (2, 6), "to 10": (4, 10), "to 16": (8, 16), "to 24": (15, 24)}[size]
    rows, columns = random.integers(low, high + 1, 2)
    return int(rows), int(columns)


def _cells(random: np.random.Generator, shape: tuple[int, int]) -> Array:
    """Three frames ohm: scattered cells, and patches that are pressed or sucked more and more."""
    level = 10 ** random.uniform(2.5, 4.5)
    spread = random.choice([0.05, 0.3, 1.0], p=[0.3, 0.5, 0.2])
    resting = level * np.exp(spread * random.standard_normal(shape))
    down, along = np.indices(shape)
    change = np.zeros(shape)
    for _ in range(int(random.integers(0, 4))):
        centre = random.uniform(0, 1, 2) * shape
        near = np.hypot(down - centre[0], along - centre[1]) < random.uniform(
            0.6, 0.4 * max(shape) + 0.7
        )
        change = np.where(near, random.uniform(-3, 3), change)
    return np.stack(
        [resting * np.exp(share * change) for share in (0.0, random.uniform(0.3, 1.0), 1.0)]
    )


def _faults(random: np.random.Generator, shape: tuple[int, int]) -> Faults | None:
    """Draw one or two faults of a scene, or none on panels that are too small for it."""
    if min(shape) < 3:
        return None
    fault = random.choice(["open", "shorted", "dead", "joined"])
    first = random.choice(shape[0], 2, replace=False)
    second = random.choice(shape[1], 2, replace=False)
    pairs = tuple((int(row), int(column)) for row, column in zip(first, second, strict=True))
    if fault == "joined":
        return Faults(joined_rows=(tuple(int(row) for row in sorted(first)),))
    if fault == "dead":
        return Faults(
            dead_rows=(int(first[0]),),
            dead_columns=(int(second[0]),) if random.random() < 0.5 else (),
        )
    return Faults(open=pairs) if fault == "open" else Faults(shorted=pairs[:1])


def _with_faults(cells: Array, faults: Faults | None) -> Array:
    if faults is None:
        return cells
    panel = Panel(*cells.shape[1:])
    typical = np.exp(np.mean(np.log(cells)))
    broken = np.where(faults.open_cells(panel), 1e9 * typical, cells)
    return np.where(faults.shorted_cells(panel), 1e-6 * typical, broken)


def _circuit(
    random: np.random.Generator, kind: str, level: float, faults: Faults | None, rows: int
) -> tuple[Circuit, Readout | None]:
    drive = float(random.uniform(20, 200))
    sense = float(random.uniform(20, 200))
    load = float(level * 10 ** random.uniform(-1, 0.7))
    joined = () if faults is None else faults.joined_rows
    converter = {"adc_bits": 16, "readings": 20, "noise_lsb": 0.5, "supply_volt": 5.0}
    circuit = Circuit(kind, joined, drive, sense, load, 5.0)
    if kind == "two_point":
        return circuit, TwoPointReadout(
            reference_ohm=level, **converter
        ) if random.random() < 0.5 else None
    if kind == "loaded":
        return circuit, LoadedColumnsReadout(drive_ohm=drive, load_ohm=load, **converter)
    if kind == "virtual":
        return circuit, VirtualGroundReadout(
            drive_ohm=drive, sense_ohm=sense, feedback_ohm=load, **converter
        )
    sensed = "one" if kind == "grounded_one" else "all"
    return circuit, GroundedReadout(
        drive_ohm=drive, sense_ohm=sense, load_ohm=load, sense=sensed, **converter
    )


def _troubled(random: np.random.Generator, recorded: Array, circuit: Circuit) -> list[str]:
    """Wild readings, holes and rails, put into `recorded`; their names."""
    names = []
    for name, share in (("wild", 0.12), ("rails", 0.12), ("holes", 0.15)):
        if random.random() >= share:
            continue
        names.append(name)
        struck = random.random(recorded.shape) < 10 ** random.uniform(-2, -0.7)
        if name == "wild":
            struck &= random.random(recorded.shape) < 0.3
            recorded[struck] *= np.exp(
                random.choice([-1, 1], struck.sum()) * random.uniform(0.2, 2, struck.sum())
            )
        elif name == "rails":
            high = np.inf if circuit.kind == "two_point" else circuit.supply
            recorded[struck] = np.where(random.random(struck.sum()) < 0.7, high, 0.0)
        else:
            recorded[struck] = np.nan
    return names


def _penalties(
    random: np.random.Generator, noise_known: bool, exact: Array, sigma: Array
) -> tuple[Penalty, ...]:
    scaled = noise_known and random.random() < 0.4
    shares = {"squared": 0.8, "huber": 0.12, "absolute": 0.08}
    corner = float(random.uniform(1, 4) * (1.0 if scaled else np.median(sigma)))
    data = Penalty("misfit", 1.0, chosen(random, shares), corner, scaled=scaled)
    kind = chosen(random, TERMS)
    if kind == "misfit" or (kind == "arrival" and not noise_known):
        return (data,)
    own = {
        "total_variation": "absolute",
        "log_ratio": "absolute",
        "total_variation_of_change": "absolute",
    }
    loss = own.get(kind, "huber" if kind == "arrival" else "squared")
    if random.random() < 0.2:
        loss = chosen(random, {"squared": 1, "huber": 1, "absolute": 1})
    weight = 10 ** (random.uniform(-9, 9) if random.random() < 0.5 else random.uniform(-5, 2))
    corner = float(10 ** random.uniform(0, 2))
    if kind == "arrival":
        corner = 1.25
        weight = 1.0 if scaled else float(np.median(sigma) ** 2)
    against = str(random.choice(["baseline", "previous"])) if kind in own else "previous"
    return data, Penalty(kind, float(weight), loss, corner, against)
