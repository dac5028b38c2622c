"""Calibration of channels, series resistance and reference from ordinary recordings under many loads.

Under a wrong circuit, untouched cells seem to move when others do. The smoother's cost has the errors z that all frames
share as unknowns. Every block of frames gives an estimate z with the precision Λ of its likelihood, where the cells are
integrated out by the Schur complement. All blocks together give the posterior N(ẑ, C),

    C⁻¹ = I + b Σ Λ,   ẑ = b C Σ (Λ + I) z,

where b = BELIEVED is the share of the information that is used.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from lampest.cost.losses import Student
from lampest.cost.terms import Misfit
from lampest.estimate.assumptions import ASSUMED
from lampest.estimate.calibration import DIGITS, FRACTION_DIGITS, Calibration, common_scene
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods.joint import BELIEVED
from lampest.estimate.methods.smoother import SmootherMethod
from lampest.estimate.prepared import Prepared
from lampest.estimate.sequence import first_stream
from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.panel.readouts.driven import DrivenReadout
from lampest.panel.scene import Scene, SeriesPerLine, Systematic
from lampest.panel.systematic import USUAL, systematic_of
from lampest.posterior.covariance import positive_inverse
from lampest.recording.recording import Recording
from lampest.solvers.multistart import BROKEN

BLOCK = 50  # frames that are solved together; ten blocks take as long as one of all their frames
UNCHANGED = 0.9  # ratio of the deviations after and before: above it the recordings determine hardly any channel
HARDLY = "these loads determine hardly any channel; press the panel at more places, or record longer"


@dataclass(frozen=True, eq=False, kw_only=True)
class ChannelCalibration(Calibration):
    """Channels and reference with their posterior.

    Attributes
    ----------
    errors : array, shape (1 + lines,)
        Relative error of the reference, then the error of each line's channel, ohm, rows first.
    covariance : array, shape (1 + lines, 1 + lines)
        Posterior covariance of the errors.
    apart, apart_before : float
        rms standard deviation of a channel against the mean of its side, posterior and prior, ohm.
    frames : int
        Number of frames that were used.
    """

    errors: Array
    covariance: Array
    apart: float
    apart_before: float
    frames: int


def calibrate_channels(recordings: Sequence[Recording]) -> ChannelCalibration:
    """Estimate the electronics' errors that explain the cells that nobody touches, in recordings of one circuit.

    Raises InputError without a readout, for panels of modules, where scenes differ, or where no frame can be estimated.
    """
    common_scene(recordings, _circuit)
    first = recordings[0]
    if first.scene.readout is None:
        raise InputError(f"{first.name}: its scene names no readout, whose numbers a calibration could find")
    if first.scene.panel.modules is not None:
        raise InputError(f"{first.name}: calibrate a panel of modules by recordings of each")
    scene = _with_all_errors(first.scene)
    parts = [part for recording in recordings for part in _likelihoods(replace(recording, scene=scene))]
    if not parts:
        raise InputError(f"{first.name}: no calibration: no frame could be estimated")
    unit = np.eye(len(parts[0][0]))
    inverse = positive_inverse(unit + BELIEVED * sum(learned for _, learned, _ in parts))
    units = _in_units(scene, len(unit))
    errors = units @ (BELIEVED * inverse @ sum((learned + unit) @ z for z, learned, _ in parts))
    return _calibration(scene, errors, units @ inverse @ units.T, units @ units.T, sum(count for *_, count in parts))


def _calibration(scene: Scene, errors: Array, covariance: Array, before: Array, frames: int) -> ChannelCalibration:
    """Return the scene corrected for these errors, with their posterior uncertainty as its systematic errors.

    Parameters
    ----------
    scene : Scene
    errors : array, shape (1 + lines,)
    covariance, before : array, shape (1 + lines, 1 + lines)
        Posterior and prior covariance.
    frames : int
    """
    deviation, (rows, columns) = np.sqrt(np.diag(covariance)), scene.panel.shape
    mean = np.repeat([1 / rows, 1 / columns], [rows, columns])
    centred = block_diag(*(np.eye(lines) - 1 / lines for lines in (rows, columns)))
    # √(tr H P H/(lines − 2)), where H subtracts the mean of each side
    apart, apart_before = (
        float(np.sqrt(np.trace(centred @ part[1:, 1:] @ centred) / (rows + columns - 2)))
        for part in (covariance, before)
    )
    # variance of the sum of both sides' means, less the part of independent channels
    together = float(mean @ covariance[1:, 1:] @ mean) - apart**2 * (1 / rows + 1 / columns)
    sizes = replace(
        scene.specified_systematic or Systematic(),
        channel_spread_ohm=round(apart, DIGITS),
        reference_tolerance=round(float(np.sqrt(3) * deviation[0]), FRACTION_DIGITS),
        series_ohm=round(float(np.sqrt(max(together, 0.0))), DIGITS) or None,
    )
    off = float(np.sqrt(np.mean(errors[1:] ** 2)))
    summary = (
        f"reference {100 * errors[0]:+.2f} +- {100 * deviation[0]:.2f} %, channels off by {off:.2f} ohm rms and known "
        f"to {apart:.2f} ohm beside their mean, from {frames} frames"
    )
    remarks = [f"from {frames} frames; +- is one standard deviation", summary]
    for side, lines in zip(("rows", "columns"), np.split(np.arange(1, len(errors)), [rows]), strict=True):
        each = ", ".join(f"{errors[line]:+.2f} +- {deviation[line]:.2f}" for line in lines)
        remarks.append(f"{side} are off by {each} ohm")
    return ChannelCalibration(
        scene=_corrected(replace(scene, systematic=sizes), errors),
        summary=summary,
        remarks=tuple(remarks),
        warnings=() if apart < UNCHANGED * apart_before else (HARDLY,),
        errors=errors,
        covariance=covariance,
        apart=apart,
        apart_before=apart_before,
        frames=frames,
    )


def _corrected(scene: Scene, errors: Array) -> Scene:
    """Return the scene with its reference and channels corrected by these errors."""
    readout: Any = scene.circuit.off_by(float(errors[0]))
    more = np.split(errors[1:], [scene.panel.rows])
    if isinstance(readout, DrivenReadout):
        driven: Any = readout.with_channels(*more)
        return replace(scene, readout=driven)
    known = scene.series_resistance_ohm
    both = (known.rows, known.columns) if isinstance(known, SeriesPerLine) else (known / 2, known / 2)
    lines = (np.round(np.maximum(np.add(ohm, off), 0.0), DIGITS) for ohm, off in zip(both, more, strict=True))
    series = SeriesPerLine(*(tuple(float(ohm) for ohm in line) for line in lines))
    readout = replace(readout, reference_ohm=round(readout.reference_ohm, DIGITS))
    return replace(scene, readout=readout, series_resistance_ohm=series)


def _circuit(scene: Scene) -> Scene:
    """Return the scene without loads, environment and film, the part that all recordings must share."""
    return replace(scene, subject=None, experiment=None, water=None, temperature=None, film=None, response=None)


def _with_all_errors(scene: Scene) -> Scene:
    """Return the scene with prior sizes of all errors, channels included."""
    sizes = systematic_of(scene) or replace(USUAL, series_ohm=None, inl_lsb=None, wire_ohm_per_cell=None)
    spread = sizes.channel_spread_ohm or ASSUMED.channel_ohm
    return replace(scene, systematic=replace(sizes, channel_spread_ohm=spread, reading_error=None))


def _likelihoods(recording: Recording) -> list[tuple[Array, Array, int]]:
    """Return z, Λ and the number of frames of every block of frames that can be estimated."""
    noise, parts = Prepared(recording).noise, []
    estimator = Estimator((Misfit(weighting="noise", loss=Student(corner=4.0)),), SmootherMethod(), error_bars=False)
    stream = first_stream(recording, noise.readings, estimator, noise)
    enough = np.flatnonzero(noise.readings.enough(recording.scene))
    for block in np.array_split(enough, max(round(len(enough) / BLOCK), 1)):
        if len(block) < 2:
            continue
        try:
            shared = SmootherMethod().least_cost(stream, [noise.readings[frame] for frame in block]).shared_estimate
        except BROKEN:
            continue
        parts.append((*shared, len(block)))
    return parts


def _in_units(scene: Scene, count: int) -> Array:
    """Return the matrix (1 + lines, count) that maps z to the relative error of the reference and to ohm of lines."""
    sizes, (rows, columns) = scene.specified_systematic or Systematic(), scene.panel.shape
    contacts, units = 0 if scene.contacts is None else rows + columns, np.zeros((1 + rows + columns, count))
    units[0, contacts] = sizes.reference_tolerance / np.sqrt(3)
    lines = slice(contacts + 1, contacts + 1 + rows + columns)
    units[1:, lines] = sizes.channel_spread_ohm * np.eye(rows + columns)
    if sizes.series_ohm:
        driven = slice(1, 1 + rows) if scene.circuit.noisy_side == "rows" else slice(1 + rows, None)
        units[driven, lines.stop] = sizes.series_ohm
    return units
