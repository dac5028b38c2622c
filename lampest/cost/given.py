"""What a solve is given beside its unknowns, by name: arrays in data, symbols in costs and in a term's `State`.

Whatever a new term must know is one more field here: where it comes from, and what stands for it where there is none.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from functools import cache, cached_property
from typing import Any, Protocol, Self

import casadi
import numpy as np

from lampest.panel.panel import Array
from lampest.panel.scene import Scene


class FrameReadings(Protocol):
    """The readings that a solve is given, all (frames, rows, columns); see `Given` for what they are.

    partial : whether any is not a plain value.
    """

    @property
    def value(self) -> Array: ...

    @property
    def sigma(self) -> Array | None: ...

    @property
    def side(self) -> Array: ...

    @property
    def seen(self) -> Array: ...

    @property
    def partial(self) -> bool: ...


@dataclass(frozen=True, eq=False)
class Background:
    """What stands behind a frame: the scene, and what is known from earlier frames.

    period : s between frames; infinite where there is one only. previous, previous_deviation : (rows, columns) the last
    estimate in ohm and the standard deviation of its logarithm. baseline : (rows, columns) ohm. None: not known.
    """

    scene: Scene
    period: float = float("inf")
    previous: Array | None = None
    previous_deviation: Array | None = None
    baseline: Array | None = None


@dataclass(frozen=True)
class Source:
    """Where a field of `Given` comes from.

    of : its value from the readings and the background, or None. absent : the number that stands in the arrays of a
    compiled cost where there is none. per_frame : (frames, rows, columns) rather than (rows, columns). partial : only
    there where readings may be bounds or missing. after : of a field of an earlier frame: what it is for a frame that
    is solved together with the baseline, from the baseline's unknown cells (cells, 1).
    """

    of: Callable[[FrameReadings, Background], Array | None]
    absent: float
    per_frame: bool = False
    partial: bool = False
    after: Callable[[casadi.SX], casadi.SX] | None = None


def given(source: Source) -> Any:
    """A field of `Given`, None unless it is set."""
    return field(default=None, metadata={"source": source})


@dataclass(frozen=True, eq=False, kw_only=True)
class Given:
    """Arrays in a solve's data, symbols in a compiled cost, columns (cells, 1) in a term's `State`; None: not known.

    measured, sigma : the network's readings, in the readout's unit, and their standard deviation, ones if unknown.
    side, seen : of each reading: 0 a value, 1 or -1 where the truth is at least or at most this; 1, or 0 where it is
    missing, between them the weight of what stands in for it. None where all readings are values.
    previous : r0, the previous frame's (or the baseline's) cell resistance, ohm. baseline : the unloaded panel's, ohm.
    previous_deviation : standard deviation of log r0; 0 where r0 is an unknown of the same solve.
    """

    measured: Any = given(Source(lambda readings, behind: readings.value, 1.0, per_frame=True))
    sigma: Any = given(Source(lambda readings, behind: _noise(readings), 1.0, per_frame=True))
    side: Any = given(Source(lambda readings, behind: _mark(readings, readings.side), 0.0, True, partial=True))
    seen: Any = given(Source(lambda readings, behind: _mark(readings, readings.seen), 1.0, True, partial=True))
    previous: Any = given(Source(lambda readings, behind: behind.previous, 1.0, after=lambda cells: cells))
    baseline: Any = given(Source(lambda readings, behind: _baseline(behind), 1.0, after=lambda cells: cells))
    previous_deviation: Any = given(
        Source(lambda readings, behind: behind.previous_deviation, 0.0, after=lambda cells: 0 * cells)
    )

    @staticmethod
    @cache
    def sources() -> dict[str, Source]:
        """name → source, in the order of the fields."""
        return {part.name: part.metadata["source"] for part in fields(Given)}

    @classmethod
    def of(cls, readings: FrameReadings, background: Background) -> Self:
        """The arrays of a solve."""
        return cls(**{name: source.of(readings, background) for name, source in cls.sources().items()})

    @classmethod
    def symbols(cls, cells: int, frames: int, partial: bool) -> Self:
        """Symbols (cells, frames) of what every frame has, (cells, 1) of all else."""
        names = {name: source for name, source in cls.sources().items() if partial or not source.partial}
        return cls(
            **{name: casadi.SX.sym(name, cells, frames if source.per_frame else 1) for name, source in names.items()}
        )

    def of_frame(self, frame: int, baseline: casadi.SX | None, looks_back: bool) -> dict[str, Any]:
        """Symbols by name as a term sees them in one frame.

        baseline : the cells of a baseline that is solved together with it, or None. looks_back : whether earlier frames
        are given.
        """
        parts = {}
        for name, source in self.sources().items():
            value = getattr(self, name)
            if source.after is not None:
                value = (value if looks_back else None) if baseline is None else source.after(baseline)
            elif source.per_frame and value is not None:
                value = value[:, frame]
            parts[name] = value
        return parts

    @cached_property
    def flat(self) -> dict[str, Array]:
        """Flat arrays by name, with the number that stands for what is not known."""
        found = {}
        for name, source in self.sources().items():
            value = getattr(self, name)
            if value is not None or not source.partial:
                found[name] = np.full(self.measured[0].size, source.absent) if value is None else value.ravel()
        return found

    def named(self) -> Iterable[tuple[str, Any]]:
        """(name, value) of all that is there."""
        return ((name, value) for name in self.sources() if (value := getattr(self, name)) is not None)


def _noise(readings: FrameReadings) -> Array:
    return np.ones_like(readings.value) if readings.sigma is None else readings.sigma


def _mark(readings: FrameReadings, mark: Array) -> Array | None:
    return mark if readings.partial else None


def _baseline(background: Background) -> Array | None:
    """The baseline's cells; before one is known apart, the previous frame stands for it."""
    return background.previous if background.baseline is None else background.baseline
