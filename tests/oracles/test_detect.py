"""Recognition against scenes whose truth is known, its parts, and what it makes of frames over time."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from docs.studies.attachments import recording as attached
from lampest import Array, Block, Film, OralDisc, Panel, Recording, Ring, Rod, Scene, SuctionCup, TwoPointReadout
from lampest.loads.recognition.attachment import Attachment
from lampest.loads.recognition.candidates import AND, FLAT, UNIFORM, Several
from lampest.loads.recognition.candidates import LOADS as SHAPED
from lampest.loads.recognition.detector import Detector, discs_of
from lampest.loads.recognition.evidence import IMPOSSIBLE, MOUTH_LOG_ODDS, Verdict, prior_cost, rises
from lampest.loads.recognition.fit import SD, field_fit, paid, prior, states
from lampest.loads.recognition.observation import Baseline, ModelErrors, Observation, Whitening, outliers
from lampest.loads.recognition.watch import Panelled, Watch
from lampest.loads.shapes.disc import Disc, pressure_at_places
from lampest.loads.shapes.kinds import RoundCandidate
from lampest.loads.shapes.shape import Candidate, Shape
from lampest.recording.simulation import Course, Simulation, Unmodelled, simulate
from lampest.recording.simulation.measure import measured
from lampest.report.detect.detection import detect_recording

pytestmark = pytest.mark.slow

PANEL = Panel(9, 11, 10.0)
READOUT = TwoPointReadout(kind="two_point", noise_lsb=0.7)
CENTRE = (52.0, 37.0)
TWO = AND.join([OralDisc.candidate.label] * 2)
MOUTH = OralDisc(
    kind="oral_disc", centre_mm=CENTRE, diameter_mm=34, rim_width_mm=5.5, pressure_kpa=-11, rim_kpa=85, tilt=0.2
)
LOADS: dict[str, Any] = {
    "rod": Rod(kind="rod", centre_mm=CENTRE, diameter_mm=40, mass_g=700),
    "ring": Ring(kind="ring", centre_mm=CENTRE, inner_diameter_mm=26, outer_diameter_mm=37, mass_g=850),
    "cup": SuctionCup(
        kind="suction_cup", centre_mm=CENTRE, inner_diameter_mm=26, outer_diameter_mm=37, pressure_kpa=-9
    ),
    "lamprey or cup": MOUTH,
}


def recorded(*loads: Any, panel: Panel = PANEL, seed: int = 3, frames: int = 2, **more: Any) -> Recording:
    scene = Scene(panel=panel, readout=READOUT, series_resistance_ohm=140.0)
    return simulate(Simulation(schema=1, seed=seed, scene=scene, frames=frames, loads=loads, **more))


def frames_of(recording: Recording, measured: Any = None, errors: ModelErrors | None = None) -> list[Observation]:
    readings, panel = recording.readings(), recording.scene.panel
    resting = readings[[0, 1, 2]].mean()
    baseline = Baseline.of(resting.value, resting.sigma, recording.scene, errors or ModelErrors())
    values = readings.value if measured is None else measured
    dry = np.zeros(panel.shape)
    return [Observation(values[k], readings.sigma[k], baseline, dry, k - 1.0) for k in range(3, len(values))]


def seen(frames: list[Any], panel: Panel = PANEL) -> list[Verdict]:
    detector = Detector(panel, 0.6 * panel.pitch_mm)
    verdicts: list[Verdict] = []
    for frame in frames:
        verdicts.append(detector.verdict(frame, verdicts[-1] if verdicts else None))
    return verdicts


def disc_of(verdict: Verdict) -> Disc:
    assert isinstance(verdict.best.candidate, RoundCandidate)
    return verdict.best.candidate.disc(verdict.best.parameters)


@pytest.mark.parametrize("kind", (*UNIFORM, *SHAPED), ids=lambda kind: kind.label)
def test_pressure_slopes_are_differences(kind: Candidate) -> None:
    rng = np.random.default_rng(5)
    for _ in range(4):
        here = kind.mean(PANEL) + 0.5 * kind.sd(PANEL) * rng.standard_normal(len(kind.priors(PANEL)))
        _, slopes = kind.pressure(PANEL, 6.0, here)
        for slope, step in zip(slopes, 1e-6 * np.eye(len(here)), strict=True):
            up, down = (kind.pressure(PANEL, 6.0, here + sign * step)[0] for sign in (1, -1))
            size = max(1.0, float(np.abs(slope).max()))
            np.testing.assert_allclose(slope, (up - down) / 2e-6, atol=1e-4 * size)


def test_pressure_is_that_of_the_simulation_but_for_its_sampling() -> None:
    sampled = np.sum(MOUTH.mean_pressure(PANEL, 6.0), axis=0)
    smooth, _ = pressure_at_places(PANEL.places_mm, 6.0, Disc(*CENTRE, 34.0, 23.0, -11.0, 85.0, 0.2, 0.0))
    assert np.abs(sampled - smooth).max() < 0.04 * 85


@pytest.mark.parametrize("label", LOADS)
def test_each_load_is_called_what_it_is(label: str) -> None:
    load = LOADS[label]
    verdict = seen(frames_of(recorded(load)))[-1]
    disc = disc_of(verdict)
    assert verdict.best.candidate.label == ("lamprey or cup" if label == "cup" else label) and verdict.goodness < 1.4
    assert verdict.sucks_at(None) > 0.99 if "cup" in label else verdict.sucks_at(None) < 0.01
    assert disc.diameter_mm == pytest.approx(load.disc().diameter_mm, abs=1.5)
    assert np.hypot(disc.x_mm - CENTRE[0], disc.y_mm - CENTRE[1]) < 1


@pytest.mark.parametrize(
    "form",
    [
        {},
        {"elongation": 1.2, "elongation_deg": 30.0, "unevenness": 0.3},
        {"unevenness": 0.3, "lobes": 3, "tilt": 0.3},
        {"centre_mm": (8.0, 37.0)},
        {"extra_rim_kpa": 60.0},
    ],
    ids=["even", "long", "lobed", "partly off", "pressed"],
)
def test_a_mouth_that_bears_its_suction_may_be_one(form: dict[str, Any]) -> None:
    """Also where it is neither round nor even, or hangs over the edge of the panel."""
    natural = {"centre_mm": CENTRE, "diameter_mm": 36.0, "rim_width_mm": 5.5, "pressure_kpa": -10.0, **form}
    verdict = seen(frames_of(recorded(OralDisc(**natural))))[-1]
    assert verdict.best.candidate.label == "lamprey or cup" and verdict.sucks_at(None) > 0.99 and verdict.goodness < 1.4
    assert disc_of(verdict).diameter_mm == pytest.approx(36, abs=2.0)


def test_two_mouths_are_two() -> None:
    places, sizes = ((28.0, 25.0), (76.0, 56.0)), (36.0, 28.0)
    mouths = [
        OralDisc(centre_mm=place, diameter_mm=size, rim_width_mm=5.5, pressure_kpa=-10, unevenness=0.2)
        for place, size in zip(places, sizes, strict=True)
    ]
    verdict = seen(frames_of(recorded(*mouths)))[-1]
    assert verdict.best.candidate.label == TWO
    several = verdict.best.candidate
    assert isinstance(several, Several) and len(several.parts) == 2
    found = sorted(disc.diameter_mm for disc in discs_of(verdict.best))
    np.testing.assert_allclose(found, sorted(sizes), atol=2.0)


@pytest.mark.parametrize("places", [((25, 30), (84, 58)), ((22, 20), (79, 60))], ids=["far", "near"])
def test_two_faint_mouths_on_a_bent_film_are_two(places: tuple[tuple[float, float], ...]) -> None:
    """Compared coarsely one of them might be a rod; on a film that answers a fifth less and unevenly."""
    mouths = [
        OralDisc(centre_mm=places[0], diameter_mm=27, rim_width_mm=6, pressure_kpa=-4, unevenness=0.25),
        OralDisc(centre_mm=places[1], diameter_mm=25, rim_width_mm=5.5, pressure_kpa=-8, elongation=1.15),
    ]
    off = Unmodelled(response_loss=0.2, response_spread=0.15)
    assert seen(frames_of(recorded(*mouths, unmodelled=off)))[-1].best.candidate.label == TWO


@pytest.mark.parametrize(("side", "places"), [(6, ((12, 14), (38, 37))), (12, ((25, 80), (75, 35)))])
def test_two_small_mouths_are_two_on_any_panel(side: int, places: tuple[tuple[float, float], ...]) -> None:
    panel = Panel(side, side)
    mouths = [
        OralDisc(centre_mm=place, diameter_mm=size, rim_width_mm=5, pressure_kpa=-9)
        for place, size in zip(places, (25.0, 27.0), strict=True)
    ]
    verdict = seen(frames_of(recorded(*mouths, panel=panel)), panel)[-1]
    assert verdict.best.candidate.label == TWO and isinstance(verdict.best.candidate, Several)
    discs = discs_of(verdict.best)
    for place, disc in zip(places, sorted(discs, key=lambda one: one.x_mm), strict=True):
        np.testing.assert_allclose(disc[:2], place, atol=5.0)  # a row of cells hardly tells its two sides apart


def test_loads_do_not_stand_in_one_place() -> None:
    fit = seen(frames_of(recorded(MOUTH)))[-1].best
    both = Several.of((OralDisc.candidate, OralDisc.candidate))
    for shift, cost in ((0.0, IMPOSSIBLE), (60.0, 0.0)):
        other = fit.parameters + np.eye(len(fit.parameters))[0] * shift
        twice = replace(fit, candidate=both, parameters=np.concatenate([fit.parameters, other]))
        alone = prior_cost(PANEL, replace(fit, parameters=other)) if shift == 0 else IMPOSSIBLE  # no cell rises there
        assert prior_cost(PANEL, twice) == pytest.approx(
            prior_cost(PANEL, fit) + alone + cost + MOUTH_LOG_ODDS, abs=0.5
        )


@pytest.mark.parametrize("told", [0.0, 0.05])
def test_errors_of_readings_that_stay_are_allowed_for(told: float) -> None:
    """A panel of which every reading is off by 5 %, the same in all frames: its unloaded cells are off by a half."""
    recording = recorded(MOUTH, unmodelled=Unmodelled(reading_error=0.05), frames=1)
    verdict = seen(frames_of(recording, errors=ModelErrors(reading_error=told)))[-1]
    if told:
        assert verdict.best.candidate.label == "lamprey or cup" and verdict.goodness < 1.4
        assert verdict.sucks_at(None) > 0.5
        assert disc_of(verdict).diameter_mm == pytest.approx(MOUTH.diameter_mm, abs=3)
    else:
        assert verdict.goodness > 1.4 or verdict.sucks_at(None) < 0.5


def test_the_field_is_none_of_a_reading_that_stands_alone() -> None:
    blocks = [Block(centre_mm=place, length_mm=60, width_mm=14, mass_g=300) for place in ((40, 20), (60, 55))]
    frame = frames_of(recorded(*blocks))[0]
    wild = frame.measured.copy()
    wild[1, 9] *= 3
    clean, fooled = (field_fit(one)[0] for one in (frame, replace(frame, measured=wild)))
    assert np.abs(fooled.change - clean.change).max() < 0.3 and fooled.evidence > clean.evidence - 30


def test_what_is_no_shape_is_unlike_any() -> None:
    blocks = [
        Block(centre_mm=place, length_mm=length, width_mm=14, mass_g=300, angle_deg=angle)
        for place, length, angle in (((40, 20), 70, 20), ((60, 45), 80, -35), ((30, 60), 50, 80), ((85, 20), 40, 60))
    ]
    verdict = seen(frames_of(recorded(*blocks)))[-1]
    assert verdict.best.candidate.label == "unlike any" and max(verdict.shares) > 0.99 and verdict.sucks_at(None) < 1e-3


@pytest.mark.parametrize(
    ("place", "angle_deg"), [((15.0, 15.0), 135.0), ((52.0, 37.0), 45.0), ((75.0, 47.0), 20.0), ((40.0, 60.0), 90.0)]
)
def test_a_thin_line_is_no_lamprey(place: tuple[float, float], angle_deg: float) -> None:
    """Under a line few cells change; suction that a rim cancels in every patch could be made to explain them."""
    line = Block(centre_mm=place, length_mm=45, width_mm=5, mass_g=150, angle_deg=angle_deg)
    verdict = seen(frames_of(recorded(line)))[-1]
    assert verdict.sucks_at(None) < 0.1


def test_hidden_suction_counts_less() -> None:
    verdict = seen(frames_of(recorded(MOUTH)))[-1]
    assert verdict.best.change.max() > 1 and prior_cost(PANEL, verdict.best) == pytest.approx(0, abs=0.1)
    hidden = replace(verdict.best, change=np.minimum(verdict.best.change, 0))
    assert prior_cost(PANEL, hidden) == IMPOSSIBLE
    pressed = frames_of(recorded(Rod(centre_mm=(45, 45), diameter_mm=35, mass_g=500)))[-1]
    assert not rises(pressed) and prior_cost(PANEL, verdict.best, pressed) > 0.8 * IMPOSSIBLE
    assert prior_cost(PANEL, replace(hidden, candidate=Ring.candidate)) == 0


def test_the_field_has_the_evidence_of_its_gaussian() -> None:
    """Where readings are straight in ln r, it is that of a Gaussian with the prior's covariance through them."""
    frame, cells = frames_of(recorded(frames=1))[0], PANEL.rows * PANEL.columns
    fit, _ = field_fit(frame)
    slope = frame.slope(fit.change)
    spread = frame.covariance(slope) + slope @ prior(frame, np.full(cells, SD[0])) @ slope.T
    expected = multivariate_normal(np.zeros(cells), spread, allow_singular=False).logpdf(frame.residual())
    constant = cells * np.log(2 * np.pi) / 2 - paid(PANEL, states(PANEL, np.zeros(PANEL.shape)))
    assert fit.evidence == pytest.approx(expected + constant, abs=0.5)


