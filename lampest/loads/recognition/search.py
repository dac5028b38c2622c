"""Where fits begin: round templates laid over the cells and over the whitened readings, a matched filter."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lampest.loads.recognition.observation import Observation, Whitening
from lampest.loads.shapes.disc import Disc, pressure_at_places
from lampest.loads.shapes.shape import Template
from lampest.panel.panel import Array, Panel

MAP_SD = 0.5  # of ln r/r0 before the readings, on the map that templates are laid over; an assumption
FULL_KPA, HOLLOW_KPA = (0.0, 8.0), (-6.0, 30.0)  # inside and under the rim, where a fit begins


@dataclass(frozen=True, eq=False)
class DiscSearch:
    """Templates about every cell's centre and between four of them.

    discs : (discs) what a fit begins with where one of them matches, one template after the other. changes : (cells,
    discs) ln r/r0 of unit length.
    """

    panel: Panel
    templates: tuple[Template, ...]
    discs: tuple[Disc, ...]
    changes: Array

    @classmethod
    def over(cls, panel: Panel, patch_mm: float, templates: tuple[Template, ...]) -> "DiscSearch":
        """All templates laid over a panel."""
        discs, patterns = [], []
        x, y = panel.places_mm[:, panel.present]
        apart = np.round([x - x[:, None], y - y[:, None]], 6).reshape(2, -1)  # from every cell to every other
        ways, way = np.unique(apart, axis=1, return_inverse=True)
        for template in templates:
            size = (template.outer_mm, template.inner_mm)
            pressures = HOLLOW_KPA if template.inner_mm else FULL_KPA
            for shift in (0.0, panel.pitch_mm / 2):
                numbers = (template.outer_mm, template.inner_mm, template.inside, -1.0, 0.0, 0.0)
                pattern, _ = pressure_at_places(ways, patch_mm, Disc(shift, shift, *numbers))
                patterns.append(pattern[way.ravel()].reshape(len(x), -1))
                discs += [Disc(*at, *size, *pressures, 0.0, 0.0) for at in zip(x + shift, y + shift, strict=True)]
        changes = np.zeros((panel.crossings, len(discs)))
        changes[panel.present.ravel()] = np.concatenate(patterns).T
        return cls(panel, templates, tuple(discs), unit(changes))

    @cached_property
    def faint(self) -> NDArray[np.bool_]:
        """(discs) whether it is looked for in the errors of the readings, too."""
        return np.repeat([template.faint for template in self.templates], len(self.discs) // len(self.templates))

    @cached_property
    def places(self) -> Array:
        """(discs, 2) their centres, mm."""
        return np.array([disc[:2] for disc in self.discs])

    def readings(self, frame: Observation) -> Array:
        """(cells, faint discs) ohm: what they add to the readings of a panel at rest."""
        return np.asarray(frame.slope(np.zeros(self.panel.shape)) @ self.changes[:, self.faint])

    def starts(self, frame: Observation, rest: Whitening) -> list[Disc]:
        """Where each template fits a map of the cells best, then where it fits the errors of a panel at rest.

        The map shows strong loads, whose errors are not in proportion; the errors show weak ones through noise.
        """
        size = len(self.discs) // len(self.templates)
        on_map = (self.changes.T @ np.tanh(cell_map(frame)).ravel()).reshape(-1, size)
        errors = np.full(len(self.discs), -np.inf)
        errors[self.faint] = unit(rest @ self.readings(frame)).T @ (rest @ frame.residual())
        order = np.argsort(-on_map.max(axis=1))
        best = [template * size + int(np.argmax(on_map[template])) for template in order]
        in_errors = enumerate(errors.reshape(-1, size))
        best += [number * size + int(np.argmax(row)) for number, row in in_errors if self.templates[number].faint]
        return [self.discs[number] for number in dict.fromkeys(best)]

    def beside(self, change: Array, discs: Sequence[Disc]) -> Disc | None:
        """Where one more load may stand on a map of ln r/r0 (rows, columns), clear of those discs; None: nowhere."""
        left = np.tanh(change)
        across, down = self.panel.places_mm
        for disc in discs:
            distance = np.hypot(across - disc.x_mm, down - disc.y_mm)
            left[distance < (disc.diameter_mm + self.panel.pitch_mm) / 2] = 0.0
        score = self.changes.T @ left.ravel()
        return self.discs[int(np.argmax(score))] if score.max() > 0 else None


def cell_map(frame: Observation) -> Array:
    """ln r/r0 of every cell, (rows, columns): of independent cells with a standard deviation of MAP_SD."""
    nothing = np.zeros(frame.measured.shape)
    return frame.cells(nothing, MAP_SD**2 * np.eye(nothing.size)).state.reshape(nothing.shape)


def unit(columns: Array) -> Array:
    """Columns over their length."""
    return np.asarray(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300))
