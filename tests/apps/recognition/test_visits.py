"""Visits as a biologist counts them.

Tables of visits have clock times, over recordings and folders.
"""

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from laws.recognised import answered, every_frame, known_before

from docs.studies.attachments import ATTACHED_S, TOUCH_S, Seen, seen
from docs.studies.attachments import recording as attached
from docs.studies.words import rows
from lampest import Array, Panel
from lampest.apps.recognition.attachment import Attachment, continued_by
from lampest.apps.recognition.breath import Breath, breath
from lampest.apps.recognition.breathing import Breathing
from lampest.apps.recognition.detect.answer import (
    CUP,
    LAMPREY,
    MIN_PROBABILITY,
    PRESSES,
    SUCKS,
    Detected,
    answer_of,
)
from lampest.apps.recognition.detect.detection import Known, known_of, measured_frames
from lampest.apps.recognition.detect.timeline import timeline
from lampest.apps.recognition.detect.visits import COLUMNS, count_table, visits_of
from lampest.apps.recognition.detector import Detector
from lampest.apps.recognition.pumping import Pumping
from lampest.apps.recognition.steady_frames import SteadyFrames
from lampest.apps.recognition.suction import UNRISEN
from lampest.apps.recognition.swings import Patterns
from lampest.apps.recognition.watch import Watch
from lampest.apps.recognition.watch_parts import Hold
from lampest.inference.prepared import Prepared
from lampest.recording.recording import MEASURED

# P(sucks)
MOUTH = 1.0
RING = 0.0


def load(
    since_s: float, until_s: float | None, diameter_mm: float = 35.0, sucks: float = MOUTH
) -> Attachment:
    breath = Breathing(
        odds=10.0,
        previous_odds=10.0,
        hertz=(1.1, 0.05),
        depth=(0.08, 0.02),
        full_s=9.0,
        judged_s=9.0,
    )
    numbers = {
        "diameter_mm": (diameter_mm, 1.0),
        "suctions": ((-10.0, 1.0), (-12.0, 1.0), (-30.0, 2.0)),
        "pulled_kpa": (-30.0, 2.0),
    }
    return Attachment(
        sucks, since_s, (40.0, 1.0), (50.0, 1.0), until_s=until_s, breath=breath, **numbers
    )


def detected_loads(
    *loads: Attachment, start: str | None = "2026-05-04T17:30:00+00:00", end_s: float = 7200.0
) -> Detected:
    return Detected.of("pond", loads, 4.0, start_time=start, end_s=end_s)


def test_a_visit_gives_a_row_with_the_clock_of_its_recording() -> None:
    first, second = visits_of([detected_loads(load(600.0, 900.0), load(3600.0, None, sucks=RING))])
    assert (first.answer, first.begin, first.duration_s, first.left) == (
        LAMPREY,
        "2026-05-04T17:40:00.000+00:00",
        300.0,
        "yes",
    )
    # typical, and where it was strongest
    assert (first.suction_kpa, first.strongest_kpa) == (-12.0, -30.0)
    assert (second.answer, second.duration_s, second.left, second.suction_kpa) == (
        PRESSES,
        3600.0,
        "no",
        None,
    )


def contact(x_mm: float) -> Attachment:
    """A contact without a shape whose place is known to half a pitch."""
    area = (900.0, 300.0)
    return Attachment(UNRISEN, 60.0, (x_mm, 5.0), (50.0, 5.0), area_mm2=area)


def shown(rise: float, sd: float = 0.02) -> Any:
    """A frame in which each of 5 x 5 cells has risen by ln r/r0."""
    return SimpleNamespace(free_map=np.full((5, 5), rise), free_sd=np.full((5, 5), sd))


def attached_mouth(sucks: float = MOUTH) -> Attachment:
    """A mouth that has raised a cell by 0.6 within a rim of eight."""
    change = np.zeros((5, 5))
    change[1:4, 1:4] = -0.5
    change[2, 2] = 0.6
    return replace(load(0.0, None, sucks=sucks), held=Hold(change, np.full((5, 5), 0.03)))


def test_contacts_under_a_load_that_sucks_are_its_rim() -> None:
    """The disc reaches to 57.5 mm."""
    mouth = attached_mouth()
    rim = [contact(41.0), contact(22.0), contact(60.0)]
    (kept,) = continued_by([mouth], rim, 60.0, shown(0.6), lambda _: True)
    assert kept == replace(mouth, sucks=kept.sucks) and kept.sucks > 0.999
    assert len(continued_by([mouth], [*rim, contact(75.0)], 60.0, shown(0.6), lambda _: True)) == 2


