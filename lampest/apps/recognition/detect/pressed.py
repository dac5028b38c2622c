"""Loads on a panel: centre, area, peak and total force over time, from the cells' pressures.

The loads are of any kind.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lampest.apps.film.pressure import KPA_MM2, determined, sum_sd
from lampest.files.whole import write_whole
from lampest.panel.panel import Array, Mask, Numbers, Panel
from lampest.report.compare import Table, comma_separated
from lampest.runs.case import CaseResult
from lampest.runs.results import Results

FILE = "pressed.csv"
SIDES = 4  # neighbours of a cell: if fewer of them are touched, the cell lies on the outline
POSITION_VARIANCE = 1 / 12  # of a uniform position within a cell, or of its covered share, in cells
HEADERS = ("centre x [mm]", "centre y [mm]", "area [mm²]", "peak [kPa]", "force [N]")


class PressedCells(NamedTuple):
    """Centre, area, peak and force of one estimate.

    NaN where nothing presses or the frame was not solved.

    Attributes
    ----------
    case : CaseResult
    values, errors : array, shape (frames, 5)
        Figures in the order of HEADERS, and their standard deviations.
    saturated : integer array, shape (frames,)
        Number of pressed cells whose pressure the response does not determine. With any, peak and
        force are lower bounds, because such a cell counts with the largest pressure that the
        response determines.
    """

    case: CaseResult
    values: Array
    errors: Array
    saturated: Numbers


def pressed_of(case: CaseResult) -> PressedCells | None:
    """Return the figures of the pressed cells of a case; None where the results have no pressures.

    F = a Σ p, A = n a and x̄ = Σ p x / Σ p over the cells with `Pressure.pressing`, where a is the
    pitch squared. Own errors of the cells are independent, common errors are fully correlated. Area
    and centre have further variances, a²/12 and pitch²/12 for each cell on the outline, because the
    outline may lie anywhere within it. The pressure between the films of two cells is not measured:
    a spot smaller than a cell has the force of one that fills it.
    """
    names = ("pressing", "pressure", "pressure_own", "pressure_common")
    pressing, *pressures = [case.column(name) for name in names]
    if pressing is None or any(values is None for values in pressures):
        return None
    touched = pressing != 0
    frames = zip(touched, *determined(case.scene, *pressures), strict=True)
    values, errors = np.array([_frame(case.scene.panel, *frame) for frame in frames]).swapaxes(0, 1)
    saturated = case.column("saturated")
    counts = np.sum(touched & (False if saturated is None else saturated != 0), axis=(1, 2))
    return PressedCells(case, values, errors, counts)


def pressed(results: Results) -> tuple[PressedCells, ...]:
    """Return the figures of every case that has pressures with errors."""
    return tuple(cells for case in results.cases if (cells := pressed_of(case)) is not None)


def _frame(panel: Panel, touched: Mask, pressure: Array, own_sd: Array, common_sd: Array) -> Array:
    """Return the figures of one frame and their standard deviations, (2, 5).

    The result is NaN without touched cells.

    Parameters
    ----------
    panel : Panel
    touched : boolean array, shape (rows, columns)
    pressure, own_sd, common_sd : array, shape (rows, columns)
        Pressure, and standard deviations of its own and common errors, kPa.
    """
    if not touched.any():
        return np.full((2, 5), np.nan)
    pitch = panel.pitch_mm
    cell = pitch**2
    p, own, common = (values[touched] for values in (pressure, own_sd, common_sd))
    pairs = np.array(panel.neighbours[:2])
    both = touched.ravel()[pairs].all(axis=0)
    pressed_neighbours = np.bincount(pairs[:, both].ravel(), minlength=touched.size)
    outline = np.sum(touched.ravel() & (pressed_neighbours < SIDES))
    force = p.sum()
    # x̄ = Σ p x/Σ p with ∂x̄/∂p_i = (x_i − x̄)/Σ p, and pitch²/12 · Σ (p/Σ p)² for the position within
    # cells
    places = panel.places_mm[:, touched]
    centre = places @ p / force
    within = cell * POSITION_VARIANCE * np.sum((p / force) ** 2)
    centre_sd = [
        np.sqrt(sum_sd((at - middle) / force, own, common) ** 2 + within)
        for at, middle in zip(places, centre, strict=True)
    ]
    peak = np.argmax(p)
    area_sd = cell * np.sqrt(outline * POSITION_VARIANCE)
    peak_sd = np.hypot(own[peak], common[peak])
    force_sd = sum_sd(KPA_MM2 * cell, own, common)
    return np.array(
        [
            [*centre, len(p) * cell, p[peak], KPA_MM2 * cell * force],
            [*centre_sd, area_sd, peak_sd, force_sd],
        ]
    )


def pressed_table(all_pressed: Sequence[PressedCells]) -> Table:
    """Return a table with the frame of largest force of each estimate."""
    rows = []
    for cells in all_pressed:
        case = cells.case
        force = cells.values[:, -1]
        if np.isfinite(force).any():
            at = int(np.nanargmax(force))
            numbers = [
                figure(*pair) for pair in zip(cells.values[at], cells.errors[at], strict=True)
            ]
            saturated = str(cells.saturated[at] or "")
            if saturated:
                numbers[-2:] = [f"≥\N{NO-BREAK SPACE}{number}" for number in numbers[-2:]]
            when = str(case.frame[at]), f"{case.time[at]:g}"
            rows.append((case.recording, case.estimator, *when, *numbers, saturated))
    return Table(
        ("recording", "from", "frame", "time [s]", *HEADERS, "saturated cells"), tuple(rows)
    )


def figure(value: float, error: float) -> str:
    """Return 'value ± error' with two significant digits of the error.

    If the error is 0, the value stands alone.
    """
    if error == 0:
        return f"{value:.3g}"
    digits = max(0, 1 - int(np.floor(np.log10(error)))) if error > 0 and np.isfinite(error) else 1
    return f"{value:.{min(digits, 3)}f} ± {error:.{min(digits, 3)}f}".replace("-", "−")


def write_pressed(path: Path, all_pressed: Sequence[PressedCells]) -> Path:
    """Write every frame of every estimate as CSV atomically.

    Cells are empty where nothing presses.

    Raises InputError where the place cannot be written.
    """
    named = [name for header in HEADERS for name in (header, f"standard deviation of {header}")]
    lines: list[list[object]] = [
        ["recording", "estimator", "frame", "time [s]", *named, "saturated cells"]
    ]
    for cells in all_pressed:
        case = cells.case
        pairs = np.stack([cells.values, cells.errors], axis=2).reshape(len(case.time), -1)
        for frame, time, row, saturated in zip(
            case.frame, case.time, pairs, cells.saturated, strict=True
        ):
            numbers = [float(value) if np.isfinite(value) else None for value in row]
            head = case.recording, case.estimator, int(frame), float(time)
            lines.append([*head, *numbers, int(saturated)])
    write_whole(path, comma_separated(lines))
    return path
