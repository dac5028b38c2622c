"""Calibration of the electronics with known resistors in place of the cells.

The numbers of the circuit follow by weighted least squares
(`lampest.apps.calibration.circuit_fit`). A result is refused if the circuit does not explain
the readings, if the readings do not determine a number, or if a value is implausible.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from lampest.apps.calibration.calibration import DIGITS, Calibration, common_scene
from lampest.apps.calibration.circuit_fit import (
    EXPECTED,
    CircuitFit,
    CircuitNumber,
    Problem,
    estimated_number,
    fit_circuit,
    with_estimates,
)
from lampest.apps.calibration.trials import BELIEF, Trial
from lampest.files.errors import InputError
from lampest.files.levels import NOISE_REACH, SIGNIFICANT
from lampest.panel.effects import E24_TOLERANCE
from lampest.panel.effects.channels import BEST_OHM, TYPICAL_OHM, WORST_OHM
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.panel.readouts.converter import MIN_REPEATS
from lampest.panel.readouts.tolerances import line_numbers
from lampest.recording.recording import Recording

# Deviation of a reading without a resistor over full scale: hum, and a memory of 3 %, stay below.
MAX_UNUSED_SHARE = 0.1
MAX_REFUSED = 1e-7  # share of good calibrations that may be refused
PLAUSIBLE_RANGE = {
    True: "channels of a CD74HC4067 have 40 to 160 ohm",
    False: "resistors of 5 % differ by less",
}


@dataclass(frozen=True, eq=False, kw_only=True)
class ResistorCalibration(Calibration):
    """Result of a calibration with known resistors.

    Attributes
    ----------
    numbers : tuple of CircuitNumber
        The estimated numbers of the electronics.
    readings : int
        Number of readings that are values.
    """

    numbers: tuple[CircuitNumber, ...]
    readings: int


def calibrate_resistors(
    recordings: Sequence[Recording],
    known: Sequence[Array | float] = (0.0,),
    tolerance: float = 0.01,
) -> ResistorCalibration:
    """Estimate the circuit's numbers from known resistors in place of the cells.

    Parameters
    ----------
    recordings : sequence of Recording
        Recordings of one panel and readout; the frames of each are repeats.
    known : sequence of array or float
        Known resistors of each recording, ohm: (rows, columns), or one number for all cells; 0
        where row and column lines are shorted together; inf or NaN where there is no resistor.
    tolerance : float
        Largest relative error of the known resistors and of the reference, uniformly distributed.

    Raises
    ------
    InputError
        If the scene's readout has no such numbers, if the readings do not determine them, or if
        these resistors do not explain the readings.
    """
    scene = common_scene(recordings)
    scene.panel.check_memory()
    name = recordings[0].name
    if not line_numbers(scene.circuit):
        raise InputError(
            f"{name}: known resistors tell nothing of this readout ({scene.circuit.description()})"
        )
    trials = tuple(
        Trial.of(recording, ohm) for recording, ohm in zip(recordings, known, strict=True)
    )
    fit = fit_circuit(Problem(scene, trials, tolerance))
    _check_fit(fit)
    numbers = list[CircuitNumber]()
    for unknown in fit.problem.unknowns:
        numbers.append(estimated_number(fit, unknown))
        _check_number(f"{name}: no calibration: ", numbers[-1], unknown.specified)
    noise = noise_of(trials)
    remarks = [remark for number in numbers for remark in number.remarks(fit.readings)]
    if noise is not None:
        repeats = sum(trial.repeats.sum() for trial in trials)
        remarks.append(f"noise_lsb: of one reading, from {repeats:g} repeats")
    remarks.append(
        f"resistors taken as within {100 * tolerance:g} %; the residual "
        f"is {fit.chi_square / max(fit.freedom, 1):.2g} times what noise and tolerances explain"
    )
    differ = "the lines differ by more than their noise; comments in the scene state by how much"
    return ResistorCalibration(
        scene=with_estimates(scene, numbers, noise),
        summary=f"{', '.join(number.label for number in numbers)} from {fit.readings} readings",
        remarks=tuple(remarks),
        warnings=(differ,) if any(number.differ for number in numbers) else (),
        numbers=tuple(numbers),
        readings=fit.readings,
    )


def noise_of(trials: Sequence[Trial]) -> float | tuple[float, ...] | None:
    """Return the noise of one reading from repeats, LSB; None if all lines have too few repeats.

    Driven lines that differ have a tuple. Lines with fewer than MIN_REPEATS
    repeats have the mean.
    """
    counts = np.array([trial.repeats for trial in trials])
    variances = np.average([trial.noise_lsb**2 for trial in trials], axis=0, weights=counts + 1e-9)
    repeats = counts.sum(axis=0)
    repeated = repeats >= MIN_REPEATS
    if not repeated.any():
        return None
    mean = float(np.average(variances[repeated], weights=repeats[repeated]))
    quantisation = 1 / 12  # LSB²: variances below it are equal in effect
    deviation = np.abs(np.log((variances[repeated] + quantisation) / (mean + quantisation)))
    # ln of a variance from n repeats has the standard deviation √(2/n)
    if np.all(deviation < SIGNIFICANT * np.sqrt(2 / repeats[repeated])):
        return round(float(np.sqrt(mean)), DIGITS)
    return tuple(
        round(float(variance) ** 0.5, DIGITS) for variance in np.where(repeated, variances, mean)
    )


def _check_fit(fit: CircuitFit) -> None:
    """Raise InputError where no such circuit explains the readings with the known resistors."""
    trials = fit.problem.trials
    readout = fit.problem.scene.circuit
    for trial in trials:
        # Something else than known resistors may join lines.
        unused = ~trial.used & np.isfinite(trial.volt)
        missed = np.abs(trial.volt - fit.problem.volt(fit.unknowns, trial.cells))
        missed = np.where(unused, missed, 0.0)
        if missed.max() > MAX_UNUSED_SHARE * readout.full_scale_volt:
            row, column = (int(part) for part in np.unravel_index(missed.argmax(), missed.shape))
            raise InputError(
                f"{trial.name}: no calibration: "
                f"row {row}, column {column} reads {_recorded(readout, trial.volt[row, column])}, "
                "but no known resistor leads there; was the panel unplugged?"
            )
    if fit.freedom < 0 or not fit.readings:
        count = f"only {fit.readings} readings"
        if not fit.readings:
            count = "nothing was read across a known resistor"
        raise InputError(
            f"{trials[0].name}: no calibration: {count}; join lines by more known resistors"
        )
    # σ itself is estimated from a finite number of repeats, so χ²/freedom follows Fisher's F
    # distribution.
    freedom = max(fit.freedom, 1)
    repeats = sum(BELIEF + trial.repeats.sum() for trial in trials)
    if not fdtrc(freedom, repeats, fit.chi_square / freedom) < MAX_REFUSED:
        return
    deviation = np.abs(fit.residual) / fit.sigma
    index = int(deviation.argmax())
    places = [(trial.name, *place) for trial in trials for place in np.argwhere(trial.used)]
    name, row, column = places[index]
    measured = fit.problem.measured[index]
    raise InputError(
        f"{name}: no calibration: row {row}, column {column} reads {_recorded(readout, measured)}, "
        "but behind the circuit that fits best "
        f"the known resistors give {_recorded(readout, measured - fit.residual[index])}; noise "
        f"and tolerances explain {100 * np.mean(deviation < NOISE_REACH):.0f} % of the readings"
    )


def _recorded(readout: Readout, volt: float) -> str:
    """Return the recorded value of a voltage, in words."""
    return f"{float(readout.recorded_from_volt(np.array(volt))):.4g} {readout.unit}"


def _check_number(where: str, estimate: CircuitNumber, specified: float) -> None:
    """Raise InputError where readings do not determine a number, or its value is implausible.

    Parameters
    ----------
    where : str
        Beginning of the message.
    estimate : CircuitNumber
    specified : float
        The scene's value.
    """
    number = estimate.number
    channels = len(estimate.lines)
    *_, expected = EXPECTED.get(number.name, (WORST_OHM - TYPICAL_OHM if number.channel else 0.0,))
    if estimate.sigma > max(expected, 0.3 * estimate.value):
        raise InputError(
            f"{where}the readings do not tell {number.name} "
            f"({estimate.value:.4g} ± {estimate.sigma:.2g} {number.unit}); "
            "known resistors of different values, on more lines, do"
        )
    # Equal cells are equivalent to a larger series resistance, so the value is limited to that of
    # the worst channels, or to their excess over typical ones above the specified value.
    most = channels * WORST_OHM + max(specified - channels * TYPICAL_OHM, 0.0)
    if number.in_scene and number.channel and estimate.value - SIGNIFICANT * estimate.sigma > most:
        raise InputError(
            f"{where}a {number.name} of {estimate.value:.4g} ohm is more "
            f"than the {most:g} ohm that {channels} channels have at worst; "
            "were the known resistors in place of the panel, and are their values right?"
        )
    most = max((WORST_OHM - BEST_OHM) * number.channel, 4 * E24_TOLERANCE * estimate.value)
    for side, offset, sigma in estimate.lines:
        high = int(np.nanargmax(offset))
        low = int(np.nanargmin(offset))
        difference = float(offset[high] - offset[low])
        if difference - SIGNIFICANT * np.hypot(sigma[high], sigma[low]) > most:
            raise InputError(
                f"{where}{number.name} of {side} {high} and {low} would differ by {difference:.4g} "
                f"ohm, and at most {most:.4g} ohm is likely ({PLAUSIBLE_RANGE[number.channel]})"
            )
