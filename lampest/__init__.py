"""Cell resistances of passive resistive matrix sensors from two-point measurements.

    import lampest
    recording = lampest.Recording.load("data/lamprey_35mm.h5")
    found = lampest.reconstruct(recording, terms=[lampest.Misfit(), lampest.Gradient(weight=1e-3)])
    found.cell_resistance  # (frames, rows, columns) ohm
    found.relative_change  # percent of the unloaded panel

Names are loaded when they are first used, so that importing the package costs nothing.
"""

from importlib import import_module
from importlib.metadata import version
from typing import Any

__version__ = version("lampest")
_HOMES = {
    "Recording": "lampest.recording.recording",
    "Readings": "lampest.recording.readings",
    "Scene": "lampest.panel.scene",
    "TwoPointReadout": "lampest.panel.readouts",
    "Panel": "lampest.panel.panel",
    "Faults": "lampest.panel.scene",
    "Systematic": "lampest.panel.scene",
    "Temperature": "lampest.panel.scene",
    "Water": "lampest.panel.scene",
    "LoadedColumnsReadout": "lampest.panel.readouts",
    "InputError": "lampest.files.errors",
    "Estimator": "lampest.estimate.estimator",
    "Bounds": "lampest.estimate.estimator",
    "Stream": "lampest.estimate.stream",
    "Settings": "lampest.solvers.solution",
    "Misfit": "lampest.cost.terms",
    "CellResistance": "lampest.cost.terms",
    "RelativeChange": "lampest.cost.terms",
    "Gradient": "lampest.cost.terms",
    "GradientOfRelativeChange": "lampest.cost.terms",
    "LogRatio": "lampest.cost.terms",
    "TotalVariation": "lampest.cost.terms",
    "TotalVariationOfChange": "lampest.cost.terms",
    "Arrival": "lampest.cost.terms",
    "Squared": "lampest.cost.losses",
    "Huber": "lampest.cost.losses",
    "Absolute": "lampest.cost.losses",
    "two_point_resistance": "lampest.panel.readouts.two_point.exact",
    "read_results": "lampest.runs.results",
}
__all__ = [*_HOMES, "reconstruct"]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'lampest' has no attribute '{name}'")


def reconstruct(recording: Any, terms: Any, **options: Any) -> Any:
    """r̂ = argmin Σ weight·loss(residual) for every measured frame of a recording.

    Parameters
    ----------
    recording : a Recording.
    terms : the cost terms, such as [Misfit(), Gradient(weight=1e-3)].
    options : formulation, solver and bounds, as `Estimator` takes them.

    Returns a Reconstruction; `cell_resistance` (frames, rows, columns) ohm and `relative_change` percent are arrays.
    Raises InputError where the recording and the estimator do not fit.
    """
    estimator = import_module("lampest.estimate.estimator").Estimator(tuple(terms), **options)
    return import_module("lampest.estimate.sequence").reconstruct(recording, estimator)
