"""Order of the lines: whether loads are smooth in the scene's order, or in another one.

A load covers neighbouring cells, and its crosstalk rows and columns. Lines that a program numbered
otherwise, or a frame that was cut into rows of another length, tear its image apart. The image is
that of the cells, whose logarithms change by x = K (y − y₀) by the circuit's derivative at the
unloaded panel, so that neither film nor crosstalk are in it. Frames whose changes are alike show
one place of a load, and their mean is its image. Of an image the scores

    t = tanh(z/c),   z = sign(x) max(|x| − ν, 0)

count. The reach ν is 3 σ of noise, and a tenth of the largest change, since the change of a load is
not linear. The unit c is the third largest of the rows' second largest |z|, or that of the columns,
the smaller one: single cells, or a bar of two lines, are no image, however large they are.
An image is the sum of its mean, a part of the rows, one of the columns, and an interaction. Each
part is a smooth Gaussian process over the lines beside a roughness that knows no order,

    cov = s² (K/mean(diag K) + ρ),   K = C exp(−(i − j)²/(2 ℓ²)) C,   C = 1 − 1 1ᵀ/n,

with K_rows ⊗ K_columns for the interaction. The scale s is integrated out by its maximum, ℓ and ρ
over a few values, equally probable. The scale of a part is at least what an interaction of
independent cells leaves in the means of lines: where a load lowers the cells of each line as much
as it raises others, as suction beside a rim does, that is a coincidence and no order. An order is
found where its odds against all others that are tried, and against the scene's, are a thousand to
one.

A load in one place may be like one in another order: two feet half a panel apart are one smooth
load where odd and even lines are apart, an edge between two lines is one where they are swapped.
Such a coincidence has a probability of its own, `Order.coincidence`, which bounds the evidence of
each place: loads in several places tell an order, and one that stands tells none of lines. Nor does
a load that lies on all lines alike, such as a bar along the columns: it has no edge across them.

A load on every second line, such as a comb, has the image of a load on interleaved lines. Where
such a load has not these odds against it, the recording cannot tell the order.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from itertools import chain, combinations
from typing import NamedTuple

import numpy as np

from lampest.files.errors import BROKEN
from lampest.files.levels import NOISE_REACH
from lampest.inference.cells_fit import local_fit
from lampest.panel.panel import Array, Mask, Numbers
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings, median

ODDS = 1000.0  # of an order against the scene's
# Probability that a load in one place is as smooth in another order of lines: two like loads half a
# panel apart, or an edge between two lines. No load is like one in rows of another length, or in
# every second row reversed.
COINCIDENCE = 1e-3
NO_LOAD = 1e-9
# Loads on every second line, by the steps between rows and between columns.
COMBS = {"row": (2, 1), "column": (1, 2)}
MIN_LINES = 4  # of each side: with fewer, another order is smoother by chance
LENGTHS = (1.5, 3.0, 8.0)  # ℓ, lines: loads reach over more than one
ROUGHNESS = (1e-2, 1e-1, 1.0, np.inf)  # ρ; inf: no order
MAX_STEPS = 6  # orders one after the other, such as several swapped pairs
MAX_FRAMES = 200  # whose changes are compared, the strongest ones
MAX_PLACES = 12
# Root mean square of a change over the noise of a reading, so that its image shows a place.
MIN_CHANGE = 2.0
LOAD_SD = 1.0  # of a load's change of ln r; it decides where noise leaves a cell open
MIN_SHARE = 0.1  # of the largest change, which is not linear: smaller ones show no order
MIN_COVERED = 3  # rows, and columns, that a load covers: one on fewer shows no order
TINY = 1e-30  # norm of no image
# Standard deviation of a load's mean on each line over its mean on all lines, or over the standard
# deviation of its image, the larger one. Films that scatter by 0.3 have 0.33 under a bar, and loads
# in one place 0.6 and more (docs/studies/wrong_readings.md).
MIN_CONTRAST = 0.5
MAX_ALIKE = 0.7  # cosine between the changes of two places


class Order(NamedTuple):
    """An order of the readings on the panel.

    Attributes
    ----------
    words : str
    image : integer array, shape (rows, columns)
        Number of the reading, in the scene's order along the rows, at each place.
    remedy : str
    side : int or None
        Axis of the lines whose order this is: 0 for rows, 1 for columns, None for neither.
    """

    words: str
    image: Numbers
    remedy: str
    side: int | None = None

    @property
    def coincidence(self) -> float:
        """Probability that a load in one place is smooth in this order by chance."""
        return NO_LOAD if self.side is None else COINCIDENCE


class SmootherOrder(NamedTuple):
    """The order in which loads are smoothest.

    Attributes
    ----------
    order : Order
    gain : float
        Its gain over the scene's order in −2 ln evidence.
    every_second : str
        'row' or 'column', where a load on every second one explains the readings in the scene's
        order; '' where none does.
    """

    order: Order
    gain: float
    every_second: str = ""


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
        for words, order in chain(line_orders(count), exchanged_lines(count)):
            remedy = f"the {name} belong in the order {order.tolist()}"
            image = np.take(numbers, order, axis=place)
            yield Order(f"{name} {words}", image, remedy, place)


def line_orders(count: int) -> Iterator[tuple[str, Numbers]]:
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


def exchanged_lines(count: int) -> Iterator[tuple[str, Numbers]]:
    """Generate orders in which two neighbours, or two bits of addresses, are exchanged."""
    lines = np.arange(count)
    if count < MIN_LINES:
        return
    bits = (count - 1).bit_length()
    for low, high in combinations(range(bits if 2**bits == count else 0), 2):
        differ = ((lines >> low) ^ (lines >> high)) & 1
        words = f"with bits {low} and {high} of their addresses exchanged"
        yield words, lines ^ (differ << low) ^ (differ << high)
    for first in range(count - 1):
        swapped = lines.copy()
        swapped[[first, first + 1]] = first + 1, first
        yield f"{first} and {first + 1} swapped", swapped


def order_of_lines(scene: Scene, readings: Readings, unloaded: Mask) -> list[SmootherOrder]:
    """Return the orders, one after the other, in which the loads of a recording are smooth.

    The list is empty where the scene's order is not doubted.

    Parameters
    ----------
    scene : Scene
    readings : Readings
        (frames, rows, columns).
    unloaded : boolean array, shape (frames,)
    """
    told = min(scene.panel.shape) >= MIN_LINES and unloaded.any() and not unloaded.all()
    steps = list[SmootherOrder]()
    if not told or not scene.whole:
        return steps
    images = load_images(cell_changes(scene, readings, unloaded))
    while len(steps) < MAX_STEPS and (found := smoother_order(images)) is not None:
        if found.every_second:
            return steps or [found]
        steps.append(found)
        images = images.reshape(len(images), -1)[:, found.order.image]
    return steps


class CellChanges(NamedTuple):
    """Changes of the log cells under loads.

    Attributes
    ----------
    loaded : array, shape (loaded frames, rows, columns)
    noise : array, shape (rows, columns)
        Standard deviations of a frame's changes.
    significance : array, shape (loaded frames,)
        Root mean square of a frame's changes of readings over their standard deviations.
    unloaded : int
        Number of the unloaded frames, with whose mean the others are compared.
    """

    loaded: Array
    noise: Array
    significance: Array
    unloaded: int


def cell_changes(scene: Scene, readings: Readings, unloaded: Mask) -> CellChanges:
    """Return the changes of the log cells under loads.

    With the Jacobian J of the readings y at the cells of the unloaded panel, their mean y₀ and
    standard deviations σ, and a prior standard deviation of LOAD_SD,

        x = (Jᵀ J/σ² + 1/LOAD_SD²)⁻¹ Jᵀ (y − y₀)/σ².

    On panels of more than MAX_CELLS, J is its diagonal at the start of a fit; x is (y − y₀)/σ where
    arithmetic fails.

    Parameters
    ----------
    scene : Scene
    readings : Readings
        (frames, rows, columns).
    unloaded : boolean array, shape (frames,)
    """
    resting = readings[unloaded].mean()
    # Standard deviations of a frame: those of the readout, raised by the scatter of unloaded frames
    # where that is larger.
    specified = np.ones(readings.value.shape) if readings.sigma is None else readings.sigma
    specified = specified[unloaded]
    steps = np.diff(readings.value[unloaded], axis=0) / np.hypot(specified[1:], specified[:-1])
    measured = float(np.sqrt(np.mean(steps**2))) if steps.size else 0.0
    least = TINY if readings.sigma is None else 1.0
    sigma = median(specified)[0] * max(measured, least)
    loaded = readings[~unloaded]
    scaled = np.where(loaded.seen > 0, loaded.value - resting.value, 0.0) / sigma
    significance = np.sqrt(np.mean(scaled**2, axis=(1, 2)))
    gain = np.ones(sigma.shape)
    with suppress(*BROKEN):
        fit = local_fit(scene, replace(resting, sigma=sigma))
        if fit.jacobian.size:
            gain = np.linalg.solve(replace(fit, ridge=LOAD_SD**-2).normal, fit.jacobian.T)
        else:
            own = fit.network.own_response() / sigma
            gain = own / (own**2 + LOAD_SD**-2)
    if gain.shape == sigma.shape:
        change = gain * scaled
        noise = np.abs(gain)
    else:
        change = (scaled.reshape(len(scaled), -1) @ gain.T).reshape(scaled.shape)
        noise = np.sqrt(np.sum(gain**2, axis=1)).reshape(sigma.shape)
    return CellChanges(change, noise, significance, int(unloaded.sum()))


def load_images(changes: CellChanges) -> Array:
    """Return the scores t of the load in each of its places, (places, rows, columns).

    Frames whose changes have a cosine of MAX_ALIKE or more show one place.
    """
    flat = changes.loaded.reshape(len(changes.loaded), -1)
    strongest = np.argsort(-changes.significance)[:MAX_FRAMES]
    flat = flat[strongest[changes.significance[strongest] > MIN_CHANGE]]
    size = np.linalg.norm(flat, axis=1)
    images = list[Array]()
    while len(flat) and len(images) < MAX_PLACES:
        alike = flat @ flat[0] >= MAX_ALIKE * size * size[0]
        image = flat[alike].mean(axis=0)
        frames = np.sqrt(1 / alike.sum() + 1 / changes.unloaded)
        images.append(scores(image.reshape(changes.noise.shape), frames * changes.noise))
        flat, size = flat[~alike], size[~alike]
    return np.reshape([image for image in images if image.any()], (-1, *changes.noise.shape))


def scores(image: Array, noise: Array) -> Array:
    """Return the scores t of the changes of cells, (rows, columns); 0 where c is 0.

    Parameters
    ----------
    image, noise : array, shape (rows, columns)
        Changes, and their standard deviations.
    """
    reach = np.maximum(NOISE_REACH * noise, MIN_SHARE * np.abs(image).max())
    beyond = np.maximum(np.abs(image) - reach, 0.0)
    usual = image_unit(beyond)
    if not usual > 0:
        return np.zeros(image.shape)
    return np.asarray(np.tanh(np.sign(image) * beyond / usual))


def image_unit(image: Array) -> float:
    """Return c of the sizes of an image's changes, (rows, columns); 0 on fewer than MIN_COVERED."""
    second = [np.sort(image, axis=axis).take(-2, axis) for axis in (0, 1)]
    return float(min(np.sort(of_lines)[-MIN_COVERED] for of_lines in second))


