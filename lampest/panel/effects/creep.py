"""Creep: a change of all cells alike since the unloaded frames, which no load makes."""

from lampest.panel.effects.sized_effect import SizedEffect


class FilmCreep(SizedEffect):
    """A change of all cells since the unloaded frames; the size is that of ln r."""

    limits = (-1.0, 1.0)
    prior = 0.05  # assumed, as by temperature
    # Assumed: change of each untouched cell apart from the others, creep of a film within seconds.
    of_cell = 3e-3