@pytest.mark.parametrize(("rise", "sd"), [(0.0, 1.0), (0.35, 0.1), (0.6, 0.02)])
def test_a_load_that_sucked_is_lost_to_evidence_against_it_alone(rise: float, sd: float) -> None:
    """Its cells are hidden, beside a second load, or as before; then they are at rest."""
    mouth = attached_mouth()
    loads: tuple[Attachment, ...] = (mouth,)
    for _ in range(20):
        loads = continued_by(loads, [contact(41.0)], 60.0, shown(rise, sd), lambda _: False)
    assert loads == (replace(mouth, sucks=loads[0].sucks),) and loads[0].sucks > 0.999
    for _ in range(4):
        loads = continued_by(loads, [contact(41.0)], 60.0, shown(0.0), lambda _: False)
    assert loads[0].sucks < 0.5 and loads[0].diameter_mm is None


def test_no_single_recognition_decides_whether_a_visit_sucks() -> None:
    pressing = load(0.0, None, sucks=UNRISEN)
    once = pressing.continued(load(0.0, None, sucks=0.95))
    assert once.sucks == pytest.approx(0.5, abs=0.01)
    sucking = load(0.0, None, sucks=0.95)
    assert sucking.continued(sucking).continued(pressing).sucks > 0.9


def test_a_load_stays_until_its_own_cells_show_no_more_than_a_residue() -> None:
    """Beside it and on its rim another load stands meanwhile, and a pull leaves a residue."""
    held = attached_mouth().held
    assert held is not None
    another = held.change.copy()
    another[3, 3:] = -3.0
    sd = np.full((5, 5), 0.03)
    together = held.followed_by(Hold(another, sd))
    assert together is held
    reached = np.abs(another)
    read = np.ones((5, 5), dtype=bool)
    assert not together.has_left(held.change, sd, reached, 0.12, read)
    assert together.has_left(0.1 * another, sd, reached, 0.12, read)
    unknown = np.ones((5, 5))
    assert together.has_left(0.1 * another, unknown, reached, 0.12, read)
    assert not together.has_left(0.1 * another, unknown, reached, 0.12, ~read)
    weaker = Hold(0.4 * held.change, sd)
    assert held.followed_by(weaker) is weaker
    assert weaker.has_left(0.25 * held.change, sd, 3 * np.abs(held.change), 0.12, read)
    assert not weaker.has_left(0.25 * held.change, sd, np.abs(weaker.change), 0.12, read)


def waved(since_s: float, x_mm: float = 40.0, clear: float = 10.0) -> Attachment:
    """A contact of 2 s."""
    return replace(load(since_s, since_s + 2.0, sucks=RING), x_mm=(x_mm, 1.0), clear=clear)


def test_a_waving_plant_is_one_disturbance() -> None:
    """Contacts every 5 s, another one beside them, and one a minute later."""
    plant = [waved(5.0 * number, clear=float(number)) for number in range(12)]
    beside, later = waved(20.0, x_mm=90.0), waved(120.0)
    detected = detected_loads(*plant, beside, later)
    joined = [(contact.since_s, contact.until_s, contact.clear) for contact in detected.attachments]
    assert joined == [(0.0, 57.0, 11.0), (20.0, 22.0, 10.0), (120.0, 122.0, 10.0)]
    # what sucks is a visit each time, and on a mat each contact is a step
    assert len(detected_loads(load(0.0, 2.0), load(4.0, 6.0)).attachments) == 2
    assert len(Detected.of("mat", plant, 4.0, mat=True).attachments) == 12


def test_numbers_of_visits_have_two_digits_of_their_error() -> None:
    measured = replace(load(600.0, 900.0), diameter_mm=(33.4567, 1.2345), x_mm=(40.123, 0.034))
    (visit,) = visits_of([detected_loads(measured)])
    assert (visit.diameter_mm, visit.diameter_sd_mm, visit.x_mm) == (33.5, 1.2, 40.123)
    (visit,) = visits_of([detected_loads(replace(measured, diameter_mm=(133.4, 12.3)))])
    assert (visit.diameter_mm, visit.diameter_sd_mm) == (133.0, 12.0)


def test_visits_are_counted_by_day_and_by_night() -> None:
    answer = detected_loads(load(600.0, 900.0), load(3600.0, 3700.0))  # at 17:40 and at 18:30
    table = count_table([answer], visits_of([answer]))
    ((day, hours, lampreys, _, an_hour, hours_of_night, at_night, _, _),) = table.cells
    assert (day, hours, lampreys, an_hour, hours_of_night, at_night) == (
        "2026-05-04",
        "0.5",
        "1",
        "2",
        "1.5",
        "1",
    )


