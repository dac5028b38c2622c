"""Claims of the pages of which no other test asks."""

import subprocess
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from promises import promise

import lampest
from lampest import (
    Array,
    Estimator,
    Gradient,
    InputError,
    Lines,
    Misfit,
    Panel,
    Readings,
    Scene,
    SeriesPerLine,
    Systematic,
    TwoPointReadout,
    two_point_resistance,
)
from lampest.apps.calibration.loads import Loaded, fit_loads, response_of
from lampest.apps.calibration.resistors import calibrate_resistors
from lampest.apps.film.memory import FilmMemory
from lampest.apps.film.pressure import pressure_of
from lampest.apps.recognition.detect.detection import detect_recording
from lampest.apps.recognition.suction import suctions
from lampest.cost import problem as problem_module
from lampest.cost.given import Background
from lampest.estimate.methods import method as method_module
from lampest.inference import model_error
from lampest.inference.prepared import Prepared
from lampest.panel.response import PUBLISHED
from lampest.solvers import direction
from lampest.solvers.hessian import Hessian, Smoothing
from lampest.solvers.multistart import evaluated
from lampest.solvers.preconditioners import TwoLevel
from lampest.solvers.solution import Solution, Status
from tests.estimates import recording_of

Command = Callable[..., SimpleNamespace]
LIBRARY = Path(__file__).parents[2] / "firmware" / "lampest_estimate"
SMOOTH = (Misfit(), Gradient(weight=1e-3))
NOISE = {"adc_bits": 12, "readings": 20, "noise_lsb": 0.7}


def cells_of(shape: tuple[int, ...], seed: int = 4) -> Array:
    """Cells around 3 kilo-ohm."""
    return 3000 * np.exp(0.5 * np.random.default_rng(seed).standard_normal(shape))


def test_a_product_with_the_hessian_takes_less_memory_than_a_matrix_over_the_cells() -> None:
    shape = (32, 32)
    scene = Scene(Panel(*shape), TwoPointReadout())
    exact = two_point_resistance(cells_of(shape))[None]
    estimator = Estimator(SMOOTH, "reduced")
    data = estimator.data(Readings.of(scene, exact[0]).alone(), Background(scene))
    point = evaluated(estimator.cost(scene, 1), data, 1.1 * cells_of(shape)[None])
    hessian = Hessian(point, Smoothing.start(point))
    step = np.random.default_rng(1).standard_normal(exact.size)
    tracemalloc.start()
    hessian.product(step)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 0.2 * 8 * exact.size**2


