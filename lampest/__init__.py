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
    "Recording": "lampest.recording",
    "Scene": "lampest.scene",
    "TwoPointReadout": "lampest.scene",
    "Panel": "lampest.panel",
    "InputError": "lampest.errors",
    "Estimator": "lampest.estimator",
    "Bounds": "lampest.estimator",
    "Settings": "lampest.solvers.solution",
    "Misfit": "lampest.terms",
    "CellResistance": "lampest.terms",
    "RelativeChange": "lampest.terms",
    "Gradient": "lampest.terms",
    "GradientOfRelativeChange": "lampest.terms",
    "LogRatio": "lampest.terms",
    "TotalVariation": "lampest.terms",
    "TotalVariationOfChange": "lampest.terms",
    "Arrival": "lampest.terms",
    "Squared": "lampest.terms.losses",
    "Huber": "lampest.terms.losses",
    "Absolute": "lampest.terms.losses",
    "two_point_resistance": "lampest.kirchhoff",
    "read_results": "lampest.results",
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
    estimator = import_module("lampest.estimator").Estimator(tuple(terms), **options)
    return import_module("lampest.sequence").reconstruct(recording, estimator)