@pytest.mark.parametrize(("rows", "columns", "pitch"), [(6, 6, 10.0), (8, 14, 7.0), (16, 12, 12.0)])
def test_panels_of_other_shapes(rows: int, columns: int, pitch: float) -> None:
    panel = Panel(rows, columns, pitch)
    place = ((columns - 1) * pitch * 0.47, (rows - 1) * pitch * 0.55)
    load = OralDisc(
        kind="oral_disc", centre_mm=place, diameter_mm=4 * pitch, rim_width_mm=6, pressure_kpa=-10, rim_kpa=90
    )
    recording = simulate(
        Simulation(
            schema=1,
            seed=8,
            scene=Scene(panel=panel, readout=READOUT, series_resistance_ohm=140.0),
            frames=1,
            loads=(load,),
        )
    )
    verdict = seen(frames_of(recording), panel)[-1]
    assert verdict.best.candidate.label == "lamprey or cup"
    assert disc_of(verdict).diameter_mm == pytest.approx(4 * pitch, abs=pitch / 4)


@pytest.mark.parametrize("seed", range(4))
def test_drift_and_outliers_are_nothing(seed: int) -> None:
    doubtful = Unmodelled(
        channel_spread_ohm=3, reference_tolerance=0.01, drift_per_minute=0.01, outlier_probability=1e-4
    )
    verdicts = seen(frames_of(recorded(seed=seed, frames=6, unmodelled=doubtful)))
    assert all(verdict.best.candidate.label in ("nothing", FLAT.label) for verdict in verdicts)