def along_side(images: Array, side: int | None) -> Numbers:
    """Return numbers of the places as the lines of a side tell them apart, (places,).

    A bar across all rows that moves over columns is in one place along rows, and tells nothing of
    them.

    Parameters
    ----------
    images : array, shape (places, rows, columns)
    side : int or None
        Axis of the lines, 0 for rows; None: all places are distinct.

    Returns
    -------
    integer array
        −1 for places whose load lies on all lines of the side alike.
    """
    if side is None:
        return np.arange(len(images))
    profiles = images.mean(axis=2 - side)
    means = profiles.mean(axis=1, keepdims=True)
    profiles = profiles - means
    size = np.linalg.norm(profiles, axis=1, keepdims=True)
    variation = np.minimum(np.abs(means), images.std(axis=(1, 2))[:, None])
    uneven = size >= MIN_CONTRAST * np.sqrt(profiles.shape[1]) * variation
    profiles = profiles / np.maximum(size, TINY)
    cosines = profiles @ profiles.T
    open_places = uneven[:, 0]
    groups = np.full(len(images), -1)
    for place in range(len(images)):
        if open_places[place]:
            alike = open_places & (cosines[place] >= MAX_ALIKE)
            groups[alike] = place
            open_places = open_places & ~alike
    return groups


def smoother_order(images: Array) -> SmootherOrder | None:
    """Return the order in which loads are smoothest; None where no order has the odds.

    Orders that are mirror images of each other have one evidence;
    of these the first counts.

    Parameters
    ----------
    images : array, shape (places, rows, columns)
        Images of the load in each place, in the scene's order.
    """
    if not len(images):
        return None
    flat = images.reshape(len(images), -1)
    as_specified = smooth_costs(images)
    tried = list(orders(*images.shape[1:]))

    def gains_of(order: Order) -> Array:
        in_order = flat[:, order.image]
        # Where a load covers few lines in an order, it is no image in that one either.
        shown = np.array([image_unit(np.abs(image)) > 0 for image in in_order])
        return np.asarray((as_specified - smooth_costs(in_order)) * shown)

    gains = [*map(gains_of, tried)]
    several = several_exchanges(tried, np.sum(gains, axis=1))
    tried += several
    gains += map(gains_of, several)
    best = int(np.argmax(np.sum(gains, axis=1).round(6)))
    # A coincidence bounds each place's share of the evidence.
    in_order = flat[:, tried[best].image]
    groups = along_side(in_order, tried[best].side)
    of_groups = np.bincount(groups[groups >= 0], weights=gains[best][groups >= 0])
    gain = float(np.minimum(of_groups, -2 * np.log(tried[best].coincidence)).sum())
    if not gain > 2 * np.log(ODDS * len(tried)):
        return None
    # A load on every second line may explain as much.
    of_combs = [as_specified - smooth_costs(images, step) for step in COMBS.values()]
    beyond = (gains[best] - of_combs).sum(axis=1)
    comb = int(np.argmin(beyond))
    every_second = list(COMBS)[comb] if beyond[comb] < 2 * np.log(ODDS) else ""
    return SmootherOrder(tried[best], gain, every_second)


