"""Order of the lines: whether neighbouring lines change alike in the scene's order.

A load covers neighbouring cells, and its crosstalk rows and columns. Lines that a program numbered
otherwise, or a frame that was cut into rows of another length, tear its image apart; another order
with much less disorder is the panel's.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lampest.audit.finding import Finding
from lampest.files.levels import OUTLIER_THRESHOLD
from lampest.panel.panel import Array
from lampest.recording.readings import median
from lampest.recording.recording import UNLOADED, Recording

# Ratio of the disorder in the best other order to that in the scene's. Of 500 clean recordings the
# smallest is 0.7; of panels whose rows were cut at the wrong length nine in ten are below 0.54
# (tests/oracles/test_health.py).
MAX_RATIO = 0.5
MIN_LINES = 4  # of each side: with fewer, another order is smoother by chance
MIN_CHANGED = 6  # readings whose change exceeds the noise by far


@dataclass(frozen=True, eq=False)
class Order:
    """An order of the readings on the panel.

    Attributes
    ----------
    words : str
    image : integer array, shape (rows, columns)
        Number of the reading, in the scene's order along the rows, at each place.
    remedy : str
    """

    words: str
    image: NDArray[np.intp]
    remedy: str


def orders(rows: int, columns: int) -> Iterator[Order]:
    """Generate orders in which programs deliver readings by mistake."""
    numbers = np.arange(rows * columns).reshape(rows, columns)
    if rows != columns:
        yield Order(
            f"{columns} rows of {rows} readings, not {rows} of {columns}",
            numbers.reshape(columns, rows),
            f"import with --rows {columns} --columns {rows}, or --transpose",
        )
        yield Order(
            "column after column, not row after row",
            numbers.reshape(columns, rows).T,
            "import with --transpose",
        )
    serpentine = numbers.copy()
    serpentine[1::2] = serpentine[1::2, ::-1]
    yield Order(
        "every second row reversed, as a serpentine scan delivers them",
        serpentine,
        "reverse them before import",
    )
    for name, count, place in (("rows", rows, 0), ("columns", columns, 1)):
        for words, order in line_orders(count):
            remedy = f"the {name} belong in the order {order.tolist()}"
            yield Order(f"{name} {words}", np.take(numbers, order, axis=place), remedy)


def line_orders(count: int) -> Iterator[tuple[str, NDArray[np.intp]]]:
    """Generate orders of lines.

    In them odd and even ones are apart or interleaved, address bits reversed, or pairs swapped.
    """
    lines = np.arange(count)
    if count < MIN_LINES:
        return
    half = count // 2
    merged = np.empty(count, dtype=np.intp)
    merged[::2] = lines[: count - half]
    merged[1::2] = lines[count - half :]
    yield "with odd and even ones apart", merged
    yield "interleaved", np.concatenate([lines[::2], lines[1::2]])
    pairs = lines.copy()
    pairs[: 2 * half] = lines[: 2 * half].reshape(-1, 2)[:, ::-1].ravel()
    yield "with neighbours swapped", pairs
    bits = (count - 1).bit_length()
    if 2**bits == count:
        yield (
            "with the bits of their addresses reversed",
            np.array([int(f"{n:0{bits}b}"[::-1], 2) for n in lines]),
        )


def order_findings(recording: Recording, volts: Array) -> Iterator[Finding]:
    """Yield a finding where another order makes the changes of the readings much smoother.

    `volts` are (frames, rows, columns), NaN where missing.
    """
    scene = recording.scene
    unloaded = recording.role == UNLOADED
    rows, columns = scene.panel.shape
    if min(rows, columns) < MIN_LINES or not unloaded.any() or unloaded.all() or not scene.whole:
        return
    change = _changes(recording, volts, unloaded)
    if not len(change):
        return
    as_specified = disorder(change)
    flat = change.reshape(len(change), -1)
    candidates = [
        (disorder(flat[:, order.image.ravel()].reshape(-1, *order.image.shape)), order)
        for order in orders(rows, columns)
    ]
    least, best = min(candidates, key=lambda pair: pair[0])
    if least < MAX_RATIO * as_specified:
        evidence = (
            f"changes are {as_specified / least:.2g} times smoother "
            "and better aligned with the lines then"
        )
        yield Finding(
            "order",
            f"readings seem to come in another order: {best.words}",
            evidence,
            remedy=best.remedy,
        )


def _changes(recording: Recording, volts: Array, unloaded: NDArray[np.bool_]) -> Array:
    """Return changes of the voltages from the unloaded panel, in frames that change strongly."""
    change = volts[~unloaded] - median(volts[unloaded])[0]
    change = np.where(np.isfinite(change), change, 0.0)
    readout = recording.scene.readout
    steps = np.diff(volts[unloaded], axis=0)
    finite = np.isfinite(steps)
    noise = float(np.sqrt(np.sum(steps[finite] ** 2) / (2 * max(int(finite.sum()), 1))))
    noise = max(noise, 0.0 if readout is None else readout.lsb_volt)
    changed = np.abs(interaction(change)) > OUTLIER_THRESHOLD * noise
    return np.asarray(change[changed.sum(axis=(1, 2)) >= MIN_CHANGED])


def interaction(change: Array) -> Array:
    """Return images less the means of rows and columns, (frames, rows, columns).

    Crosstalk changes whole rows and columns; this part is the load's own.
    """
    centred = change - change.mean(axis=1, keepdims=True)
    return np.asarray(centred - centred.mean(axis=2, keepdims=True))


def disorder(change: Array) -> float:
    """Return how little images follow rows, columns and neighbours, for (frames, rows, columns).

    The disorder is the product of three measures: the roughness of the images, that of their
    interaction, and the share of the interaction. Each is smaller in the panel's own order.
    """
    own = interaction(change)
    return roughness(change) * roughness(own) * float(np.sum(own**2) / np.sum(change**2))


def roughness(change: Array) -> float:
    """Return the mean square difference of neighbours over the mean square of images.

    The images are (frames, rows, columns).
    """
    down = np.diff(change, axis=1)
    across = np.diff(change, axis=2)
    neighbours = (np.sum(down**2) + np.sum(across**2)) / (down[0].size + across[0].size)
    return float(neighbours / max(float(np.sum(change**2)) / change[0].size, np.finfo(float).tiny))