@pytest.mark.parametrize("place", [(4, 6), (3, 5), (1, 1)])
@pytest.mark.parametrize("ohm", [20.0, 160.0])
def test_an_outlier_does_not_move_the_mouth(ohm: float, place: tuple[int, int]) -> None:
    """Nor do last bits, where it lies under the mouth."""
    recording, found = recorded(MOUTH, frames=1), []
    for last_bits in (0.0, 1e-12):
        measured = recording.readings().value * (1 + last_bits * np.random.default_rng(1).standard_normal(PANEL.shape))
        measured[3, *place] += ohm
        verdict = seen(frames_of(recording, measured))[-1]
        assert verdict.best.candidate.label == "lamprey or cup"
        found.append(disc_of(verdict).diameter_mm)
    assert found[0] == pytest.approx(34, abs=0.6) and found[1] == pytest.approx(found[0], abs=0.01)


def test_an_outlier_is_the_reading_that_the_others_contradict() -> None:
    frame = frames_of(recorded(frames=1))[0]
    weight = Whitening.at_rest(frame)
    residual = frame.residual()
    assert list(outliers(weight, residual)) == []
    residual[17] += 60.0
    assert list(outliers(weight, residual)) == [17]


def test_strong_suction_leaves_no_smaller_disc_possible(tmp_path: Path) -> None:
    """Cells that suction opens change the readings by little more, but by much where they would close again."""
    scene = Scene(Panel(10, 10), TwoPointReadout(), series_resistance_ohm=140.0)
    load = OralDisc(centre_mm=(45.2, 51.3), diameter_mm=32.2, rim_width_mm=4.5, pressure_kpa=-20, rim_kpa=60)
    off = Unmodelled(channel_spread_ohm=3.0, reference_tolerance=0.01, response_spread=0.25, response_loss=0.3)
    times = {"frames": 12, "baseline_frames": 5, "frame_period_s": 0.25, "course": Course(start_s=2.0)}
    simulate(Simulation(1, 1, scene, loads=(load,), unmodelled=off, **times)).save(tmp_path / "mouth.h5")
    (found,) = detect_recording(tmp_path / "mouth.h5").attachments
    assert found.diameter_mm[1] < 3 and abs(found.diameter_mm[0] - 32.2) < 2 * found.diameter_mm[1]


