"""Inequalities that readings of a circuit keep whatever its cells are: tests that need no estimate."""

from dataclasses import dataclass

from lampest.panel.panel import Array


@dataclass(frozen=True, eq=False)
class FreeTest:
    """law : what must hold, in words. excess : by how many σ the readings of every frame break it, at worst (frames).

    count : how many inequalities of a frame the worst was taken from.
    """

    law: str
    excess: Array
    count: int
