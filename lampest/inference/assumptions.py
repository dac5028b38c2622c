"""Assumptions on cells and circuits that no scene states."""

from dataclasses import dataclass

# Assumed changes of each untouched cell apart from the others. Films creep by a few percent for
# each decade of minutes under load, and by a part of that at rest, with a scatter about it.
CREEP_PER_DECADE = 0.01
CREEP_AT_ONCE = 2e-3


@dataclass(frozen=True)
class Assumptions:
    """Prior standard deviations; of log r unless a unit is given.

    Attributes
    ----------
    common_change : float
        Change of all cells alike since the unloaded frames, as by temperature.
    common_step : float
        Change of all cells alike from frame to frame, as by temperature and supply: some percent.
    creep : float
        Change of each untouched cell since the unloaded frames, by drift and scatter together.
    jump : float
        Change between frames under a load, and value of a cell that no reading determines.
    scatter, scatter_factor : float
        Scatter s of unloaded cells: films of one batch scatter by a tenth, worn ones by 0.4. The
        prior of ln s has mean ln scatter and standard deviation ln scatter_factor.
    """

    common_change: float = 0.05
    common_step: float = 0.1
    creep: float = 3e-3  # of both, within the 40 s of a usual recording
    jump: float = 1.0
    scatter: float = 0.1
    scatter_factor: float = 2.0


ASSUMED = Assumptions()
