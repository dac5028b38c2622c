"""Attachments and other loads, at 1 to 10 frames a second.

The questions are whether a load sucks and breathes, its size, and its time.

Pressures come from `mouth_scenes`, whose films, rims and electronics are not the package's; here
they get a course over time: touch, suction, breathing with a phase that wanders, leaks, hands that
jitter, release; and films that creep and keep a part of their answer. Only the panel's two-point
resistances are the package's.

    python -m docs.studies.attachments --scenes 10 --seed 7 --rates 4 --out seen.csv
    python -m docs.studies.attachments --read seen.csv other.csv --figure roc.png
    python -m docs.studies.attachments --table --attached 300 --side 8 --scenes 4 --rates 1 2 4 10
    python -m docs.studies.attachments --attached 3600 --rates 1 --side 6 --kinds cup rod
    python -m docs.studies.attachments --pumps-alone --attached 300 --scenes 200
"""

import argparse
import csv
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from time import process_time

import numpy as np

from docs.studies.mouth_scenes import MAKERS, MOUTHS, Film, film, limpet, patch_means, sampled
from docs.studies.mouth_scenes import Scene as Made
from lampest import GroundedReadout, two_point_resistance
from lampest.apps.recognition.detect.answer import LAMPREY, Detected
from lampest.apps.recognition.detect.detection import known_of, measured_frames
from lampest.apps.recognition.pumping import BLOCK_S, Pumping
from lampest.inference.prepared import Prepared
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.response import PublishedResponse, ratio_from_pressure
from lampest.panel.scene import Scene
from lampest.recording.recording import Recording

UNLOADED = 5
TOUCH_S = 2.0
ATTACHED_S = 14.0
BARE_S = 4.0
# of the temperature: of all cells, a tenth of it different from cell to cell
SWAY = 0.03
SWAY_S = 7200.0
# s, and the part of the answer that comes so late
CREEP = ((1.0, 0.02), (10.0, 0.02), (100.0, 0.02))
# part of its largest answer that a film keeps, and for how long
KEPT = 0.12
FADES_S = 60.0
SHAKEN = "shaken cup"
STILL = "still mouth"
PUMPING = "pumping mouth"
BUMPED = "bumped cup"
SLIDING = "sliding mouth"
PULLED = "pulled mouth"
CURRENT = "mouth in current"
CUP_CURRENT = "cup in current"
HAND_PUMPED = "hand-pumped cup"
RING = "jitter ring"
WATER = "moving water"
MOVING = "mouth in moving water"
CUP_MOVING = "cup in moving water"
LEAKING = "leaking cup"
IRREGULAR = "irregular breath"
STRONGLY_PULLED = "strongly pulled mouth"
PAUSING = "pausing mouth"
LIMPET = "limpet"
PLANT = "waving plant"
IN_WATER = (WATER, MOVING, CUP_MOVING)
KINDS = (
    *MAKERS,
    SHAKEN,
    STILL,
    PUMPING,
    BUMPED,
    SLIDING,
    PULLED,
    CURRENT,
    CUP_CURRENT,
    HAND_PUMPED,
    RING,
    WATER,
    MOVING,
    CUP_MOVING,
    LEAKING,
    IRREGULAR,
    STRONGLY_PULLED,
    LIMPET,
    PLANT,
    PAUSING,
)
LIVING = (*MOUTHS, PUMPING, SLIDING, PULLED, CURRENT, MOVING, IRREGULAR, STRONGLY_PULLED, PAUSING)
# their shapes
OF_COURSE = {
    SHAKEN: "cup",
    BUMPED: "cup",
    STILL: "mouth",
    PUMPING: "uneven mouth",
    SLIDING: "mouth",
}
OF_COURSE |= {
    PULLED: "wavy mouth",
    CURRENT: "wavy mouth",
    CUP_CURRENT: "cup",
    HAND_PUMPED: "cup",
    RING: "ring",
    WATER: "nothing",
    MOVING: "wavy mouth",
    CUP_MOVING: "cup",
    LEAKING: "cup",
    IRREGULAR: "wavy mouth",
    STRONGLY_PULLED: "wavy mouth",
    PAUSING: "wavy mouth",
    PLANT: "fin",
}
# kPa: common pressure of the water on all cells; gradients have half of it
WATER_KPA = (0.05, 0.25)
WAVE_HZ = (0.1, 0.45)
# of the durations of single breaths, relative, one from the next
BREATH_SD = 0.06
# of the suction of a strongly pulled mouth, for how long, and the strongest that water holds
PULL = (2.0, 8.0)
PULL_S = 6.0
STRONGEST_KPA = -70.0
# along the rows, and between which times after the touch
SLIDES_MM = 15.0
SLIDES_S = (6.0, 8.0)
SUCKING = ("mouth", "cup", IRREGULAR, LIMPET)
TABLE = (PUMPING, "cup", BUMPED, SHAKEN, "rod", "hand")
PAUSES_S = (10.0, 20.0)  # from one pause of breath to the next; two fifths of the time are pauses
BLOCK = 3600  # frames that are read at once
POISSON_95 = (3.0, 4.74, 6.30, 7.75)  # upper limits of a mean of which so many events were seen
# between pumps (Shi et al. 2021), and the part that is lost until one
PUMPED_S = (20.0, 200.0)
DECAY = (0.1, 0.5)