def test_a_mouth_of_the_same_size_is_a_possible_return() -> None:
    loads = load(0.0, 100.0, 30.0), load(200.0, 300.0, 40.0), load(400.0, 500.0, 30.5)
    assert [visit.may_be_visit for visit in visits_of([detected_loads(*loads)])] == [None, None, 1]


def test_a_return_that_may_be_of_two_animals_names_no_visit() -> None:
    """Animals of 30, 32 and 40 mm, at one time on the panel; 30.2 mm may be either of two."""
    together = [load(10.0 * size, 900.0, size) for size in (30.0, 32.0, 40.0)]
    returns = load(1000.0, 1100.0, 30.2), load(1200.0, 1300.0, 40.5), load(1400.0, 1500.0, 45.0)
    visits = visits_of([detected_loads(*together, *returns)])
    assert [visit.may_be_visit for visit in visits] == [None, None, None, None, 3, None]


def test_an_animal_on_the_panel_does_not_return() -> None:
    """Two of one size, of which the first stays."""
    loads = load(0.0, None), load(100.0, 200.0), load(300.0, 400.0)
    assert [visit.may_be_visit for visit in visits_of([detected_loads(*loads)])] == [None, None, 2]


def test_the_strongest_suction_is_not_weaker_than_the_typical_one() -> None:
    """A stronger one with a large error, and a weaker one with a small error."""
    sucked = replace(load(0.0, 100.0), suctions=((-12.0, 6.0), (-11.0, 5.0), (-8.0, 0.5)))
    assert replace(sucked, pulled_kpa=(-8.0, 0.5)).strongest_kpa == sucked.suction_kpa
    assert replace(sucked, pulled_kpa=(-20.0, 6.0)).strongest_kpa == (-20.0, 6.0)
    assert replace(sucked, suctions=()).strongest_kpa is None


def test_the_strongest_suction_of_all_recognitions_is_kept() -> None:
    """The one that exceeds the other by more than its error."""
    first = replace(load(0.0, None), pulled_kpa=(-20.0, 2.0))
    for later, strongest in (((-40.0, 15.0), (-40.0, 15.0)), ((-21.0, 9.0), (-20.0, 2.0))):
        again = first.continued(replace(load(9.0, None), pulled_kpa=later))
        assert again.pulled_kpa == strongest


def test_visits_of_several_recordings_are_sorted_by_time() -> None:
    late = detected_loads(load(10.0, 20.0))
    early = detected_loads(load(10.0, 20.0), start="2026-05-03T10:00:00+00:00")
    assert [visit.begin[:10] for visit in visits_of([late, early]) if visit.begin] == [
        "2026-05-03",
        "2026-05-04",
    ]


def test_the_sentence_counts_visits() -> None:
    sentence = detected_loads(load(0.0, 100.0), load(200.0, 300.0), load(400.0, None)).sentence
    assert sentence.startswith("3 lamprey visits; last: lamprey attached since 400.0 s")


def test_a_timeline_of_a_mat_shows_contacts() -> None:
    course = np.array([[0.0, 400.0], [1.0, 9.0]])
    detected = detected_loads(load(0.0, 100.0), load(200.0, 300.0))
    for mat, visitors in ((False, "visits"), (True, "contacts")):
        figure = timeline(replace(detected, course=course, panel=Panel(6, 6, 10.0), mat=mat))
        assert f"places of all {visitors}" in [axes.get_title() for axes in figure.axes]


@pytest.mark.parametrize(("threshold", "answer"), [(0.9, LAMPREY), (0.999, SUCKS)])
def test_the_threshold_determines_the_answer_lamprey(threshold: float, answer: str) -> None:
    sure = replace(load(0.0, None), sucks=0.99)
    assert answer_of(sure, 4.0, threshold)[0] == answer


@pytest.mark.parametrize(("sd", "answer"), [(0.005, CUP), (0.03, SUCKS)])
def test_a_full_window_excludes_a_breath_before_a_cup_is_named(sd: float, answer: str) -> None:
    window = Breath(odds=-9.0, suction=0.8, hertz=(1.0, 0.1), depth=(0.01, sd))
    early, late = (Breathing().after(window, 8.0, full=full) for full in (False, True))
    cup = load(0.0, None)
    named, why = answer_of(replace(cup, breath=late), 4.0)[::2]
    assert named == answer and ("no full window excludes" in why) == (answer == SUCKS)
    assert answer_of(replace(cup, breath=early), 4.0)[0] == SUCKS


