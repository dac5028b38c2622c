"""Ghosts and misses of the example `keyboard` on boards that deviate from their constants.

    python -m tests.apps.microcontroller.wrong_circuits [CHORDS [SEED]]

prints a table: chords of three and four keys on 8 × 12 keys, with constants of the nominal circuit.
"""

import ctypes
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import lampest
from lampest.apps.microcontroller.constants import Budget, Constants
from lampest.apps.microcontroller.host import Host, compiled
from lampest.apps.microcontroller.library import library_folder
from lampest.panel.panel import Array
from lampest.panel.readouts.tolerances import off_by, simulated
from lampest.panel.scene import Scene
from tests.apps.board.estimated import unchecked_case

SHAPE = (8, 12)
KEY_OHM = 30_000.0  # at rest; a tenth of it differs between keys
PRESSED_OHM = (1500.0, 4000.0)
CHANNEL_OHM = (40.0, 110.0)  # of CD4051 and CD74HC4067 at 5 V
REFERENCE_ERROR = 0.05
MEMORY = 0.05  # of the reading before
OPEN_OHM = 1e9
SHORT_OHM = 1.0
BUDGET = Budget(3, 12, 0.05)
BASELINES = 8  # frames that the example takes at its start
SCANS = 3  # of a chord, and of no key after it
PRESSED = 1  # KEYS_DOWN
FALLS = (
    0.4,
    0.5,
    0.6,
    0.7,
    1.0,
)  # KEYS_FALL, from that of the example to half of the lightest press
NOISE_LSB = 0.7
READINGS = 4
BITS = 12
LOAD_OHM = 1000.0
KEYS = """
#include "keys.h"
int host_keys(const uint32_t *sums, float *change, uint8_t *pressed) {
    return keys_scan(&host_panel, sums, change, pressed, 0).settled;
}
"""
CIRCUITS: dict[str, Any] = {
    "two_point": lampest.TwoPointReadout(adc_bits=BITS, readings=READINGS, noise_lsb=NOISE_LSB),
    "grounded": lampest.GroundedReadout(
        sense="one",
        drive_ohm=70.0,
        load_ohm=LOAD_OHM,
        adc_bits=BITS,
        readings=READINGS,
        noise_lsb=NOISE_LSB,
    ),
}


@dataclass(frozen=True, eq=False)
class Board:
    """A board as it is: circuit, channels (rows,) and (columns,) ohm, memory, and bad keys."""

    scene: Scene
    row_ohm: Array
    column_ohm: Array
    memory: float = 0.0
    bad: tuple[tuple[int, int], ...] = ()
    bad_ohm: float = OPEN_OHM

    def sums(self, cells: Array, rng: np.random.Generator) -> NDArray[np.uint32]:
        """Return the sums of codes of a scan, row after row."""
        actual = cells.copy()
        for key in self.bad:
            actual[key] = self.bad_ohm
        readout = self.scene.circuit
        recorded = simulated(readout, actual, self.scene, self.row_ohm, self.column_ohm)
        volt = np.array(readout.volt_from_recorded(recorded), dtype=float).ravel()
        for reading in range(1, volt.size):
            volt[reading] += self.memory * (volt[reading - 1] - volt[reading])
        noise = NOISE_LSB * rng.standard_normal((volt.size, readout.readings))
        codes = np.rint(np.asarray(readout.steps_from_volt(volt), float)[:, None] + noise)
        sums = np.clip(codes, 0, 2**readout.adc_bits - 1).sum(axis=1)
        return np.asarray(sums.reshape(cells.shape), np.uint32)


def _nominal(scene: Scene, rng: np.random.Generator) -> Board:
    return Board(scene, np.zeros(SHAPE[0]), np.zeros(SHAPE[1]))


def _channels(scene: Scene, rng: np.random.Generator) -> Board:
    rows, columns = SHAPE
    return Board(scene, rng.uniform(*CHANNEL_OHM, rows), rng.uniform(*CHANNEL_OHM, columns))


def _reference(scene: Scene, rng: np.random.Generator) -> Board:
    wrong: Any = off_by(scene.circuit, REFERENCE_ERROR)
    return _nominal(replace(scene, readout=wrong), rng)


def _open_row(scene: Scene, rng: np.random.Generator) -> Board:
    row = int(rng.integers(SHAPE[0]))
    return replace(_nominal(scene, rng), bad=tuple((row, key) for key in range(SHAPE[1])))


def _short(scene: Scene, rng: np.random.Generator) -> Board:
    key = (int(rng.integers(SHAPE[0])), int(rng.integers(SHAPE[1])))
    return replace(_nominal(scene, rng), bad=(key,), bad_ohm=SHORT_OHM)


def _memory(scene: Scene, rng: np.random.Generator) -> Board:
    return replace(_nominal(scene, rng), memory=MEMORY)


