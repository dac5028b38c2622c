"""What frames of one load say together."""

from collections.abc import Sequence

import numpy as np

from lampest.loads.recognition.candidates import LOADS, UNIFORM
from lampest.loads.recognition.field import FIELD
from lampest.loads.recognition.fit import Fit
from lampest.loads.recognition.frame import Explained
from lampest.loads.recognition.verdict import OR, OverTime, Verdict

CANDIDATES = UNIFORM + LOADS
KINDS = (*CANDIDATES, FIELD)


def frame(**shares: float) -> Verdict:
    """A verdict of one frame with so probable labels, blanks as underscores; UNIFORM has next to nothing."""
    labels = {"nothing": 0.0, "flat load": 0.0} | {name.replace("_", " "): share for name, share in shares.items()}
    none = np.zeros((2, 2))
    fits = tuple(
        Fit(
            next(kind for kind in KINDS if kind.label == label),
            *(np.zeros(0), none),
            Explained(none, none, none),
            *(np.zeros(4), np.zeros((4, 0)), 4.0, 2.0, 0.0, 0.0, 0.1, 1),
        )
        for label in labels
    )
    return Verdict(fits, tuple(labels.values()), (), 1.0, "", 0.0).with_odds(labels, CANDIDATES)


def said(frames: Sequence[Verdict]) -> list[Verdict]:
    """What they say, each in the light of those before."""
    together, found = OverTime(), []
    for one in frames:
        together, verdict = together.after(one, CANDIDATES)
        found.append(verdict)
    return found


MOUTH = {"lamprey": 1 - 2e-6, "cup": 1e-6, "ring": 1e-6}
FIN = {"unlike_any": 1 - 1e-9, "lamprey": 1e-9, "rod": 0.0}


def test_frames_that_agree_say_what_each_says() -> None:
    agreed = said([frame(**MOUTH)] * 4)
    assert [verdict.label for verdict in agreed] == ["lamprey or cup"] + 3 * ["lamprey"]  # one frame is no alarm
    np.testing.assert_allclose([sum(verdict.probabilities) for verdict in agreed], 1)
    shared = [verdict.by_label["cup"] for verdict in said([frame(cup=0.7, lamprey=0.3)] * 5)]
    np.testing.assert_allclose(shared, 0.7, atol=0.02)  # the same evidence again is none


def test_one_wrong_frame_makes_no_alarm() -> None:
    alone = frame(**MOUTH)
    assert alone.label == "lamprey"
    wrong = said([frame(**FIN), alone, frame(**FIN)])
    assert "unlike any" in wrong[1].label.split(OR) and wrong[2].label.split(OR)[0] == "unlike any"
    assert wrong[1].probabilities[[kind.label for kind in KINDS].index("lamprey")] < 0.999


def test_what_touched_and_now_sucks_is_judged_anew() -> None:
    ring = frame(ring=1 - 1e-9, lamprey=1e-9)
    assert [one.label for one in said([ring, ring, frame(**MOUTH)])] == ["ring", "ring", "lamprey or cup"]
    cup = frame(cup=0.7, lamprey=0.3)
    assert set(said([cup, cup, frame(**MOUTH)])[-1].label.split(OR)) == {"lamprey", "cup"}


def test_frames_that_go_on_convince_and_what_has_left_is_forgotten() -> None:
    assert said([frame(**FIN)] * 3 + [frame(**MOUTH)] * 4)[-1].label.split(OR)[0] == "lamprey"
    gone = Verdict(frame().fits, (1.0, 0.0), (), 1.0, "", 0.0).with_odds({"nothing": 1.0, "flat load": 0.0}, CANDIDATES)
    assert [one.label for one in said([frame(**FIN), gone, frame(**MOUTH)])] == [
        "unlike any",
        "nothing",
        "lamprey or cup",
    ]
