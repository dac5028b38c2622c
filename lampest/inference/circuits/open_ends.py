"""Ends of lines that a scene leaves out, and that readings may not show.

Idle sensed lines are held or float, resistors stay at driven lines or a switch takes them off, and
an uncut sheet of film conducts between neighbouring strips. With such an end other cells give
nearly the same readings. The pair of frames is fitted with each end. Where it is about as probable
as without, by the evidence of loads (`FittedPair.density_of_loads`) and by how usual the end is,
the circuit is doubtful. An end that the readings only do not exclude is named.
"""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from lampest.files.document import in_one_line
from lampest.files.levels import DOUBTFUL_GAIN
from lampest.panel.lines import as_tuple, opposite
from lampest.panel.readouts.wiring import NeighbourLeaks
from lampest.panel.scene import Scene

if TYPE_CHECKING:
    from lampest.inference.circuits.explanation import ComparedFrames, Explanation

# −2 ln odds beyond which an end is excluded
EXCLUDED = 12.0
# −2 ln prior odds of a sheet without cuts, so that it is a doubt from DOUBTFUL_GAIN on: under soft
# loads and feet leaks that are not there gain nearly as much
SHEET_COST = DOUBTFUL_GAIN + EXCLUDED
# Leaks that are tried, over the median cell
LEAKS_OVER_CELLS = (8.0, 4.0, 2.0, 1.4, 1.0, 0.7, 0.5)
# Median change of ln r by an end that is named, and by one that is a doubt
MIN_SHIFT = 0.03
DOUBTFUL_SHIFT = 0.05


class LeftOutEnd(NamedTuple):
    """An end of lines that a scene leaves out.

    Attributes
    ----------
    words : str
        The end in words.
    key : str
        Key that states it, such as 'readout.idle_load_ohm'.
    cost : float
        −2 ln prior odds of the end; 0 where it is as usual as none.
    cure : str
        How to find out, in words.
    scenes : tuple of (mapping, Scene)
        Entries and scenes with the end, the smallest effect first.
    """

    words: str
    key: str
    cost: float
    cure: str
    scenes: tuple[tuple[Mapping[str, Any], Scene], ...]


def open_ends(scene: Scene, cell_ohm: float = 1000.0) -> Iterator[LeftOutEnd]:
    """Yield the ends that a scene leaves out.

    Parameters
    ----------
    scene : Scene
    cell_ohm : float
        Median resistance of the cells.
    """
    if scene.purpose == "mat" and scene.leak_ohm is None and max(scene.panel.shape) > 1:
        sides = [
            side
            for side, lines in zip(("rows", "columns"), scene.panel.shape, strict=True)
            if lines > 1
        ]
        scenes = []
        for factor in LEAKS_OVER_CELLS:
            leaks = dict.fromkeys(sides, float(f"{factor * cell_ohm:.2g}"))
            with suppress(ValueError):  # the scene may have faults that leave no place for leaks
                leaking = replace(scene, leak_ohm=NeighbourLeaks(**leaks))
                scenes.append(({"leak_ohm": leaks}, leaking))
        yield LeftOutEnd(
            "leaks between neighbouring strips, which one uncut sheet has",
            "leak_ohm",
            SHEET_COST,
            "measure them with an ohmmeter, or press a few cells and leave the others free",
            tuple(scenes),
        )
    circuit: Any = scene.readout
    if getattr(circuit, "idle_load_ohm", 0.0) is None:
        from lampest.panel.circuit import nominal_terminations  # for circuits with the key alone

        sensed = opposite(circuit.driven)
        if not nominal_terminations(circuit).sensing.connected(own=False).size:
            yield LeftOutEnd(
                f"ends of idle {sensed}, as of outputs at LOW",
                "readout.idle_load_ohm",
                0.0,
                f"state what idle {sensed} end in (.inf: nothing)",
                _with_entries(scene, {"idle_load_ohm": 0.0}),
            )
    may_stay = getattr(circuit, "idle_stays", True) is False
    if may_stay and 0 < min(as_tuple(circuit.idle_ohm), default=inf) < inf:
        yield LeftOutEnd(
            f"resistors that stay at driven {circuit.driven}",
            "readout.idle_stays",
            0.0,
            "does a switch take them off while a line is driven?",
            _with_entries(scene, {"idle_stays": True}),
        )


