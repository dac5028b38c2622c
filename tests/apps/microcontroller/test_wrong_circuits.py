"""The example `keyboard` on boards that deviate from their constants, and on drifting films."""

import numpy as np
import pytest
from apps.microcontroller.wrong_circuits import (
    BASELINES,
    BOARDS,
    BUDGET,
    CIRCUITS,
    KEYS,
    SHAPE,
    Keyboard,
    errors_of,
    exported,
)

import lampest
from lampest.apps.microcontroller.host import compiled
from lampest.apps.microcontroller.library import library_folder
from lampest.panel.scene import Scene

FAST = ("channels of 40 to 110 Ω", "two_point")
# Ghosts of the next reading, and presses in scans that are far from settled: the page's table.
LACKING = {("5 % memory of the reading before", name) for name in CIRCUITS} | {
    ("one open row", "two_point")
}
DRIFT = -0.3  # of ln r: more than the share of a fall at which a key is released
SCANS = 600


@pytest.mark.parametrize(
    ("kind", "circuit"),
    [
        pytest.param(kind, circuit, marks=() if (kind, circuit) == FAST else pytest.mark.slow)
        for kind in BOARDS
        for circuit in CIRCUITS
        if (kind, circuit) not in LACKING
    ],
)
def test_a_keyboard_on_a_wrong_board_has_no_ghost_and_misses_no_press(kind, circuit):
    errors = errors_of(circuit, kind, 10, 84)
    assert errors.presses > 20
    assert errors[1:] == (0, 0, 0)


@pytest.mark.slow
@pytest.mark.parametrize(("circuit", "threshold"), [("two_point", 0.7), ("grounded", 0.5)])
def test_a_higher_threshold_leaves_no_ghosts_of_converter_memory(circuit, threshold):
    errors = errors_of(circuit, "5 % memory of the reading before", 10, 84, threshold)
    assert errors[1:] == (0, 0, 0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 3])
def test_scans_behind_an_open_row_are_judged_although_they_do_not_settle(seed):
    errors = errors_of("two_point", "one open row", 20, seed, 0.6)
    assert errors.misses <= 0.1 * errors.presses
    assert errors[2:] == (0, 0)


@pytest.mark.slow
def test_a_key_is_released_on_a_film_that_has_drifted():
    rng = np.random.default_rng(3)
    scene = Scene(lampest.Panel(*SHAPE, 10.0), CIRCUITS["grounded"])
    resting = 30_000.0 * np.exp(0.1 * rng.standard_normal(SHAPE))
    constants = exported(scene, resting, rng)
    board = BOARDS["as its constants say"](scene, rng)
    folder = library_folder() / "examples" / "keyboard"
    with compiled(constants, f"-I{folder}", program=KEYS) as host:
        keyboard = Keyboard(host)
        host.begin(BUDGET)
        for _ in range(BASELINES):
            host.baseline(board.sums(resting, rng))
        for share in np.linspace(0, 1, SCANS):
            drifted = resting * np.exp(DRIFT * share)
            assert keyboard.after([board.sums(drifted, rng)]) == set()
        pressed = drifted.copy()
        pressed[2, 3] = 3000.0
        assert keyboard.after([board.sums(pressed, rng)] * 3) == {(2, 3)}
        assert keyboard.after([board.sums(drifted, rng)] * 3) == set()
