"""Inputs of a solve other than its unknowns, by name.

The inputs of a solve are arrays; those of a cost and of a term's `State` are symbols. A further
input for new terms is one more field of `Given`, with its source and its value if absent.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields
from functools import cache
from typing import Any, Protocol, Self

import casadi
import numpy as np

from lampest.files.typed import ReadOnlyArrays
from lampest.panel.panel import Array
from lampest.panel.scene import Scene


class FrameReadings(Protocol):
    """Interface of the readings of a solve, all arrays (frames, rows, columns).

    `Given` describes each.
    """

    @property
    def value(self) -> Array:
        """Readings of the network, in the readout's unit."""

    @property
    def sigma(self) -> Array | None:
        """Standard deviations; None if unknown."""

    @property
    def side(self) -> Array:
        """0 for a value; 1 or -1 if the truth is at least or at most the reading."""

    @property
    def seen(self) -> Array:
        """1, 0 for a missing reading, and the weight of its substitute in between."""

    @property
    def partial(self) -> bool:
        """Whether any reading is one-sided or missing."""


@dataclass(frozen=True, eq=False)
class Background:
    """Context of a frame: the scene, and earlier frames.

    Attributes
    ----------
    scene : Scene
    previous, previous_deviation : array, shape (rows, columns), or None
        Last estimate in ohm, and the standard deviation of its logarithm.
    baseline : array, shape (rows, columns), or None
        Cells of the unloaded panel in ohm.
    """

    scene: Scene
    previous: Array | None = None
    previous_deviation: Array | None = None
    baseline: Array | None = None


@dataclass(frozen=True)
class Source:
    """Origin of a field of `Given`.

    Attributes
    ----------
    of : callable
        Function (readings, background) → value, or None.
    absent : float
        Number that replaces an absent value in the arrays of a compiled cost.
    per_frame : bool
        Whether the shape is (frames, rows, columns) rather than (rows, columns).
    partial : bool
        Whether the field exists only if readings may be one-sided or missing.
    after : callable, or None
        For fields of an earlier frame: function of the baseline's unknown cells (cells, 1) that
        returns the value for a frame that is solved together with the baseline.
    """

    of: Callable[[FrameReadings, Background], Array | None]
    absent: float
    per_frame: bool = False
    partial: bool = False
    after: Callable[[casadi.SX], casadi.SX] | None = None


def input_field(
    of: Callable[[FrameReadings, Background], Array | None], absent: float, **more: Any
) -> Any:
    """Declare a field of `Given` with the default None; the arguments are those of `Source`."""
    return field(default=None, metadata={"source": Source(of, absent, **more)})


@dataclass(frozen=True, eq=False, kw_only=True)
class Given(ReadOnlyArrays):
    """Inputs of a solve other than its unknowns.

    A field is an array in the data of a solve, a symbol in a compiled cost, a column (cells, 1) in
    a term's `State`, and None if it is not known.

    Attributes
    ----------
    measured, sigma
        Readings of the network in the readout's unit, and their standard deviations; ones if
        unknown.
    side
        0 for a value; 1 or -1 where the truth is at least or at most the reading. None if all
        readings are values.
    seen
        1; 0 for a missing reading, and the weight of its substitute in between. None if all
        readings are values.
    previous
        r0, the cell resistance of the previous frame or of the baseline, in ohm.
    baseline
        Cell resistance of the unloaded panel in ohm.
    previous_deviation
        Standard deviation of log r0; 0 if r0 is an unknown of the same solve.
    """

    measured: Any = input_field(lambda readings, background: readings.value, 1.0, per_frame=True)
    # The noise, ones where it is not known
    sigma: Any = input_field(
        lambda readings, background: (
            np.ones_like(readings.value) if readings.sigma is None else readings.sigma
        ),
        1.0,
        per_frame=True,
    )
    side: Any = input_field(
        lambda readings, background: readings.side, 0.0, per_frame=True, partial=True
    )
    seen: Any = input_field(
        lambda readings, background: readings.seen, 1.0, per_frame=True, partial=True
    )
    previous: Any = input_field(
        lambda readings, background: background.previous, 1.0, after=lambda r: r
    )
    # Before the baseline is known, the previous frame
    baseline: Any = input_field(
        lambda readings, background: (
            background.previous if background.baseline is None else background.baseline
        ),
        1.0,
        after=lambda r: r,
    )
    previous_deviation: Any = input_field(
        lambda readings, background: background.previous_deviation, 0.0, after=lambda r: 0 * r
    )

    @staticmethod
    @cache
    def sources() -> dict[str, Source]:
        """Return the sources by name, in the order of the fields."""
        return {part.name: part.metadata["source"] for part in fields(Given)}

    @classmethod
    def of(cls, readings: FrameReadings, background: Background) -> Self:
        """Return the arrays of a solve from its readings and background."""
        return cls(
            **{
                name: source.of(readings, background)
                for name, source in cls.sources().items()
                if readings.partial or not source.partial
            }
        )

    @classmethod
    def symbols(cls, cells: int, frames: int, *, partial: bool) -> Self:
        """Make symbols (cells, frames) of fields of every frame, and (cells, 1) of all others."""
        return cls(
            **{
                name: casadi.SX.sym(name, cells, frames if source.per_frame else 1)
                for name, source in cls.sources().items()
                if partial or not source.partial
            }
        )

    def of_frame(
        self, frame: int, baseline: casadi.SX | None, *, looks_back: bool
    ) -> dict[str, Any]:
        """Return the inputs of a term in one frame, by name.

        Parameters
        ----------
        frame : int
            Number of the frame.
        baseline : casadi.SX or None
            Cells of a baseline that is solved together with the frame.
        looks_back : bool
            Whether earlier frames are given.
        """
        parts = {}
        for name, source in self.sources().items():
            value = getattr(self, name)
            if source.after is not None and baseline is not None:
                value = source.after(baseline)
            elif source.after is not None and not looks_back:
                value = None
            elif source.per_frame and value is not None:
                value = value[:, frame]
            parts[name] = value
        return parts

    def named(self) -> Iterator[tuple[str, Any]]:
        """Yield (name, value) of every field that is known."""
        for name in self.sources():
            value = getattr(self, name)
            if value is not None:
                yield name, value
