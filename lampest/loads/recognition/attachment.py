"""A load from when it came until it left: where it is, how large, whether it sucks, breathes and pumps."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import exp, hypot, inf, log
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from lampest.files.levels import NOISE_REACH, SIGNIFICANT
from lampest.loads.recognition.breathing import MAX_LOG_ODDS, Breathing
from lampest.loads.recognition.candidates import UNIFORM, under
from lampest.loads.recognition.evidence import RARE_LOG_ODDS, Verdict
from lampest.loads.recognition.observation import Observation
from lampest.loads.recognition.pumping import Pumping
from lampest.panel.panel import Array, Panel

Pair = tuple[float, float]


@dataclass(frozen=True)
class Attachment:
    """A load from when it came until it left.

    Attributes
    ----------
    sucks : float
        Probability.
    since_s, until_s : float or float or None
        s; until None: it is there. x_mm and so on : (value, standard deviation), None where it is not known.
    cells : int
        How many it touches.
    conductance_s : Pair or None
        Increase of their conductance since rest.
    breath : Breathing
        Of its suction, from all windows.
    sucks_s, moved_s : float or None or tuple of float
        When it began to suck, None: it does not; when it moved.
    clear : float
        ln of how much more probable it is than an unloaded panel.
    track : Pumping or None
        Its suction from then on, None: it has not been followed yet.
    """

    sucks: float
    since_s: float
    x_mm: Pair
    y_mm: Pair
    diameter_mm: Pair | None = None
    suction_kpa: Pair | None = None
    cells: int = 0
    area_mm2: Pair | None = None
    conductance_s: Pair | None = None
    until_s: float | None = None
    breath: Breathing = Breathing()
    sucks_s: float | None = None
    moved_s: tuple[float, ...] = ()
    clear: float = 0.0
    track: Pumping | None = None

    @property
    def breathes(self) -> float:
        """Probability that its suction changes as breathing does, given that it sucks; 1/2 where nothing was seen."""
        return self.breath.probability

    @property
    def breathing_hz(self) -> Pair | None:
        """Rate at which its suction changes."""
        return self.breath.hertz

    @property
    def breathing_depth(self) -> Pair | None:
        """Relative amplitude of that."""
        return self.breath.depth

    @property
    def pumps(self) -> float:
        """Probability that its suction decays and is pumped up again, given that it sucks; 1/2 where nothing shows."""
        return 1 / (1 + exp(-self._pumping))

    @property
    def lives(self) -> float:
        """Probability that it is a mouth, given that it sucks: the odds of both signs, which are independent."""
        breathes = max(log(max(self.breathes, 1e-9) / max(1 - self.breathes, 1e-9)), -RARE_LOG_ODDS)
        return 1 / (1 + exp(-breathes - self._pumping))

    @property
    def _pumping(self) -> float:
        return 0.0 if self.track is None else min(self.track.odds, MAX_LOG_ODDS)

    @property
    def present(self) -> bool:
        """Whether it is still there."""
        return self.until_s is None

    @property
    def place(self) -> tuple[float, float]:
        """Centre, mm."""
        return self.x_mm[0], self.y_mm[0]

    @property
    def size(self) -> float:
        """Diameter, mm; without one infinite: it may be anywhere."""
        return inf if self.diameter_mm is None else self.diameter_mm[0]

    @property
    def width(self) -> float:
        """mm; of a load without a diameter the edge of a square of its area."""
        return self.size if self.diameter_mm or self.area_mm2 is None else self.area_mm2[0] ** 0.5

    def distance(self, place: tuple[float, float]) -> float:
        """Return the distance to a place, mm."""
        return hypot(self.place[0] - place[0], self.place[1] - place[1])

    def continued(self, later: "Attachment") -> "Attachment":
        """Return the later state.

        The earlier one where it sucked and now shows less: leaking suction leaves no shape.
        """
        if self.sucks > 0.5 > later.sucks and later.clear < self.clear:
            return self
        far = NOISE_REACH * max(1.0, hypot(self.x_mm[1], self.y_mm[1], later.x_mm[1], later.y_mm[1]))
        moved = (*self.moved_s, later.since_s) if self.distance(later.place) > far else self.moved_s
        began = later.since_s if self.sucks_s is None and later.sucks > 0.5 else self.sucks_s
        same = replace(later, since_s=self.since_s, breath=self.breath, track=self.track)
        return replace(same, sucks_s=began, moved_s=moved)


def attachments_of(frame: Observation, verdict: Verdict, since: float) -> list[Attachment]:
    """Return all loads of the most probable candidate; of no shape, a load for each group of changed cells."""
    best, attachments, first = verdict.best, list[Attachment](), 0
    clear = best.evidence - max(fit.evidence for fit in verdict.fits if fit.candidate in UNIFORM)
    cells = _ChangedCells.of(frame)
    for candidate, own in best.loads:
        disc, after = candidate.disc(own), first + len(own)
        covariance, first = best.covariance[first:after, first:after], after
        groups = cells.groups() if disc is None else [cells.moved & under(frame.baseline.scene.panel, disc)]
        for group in groups:
            attachment = replace(cells.load(group), sucks=verdict.sucks_at(disc), since_s=since, clear=clear)
            if disc is not None:
                apart = frame.baseline.scene.panel.pitch_mm / 2
                pairs: dict[str, Any] = {"x_mm": (disc.x_mm, apart), "y_mm": (disc.y_mm, apart)}
                for name, (value, slopes) in candidate.report(own).items():
                    pairs[name] = value, float(np.sqrt(slopes @ covariance @ slopes))
                attachment = replace(attachment, sucks_s=since if attachment.sucks > 0.5 else None, **pairs)
            attachments.append(attachment)
    return attachments


@dataclass(frozen=True, eq=False)
class _ChangedCells:
    """Cells of a frame whatever stands on them.

    Attributes
    ----------
    change : (rows, columns), ln r/r0 of every cell.
    moved : (rows, columns), cells that differ clearly from those at rest.
    more, errors : (rows, columns), conductance beyond that at rest in siemens, and its standard deviation.
    panel : the panel of the cells.
    """

    change: Array
    moved: NDArray[np.bool_]
    more: Array
    errors: Array
    panel: Panel

    @classmethod
    def of(cls, frame: Observation) -> "_ChangedCells":
        """Estimate the cells of a frame with a Gaussian prior of standard deviation 1."""
        shape = frame.measured.shape
        cells = frame.cells(np.zeros(shape), np.eye(frame.measured.size))
        change, sd = cells.state.reshape(shape), np.sqrt(np.diag(cells.covariance)).reshape(shape)
        moved = np.abs(change) > NOISE_REACH * np.hypot(sd, frame.baseline.model_errors.resting_sd(frame.seconds))
        resting = np.exp(-frame.baseline.logarithm)
        more, errors = resting * np.expm1(-change), resting * np.exp(-change) * sd
        return cls(change, moved, more, errors, frame.baseline.scene.panel)

    def groups(self) -> list[NDArray[np.bool_]]:
        """Return the groups of neighbouring changed cells that noise cannot make; all cells where there is none."""
        first, second, _ = self.panel.neighbours
        linked = self.moved.flat[first] & self.moved.flat[second]
        pairs = coo_array((linked[linked], (first[linked], second[linked])), shape=2 * (self.moved.size,))
        _, labels = connected_components(pairs)
        groups = [labels.reshape(self.moved.shape) == label for label in dict.fromkeys(labels[self.moved.ravel()])]
        sure = [
            group for group in groups if abs(self.more[group].sum()) > SIGNIFICANT * np.hypot.reduce(self.errors[group])
        ]
        return sure or [self.moved]

    def load(self, group: NDArray[np.bool_]) -> Attachment:
        """Return the centre, area and conductance of a group of cells."""
        weight, apart = np.abs(self.change) * (group if group.any() else 1.0), self.panel.pitch_mm / 2
        x, y = (float(np.nansum(weight * line) / weight.sum()) for line in self.panel.places_mm)
        count, square = int(group.sum()), self.panel.pitch_mm**2
        conductance = float(self.more[group].sum()), float(np.hypot.reduce(self.errors[group]))
        area = count * square, square * (max(count, 1) / 3) ** 0.5
        return Attachment(0.0, 0.0, (x, apart), (y, apart), cells=count, area_mm2=area, conductance_s=conductance)


def continued_by(
    before: Sequence[Attachment], loads: Sequence[Attachment], time: float, *, again: bool = False
) -> tuple[Attachment, ...]:
    """Return all attachments once loads were recognised since a step at that time; those nearest by are continued.

    The others have left with the step. again : not the first time since then: nothing leaves without a step, so they
    stay; a load that was seen since the step alone was a part of another.
    """
    attachments, left = list(before), [number for number, attachment in enumerate(before) if attachment.present]
    apart = [min((attachments[number].distance(load.place) for number in left), default=inf) for load in loads]
    for load in (loads[number] for number in np.argsort(apart, kind="stable")):
        near = min(left, key=lambda number: attachments[number].distance(load.place), default=None)
        if near is not None and attachments[near].distance(load.place) < max(attachments[near].size, load.size):
            attachments[near] = attachments[near].continued(load)
            left.remove(near)
        else:
            attachments.append(load)
    if again:
        return tuple(
            attachment
            for number, attachment in enumerate(attachments)
            if number not in left or attachment.since_s < time
        )
    for number in left:
        attachments[number] = replace(attachments[number], until_s=time)
    return tuple(attachments)
