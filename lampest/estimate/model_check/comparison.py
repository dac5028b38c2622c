"""Which other circuit explains an unloaded panel and a frame clearly better than the told one."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lampest.estimate.model_check.explanation import (
    Explanation,
    explanation_of,
    most_in_series,
    with_some_in_series,
)
from lampest.estimate.model_check.joint_fit import JointFit, in_series
from lampest.estimate.model_check.laws import lawful
from lampest.estimate.model_check.question import Question
from lampest.estimate.model_check.rivals import Rival
from lampest.files.errors import InputError
from lampest.solvers.starts import BROKEN

# −2 log probability by which another circuit must beat the told one: e^18 to one. The best of eight kinds, with any
# resistance in series, beat a right one by 32, 25 and 19 in three of some 430 recordings, else by 15 or less.
MARGIN = 36.0
MOST_ASKED = 3  # rivals: those that linear theory finds best


@dataclass(frozen=True)
class Better:
    """Another circuit that explains the readings better: its name, and how that shows."""

    name: str
    reason: str


def better_rival(rivals: list[Rival], question: Question, told: Explanation | None) -> Better | None:
    """The rival that explains the readings where the told circuit does not, or by MARGIN better; None where none does.

    rivals : the told circuit first. told : what that explains; None where it does not. A rival under which most cells
    have moved is none: nothing then shows which have not; nor is one under which as many have as under the told one.
    """
    if told is None:
        tried = (with_some_in_series(rivals[0], question), *(explanation_of(rival, question) for rival in rivals[1:]))
        found = [one for one in tried if one is not None and one.sparse and lawful(one.rival, question)]
        first = min(found, key=lambda one: one.score, default=None)
        return None if first is None else Better(first.rival.name, "")
    if not told.comparable:
        return None
    as_told = told.joint(question, told.moving)
    if as_told.beyond_noise < MARGIN:
        return None
    best = min(_others(as_told, told, rivals[1:], question), key=lambda fit: fit.beyond_noise, default=None)
    if best is None or not _beaten(as_told, best):
        return None
    # What moved under the rival may have moved under the told circuit.
    again = told.joint(question, best.moved.reshape(told.moving.shape))
    if not _beaten(again, best):
        return None
    moved = min(as_told.count, again.count)
    if best.count >= moved:
        return None
    counts = f"{best.count} cells have moved then, and {moved} as told"
    return Better(best.rival.name, f"between the unloaded panel and {question.loaded} {counts}")


def _beaten(told: JointFit, best: JointFit) -> bool:
    """Whether a rival explains better by MARGIN, wider where even the rival leaves more than noise."""
    return bool(told.beyond_noise > best.beyond_noise + MARGIN * best.excess)


def _others(as_told: JointFit, told: Explanation, rivals: list[Rival], question: Question) -> Iterator[JointFit]:
    """The told circuit and its likeliest rivals, as linear theory has it, explained by the networks themselves.

    Each as it is and with more in series, rivals begun with nothing and with some in series.
    """
    plain = (explanation_of(rival, question) for rival in rivals)
    likely = sorted((one for one in plain if one is not None and one.score < told.score), key=lambda one: one.score)[
        :MOST_ASKED
    ]
    begun = (with_some_in_series(one.rival, question) for one in likely)
    for one in (told, *likely, *(one for one in begun if one is not None)):
        try:
            fit = as_told if one is told else one.joint(question, one.moving)
            most = most_in_series(fit.rival, question)
            fits = [fit] * (one is not told) + ([in_series(fit, question, most)] if most else [])
        except (InputError, *BROKEN):
            continue
        yield from (fit for fit in fits if fit.sparse and np.isfinite(fit.score))
