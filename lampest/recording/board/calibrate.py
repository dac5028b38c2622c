"""Series resistance of the electronics, from a recording of known resistors or shorted lines."""

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lampest.files.document import to_yaml
from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.scene import Scene
from lampest.recording.recording import Recording

Index = NDArray[np.signedinteger]
MOST_SIGMA_OF_LINES = 5.0


@dataclass(frozen=True, eq=False)
class Calibration:
    """What stands in series with every two-point resistance.

    Parameters
    ----------
    series_ohm, sigma_ohm : mean over the measured cells and its standard deviation, in ohm; the tolerance of the
        resistors is not in it.
    row_ohm, column_ohm : (rows) and (columns) ohm, what each line adds to the mean, zero on average; NaN for lines
        that were not measured. Rows and columns together cannot tell which side the mean belongs to.
    line_sigma_ohm : standard deviation of those, in ohm.
    lines_differ : whether lines differ by more than their noise; then one number for all is that much in error.
    residual_ohm : root mean square of what mean and lines leave over, in ohm.
    cells : number of cells that were used.
    """

    series_ohm: float
    sigma_ohm: float
    row_ohm: Array
    column_ohm: Array
    line_sigma_ohm: float
    lines_differ: bool
    residual_ohm: float
    cells: int


def calibrate(recording: Recording, known_cell_resistance: Array | float = 0.0) -> Calibration:
    """s_jk = R_jk measured − R_jk of the known cells = s + a_j + b_k, by weighted least squares.

    Parameters
    ----------
    recording : all its frames are averaged.
    known_cell_resistance : ohm, (rows, columns) or one number for all; 0 where row and column lines are shorted
        together; inf or NaN where there is no resistor.

    Raises InputError where nothing was measured between joined lines, or the result is not positive.
    """
    shape = recording.scene.panel.shape
    known = np.broadcast_to(np.asarray(known_cell_resistance, dtype=float), shape)
    expected = np.zeros(shape) if np.all(known == 0) else _two_point(known)
    excess = recording.resistance.mean(axis=0) - expected
    used = np.isfinite(excess)
    if not used.any():
        raise InputError(f"{recording.name}: no row line is joined to a column line by a known resistor")
    sigma = _sigma_of_mean(recording, used)
    rows, columns = np.nonzero(used)
    row_ohm, column_ohm, mean_of_lines, parameters = _lines(excess[used], rows, columns, 1 / sigma**2, shape)
    rest = excess[used] - mean_of_lines - row_ohm[rows] - column_ohm[columns]
    scatter = max(1.0, float(np.sum((rest / sigma) ** 2)) / max(len(rows) - parameters, 1))
    common = np.average(excess[used], weights=1 / sigma**2)
    chi_square = float(np.sum(((excess[used] - common) / sigma) ** 2)) / scatter
    differ = parameters > 1 and chi_square > len(rows) - 1 + MOST_SIGMA_OF_LINES * np.sqrt(2 * len(rows))
    # Where lines differ each counts the same; weights would prefer the lower ones.
    shares = np.full(len(rows), 1 / len(rows)) if differ else sigma**-2 / np.sum(sigma**-2)
    mean = float(shares @ excess[used])
    if mean <= 0:
        raise InputError(
            f"{recording.name}: the measured resistances are {-mean:.3g} ohm below the known ones; check their values "
            f"and the scene's readout.measured_across"
        )
    per_line = len(rows) / max(len(np.unique(rows)), len(np.unique(columns)))
    return Calibration(
        mean,
        float(np.sqrt(scatter * np.sum((shares * sigma) ** 2))),
        np.where(np.isin(np.arange(shape[0]), rows), row_ohm, np.nan),
        np.where(np.isin(np.arange(shape[1]), columns), column_ohm, np.nan),
        float(np.sqrt(scatter * np.mean(sigma**2) / per_line)),
        bool(differ),
        float(np.sqrt(np.mean(rest**2))),
        len(rows),
    )


def calibrated_scene(scene: Scene, calibration: Calibration) -> Scene:
    """The scene with the series resistance found, rounded to a milliohm."""
    return dataclasses.replace(scene, series_resistance_ohm=round(calibration.series_ohm, 3))


