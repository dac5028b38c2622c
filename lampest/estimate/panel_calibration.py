"""Channels, series resistance and reference from ordinary recordings: errors that all frames share, under many loads.

Under a wrong circuit cells that nobody touches seem to move when others do. The smoother's cost has these errors as
unknowns z; every block of frames gives their likelihood, cells integrated out by the Schur complement, and all blocks
together their posterior N(ẑ, C), C⁻¹ = I + b Σ Λ, ẑ = b C Σ (Λ + I) z, with b the share of it that is believed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lampest.cost.losses import Student
from lampest.cost.terms import Misfit
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods.joint import BELIEVED
from lampest.estimate.methods.smoother import SmootherMethod
from lampest.estimate.nuisances import CHANNEL_OHM
from lampest.estimate.prepared import Prepared
from lampest.estimate.sequence import first_stream
from lampest.files.document import to_yaml
from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.panel.readouts.driven import DrivenReadout
from lampest.panel.scene import Scene, SeriesPerLine, Systematic
from lampest.panel.systematic import USUAL, usual
from lampest.posterior.dense import positive_inverse
from lampest.recording.recording import Recording
from lampest.solvers.multistart import BROKEN

BLOCK = 50  # frames that are solved together; ten blocks cost as much as one of all
DIGITS = 3  # of an ohm
UNCHANGED = 0.9  # of a channel's standard deviation
HARDLY = "these loads determine hardly any channel"


@dataclass(frozen=True, eq=False)
class PanelCalibration:
    """What recordings say of the electronics. scene : theirs, with the sizes of errors that were assumed.

    errors : of the reference as a fraction, then of each line's channel, ohm, rows first. covariance, before : theirs,
    and what it was without the recordings. frames : that took part.
    """

    scene: Scene
    errors: Array
    covariance: Array
    before: Array
    frames: int

    @property
    def deviation(self) -> Array:
        """Standard deviations of the errors."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def apart(self) -> Array:
        """Of every line against the mean of its side, after and before the recordings: rms deviations, ohm."""
        rows, columns = self.scene.panel.shape
        centred = np.eye(rows + columns)
        centred[:rows, :rows] -= 1 / rows
        centred[rows:, rows:] -= 1 / columns
        both = np.stack([self.covariance[1:, 1:], self.before[1:, 1:]])
        return np.asarray(np.sqrt(np.trace(centred @ both @ centred, axis1=1, axis2=2) / (rows + columns - 2)))

    @property
    def sizes(self) -> Systematic:
        """What is left open: of channels apart, and of what all readings have in common."""
        (rows, columns), apart = self.scene.panel.shape, float(self.apart[0])
        mean = np.repeat([1 / rows, 1 / columns], [rows, columns])
        together = float(mean @ self.covariance[1:, 1:] @ mean) - apart**2 * (1 / rows + 1 / columns)
        series = round(float(np.sqrt(max(together, 0.0))), DIGITS)
        tolerance = round(float(np.sqrt(3) * self.deviation[0]), DIGITS + 2)
        known = self.scene.specified_systematic or Systematic()
        apart = round(apart, DIGITS)
        return replace(known, channel_spread_ohm=apart, reference_tolerance=tolerance, series_ohm=series or None)

    @property
    def calibrated(self) -> Scene:
        """The scene with these numbers, and with what is left open of them as its systematic errors."""
        scene = replace(self.scene, systematic=self.sizes)
        readout: Any = scene.circuit.off_by(float(self.errors[0]))
        more = np.split(self.errors[1:], [scene.panel.rows])
        if isinstance(readout, DrivenReadout):
            driven: Any = readout.with_channels(*more)
            return replace(scene, readout=driven)
        known = scene.series_resistance_ohm
        both = (known.rows, known.columns) if isinstance(known, SeriesPerLine) else (known / 2, known / 2)
        lines = (np.round(np.maximum(np.add(one, off), 0.0), DIGITS) for one, off in zip(both, more, strict=True))
        series = SeriesPerLine(*(tuple(float(ohm) for ohm in line) for line in lines))
        return replace(
            scene,
            readout=replace(readout, reference_ohm=round(readout.reference_ohm, DIGITS)),
            series_resistance_ohm=series,
        )

    @property
    def warning(self) -> str:
        """That the loads have determined no channel, or ''."""
        after, before = self.apart
        return "" if after < UNCHANGED * before else f"{HARDLY}; press the panel at more places, or record longer"

    def summary(self) -> str:
        """'reference +0.2 +- 0.5 %, channels off by 2.8 ohm rms, known to 1.2 ohm, from 400 frames'."""
        off = float(np.sqrt(np.mean(self.errors[1:] ** 2)))
        return (
            f"reference {100 * self.errors[0]:+.2f} +- {100 * self.deviation[0]:.2f} %, channels off by {off:.2f} ohm "
            f"rms and known to {self.apart[0]:.2f} ohm beside their mean, from {self.frames} frames"
        )

    def text(self) -> str:
        """The calibrated scene as YAML, with every number's standard deviation as a comment."""
        remarks = [f"from {self.frames} frames; +- is one standard deviation", self.summary()]
        parts = np.split(np.arange(1, len(self.errors)), [self.scene.panel.rows])
        for side, lines in zip(("rows", "columns"), parts, strict=True):
            each = ", ".join(f"{self.errors[line]:+.2f} +- {self.deviation[line]:.2f}" for line in lines)
            remarks.append(f"{side} are off by {each} ohm")
        return "".join(f"# {remark}\n" for remark in remarks) + to_yaml(self.calibrated)