STRONG = OralDisc(kind="oral_disc", centre_mm=(37, 35), diameter_mm=32, rim_width_mm=5.5, pressure_kpa=-10, rim_kpa=60)
SMALL_ROD = Rod(kind="rod", centre_mm=(37, 35), diameter_mm=30, mass_g=300)
SQUARE = Scene(Panel(8, 8), TwoPointReadout(noise_lsb=0.7), 140.0)


def load_that_leaves(
    film: Film | None, load: Shape = STRONG, frames: int = 40, release: float = 15, start: float = 4
) -> Recording:
    """A load from `start` on, and then nothing; s after the unloaded frames."""
    course = Course(start_s=start, approach_s=0.5, attachment_s=0.5, release_at_s=release, release_s=0.2)
    return simulate(Simulation(1, 5, SQUARE, frames=frames, loads=(load,), course=course, film=film))


def watched(
    recordings: list[Recording], minutes: float = 0.0, drift: float = 0.0, period: float = 1.0
) -> tuple[Attachment, ...]:
    """What is attached in recordings, one after the other; the first has the baseline.

    minutes : between the first frames of the load and its last. drift : of ln y a decade, of each reading by itself a
    tenth of that. period : s, between frames.
    """
    readings = recordings[0].readings()
    resting = readings[[0, 1, 2]].mean()
    panelled = Panelled(SQUARE, Detector(SQUARE.panel, 6.0), np.zeros(SQUARE.panel.shape), ModelErrors())
    watch = Watch.begin(panelled, resting.value, readings.sigma[0], readings.value[:3], 0.0)
    rng, time = np.random.default_rng(3), 0.0
    wander = drift * (1 + 0.1 * rng.standard_normal(SQUARE.panel.shape))

    def pushed(watch: Watch, value: Array, sigma: Array, time: float) -> Watch:
        return watch.push(value * np.exp(wander * np.log10(1 + time / 10)), sigma, time)

    for recording in recordings:
        readings = recording.readings()
        for number in range(3, len(readings.value)):
            time += period
            watch = pushed(watch, readings.value[number], readings.sigma[number], time)
            for _ in range(round(60 * minutes / period) if number == 14 else 0):
                time += period
                noise = readings.sigma[number] * rng.standard_normal(SQUARE.panel.shape)
                watch = pushed(watch, readings.value[number] + noise, readings.sigma[number], time)
    return watch.attachments