@dataclass(frozen=True)
class Seen:
    """One recording and its first attachment; times in s after the touch, NaN where there is none.

    true_strongest, strongest, strongest_sd : strongest suction, kPa.

    early : probability that it sucks, 5 s after the touch; sucks, breathes, lives : 4 s before the
        release. pumps : at the end. probability : that of the answer.
    lamprey : when something was first called a lamprey. watched : s of measured frames.
    """

    kind: str
    rate: float
    seed: int
    depth: float
    hertz: float
    answer: str
    early: float
    sucks: float
    breathes: float
    touched: float
    released: float
    count: int
    true_diameter: float
    diameter: float
    diameter_sd: float
    true_suction: float
    suction: float
    suction_sd: float
    seen_depth: float
    depth_sd: float
    seen_hertz: float
    cpu: float
    pumps: float = np.nan
    lamprey: float = np.nan
    watched: float = np.nan
    true_strongest: float = np.nan
    strongest: float = np.nan
    strongest_sd: float = np.nan
    probability: float = np.nan
    lives: float = np.nan


def courses(
    rng: np.random.Generator,
    kind: str,
    time: Array,
    attached_s: float,
    pumps: list[float] | None = None,
    most_pull: float = np.inf,
) -> tuple[Array, float, float]:
    """((frames, 3) factors of contact, of suction and of a body beside, breathing depth, rate).

    The times of pumps are appended to `pumps`, s after the touch. A pull multiplies the suction by
    `most_pull` at most.
    """
    since = time - TOUCH_S
    on = (since >= 0) & (since < attached_s)
    press = np.clip(since / 0.4, 0, 1) * on
    suck = np.clip((since - 0.3) / 1.2, 0, 1) * on
    depth = rng.uniform(0.03, 0.15)
    hertz = rng.uniform(0.6, 2.0)
    step = np.diff(time, prepend=time[0])
    phase = (
        2
        * np.pi
        * (hertz * time + np.cumsum(0.03 * np.sqrt(step) * rng.standard_normal(len(time))))
    )
    jitter = 1 + 0.015 * _wandering(rng, step)
    (own,) = rng.spawn(1)  # so that scenes without a body are as they were
    beats = np.clip(_wandering(own, step, 3.0), 0, 1) * np.sin(
        2 * np.pi * own.uniform(0.4, 1.6) * time
    )
    body = on * (1 + 0.6 * beats)
    if kind == PLANT:  # its blade touches the panel at each wave
        waves = np.maximum(own.uniform(0.2, 1.2) + np.sin(0.6 * phase), 0)
        return np.stack([on * waves, 0 * suck, body], axis=1), 0.0, hertz
    if kind == LIMPET:
        settles = np.clip(since / own.uniform(1, 6), 0, 1)
        press, suck = press * settles, suck * settles
    if kind == RING:  # as a weight on it does that is not at rest
        return np.stack([press * (1 + 0.03 * np.sin(phase)), 0 * suck, body], axis=1), 0.0, hertz
    if kind == HAND_PUMPED:
        pulls = 1 + depth * np.sin(2 * np.pi * hertz * time)
        return np.stack([press * pulls, suck * pulls, body], axis=1), 0.0, hertz
    if kind in LIVING:
        if kind in (IRREGULAR, STRONGLY_PULLED):
            phase = _breath_by_breath(own, time, hertz)
        swing = np.sin(phase)
        if kind == PAUSING:
            swing *= np.sin(2 * np.pi * (since / own.uniform(*PAUSES_S) + own.random())) > -0.3
        breath = 1 + depth * swing
        suck = suck * (_pumped(rng, since, pumps) if kind == PUMPING else 1.0)
        if kind == PULLED:
            begin = rng.uniform(3, 9)
            lasts = rng.uniform(2, 4)
            suck = suck * (
                1
                + rng.uniform(0.5, 2)
                * np.clip(np.minimum(since - begin, begin + lasts - since) * 2, 0, 1)
            )
        if kind == STRONGLY_PULLED:
            begin = own.uniform(3, attached_s - PULL_S - 3)
            within = np.minimum(since - begin, begin + PULL_S - since)
            by = min(own.uniform(*PULL), most_pull)
            suck = suck * (1 + (by - 1) * np.clip(within / 0.5, 0, 1))
        return (
            np.stack([press * (0.2 + 0.8 * suck) * breath, suck * breath, body], axis=1),
            depth,
            hertz,
        )
    leak = np.exp(
        -np.clip(since, 0, attached_s) * rng.uniform(0, 0.14 / attached_s) * ("cup" in kind)
    ) * (1 + 0.004 * _wandering(rng, step))
    if kind == LEAKING:
        begin = own.uniform(5, 9)
        leak = leak * np.exp(-np.maximum(since - begin, 0) / own.uniform(1, 4))
    # Every minute something pushes it, and its suction is another one from then on.
    if kind == BUMPED:
        bumps = rng.uniform(0, attached_s, rng.poisson(attached_s / 60))
        leak = leak * np.exp(rng.normal(0, 0.15, len(bumps)) @ (since >= bumps[:, None]))
    return (
        np.stack(
            [press * (leak if "cup" in kind or kind == STILL else jitter), suck * leak, body],
            axis=1,
        ),
        0.0,
        hertz,
    )