def several_exchanges(tried: Sequence[Order], gains: Array) -> list[Order]:
    """Return orders with all exchanges of two lines that gain, of each side, and of both.

    Several swapped pairs are rough together, so that one exchange alone gains little.

    Parameters
    ----------
    tried : sequence of Order
    gains : array, shape (orders,)
        Gains in −2 ln evidence.
    """
    several = list[Order]()
    for side in (0, 1):
        of_side = [number for number in np.argsort(-gains) if tried[number].side == side]
        if not of_side:
            continue
        shape = tried[of_side[0]].image.shape
        at_home = np.arange(np.prod(shape)).reshape(shape)
        numbers = at_home
        chosen = list[Order]()
        for number in of_side:
            moved = tried[number].image != at_home
            two_lines = moved.sum() == 2 * at_home.shape[1 - side]
            if gains[number] > 0 and two_lines and not (moved & (numbers != at_home)).any():
                numbers = np.where(moved, tried[number].image, numbers)
                chosen.append(tried[number])
        if len(chosen) > 1:
            words = " and ".join(order.words for order in chosen)
            remedy = "; then ".join(order.remedy for order in chosen)
            several.append(Order(words, numbers, remedy, side))
    return several


def smooth_costs(images: Array, steps: tuple[int, int] = (1, 1)) -> Array:
    """Return −2 ln evidence of each image, (n,), as smooth processes of its lines.

    Parameters
    ----------
    images : array, shape (n, rows, columns)
    steps : tuple of int
        Distances between rows, and between columns, that a load covers: 2 for every second one.
    """
    costs: tuple[list[Array], ...] = ([], [], [])
    by_rows = images.mean(axis=2)
    by_columns = images.mean(axis=1)
    for length in LENGTHS:
        values, rows = _smooth_modes(images.shape[1], length, steps[0])
        across, columns = _smooth_modes(images.shape[2], length, steps[1])
        within = (rows.T @ images @ columns).reshape(len(images), -1)
        least = np.mean(within**2, axis=1)
        parts = (
            (by_rows @ rows, values, least / images.shape[2]),
            (by_columns @ columns, across, least / images.shape[1]),
            (within, np.outer(values, across).ravel(), least),
        )
        for of_part, (amplitudes, variances, smallest) in zip(costs, parts, strict=True):
            # n ln s² + Σ x²/(λ s²) − n + Σ ln λ,   λ = variances over their mean + ρ; 1 without an
            # order
            roughness = np.array(ROUGHNESS)[:, None]
            relative = np.where(
                np.isfinite(roughness), variances / variances.mean() + roughness, 1.0
            )
            count = len(variances)
            squares = (1 / relative) @ (amplitudes**2).T / count
            scale = np.maximum(squares, np.maximum(smallest, np.finfo(float).tiny))
            of_part += list(
                count * (np.log(scale) + squares / scale - 1)
                + np.log(relative).sum(axis=1, keepdims=True)
            )
    of_parts = [-2 * np.logaddexp.reduce(-np.array(part) / 2, axis=0) for part in costs]
    return np.asarray(np.sum(of_parts, axis=0))


@lru_cache(maxsize=64)
def _smooth_modes(count: int, length: float, step: int) -> tuple[Array, Array]:
    """Return the eigenvalues and eigenvectors of K on lines, orthogonal to the mean.

    Only lines whose distance is a multiple of the step are alike.
    """
    lines = np.arange(count)
    # Its rows are orthonormal, and orthogonal to the mean.
    differences = np.linalg.svd(np.ones((1, count)))[2][1:]
    distance = (lines[:, None] - lines) / step
    kernel = np.where(distance % 1 == 0, np.exp(-(distance**2) / (2 * length**2)), 0.0)
    values, vectors = np.linalg.eigh(differences @ kernel @ differences.T)
    return np.maximum(values, 0.0), differences.T @ vectors