@pytest.mark.parametrize("creep", [0.03, 0.1])
def test_memory_of_a_lamprey_is_nothing(creep: float) -> None:
    (one,) = watched([load_that_leaves(Film(0.24, creep, cell_spread=0.2))])
    assert one.sucks > 0.9 and one.since_s == pytest.approx(5, abs=2) and one.until_s == pytest.approx(16, abs=2)


@pytest.mark.parametrize("load", [STRONG, SMALL_ROD], ids=["mouth", "rod"])
@pytest.mark.parametrize("drift", [0.0, 0.02])
def test_what_is_attached_stays_until_the_readings_step(load: Shape, drift: float) -> None:
    (one,) = watched([load_that_leaves(Film(0.24, 0.03), load)], minutes=5, drift=drift)
    assert one.since_s == pytest.approx(5, abs=2) and one.until_s == pytest.approx(316, abs=5)
    assert (one.sucks > 0.5) == (load is STRONG)


def test_an_hour_at_a_frame_every_ten_seconds_is_kept_from_the_first_frame_to_the_last() -> None:
    (one,) = watched([load_that_leaves(Film(0.24, 0.03))], minutes=60, drift=0.02, period=10)
    assert one.since_s == pytest.approx(55, abs=6) and one.until_s == pytest.approx(3765, abs=6)
    assert one.sucks > 0.5


