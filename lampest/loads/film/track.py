"""Pressures of frames as they come, on a film that remembers: what it remembers is carried on from frame to frame."""

from dataclasses import dataclass, replace

import numpy as np

from lampest.loads.film.known import SOONEST, FilmKnown
from lampest.loads.film.memory import FilmMemory
from lampest.panel.panel import Array
from lampest.panel.response import Response


@dataclass(frozen=True, eq=False)
class FilmTrack:
    """Where a film stands after a frame.

    Parameters
    ----------
    films : the mean film, then one with each of its strengths by a standard deviation more; (rows, columns) each.
    zeros : (films, rows, columns) ln(r/r_rest) that counts as none beside the memory: a tare.
    time : s, of the last frame that was seen; None before the first.
    """

    films: tuple[FilmMemory, ...]
    zeros: Array
    time: float | None = None

    @classmethod
    def begin(cls, known: FilmKnown, water: Array, response: Response | None = None) -> "FilmTrack":
        """At rest in water, (rows, columns) kPa; response : the scene's own."""
        films = known.memories(water, response)
        return cls(films, np.zeros((len(films), *water.shape)))

    def seconds(self, time: float) -> float:
        """Since the last frame; a second before the first."""
        return 1.0 if self.time is None else max(time - self.time, SOONEST)

    def fading(self, time: float) -> Array:
        """ln(r/r_rest) (rows, columns) of a panel that nothing has touched since the last frame, its zero included."""
        return np.asarray(self.films[0].fading(self.seconds(time)) + self.zeros[0])

    def memory(self, time: float) -> Array:
        """The same without the zero: what is remembered of loads."""
        return self.films[0].fading(self.seconds(time))

    def told(self, change: Array, time: float) -> "FilmTrack":
        """After a frame with ln(r/r_rest) = `change` (rows, columns); where that is NaN, the film stands still."""
        if not np.isfinite(change).any():
            return self
        seconds = self.seconds(time)
        films = tuple(film.told(change - zero, seconds) for film, zero in zip(self.films, self.zeros, strict=True))
        return replace(self, films=films, time=time)

    def tared(self, change: Array, time: float) -> "FilmTrack":
        """As if nothing pressed in a frame with this ln(r/r_rest): what the memory does not explain is the new zero."""
        seconds = self.seconds(time)
        fading = np.stack([film.fading(seconds) for film in self.films])
        return replace(self, zeros=np.where(np.isfinite(change), change - fading, self.zeros))

    def pressures(self, change: Array, time: float) -> Array:
        """(films, rows, columns) kPa that ln(r/r_rest) = `change` tells each film, (…, rows, columns)."""
        seconds = self.seconds(time)
        return np.stack(
            [film.pressure(change - zero, seconds) for film, zero in zip(self.films, self.zeros, strict=True)]
        )

    def at_once(self, change: Array, time: float) -> Array:
        """−ln(r/r_rest) without the memory, (rows, columns), of the mean film."""
        return self.films[0].at_once(change - self.zeros[0], self.seconds(time))