def calibrate_from_recordings(recordings: Sequence[Recording]) -> PanelCalibration:
    """The electronics' errors that explain the cells that nobody touches, in recordings of one circuit.

    Raises InputError without a readout, for panels of modules, where scenes differ, or where no frame can be estimated.
    """
    first = recordings[0]
    for other in recordings[1:]:
        if _circuit(other.scene) != _circuit(first.scene):
            raise InputError(f"{other.name}: its scene is another than that of {first.name}")
    if first.scene.readout is None:
        raise InputError(f"{first.name}: its scene names no readout, whose numbers a calibration could find")
    if first.scene.panel.modules is not None:
        raise InputError(f"{first.name}: calibrate a panel of modules by recordings of each")
    scene = _assuming(first.scene)
    estimator = Estimator((Misfit(weighting="noise", loss=Student(corner=4.0)),), SmootherMethod(), error_bars=False)
    found, frames = list[tuple[Array, Array]](), 0
    for recording in recordings:
        parts, used = _likelihoods(replace(recording, scene=scene), estimator)
        found, frames = found + parts, frames + used
    if not found:
        raise InputError(f"{first.name}: no calibration: no frame could be estimated")
    unit = np.eye(len(found[0][0]))
    covariance = positive_inverse(unit + BELIEVED * sum(learned for _, learned in found))
    errors = BELIEVED * covariance @ sum((learned + unit) @ z for z, learned in found)
    into = _in_units(scene, len(unit))
    return PanelCalibration(scene, into @ errors, into @ covariance @ into.T, into @ into.T, frames)


def _circuit(scene: Scene) -> Scene:
    """The scene without what touched the panel, and how the film answers."""
    return replace(scene, subject=None, experiment=None, water=None, temperature=None, film=None, response=None)


def _assuming(scene: Scene) -> Scene:
    """The scene with the sizes of all errors, those of channels included."""
    sizes = usual(scene) or replace(USUAL, series_ohm=None, inl_lsb=None, wire_ohm_per_cell=None)
    spread = sizes.channel_spread_ohm or CHANNEL_OHM
    return replace(scene, systematic=replace(sizes, channel_spread_ohm=spread, reading_error=None))


def _likelihoods(recording: Recording, estimator: Estimator) -> tuple[list[tuple[Array, Array]], int]:
    """(z, Λ) of every block of frames that can be estimated, and how many frames these are."""
    noise, found, used = Prepared(recording).noise, [], 0
    stream = first_stream(recording, noise.readings, estimator, noise)
    enough = np.flatnonzero(noise.readings.enough(recording.scene))
    for block in np.array_split(enough, max(round(len(enough) / BLOCK), 1)):
        if len(block) < 2:
            continue
        try:
            found.append(SmootherMethod().least_cost(stream, [noise.readings[frame] for frame in block]).shared)
            used += len(block)
        except BROKEN:
            continue
    return found, used


def _in_units(scene: Scene, count: int) -> Array:
    """(1 + lines, count): what z of all errors are of the reference, a fraction, and of lines, ohm."""
    sizes, (rows, columns) = scene.specified_systematic or Systematic(), scene.panel.shape
    contacts, into = 0 if scene.contacts is None else rows + columns, np.zeros((1 + rows + columns, count))
    into[0, contacts] = sizes.reference_tolerance / np.sqrt(3)
    lines = slice(contacts + 1, contacts + 1 + rows + columns)
    into[1:, lines] = sizes.channel_spread_ohm * np.eye(rows + columns)
    if sizes.series_ohm:
        driven = slice(1, 1 + rows) if scene.circuit.noisy_side == "rows" else slice(1 + rows, None)
        into[driven, lines.stop] = sizes.series_ohm
    return into