def _breath_by_breath(rng: np.random.Generator, time: Array, hertz: float) -> Array:
    """Return the phase of a breath, (frames), each of whose swings has a duration of its own."""
    count = int(np.ptp(time) * hertz * 2) + 10
    ends = np.cumsum(np.exp(BREATH_SD * rng.standard_normal(count)) / hertz)
    begins = time[0] + np.concatenate([[0.0], ends]) - rng.uniform(0, 1 / hertz)
    return 2 * np.pi * np.interp(time, begins, np.arange(count + 1.0))


def _pumped(rng: np.random.Generator, since: Array, pumps: list[float] | None = None) -> Array:
    """Return the suction over that after a pump, (frames).

    Suction decays until the next pump, which takes half a second to two. The times of the pumps, in
    s after the touch, are appended to `pumps`.
    """
    factor = np.ones_like(since)
    begin = 1.5
    pumps = [] if pumps is None else pumps
    while begin < since[-1]:
        length = np.exp(rng.uniform(*np.log(PUMPED_S)))
        lost = rng.uniform(*DECAY)
        takes = rng.uniform(0.5, 2.0)
        lasted = since - begin
        level = rng.uniform(0.9, 1.1)
        low = factor[lasted < 0][-1] if np.any(lasted < 0) else 1.0
        falls = level * np.exp(np.log1p(-lost) * lasted / length)
        rises = low + (falls - low) * np.clip(lasted / takes, 0, 1)
        factor = np.where(lasted < 0, factor, rises)
        begin = begin + length
        pumps.append(begin)
    return factor


def _wandering(rng: np.random.Generator, step: Array, seconds: float = 0.3) -> Array:
    """Noise of unit variance that is alike within some seconds."""
    value = 0.0
    values = []
    for record in step:
        cached = np.exp(-record / seconds)
        value = cached * value + np.sqrt(1 - cached**2) * rng.standard_normal()
        values.append(value)
    return np.array(values)


def straight(pressure: Array) -> Array:
    """r/r0 that under suction grows along a straight line through the published point.

    The point is 7.54 at −10 kPa.
    """
    return np.where(
        pressure < 0, 1 - 0.654 * pressure, ratio_from_pressure(np.maximum(pressure, 0))
    )


def delayed(pressure: Array) -> Array:
    """r/r0 through the same point that stays 1 up to a suction of 2 kPa."""
    return ratio_from_pressure(
        np.where(pressure < 0, np.minimum(pressure + 2, 0) * 10 / 8, pressure)
    )


def saturated(pressure: Array) -> Array:
    """r/r0 that under suction ends at 5, as of a film whose patches keep an edge in contact."""
    published = ratio_from_pressure(pressure)
    most = np.log(5.0)
    return np.where(pressure < 0, np.exp(most * -np.expm1(-np.log(published) / most)), published)


DRAWN = "drawn"
CURVES: dict[str, Callable[[Array], Array]] = {
    "published": ratio_from_pressure,
    "straight": straight,
    "delayed": delayed,
    "saturated": saturated,
}


