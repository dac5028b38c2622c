"""What stands on a panel in one frame: every candidate fitted, from where the frame before ended where there is one."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from lampest.loads.recognition.candidates import LOADS, UNIFORM, Several
from lampest.loads.recognition.field import FIELD, field_fit
from lampest.loads.recognition.fit import Fit, along_diameter, with_errors
from lampest.loads.recognition.frame import SUSPICIOUS, Observation, Whitening, outliers, without
from lampest.loads.recognition.multistart import LEVELS, MultiStart, discs_of
from lampest.loads.recognition.search import cell_map
from lampest.loads.recognition.verdict import Verdict, judged, outline_cost
from lampest.loads.shapes.shape import Candidate
from lampest.panel.panel import Array, Panel

QUIET = 4.5  # standard deviations by which something must stand out for loads to be looked for
FORGOTTEN = 60.0  # ln of a likelihood ratio beyond which a candidate is left out until the panel is searched again
CLEAR = 1.15  # χ² per reading: above, a field might win; below, it lost by more than 60 in all scenes that were tried
NO_DOUBT = 1.0  # of ln P: an outline that costs more might be anything's
MOST_AT_ONCE = 3  # loads
COUNTED = 0.02  # share below which a kind hardly counts for a load's size


@dataclass(frozen=True, eq=False)
class Detector:
    """Where a sequence of frames stands.

    starts : what fits to its frames need.
    previous : the verdict on the last frame, or None. changed : ln r/r0 of its field, where a field was fitted.
    """

    starts: MultiStart
    previous: Verdict | None = None
    changed: Array | None = None

    @classmethod
    def of(cls, panel: Panel, patch_mm: float, first: Observation, loads: tuple[Candidate, ...] = LOADS) -> "Detector":
        """Before the first frame."""
        return cls(MultiStart.of(panel, patch_mm, first, loads))

    def push(self, frame: Observation) -> tuple["Detector", Verdict]:
        """The verdict on a frame, begun where the one before ended, and the detector for the next one."""
        calm, whitening = self._at_rest(frame)
        if whitening is not None:
            verdict = self._judged(calm, self._uniform(calm, whitening))
            return replace(self, previous=verdict), verdict
        verdicts = []
        if self.previous is not None and self.previous.loads:
            first = self.previous.loads[0].evidence - FORGOTTEN
            verdicts = [self._settled(calm, [fit for fit in self.previous.loads if fit.evidence > first])]
            if self._clear(verdicts[0]):
                verdict = self._spread(calm, verdicts[0])
                return replace(self, previous=verdict), verdict
        field = field_fit(calm, cell_map(calm), *(() if self.changed is None else (self.changed,)))
        verdicts = [self._judged(calm, (*one.fits, field)) for one in verdicts]
        if not verdicts or self._doubtful(verdicts[0]):
            verdicts.append(self._settled(calm, self.starts.everywhere(calm), field))
            if self._doubtful(verdicts[-1]):
                verdicts += self._several(calm, verdicts[-1], field)
        verdict = self._spread(calm, max(verdicts, key=lambda one: one.evidence))
        return replace(self, previous=verdict, changed=field.change), verdict

    def _at_rest(self, frame: Observation) -> tuple[Observation, Whitening | None]:
        """(frame, None) where something stands out; else the frame without outliers, and its whitening."""
        residual, rest = self.starts.unexplained(frame), self.starts.rest
        far = outliers(rest, residual)
        calm = without(frame, far)
        whitening = Whitening.at_rest(calm) if len(far) else rest
        errors = whitening @ residual
        quiet = errors @ errors < SUSPICIOUS * errors.size and self.starts.search.stands_out(errors) < QUIET
        return (calm, whitening) if quiet else (frame, None)

    def _settled(self, frame: Observation, starts: Sequence[Fit], *others: Fit) -> Verdict:
        """The verdict on all candidates from those starts, and other fits."""
        frame, fits = self.starts.settled(frame, starts)
        return self._judged(frame, (*self._uniform(frame, Whitening.at_rest(frame)), *fits, *others))

    def _several(self, frame: Observation, single: Verdict, field: Fit) -> list[Verdict]:
        """Verdicts on two loads at once, then on three, while they explain more than what one load fewer does."""
        search = self.starts.search
        discs = search.beside(field.change, ())[:1]
        found: list[Verdict] = []
        for _ in range(1, MOST_AT_ONCE):
            places = [[*discs, place] for place in search.beside(field.change, discs)]
            if not places:
                break
            fits = self.starts.sharper(frame, self.starts.together(frame, places))
            verdict = self._settled(frame, (*fits, *single.loads[:1]), field)
            if verdict.evidence <= (found[-1] if found else single).evidence:
                break
            found.append(verdict)
            if not self._doubtful(verdict):
                break
            discs = discs_of(fits[0])
        return found

    def _spread(self, frame: Observation, verdict: Verdict) -> Verdict:
        """The verdict with single loads as large as they may be, where their shares count."""
        best = verdict.best
        if best not in verdict.loads or isinstance(best.candidate, Several):
            return verdict
        frame, whitening = with_errors(frame, best)
        fits = tuple(
            along_diameter(self.starts.fitting(fit.candidate, frame, whitening), fit)
            if share > COUNTED and not isinstance(fit.candidate, Several)
            else fit
            for fit, share in zip(verdict.fits, verdict.shares, strict=True)
        )
        return replace(verdict, fits=fits)

    def _clear(self, verdict: Verdict) -> bool:
        """Whether a shape explains so much, on a film that is not at its worst, that no field need stand against it."""
        best = verdict.best
        likely = verdict.goodness < CLEAR and best.scatter < LEVELS[-1] * self.starts.response
        return likely and outline_cost(self.starts.panel, best) < NO_DOUBT

    def _doubtful(self, verdict: Verdict) -> bool:
        """Whether another position, or another number of loads, might explain more."""
        return verdict.best.candidate is FIELD or verdict.goodness > SUSPICIOUS

    def _uniform(self, frame: Observation, whitening: Whitening) -> tuple[Fit, ...]:
        return tuple(self.starts.fitting(kind, frame, whitening).best(kind.mean(self.starts.panel)) for kind in UNIFORM)

    def _judged(self, frame: Observation, fits: tuple[Fit, ...]) -> Verdict:
        return judged(self.starts.panel, fits, frame.measured.size, frame.baseline.response)
