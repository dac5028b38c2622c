"""The formulations that a run's file may name."""

from lampest.solvers.ipopt.formulation import Formulation
from lampest.solvers.ipopt.nodal import Nodal
from lampest.solvers.ipopt.per_pixel import PerPixel

__all__ = ["FORMULATIONS", "Formulation", "Nodal", "PerPixel"]
FORMULATIONS: dict[str, Formulation] = {form.kind: form for form in (Nodal(), PerPixel())}