def calibrated_scene_text(scene: Scene, calibration: Calibration) -> str:
    """The calibrated scene as YAML, with the uncertainty and the lines as comments."""
    remarks = [
        f"series_resistance_ohm: {calibration.series_ohm:.3f} +- {calibration.sigma_ohm:.3f} ohm (one standard "
        f"deviation), from {calibration.cells} cells",
    ]
    if calibration.lines_differ:
        lines = (("row", calibration.row_ohm), ("column", calibration.column_ohm))
        remarks += [
            f"{name} lines differ from the mean by {' '.join(f'{x:+.2f}' for x in ohm)} ohm" for name, ohm in lines
        ]
        remarks += [
            f"each +- {calibration.line_sigma_ohm:.2f} ohm; one series resistance for all leaves that in the data"
        ]
    return "".join(f"# {remark}\n" for remark in remarks) + to_yaml(calibrated_scene(scene, calibration))


def _two_point(known: Array) -> Array:
    """R of a network that may fall into parts; inf between lines of different parts."""
    if np.any(known <= 0):
        raise InputError("known resistors must be positive; only all of them together may be 0 (shorted lines)")
    conductance = np.where(np.isfinite(known), 1 / known, 0.0)
    rows, columns = known.shape
    part = _parts(conductance)
    tie = np.zeros(rows + columns)
    tie[np.unique(part)] = conductance.max() or 1.0
    resistance = TwoPointReadout().network(known, tie).reading()
    return np.where(part[:rows, None] == part[None, rows:], resistance, np.inf)


def _parts(conductance: Array) -> Index:
    """For every line (rows, then columns) the first line that it is joined to, itself included."""
    rows, columns = conductance.shape
    reach = np.eye(rows + columns)
    reach[:rows, rows:] = conductance > 0
    reach[rows:, :rows] = conductance.T > 0
    # Each squaring doubles the steps that are looked along.
    for _ in range(int(np.ceil(np.log2(rows + columns)))):
        reach = (reach @ reach > 0).astype(float)
    first: Index = np.argmax(reach > 0, axis=1)
    return first


def _sigma_of_mean(recording: Recording, used: Array) -> Array:
    """σ of each used cell's mean over the frames (cells) ohm: what averages out, and what quantisation leaves."""
    whole, frames = recording.resistance.mean(axis=0), len(recording.resistance)
    scatter = recording.resistance[:, used].std(axis=0, ddof=1) if frames > 1 else np.zeros(int(np.sum(used)))
    readout = recording.scene.readout
    if readout is None:
        return np.full(len(scatter), max(float(np.sqrt(np.mean(scatter**2))), 1e-9) / np.sqrt(frames))
    endless = dataclasses.replace(readout, readings=65535)
    lasting = endless.sigma(whole)[used]
    # One cell's scatter over few frames is a poor estimate, and zero where all readings agree: that of all, in codes.
    expected = readout.sigma(whole)[used]
    pooled = float(np.sqrt(np.mean((scatter / expected) ** 2))) if frames > 1 else 1.0
    least = float(np.min(endless.sigma_code() / readout.sigma_code()))
    total: Array = np.hypot(expected * max(pooled, least) / np.sqrt(frames), lasting)
    return total


def _lines(
    excess: Array, rows: Index, columns: Index, weights: Array, shape: tuple[int, int]
) -> tuple[Array, Array, float, int]:
    """a_j, b_k and s with excess = s + a_j + b_k, a and b zero on average over the lines used; and the fit's rank."""
    design = np.zeros((len(excess), sum(shape)))
    design[np.arange(len(excess)), rows] = 1
    design[np.arange(len(excess)), shape[0] + columns] = 1
    root = np.sqrt(weights)
    solution, _, rank, _ = np.linalg.lstsq(design * root[:, None], excess * root, rcond=1e-10)
    row_ohm, column_ohm = solution[: shape[0]], solution[shape[0] :]
    row_mean, column_mean = row_ohm[np.unique(rows)].mean(), column_ohm[np.unique(columns)].mean()
    return row_ohm - row_mean, column_ohm - column_mean, float(row_mean + column_mean), int(rank)