def test_answers_are_counted_by_word_and_probability() -> None:
    answers = [("mouth", LAMPREY, 0.95), ("cup", LAMPREY, 0.93), ("leaking cup", CUP, 0.92)]
    answers += [("rod", PRESSES, 1.0), ("mouth", PRESSES, 0.5), ("nothing", "nothing", 0.99)]
    records = [
        Seen(kind, 4.0, 0, 0.0, 0.0, answer, *[0.0] * 16, probability=probability)
        for kind, answer, probability in answers
    ]
    assert rows(records) == [
        (LAMPREY, "0.93 to 0.97", 2, pytest.approx(0.94), 1),
        (CUP, "0.9 to 0.93", 1, 0.92, 1),
        (PRESSES, "0 to 0.9", 1, 0.5, 0),
        (PRESSES, "0.99 to 1", 1, 1.0, 1),
    ]


def test_a_reason_applies_to_its_time() -> None:
    """After 55 minutes nothing shows within minutes.

    After nine seconds nothing shows at 3.5 s at the earliest.
    """
    silent = replace(load(0.0, None), breath=Breathing(judged_s=9.0))
    assert "earliest" not in answer_of(silent, 4.0)[2]
    watched = replace(Pumping.begin(np.ones(1), np.zeros(1), 0.0, 0), observed_s=3300.0)
    assert "in 55 minutes" in answer_of(replace(silent, track=watched), 1.0)[2]


@pytest.mark.slow
def test_a_folder_of_recordings_gives_one_table(
    tmp_path: Path, lampest: Callable[..., Any]
) -> None:
    """Two recordings have the same name, clocks and folders of their own.

    `export` writes their visits from detections.h5. A single visit has no picture of days.
    """
    recording, *_ = attached("ring", 1.0, 5, 6, 6.0)
    season = tmp_path / "season"
    out = tmp_path / "out"
    for day in (1, 2):
        (season / str(day)).mkdir(parents=True)
        replace(recording, start_time=f"2026-05-0{day}T12:00:00+00:00").save(
            season / str(day) / "pond.h5"
        )
    assert lampest("detect", season, "--out", out).code == 0
    with (out / "visits.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == list(COLUMNS) and [row["recording"] for row in rows] == [
        "pond",
        "pond_2",
    ]
    assert [row["begin"][:10] for row in rows] == ["2026-05-01", "2026-05-02"]
    assert (out / "visits.png").exists()
    alone = tmp_path / "alone"
    assert lampest("detect", season / "1" / "pond.h5", "--no-check", "--out", alone).code == 0
    assert (alone / "timeline_pond.png").exists() and not (alone / "visits.png").exists()
    assert (
        lampest(
            "export", out / "detections.h5", "--to", "csv", "--out", tmp_path / "visits.csv"
        ).code
        == 0
    )
    assert (tmp_path / "visits.csv").read_text() == (out / "visits.csv").read_text()
    refused = lampest("export", out / "detections.h5", "--to", "nwb")
    assert refused.code == 2 and "csv, parquet, mat" in refused.err
    answers = json.loads(lampest("detect", season, "--json").out)
    assert [answer["recording"] for answer in answers] == ["pond", "pond_2"]


def test_a_folder_without_a_recording_is_refused(
    tmp_path: Path, lampest: Callable[..., Any]
) -> None:
    refused = lampest("detect", tmp_path)
    assert refused.code == 2 and "holds no recording" in refused.err


