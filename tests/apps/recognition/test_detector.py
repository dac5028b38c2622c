"""Recognition against scenes whose truth is known.

With it come its parts, and what it makes of frames over time.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from laws.recognised import answered
from promises import promise
from scipy.stats import multivariate_normal

from docs.studies.attachments import recording as attached
from lampest import (
    Array,
    Block,
    Faults,
    Film,
    GroundedReadout,
    LoadedColumnsReadout,
    OralDisc,
    Panel,
    Recording,
    Ring,
    Rod,
    Scene,
    Shape,
    SuctionCup,
    TwoPointReadout,
    VirtualGroundReadout,
)
from lampest.apps.recognition.attachment import Attachment, attachments_of
from lampest.apps.recognition.detect.answer import PRESSES, answer_of
from lampest.apps.recognition.detect.detection import detect_recording
from lampest.apps.recognition.detector import (
    SD,
    Detector,
    Verdict,
    field_fit,
    potts_cost,
    prior,
    states,
    without_load,
)
from lampest.apps.recognition.model_errors import ModelErrors
from lampest.apps.recognition.observation import Baseline, Observation, counting
from lampest.apps.recognition.watch import Watch
from lampest.apps.recognition.watch_parts import WatchSetup
from lampest.files.levels import MAX_MEAN_SQUARE
from lampest.panel.response import CURVE
from lampest.recording.shapes.disc import Disc
from lampest.recording.simulation.measure import Unmodelled, measured
from lampest.recording.simulation.simulation import Course, Simulation, simulate

PANEL = Panel(9, 11, 10.0)
CENTRE = (52.0, 37.0)
MOUTH = OralDisc(
    centre_mm=CENTRE, diameter_mm=34, rim_width_mm=5.5, pressure_kpa=-11, rim_kpa=85, tilt=0.2
)
LOADS: dict[str, Any] = {
    "rod": Rod(centre_mm=CENTRE, diameter_mm=40, mass_g=700),
    "ring": Ring(centre_mm=CENTRE, inner_diameter_mm=26, outer_diameter_mm=37, mass_g=850),
    "cup": SuctionCup(
        centre_mm=CENTRE, inner_diameter_mm=26, outer_diameter_mm=37, pressure_kpa=-9
    ),
    "mouth": MOUTH,
}
# Two of 25 to 36 mm, on small and on large panels; and two faint ones on a film that answers a
# fifth less and unevenly, one of which might be a rod where they are compared coarsely.
BENT = Unmodelled(response_loss=0.2, response_spread=0.15)
FAINT_LOADS = (
    (27, {"pressure_kpa": -4, "rim_width_mm": 6, "unevenness": 0.25}),
    (25, {"pressure_kpa": -8, "elongation": 1.15}),
)
SMALL_MOUTHS = (
    (25.0, {"pressure_kpa": -9, "rim_width_mm": 5}),
    (27.0, {"pressure_kpa": -9, "rim_width_mm": 5}),
)
UNEVEN = ((36.0, {"unevenness": 0.2}), (28.0, {"unevenness": 0.2}))
STRONG = OralDisc(
    centre_mm=(37, 35), diameter_mm=32, rim_width_mm=5.5, pressure_kpa=-10, rim_kpa=60
)
SMALL_ROD = Rod(centre_mm=(37, 35), diameter_mm=30, mass_g=300)
SQUARE = Scene(Panel(8, 8), TwoPointReadout(noise_lsb=0.7), 140.0)


def recorded(
    *loads: Any, panel: Panel = PANEL, seed: int = 3, frames: int = 2, **options: Any
) -> Recording:
    scene = Scene(panel=panel, readout=TwoPointReadout(noise_lsb=0.7), series_resistance_ohm=140.0)
    return simulate(
        Simulation(schema=1, seed=seed, scene=scene, frames=frames, loads=loads, **options)
    )


def frames_of(
    recording: Recording, measured: Any = None, errors: ModelErrors | None = None
) -> list[Observation]:
    readings = recording.readings()
    panel = recording.scene.panel
    resting = readings[[0, 1, 2]].mean()
    baseline = Baseline.of(resting.value, resting.sigma, recording.scene, errors or ModelErrors())
    values = readings.value if measured is None else measured
    dry = np.zeros(panel.shape)
    return [
        Observation(values[k], readings.sigma[k], baseline, dry, k - 1.0)
        for k in range(3, len(values))
    ]


def verdicts_of(frames: list[Any], panel: Panel = PANEL) -> list[Verdict]:
    detector = Detector(0.6 * panel.pitch_mm)
    return [detector.verdict(frame) for frame in frames]


def disc_of(verdict: Verdict) -> Disc:
    (sucking,) = verdict.discs
    return sucking.disc


def verdict_on(*loads: Any, panel: Panel = PANEL, **options: Any) -> Verdict:
    return verdicts_of(frames_of(recorded(*loads, panel=panel, **options)), panel)[-1]


def mouth(centre_mm: tuple[float, float], diameter_mm: float, **form: float) -> OralDisc:
    natural = {"rim_width_mm": 5.5, "pressure_kpa": -10.0, **form}
    return OralDisc(centre_mm=centre_mm, diameter_mm=diameter_mm, **natural)


SUCKING: dict[str, tuple[Any, float, Panel]] = {
    "cup": (LOADS["cup"], 1.5, PANEL),
    "mouth": (MOUTH, 1.5, PANEL),
    "even": (mouth(CENTRE, 36.0), 2.0, PANEL),
    "long": (
        mouth(CENTRE, 36.0, elongation=1.2, elongation_deg=30.0, unevenness=0.3),
        2.0,
        PANEL,
    ),
    "lobed": (mouth(CENTRE, 36.0, unevenness=0.3, lobes=3, tilt=0.3), 2.0, PANEL),
    "partly off": (mouth((8.0, 37.0), 36.0), 2.0, PANEL),
    "pressed": (mouth(CENTRE, 36.0, extra_rim_kpa=60.0), 2.0, PANEL),
    **{
        f"{rows} × {columns}": (
            mouth(
                (0.47 * (columns - 1) * pitch, 0.55 * (rows - 1) * pitch),
                4 * pitch,
                rim_width_mm=6,
            ),
            pitch / 4,
            Panel(rows, columns, pitch),
        )
        for rows, columns, pitch in ((6, 6, 10.0), (8, 14, 7.0), (16, 12, 12.0))
    },
}


@pytest.mark.parametrize(("width", "small"), [(16, True), (40, False)])
def test_a_load_presses_probably_only_where_suction_would_show(width: float, small: bool) -> None:
    """It stands between four cells. One suction in twenty raises none; on a mat nothing sucks."""
    rod = Rod(centre_mm=(45, 45), diameter_mm=width, mass_g=400)
    verdict = verdict_on(rod)
    (load,) = attachments_of(verdict, 0.0)
    answer, probability, why = answer_of(load, 4.0)
    assert answer == PRESSES
    assert probability == (0.5 if small else 0.95)
    assert ("too small" in why) == small
    repeated = load
    for _ in range(5):
        repeated = repeated.continued(load)
    assert repeated.sucks == load.sucks  # that it shows no suction again is no further evidence
    (contact,) = attachments_of(verdict, 0.0, any_form=True)
    assert contact.continued(contact).sucks < 1e-5 and not contact.small


@pytest.mark.parametrize("name", SUCKING)
def test_a_load_that_sucks_has_its_place_and_its_size(name: str) -> None:
    """A mouth may be uneven or not round, or may hang over the edge of the panel."""
    load, tolerance, panel = SUCKING[name]
    verdict = verdict_on(load, panel=panel)
    (sucking,) = verdict.discs
    true = load.disc()
    assert sucking.goodness < MAX_MEAN_SQUARE and sucking.place.probability > 0.99
    assert sucking.disc.diameter_mm == pytest.approx(true.diameter_mm, abs=tolerance)
    assert np.hypot(sucking.disc.x_mm - true.x_mm, sucking.disc.y_mm - true.y_mm) < tolerance
    suction, suction_sd = sucking.report["suction_kpa"]
    assert abs(suction - true.suction_kpa) < 2 * suction_sd


@pytest.mark.parametrize("name", ["rod", "ring"])
def test_a_load_that_presses_does_not_suck(name: str) -> None:
    verdict = verdict_on(LOADS[name])
    assert verdict.nothing < 1e-6 and not verdict.discs
    assert all(load.sucks <= 0.5 for load in attachments_of(verdict, 0.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("places", "forms", "panel", "unmodelled"),
    [
        (((28, 25), (76, 56)), UNEVEN, PANEL, None),
        (((25, 30), (84, 58)), FAINT_LOADS, PANEL, BENT),
        (((22, 20), (79, 60)), FAINT_LOADS, PANEL, BENT),
        (((12, 14), (38, 37)), SMALL_MOUTHS, Panel(6, 6), None),
        (((25, 80), (75, 35)), SMALL_MOUTHS, Panel(12, 12), None),
    ],
    ids=["uneven", "faint and far", "faint and near", "small panel", "large panel"],
)
def test_two_mouths_are_recognised_as_two(
    places: Any, forms: Any, panel: Panel, unmodelled: Unmodelled | None
) -> None:
    mouths = [mouth(place, size, **form) for place, (size, form) in zip(places, forms, strict=True)]
    verdict = verdict_on(*mouths, panel=panel, unmodelled=unmodelled or Unmodelled())
    found = sorted(verdict.discs, key=lambda sucking: sucking.disc.x_mm)
    assert len(found) == 2
    if forms is UNEVEN:  # the waves of a rim leave its diameter less certain
        for sucking, (size, _) in zip(found, forms, strict=True):
            diameter, diameter_sd = sucking.report["diameter_mm"]
            assert abs(diameter - size) < 2 * diameter_sd < 0.3 * diameter
    if forms is SMALL_MOUTHS:  # a row of cells hardly tells its two sides apart
        np.testing.assert_allclose([sucking.disc[:2] for sucking in found], places, atol=5.0)


def test_static_errors_of_readings_are_allowed_for() -> None:
    """All readings have a constant error of 5 %, which shifts unloaded cells by a half."""
    load = mouth(CENTRE, 36.0)
    recording = recorded(load, unmodelled=Unmodelled(reading_error=0.05), frames=1)
    allowed, ignored = (
        verdicts_of(frames_of(recording, errors=ModelErrors(reading_error=error)))[-1]
        for error in (0.05, 0.0)
    )
    (sucking,) = allowed.discs
    assert sucking.goodness < MAX_MEAN_SQUARE
    diameter, diameter_sd = sucking.report["diameter_mm"]
    assert abs(diameter - load.diameter_mm) < 2 * diameter_sd
    assert not ignored.discs


def test_unloaded_readings_do_not_differ_from_their_baseline() -> None:
    """However much they are off: squares of errors of 5 % would be many times the noise."""
    recording = recorded(unmodelled=Unmodelled(reading_error=0.05), frames=1)
    resting = recording.readings()[[0, 1, 2]].mean()
    errors = ModelErrors(reading_error=0.05)
    baseline = Baseline.of(resting.value, resting.sigma, recording.scene, errors)
    frame = Observation(resting.value, resting.sigma, baseline, np.zeros(PANEL.shape))
    assert np.all(np.abs(frame.residual()) < 0.2 * resting.sigma.ravel())


@pytest.mark.slow
def test_the_field_ignores_a_single_outlying_reading() -> None:
    blocks = [
        Block(centre_mm=place, length_mm=60, width_mm=14, mass_g=300)
        for place in ((40, 20), (60, 55))
    ]
    frame = frames_of(recorded(*blocks))[0]
    wild = frame.measured.copy()
    wild[1, 9] *= 3
    clean, fooled = (
        field_fit(candidate)[0] for candidate in (frame, replace(frame, measured=wild))
    )
    assert (
        np.abs(fooled.change - clean.change).max() < 0.3 and fooled.evidence > clean.evidence - 30
    )


@pytest.mark.slow
def test_contacts_of_any_shape_and_thin_lines_do_not_suck() -> None:
    """Under a line few cells change.

    Suction that a rim cancels in every patch could be made to explain them.
    """
    angles = (((40, 20), 70, 20), ((60, 45), 80, -35), ((30, 60), 50, 80), ((85, 20), 40, 60))
    form = {"width_mm": 14, "mass_g": 300}
    blocks = [
        Block(centre_mm=place, length_mm=length, angle_deg=angle, **form)
        for place, length, angle in angles
    ]
    verdict = verdict_on(*blocks)
    assert verdict.nothing < 1e-6 and not verdict.discs
    for place, angle in (
        ((15.0, 15.0), 135.0),
        ((52.0, 37.0), 45.0),
        ((75.0, 47.0), 20.0),
        ((40.0, 60.0), 90.0),
    ):
        line = Block(centre_mm=place, length_mm=45, width_mm=5, mass_g=150, angle_deg=angle)
        assert not verdict_on(line).discs


MAT = Scene(
    Panel(6, 12, 10.0), GroundedReadout(noise_lsb=1, adc_bits=10), purpose="mat"
)  # two feet stand on it
FEET = [Rod(centre_mm=(x, 25), diameter_mm=40, mass_g=1500) for x in (25, 85)]


def mat_frame(scene: Scene, loads: list[Rod], errors: ModelErrors) -> Observation:
    simulation = Simulation(schema=1, seed=3, scene=scene, frames=1, loads=tuple(loads))
    return frames_of(simulate(simulation), errors=errors)[0]


def test_an_error_of_the_reference_explains_no_change_of_cells() -> None:
    """It is in the unloaded frames as well, so changes of the readings exclude it."""
    misfits = []
    for reference in (0.0, 0.035):
        frame = mat_frame(MAT, FEET, replace(ModelErrors(), channel_ohm=0.0, reference=reference))
        verdict = Detector(6.0, any_form=True).verdict(frame)
        assert verdict.nothing < 1e-6
        assert len(attachments_of(verdict, 0.0)) == len(FEET)
        misfits.append(without_load(frame)[0].chi2)
    assert misfits[1] > 0.8 * misfits[0]


def test_voltages_leave_a_large_error_of_the_reference_to_the_cells() -> None:
    """They depend on the cells over the reference alone, which is common to all frames."""
    readout = LoadedColumnsReadout(polarity="down", load_ohm=4700.0, adc_bits=10, noise_lsb=1)
    scene = Scene(Panel(8, 8, 10.0), readout, purpose="mat")
    rod = Rod(centre_mm=(16, 21), diameter_mm=28, mass_g=733)
    exact, doubtful = (
        mat_frame(scene, [rod], replace(ModelErrors(), reference=error)) for error in (0.0, 0.25)
    )
    resting = np.exp(np.median(doubtful.baseline.logarithm))
    assert resting == pytest.approx(3050, rel=0.1)
    np.testing.assert_allclose(doubtful.free_map, exact.free_map, atol=0.02)


def test_a_dead_row_that_the_scene_names_leaves_the_other_cells_certain() -> None:
    """Its cells do not conduct; where they may have any resistance, all others are uncertain."""
    frames = []
    for scene in (SQUARE, replace(SQUARE, faults=Faults(dead_rows=(7,)))):
        made = simulate(Simulation(schema=1, seed=3, scene=scene, frames=1, loads=(SMALL_ROD,)))
        readings = made.readings()
        value = np.where(scene.broken, 600.0, readings.value)
        sigma = counting(np.where(scene.broken, np.inf, readings.sigma[0]), value[0])
        baseline = Baseline.of(value[:3].mean(axis=0), sigma, scene, ModelErrors())
        frames.append(Observation(value[3], sigma, baseline, np.zeros(scene.panel.shape), 2.0))
    whole, dead = frames
    read = np.s_[:7]
    assert np.median(dead.free_sd[read]) < 1.2 * np.median(whole.free_sd[read])
    np.testing.assert_allclose(dead.free_map[read], whole.free_map[read], atol=0.03)


@pytest.mark.parametrize("rise_kpa", [-1.0, 3.0])
def test_a_level_of_the_water_is_no_load(rise_kpa: float) -> None:
    """Cells at different depths, on films of their own, respond differently to it."""
    rng = np.random.default_rng(5)
    water = 2.0 + 0.1 * np.arange(9.0)[:, None] + np.zeros(PANEL.shape)
    response = np.log(np.interp(water + rise_kpa, *CURVE.T) / np.interp(water, *CURVE.T))
    change = response * np.exp(0.1 * rng.standard_normal(PANEL.shape))
    made = recorded(SMALL_ROD, frames=1)
    resting = made.readings()[[0, 1, 2]].mean()
    baseline = Baseline.of(resting.value, resting.sigma, made.scene, ModelErrors())
    levelled = baseline.network(change).reading()
    frame = Observation(levelled, resting.sigma, baseline, water, 60.0)
    assert Detector(6.0).verdict(frame).nothing > 0.99


def test_no_load_is_no_verdict_where_its_misfit_refutes_it() -> None:
    frame = mat_frame(MAT, FEET, ModelErrors())
    field, _ = field_fit(frame)
    favoured = replace(without_load(frame)[0], evidence=field.evidence + 100)
    assert Verdict.of(frame, field, (favoured,)).nothing == 0
    explains = replace(favoured, chi2=float(frame.measured.size))
    assert Verdict.of(frame, field, (explains,)).nothing > 0.99
    refuted = replace(field, chi2=2 * favoured.chi2)
    assert Verdict.of(frame, refuted, (favoured,)).nothing > 0.5


def test_contacts_are_found_where_a_load_lowers_the_sensitivity() -> None:
    """Beside pull-ups of ten times the cells the error of a pressed cell is twice that at rest."""
    pull_ups = LoadedColumnsReadout(
        polarity="down", load_ohm=35000.0, drive_ohm=30.0, adc_bits=10, noise_lsb=1
    )
    scene = Scene(Panel(8, 8, 10.0), pull_ups, purpose="mat")
    rods = [
        Rod(centre_mm=(16, 21), diameter_mm=28, mass_g=733),
        Rod(centre_mm=(59, 58), diameter_mm=22, mass_g=500),
    ]
    frame = mat_frame(scene, rods, ModelErrors())
    verdict = Detector(6.0, any_form=True).verdict(frame)
    places = [load.place for load in attachments_of(verdict, 0.0)]
    for rod in rods:
        assert min(np.hypot(*np.subtract(place, rod.centre_mm)) for place in places) < 10
    assert len(places) == len(rods)


@pytest.mark.parametrize("purpose", [None, "mat"])
def test_loads_of_any_number_are_found(purpose: Any) -> None:
    """A shape that leaves contacts unexplained is no answer, and drops no reading under them."""
    scene = Scene(Panel(8, 12, 10.0), GroundedReadout(noise_lsb=1, adc_bits=10), purpose=purpose)
    rods = [
        Rod(centre_mm=place, diameter_mm=width, mass_g=mass)
        for place, width, mass in (
            ((80, 59), 17, 334),
            ((29, 33), 24, 186),
            ((78, 18), 15, 147),
            ((10, 62), 16, 200),
        )
    ]
    frame = mat_frame(scene, rods, ModelErrors())
    verdict = Detector(6.0, any_form=purpose == "mat").verdict(frame)
    places = [load.place for load in attachments_of(verdict, 0.0)]
    assert len(places) == len(rods)
    for rod in rods:
        assert min(np.hypot(*np.subtract(place, rod.centre_mm)) for place in places) < 10


def test_cells_that_rise_with_their_whole_line_are_not_under_suction() -> None:
    """Amplifiers that saturate under a heavy rod make other cells of their columns rise."""
    amplifiers = VirtualGroundReadout(drive_ohm=70.0, feedback_ohm=1000.0, adc_bits=10, noise_lsb=1)
    scene = Scene(Panel(10, 10, 10.0), amplifiers)
    rod = Rod(centre_mm=(59, 63), diameter_mm=44, mass_g=4500)
    course = Course(start_s=1.2)
    recording = simulate(Simulation(1, 3, scene, frames=6, loads=(rod,), course=course))
    contacts = answered(recording).attachments
    assert contacts
    for contact in contacts:
        assert answer_of(contact, 4.0)[0] == PRESSES
        assert contact.distance(rod.centre_mm) < rod.diameter_mm / 2 + 10


def test_the_field_has_the_evidence_of_its_gaussian() -> None:
    """Where readings are straight in ln r, it is that of a Gaussian through them.

    The Gaussian has the prior's covariance.
    """
    frame = frames_of(recorded(frames=1))[0]
    cells = PANEL.rows * PANEL.columns
    fit, _ = field_fit(frame)
    network = frame.baseline.network(fit.change)
    slope = frame.sensitivity(network)
    spread = frame.covariance(network) + slope @ prior(frame, np.full(cells, SD[0])) @ slope.T
    expected = multivariate_normal(np.zeros(cells), spread, allow_singular=False).logpdf(
        frame.residual()
    )
    constant = cells * np.log(2 * np.pi) / 2 - potts_cost(
        PANEL, states(PANEL, np.zeros(PANEL.shape))
    )
    assert fit.evidence == pytest.approx(expected + constant, abs=0.5)


@pytest.mark.slow
@pytest.mark.parametrize("place", [(4, 6), (3, 5), (1, 1)])
@pytest.mark.parametrize("ohm", [20.0, 160.0])
def test_an_outlier_does_not_move_the_mouth(ohm: float, place: tuple[int, int]) -> None:
    """Neither do the last bits of readings, where the outlier lies under the mouth."""
    load = mouth(CENTRE, 36.0)
    recording = recorded(load, frames=1)
    diameters = []
    for last_bits in (0.0, 1e-12):
        measured = recording.readings().value * (
            1 + last_bits * np.random.default_rng(1).standard_normal(PANEL.shape)
        )
        measured[3, *place] += ohm
        verdict = verdicts_of(frames_of(recording, measured))[-1]
        diameters.append(disc_of(verdict).diameter_mm)
    assert diameters[0] == pytest.approx(load.diameter_mm, abs=0.6)
    assert diameters[1] == pytest.approx(diameters[0], abs=0.01)


@pytest.mark.slow
def test_strong_suction_excludes_a_smaller_disc(tmp_path: Path) -> None:
    """Cells that suction opens change the readings by little more.

    Under a smaller disc they would close again and change the readings by much.
    """
    scene = Scene(Panel(10, 10), TwoPointReadout(), series_resistance_ohm=140.0)
    load = OralDisc(
        centre_mm=(45.2, 51.3), diameter_mm=32.2, rim_width_mm=4.5, pressure_kpa=-20, rim_kpa=60
    )
    unmodelled = Unmodelled(
        channel_spread_ohm=3.0, reference_tolerance=0.01, response_spread=0.25, response_loss=0.3
    )
    times = {
        "frames": 12,
        "baseline_frames": 5,
        "frame_period_s": 0.25,
        "course": Course(start_s=2.0),
    }
    simulate(Simulation(1, 1, scene, loads=(load,), unmodelled=unmodelled, **times)).save(
        tmp_path / "mouth.h5"
    )
    (attachment,) = detect_recording(tmp_path / "mouth.h5").attachments
    assert (
        attachment.diameter_mm[1] < 4
        and abs(attachment.diameter_mm[0] - 32.2) < 2 * attachment.diameter_mm[1]
    )


def load_that_leaves(
    film: Film | None, load: Shape = STRONG, frames: int = 40, release: float = 15, start: float = 4
) -> Recording:
    """A load from `start` on, and then nothing; s after the unloaded frames."""
    course = Course(
        start_s=start, approach_s=0.5, attachment_s=0.5, release_at_s=release, release_s=0.2
    )
    return simulate(
        Simulation(1, 5, SQUARE, frames=frames, loads=(load,), course=course, film=film)
    )


def watched(
    recordings: list[Recording], minutes: float = 0.0, drift: float = 0.0
) -> tuple[Attachment, ...]:
    """Return the attachments of successive recordings; the first one has the baseline.

    minutes : between the first frames of the load and its last. drift : of ln y a decade, of each
    reading by itself a tenth of that.
    """
    readings = recordings[0].readings()
    resting = readings[[0, 1, 2]].mean()
    setup = WatchSetup(SQUARE, Detector(6.0), np.zeros(SQUARE.panel.shape), ModelErrors())
    watch = Watch.begin(setup, resting.value, readings.sigma[0], readings.value[:3], 0.0)
    rng = np.random.default_rng(3)
    time = 0.0
    wander = drift * (1 + 0.1 * rng.standard_normal(SQUARE.panel.shape))

    def pushed(watch: Watch, value: Array, sigma: Array, time: float) -> Watch:
        return watch.push(value * np.exp(wander * np.log10(1 + time / 10)), sigma, time)

    for recording in recordings:
        readings = recording.readings()
        for number in range(3, len(readings.value)):
            time += 1.0
            watch = pushed(watch, readings.value[number], readings.sigma[number], time)
            for _ in range(round(60 * minutes) if number == 14 else 0):
                time += 1.0
                noise = readings.sigma[number] * rng.standard_normal(SQUARE.panel.shape)
                watch = pushed(watch, readings.value[number] + noise, readings.sigma[number], time)
    return watch.attachments


@pytest.mark.parametrize("creep", [0.03, 0.1])
def test_the_memory_of_a_lamprey_is_not_detected(creep: float) -> None:
    (attachment,) = watched([load_that_leaves(Film(0.24, creep, cell_spread=0.2))])
    assert (
        attachment.sucks > 0.9
        and attachment.since_s == pytest.approx(5, abs=2)
        and attachment.until_s == pytest.approx(16, abs=2)
    )


@promise("apps/recognition/detect: **Attached is attached until the readings step.**")
@pytest.mark.slow
@pytest.mark.parametrize("load", [STRONG, SMALL_ROD], ids=["mouth", "rod"])
@pytest.mark.parametrize("drift", [0.0, 0.02])
def test_an_attachment_lasts_until_the_readings_step(load: Shape, drift: float) -> None:
    (attachment,) = watched([load_that_leaves(Film(0.24, 0.03), load)], minutes=5, drift=drift)
    assert attachment.since_s == pytest.approx(5, abs=2) and attachment.until_s == pytest.approx(
        316, abs=5
    )
    assert (attachment.sucks > 0.5) == (load is STRONG)


def test_a_weaker_returning_lamprey_is_detected() -> None:
    returning = load_that_leaves(None, replace(STRONG, pressure_kpa=-4, rim_kpa=30))
    answer = watched([load_that_leaves(None), returning])
    assert len(answer) == 2 and all(attachment.sucks > 0.9 for attachment in answer)


@pytest.mark.slow
def test_a_lamprey_with_weaker_suction_stays_attached() -> None:
    less = load_that_leaves(
        None, replace(STRONG, pressure_kpa=-3, rim_kpa=20), release=60, start=-0.9
    )
    answer = watched([load_that_leaves(None, frames=12, release=60), less])
    assert answer[-1].present and answer[-1].sucks > 0.5


@pytest.mark.parametrize("seed", range(2))
def test_a_bare_panel_shows_nothing_for_ten_minutes(seed: int) -> None:
    """With drift, a gain that scatters, ripple and outliers."""
    real = Unmodelled(gain_spread=0.001, supply_ripple_lsb=0.4, outlier_probability=1e-4)
    bare = simulate(Simulation(1, seed, SQUARE, frames=600, unmodelled=real))
    assert watched([bare], drift=0.02) == ()


@pytest.mark.parametrize("minutes", [1.0, 10.0])
def test_memory_of_another_kind_is_not_detected(minutes: float) -> None:
    """About 15 % of a cell's change remains after the load and fades exponentially.

    The share scatters by a fifth between cells.
    """
    recording = load_that_leaves(None, frames=60)
    cells = recording.truth_cell_resistance
    frames_since = np.arange(len(cells)) - 18
    part = 0.15 * np.exp(0.2 * np.random.default_rng(3).standard_normal(SQUARE.panel.shape))
    remaining = (
        part
        * np.log(cells[12] / cells[0])
        * np.exp(-np.maximum(frames_since, 0) / (60 * minutes))[:, None, None]
    )
    remembered = np.where((frames_since >= 0)[:, None, None], cells * np.exp(remaining), cells)
    recorded_ohm, _ = measured(SQUARE, remembered, Unmodelled(), 5)
    (attachment,) = watched([replace(recording, recorded=recorded_ohm)])
    assert attachment.until_s == pytest.approx(16, abs=2)


def test_a_step_of_the_noise_is_not_a_load(tmp_path: Path) -> None:
    """A recording not made with this package, in whose first frames ripple steps.

    A load was 1.5 times as probable.
    """
    bare, *_ = attached("nothing", 4.0, 98004)
    bare.save(tmp_path / "bare.h5")
    assert detect_recording(tmp_path / "bare.h5").answer == "nothing"
