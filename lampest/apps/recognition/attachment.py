"""Attachments: loads over time, with place and size.

Each attachment has the probabilities that it sucks, breathes and pumps.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import hypot, inf

import numpy as np
from scipy.special import expit, logit

from lampest.apps.recognition.breath import Pair, breath
from lampest.apps.recognition.breathing import MAX_LOG_ODDS, MIN_WINDOW_S, WINDOW_S, Breathing
from lampest.apps.recognition.detector import Verdict
from lampest.apps.recognition.hypotheses import SILENT_LOG_ODDS
from lampest.apps.recognition.observation import Observation
from lampest.apps.recognition.pumping import BLOCK_S, Pumping
from lampest.apps.recognition.steady_frames import SteadyFrames, changes_without_water
from lampest.apps.recognition.suction import UNRISEN, contacts_of, inner_cells, rise_odds, under
from lampest.apps.recognition.swings import Patterns
from lampest.apps.recognition.watch_parts import Frames, Hold
from lampest.files.levels import NOISE_REACH, SIGNIFICANT
from lampest.panel.panel import Array, Mask, Panel

# Largest ln odds of suction that one recognition leaves to later ones: all have the same film and
# unloaded frames, and err together.
MAX_LOOK_LOG_ODDS = 3.0
JUDGED_S = 1.0  # between two judgements of breath
# Recognitions of an attachment whose suction is kept: four hours, and then every second one.
MAX_SUCTIONS = 256
CORNER_PITCHES = 1.5  # distance of two cells below which they touch, at least by their corners
MIN_SAMPLE_FRAMES = 3  # of a sample of suction, whose median is free of an outlier


@dataclass(frozen=True)
class Attachment:
    """A load from its arrival until it left.

    Attributes
    ----------
    sucks : float
        Probability that it sucks: the ln odds of all recognitions, each within MAX_LOOK_LOG_ODDS,
        add up. A recognition that would not show it has 1/2.
    since_s, until_s : float, float or None
        Times of arrival and departure, s; `until_s` is None while it is present.
    x_mm, y_mm, diameter_mm, area_mm2 : (float, float) or None
        Value and standard deviation; None where unknown.
    suctions : tuple of (float, float)
        Suction in kPa and its standard deviation at each recognition, thinned beyond MAX_SUCTIONS.
    pulled_kpa : (float, float) or None
        The strongest suction of all recognitions, kPa, and its standard deviation.
    cells : int
        Number of touched cells.
    conductance_s : (float, float) or None
        Increase of their conductance since rest, S, and its standard deviation.
    held : Hold or None
        Change of its cells when it was weakest in its place; None where it is not known.
    breath : Breathing
        Breath of its suction, from all windows.
    sucks_s : float or None
        Time at which it began to suck, s; None if it does not.
    moved_s : tuple of float
        Times at which it moved, s.
    placed_s : float
        Time since which it is in its place, s.
    looks : int
        Number of recognitions that show it.
    small : bool
        Whether it is so small that no cell would show that it sucks.
    clear : float
        ln evidence over that of an unloaded panel.
    track : Pumping or None
        Pumps of its suction; None before the first sample.
    patterns : Patterns or None
        Effects of swings of its suction on the readings; None where it does not suck.
    """

    sucks: float
    since_s: float
    x_mm: Pair
    y_mm: Pair
    diameter_mm: Pair | None = None
    suctions: tuple[Pair, ...] = ()
    pulled_kpa: Pair | None = None
    cells: int = 0
    area_mm2: Pair | None = None
    conductance_s: Pair | None = None
    until_s: float | None = None
    held: Hold | None = field(default=None, repr=False, compare=False)
    breath: Breathing = Breathing()
    sucks_s: float | None = None
    moved_s: tuple[float, ...] = ()
    placed_s: float = -inf
    looks: int = 1
    small: bool = False
    clear: float = 0.0
    track: Pumping | None = None
    patterns: Patterns | None = field(default=None, repr=False, compare=False)

    @property
    def breathes(self) -> float:
        """Probability that its suction oscillates like breathing, given that it sucks.

        The value is 1/2 before any observation.
        """
        return self.breath.probability

    @property
    def suction_kpa(self) -> Pair | None:
        """Typical suction, the median over all recognitions, kPa, and its standard deviation.

        The standard deviation is the median of theirs.
        """
        if not self.suctions:
            return None
        values, errors = np.array(self.suctions).T
        return float(np.median(values)), float(np.median(errors))

    @property
    def strongest_kpa(self) -> Pair | None:
        """Strongest suction, kPa, and its standard deviation; never weaker than the typical one."""
        typical = self.suction_kpa
        if typical is None or self.pulled_kpa is None:
            return typical
        return min(typical, self.pulled_kpa)

    @property
    def breathing_hz(self) -> Pair | None:
        """Rate of the oscillation, Hz, and its standard deviation."""
        return self.breath.hertz

    @property
    def breathing_depth(self) -> Pair | None:
        """Relative amplitude of the oscillation, and its standard deviation."""
        return self.breath.depth

    @property
    def pumps(self) -> float:
        """Probability that its suction is pumped up after a decay, given that it sucks.

        The value is 1/2 before any observation.
        """
        return float(expit(self._pumping))

    @property
    def pump_count(self) -> int | None:
        """Number of times that the suction was pumped up; None before the first sample."""
        return None if self.track is None else self.track.pumps[0]

    @property
    def pump_interval_s(self) -> float | None:
        """Mean time between pumps, s; None with less than two."""
        return None if self.track is None else self.track.interval_s

    @property
    def lives(self) -> float:
        """Probability that it is a mouth, given that it sucks.

        Its odds are the product of those of breath and of pumps.
        """
        # one mouth in ten never shows its breath; ln odds of pumps add
        breathes = max(logit(self.breathes), -SILENT_LOG_ODDS)
        return float(expit(breathes + self._pumping))

    @property
    def _pumping(self) -> float:
        return 0.0 if self.track is None else min(self.track.odds, MAX_LOG_ODDS)

    @property
    def present(self) -> bool:
        """Whether it has not left."""
        return self.until_s is None

    @property
    def place(self) -> tuple[float, float]:
        """Coordinates x and y of the centre, mm."""
        return self.x_mm[0], self.y_mm[0]

    @property
    def size(self) -> float:
        """Diameter, mm; infinite where it is unknown."""
        return inf if self.diameter_mm is None else self.diameter_mm[0]

    @property
    def width(self) -> float:
        """Diameter, mm; for a load without a diameter the edge of a square of its area."""
        return self.size if self.diameter_mm or self.area_mm2 is None else self.area_mm2[0] ** 0.5

    def distance(self, place: tuple[float, float] | Array) -> float:
        """Return the distance to a place, mm."""
        return hypot(self.place[0] - place[0], self.place[1] - place[1])

    def contains(self, contact: "Attachment") -> bool:
        """Return whether a contact without a shape lies under the disc, to the error of its place.

        Such a contact is a part of the rim.
        """
        reach = self.size / 2 + contact.x_mm[1]
        return contact.diameter_mm is None and self.distance(contact.place) < reach < inf

    def adjoins(self, load: "Attachment") -> bool:
        """Return whether the centre of one of two loads lies within the width of the other."""
        return self.distance(load.place) < max(self.width, load.width)

    def ended(self, time: float) -> "Attachment":
        """Return the attachment after it left at a time in s.

        Data that only later frames need are dropped.
        """
        return replace(self, until_s=time, patterns=None, held=None)

    def departed(
        self,
        frames: Frames,
        whitening: Array,
        frame: Observation,
        loads: Sequence["Attachment"],
    ) -> "Attachment":
        """Return an attachment whose cells show it no more, ended if it left beside other loads.

        Its departure was less than a step of a stronger load. It left when the change of the
        readings along its pattern was halved. Under a load that adjoins it may stay.
        """
        if self.held is None or not loads or any(map(self.adjoins, loads)):
            return self
        pattern = whitening @ (frame.slope() @ self.held.change.ravel() / frame.measured.ravel())
        course = [logarithm @ (whitening.T @ pattern) for _, logarithm in frames]
        left = course < np.mean([course[0], course[-1]])
        return self.ended(frames[np.argmax(left)][0])

    def sucks_with(self, look: float) -> float:
        """Return the probability that it sucks after a further recognition, which alone gives one.

        The odds are multiplied. Recognitions without a risen cell do not add up beyond UNRISEN: a
        suction that raises no cell raises none at any time.
        """
        before = min(logit(self.sucks), MAX_LOG_ODDS)
        odds = logit(look)
        least = min(logit(UNRISEN), odds)
        return float(expit(np.clip(before + odds, least, MAX_LOG_ODDS)))

    def beside(self, frame: Observation) -> "Attachment":
        """Return the attachment after a frame whose recognition does not show it as sucking.

        The cells that it raised before give the evidence. Leaking suction, or one beside another
        load, has no clear shape.
        """
        if self.held is None:
            return self
        look = expit(min(rise_odds(frame, self.held.risen), MAX_LOOK_LOG_ODDS))
        return replace(self, sucks=self.sucks_with(look))

    def continued(self, later: "Attachment") -> "Attachment":
        """Return the later state of the same load, with its history."""
        later = replace(later, sucks=self.sucks_with(later.sucks))
        if self.held is not None and later.held is not None:
            later = replace(later, held=self.held.followed_by(later.held))
        # a move: farther than three standard deviations of the distance, and than 3 mm
        distance_sd = max(1.0, hypot(self.x_mm[1], self.y_mm[1], later.x_mm[1], later.y_mm[1]))
        is_far = self.distance(later.place) > NOISE_REACH * distance_sd
        moves = is_far and later.since_s > self.placed_s
        begins_to_suck = self.sucks_s is None and later.sucks > 0.5
        suctions = (*self.suctions, *later.suctions)
        pulls = [pair for pair in (self.pulled_kpa, later.pulled_kpa) if pair is not None]
        return replace(
            later,
            since_s=self.since_s,
            looks=self.looks + 1,
            sucks_s=later.since_s if begins_to_suck else self.sucks_s,
            moved_s=(*self.moved_s, *([later.since_s] * moves)),
            placed_s=later.since_s if moves else self.placed_s,
            suctions=suctions[::2] if len(suctions) > MAX_SUCTIONS else suctions,
            # the one that exceeds the other by more than its error
            pulled_kpa=min(pulls, key=sum, default=None),
            breath=self.breath,
            track=self.track,
        )

    def listened(
        self,
        frames: Frames,
        steps: Sequence[float],
        whitening: Array,
        verdict: Verdict,
    ) -> "Attachment":
        """Return the attachment after a judgement of its breath.

        The judgement uses the frames since the last full window in the attachment's place.

        Parameters
        ----------
        frames : sequence of (float, array)
            Times, s, and readings ln y, (cells,).
        steps : sequence of float
            Times of steps of the readings, s.
        whitening : array, shape (cells, cells)
        verdict : Verdict
            The last recognition.
        """
        before = self.breath.parted(steps)
        unjudged = replace(self, breath=before)
        begin = max(before.full_s, self.placed_s)
        recent = [frame for frame in frames if frame[0] > begin]
        if self.patterns is None or not recent:
            return unjudged
        last = recent[-1][0]
        if last - recent[0][0] < MIN_WINDOW_S or last - before.judged_s < JUDGED_S:
            return unjudged
        times, logarithms = map(np.array, zip(*recent, strict=True))
        interval = SteadyFrames.of(times, logarithms, steps)
        if not interval.times.size:
            return unjudged
        full = bool(np.ptp(interval.times) > WINDOW_S - 2.5 * interval.period)
        changes = changes_without_water(interval, verdict.frame, verdict.change) @ whitening.T
        shown = breath(interval, changes, self.patterns)
        return replace(self, breath=before.after(shown, last, full=full))

    def sampled(self, frames: Frames, whitening: Array, frame: Observation) -> "Attachment":
        """Return the attachment after a sample of its suction, where the last one is BLOCK_S old.

        `frame` is the recognised one, `whitening` (cells, cells) whitens changes of ln y. A sample
        with too few frames waits.
        """
        if self.patterns is None or self.sucks <= 0.5:
            return self
        moves = len(self.moved_s)
        time = frames[-1][0]
        track = self.track if self.track is not None and self.track.moves == moves else None
        begin = max(self.placed_s, frames[0][0]) if track is None else track.since_s
        block = np.array([logarithm for at, logarithm in frames if at > begin])
        if time - begin < BLOCK_S or len(block) < MIN_SAMPLE_FRAMES:
            return self
        if track is None:
            weights = self.patterns.suction_weights(whitening)
            reference = np.log(frame.measured.ravel())
            track = Pumping.begin(weights, reference, begin, moves, self.track)
        return replace(self, track=track.after(block, time))


def attachments_of(
    verdict: Verdict,
    since: float,
    patterns: Sequence[Patterns] = (),
    *,
    any_form: bool = False,
) -> list[Attachment]:
    """Return the loads that suck; where nothing does, one load for each contact.

    Parameters
    ----------
    verdict : Verdict
    since : float
        Time of arrival, s.
    patterns : sequence of Patterns
        Patterns of the loads that suck.
    any_form : bool
        Whether the panel is a mat, on which nothing sucks.
    """
    frame = verdict.frame
    change = frame.free_map
    moved = np.abs(change) > NOISE_REACH * np.hypot(frame.free_sd, frame.drift_sd)
    loads = list[Attachment]()
    for disc, effects in zip(verdict.discs, patterns, strict=True):
        covered = under(frame.panel, disc.disc)
        x_mm, y_mm, diameter_mm, suction = disc.report.values()
        loads.append(
            replace(
                _of_cells(verdict, moved & covered, since),
                held=Hold(np.where(covered, change, 0.0), frame.free_sd),
                patterns=effects,
                x_mm=x_mm,
                y_mm=y_mm,
                diameter_mm=diameter_mm,
                suctions=(suction,),
                pulled_kpa=suction,
            )
        )
    if not loads:
        groups = _contacts(frame)
        groups = groups if any_form else _touching(frame.panel, groups)
        loads = [_of_cells(verdict, group, since) for group in groups]
    return loads if any_form else [_judged(load, verdict) for load in loads]


def _of_cells(verdict: Verdict, group: Mask, since: float) -> Attachment:
    """Return a load with the place, the area and the conductance of a group of cells."""
    frame = verdict.frame
    panel = frame.panel
    change = frame.free_map
    # Δg = g₀ (e^−x − 1) and σ = g₀ e^−x σ_x of x = ln r/r₀
    resting = np.exp(-frame.baseline.logarithm[group])
    more = resting * np.expm1(-change[group])
    errors = resting * np.exp(-change[group]) * frame.free_sd[group]
    # centre of the cells weighted by |x|, to half a pitch
    weight = np.abs(change) * (group if group.any() else 1.0)
    half_pitch = panel.pitch_mm / 2
    x, y = (float(np.nansum(weight * line) / weight.sum()) for line in panel.places_mm)
    count = int(group.sum())
    square = panel.pitch_mm**2
    return Attachment(
        sucks=0.0,
        since_s=since,
        placed_s=since,
        x_mm=(x, half_pitch),
        y_mm=(y, half_pitch),
        cells=count,
        area_mm2=(count * square, square * (max(count, 1) / 3) ** 0.5),
        conductance_s=(float(more.sum()), float(np.hypot.reduce(errors, initial=0.0))),
        held=Hold(np.where(group, change, 0.0), frame.free_sd),
        clear=verdict.clear,
    )


def _judged(load: Attachment, verdict: Verdict) -> Attachment:
    """Return a load with the probability that it sucks by one recognition.

    A contact without a diameter is a disc of the same area.
    """
    frame = verdict.frame
    round_mm = load.width if load.diameter_mm else load.width * (4 / np.pi) ** 0.5
    inner = inner_cells(frame.panel, load.place, round_mm)
    places = [disc.place for disc in verdict.discs]
    near = [place.odds for place in places if load.distance(place.centre) < round_mm / 2]
    # A load without a cell that would show its suction has even odds.
    odds = max(near, default=min(rise_odds(frame, inner), 0.0))
    look = float(expit(np.clip(odds, -MAX_LOOK_LOG_ODDS, MAX_LOOK_LOG_ODDS)))
    begins = load.since_s if load.diameter_mm and odds > 0 else None
    small = not near and not inner.any()
    return replace(load, sucks=look, small=small, sucks_s=begins)


def _contacts(frame: Observation) -> list[Mask]:
    """Return the cells of the contacts without which the readings are not explained.

    The misfit rises by more than SIGNIFICANT² where the cells of such a contact are as the level
    of the water has them, to the unevenness of films, and all others are free. The test is a
    likelihood ratio: where a load lowers the sensitivity, as with large pull-ups, the standard
    deviation of a pressed cell does not show whether it is pressed.
    """
    level = frame.common_change
    uneven = np.diag(level.uneven).reshape(frame.measured.shape)
    sd = np.sqrt(frame.mean_sd**2 + frame.drift_sd**2 + uneven)
    least = frame.free.misfit + SIGNIFICANT**2

    def misfit(group: Mask) -> float:
        start = np.where(group, level.mean, frame.free_map)
        variances = np.where(group, uneven, 1.0).ravel()
        return frame.cells(start, variances, level.mean * group).misfit

    groups = contacts_of(frame.panel, frame.free_map - level.mean, sd)
    return [group for group in groups if misfit(group) > least]


def _touching(panel: Panel, contacts: Sequence[Mask]) -> list[Mask]:
    """Return the contacts, joined where cells of two of them touch, also by their corners.

    A ring is one load, and the feet on a mat are several.
    """
    x, y = panel.places_mm / panel.pitch_mm
    joined = list[Mask]()
    for contact in contacts:
        parts = [contact]
        apart = list[Mask]()
        for other in joined:
            distances = np.hypot(x[contact, None] - x[other], y[contact, None] - y[other])
            (parts if distances.min() < CORNER_PITCHES else apart).append(other)
        joined = [*apart, np.any(parts, axis=0)]
    return joined


def continued_by(
    before: Sequence[Attachment],
    loads: Sequence[Attachment],
    time: float,
    frame: Observation,
    has_left: Callable[[Attachment], bool],
    *,
    again: bool = False,
) -> tuple[Attachment, ...]:
    """Return all attachments after a recognition.

    Each load continues the nearest attachment that is present. One that sucks, whose cells still
    show that where no shape does, stays as it was; contacts under its disc are parts of it.

    Parameters
    ----------
    before, loads : sequence of Attachment
        Known attachments, and loads that were recognised.
    time : float
        Time of the last step, s; attachments whose cells do not show them left then.
    frame : Observation
    has_left : callable
        Returns whether the cells of an attachment show it no more.
    again : bool
        Whether it is a repeated recognition since that step. Nothing leaves without a step, but
        attachments that arrived with it may have been parts of a load, or nothing: that were
        recognised once.
    """
    attachments = list(before)
    unmatched = [number for number, load in enumerate(before) if load.present]
    kept = list[Attachment]()

    def distances(load: Attachment) -> list[float]:
        return [attachments[number].distance(load.place) for number in unmatched]

    # Greedy matching: the load with the nearest attachment first, within the larger width of both.
    for load in sorted(loads, key=lambda load: min(distances(load), default=inf)):
        near = unmatched[np.argmin(distances(load))] if unmatched else None
        if near is not None and attachments[near].adjoins(load):
            former = attachments[near]
            shown = former.beside(frame)
            unmatched.remove(near)
            if min(former.sucks, shown.sucks) > 0.5 >= load.sucks:
                attachments[near] = shown
                kept.append(former)
            else:
                attachments[near] = former.continued(load)
        elif not any(former.contains(load) for former in kept):
            attachments.append(load)
    for number in reversed(unmatched):
        load = attachments[number]
        new = again and load.since_s >= time
        nothing = load.looks == 1 and has_left(load)
        if new and (nothing or any(map(load.adjoins, loads))):
            del attachments[number]
        elif again or not has_left(load):
            attachments[number] = load.beside(frame)
        else:
            attachments[number] = load.ended(time)
    return tuple(attachments)
