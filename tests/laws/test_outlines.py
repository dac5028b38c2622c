"""Laws of panels that are no full rectangle: absent crossings are nothing, whatever the outline."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from promises import promise

import lampest
from lampest import Cells, Panel, Scene, Simulation
from lampest.apps.recognition.detect.detection import detect_recording
from lampest.apps.recognition.detect.pressed import pressed_of
from lampest.inference.prepared import Prepared
from lampest.panel.readouts.floating import exact_two_point_resistance
from lampest.panel.response import PUBLISHED
from tests.apps.board.estimated import unchecked_case
from tests.estimates import recording_of
from tests.outlines import OUTLINES

READOUT = lampest.TwoPointReadout(adc_bits=16, readings=100, noise_lsb=0.5)
CONVERGED = 1e-6  # relative, of cells at the end of a solve; measured at most 8.5e-7 by IPOPT
MAX_CELL_ERROR = 5e-3  # of the cells of the hand with its noise; measured 0.2 %
MAX_CENTRE_MM = 2.0  # from the load to the centre of pressure; measured 0.7 mm
MAX_PLACE_MM = 2.5  # of the attachment, from its cells; measured 2.0 mm


def random_panel(outline: str, seed: int) -> tuple[Panel, np.ndarray]:
    """A panel and its cells in ohm; infinite where there is none."""
    rng = np.random.default_rng(seed)
    panel = OUTLINES[outline](rng)
    return panel, np.where(panel.present, 1000 * np.exp(rng.normal(0, 0.5, panel.shape)), np.inf)


def estimate_of(
    panel: Panel, frames: np.ndarray, *terms: lampest.Term, **settings: object
) -> lampest.Reconstruction:
    """Frames (frames, rows, columns) ohm as a recording of measured frames, reconstructed."""
    return lampest.reconstruct(
        recording_of(Scene(panel, READOUT), frames), terms=list(terms), **settings
    )


@pytest.mark.parametrize("crossing", [(0, 3), (2, 0), (-1, 0), (0, -1)])
def test_a_cell_at_no_crossing_is_refused(crossing: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match=rf"there is no crossing \[{crossing[0]}, {crossing[1]}\]"):
        Panel(2, 3, cells=((0, 0, 0.0, 0.0), (*crossing, 10.0, 10.0)))


@pytest.mark.parametrize("outline", OUTLINES)
@pytest.mark.parametrize("formulation", ["reduced", "nodal"])
def test_exact_readings_give_the_cells_back(outline: str, formulation: str) -> None:
    panel, cells = random_panel(outline, 1)
    readings = np.where(panel.present, exact_two_point_resistance(cells), np.nan)
    estimate = estimate_of(panel, readings[None], lampest.Misfit(), formulation=formulation)
    assert estimate.status[0] == "local optimum verified"
    np.testing.assert_allclose(
        estimate.cell_resistance[0][panel.present], cells[panel.present], rtol=CONVERGED
    )
    assert np.all(np.isnan(estimate.cell_resistance[0][~panel.present]))


@pytest.mark.parametrize("outline", OUTLINES)
def test_neighbours_connect_all_cells_and_no_absent_one(outline: str) -> None:
    panel, _ = random_panel(outline, 2)
    first, second, distance = panel.neighbours
    assert panel.present.flat[first].all() and panel.present.flat[second].all()
    x, y = panel.places_mm.reshape(2, -1)
    np.testing.assert_allclose(
        distance * panel.pitch_mm, np.hypot(x[first] - x[second], y[first] - y[second])
    )
    reached = {int(first[0])}
    for _ in range(panel.crossings):
        reached |= {int(b) for a, b in zip(first, second, strict=True) if int(a) in reached}
        reached |= {int(a) for a, b in zip(first, second, strict=True) if int(b) in reached}
    assert reached == set(np.flatnonzero(panel.present).tolist())


def turned_into_space(panel: Panel) -> Panel:
    """The same cells on a plane that is tilted in space."""
    rng = np.random.default_rng(4)
    turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return Panel(
        *panel.shape,
        panel.pitch_mm,
        tuple((row, column, *(turn @ (x, y, 0.0)).tolist()) for row, column, x, y in panel.cells),
    )


def test_neighbours_in_space_are_those_of_the_plane_that_they_lie_on() -> None:
    panel, _ = random_panel("hand", 2)
    first, second, distance = panel.neighbours
    turned = turned_into_space(panel).neighbours
    np.testing.assert_array_equal(turned[0], first)
    np.testing.assert_array_equal(turned[1], second)
    np.testing.assert_allclose(turned[2], distance)


def test_neighbours_in_space_have_no_cell_in_the_sphere_between_them() -> None:
    rng = np.random.default_rng(5)
    places = rng.uniform(0, 30, (16, 3))
    cells = tuple((*divmod(number, 4), *place) for number, place in enumerate(places.tolist()))
    first, second, _ = Panel(4, 4, cells=cells).neighbours
    pairs = set(zip(first.tolist(), second.tolist(), strict=True))
    for a in range(16):
        for b in range(a + 1, 16):
            radius = np.linalg.norm(places[a] - places[b]) / 2
            away = np.linalg.norm(places - (places[a] + places[b]) / 2, axis=1)
            distances = np.delete(away, [a, b])
            assert ((a, b) in pairs) == bool(distances.min() > radius)


@pytest.mark.slow
def test_results_of_cells_in_space_state_their_height_and_a_penalty_goes_by_distance(
    tmp_path: Path,
) -> None:
    panel, cells = random_panel("hand", 1)
    readings = np.where(panel.present, exact_two_point_resistance(cells), np.nan)[None]
    term = lampest.LogGradient(weight=1.0)
    flat, space = (
        estimate_of(shape, readings, lampest.Misfit(), term)
        for shape in (panel, turned_into_space(panel))
    )
    np.testing.assert_allclose(space.cell_resistance, flat.cell_resistance, rtol=1e-6)
    space.save(tmp_path / "hand.h5")
    (case,) = lampest.read_results(tmp_path / "hand.h5").cases
    heights = turned_into_space(panel).heights_mm
    np.testing.assert_allclose(case.scene.panel.heights_mm, heights)
    assert np.nansum(np.abs(case.long_columns()["z"].values - heights.ravel())) < 1e-9


def test_cells_partly_in_space_are_refused() -> None:
    with pytest.raises(ValueError, match="all have a z_mm, or none has one"):
        Panel(1, 2, cells=((0, 0, 0.0, 0.0), (0, 1, 1.0, 0.0, 0.0)))


def test_cells_of_a_rotated_lattice_have_four_neighbours_despite_rounding() -> None:
    places = [
        (j, k, round((j + k) * 7.5 / 2**0.5, 1), round((j - k) * 7.5 / 2**0.5, 1))
        for j in range(5)
        for k in range(5)
    ]
    assert len(Panel(5, 5, 7.5, tuple(places)).neighbours[0]) == 2 * 5 * 4


def test_a_listed_rectangle_equals_the_plain_rectangle() -> None:
    plain = Panel(3, 4, 8.0)
    listed = replace(
        plain, cells=tuple((j, k, 8.0 * k, 8.0 * j) for j in range(3) for k in range(4))
    )
    pairs = [
        {*zip(*map(np.ndarray.tolist, panel.neighbours[:2]), strict=True)}
        for panel in (plain, listed)
    ]
    assert pairs[0] == pairs[1]
    readings = exact_two_point_resistance(
        1000 * np.exp(np.random.default_rng(3).normal(0, 0.5, (3, 4)))
    )[None]
    for term in (lampest.LogGradient(weight=1e4), lampest.TotalVariation(weight=1.0)):
        estimates = [
            estimate_of(panel, readings, lampest.Misfit(), term).cell_resistance
            for panel in (plain, listed)
        ]
        np.testing.assert_allclose(estimates[0], estimates[1], rtol=CONVERGED)


@pytest.mark.parametrize(
    "outline",
    [pytest.param(name, marks=[pytest.mark.slow] * (name == "ring")) for name in OUTLINES],
)
def test_an_unread_cell_follows_its_neighbours(outline: str) -> None:
    panel, _ = random_panel(outline, 4)
    readings = np.where(
        panel.present, exact_two_point_resistance(np.where(panel.present, 500.0, np.inf)), np.nan
    )
    row, column = np.argwhere(panel.present)[3]
    readings[row, column] = np.nan
    estimate = estimate_of(panel, readings[None], lampest.Misfit(), lampest.LogGradient(weight=1.0))
    assert estimate.status[0] == "local optimum verified"
    np.testing.assert_allclose(estimate.cell_resistance[0][panel.present], 500.0, rtol=CONVERGED)


def test_a_reading_at_a_crossing_without_a_cell_is_used() -> None:
    panel, cells = random_panel("foot", 5)
    readings = exact_two_point_resistance(cells)
    row, column = np.argwhere(panel.present)[0]
    readings[row, column] = np.nan
    estimate = estimate_of(
        panel, np.where(np.isfinite(readings), readings, np.nan)[None], lampest.Misfit()
    )
    np.testing.assert_allclose(
        estimate.cell_resistance[0][panel.present], cells[panel.present], rtol=3 * CONVERGED
    )


@pytest.mark.slow
@pytest.mark.long
@promise("howto/outlines: They are not estimated, and their resistance in results is NaN.")
@pytest.mark.parametrize("outline", ["glove", "ring"])
def test_results_and_pictures_have_the_outline_of_the_panel(outline: str, tmp_path: Path) -> None:
    panel, cells = random_panel(outline, 7)
    readings = np.where(panel.present, exact_two_point_resistance(cells), np.nan)
    estimate = estimate_of(
        panel,
        np.stack([readings, 1.01 * readings]),
        lampest.Misfit(),
        lampest.LogGradient(weight=1.0),
    )
    result = unchecked_case(estimate)
    assert np.array_equal(np.isfinite(result.cell_resistance[0]), panel.present)
    for axis in ("x", "y"):
        assert np.array_equal(np.isfinite(result.to_xarray()[axis]), panel.present)
    for kind in ("contours", "resistance"):
        estimate.plot(kind).savefig(tmp_path / f"{kind}.png")


@pytest.mark.slow
def test_a_load_is_simulated_recognised_and_weighed_at_its_place(tmp_path: Path) -> None:
    panel = OUTLINES["hand"](np.random.default_rng(1))
    rod = lampest.Rod(centre_mm=(20.0, 46.0), diameter_mm=16, mass_g=200)
    cells = Cells(3000, 0.1, 6)
    scene = Scene(
        panel, lampest.TwoPointReadout(adc_bits=12, readings=20, noise_lsb=0.5), response=PUBLISHED
    )
    times = {"baseline_frames": 4, "frames": 6, "frame_period_s": 0.3}
    recording = lampest.simulate(Simulation(1, 2, scene, cells=cells, loads=(rod,), **times))
    assert np.array_equal(np.isfinite(recording.truth_cell_resistance[0]), panel.present)
    x, y = panel.places_mm
    under = recording.truth_pressure[-1] > 0
    assert under.any() and np.all(
        np.hypot(x - 20, y - 46)[under] < rod.diameter_mm / 2 + panel.pitch_mm
    )
    terms = [lampest.Misfit(weighting="noise"), lampest.LogGradient(weight=1e-3)]
    estimate = lampest.reconstruct(recording, terms)
    truth = recording.truth_cell_resistance[recording.role == 1]
    np.testing.assert_allclose(
        estimate.cell_resistance[:, panel.present], truth[:, panel.present], rtol=MAX_CELL_ERROR
    )
    pressed = pressed_of(estimate.result())
    assert (
        pressed is not None
        and np.hypot(pressed.values[-1, 0] - 20, pressed.values[-1, 1] - 46) < MAX_CENTRE_MM
    )
    recording.save(tmp_path / "hand.h5")
    answer = detect_recording(tmp_path / "hand.h5")
    assert (
        answer.attachments
        and np.hypot(answer.attachments[0].x_mm[0] - 20, answer.attachments[0].y_mm[0] - 46)
        < MAX_PLACE_MM
    )
    assert estimate.result().to_xarray()["x"].dims == ("row", "column")


def test_a_frame_of_bounds_is_checked_by_the_circuit_laws_alone() -> None:
    panel, cells = random_panel("foot", 11)
    readings = np.where(panel.present, exact_two_point_resistance(cells), np.nan)
    recorded = np.stack([np.where(readings > np.nanmedian(readings), np.inf, readings)] * 3)
    check = Prepared(recording_of(Scene(panel, READOUT), recorded, 1)).check
    assert check.mark == "doubtful" and "no cells were fitted" in check.sentence


def test_the_error_names_a_table_line_without_numbers(tmp_path: Path) -> None:
    """The first line of the table may be a header."""
    (tmp_path / "cells.csv").write_text("row,column\n0,0\n0,x\n")
    (tmp_path / "scene.yaml").write_text("panel: {rows: 2, columns: 2, cells: cells.csv}\n")
    with pytest.raises(lampest.InputError, match=r"cells\.csv:3: 0, x are not all numbers"):
        lampest.read_scene(tmp_path / "scene.yaml")