def test_a_known_load_ends_by_a_step_and_not_by_an_opinion(monkeypatch: pytest.MonkeyPatch) -> None:
    """However probable drift makes it afterwards that nothing is there."""
    first, verdicts = Detector.verdict, list[Verdict]()

    def judged(self: Detector, frame: Observation, before: Verdict | None = None) -> Verdict:
        verdicts.append(first(self, frame, before))
        nothing = (1.0, *(0.0 for _ in verdicts[-1].fits[1:]))
        return verdicts[-1] if len(verdicts) == 1 else replace(verdicts[-1], shares=nothing)

    monkeypatch.setattr(Detector, "verdict", judged)
    (one,) = watched([load_that_leaves(None)])
    assert len(verdicts) > 1 and one.since_s == pytest.approx(5, abs=2) and one.until_s == pytest.approx(16, abs=2)


def test_drift_of_hours_is_little_and_mostly_common_to_all_cells() -> None:
    covariance = ModelErrors().resting_covariance(6 * 3600, 4)
    assert 0.02 < np.sqrt(covariance[0, 0]) < 0.1 and covariance[0, 1] > 0.5 * covariance[0, 0]
    assert ModelErrors().resting_sd(86400) < 2 * ModelErrors().resting_sd(3600)


def test_a_weaker_lamprey_that_comes_back_to_its_place_is_seen() -> None:
    again = load_that_leaves(None, replace(STRONG, pressure_kpa=-4, rim_kpa=30))
    found = watched([load_that_leaves(None), again])
    assert len(found) == 2 and all(one.sucks > 0.9 for one in found)


def test_a_lamprey_that_sucks_less_is_still_there() -> None:
    less = load_that_leaves(None, replace(STRONG, pressure_kpa=-3, rim_kpa=20), release=60, start=-0.9)
    found = watched([load_that_leaves(None, frames=12, release=60), less])
    assert found[-1].present and found[-1].sucks > 0.5


@pytest.mark.parametrize("seed", range(2))
def test_a_bare_panel_is_nothing_for_ten_minutes(seed: int) -> None:
    """With drift, a gain that scatters, ripple and outliers."""
    real = Unmodelled(gain_spread=0.001, supply_ripple_lsb=0.4, outlier_probability=1e-4)
    bare = simulate(Simulation(1, seed, SQUARE, frames=600, unmodelled=real))
    assert watched([bare], drift=0.02) == ()


@pytest.mark.parametrize("minutes", [1.0, 10.0])
def test_memory_of_another_kind_is_nothing_either(minutes: float) -> None:
    """15 % of what cells have answered stays and fades exponentially, each cell's by a fifth more or less."""
    recording = load_that_leaves(None, frames=60)
    cells = recording.truth_cell_resistance
    after = np.arange(len(cells)) - 18
    part = 0.15 * np.exp(0.2 * np.random.default_rng(3).standard_normal(SQUARE.panel.shape))
    left = part * np.log(cells[12] / cells[0]) * np.exp(-np.maximum(after, 0) / (60 * minutes))[:, None, None]
    remembered = np.where((after >= 0)[:, None, None], cells * np.exp(left), cells)
    recorded_ohm, _ = measured(SQUARE, remembered, Unmodelled(), 5)
    (one,) = watched([replace(recording, recorded=recorded_ohm)])
    assert one.until_s == pytest.approx(16, abs=2)


def test_a_step_of_noise_is_no_load(tmp_path: Path) -> None:
    """A recording not made with this package, in whose first frames ripple steps: a load was 1.5 times as probable."""
    bare, *_ = attached("nothing", 4.0, 98004)
    bare.save(tmp_path / "bare.h5")
    assert detect_recording(tmp_path / "bare.h5").answer == "nothing"
