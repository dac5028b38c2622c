"""Scenes for recognition, made without the package's simulation.

The patches, rims and electronics are other ones than those of the package.

A film's patch is a square or a circle of 5 to 7 mm, sampled on a grid of its own; rims have hard or
sloping edges. Cells answer with a factor of their own and all of them less than published, where
the film is bent. The divider, its converter, channels and outliers are written out here. Only the
panel's two-point resistances are the package's.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lampest import two_point_resistance
from lampest.panel.panel import Array, Panel
from lampest.panel.response import ratio_from_pressure

GRID = 11  # points along a patch's edge
Pressure = Callable[[Array, Array], Array]  # x, y in mm → kPa


@dataclass(frozen=True)
class Film:
    """Departure of a film from its published curve.

    Cells answer `bent` times as much in log, each scattered by its own factor.
    """

    patch_mm: float
    round: bool
    bent: float
    scatter: float
    spread: float


def _none(x: Array, y: Array) -> Array:
    return np.zeros_like(x)


@dataclass(frozen=True, eq=False)
class Scene:
    """Pressure at the points of a panel for a factor of contact and of suction, and what it is.

    label : its class. diameter_mm : of every round load, in the order of their centres. centres_mm
        : (loads, 2).
    beside : pressure of a body that moves by itself. pull : strongest suction over `suction`.
    """

    label: str
    contact: Pressure
    suction: Pressure
    diameters_mm: tuple[float, ...] = ()
    centres_mm: tuple[tuple[float, float], ...] = ()
    beside: Pressure = _none
    pull: float = 1.0


def film(rng: np.random.Generator, kind: str) -> Film:
    """`ideal`: as published; `real`: drawn; `other`: round patches, harsher.

    `real` has up to 20 % less and 15 % scatter.
    """
    if kind == "ideal":
        return Film(6.0, False, 1.0, 0.0, 0.2)
    if kind == "real":
        return Film(
            6.0, False, rng.uniform(0.8, 1.0), rng.uniform(0.05, 0.15), rng.uniform(0.1, 0.4)
        )
    return Film(
        rng.uniform(5.0, 7.0),
        bool(rng.random() < 0.6),
        rng.uniform(0.75, 1.1),
        rng.uniform(0.1, 0.2),
        0.4,
    )


def _edge(distance: Array, width: float) -> Array:
    """1 inside (distance < 0), 0 outside, falling over `width` mm."""
    return np.asarray(np.clip(0.5 - distance / max(width, 1e-9), 0.0, 1.0))


def _place(rng: np.random.Generator, panel: Panel, margin: float) -> tuple[float, float]:
    across, down = panel.centres_mm()
    pitch = panel.pitch_mm
    low = -pitch / 2 + margin
    high = pitch / 2 - margin
    x = rng.uniform(min(low, across[-1] / 2), max(across[-1] + high, across[-1] / 2))
    y = rng.uniform(min(low, down[-1] / 2), max(down[-1] + high, down[-1] / 2))
    return float(x), float(y)


def _turned(x: Array, y: Array, place: tuple[float, float], turn: float) -> tuple[Array, Array]:
    """Coordinates from a place, along a direction and across it."""
    u = x - place[0]
    v = y - place[1]
    return u * np.cos(turn) + v * np.sin(turn), v * np.cos(turn) - u * np.sin(turn)


def annulus(
    rng: np.random.Generator, place: tuple[float, float], outer: float, inner: float, **form: float
) -> Scene:
    """Return a rim that presses with `rim` kPa in the mean and sucks with `inside`.

    The rim is long, uneven and tilted, with soft edges.
    """
    long = form.get("long", 1.0)
    turn = rng.uniform(0, np.pi)
    wave = form.get("wave", 0.0)
    lobes = rng.integers(1, 4)
    phase = rng.uniform(0, 2 * np.pi)
    tilt = form.get("tilt", 0.0)
    lean = rng.uniform(0, 2 * np.pi)
    soft = form.get("soft", 0.0)

    def polar(x: Array, y: Array) -> tuple[Array, Array]:
        along, across = _turned(x, y, place, turn)
        a = along / np.sqrt(long)
        b = across * np.sqrt(long)
        return np.hypot(a, b), np.arctan2(b, a)

    def contact(x: Array, y: Array) -> Array:
        radius, angle = polar(x, y)
        rim = _edge(radius - outer / 2, soft) - (_edge(radius - inner / 2, soft) if inner else 0.0)
        leaning = 1 + tilt * 2 * radius / outer * np.cos(angle - lean)
        return np.asarray(
            form["rim"] * rim * np.maximum(leaning * (1 + wave * np.cos(lobes * angle + phase)), 0)
        )

    def suction(x: Array, y: Array) -> Array:
        return np.asarray(form.get("inside", 0.0) * _edge(polar(x, y)[0] - inner / 2, soft))

    return Scene("", contact, suction if inner else _none, (outer,), (place,))


def both(label: str, record: Scene, two: Scene) -> Scene:
    """Two loads at once."""
    return Scene(
        label,
        lambda x, y: record.contact(x, y) + two.contact(x, y),
        lambda x, y: record.suction(x, y) + two.suction(x, y),
        record.diameters_mm + two.diameters_mm,
        record.centres_mm + two.centres_mm,
    )


def mouth(
    rng: np.random.Generator,
    panel: Panel,
    uneven: bool = True,
    off: bool = False,
    pressed: bool = False,
    least: float = 24,
) -> Scene:
    """Return a lamprey's mouth of `least` to 45 mm.

    The rim bears the suction, or presses with 30 to 80 kPa more.
    """
    most = min(45.0, 0.7 * panel.pitch_mm * min(panel.shape))
    outer = rng.uniform(min(least, most), most)
    width = rng.uniform(4, 7)
    inner = outer - 2 * width
    inside = -float(np.exp(rng.uniform(np.log(4), np.log(20))))
    rim = -inside * inner**2 / (outer**2 - inner**2) + (rng.uniform(30, 80) if pressed else 0.0)
    form = {"rim": rim, "inside": inside, "soft": rng.uniform(0, 1.5)}
    if uneven:
        form |= {
            "long": rng.uniform(1, 1.25),
            "wave": rng.uniform(0.1, 0.35),
            "tilt": rng.uniform(0, 0.3),
        }
    return annulus(rng, _place(rng, panel, outer * (0.2 if off else 0.5)), outer, inner, **form)


def wavy_mouth(rng: np.random.Generator, panel: Panel) -> Scene:
    """Return a mouth whose rim is a closed curve of uneven load.

    The rim is long by up to 1.3, with waves of form and of load, a tilt and teeth. The outer edge
    is R (1 + Σ a_k cos(kθ − φ_k)) with k of 2 to 5, the load (1 + Σ b_k cos(kθ − ψ_k)) with k of 1
    to 6, and teeth press inside the rim. The diameter is that of a circle of the same area.
    """
    outer = rng.uniform(25, min(45.0, 0.7 * panel.pitch_mm * min(panel.shape)))
    width = rng.uniform(4, 7)
    inside = -float(np.exp(rng.uniform(np.log(2.5), np.log(20))))
    soft = rng.uniform(0.3, 2.0)
    form = rng.normal(0, 0.03, 4), rng.uniform(0, 2 * np.pi, 4)
    form[0][0] = 0.5 * np.log(rng.uniform(1.0, 1.3))
    load = rng.normal(0, 0.18, 6), rng.uniform(0, 2 * np.pi, 6)
    taper = rng.uniform(-0.4, 0.4)
    teeth = rng.uniform(0, 0.25)
    extra = rng.uniform(0, 15) * (rng.random() < 0.5)
    cx, cy = _place(rng, panel, outer / 2)
    inner = outer - 2 * width
    rim = -inside * inner**2 / (outer**2 - inner**2) + extra

    def sides(x: Array, y: Array) -> tuple[Array, Array, Array]:
        angle = np.arctan2(y - cy, x - cx)
        radius = np.hypot(x - cx, y - cy)
        curve = 1 + sum(
            a * np.cos(k * angle - b) for k, a, b in zip(range(2, 6), *form, strict=True)
        )
        return radius, outer / 2 * curve, angle

    def contact(x: Array, y: Array) -> Array:
        radius, edge, angle = sides(x, y)
        ring = _edge(radius - edge, soft) - _edge(radius - edge + width, soft)
        along = 1 + sum(
            a * np.cos(k * angle - b) for k, a, b in zip(range(1, 7), *load, strict=True)
        )
        across = 1 + taper * np.clip(2 * (edge - radius) / width - 1, -1, 1)
        spikes = (
            teeth
            * (np.cos(11 * angle) > 0.3)
            * (_edge(radius - edge + width, 0.5) - _edge(radius - edge + 2 * width, 0.5))
        )
        return np.asarray(rim * (ring * across * np.maximum(along, 0.1) + spikes))

    def suction(x: Array, y: Array) -> Array:
        radius, edge, _ = sides(x, y)
        return np.asarray(inside * _edge(radius - edge + width, soft))

    return Scene("wavy mouth", contact, suction, (outer,), ((cx, cy),))


def with_body(rng: np.random.Generator, made: Scene) -> Scene:
    """A load with a body of 60 to 140 mm behind it that lies on the panel.

    The body lies from the edge of the load on.
    """
    turn = rng.uniform(0, 2 * np.pi)
    begin = made.diameters_mm[0] / 2 + 2
    length = rng.uniform(60, 140)
    half = rng.uniform(7, 14)
    kpa = rng.uniform(0.5, 6)

    def body(x: Array, y: Array) -> Array:
        along, across = _turned(x, y, made.centres_mm[0], turn)
        behind = along - begin
        return np.asarray(
            kpa
            * np.maximum(1 - (across / half) ** 2, 0)
            * _edge(-behind, 3.0)
            * _edge(behind - length, 10.0)
        )

    return Scene(made.label, made.contact, made.suction, made.diameters_mm, made.centres_mm, body)


def cup(rng: np.random.Generator, panel: Panel) -> Scene:
    """A round suction cup of 25 to 45 mm at −8 to −20 kPa."""
    outer = rng.uniform(25, min(45, 0.7 * panel.pitch_mm * min(panel.shape)))
    width = rng.uniform(3.5, 5)
    inner = outer - 2 * width
    inside = -rng.uniform(8, 20)
    rim = -inside * inner**2 / (outer**2 - inner**2)
    form = {"rim": rim, "inside": inside, "tilt": rng.uniform(0, 0.1), "soft": rng.uniform(0, 1)}
    return annulus(rng, _place(rng, panel, outer / 2), outer, inner, **form)


def ring(rng: np.random.Generator, panel: Panel) -> Scene:
    """A weighted ring of 25 to 50 mm."""
    outer = rng.uniform(25, min(50, 0.7 * panel.pitch_mm * min(panel.shape)))
    width = rng.uniform(3.5, 7)
    form = {"rim": float(np.exp(rng.uniform(np.log(6), np.log(60)))), "tilt": rng.uniform(0, 0.2)}
    return annulus(
        rng, _place(rng, panel, outer / 2), outer, outer - 2 * width, soft=rng.uniform(0, 1), **form
    )


def rod(rng: np.random.Generator, panel: Panel, most: float = 50) -> Scene:
    """A standing rod of 15 to `most` mm."""
    outer = rng.uniform(15, min(most, 0.7 * panel.pitch_mm * min(panel.shape)))
    form = {"rim": float(np.exp(rng.uniform(np.log(2), np.log(40)))), "tilt": rng.uniform(0, 0.3)}
    return annulus(rng, _place(rng, panel, outer / 2), outer, 0.0, soft=rng.uniform(0, 1), **form)


def limpet(rng: np.random.Generator, panel: Panel) -> Scene:
    """A foot of 18 to 32 mm that sucks faintly within an edge that bears it."""
    outer = rng.uniform(18, 32)
    inner = outer - 8
    inside = -rng.uniform(0.5, 4)
    rim = -inside * inner**2 / (outer**2 - inner**2)
    place = _place(rng, panel, outer / 2)
    return annulus(rng, place, outer, inner, rim=rim, inside=inside, soft=1.0)


def blobs(
    rng: np.random.Generator,
    panel: Panel,
    count: int,
    size: tuple[float, float],
    kpa: tuple[float, float],
) -> Pressure:
    """Bumps of Gaussian profile and any direction: `size` mm wide, `kpa` high."""
    parts = [
        (
            _place(rng, panel, 0.0),
            *np.exp(rng.uniform(*np.log(size), 2)),
            rng.uniform(0, np.pi),
            np.exp(rng.uniform(*np.log(kpa))),
        )
        for _ in range(count)
    ]

    def pressure(x: Array, y: Array) -> Array:
        total = np.zeros_like(x)
        for place, a, b, turn, high in parts:
            u, v = _turned(x, y, place, turn)
            total += high * np.exp(-2 * ((u / a) ** 2 + (v / b) ** 2))
        return total

    return pressure


def hand(rng: np.random.Generator, panel: Panel) -> Scene:
    """A palm and up to five fingers about it, each a capsule."""
    cx, cy = _place(rng, panel, 25.0)
    turn = rng.uniform(0, 2 * np.pi)
    scale = rng.uniform(0.5, 1.0)
    fingers = [
        (turn + step, scale * rng.uniform(22, 30), scale * rng.uniform(50, 75), rng.uniform(3, 25))
        for step in np.linspace(-0.9, 0.9, rng.integers(2, 6))
    ]
    palm = rng.uniform(1, 12) * (rng.random() < 0.8)

    def pressure(x: Array, y: Array) -> Array:
        total = palm * _edge(np.hypot(x - cx, y - cy) - scale * 22, 6.0)
        for angle, near, far, kpa in fingers:
            along, across = _turned(x, y, (cx, cy), angle)
            beyond = np.maximum(np.maximum(near - along, along - far), 0)
            total = np.maximum(total, kpa * _edge(np.hypot(beyond, across) - scale * 8, 5.0))
        return total

    return Scene("hand", pressure, _none)


def fin(rng: np.random.Generator, panel: Panel) -> Scene:
    """A thin straight or bent line that presses."""
    place = _place(rng, panel, 10.0)
    turn = rng.uniform(0, np.pi)
    bend = rng.uniform(-0.012, 0.012)
    half = rng.uniform(15, 45)
    thick = rng.uniform(2, 8)
    kpa = np.exp(rng.uniform(np.log(2), np.log(30)))

    def pressure(x: Array, y: Array) -> Array:
        along, across = _turned(x, y, place, turn)
        aside = across - bend * along**2
        return np.asarray(
            kpa * _edge(np.abs(aside) - thick / 2, 2.0) * _edge(np.abs(along) - half, 4.0)
        )

    return Scene("fin", pressure, _none)


def fish(rng: np.random.Generator, panel: Panel) -> Scene:
    """A large soft body, pressing weakly, with a faint wake of suction beside it."""
    place = _place(rng, panel, 10.0)
    turn = rng.uniform(0, np.pi)
    a = rng.uniform(35, 70)
    b = rng.uniform(12, 25)
    kpa = rng.uniform(0.5, 8)
    wake = -rng.uniform(0, 0.4)

    def body(x: Array, y: Array, shift: float) -> Array:
        u, v = _turned(x, y, place, turn)
        return np.asarray(np.maximum(1 - (u / a) ** 2 - ((v - shift) / b) ** 2, 0))

    return Scene("fish", lambda x, y: kpa * body(x, y, 0.0), lambda x, y: wake * body(x, y, 2 * b))


def bubbles(rng: np.random.Generator, panel: Panel) -> Scene:
    """Small spots that press or pull faintly."""
    count = int(rng.integers(2, 12))
    press = blobs(rng, panel, count, (3, 10), (0.05, 1.0))
    pull = blobs(rng, panel, count, (3, 10), (0.05, 1.0))
    return Scene("bubbles", press, lambda x, y: -pull(x, y))


def apart(rng: np.random.Generator, panel: Panel, make: Callable[[], Scene], label: str) -> Scene:
    """Two of a kind that stand clear by 4 mm, drawn until they do.

    Raises ValueError where a panel has no room.
    """
    for _ in range(5000):
        record = make()
        two = make()
        clear = np.hypot(*np.subtract(record.centres_mm[0], two.centres_mm[0])) - 4
        if clear > (record.diameters_mm[0] + two.diameters_mm[0]) / 2:
            return both(label, record, two)
    raise ValueError(f"{label} do not find room on {panel.rows} x {panel.columns} cells")


MAKERS: dict[str, Callable[[np.random.Generator, Panel], Scene]] = {
    "nothing": lambda rng, panel: Scene("nothing", _none, _none),
    "mouth": lambda rng, panel: mouth(rng, panel, uneven=False),
    "uneven mouth": mouth,
    "pressed mouth": lambda rng, panel: mouth(rng, panel, pressed=True),
    "mouth partly off": lambda rng, panel: mouth(rng, panel, off=True),
    "two mouths": lambda rng, panel: apart(rng, panel, lambda: mouth(rng, panel), "two mouths"),
    "cup": cup,
    "ring": ring,
    "rod": rod,
    "two rods": lambda rng, panel: apart(rng, panel, lambda: rod(rng, panel, 35), "two rods"),
    "hand": hand,
    "rock": lambda rng, panel: Scene(
        "rock", blobs(rng, panel, int(rng.integers(1, 7)), (5, 30), (1, 60)), _none
    ),
    "fin": fin,
    "fish": fish,
    "bubbles": bubbles,
    "wavy mouth": wavy_mouth,
    "mouth and body": lambda rng, panel: with_body(rng, wavy_mouth(rng, panel)),
    "cup and body": lambda rng, panel: with_body(rng, cup(rng, panel)),
}
MOUTHS = tuple(kind for kind in MAKERS if "mouth" in kind)


def patch_means(
    pressures: Sequence[Pressure], panel: Panel, film_: Film, shift_mm: float = 0.0
) -> list[Array]:
    """Mean of each pressure over the patch of every cell, (rows, columns) kPa.

    shift_mm : distance along x by which the loads stand off.
    """
    offset = ((np.arange(GRID) + 0.5) / GRID - 0.5) * film_.patch_mm
    inside = np.hypot(*np.meshgrid(offset, offset)) < (
        film_.patch_mm / 2 if film_.round else np.inf
    )
    across, down = panel.centres_mm()
    x = (
        across[None, :, None, None]
        + np.broadcast_to(offset, (GRID, GRID))
        + np.zeros((panel.rows, 1, 1, 1))
    )
    y = (
        down[:, None, None, None]
        + np.broadcast_to(offset[:, None], (GRID, GRID))
        + np.zeros((1, panel.columns, 1, 1))
    )
    return [pressure(x - shift_mm, y)[..., inside].mean(axis=-1) for pressure in pressures]


def cells(
    rng: np.random.Generator, panel: Panel, scene: Scene, film_: Film, courses: Array
) -> Array:
    """(frames, rows, columns) ohm.

    courses (frames, 2): factors of contact and suction, zero where unloaded.
    """
    contact, suction = patch_means((scene.contact, scene.suction), panel, film_)
    resting = 3050 * np.exp(film_.spread * rng.standard_normal(panel.shape))
    answer = film_.bent * np.exp(film_.scatter * rng.standard_normal(panel.shape))
    pressure = courses[:, :1, None] * contact + courses[:, 1:, None] * suction
    return np.asarray(resting * np.exp(answer * np.log(ratio_from_pressure(pressure))))


def sampled(rng: np.random.Generator, codes: Array, wild_share: float = 1e-4) -> Array:
    """Means of 20 readings of codes with 0.7 LSB of noise, of which a share is wild."""
    codes = np.round(codes + 0.7 * rng.standard_normal((20, *codes.shape)))
    wild = rng.random(codes.shape) < wild_share
    return np.asarray(np.where(wild, rng.integers(0, 1024, codes.shape), codes).mean(axis=0))


def recorded(
    rng: np.random.Generator, resistance: Array, real: bool, time: Array
) -> tuple[Array, Array]:
    """Return two-point resistances without the 140 ohm in series, and their σ, in ohm.

    A divider of 1 kohm, 10 bits and 20 readings measures them.
    """
    rows, columns = resistance.shape[1:]
    drift = rng.standard_normal((rows, columns)) * (0.01 / 60 if real else 0.0)
    total = two_point_resistance(resistance * np.exp(drift * time[:, None, None])) + 140.0
    if real:
        channels = 3.0 * rng.standard_normal(rows + columns)
        total = total + channels[:rows, None] + channels[rows:]
    reference = 1000 * (1 + (rng.uniform(-0.01, 0.01) if real else 0.0))
    volt = 5 * reference / (total + reference)
    mean = sampled(rng, volt / 5 * 1023, 1e-4 if real else 0.0)
    measured = 1000 * (1023 - mean) / mean
    sigma = (measured + 1000) ** 2 / 1000 / 1023 * np.hypot(0.7, 12**-0.5) / np.sqrt(20)
    return measured - 140.0, sigma
