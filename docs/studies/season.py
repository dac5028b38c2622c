"""Visits of a season: whether each is one row, with its times and its word.

A season is drawn: a mouth, which attaches again after 30 s, two mouths at once, a cup, a rod, a
limpet that settles slowly and a waving plant, in a drawn order. Meanwhile the level rises by 30 cm,
the temperature drifts by 2 °C an hour, and a dead row of the panel is declared. Pressures, films
and electronics are those of `docs.studies.attachments`.

With --rounds the loads come again, other ones each time, and --idle lengthens the times between
them.

    python -m docs.studies.season --seasons 2 --rates 4 1
    python -m docs.studies.season --seasons 1 --rates 1 --rounds 5 --idle 45
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import process_time

import numpy as np

from docs.studies.attachments import (
    CURVES,
    LIMPET,
    PUMPING,
    TOUCH_S,
    UNLOADED,
    answered_film,
    courses,
    recorded,
    scene_of,
)
from docs.studies.mouth_scenes import (
    Film,
    Pressure,
    cup,
    film,
    fin,
    limpet,
    mouth,
    patch_means,
    rod,
)
from docs.studies.mouth_scenes import Scene as Made
from lampest import Faults
from lampest.apps.recognition.attachment import Attachment
from lampest.apps.recognition.detect.answer import Detected
from lampest.apps.recognition.detect.detection import Known, known_of, measured_frames
from lampest.inference.prepared import Prepared
from lampest.panel.conditions import Water, water_pressure
from lampest.panel.panel import Array, Panel
from lampest.recording.recording import Recording

HEAD = 60  # frames before the first visit, from which the noise is estimated
AGAIN_S = 30.0  # between two visits of one mouth
DEPTH_MM = 200.0
LEVEL_KPA = 0.00981 * 300  # 30 cm of water
LEVEL_S = 300.0
# of ln r in an hour: 2 °C at 0.4 % per degree, a tenth of it different from cell to cell; it
# returns within a day
DRIFT = 0.008
DAY_S = 86400.0
PLANT = "plant"
IN_TIME_S = 2.0
MATCH_MM = 15.0  # between a visit and its row
ROOM_MM = 4.0  # between two loads at once


@dataclass(frozen=True, eq=False)
class Visit:
    """A true visit.

    Attributes
    ----------
    kind : str
    begin, end : float
        s.
    places : tuple of (float, float)
        Its centre, mm; of a plant that of every blade.
    kpa : (float, float)
        Lowest and highest pressure on a cell that is read, beside that of the water.
    """

    kind: str
    begin: float
    end: float
    places: tuple[tuple[float, float], ...]
    kpa: tuple[float, float]


@dataclass
class Season:
    """A season that is being drawn: pressures and their courses, and the visits.

    Attributes
    ----------
    rng : Generator
    panel : Panel
    time : array, shape (frames,)
        s.
    layer : Film
    dead : int
        Row that is not read.
    parts : list of (pressure, course)
        Pressures over the panel, kPa, and their factors in time, (frames,).
    visits : list of Visit
    """

    rng: np.random.Generator
    panel: Panel
    time: Array
    layer: Film
    dead: int
    parts: list[tuple[Pressure, Array]]
    visits: list[Visit]

    def add(self, kind: str, made: Made, begin: float, lasts: float) -> None:
        """Add the visit of a load."""
        # beyond it courses are 0, and its pumps would be drawn in vain
        near = np.abs(self.time - begin - lasts / 2) < lasts / 2 + 2 * TOUCH_S
        course = np.zeros((len(self.time), 3))
        course[near], _, _ = courses(self.rng, kind, self.time[near] - begin + TOUCH_S, lasts)
        if kind == LIMPET:
            settles = np.clip((self.time - begin) / self.rng.uniform(1, 30), 0, 1)
            course = course * settles[:, None]
        self.parts += [(made.contact, course[:, 0]), (made.suction, course[:, 1])]
        self._visit(kind, begin, begin + lasts, made.centres_mm, (made.contact, made.suction))

    def _visit(
        self,
        kind: str,
        begin: float,
        end: float,
        places: tuple[tuple[float, float], ...],
        pressures: Sequence[Pressure],
    ) -> None:
        maps = np.delete(np.sum(patch_means(pressures, self.panel, self.layer), 0), self.dead, 0)
        kpa = float(maps.min()), float(maps.max())
        self.visits.append(Visit(kind, begin, end, places, kpa))

    def mouth_again(self, begin: float) -> float:
        """Add a mouth that attaches again in its place, and return the end."""
        made = mouth(self.rng, self.panel)
        for _ in range(2):
            lasts = self.rng.uniform(60, 120)
            self.add(PUMPING, made, begin, lasts)
            begin += lasts + AGAIN_S
        return begin - AGAIN_S

    def two_mouths(self, begin: float) -> float:
        """Add two mouths that are attached at once, and return the end."""
        first = mouth(self.rng, self.panel)
        second = first
        while _overlap(first, second):
            second = mouth(self.rng, self.panel)
        self.add(PUMPING, first, begin, self.rng.uniform(80, 120))
        self.add(PUMPING, second, begin + self.rng.uniform(15, 40), self.rng.uniform(40, 100))
        return max(visit.end for visit in self.visits)

    def single(self, kind: str, make: Callable[..., Made]) -> Callable[[float], float]:
        """Return a function that adds one load and returns its end."""

        def added(begin: float) -> float:
            lasts = self.rng.uniform(80, 150)
            self.add(kind, make(self.rng, self.panel), begin, lasts)
            return begin + lasts

        return added

    def plant(self, begin: float) -> float:
        """Add a plant whose blades touch the panel at each wave, and return the end."""
        lasts = self.rng.uniform(100, 180)
        on = (self.time >= begin) & (self.time < begin + lasts)
        hertz = self.rng.uniform(0.3, 1.2)
        places = []
        blades = []
        for _ in range(self.rng.integers(3, 7)):
            wave = np.sin(2 * np.pi * hertz * self.time + self.rng.uniform(0, 1.5))
            made = fin(self.rng, self.panel)
            factor = on * np.maximum(self.rng.uniform(0.2, 1.2) + wave, 0.0) * 0.3
            self.parts.append((made.contact, factor))
            blades.append(made.contact)
            x, y = np.meshgrid(*self.panel.centres_mm())
            weight = made.contact(x, y)
            total = max(float(weight.sum()), 1e-9)
            places.append((float((weight * x).sum() / total), float((weight * y).sum() / total)))
        self._visit(PLANT, begin, begin + lasts, tuple(places), blades)
        return begin + lasts

    def recording(self, water: Array) -> Recording:
        """Return the recording of the loads, while the water has more pressure, (frames,) kPa."""
        time = self.time[: len(water)]
        maps = patch_means([pressure for pressure, _ in self.parts], self.panel, self.layer)
        factors = np.array([course[: len(water)] for _, course in self.parts])
        under = Water(DEPTH_MM)
        depth = water_pressure(self.panel, under)
        pressure = np.tensordot(factors, np.array(maps), axes=(0, 0))
        pressure += water[:, None, None] + depth
        curve = CURVES["published"]
        response = np.log(curve(pressure) / curve(depth))
        resistance = answered_film(self.rng, self.layer, response, time)
        own = DRIFT * (1 + 0.1 * self.rng.standard_normal(self.panel.shape))
        day = DAY_S / (2 * np.pi)
        resistance *= np.exp(-own * day * np.sin(time[:, None, None] / day) / 3600)
        resistance[:, self.dead] = 1e12
        with np.errstate(divide="ignore"):  # of the row that is not read
            readings = recorded(self.rng, resistance, time)
        readings[:, self.dead] = np.nan
        scene = replace(scene_of(self.panel), faults=Faults(dead_rows=(self.dead,)), water=under)
        role = (np.arange(len(time)) >= UNLOADED).astype(np.uint8)
        return Recording(scene, readings, time, role, name="season")


def _overlap(first: Made, second: Made) -> bool:
    reach = (first.diameters_mm[0] + second.diameters_mm[0]) / 2 + ROOM_MM
    distance = np.hypot(*np.subtract(first.centres_mm[0], second.centres_mm[0]))
    return bool(distance < reach)


def drawn(
    seed: int, rate: float, side: int = 10, rounds: int = 1, idle: float = 1.0
) -> tuple[Season, Array]:
    """Return a season, and the pressure of the rising water over that at first, (frames,) kPa.

    Its loads come in `rounds`, and times between them are `idle` times as long.
    """
    rng = np.random.default_rng([seed, side, round(10 * rate)])
    panel = Panel(side, side)
    longest = 1800.0 * rounds * idle
    time = np.arange(UNLOADED + HEAD + round(longest * rate)) / rate
    dead = int(rng.integers(side))
    season = Season(rng, panel, time, film(rng, "real"), dead, [], [])
    acts = [
        season.mouth_again,
        season.two_mouths,
        season.single("cup", cup),
        season.single("rod", rod),
        season.single(LIMPET, limpet),
        season.plant,
    ]
    begin = (UNLOADED + HEAD) / rate
    for _ in range(rounds):
        for number in rng.permutation(len(acts)):
            begin = acts[number](begin + idle * rng.uniform(40, 80))
    frames = np.searchsorted(time, begin + 40)
    water = LEVEL_KPA * np.clip((time[:frames] - rng.uniform(0.2, 0.7) * begin) / LEVEL_S, 0, 1)
    return season, water


def rows_of(record: Recording) -> Detected:
    """Return the answer of `lampest detect` to a season."""
    known = known_of(Prepared(record))
    assert isinstance(known, Known), known.why
    return known.answer(measured_frames(record, known, np.ones(len(record.time), dtype=bool)))


def matched(visit: Visit, loads: Sequence[Attachment], end: float) -> list[int]:
    """Return the numbers of the rows that are of a visit."""
    numbers = []
    for number, load in enumerate(loads):
        until = end if load.until_s is None else load.until_s
        during = load.since_s < visit.end + IN_TIME_S and until > visit.begin - IN_TIME_S
        reach = MATCH_MM + (load.width if visit.kind == PLANT else 0.0)
        if during and min(map(load.distance, visit.places)) < reach:
            numbers.append(number)
    return numbers


def report(visits: Sequence[Visit], answer: Detected) -> None:
    """Print a row for each visit, and the rows of no visit."""
    end = answer.end_s or 0.0
    free = dict(enumerate(answer.attachments))
    print("| visit | cells under [kPa] | from, to [s] | rows | late by [s] | word | P(sucks) |")
    print("|---|---|---|---|---|---|---|")
    for visit in sorted(visits, key=lambda visit: (visit.kind == PLANT, visit.begin)):
        numbers = [number for number in matched(visit, answer.attachments, end) if number in free]
        rows = [free.pop(number) for number in numbers]
        late = ""
        if rows:
            last = max(end if load.until_s is None else load.until_s for load in rows)
            first = min(load.since_s for load in rows)
            late = f"{first - visit.begin:.1f}, {last - visit.end:.1f}"
        words = ", ".join(answer.called[number] for number in numbers)
        chances = ", ".join(f"{load.sucks:.3f}" for load in rows)
        print(
            f"| {visit.kind} | {visit.kpa[0]:.1f} to {visit.kpa[1]:.1f} "
            f"| {visit.begin:.0f}, {visit.end:.0f} | {len(rows)} | {late} "
            f"| {words} | {chances} |"
        )
    for number, load in free.items():
        print(
            f"| none | | | 1 | {load.since_s:.1f} to {load.until_s} s | {answer.called[number]} "
            f"| {load.sucks:.3f} |"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seasons", type=int, default=2)
    parser.add_argument("--seed", type=int, default=7100)
    parser.add_argument("--rates", type=float, nargs="+", default=[4.0], help="frames a second")
    parser.add_argument("--side", type=int, default=10, help="rows and columns of the panel")
    parser.add_argument("--rounds", type=int, default=1, help="in which the loads come")
    parser.add_argument("--idle", type=float, default=1.0, help="factor of the times between them")
    given = parser.parse_args()
    for rate in given.rates:
        for seed in range(given.seed, given.seed + given.seasons):
            season, water = drawn(seed, rate, given.side, given.rounds, given.idle)
            record = season.recording(water)
            begin = process_time()
            answer = rows_of(record)
            cpu = process_time() - begin
            print(f"\nseason {seed}, {rate:g} frames a second, {cpu:.0f} s of processor time")
            report(season.visits, answer)
