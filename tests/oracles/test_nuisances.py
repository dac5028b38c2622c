"""Leaks, contacts, common creep and saturation are named, in readings of a network that is written anew here."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import lampest
from lampest import Recording, Scene, TwoPointReadout
from lampest.estimate.warnings import warnings_of

Array = NDArray[np.float64]
ROWS, COLUMNS, UNLOADED, FRAMES = 9, 10, 5, 6
NEIGHBOURS = [(line, line + 1) for line in range(ROWS + COLUMNS - 1) if line != ROWS - 1]


def two_point(cells: Array, leaks: Sequence[tuple[int, int]] = (), siemens: float = 0.0) -> Array:
    """Resistances between rows and columns of cells (rows, columns), some lines joined by a conductance."""
    matrix = np.zeros((ROWS + COLUMNS,) * 2)
    matrix[:ROWS, ROWS:] = -1 / cells
    matrix[ROWS:, :ROWS] = -1 / cells.T
    for one, two in leaks:
        matrix[one, two] = matrix[two, one] = -siemens
    inverse = np.linalg.pinv(matrix - np.diag(matrix.sum(axis=1)))
    own = np.diag(inverse)
    return own[:ROWS, None] + own[None, ROWS:] - 2 * inverse[:ROWS, ROWS:]


def panel(
    seed: int,
    leak_ohm: float = np.inf,
    leak_from: int = 0,
    contact: tuple[int, float, int] = (0, 0.0, 0),
    creep: float = 0.0,
    saturated: float = 1.0,
) -> Recording:
    """A hand on some cells; contact : of a row, so many ohm more, from a frame on. saturated : share of full scale."""
    rng = np.random.default_rng(seed)
    row, column = np.indices((ROWS, COLUMNS))
    across, down = rng.uniform(3, 6, 2)
    frames = UNLOADED + FRAMES
    cells = np.repeat(3000 * np.exp(0.15 * rng.standard_normal((1, ROWS, COLUMNS))), frames, axis=0)
    cells[UNLOADED:] *= np.exp(-2 * np.exp(-((row - down) ** 2 + (column - across) ** 2) / 3))
    cells[UNLOADED:] *= np.exp(creep * np.linspace(0, 1, FRAMES))[:, None, None]
    ohm = np.stack([two_point(one, NEIGHBOURS, (n >= leak_from) / leak_ohm) for n, one in enumerate(cells)])
    ohm[contact[2] :, contact[0]] += contact[1]
    code = np.minimum(1023 * 1000 / (1140 + ohm), saturated * 1023)
    noisy = np.round(code + 0.7 * rng.standard_normal((20, *code.shape)))
    volt = np.minimum(noisy, np.round(saturated * 1023)).mean(axis=0) * 5 / 1023
    scene = Scene(lampest.Panel(ROWS, COLUMNS), TwoPointReadout(readings=20, noise_lsb=0.7), 140.0)
    role = (np.arange(frames) >= UNLOADED).astype(np.uint8)
    return Recording(scene, (5 - volt) / volt * 1000, np.arange(float(frames)), role)


@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_said_where_nothing_is(seed: int) -> None:
    assert warnings_of(panel(seed)) == ()


@pytest.mark.parametrize(
    ("effect", "sentence"),
    [
        ({"leak_ohm": 10e3, "leak_from": UNLOADED}, "kohm between neighbouring lines, since the unloaded frames"),
        ({"leak_ohm": 2e3}, "kohm between neighbouring lines explains"),
        ({"contact": (3, 200.0, UNLOADED)}, "200 ohm more at the contact of row 3, since the unloaded frames"),
        ({"contact": (3, 200.0, UNLOADED + 3)}, "200 ohm more at the contact of row 3, since the unloaded frames"),
        ({"creep": -0.03}, "cells that nobody touched changed together by -3"),
        ({"saturated": 0.62}, "loaded channels end at the same 3.1 volt"),
    ],
)
def test_what_a_panel_does_is_named(effect: dict, sentence: str) -> None:
    said = warnings_of(panel(1, **effect))
    assert sum(sentence in line for line in said) == 1, said


def test_the_size_of_a_leak_is_found() -> None:
    (line,) = (line for line in warnings_of(panel(2, leak_ohm=5e3, leak_from=UNLOADED)) if "leak" in line)
    assert 4 < float(line.split("a leak of ")[1].split(" kohm")[0]) < 6


@pytest.mark.parametrize("mouth", ["lamprey_25mm", "lamprey_35mm"])
def test_channels_that_differ_are_no_contact_under_a_mouth(mouth: str) -> None:
    """Channels of 3 ohm shift the cells of a rim, which are as low as 100 ohm, by several percent."""
    shipped = Recording.load(Path(__file__).parents[2] / "data" / f"{mouth}.h5")
    assert [line for line in warnings_of(shipped) if "outliers" not in line] == []
