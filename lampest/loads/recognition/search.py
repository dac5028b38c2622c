"""Where fits begin: a map of ln r/r0 of the cells, and round templates laid over it, a matched filter."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular

from lampest.loads.recognition.baseline import Baseline
from lampest.loads.recognition.frame import Observation, Whitening
from lampest.loads.shapes.disc import Disc, oval_pressure
from lampest.loads.shapes.shape import Template
from lampest.panel.panel import Array, Panel

MAP_SD, MAP_STEPS = 0.5, 4  # prior of ln r/r0 of a map's cells; Gauss-Newton steps
STEP = 1.5  # the longest change of ln r/r0 in one
CLEAR = 1.5  # ln r/r0 beyond which a cell counts no more than one there
PLACES, LEAST, FAINTEST = 3, 0.15, 0.08  # for one more load; ln r/r0 in all, and relative to the clearest, of one
FULL_KPA, HOLLOW_KPA = (0.0, 8.0), (-6.0, 30.0)  # inside and under the rim, where a fit begins


@dataclass(frozen=True, eq=False)
class DiscSearch:
    """Templates about every cell's centre and between four of them.

    panel, templates : themselves. discs : (discs) what a fit begins with where one of them matches, one template after
    the other.
    changes : (cells, discs) ln r/r0 of unit length. readings : (cells, discs of the faint ones) ohm, what they add.
    errors : the same of whitened readings of a panel at rest, of unit length.
    """

    panel: Panel
    templates: tuple[Template, ...]
    discs: tuple[Disc, ...]
    changes: Array
    readings: Array
    errors: Array

    @classmethod
    def over(
        cls, panel: Panel, patch_mm: float, baseline: Baseline, whitening: Whitening, templates: tuple[Template, ...]
    ) -> "DiscSearch":
        """All templates laid over a panel, and what its readings would show of them."""
        discs, patterns = [], []
        for template in templates:
            size = (template.outer_mm, template.inner_mm)
            pressures = HOLLOW_KPA if template.inner_mm else FULL_KPA
            for shift in (0.0, panel.pitch_mm / 2):
                patterns.append(_everywhere(panel, patch_mm, template, shift))
                across, down = panel.centres_mm()
                discs += [Disc(x + shift, y + shift, *size, *pressures, 0.0, 0.0) for y in down for x in across]
        changes = _unit(np.concatenate(patterns).reshape(-1, panel.crossings).T)
        faint = changes[:, np.repeat([template.faint for template in templates], 2 * panel.crossings)]
        readings = baseline.network().sensitivity() @ faint
        return cls(panel, templates, tuple(discs), changes, readings, _unit(whitening @ readings))

    def faint_places(self) -> Array:
        """(faint discs, 2) mm, in the order of `readings`."""
        faint = np.repeat([template.faint for template in self.templates], len(self.discs) // len(self.templates))
        return np.asarray(np.array([disc[:2] for disc in self.discs])[faint])

    def against(self, whitening: Whitening) -> "DiscSearch":
        """The same where a panel at rest has other errors."""
        return replace(self, errors=_unit(whitening @ self.readings))

    def stands_out(self, errors: Array) -> float:
        """By how many standard deviations errors of unit variance, against a panel at rest, look like a disc."""
        return float((self.errors.T @ errors).max())

    def starts(self, change: Array, errors: Array) -> list[Disc]:
        """Where each template fits a map of ln r/r0 (rows, columns) best, then where it fits errors of a panel at rest.

        The map shows strong loads, whose errors are not in proportion; the errors show weak ones through noise.
        """
        on_map = (self.changes.T @ np.clip(change.ravel(), -CLEAR, CLEAR)).reshape(len(self.templates), -1)
        faint = [number for number, template in enumerate(self.templates) if template.faint]
        in_errors = (self.errors.T @ errors).reshape(len(faint), -1)
        size = on_map.shape[1]
        order = np.argsort(-on_map.max(axis=1))
        best = [template * size + int(np.argmax(on_map[template])) for template in order]
        best += [template * size + int(np.argmax(row)) for template, row in zip(faint, in_errors, strict=True)]
        return [self.discs[number] for number in dict.fromkeys(best)]

    def beside(self, change: Array, discs: Sequence[Disc]) -> list[Disc]:
        """Where one more load may stand on a map of ln r/r0 (rows, columns), clear of those discs; the clearest first.

        At most PLACES, each more than half a pitch from the others; none where nothing is left beside the discs.
        """
        whole, pitch = np.clip(change, -CLEAR, CLEAR), self.panel.pitch_mm
        left, first = whole.copy(), float((self.changes.T @ whole.ravel()).max())
        across, down = self.panel.centres_mm()
        for disc in discs:
            distance = np.hypot(across - disc.x_mm, down[:, None] - disc.y_mm)
            left[distance < disc.diameter_mm / 2 + pitch / 2] = 0.0
        score, (x_mm, y_mm) = self.changes.T @ left.ravel(), np.array(self.discs).T[:2]
        found: list[Disc] = []
        while len(found) < PLACES:
            best = int(np.argmax(score))
            if score[best] < max(LEAST, FAINTEST * first):
                break
            found.append(self.discs[best])
            apart = np.hypot(x_mm - found[-1].x_mm, y_mm - found[-1].y_mm)
            score = np.where(apart > 0.6 * pitch, score, -np.inf)
        return found


def cell_map(frame: Observation) -> Array:
    """ln r/r0 of every cell, (rows, columns): of independent cells with a standard deviation of MAP_SD."""
    nothing = np.zeros(frame.measured.shape)
    return gaussian_cells(frame, nothing, MAP_SD**2, MAP_STEPS, frame.covariance(nothing))[0]


def cells_about(frame: Observation, change: Array) -> tuple[Array, Array]:
    """The cells that readings show where they lie about a change (rows, columns), and their standard deviations."""
    found, root, _ = gaussian_cells(frame, change, 1.0, MAP_STEPS)
    seen = solve_triangular(root, frame.slope(found), lower=True)
    return found, np.sqrt(np.maximum(1 - (seen**2).sum(axis=0), 1e-6)).reshape(found.shape)


def gaussian_cells(
    frame: Observation, start: Array, prior: Array | float, steps: int, noise: Array | None = None
) -> tuple[Array, Array, Array]:
    """argmin ‖R − f(r0·e^x)‖² in C + ‖x‖² in P, by Gauss-Newton steps from `start` in the space of the readings.

    prior : P (cells, cells), or the variance of independent cells. noise : C (cells, cells) ohm²; None: that of the
    frame at x. Gives x (rows, columns); A P Aᵀ + C (cells, cells) as its lower root L, and the readings' distance from
    a panel at rest (cells) ohm, linearised where the last step began.
    """
    change, every = start, np.arange(start.size)
    for _ in range(steps):
        residual, slope = frame.missed(change, every)
        across = prior @ slope.T if isinstance(prior, np.ndarray) else prior * slope.T
        root = cholesky(slope @ across + (frame.covariance(change) if noise is None else noise), lower=True)
        apart = residual + slope @ change.ravel()
        move = (across @ cho_solve((root, True), apart)).reshape(change.shape) - change
        change = change + np.clip(move, -STEP, STEP)
        if np.abs(move).max() < STEP / 10:
            break
    return change, root, apart


def _everywhere(panel: Panel, patch_mm: float, template: Template, shift: float) -> Array:
    """ln r/r0 (cells, rows, columns) of a template about every cell's centre, `shift` further on.

    About another cell it looks the same: it is laid once over a larger panel, and cut out for every cell.
    """
    across, down = panel.centres_mm()
    large = Panel(2 * panel.rows - 1, 2 * panel.columns - 1, panel.pitch_mm)
    numbers = (template.outer_mm, template.inner_mm, template.inside, -1.0, 0.0, 0.0)
    pattern, _ = oval_pressure(large, patch_mm, Disc(across[-1] + shift, down[-1] + shift, *numbers))
    windows = np.lib.stride_tricks.sliding_window_view(pattern, panel.shape)[::-1, ::-1]
    return windows.reshape(-1, *panel.shape)


def _unit(columns: Array) -> Array:
    unit: Array = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    return unit