def cells(
    rng: np.random.Generator,
    panel: Panel,
    made: Made,
    layer: Film,
    course: Array,
    time: Array,
    shake: Array,
    curve: str = "published",
    water: Array | float = 0.0,
) -> Array:
    """(frames, rows, columns) ohm of a film that creeps.

    shake : (frames) mm by which the load stands off. water : (frames, rows, columns) kPa.
    """
    places = np.unique(np.round(shake, 2))
    parts = (made.contact, made.suction, made.beside)
    maps = {at: patch_means(parts, panel, layer, at) for at in places.tolist()}
    each = [maps[at] for at in np.round(shake, 2).tolist()]
    pressure = np.array(
        [np.tensordot(share, record, 1) for share, record in zip(course, each, strict=True)]
    )
    pressure = pressure + water
    return answered_film(rng, layer, np.log(CURVES[curve](pressure)), time)


def answered_film(
    rng: np.random.Generator,
    layer: Film,
    response: Array,
    time: Array,
) -> Array:
    """Return the cells of a film that creeps, (frames, rows, columns) ohm.

    response : (frames, rows, columns) ln r/r₀ by the film's curve, without creep.
    """
    shape = response.shape[1:]
    resting = 3050 * np.exp(layer.spread * rng.standard_normal(shape))
    answer = layer.bent * np.exp(layer.scatter * rng.standard_normal(shape))
    logarithm = answer * response
    late = [np.zeros(shape) for _ in CREEP]
    most = np.zeros(shape)
    shown = []
    for now, step in zip(logarithm, np.diff(time, prepend=time[0]), strict=True):
        late = [
            old + (now - old) * (1 - np.exp(-step / lag))
            for old, (lag, _) in zip(late, CREEP, strict=True)
        ]
        most = np.where(
            np.abs(now) > np.abs(most), now, now + (most - now) * np.exp(-step / FADES_S)
        )
        shown.append(
            now
            + sum(part * old for old, (_, part) in zip(late, CREEP, strict=True))
            + KEPT * (most - now)
        )
    return np.asarray(resting * np.exp(np.array(shown)))


def moving_water(rng: np.random.Generator, panel: Panel, time: Array) -> Array:
    """Pressure of waves and of a current on all cells, (frames, rows, columns) kPa.

    It has a common part and gradients along both sides. The rate of the waves wanders.
    """
    step = np.diff(time, prepend=time[0])
    size = rng.uniform(*WATER_KPA)
    parts = []
    for share in (1.0, 0.5, 0.5):
        rate = rng.uniform(*WAVE_HZ) * np.exp(0.15 * _wandering(rng, step, 5.0))
        wave = np.sin(2 * np.pi * np.cumsum(rate * step) + rng.uniform(0, 2 * np.pi))
        turbulent = 0.5 * _wandering(rng, step, 0.7) + 0.3 * _wandering(rng, step, 4.0)
        parts.append(size * share * (0.8 * wave + turbulent)[:, None, None])
    down = np.linspace(-0.5, 0.5, panel.rows)[:, None]
    across = np.linspace(-0.5, 0.5, panel.columns)
    return np.asarray(parts[0] + parts[1] * down + parts[2] * across)


def recorded(
    rng: np.random.Generator, resistance: Array, time: Array, *, grounded: bool = False
) -> Array:
    """Return two-point resistances, with 140 ohm in series, as a divider reads them.

    The divider has 1 kohm, 10 bits, 20 readings and a ripple. In the grounded circuit, one row at a
    time has 5 V, all others 0 V, and every column 1 kohm: the result has the columns' volts.
    """
    rows, columns = resistance.shape[1:]
    drift = rng.standard_normal((rows, columns)) * 0.005 + rng.standard_normal() * 0.02
    sway = (
        SWAY
        * (1 + 0.1 * rng.standard_normal((rows, columns)))
        * np.sin(2 * np.pi * time / SWAY_S)[:, None, None]
    )
    drifted = resistance * np.exp(drift * np.log10(1 + time)[:, None, None] + sway)
    channels = 3.0 * rng.standard_normal(rows + columns)
    reference = 1000 * (1 + rng.uniform(-0.01, 0.01))
    gain = 1 + rng.uniform(0, 0.001) * rng.standard_normal((len(time), 1, 1))
    ripple = rng.uniform(0, 0.4) * rng.standard_normal((len(time), 1, columns))
    if grounded:
        share = 1 / drifted / (np.sum(1 / drifted, axis=1, keepdims=True) + 1 / reference)
    else:
        total = two_point_resistance(drifted) + 140.0 + channels[:rows, None] + channels[rows:]
        share = reference / (total + reference)
    codes = 1023 * share * gain + ripple
    parts = np.split(codes, range(BLOCK, len(codes), BLOCK))
    mean = np.concatenate([sampled(rng, part) for part in parts])
    return np.asarray(5 * mean / 1023 if grounded else 1000 * (1023 - mean) / mean)