@pytest.mark.parametrize("formulation", ["reduced", "nodal"])
def test_no_result_depends_on_the_clock_without_a_limit(
    formulation: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A computer of which every step seems to take an hour gives the same bytes."""
    recording = recording_of(
        Scene(Panel(4, 5), TwoPointReadout(**NOISE)), two_point_resistance(cells_of((4, 4, 5))), 1
    )
    usual = lampest.reconstruct(recording, SMOOTH, formulation=formulation)
    hours = iter(range(0, 3600 * 10**6, 3600))
    for module in (method_module, problem_module):
        for name in ("perf_counter", "monotonic"):
            monkeypatch.setattr(module, name, lambda: float(next(hours)), raising=False)
    slow = lampest.reconstruct(recording, SMOOTH, formulation=formulation)
    assert next(hours) > 3600
    assert_array_equal(slow.cell_resistance, usual.cell_resistance)
    assert_array_equal(slow.cell_resistance_errors, usual.cell_resistance_errors)
    assert slow.status == usual.status


def test_another_preconditioner_gives_the_same_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = recording_of(
        Scene(Panel(5, 6), TwoPointReadout(**NOISE)), two_point_resistance(cells_of((3, 5, 6))), 1
    )
    usual = lampest.reconstruct(recording, SMOOTH, formulation="reduced")
    calls = list[object]()

    def two_level(hessian: Hessian, free: object) -> TwoLevel:
        calls.append(free)
        return TwoLevel.of(hessian)

    monkeypatch.setattr(direction, "preconditioner", two_level)
    changed = lampest.reconstruct(recording, SMOOTH, formulation="reduced")
    assert calls and changed.status == usual.status
    assert_allclose(changed.cell_resistance, usual.cell_resistance, rtol=1e-6)


@promise("apps/calibration/calibrate_loads: The curve is therefore always monotone.")
def test_a_calibrated_curve_falls_whatever_the_cells_answer() -> None:
    rng = np.random.default_rng(2)
    pressure = np.tile([[0.5], [2.0], [8.0], [20.0], [30.0]], (1, 12))
    for _ in range(3):
        change = -rng.uniform(0.2, 3.0, pressure.shape)  # in no order of the pressures
        fit = fit_loads(
            Loaded(change, np.full(pressure.shape, 0.01), pressure, 0 * pressure, np.zeros(12))
        )
        assert np.all(np.diff(response_of(fit, PUBLISHED, (3, 4), 0.0).resistance_ohm) <= 0)


def test_pressures_of_a_scene_without_a_film_follow_no_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("has a film")

    for name in ("answered", "observed"):
        monkeypatch.setattr(FilmMemory, name, refuse)
    ratio = np.exp(-np.random.default_rng(1).uniform(0, 1, (5, 3, 4)))
    scene = Scene(Panel(3, 4), response=PUBLISHED)
    pressures = pressure_of(ratio, 0.9 * ratio, 1.1 * ratio, scene, np.arange(5.0))
    alone = pressure_of(ratio[3:4], 0.9 * ratio[3:4], 1.1 * ratio[3:4], scene)
    assert_array_equal(pressures.pressure[3], alone.pressure[0])
    with pytest.raises(AssertionError, match="has a film"):
        pressure_of(
            ratio,
            0.9 * ratio,
            1.1 * ratio,
            replace(scene, film=lampest.Film(0.2, 0.05)),
            np.arange(5.0),
        )


@pytest.mark.slow
def test_the_library_calls_nothing_but_arithmetic_and_has_no_globals(tmp_path: Path) -> None:
    """Symbols of its object files: functions of its own, of math.h, and moves of memory."""
    objects = list[str]()
    for source in sorted(LIBRARY.glob("*.c")):
        objects.append(str(tmp_path / f"{source.stem}.o"))
        words = ["gcc", "-std=c99", "-O2", "-c", str(source), "-o", objects[-1]]
        subprocess.run(words, check=True)
    listed = subprocess.run(["nm", *objects], capture_output=True, text=True, check=True).stdout
    kinds = [line.split()[-2:] for line in listed.splitlines() if len(line.split()) > 1]
    assert not [name for kind, name in kinds if kind in "bBcCdDsS"]
    own = {name for kind, name in kinds if kind == "T"}
    arithmetic = {"fmaf", "sqrtf", "expf", "logf", "log1pf", "fabsf", "memcpy", "memset"}
    assert own and {name for kind, name in kinds if kind == "U"} <= own | arithmetic


def wired_recording(table: Array, wire: float) -> lampest.Recording:
    """Resistors on lines of that wire behind channels of 60 to 90 ohm; read with noise."""
    rng = np.random.default_rng(3)
    rows, columns = (tuple(rng.uniform(60, 90, length)) for length in table.shape)
    true = Scene(
        Panel(*table.shape),
        TwoPointReadout(adc_bits=10, readings=20, noise_lsb=0.7),
        SeriesPerLine(rows=rows, columns=columns),
        lines=Lines(wire, wire),
    )
    readout = true.circuit
    exact = readout.to_recorded(readout.exact_reading(table, true.wiring), true)
    recorded = exact + readout.sigma(exact) * rng.standard_normal((10, *table.shape))
    return recording_of(
        replace(true, series_resistance_ohm=140.0, lines=Lines(1.0, 1.0)), recorded, name="r"
    )


def test_two_point_resistors_tell_wire_from_channels_only_where_they_form_loops() -> None:
    table = np.random.default_rng(2).choice([220.0, 470.0, 1000.0, 2200.0], (5, 6))
    calibration = calibrate_resistors([wired_recording(table, 2.0)], [table], tolerance=1e-3)
    wires = {
        number.number.name: number
        for number in calibration.numbers
        if number.number.name.startswith("lines")
    }
    assert len(wires) == 2
    for number in wires.values():
        assert number.sigma < 0.5 and abs(number.value - 2.0) < 4 * number.sigma
    number = np.indices(table.shape).min(axis=0)
    tree = np.where(number == 0, table, np.inf)  # first row and first column
    with pytest.raises(InputError, match=r"the readings do not tell lines\.row_ohm_per_cell"):
        calibrate_resistors([wired_recording(tree, 2.0)], [tree], tolerance=1e-3)


def test_detection_of_more_than_1024_cells_cannot_say(tmp_path: Path) -> None:
    frames = np.full((5, 33, 32), 3000.0)
    frames[3:, 4:7, 4:7] *= 0.3
    scene = Scene(Panel(33, 32), TwoPointReadout(noise_lsb=0.7), purpose="mat")
    recording_of(scene, two_point_resistance(frames), 3).save(tmp_path / "mat.h5")
    answer = detect_recording(tmp_path / "mat.h5")
    assert answer.answer == "cannot say" and "up to 1024 cells" in answer.why


@promise("apps/foreign/import: `1/2/2025` is refused where day and month cannot be distinguished.")
def test_an_import_refuses_a_date_whose_day_may_be_its_month(tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    path.write_text("time,r0c0,r0c1\n1/2/2025 12:00,500,600\n1/3/2025 12:00,510,620\n")
    with pytest.raises(InputError, match=r"day/month/year or month/day/year"):
        lampest.import_file(path, 1, 2, unit="ohm")
    path.write_text(path.read_text().replace("1/3/2025", "1/31/2025"))
    recording, _ = lampest.import_file(path, 1, 2, unit="ohm")
    assert recording.time[1] == 30 * 86400 - 86400


R = 1000.0  # of the single resistors of the page of readouts
CHANNEL = 70.0
SINGLE: dict[str, lampest.Readout] = {
    "two_point": TwoPointReadout(),
    "loaded_columns": lampest.LoadedColumnsReadout(load_ohm=R, drive_ohm=CHANNEL),
    "all": lampest.GroundedReadout(sense="all", load_ohm=R, drive_ohm=CHANNEL),
    "one": lampest.GroundedReadout(sense="one", load_ohm=R, drive_ohm=CHANNEL),
    "virtual_ground": lampest.VirtualGroundReadout(
        feedback_ohm=R, drive_ohm=CHANNEL, sense_ohm=CHANNEL
    ),
}


def single(kind: str, *places: tuple[int, int]) -> float:
    """Reading at (0, 0) of resistors at these places."""
    cells = np.full((2, 2), 1e12)
    cells[tuple(np.transpose(places))] = R
    return float(SINGLE[kind].exact_reading(cells)[0, 0])


@pytest.mark.parametrize(
    ("kind", "sensed", "driven"),
    [
        ("two_point", 1.0, 1.0),
        ("loaded_columns", 1.0, (2 * R + CHANNEL) / (2 * R + 2 * CHANNEL)),
        ("all", 2 / 3, (2 * R + CHANNEL) / (2 * R + 2 * CHANNEL)),
        ("one", 2 / 3, 1.0),
        ("virtual_ground", (R + CHANNEL) / (R + 2 * CHANNEL), (R + CHANNEL) / (R + 2 * CHANNEL)),
    ],
)
def test_single_resistors_show_the_circuit_as_the_table_of_readouts_says(
    kind: str, sensed: float, driven: float
) -> None:
    """One more on the sensed line, one more on the driven line, three around an empty crossing."""
    usual = single(kind, (0, 0))
    assert single(kind, (0, 0), (1, 0)) / usual == pytest.approx(sensed, rel=0.04)
    assert single(kind, (0, 0), (0, 1)) / usual == pytest.approx(driven, rel=0.04)
    around = single(kind, (0, 1), (1, 1), (1, 0))
    if kind == "two_point":
        assert around == pytest.approx(3 * R)
    elif kind == "loaded_columns":
        apparent = SINGLE[kind].apparent_resistance(np.full((2, 2), around))[0, 0]
        assert apparent == pytest.approx(6 * R, rel=0.1)
    else:
        assert around < 0.05 * usual


def resting(evenness: float, hidden: bool = False) -> SimpleNamespace:
    """Changes of a mouth: a risen or a hidden cell within fallen ones, on an uneven panel."""
    change = np.zeros((7, 7))
    change[2:5, 2:5] = -1.0
    change[3, 3] = 0.0 if hidden else 1.0
    sd = np.full((7, 7), 0.02)
    sd[3, 3] = 1.0 if hidden else 0.02
    logarithm = 8 + evenness * np.random.default_rng(1).standard_normal((7, 7))
    panel = Panel(7, 7)
    baseline = SimpleNamespace(logarithm=logarithm, scene=Scene(panel))
    return SimpleNamespace(panel=panel, free_map=change, free_sd=sd, baseline=baseline)


def test_nothing_sucks_on_cells_as_uneven_as_under_loads_or_where_none_may_rise() -> None:
    (place,) = suctions(resting(0.1))
    assert place.cells[3, 3] and place.cells.sum() == 1
    assert not suctions(resting(0.1, hidden=True))
    uneven = resting(1.5)
    assert not suctions(uneven)
    pressed = resting(0.1)
    pressed.free_map[3, 3] = -1.0
    assert not suctions(pressed)


@pytest.mark.parametrize(
    ("unloaded", "key", "widened"),
    [(3, None, False), (3, "estimated", True), (0, None, True), (0, 0.0, False)],
)
def test_heavy_tails_widen_sigma_without_unloaded_frames_or_on_request(
    unloaded: int, key: float | str | None, widened: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(model_error, "heavy_tails", lambda *_: 3.0)
    scene = Scene(Panel(6, 6), TwoPointReadout(**NOISE), systematic=Systematic(model_error=key))
    exact = two_point_resistance(np.repeat(cells_of((1, 6, 6)), 5, axis=0))
    noise = scene.circuit.sigma(exact) * np.random.default_rng(7).standard_normal(exact.shape)
    prepared = Prepared(recording_of(scene, exact + noise, unloaded))
    assert prepared.noise.model_factor == (3.0 if widened else 1.0)


def test_own_and_common_errors_add_up_in_square_to_the_whole_one() -> None:
    scene = Scene(Panel(4, 5), TwoPointReadout(**NOISE), 140.0, systematic=Systematic(0.01, 3.0))
    recorded = two_point_resistance(cells_of((3, 4, 5))) + 140.0
    estimate = lampest.reconstruct(recording_of(scene, recorded, 1), [Misfit(weighting="noise")])
    whole = estimate.cell_resistance_errors / estimate.cell_resistance
    assert np.all(estimate.sigma_own > 0) and np.all(estimate.sigma_common > 0)
    assert_allclose(estimate.sigma_own**2 + estimate.sigma_common**2, whole**2, rtol=1e-6)


def test_a_calibration_that_does_not_show_its_resistors_writes_nothing(
    tmp_path: Path, lampest: Command
) -> None:
    scene = Scene(Panel(3, 4), TwoPointReadout(adc_bits=10, readings=20, noise_lsb=0.7))
    readings = two_point_resistance(np.repeat(cells_of((1, 3, 4)), 10, axis=0)) + 140.0
    readings += scene.circuit.sigma(readings) * np.random.default_rng(1).standard_normal(
        readings.shape
    )
    recording_of(scene, readings).save(tmp_path / "panel.h5")
    words = ("calibrate", tmp_path / "panel.h5", "--known", 1000, "--out", tmp_path / "new.yaml")
    completed = lampest(*words)
    assert completed.code == 2 and completed.err.count("\n") == 1
    assert "no calibration: " in completed.err and not (tmp_path / "new.yaml").exists()


def test_readings_behind_amplifiers_do_not_show_the_ratio_of_their_voltages() -> None:
    """Cells of half the size at half the driving voltage, and channels as much smaller."""
    usual = lampest.VirtualGroundReadout(
        feedback_ohm=R, drive_volt=1.0, converter_volt=2.5, drive_ohm=0.01, sense_ohm=0.01
    )
    half = replace(usual, drive_volt=0.5)
    cells = cells_of((4, 5))
    assert_allclose(half.exact_reading(cells / 2), usual.exact_reading(cells), rtol=1e-3)


@pytest.mark.parametrize(
    ("missing", "bounds", "enough"),
    [(18, 0, True), (19, 0, False), (0, 25, True), (0, 26, False), (18, 7, True), (18, 8, False)],
)
def test_a_frame_needs_half_of_its_readings_and_so_many_values_as_factors_of_lines(
    missing: int, bounds: int, enough: bool
) -> None:
    """6 × 6: at most 18 missing, at least 6 + 6 − 1 values."""
    scene = Scene(Panel(6, 6))
    recorded = two_point_resistance(cells_of((6, 6)))
    recorded.flat[:missing] = np.nan
    recorded.flat[missing : missing + bounds] = np.inf
    assert bool(Readings.of(scene, recorded).enough(scene)) == enough


@promise("howto/python: A frame can therefore be tried and discarded.")
def test_a_frame_can_be_tried_and_discarded() -> None:
    """The term carries the frame before on, so a frame that stayed would show."""
    scene = Scene(Panel(4, 5), TwoPointReadout(**NOISE))
    exact = two_point_resistance(cells_of((3, 4, 5)))
    resting, tried, next_one = (Readings.of(scene, frame) for frame in exact)
    estimator = Estimator((Misfit(weighting="noise"), lampest.Arrival()), "reduced")
    stream = lampest.Stream.begin(estimator, scene, 0.1, resting)
    alone = stream.push(next_one)[1].cell_resistance
    stream.push(tried)
    assert_array_equal(stream.push(next_one)[1].cell_resistance, alone)
    with pytest.raises(AttributeError):
        stream.estimator = estimator


@pytest.mark.parametrize(
    ("shape", "second", "solvers"),
    [
        ((4, 5), 0.1, ["ProjectedNewton", "Ipopt"]),
        ((4, 5), 1.0, ["Ipopt", "ProjectedNewton"]),
        ((13, 20), 0.1, ["ProjectedNewton"]),
    ],
    ids=["newton first", "ipopt first", "more than 256 cells"],
)
def test_a_frame_that_one_solver_does_not_solve_is_given_to_the_other(
    shape: tuple[int, int], second: float, solvers: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    called = list[str]()
    solve = method_module.best_solution

    def failing_once(solver: object, *given: object) -> Solution:
        called.append(type(solver).__name__)
        solution = solve(solver, *given)
        return replace(solution, status=Status.STALLED) if len(called) == 1 else solution

    scene = Scene(Panel(*shape), TwoPointReadout(**NOISE))
    readings = Readings.of(scene, two_point_resistance(cells_of(shape)))
    terms = (Misfit(weighting="noise"), lampest.LogGradient(weight=1.0))
    stream = lampest.Stream.begin(
        Estimator(terms, "auto", error_bars=False), scene, second, readings
    )
    monkeypatch.setattr(method_module, "best_solution", failing_once)
    _, step = stream.push(readings)
    assert called == solvers and step.solution.solved == (len(solvers) > 1)
