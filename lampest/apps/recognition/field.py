"""Explanations of one frame without a shape: no load, an equal change of all cells, or any field.

In a field each cell has one of four states, from quiet to strongly changed, with a Potts prior on
neighbours. The evidence integrates over the cells about the most probable ones.
"""

from dataclasses import dataclass

import numpy as np

from lampest.apps.recognition.observation import Observation, Whitening, outliers
from lampest.apps.recognition.sucking_disc import UNEVENNESS
from lampest.files.levels import MAX_MEAN_SQUARE
from lampest.panel.panel import Array, Numbers, Panel

# Assumed standard deviations of ln r/r0 in the four states: no load, half a kPa, a few kPa, tens of
# kPa.
SD = np.array([0.005, 0.08, 0.4, 1.6])
# Assumed standard deviation of ln r/r0 by a change that all cells share, as by 5 kPa.
UNIFORM_SD = 1.0


@dataclass(frozen=True, eq=False)
class CellsUnderPrior:
    """The most probable change of all cells under a prior.

    Attributes
    ----------
    change : array, shape (rows, columns)
        x = ln r/r0.
    evidence : float
        ln of the frame's probability under the prior, up to a constant common to all priors.
    chi2 : float
        χ² of the readings about x.
    contradicting : integer array
        Numbers of the readings that x does not explain as the others.
    """

    change: Array
    evidence: float
    chi2: float
    contradicting: Numbers

    @classmethod
    def of(
        cls, frame: Observation, start: Array, covariance: Array, log_prior: float = 0.0
    ) -> "CellsUnderPrior":
        """Return the explanation of a frame by cells x ~ N(0, P).

        The evidence is −½ eᵀ (A P Aᵀ + C)⁻¹ e − ½ ln det (A P Aᵀ + C) + ln P(prior).

        Parameters
        ----------
        frame : Observation
        start : array, shape (rows, columns)
            Initial x.
        covariance : array, shape (cells, cells)
            P.
        log_prior : float
            ln probability of the prior itself.
        """
        most_probable = frame.cells(start, covariance)
        change = most_probable.state.reshape(start.shape)
        misfit = Whitening.of(most_probable.noise) @ frame.residual(change)
        chi2 = float(misfit @ misfit)
        contradicting = np.zeros(0, dtype=np.intp)
        if chi2 >= MAX_MEAN_SQUARE * frame.measured.size:
            contradicting = outliers(most_probable.whitening, most_probable.apart)
        evidence = log_prior - most_probable.misfit / 2 - most_probable.whitening.volume
        return cls(change, evidence, chi2, contradicting)


def without_load(frame: Observation) -> list[CellsUnderPrior]:
    """Return the explanations by no load, and by a common change of all cells.

    In air that is a drift, which is equal in all of them. Under water it is a level, an equal
    pressure, to which films respond differently.
    """
    cells = frame.measured.size
    start = np.zeros(frame.measured.shape)
    common = _levelled(frame) if frame.water.any() else np.full((cells, cells), UNIFORM_SD**2)
    priors = np.zeros((cells, cells)), common
    return [CellsUnderPrior.of(frame, start, covariance) for covariance in priors]


def _levelled(frame: Observation) -> Array:
    """Return the covariance (cells, cells) of ln r under the pressure that most cells show."""
    response = frame.baseline.response
    at_rest = response.logarithm(frame.water)
    pressures = response.pressure(at_rest + frame.free_map / response.gains) - frame.water
    pressure = np.median(pressures[frame.panel.present])
    change, _ = frame.change(np.full(frame.measured.shape, pressure))
    unit = change.ravel() / max(float(np.abs(np.median(change))), np.finfo(float).tiny)
    uneven, _ = frame.baseline.film_parts(np.stack([change, *np.zeros((2, *change.shape))]))
    scatter = UNEVENNESS * frame.baseline.model_errors.response
    return UNIFORM_SD**2 * np.outer(unit, unit) + scatter**2 * uneven


def field_fit(frame: Observation) -> tuple[CellsUnderPrior, Observation]:
    """Return the most probable field, and the frame without outliers.

    x = ln r/r0 is Gaussian with the σ of each cell's state, correlated between neighbours. The
    states are those of a map of the cells, or of a first field, and have a Potts prior.
    """
    field = _of_two_maps(frame)
    if not field.contradicting.size:
        return field, frame
    calm = frame.without(field.contradicting)
    return max((field, frame), (_of_two_maps(calm), calm), key=lambda pair: pair[0].evidence)


def _of_two_maps(frame: Observation) -> CellsUnderPrior:
    first = _with_states(frame, frame.map)
    return max(first, _with_states(frame, first.change), key=lambda field: field.evidence)


def _with_states(frame: Observation, start: Array) -> CellsUnderPrior:
    """Return the most probable field with the states of ln r/r0 = `start` (rows, columns).

    `start` is also the start.
    """
    of_cells = states(frame.panel, start)
    log_prior = -potts_cost(frame.panel, of_cells)
    return CellsUnderPrior.of(frame, start, prior(frame, SD[of_cells].ravel()), log_prior)


def prior(frame: Observation, sd: Array) -> Array:
    """Return the prior covariance of ln r/r0 of cells with these standard deviations.

    Neighbours are correlated.
    """
    shared = frame.baseline.model_errors.common + frame.baseline.model_errors.near
    return np.outer(sd, sd) * ((1 - shared) * np.eye(sd.size) + shared * frame.baseline.near)


def states(panel: Panel, change: Array) -> Numbers:
    """Return the state of each cell, 0 to 3 for quiet to strongly changed.

    The changes of the cell and of its neighbours determine the state.
    """
    square = change.ravel() ** 2
    first, second, _ = panel.neighbours
    cell = np.concatenate([first, second])
    neighbour = np.concatenate([second, first])
    near = np.bincount(cell, square[neighbour], square.size).astype(float)
    sides = np.bincount(cell, minlength=square.size)
    # a cell at the border stands for its missing neighbours
    near += np.maximum(4 - sides, 0) * square
    limits = np.sqrt(SD[1:] * SD[:-1])
    return np.asarray(np.digitize(np.sqrt(0.6 * square + 0.1 * near), limits)).reshape(change.shape)


def potts_cost(panel: Panel, of_cells: Numbers) -> float:
    """Return −ln P of the states in the Potts field.

    Each pair of unlike neighbours costs 1 (an assumption); a constant normalises the probability.
    """
    first, second, _ = panel.neighbours
    unlike = np.count_nonzero(of_cells.flat[first] != of_cells.flat[second])
    return float(unlike + np.log1p(3 * np.exp(-4)) * panel.present.sum())