BOARDS: dict[str, Callable[[Scene, np.random.Generator], Board]] = {
    "as its constants say": _nominal,
    "channels of 40 to 110 Ω": _channels,
    "reference 5 % larger": _reference,
    "one open row": _open_row,
    "a shorted key": _short,
    "5 % memory of the reading before": _memory,
}


class Errors(NamedTuple):
    """Keys of some chords: pressed ones, missed ones, ghosts, and releases that were missed."""

    presses: int
    misses: int
    ghosts: int
    stuck: int


def errors_of(
    circuit: str, board_kind: str, chords: int, seed: int, fall: float = FALLS[0]
) -> Errors:
    """Return the errors of a keyboard in random chords.

    Parameters
    ----------
    circuit : str
        One of CIRCUITS.
    board_kind : str
        One of BOARDS.
    chords : int
    seed : int
    fall : float
        KEYS_FALL, the threshold of a press in ln r.
    """
    rng = np.random.default_rng(seed)
    scene = Scene(lampest.Panel(*SHAPE, 10.0), CIRCUITS[circuit])
    resting = KEY_OHM * np.exp(0.1 * rng.standard_normal(SHAPE))
    constants = exported(scene, resting, rng)
    board = BOARDS[board_kind](scene, rng)
    folder = library_folder() / "examples" / "keyboard"
    with compiled(constants, f"-I{folder}", f"-DKEYS_FALL={fall}f", program=KEYS) as host:
        keyboard = Keyboard(host)
        host.begin(BUDGET)
        for _ in range(BASELINES):
            host.baseline(board.sums(resting, rng))
        counts = np.zeros(4, int)
        for _ in range(chords):
            keys = chord(rng)
            cells = resting.copy()
            for key in keys:
                cells[key] = rng.uniform(*PRESSED_OHM)
            pressed = keyboard.after([board.sums(cells, rng) for _ in range(SCANS)])
            released = keyboard.after([board.sums(resting, rng) for _ in range(SCANS)])
            # A key that the fault itself opens or closes is none that the keyboard can tell.
            true = set(keys) - set(board.bad)
            counts += (
                len(true),
                len(true - pressed),
                len(pressed - true - set(board.bad)),
                len(released - set(board.bad)),
            )
    return Errors(*map(int, counts))


def corners(rng: np.random.Generator, shape: tuple[int, int]) -> list[tuple[int, int]]:
    """Return the keys at the corners of a rectangle."""
    rows, columns = (rng.choice(size, 2, replace=False) for size in shape)
    return [(int(row), int(column)) for row in rows for column in columns]


def chord(rng: np.random.Generator) -> list[tuple[int, int]]:
    """Return three or four keys, mostly corners of a rectangle."""
    keys = corners(rng, SHAPE)
    if rng.random() < 0.3:
        places = np.unravel_index(rng.choice(SHAPE[0] * SHAPE[1], 4, replace=False), SHAPE)
        keys = [(int(row), int(column)) for row, column in zip(*places, strict=True)]
    return [keys[number] for number in rng.permutation(4)[: rng.integers(3, 5)]]


def exported(scene: Scene, resting: Array, rng: np.random.Generator) -> Constants:
    """Return the constants of a recording of the unloaded nominal keyboard."""
    readout = scene.circuit
    board = _nominal(scene, rng)
    sums = np.array([board.sums(resting, rng) for _ in range(3)])
    values = readout.recorded_from_volt(readout.volt_from_code(sums.astype(int) / readout.readings))
    recording = lampest.Recording.from_array(values, unit=readout.unit, baseline=2, scene=scene)
    terms = [
        lampest.Misfit(weighting="noise"),
        lampest.LogRatio(loss=lampest.Squared(), weight=1e-4),
    ]
    estimate = lampest.reconstruct(recording, terms, formulation="reduced", error_bars=False)
    return Constants.of(unchecked_case(estimate))


class Keyboard:
    """The example's keys on the compiled library."""

    def __init__(self, host: Host) -> None:
        self.host = host
        self.change = np.zeros(SHAPE, np.float32)
        self.pressed = np.zeros(SHAPE, np.uint8)

    def after(self, scans: list[NDArray[np.uint32]]) -> set[tuple[int, int]]:
        """Return the keys that are down after some scans."""
        for sums in scans:
            arrays = (sums, self.change, self.pressed)
            self.host.library.host_keys(*(a.ctypes.data_as(ctypes.c_void_p) for a in arrays))
        return {(int(row), int(column)) for row, column in np.argwhere(self.pressed & PRESSED)}


def main() -> None:
    """Print the table."""
    chords = int(sys.argv[1]) if len(sys.argv) > 1 else 40
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    print("| board | circuit | threshold | presses | misses | ghosts | stuck |")
    print("|---|---|---|---|---|---|---|")
    for kind in BOARDS:
        for circuit in CIRCUITS:
            for fall in FALLS:
                numbers = " | ".join(map(str, errors_of(circuit, kind, chords, seed, fall)))
                print(f"| {kind} | `{circuit}` | {fall} | {numbers} |", flush=True)


if __name__ == "__main__":
    main()