def recording(
    kind: str,
    rate: float,
    seed: int,
    side: int = 10,
    attached_s: float = ATTACHED_S,
    curve: str = "published",
) -> tuple[Recording, Made, float, float]:
    """Return the recording, its loads, breathing depth and rate.

    The curve "drawn" is any of the others, and the circuit is drawn, too.
    """
    rng = np.random.default_rng([seed, side, KINDS.index(kind)])
    panel = Panel(side, side)
    makers = MAKERS | {LIMPET: limpet}
    made = makers[OF_COURSE.get(kind, kind)](rng, panel)
    grounded = False
    if curve == DRAWN:
        own = np.random.default_rng([seed, side, KINDS.index(kind), 1])
        curve = str(own.choice(list(CURVES)))
        grounded = bool(own.random() < 0.5)
    layer = film(rng, rng.choice(["real", "other"]))
    frames = round((TOUCH_S + attached_s + max(BARE_S, 10 / rate)) * rate)
    time = np.concatenate([(np.arange(UNLOADED) - UNLOADED) / rate, np.arange(frames) / rate])
    most_pull = STRONGEST_KPA / (_suction_of(made) or -1.0)
    course, depth, hertz = courses(rng, kind, time, attached_s, most_pull=most_pull)
    made = replace(made, pull=float(course[:, 1].max()) / (1 + depth))
    shake = rng.uniform(0.3, 1.5) * np.sin(2 * np.pi * hertz * time) * (kind == SHAKEN)
    inwards = (
        1.0 if made.centres_mm and made.centres_mm[0][0] < panel.centres_mm()[0].mean() else -1.0
    )
    shake += (
        inwards
        * SLIDES_MM
        * np.clip((time - TOUCH_S - SLIDES_S[0]) / np.ptp(SLIDES_S), 0, 1)
        * (kind == SLIDING)
    )
    # Turbulence moves it by a third of a millimetre, within two seconds.
    if kind in (CURRENT, CUP_CURRENT, MOVING, CUP_MOVING):
        shake += rng.uniform(0.1, 0.6) * _wandering(rng, np.diff(time, prepend=time[0]), 2.0)
    water: Array | float = 0.0
    if kind in IN_WATER:
        water = moving_water(rng.spawn(1)[0], panel, time)
    resistance = cells(rng, panel, made, layer, course, time - time[0], shake, curve, water)
    scene = scene_of(panel, grounded=grounded)
    if kind in IN_WATER:  # as most scenes, which name neither gain nor ripple
        scene = replace(scene, gain=None, ripple=None)
    role = (np.arange(len(time)) >= UNLOADED).astype(np.uint8)
    return (
        Recording(
            scene,
            recorded(rng, resistance, time - time[0], grounded=grounded),
            time - time[0],
            role,
            name=kind.replace(" ", "_"),
        ),
        made,
        depth,
        hertz,
    )


def _suction_of(made: Made) -> float:
    """Return the suction at the first load's centre, kPa; 0 without one."""
    if not made.centres_mm:
        return 0.0
    x, y = (np.full(1, value) for value in made.centres_mm[0])
    return float(made.suction(x, y)[0])


def scene_of(panel: Panel, *, grounded: bool = False) -> Scene:
    """Return the scene of the recordings of a panel, see `recorded`."""
    readout = GroundedReadout(sense="all", drive_ohm=0.0, load_ohm=1000.0, noise_lsb=0.7)
    return Scene(
        panel,
        readout if grounded else TwoPointReadout(noise_lsb=0.7),
        0.0 if grounded else 140.0,
        response=PublishedResponse(),
        gain="estimated",
        ripple="estimated",
    )


