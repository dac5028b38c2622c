"""Leaks between neighbouring lines that begin while a panel is watched.

Water between two lines makes all cells of both seem to conduct more, from one end of the panel to
the other, which no load does. The cells' changes d = ln r/r0 under loads of any form have the
spike-and-slab prior of `lampest.inference.evidence`, beside a drift or a level that all share. A
leak of the conductance θ adds a θ to d of still cells, with

    a = K (∂f/∂θ),

where f are the readings and K is the inverse of their Jacobian. A leak that is named becomes a part
of the circuit.
"""

from dataclasses import replace

import numpy as np

from lampest.apps.recognition.detector import UNIFORM_SD
from lampest.apps.recognition.observation import Observation
from lampest.files.levels import MIN_EVIDENCE_GAIN, NOISE_REACH
from lampest.inference.assumptions import ASSUMED
from lampest.inference.evidence import (
    PARAMETER_COST,
    Changes,
    away_from_changed,
    mostly_still,
    usual_starts,
)
from lampest.panel.effects.line_effect import LineEffect, line_effects
from lampest.panel.panel import Array

Leaks = tuple[LineEffect, ...]
SECANT_STEP = 1e-3  # of the prior's standard deviation of a leak
# Share of the cells of a line that have fallen where it may leak: a mouth covers up to half of a
# row of ten, and raises some cells there.
MIN_FALLEN = 0.5


def leaks_of(frame: Observation) -> Leaks | None:
    """Return the leaks of a frame where they differ from those of its baseline; else None.

    The size of a known leak follows where the still cells contradict it by NOISE_REACH standard
    deviations. A further leak has to gain MIN_EVIDENCE_GAIN, and leaves most cells still. The
    circuit is linearised once, so that a large leak needs several calls.
    """
    known = frame.baseline.leaks
    # Further leaks are between lines of which MIN_FALLEN of the cells have fallen.
    panel = frame.panel
    level = frame.common_change
    sd = np.hypot(frame.free_sd.ravel(), np.sqrt(np.diag(level.uneven))).reshape(panel.shape)
    fallen = panel.present & (frame.free_map - level.mean < -NOISE_REACH * sd)
    shares = [
        fallen.sum(axis=axis) / np.maximum(panel.present.sum(axis=axis), 1) for axis in (1, 0)
    ]
    leaking = np.concatenate(shares) >= MIN_FALLEN
    further = [
        kind(lines)
        for kind in line_effects()
        if kind.key == "leaks"
        for lines in kind.places(*panel.shape)
        if all(leaking[line] and leaking[line + 1] for line in lines)
        and all(lines != own.lines for own in known)
    ]
    if not known and not further:
        return None
    change = frame.free_map.ravel()
    noise = frame.free.covariance + ASSUMED.creep**2 * np.eye(len(change)) + level.uneven
    common = UNIFORM_SD * level.unit
    own = [_column(frame, leak) for leak in known]
    alone = Changes(change, noise, np.column_stack([common, *own]))
    starts = usual_starts(change)
    score, moved = alone.selected(starts)
    best, sizes = known, alone
    least = score - MIN_EVIDENCE_GAIN - PARAMETER_COST
    for leak in further:
        beside = replace(alone, columns=np.column_stack([alone.columns, _column(frame, leak)]))
        lower, still_moved = beside.selected(starts)
        if lower < least and mostly_still(still_moved):
            least, moved, best, sizes = lower, still_moved, (*known, leak), beside
    if not best or not mostly_still(moved):
        return None
    mean, covariance = sizes.posterior(away_from_changed(~moved, panel.shape))
    clear = np.abs(mean) > NOISE_REACH * np.sqrt(np.diag(covariance))
    steps = np.where(clear, mean, 0.0)[1:]
    stepped = [
        replace(leak, size=max(leak.size + float(step) * leak.prior, 0.0))
        for leak, step in zip(best, steps, strict=True)
    ]
    remaining = tuple(leak for leak in stepped if leak.size > 0)
    return None if remaining == known else remaining


def _column(frame: Observation, leak: LineEffect) -> Array:
    """Return a of a leak, (cells,), in units of its prior."""
    network = frame.baseline.network(frame.free_map)
    more = replace(leak, size=SECANT_STEP * leak.prior).changed(network).reading()
    by_leak = (more - network.reading()).ravel() / SECANT_STEP
    return frame.free.conditioned.mean(by_leak)
