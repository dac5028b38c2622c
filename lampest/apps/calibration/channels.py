"""Calibration of channels, series resistance and reference from recordings under many loads.

The recordings are ordinary ones, without known resistors. Under a wrong circuit, untouched cells
seem to move when others do. The smoother's cost has the errors z that all frames share as unknowns.
Every block of frames gives an estimate z with the precision Λ of its likelihood, where the cells
are integrated out by the Schur complement. All blocks together give the posterior N(ẑ, C),

    C⁻¹ = I + b Σ Λ,   ẑ = b C Σ (Λ + I) z,

where b = BELIEVED is the share of the information that is used.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from lampest.apps.calibration.calibration import DIGITS, FRACTION_DIGITS, Calibration, common_scene
from lampest.cost.losses import Student
from lampest.cost.terms import Misfit
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods.joint import BELIEVED
from lampest.estimate.methods.smoother import SmootherMethod
from lampest.estimate.sequence import first_stream
from lampest.files.errors import BROKEN, InputError
from lampest.inference.circuits.kinds import RESISTORS
from lampest.inference.prepared import Prepared
from lampest.panel.effects import systematic_of, usual_sizes
from lampest.panel.effects.channels import CHANNELS
from lampest.panel.lines import SeriesPerLine, of_side
from lampest.panel.panel import Array
from lampest.panel.readouts.tolerances import behind_channels, line_numbers, off_by
from lampest.panel.scene import Scene
from lampest.panel.sizes import Systematic
from lampest.posterior.gaussian import Information
from lampest.recording.recording import Recording

BLOCK = 50  # frames that are solved together; ten blocks take as long as one of all their frames
# Ratio of the deviations after and before: above it the recordings determine hardly any channel.
UNCHANGED = 0.9
ROBUST_CORNER = 4.0  # σ: residuals of the misfit beyond it count less, as in the smoother's default
HARDLY = (
    "these loads determine hardly any channel; press the panel at more places, or record longer"
)


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
    """Estimate the electronics' errors from the apparent motion of untouched cells.

    The cells are those in recordings of one circuit. The scene is corrected by them, and its
    systematic errors are their posterior uncertainty.

    Raises InputError without a readout, for a readout that states no numbers of its lines, for
    panels of modules, where scenes differ, or where no frame can be estimated.
    """
    common_scene(recordings, _circuit)
    name = recordings[0].name
    scene = recordings[0].scene
    _check_determined(name, scene)
    prior = prior_sizes(scene)
    channel_prior = float(prior.channel_spread_ohm)
    scene = replace(scene, systematic=prior)
    rows, columns = scene.panel.shape
    parts: list[tuple[Information, int]] = []
    for recording in recordings:
        parts += _likelihoods(replace(recording, scene=scene))
    if not parts:
        raise InputError(f"{name}: no calibration: no frame could be estimated")
    (first, _), *others = parts
    posterior = sum((part for part, _ in others), first).share(BELIEVED)
    units = _units(scene, prior, len(posterior.mean))
    errors = units @ posterior.mean
    covariance = units @ posterior.covariance @ units.T
    frames = sum(count for _, count in parts)
    deviation = np.sqrt(np.diag(covariance))
    spread, common = _channel_deviations(covariance[1:, 1:], rows, columns)
    sizes = replace(
        prior,
        channel_spread_ohm=round(spread, DIGITS),
        reference_tolerance=round(float(np.sqrt(3) * deviation[0]), FRACTION_DIGITS),
        series_tolerance_ohm=round(common, DIGITS) or None,
    )
    summary = (
        f"reference {100 * errors[0]:+.2f} +- {100 * deviation[0]:.2f} %, "
        f"channels off by {np.sqrt(np.mean(errors[1:] ** 2)):.2f} ohm rms "
        f"and known to {spread:.2f} ohm beside their mean, from {frames} frames"
    )
    offsets = [f"{error:+.2f} +- {sd:.2f}" for error, sd in zip(errors, deviation, strict=True)]
    return ChannelCalibration(
        scene=_corrected(replace(scene, systematic=sizes), errors),
        summary=summary,
        remarks=(
            f"from {frames} frames; +- is one standard deviation",
            summary,
            f"rows are off by {', '.join(offsets[1 : 1 + rows])} ohm",
            f"columns are off by {', '.join(offsets[1 + rows :])} ohm",
        ),
        warnings=() if spread < UNCHANGED * channel_prior else (HARDLY,),
        errors=errors,
        covariance=covariance,
        apart=spread,
        apart_before=channel_prior,
        frames=frames,
    )


def _check_determined(name: str, scene: Scene) -> None:
    """Raise InputError unless recordings of a scene determine its channels.

    `name` is that of a recording.
    """
    if scene.readout is None:
        raise InputError(
            f"{name}: its scene names no readout, whose numbers a calibration could find"
        )
    if not line_numbers(scene.circuit):
        raise InputError(
            f"{name}: recordings tell nothing of this readout ({scene.circuit.description()})"
        )
    if scene.panel.modules is not None:
        raise InputError(f"{name}: calibrate a panel of modules by recordings of each")


def prior_sizes(scene: Scene) -> Systematic:
    """Return the prior sizes of all errors, channels included."""
    prior = systematic_of(scene) or replace(
        usual_sizes(), series_tolerance_ohm=None, inl_lsb=None, wire_ohm_per_cell=None
    )
    return replace(
        prior,
        channel_spread_ohm=prior.channel_spread_ohm or CHANNELS.prior,
        reading_error=None,
    )


def _channel_deviations(covariance: Array, rows: int, columns: int) -> tuple[float, float]:
    """Return standard deviations of channels from their covariance (lines, lines), ohm.

    Returns
    -------
    float
        rms deviation of a channel from the mean of its side.
    float
        That of the sum of both sides' means, less the part of independent channels; 0 if negative.
    """
    mean = np.zeros((rows + columns, 2))
    mean[:rows, 0] = 1 / rows
    mean[rows:, 1] = 1 / columns
    of_means = mean.T @ covariance @ mean
    # (Σ var e − Σ_sides n var ē)/(lines − 2)
    variance = float(np.trace(covariance) - np.diag(of_means) @ (rows, columns))
    variance /= rows + columns - 2
    common = float(of_means.sum()) - variance * (1 / rows + 1 / columns)
    return float(np.sqrt(variance)), float(np.sqrt(max(common, 0.0)))


def _corrected(scene: Scene, errors: Array) -> Scene:
    """Return the scene with its reference and channels corrected by these errors."""
    readout = off_by(scene.readout or scene.circuit, float(errors[0]))
    of_rows, of_columns = np.split(errors[1:], [scene.panel.rows])
    if readout.unit != "ohm":
        return replace(scene, readout=_rounded(behind_channels(readout, of_rows, of_columns)))
    specified = scene.series_resistance_ohm
    if not isinstance(specified, SeriesPerLine):
        specified = SeriesPerLine(specified / 2, specified / 2)

    def corrected(ohm: Any, offsets: Array) -> tuple[float, ...]:
        line = np.round(np.maximum(np.add(ohm, offsets), 0.0), DIGITS)
        return tuple(map(float, line))

    series = SeriesPerLine(
        corrected(specified.rows, of_rows), corrected(specified.columns, of_columns)
    )
    return replace(scene, readout=_rounded(readout), series_resistance_ohm=series)


def _rounded(readout: Any) -> Any:
    """Return the readout with resistances to a milliohm."""
    names = {"drive_ohm", "sense_ohm", *RESISTORS}.intersection(
        field.name for field in fields(readout)
    )
    values = {name: np.round(getattr(readout, name), DIGITS).tolist() for name in names}
    return replace(
        readout,
        **{name: tuple(ohm) if isinstance(ohm, list) else ohm for name, ohm in values.items()},
    )


def _circuit(scene: Scene) -> Scene:
    """Return the scene without loads, environment and film: the part that all recordings share."""
    return replace(
        scene, subject=None, experiment=None, water=None, temperature=None, film=None, response=None
    )


def _likelihoods(recording: Recording) -> Iterator[tuple[Information, int]]:
    """Yield the information on the errors z of every block that can be estimated, and its frames.

    The information is Λ and (Λ + I) z.
    """
    noise = Prepared(recording).noise
    method = SmootherMethod()
    misfit = Misfit(weighting="noise", loss=Student(corner=ROBUST_CORNER))
    estimator = Estimator((misfit,), method, error_bars=False)
    stream = first_stream(recording, noise.readings, estimator, noise)
    usable = np.flatnonzero(noise.readings.enough(recording.scene))
    for block in np.array_split(usable, max(round(len(usable) / BLOCK), 1)):
        with suppress(*BROKEN):
            joint = method.least_cost(stream, [noise.readings[frame] for frame in block])
            estimate, precision = joint.shared_estimate
            yield Information(precision, precision @ estimate + estimate), len(block)


def _units(scene: Scene, prior: Systematic, count: int) -> Array:
    """Return the matrix that maps z to the relative error of the reference and to ohm of lines.

    Shape (1 + lines, count).
    """
    rows, columns = scene.panel.shape
    lines = sum(scene.panel.shape)
    first = 0 if scene.contact_prior is None else lines
    units = np.zeros((1 + lines, count))
    sizes = [prior.reference_tolerance / np.sqrt(3), *lines * [prior.channel_spread_ohm]]
    units[:, first : first + 1 + lines] = np.diag(sizes)
    if prior.series_tolerance_ohm:
        driven = of_side(scene.circuit.noisy_side, (1.0, 0.0), (0.0, 1.0))[0]
        units[1:, first + 1 + lines] = prior.series_tolerance_ohm * np.repeat(
            driven, (rows, columns)
        )
    return units