def seen(
    kind: str,
    rate: float,
    seed: int,
    side: int = 10,
    attached_s: float = ATTACHED_S,
    curve: str = "published",
) -> Seen:
    """One recording, and how `lampest detect` answers it at three times."""
    whole, made, depth, hertz = recording(kind, rate, seed, side, attached_s, curve)
    touch = float(whole.time[UNLOADED]) + TOUCH_S
    begin = process_time()
    watched = known_of(Prepared(whole))
    if isinstance(watched, Detected):
        size = made.diameters_mm[0] if len(made.diameters_mm) == 1 else np.nan
        unknown = (np.nan,) * 8
        cpu = process_time() - begin
        answered = (watched.answer, 0.0, 0.0, 0.5, np.nan, np.nan, 0)
        return Seen(kind, rate, seed, depth, hertz, *answered, size, *unknown, cpu)
    watch = watched.watch()
    moments = []
    answers_s = (5.0, attached_s - 4.0)  # after the touch
    lamprey = np.nan
    for value, sigma, time in measured_frames(whole, watched, np.ones(len(whole.time), dtype=bool)):
        watch = watch.push(value, sigma, time)
        moments += [watch] if time >= touch + (*answers_s, np.inf)[len(moments)] else []
        if np.isnan(lamprey) and Detected.of(kind, watch.attachments, rate).answer == LAMPREY:
            lamprey = time - touch
    early, later, full = (
        Detected.of(kind, record.attachments, rate) for record in (*moments, watch)
    )
    cpu = process_time() - begin
    first = full.chosen
    best = later.chosen
    sucking = max((record.sucks for record in early.attachments if record.present), default=0.0)
    suction = np.nan
    x = np.zeros(1)
    if first and made.centres_mm:
        at = min(made.centres_mm, key=first.distance)
        suction = float(made.suction(x + at[0], x + at[1])[0])
    value, sd = (first and first.suction_kpa) or (np.nan, np.nan)
    size, size_sd = (first and first.diameter_mm) or (np.nan, np.nan)
    rhythm = first.breathing_hz if first and first.breathing_hz else (np.nan, np.nan)
    deep = first.breathing_depth if first and first.breathing_depth else (np.nan, np.nan)
    return Seen(
        kind,
        rate,
        seed,
        depth,
        hertz,
        later.answer,
        sucking,
        best.sucks if best else 0.0,
        best.breathes if best else 0.5,
        first.since_s - touch if first else np.nan,
        first.until_s - touch - attached_s if first and first.until_s is not None else np.nan,
        sum(
            record.until_s is None or record.until_s - record.since_s > 3
            for record in full.attachments
        ),
        made.diameters_mm[0] if len(made.diameters_mm) == 1 else np.nan,
        size,
        size_sd,
        suction or np.nan,
        value,
        sd,
        *deep,
        rhythm[0],
        cpu,
        first.pumps if first else np.nan,
        lamprey,
        float(whole.time[-1] - whole.time[UNLOADED]),
        suction * made.pull or np.nan,
        *((first and first.strongest_kpa) or (np.nan, np.nan)),
        later.probability,
        best.lives if best else 0.5,
    )