def test_a_frame_that_cannot_be_computed_is_left_out_with_a_note(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    recording, *_ = attached("rod", 4.0, 3, 6, 8.0)
    known = known_before(recording)
    frames = list(every_frame(recording, known))
    failing_s = frames[2][2]
    push = Watch.push

    def pushed(watch: Watch, measured: Array, sigma: Array, time: float) -> Watch:
        if time == failing_s:
            raise np.linalg.LinAlgError("Singular matrix")
        return push(watch, measured, sigma, time)

    monkeypatch.setattr(Watch, "push", pushed)
    answer = known.answer(frames)
    assert answer.answer == PRESSES
    assert any(
        note.startswith(f"the frame at {failing_s:.1f} s is left out") for note in answer.notes
    )


@pytest.mark.slow
def test_a_failed_recognition_is_repeated_with_the_next_frames(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The next attempt recognises the load, and the recording is evaluated to its end."""
    recording, *_ = attached("rod", 4.0, 3, 6, 8.0)
    known = known_before(recording)
    attempts = list[bool]()
    verdict = Detector.verdict

    def failing(*frame: object) -> object:
        attempts.append(True)
        if len(attempts) == 1:
            raise np.linalg.LinAlgError("Singular matrix")
        return verdict(*frame)  # type: ignore[arg-type]

    monkeypatch.setattr(Detector, "verdict", failing)
    answer = known.answer(every_frame(recording, known))
    assert (
        len(attempts) > 1 and answer.answer == PRESSES and answer.attachments[0].until_s is not None
    )


@pytest.mark.slow
@pytest.mark.parametrize("number", range(3))
def test_a_jitter_ring_is_never_taken_for_a_lamprey(number: int) -> None:
    """The ring jitters by 3 % at a breathing rate; no cell has risen."""
    recording, *_ = attached("jitter ring", 4.0, 8100 + number)
    known = known_before(recording)
    watch = known.watch()
    sucking = 0.0
    for frame in every_frame(recording, known):
        watch = watch.push(*frame)
        sucking = max([sucking, *(attachment.sucks for attachment in watch.attachments)])
    assert sucking < 0.5


@pytest.mark.slow
def test_a_release_is_no_evidence_of_breath() -> None:
    """A current moves the cup at 0.56 Hz before it is released."""
    recording, *_ = attached("cup in current", 4.0, 5551011)
    released_s = float(recording.time[recording.role == MEASURED][0]) + TOUCH_S + ATTACHED_S
    known = known_of(Prepared(recording))
    assert isinstance(known, Known)
    watch = known.watch()
    lives = list[float]()
    released = list[float]()
    for frame in measured_frames(recording, known, np.ones(len(recording.time), dtype=bool)):
        watch = watch.push(*frame)
        probabilities = [load.breath.probability for load in watch.attachments]
        (released if frame[-1] >= released_s else lives).extend(probabilities)
    assert watch.attachments[0].until_s is not None
    assert set(released) == {lives[-1]}
    assert max(lives) < MIN_PROBABILITY


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", ["wavy mouth", "mouth and body", "pulled mouth", "mouth in current"]
)
def test_uneven_mouths_near_bodies_in_currents_or_pulled_are_recognised(kind: str) -> None:
    answers = [seen(kind, 4.0, 8200 + number) for number in range(3)]
    assert all(attachment.sucks > 0.9 for attachment in answers)
    # a body whose tail beats at the rate of breath may hide it
    assert (
        kind == "mouth and body"
        or sum(np.isfinite(attachment.lamprey) for attachment in answers) >= 2
    )


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["bubbles", "rock", "hand", "fin"])
def test_an_arriving_load_is_not_assumed_in_the_unloaded_frames(kind: str) -> None:
    for number in range(3):
        recording, *_ = attached(kind, 4.0, 8300 + number)
        answer = answered(recording)
        assert not any("in its unloaded frames" in note for note in (*answer.notes, answer.why))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["rock", "hand"])
def test_cells_that_drift_beside_a_load_are_not_under_suction(kind: str) -> None:
    """Half of the panel rises by two or three standard deviations, and no disc explains that."""
    answer = answered(attached(kind, 4.0, 112811003)[0])
    assert answer.answer == PRESSES
    assert all(load.sucks <= 0.5 for load in answer.attachments)


@pytest.mark.slow
def test_few_cells_becoming_even_are_not_taken_for_a_departed_load() -> None:
    """A fin presses on few cells, which happen to be more even under it."""
    answer = answered(attached("fin", 4.0, 977000)[0])
    assert answer.answer == PRESSES and not any(
        "in its unloaded frames" in note for note in answer.notes
    )


def test_a_wave_at_half_the_frame_rate_has_the_depth_of_a_breath() -> None:
    """The sine of the wave is hardly sampled.

    The prior bounds the amplitude, and nothing is divided by zero.
    """
    times = np.arange(0, 8, 0.25)
    rise = np.repeat([-2.0, 1.0], 20)
    slopes = np.repeat([-300.0, 90.0], 20)
    moves = np.ones((1, 40))
    supply = np.ones((40, 1))
    patterns = Patterns.of(np.eye(40), rise, slopes[None], 0.2 * np.abs(slopes), moves, supply)
    noise = np.random.default_rng(4).standard_normal((len(times), 40))
    changes = np.outer(0.08 * np.sin(2 * np.pi * 2.0 * times + 0.3), slopes) + noise
    wave = breath(SteadyFrames.of(times, changes), changes, patterns)
    assert wave is not None and wave.depth[0] < 0.3 and wave.hertz[0] < 2.0
