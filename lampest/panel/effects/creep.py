"""Creep: a change of all cells alike since the unloaded frames, which no load makes."""

from lampest.panel.effects.sized_effect import SizedEffect


class FilmCreep(SizedEffect):
    """A change of all cells since the unloaded frames; the size is that of ln r."""

    limits = (-1.0, 1.0)
    prior = 0.05  # assumed, as by temperature
    # Assumed: changes of each untouched cell apart from the others. Films creep by a few percent
    # for each decade of minutes under load, and by a part of that at rest, with a scatter about it.
    of_cell_per_decade = 0.01
    of_cell_at_once = 2e-3
    # Of both, within the 40 s of a usual recording.
    of_cell = 3e-3

    def sentence(self, size: float, deviation: float) -> str:
        return (
            f"cells that nobody touched changed together by {100 * size:+.2g} "
            f"+- {100 * deviation:.1g} %: creep, temperature or the supply"
        )