def pumped_alone(seed: int, count: int, attached_s: float) -> None:
    """Print how often pumps alone name a mouth whose suction is known, by the number of pumps.

    The samples of `lampest detect` at one frame a second are of the true suction, breath included.
    What they do not name, no reading at this rate can.
    """
    time = np.arange(TOUCH_S + attached_s)
    numbers = []
    named = []
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        pumps: list[float] = []
        suction = courses(rng, PUMPING, time, attached_s, pumps)[0][:, 1]
        attached = (time >= TOUCH_S + 2) & (time < TOUCH_S + attached_s)
        rests = suction[attached] / np.median(suction[attached]) - 1
        blocks = rests[: len(rests) // 3 * 3].reshape(-1, 3, 1)
        track = Pumping.begin(np.ones(1), np.zeros(1), 0.0, 0)
        odds = []
        for block, at in zip(blocks, BLOCK_S * np.arange(1, len(blocks) + 1), strict=True):
            track = track.after(block, float(at))
            odds.append(track.odds)
        numbers.append(sum(at < attached_s - BLOCK_S for at in pumps))
        named.append(max(odds) >= np.log(9))
    print(f"| pumps in {attached_s:.0f} s | mouths | named |\n|---|---|---|")
    for least, most in ((0, 0), (1, 1), (2, 2), (3, 4), (5, 99)):
        some = [has for has, pumps in zip(named, numbers, strict=True) if least <= pumps <= most]
        label = (
            f"{least}" if least == most else f"{least} to {most}" if most < 99 else f"{least} on"
        )
        print(f"| {label} | {len(some)} | {sum(some)} |")
    print(f"| all | {count} | {sum(named)}, {np.mean(named):.0%} |")


def read(path: Path) -> Iterator[Seen]:
    """Return the records of an earlier run."""
    kinds = {field.name: field.type for field in fields(Seen)}
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            yield Seen(**{name: kinds[name](text) for name, text in row.items()})  # type: ignore[operator]


def write(path: Path, record: Seen) -> None:
    """Append a recording to a table."""
    new = not path.exists()
    with path.open("a", newline="") as file:
        table = csv.writer(file)
        if new:
            table.writerow([field.name for field in fields(Seen)])
        table.writerow(list(asdict(record).values()))


def area_under_curve(true: Array, false: Array) -> float:
    """P(a score of those that are exceeds one of those that are not), ties half."""
    return float(np.mean((true[:, None] > false).astype(float) + 0.5 * (true[:, None] == false)))


def report(everything: Sequence[Seen]) -> None:
    """Print the tables of docs/studies/mouths.md."""
    for rate in sorted({record.rate for record in everything}):
        of_rate = [record for record in everything if record.rate == rate]
        print(
            f"\n{rate:g} frames a second\n| scene | recordings | answers after 10 s | P(sucks) "
            "after 5 s "
            "| P(breathes) | touched | released | kept as one | diameter: error, in 95 % | suction "
            "over true, in 95 % |"
        )
        for kind in KINDS:
            some = [record for record in of_rate if record.kind == kind]
            if not some:
                continue
            answers = {
                name: sum(record.answer == name for record in some)
                for name in sorted({record.answer for record in some})
            }
            size = np.array(
                [(record.diameter - record.true_diameter, record.diameter_sd) for record in some]
            )
            force = np.array(
                [(record.suction, record.true_suction, record.suction_sd) for record in some]
            )
            print(
                f"| {kind} | {len(some)} | "
                f"{', '.join(f'{name} {n}' for name, n in answers.items())} "
                f"| {np.median([record.early for record in some]):.2f} | "
                f"{np.median([record.breathes for record in some]):.2f} "
                f"| {_middle([record.touched for record in some])} | "
                f"{_middle([record.released for record in some])} "
                f"| {np.mean([record.count == 1 for record in some]):.0%} "
                f"| {_middle(np.abs(size[:, 0]))} mm, {_held(size[:, 0], size[:, 1])} "
                f"| {_middle(force[:, 0] / force[:, 1])}, "
                f"{_held(force[:, 0] - force[:, 1], force[:, 2])} |"
            )
        early = {
            record: [
                seen.early
                for seen in of_rate
                if any(word in seen.kind for word in SUCKING) is record
            ]
            for record in (True, False)
        }
        if all(early.values()):
            print(f"sucks, after 5 s: AUC {area_under_curve(*map(np.array, early.values())):.4f}")
        breathing = [
            np.array([record.breathes for record in of_rate if record.kind in kinds])
            for kinds in (MOUTHS, ("cup",))
        ]
        if all(map(len, breathing)):
            print(f"breathes: AUC {area_under_curve(*breathing):.4f}")
    deep = np.array(
        [
            (record.seen_depth, record.depth, record.depth_sd)
            for record in everything
            if record.depth and record.sucks > 0.5
        ]
    )
    if len(deep):
        covered = _held(deep[:, 0] - deep[:, 1], deep[:, 2])
        print(f"breathing depth over true {_middle(deep[:, 0] / deep[:, 1])}, {covered}")
    force = np.array(
        [
            (record.suction, record.true_suction, record.suction_sd)
            for record in everything
            if record.sucks > 0.5
        ]
    )
    pulled = np.array(
        [
            (record.strongest, record.true_strongest, record.strongest_sd)
            for record in everything
            if record.kind in (PULLED, STRONGLY_PULLED) and record.sucks > 0.5
        ]
    )
    if len(pulled):
        covered = _held(pulled[:, 0] - pulled[:, 1], pulled[:, 2])
        ratio = _middle(pulled[:, 0] / pulled[:, 1])
        print(f"strongest suction of {len(pulled)} pulled mouths over true {ratio}, {covered}")
    if len(force):
        covered = _held(force[:, 0] - force[:, 1], force[:, 2])
        print(f"suction over true {_middle(force[:, 0] / force[:, 1])}, {covered}")
    seconds = np.median([record.cpu for record in everything])
    print(f"median {seconds:.2f} s of processor time a recording")


def table(everything: Sequence[Seen]) -> None:
    """Print minutes to the answer, recall and false alarms for each frame rate."""
    print(
        "| frames a second | mouths | called lamprey | minutes after: median, latest | others, "
        "hours | false |"
    )
    print("|---|---|---|---|---|---|")
    for rate in sorted({record.rate for record in everything}):
        mouths, decoys = (
            [
                record
                for record in everything
                if record.rate == rate and (record.kind in LIVING) is is_one
            ]
            for is_one in (True, False)
        )
        minutes = (
            np.array([record.lamprey for record in mouths if np.isfinite(record.lamprey)]) / 60
        )
        hours = sum(record.watched for record in decoys) / 3600
        false = sum(np.isfinite(record.lamprey) for record in decoys)
        times = f"{np.median(minutes):.1f}, {minutes.max():.1f}" if len(minutes) else "–"
        bound = 24 * POISSON_95[min(false, 3)] / max(hours, 1e-9)
        stated = f"{false} ({24 * false / max(hours, 1e-9):.0f} a day, below {bound:.0f} with 95 %)"
        print(
            f"| {rate:g} | {len(mouths)} | {len(minutes)} | {times} | {len(decoys)}, {hours:.1f} | "
            f"{stated} |"
        )


def plot(everything: Sequence[Seen], path: Path) -> None:
    """Draw ROC curves of both questions, and the share of lampreys among the loads called so.

    Recordings with less than four frames a second are left out.
    """
    from matplotlib import pyplot

    fast = [record for record in everything if record.rate > 3.8]
    sucking = np.array([any(word in record.kind for word in SUCKING) for record in fast])
    mouths = np.array([record.kind in LIVING for record in fast])
    early = np.array([record.early for record in fast])
    called = np.array([record.sucks * record.breathes for record in fast])
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(9, 4), layout="constrained")
    for name, score, true in (
        ("sucks, after 5 s", early, sucking),
        ("lamprey, after 10 s", called, mouths),
    ):
        levels = np.unique(np.append(score, [-1.0, 2.0]))[::-1]
        rates = [[np.mean(score[which] >= level) for level in levels] for which in (~true, true)]
        area = area_under_curve(score[true], score[~true])
        left.plot(
            *(100 * np.array(rates)),
            drawstyle="steps-post",
            label=f"{name}: AUC {area:.3f}, {true.sum()} of {len(true)}",
        )
    left.set(xlabel="false alarms [%]", ylabel="recall [%]", xlim=(-2, 102), ylim=(-2, 102))
    left.legend(loc="lower right", frameon=False)
    for low, high in ((0, 0.1), (0.1, 0.5), (0.5, 0.9), (0.9, 1.01)):
        of = (called >= low) & (called < high)
        if of.any():
            share = mouths[of].mean()
            error = np.sqrt(
                (mouths[of].mean() * (1 - mouths[of].mean()) + 0.25 / of.sum()) / of.sum()
            )
            right.errorbar(100 * called[of].mean(), 100 * share, 100 * error, fmt="o", color="C1")
            right.annotate(
                f"{of.sum()}",
                (100 * called[of].mean(), 100 * share),
                (6, 6),
                textcoords="offset points",
            )
    right.plot([0, 100], [0, 100], color="0.7", zorder=0)
    right.set(
        xlabel="P(lamprey) after 10 s [%]", ylabel="are mouths [%]", xlim=(-5, 108), ylim=(-5, 112)
    )
    figure.savefig(path, dpi=120)
    pyplot.close(figure)


