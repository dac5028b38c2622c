"""The formulations that a run's file may name."""

from lampest.formulations.formulation import Formulation
from lampest.formulations.nodal import Nodal
from lampest.formulations.per_pixel import PerPixel

__all__ = ["Formulation", "Nodal", "PerPixel"]
