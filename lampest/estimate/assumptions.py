"""Assumptions on cells and circuits that no scene states."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Assumptions:
    """Standard deviations before anything is read, of log r where no unit is given.

    Attributes
    ----------
    common_change : float
        Of all cells alike since rest: by so much temperature moves them.
    common_step : float
        Of all cells alike from frame to frame: by some percent temperature and supply move them, not by more.
    creep : float
        Of each cell on its own, by which films creep in seconds.
    skirt, skirt_cells : float
        Of changes in the skirt of a load, or under a load that covers many cells, and the distance in cells over which
        they are alike.
    jump : float
        Of jumps between frames, and of cells that no reading determines.
    scatters : tuple of float
        Of unloaded cells, all likely: films of one batch scatter by a tenth, worn ones by 0.4.
    channel_ohm : float
        Of a multiplexer's channels, ohm (CD74HC4067, data sheet: any two differ by 10 ohm).
    """

    common_change: float = 0.05
    common_step: float = 0.1
    creep: float = 3e-3
    skirt: float = 0.3
    skirt_cells: float = 1.5
    jump: float = 1.0
    scatters: tuple[float, ...] = (0.03, 0.1, 0.2, 0.4)
    channel_ohm: float = 3.0


ASSUMED = Assumptions()
