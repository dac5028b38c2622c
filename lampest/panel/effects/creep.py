"""Creep: a change of all cells alike since the unloaded frames, which no load makes."""

from lampest.panel.effects.sized_effect import SizedEffect


class FilmCreep(SizedEffect):
    """A change of all cells since the unloaded frames; the size is that of ln r."""

    limits = (-1.0, 1.0)

    def sentence(self, size: float, deviation: float) -> str:
        return (
            f"cells that nobody touched changed together by {100 * size:+.2g} "
            f"+- {100 * deviation:.1g} %: creep, temperature or the supply"
        )