def _middle(values: Sequence[float] | Array) -> str:
    numbers = np.asarray(values, dtype=float)
    return f"{np.nanmedian(numbers):.2f}" if np.isfinite(numbers).any() else "–"


def _held(error: Array, sd: Array) -> str:
    known = np.isfinite(error) & np.isfinite(sd)
    return f"{np.mean(np.abs(error[known]) < 1.96 * sd[known]):.0%}" if known.any() else "–"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=4, help="of every kind and rate")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--rates", type=float, nargs="+", default=[4.0])
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS))
    parser.add_argument(
        "--table", action="store_true", help="minutes to the answer, recall and false alarms alone"
    )
    parser.add_argument("--out", type=Path, help="a table, to which recordings are appended")
    parser.add_argument(
        "--read", type=Path, nargs="+", help="such tables, to report instead of new scenes"
    )
    parser.add_argument("--side", type=int, default=10, help="of the panel, cells")
    parser.add_argument("--attached", type=float, default=ATTACHED_S, help="s")
    parser.add_argument(
        "--curve", choices=[*CURVES, DRAWN], default="published", help="of the film under suction"
    )
    parser.add_argument(
        "--pumps-alone", action="store_true", help="mouths that known suction names by its pumps"
    )
    parser.add_argument("--figure", type=Path, help="ROC curves and calibration, such as roc.png")
    given = parser.parse_args()
    if given.pumps_alone:
        pumped_alone(given.seed, given.scenes, given.attached)
        raise SystemExit
    records = [record for path in given.read or () for record in read(path)]
    for number in range(0 if given.read else given.scenes):
        for rate in given.rates:
            for kind in given.kinds or (TABLE if given.table else KINDS):
                seed = 1000 * given.seed + number
                records.append(seen(kind, rate, seed, given.side, given.attached, given.curve))
                if given.out is not None:
                    write(given.out, records[-1])
    (table if given.table else report)(records)
    if given.figure is not None:
        plot(records, given.figure)
