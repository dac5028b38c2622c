"""Whether a recording is a calibration at all: one sentence that says what does not fit."""

import numpy as np
from scipy.stats import f as fisher

from lampest.files.errors import InputError
from lampest.recording.calibration.circuit import MEMORY, WIRE
from lampest.recording.calibration.fit import CircuitFit
from lampest.recording.calibration.found import Found, LineOffsets
from lampest.recording.calibration.trial import Trial

BY_CHANCE = 1e-7  # of good calibrations that may be refused for what is left over
# A channel of a CD74HC4067 at 5 V; typical and worst are its data sheet's.
BEST_OHM, TYPICAL_OHM, WORST_OHM = 40.0, 70.0, 160.0
MOST_OF_RESISTORS = 0.1  # by which a load may differ from the others: twice the 5 % of ordinary resistors
LIKELY = {True: "channels of a CD74HC4067 have 40 to 160 ohm", False: "resistors of 5 % differ by less"}
OPEN_SHARE = 0.1  # of the supply: a converter that remembers 3 % of the channel before, and hum, stay below
SURE = 4.0  # σ that a number must be beyond
# σ of a number that the readings tell: of a channel less than channels differ by, of a resistor a part of itself.
LEAST_TOLD = 0.3
ENOUGH = {MEMORY.name: 0.01} | {wire.name: 0.5 for wire in WIRE} | {"diode.drop_volt": 0.2}


def check_fit(fit: CircuitFit) -> None:
    """Raise InputError where the readings are not those of the known resistors behind any such circuit.

    χ² over its freedom follows Fisher's distribution, because σ itself is known from as many repeats only.
    """
    problem = fit.problem
    for trial in problem.trials:
        _check_open_lines(fit, trial)
    if fit.freedom < 0 or not fit.readings:
        many = "nothing was read across a known resistor" if not fit.readings else f"only {fit.readings} readings"
        raise InputError(f"{problem.trials[0].name}: no calibration: {many}; join lines by more known resistors")
    repeats = sum(trial.readings.freedom for trial in problem.trials)
    chance = fisher.sf(fit.chi_square / max(fit.freedom, 1), max(fit.freedom, 1), repeats)
    if chance < BY_CHANCE:
        raise InputError(_worst(fit))


def _check_open_lines(fit: CircuitFit, trial: Trial) -> None:
    """Raise InputError where something is read on lines that no known resistor leads to."""
    circuit, reads = fit.problem.circuit, trial.readings.volt
    gives = circuit.volt(fit.unknowns, trial.cells)
    off = np.where(trial.used | ~np.isfinite(reads), 0.0, np.abs(reads - gives)) / circuit.readout.supply_volt
    if off.max() > OPEN_SHARE:
        row, column = (int(part) for part in np.unravel_index(off.argmax(), off.shape))
        read = float(circuit.readout.recorded_from_volt(reads[row, column]))
        raise InputError(
            f"{trial.name}: no calibration: row {row}, column {column} reads {read:.4g} {circuit.readout.unit}, but no "
            f"known resistor leads there; was the panel unplugged?"
        )


def _worst(fit: CircuitFit) -> str:
    """The reading that is farthest from what any such circuit gives."""
    off = np.abs(fit.rest) / fit.sigma
    index = int(off.argmax())
    expected = fit.problem.measured - fit.rest
    circuit = fit.problem.circuit.readout
    reads, gives = (
        float(circuit.recorded_from_volt(np.array(volt[index]))) for volt in (fit.problem.measured, expected)
    )
    for trial in fit.problem.trials:
        places = np.argwhere(trial.used)
        if index < len(places):
            break
        index -= len(places)
    row, column = places[index]
    return (
        f"{trial.name}: no calibration: row {row}, column {column} reads {reads:.4g} {circuit.unit}, but behind the "
        f"circuit that fits best the known resistors give {gives:.4g} {circuit.unit}; noise and tolerances explain "
        f"{100 * np.mean(off < 3):.0f} % of the readings"
    )


def check_number(fit: CircuitFit, found: Found) -> None:
    """Raise InputError where the readings do not tell a number, or it is none that such electronics have."""
    name, where = found.number.name, f"{fit.problem.trials[0].name}: no calibration: "
    enough = ENOUGH.get(found.number.name, WORST_OHM - TYPICAL_OHM if found.number.channel else 0.0)
    if found.sigma > max(enough, LEAST_TOLD * found.value):
        raise InputError(
            f"{where}the readings do not tell {name} ({found.value:.4g} ± {found.sigma:.2g} {found.number.unit}); "
            f"known resistors of different values, on more lines, do"
        )
    if found.number.in_scene and found.number.channel:
        _check_channels(fit, found, where)
    for lines in found.lines:
        _check_spread(found, lines, where)


def _check_spread(found: Found, lines: LineOffsets, where: str) -> None:
    """Raise InputError where two lines of a side differ by more than two channels, or two resistors, do."""
    most = max(WORST_OHM - BEST_OHM if found.number.channel else 0.0, 2 * MOST_OF_RESISTORS * found.value)
    high, low = int(np.nanargmax(lines.off_ohm)), int(np.nanargmin(lines.off_ohm))
    apart = float(lines.off_ohm[high] - lines.off_ohm[low])
    if apart - SURE * np.hypot(lines.sigma_ohm[high], lines.sigma_ohm[low]) > most:
        raise InputError(
            f"{where}{found.number.name} of {lines.side} {high} and {low} would differ by {apart:.4g} ohm, and at most "
            f"{most:.4g} ohm is likely ({LIKELY[found.number.channel]})"
        )


def _check_channels(fit: CircuitFit, found: Found, where: str) -> None:
    """Raise InputError where channels alone have more than the worst ones do, or than the scene's and as far above.

    A recording of equal cells looks like one of a larger series resistance in all else.
    """
    channels, told = len(found.lines), fit.problem.circuit.told(found.number)
    most = max(channels * WORST_OHM, told + channels * (WORST_OHM - TYPICAL_OHM))
    if found.value - SURE * found.sigma > most:
        raise InputError(
            f"{where}a {found.number.name} of {found.value:.4g} ohm is more than the {most:g} ohm that {channels} "
            f"channels have at worst; were the known resistors in place of the panel, and are their values right?"
        )