def _with_entries(
    scene: Scene, entries: Mapping[str, Any]
) -> tuple[tuple[Mapping[str, Any], Scene], ...]:
    """Return entries of the readout with their scene; nothing where the circuit has no place."""
    circuit: Any = scene.readout
    with suppress(ValueError):
        readout = replace(circuit, **entries)
        return (({"readout": entries}, replace(scene, readout=readout)),)
    return ()


class TriedEnd(NamedTuple):
    """An explanation of the frames with an end that the scene leaves out.

    Attributes
    ----------
    end : LeftOutEnd
    entries : mapping
        Entries of the scene that state it.
    gain : float
        Decrease of −2 ln density of the loaded frame by the end.
    shift : float
        ln of the cells with the end over those without: the median of the unloaded panel, or of
        the moved cells under load if that is larger.
    """

    end: LeftOutEnd
    entries: Mapping[str, Any]
    gain: float
    shift: float

    @property
    def text(self) -> str:
        """The entries, the end, and what it does to the cells, in words."""
        factor = float(np.exp(self.shift))
        size = f"{100 * abs(factor - 1):.2g} % {'larger' if factor > 1 else 'smaller'}"
        return f"{in_one_line(self.entries)} ({self.end.words}), with which cells are {size}"


def undetermined_ends(
    specified: "Explanation", frames: "ComparedFrames"
) -> tuple[list[str], list[str]]:
    """Return the ends that the scene leaves out and that the frames do not exclude, in words.

    Parameters
    ----------
    specified : Explanation
        Explanation by the scene's circuit.
    frames : ComparedFrames

    Returns
    -------
    doubts : list of str
        Ends that are about as likely as none, and change the cells.
    remarks : list of str
        Other ends.
    """
    doubts = list[str]()
    remarks = list[str]()
    if specified.pair is None:
        return doubts, remarks
    for end in open_ends(specified.alternative.scene, float(np.median(specified.fits[0].cells))):
        possible = _possible(end, specified, frames)
        likeliest = max(possible, key=lambda tried: tried.gain, default=None)
        furthest = max(possible, key=lambda tried: abs(tried.shift), default=None)
        if likeliest is None or furthest is None or abs(furthest.shift) < MIN_SHIFT:
            continue
        probable = likeliest.gain > end.cost - EXCLUDED
        if probable and abs(likeliest.shift) > DOUBTFUL_SHIFT:
            doubts.append(f"about as likely is {likeliest.text}: {end.cure}")
        else:
            remarks.append(f"they do not exclude {furthest.text}")
    return doubts, remarks


def _possible(
    end: LeftOutEnd, specified: "Explanation", frames: "ComparedFrames"
) -> list[TriedEnd]:
    """Return the sizes of an end that the frames do not exclude.

    The search ends at a size with which no cells give the readings, or that is less probable than
    the best one by twice EXCLUDED: larger ones are still less probable.
    """
    from lampest.inference.circuits.explanation import Explanation  # a scene's words do without

    assert specified.pair is not None
    without = specified.pair.density_of_loads
    tried = []
    most = 0.0
    near = specified
    for entries, scene in end.scenes:
        alternative = replace(specified.alternative, scene=scene, kind=end.key)
        further = Explanation.of(alternative, frames, near)
        if further is None or further.pair is None:
            break
        near = further
        gain = without - further.pair.density_of_loads
        most = max(most, gain)
        if gain < most - 2 * EXCLUDED:
            break
        resting, loaded = (
            np.log(changed.cells / fit.cells)
            for changed, fit in zip(further.fits, specified.fits, strict=True)
        )
        moved = specified.pair.moved
        medians = [float(np.median(resting))]
        medians += [float(np.median(loaded[moved]))] if moved.any() else []
        tried.append(TriedEnd(end, entries, gain, max(medians, key=abs)))
    return [one for one in tried if one.gain > most - EXCLUDED]
