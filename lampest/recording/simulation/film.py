"""What a film makes of pressures over time: it feels what happens between frames, too."""

from collections.abc import Callable

import numpy as np

from lampest.loads.film import FilmMemory
from lampest.loads.response import PUBLISHED
from lampest.panel.film import MOST_CREEP, MOST_HYSTERESIS, Film
from lampest.panel.panel import Array
from lampest.panel.response import Response
from lampest.recording.simulation.unmodelled import random_stream

# Moments within a frame's period at which a film that remembers feels the load, and frames that are looked at together.
MOMENTS, AT_ONCE = 8, 64


def remembered_ratio(
    film: Film,
    seed: int,
    pressure: Callable[[Array], Array],
    water: Array,
    time: Array,
    period: float,
    response: Response = PUBLISHED,
) -> Array:
    """r over that of a flat, unloaded film in air, (frames, rows, columns).

    pressure : moments (n) s → (n, rows, columns) kPa of load and water. water : (rows, columns) kPa, since ever. time :
    (frames) s, `period` apart.
    """
    memory = true_memory(film, seed, water, response)
    rest = memory.gain * response.logarithm(water)
    step, parts = period / MOMENTS, []
    for first in range(0, len(time), AT_ONCE):
        frames = time[first : first + AT_ONCE]
        moments = (frames[:, None] - step * np.arange(MOMENTS)[::-1]).ravel()
        for number, loaded in enumerate(pressure(moments) - water):
            memory, change = memory.answered(loaded, step)
            if number % MOMENTS == MOMENTS - 1:
                parts.append(np.exp(rest + change))
    return np.stack(parts)


def true_memory(film: Film, seed: int, water: Array, response: Response = PUBLISHED) -> FilmMemory:
    """A film at rest, drawn as is known of it: all cells together by its deviation, each by its spread."""
    strengths = []
    for name, value, most in (
        ("hysteresis", film.hysteresis, MOST_HYSTERESIS),
        ("creep", film.creep_per_decade, MOST_CREEP),
    ):
        assert value != "auto"
        stream = random_stream(seed, f"film {name}")
        shared, own = stream.standard_normal(), stream.standard_normal(water.shape)
        strengths.append(np.minimum(value * np.exp(film.deviation * shared + film.cell_spread * own), most))
    hysteresis, creep = strengths
    gain = np.broadcast_to(film.answer * response.gains, water.shape)
    return FilmMemory.at_rest(hysteresis, creep, gain, water, response)
