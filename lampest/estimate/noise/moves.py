"""What all cells seem to have done between the unloaded panel and a frame, and what errors of readings do to that."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lampest.cost.given import Background
from lampest.estimate.model_check.cells_fit import CellsFit, cells_alone, fitted
from lampest.panel.hidden import hidden_columns
from lampest.panel.panel import Array
from lampest.panel.scene import Scene, Systematic
from lampest.posterior.frame_noise import FrameNoise
from lampest.recording.readings import Readings

CLEARLY = 4.0  # σ of a change that noise does not make
CREEP = 3e-3  # of log r, by which films move on their own, as in the check of the circuit
TOGETHER = 0.05  # of log r, by which all cells may change with temperature


@dataclass(frozen=True, eq=False)
class Moves:
    """Of the cells of all frames asked: change (n), covariance (n, n) of its noise, a (n, k), and own (n, cells).

    reach : median standard deviation of log r of the unloaded cells under readings' own errors of 1.
    """

    change: Array
    noise: Array
    a: Array
    own: Array
    reach: float

    def covariance(self, size: float) -> Array:
        """Of changes of still cells, if each reading errs by so much on its own."""
        return np.asarray(self.noise + self.a @ self.a.T + size**2 * self.own @ self.own.T)

    def with_column(self, column: Array) -> "Moves":
        """With one more error that the frames do not share with the baseline, (n, 1), behind the others."""
        return replace(self, a=np.hstack([self.a, column]))


def moves_of(
    scene: Scene, sizes: Systematic, resting: Readings, frames: Readings, noise: FrameNoise | None
) -> Moves | None:
    """The changes of all cells between the unloaded panel and the frames; None where a fit fails."""
    base = asked(scene, resting, None, sizes, noise, resting=True)
    if base is None:
        return None
    fits = [asked(scene, frame, base.fit.cells, sizes, noise, resting=False) for frame in each(frames)]
    others = [one for one in fits if one is not None]
    if len(others) < len(fits):
        return None
    return moves_between(base, others)


def moves_between(base: "Asked", others: "Sequence[Asked]") -> Moves:
    """The changes of all cells from the unloaded panel to the frames."""
    cells = base.fit.cells.size
    change = np.concatenate([np.log(one.fit.cells / base.fit.cells).ravel() for one in others])
    covariance = np.tile(base.error, (len(others), len(others)))
    for number, one in enumerate(others):
        part = slice(number * cells, (number + 1) * cells)
        covariance[part, part] += one.error + CREEP**2 * np.eye(cells) + TOGETHER**2
    told = np.vstack([one.told - base.told for one in others])
    return Moves(
        change,
        covariance + told @ told.T,
        np.vstack([one.hidden - base.hidden for one in others]),
        np.vstack([one.own - base.own for one in others]),
        float(np.median(np.linalg.norm(base.own, axis=1))),
    )


@dataclass(frozen=True, eq=False)
class Asked:
    """One frame's fit, gain (cells, readings), covariance of its error, and what shared errors do to its log cells."""

    fit: CellsFit
    gain: Array
    error: Array
    hidden: Array
    own: Array
    told: Array

    def answer(self, columns: Array) -> Array:
        """(cells, n): what errors of the readings (n, rows, columns) do to log cells."""
        return np.asarray(self.gain @ columns.reshape(len(columns), self.gain.shape[1]).T)


def asked(
    scene: Scene, readings: Readings, near: Array | None, sizes: Systematic, noise: FrameNoise | None, resting: bool
) -> Asked | None:
    """One frame; None where it is not fitted. near : cells to begin at. resting : whether it is the unloaded mean."""
    fit = fitted(scene, readings, near, patient=near is None) or fitted(scene, readings, patient=True)
    if fit is None or fit.sensitivity is None:
        return None
    assert readings.sigma is not None
    error = np.linalg.inv(fit.information)
    at = fit if near is None else steadied(scene, fit, near, error)
    assert at.sensitivity is not None
    gain = np.linalg.solve(at.information, at.sensitivity.T / readings.sigma.ravel())
    if noise is not None:
        drawn = gain @ noise.columns(at.readings.value[None], resting)
        error = error + drawn @ drawn.T
    here = at.cells, at.readings.value
    channels = (sizes.reference_tolerance / np.sqrt(3), sizes.channel_spread_ohm)
    nothing = np.zeros((len(error), 0))
    blank = Asked(fit, gain, error, nothing, nothing, nothing)
    return replace(
        blank,
        hidden=blank.answer(hidden_columns(*here, scene, replace(sizes, reading_error=None))),
        own=blank.answer(hidden_columns(*here, scene, Systematic(reading_error=1.0))),
        told=blank.answer(scene.circuit.shared_errors(*here, scene, *channels)),
    )


def steadied(scene: Scene, fit: CellsFit, near: Array, error: Array) -> CellsFit:
    """The fit with cells that did not clearly move where they were, and the readings that these would give.

    What errors do to a cell's change is a small difference of two large numbers; noise of the cells at which they are
    taken would hide most of it (regression dilution). error : covariance of log r.
    """
    change = np.log(fit.cells / near)
    middle = np.median(change)
    moved = np.abs(change - middle) > CLEARLY * np.sqrt(2 * np.diag(error)).reshape(change.shape)
    data = cells_alone().data(fit.readings.alone(), Background(scene))
    network = data.network(0, np.where(moved, fit.cells, near * np.exp(middle)))
    return CellsFit.at(data, replace(fit.readings, value=network.reading()), network)


def each(frames: Readings) -> list[Readings]:
    """One after the other, (rows, columns) each."""
    return [frames[number] for number in range(len(frames.value))]
