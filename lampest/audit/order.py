"""Order of the lines: whether loads are smooth in the scene's order, or in another one.

A load covers neighbouring cells, and its crosstalk rows and columns. Lines that a program numbered
otherwise, or a frame that was cut into rows of another length, tear its image apart. Frames whose
changes are alike show one place of a load, and their mean is its image. An image is the sum of its
mean, a part of the rows, one of the columns, and an interaction. Each part is a smooth Gaussian
process over the lines beside a roughness that knows no order,

    cov = s² (K/mean(diag K) + ρ),   K = C exp(−(i − j)²/(2 ℓ²)) C,   C = 1 − 1 1ᵀ/n,

with K_rows ⊗ K_columns for the interaction. The scale s is integrated out by its maximum, ℓ and ρ
over a few values, equally probable. An order is found where its odds against all others that are
tried, and against the scene's, are a thousand to one. Single cells far larger than all others may
stand side by side by chance: the normal scores of the ranks have to show the order, too.

A load in one place may be like one in another order: two feet half a panel apart are one smooth
load where odd and even lines are apart, an edge between two lines is one where they are swapped.
Such a coincidence has a probability of its own, `Order.coincidence`, which bounds the evidence of
each place: loads in several places tell an order, and one that stands tells none of lines. Nor does
a load that lies on all lines alike, such as a bar along the columns: by them it shows the film.

A load on every second line, such as a comb, has the image of a load on interleaved lines. Where
such a load has not these odds against it, the recording cannot tell the order.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain, combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lampest.audit.finding import Finding
from lampest.panel.panel import Array
from lampest.posterior.interval import normal_quantile
from lampest.recording.readings import median
from lampest.recording.recording import UNLOADED, Recording

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
TINY = 1e-30  # norm of no image
# Standard deviation of a load's mean on each line over its mean on all lines, or over the standard
# deviation of its image, the larger one. Films that scatter by 0.3 have 0.33 under a bar, and loads
# in one place 0.6 and more (docs/studies/wrong_readings.md).
MIN_CONTRAST = 0.5
MAX_ALIKE = 0.5  # cosine between the changes of two places


@dataclass(frozen=True, eq=False)
class Order:
    """An order of the readings on the panel.

    Attributes
    ----------
    words : str
    image : integer array, shape (rows, columns)
        Number of the reading, in the scene's order along the rows, at each place.
    remedy : str
    coincidence : float
        Probability that a load in one place is smooth in this order by chance.
    side : int or None
        Axis of the lines whose order this is: 0 for rows, 1 for columns, None for neither.
    """

    words: str
    image: NDArray[np.intp]
    remedy: str
    coincidence: float = NO_LOAD
    side: int | None = None


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
            yield Order(f"{name} {words}", image, remedy, COINCIDENCE, place)


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


def exchanged_lines(count: int) -> Iterator[tuple[str, NDArray[np.intp]]]:
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


def order_findings(recording: Recording, volts: Array) -> Iterator[Finding]:
    """Yield a finding where another order makes loads smooth.

    Parameters
    ----------
    recording : Recording
    volts : array, shape (frames, rows, columns)
        Voltages; NaN where missing.
    """
    scene = recording.scene
    unloaded = recording.role == UNLOADED
    if min(scene.panel.shape) < MIN_LINES or not unloaded.any() or unloaded.all():
        return
    if not scene.whole:
        return
    lsb = 0.0 if scene.readout is None else scene.readout.lsb_volt
    images = load_images(volts[~unloaded], volts[unloaded], lsb)
    steps = list[SmootherOrder]()
    while len(steps) < MAX_STEPS and (found := smoother_order(images)) is not None:
        order, _, every_second = found
        if every_second and not steps:
            yield Finding(
                "order",
                "the order of lines cannot be told from this recording",
                f"loads lie on every second {every_second}, or they are smooth with {order.words}",
                remedy=f"press a spot that covers neighbouring {every_second}s at a known place",
            )
            return
        steps.append(found)
        images = images.reshape(len(images), -1)[:, order.image]
    if steps:
        gain = sum(step.gain for step in steps) / (2 * np.log(10))
        yield Finding(
            "order",
            "readings seem to come in another order: "
            + " and ".join(step.order.words for step in steps),
            f"loads are smooth then, with odds of 10^{gain:.0f} to one",
            remedy="; then ".join(step.order.remedy for step in steps),
        )


def load_images(loaded: Array, resting: Array, least_noise: float) -> Array:
    """Return the image of the load in each of its places, (places, rows, columns).

    Frames whose changes have a cosine of MAX_ALIKE or more show one place.

    Parameters
    ----------
    loaded, resting : arrays, shape (frames, rows, columns)
        Voltages under load, and those of the unloaded panel; NaN where missing.
    least_noise : float
        Least standard deviation of a reading.
    """
    change = loaded - median(resting)[0]
    change = np.where(np.isfinite(change), change, 0.0)
    steps = np.diff(resting, axis=0)
    steps = steps[np.isfinite(steps)]
    noise = max(float(np.sqrt(np.sum(steps**2) / (2 * max(steps.size, 1)))), least_noise)
    flat = change.reshape(len(change), -1)
    size = np.linalg.norm(flat, axis=1)
    strongest = np.argsort(-size)[:MAX_FRAMES]
    strongest = strongest[size[strongest] > MIN_CHANGE * noise * np.sqrt(flat.shape[1])]
    flat = flat[strongest] / size[strongest, None]
    images = list[Array]()
    while len(flat) and len(images) < MAX_PLACES:
        alike = flat @ flat[0] >= MAX_ALIKE
        images.append(flat[alike].mean(axis=0))
        flat = flat[~alike]
    return np.reshape(images, (-1, *change.shape[1:]))


def along_side(images: Array, side: int | None) -> NDArray[np.intp]:
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
    ranks = np.argsort(np.argsort(flat, axis=1), axis=1)
    both = (flat, normal_quantile((ranks + 0.5) / flat.shape[1]))
    as_specified = [smooth_costs(values.reshape(images.shape)) for values in both]

    def gains_of(tried: Sequence[Order]) -> Array:
        """Return gains by values and by ranks, (2, orders, places)."""
        costs = [costs_of_orders(values, tried) for values in both]
        return np.array(as_specified)[:, None] - costs

    tried = list(orders(*images.shape[1:]))
    gains = gains_of(tried)
    several = several_exchanges(tried, np.min(gains, axis=0).sum(axis=1))
    tried += several
    gains = np.concatenate([gains, gains_of(several)], axis=1)
    # By the less certain of both, values or ranks.
    of_places = np.min(gains, axis=0)
    best = int(np.argmax(of_places.sum(axis=1).round(6)))
    # A coincidence bounds each place's share of the evidence.
    groups = along_side(images, tried[best].side)
    of_groups = np.bincount(groups[groups >= 0], weights=of_places[best][groups >= 0])
    gain = float(np.minimum(of_groups, -2 * np.log(tried[best].coincidence)).sum())
    if not gain > 2 * np.log(ODDS * len(tried)):
        return None
    # By the same of both, values or ranks, a load on every second line may explain as much.
    combs = [
        [specified - smooth_costs(values.reshape(images.shape), step) for step in COMBS.values()]
        for specified, values in zip(as_specified, both, strict=True)
    ]
    beyond = np.min(gains[:, [best]] - combs, axis=0).sum(axis=1)
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
            several.append(Order(words, numbers, remedy, COINCIDENCE, side))
    return several


def costs_of_orders(values: Array, tried: Sequence[Order]) -> Array:
    """Return −2 ln evidence of images in each order, shape (orders, places).

    Orders whose images have one shape are evaluated together.

    Parameters
    ----------
    values : array, shape (places, readings)
    tried : sequence of Order
    """
    costs = np.empty((len(tried), len(values)))
    shapes = [order.image.shape for order in tried]
    for shape in set(shapes):
        numbers = [number for number, of_order in enumerate(shapes) if of_order == shape]
        images = np.concatenate([values[:, tried[number].image] for number in numbers])
        costs[numbers] = smooth_costs(images).reshape(len(numbers), -1)
    return costs


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
        parts = (
            (by_rows @ rows, values),
            (by_columns @ columns, across),
            (within, np.outer(values, across).ravel()),
        )
        for of_part, (amplitudes, variances) in zip(costs, parts, strict=True):
            # n ln(Σ x²/λ / n) + Σ ln λ,   λ = variances over their mean + ρ; 1 without an order
            roughness = np.array(ROUGHNESS)[:, None]
            relative = np.where(
                np.isfinite(roughness), variances / variances.mean() + roughness, 1.0
            )
            count = len(variances)
            squares = (1 / relative) @ (amplitudes**2).T / count
            of_part += list(
                count * np.log(np.maximum(squares, np.finfo(float).tiny))
                + np.log(relative).sum(axis=1, keepdims=True)
            )
    of_parts = [-2 * np.logaddexp.reduce(-np.array(part) / 2, axis=0) for part in costs]
    return np.asarray(np.sum(of_parts, axis=0))


@lru_cache(maxsize=64)
def _smooth_modes(count: int, length: float, step: int) -> tuple[Array, Array]:
    """Return the eigenvalues and eigenvectors of K on lines, without the mean.

    Only lines whose distance is a multiple of the step are alike.
    """
    lines = np.arange(count)
    centring = np.eye(count) - 1 / count
    distance = (lines[:, None] - lines) / step
    kernel = np.where(distance % 1 == 0, np.exp(-(distance**2) / (2 * length**2)), 0.0)
    values, vectors = np.linalg.eigh(centring @ kernel @ centring)
    return np.maximum(values[1:], 0.0), vectors[:, 1:]
