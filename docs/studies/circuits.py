"""Digits and time of derivatives, by sums over lines and by potential differences.

Run it with: python -m docs.studies.circuits [--sides 10 32] [--turns 7]. The first table has the
errors of J·p and Jᵀw against 50 digits on 5 × 6 cells, relative to their largest entry. The second
one has the processor time of J·p with H·p. A circuit whose lines all have finite ties is computed
in both ways.
"""

import argparse
from time import process_time

import mpmath
import numpy as np

import lampest
from lampest import Array
from lampest.panel.difference_network import DifferenceNetwork
from lampest.panel.network import SolvedNetwork

SHAPE = 5, 6
CIRCUITS: dict[str, lampest.Readout] = {
    "grounded": lampest.GroundedReadout(),
    "loaded columns": lampest.LoadedColumnsReadout(),
}
DIGITS = 50


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sides", type=int, nargs="+", default=[10, 32])
    parser.add_argument("--turns", type=int, default=7, help="the fastest counts")
    options = parser.parse_args()
    print("| circuit | cells | J·p, lines | J·p, differences | Jᵀw, lines | Jᵀw, differences |")
    print("|---|---|---|---|---|---|")
    for name, readout in CIRCUITS.items():
        for contrast, cells in cells_of_contrasts().items():
            errors = (f"{error:.0e}" for error in errors_of(readout, cells))
            print(f"| {name} | {contrast} | {' | '.join(errors)} |")
    print("\n| cells | lines, ms | differences, ms |\n|---|---|---|")
    for side in options.sides:
        cells = random_cells((side, side), 0.5)
        times = [
            1e3 * least_time(network, options.turns)
            for network in both(CIRCUITS["grounded"], cells)
        ]
        print(f"| {side} × {side} | {times[0]:.3f} | {times[1]:.3f} |")


def random_cells(shape: tuple[int, int], deviation: float) -> Array:
    """Return log-normal cells about 3 kΩ, ohm; `deviation` is that of ln r."""
    scatter = np.random.default_rng(1).standard_normal(shape)
    return np.asarray(3000 * np.exp(deviation * scatter))


def cells_of_contrasts() -> dict[str, Array]:
    """Return cells (rows, columns) ohm by words for their contrast."""
    random = np.random.default_rng(0)
    decades = 3000 * 10 ** random.uniform(-3, 3, SHAPE)
    shorted = random_cells(SHAPE, 0.5)
    shorted[1, 2] = 0.01
    shorted[3, 4] = 0.01
    shorted[0, 0] = 1e8
    return {
        "usual": random_cells(SHAPE, 0.5),
        "six decades": decades,
        "two of 0.01 Ω, one of 100 MΩ": shorted,
    }


def both(readout: lampest.Readout, cells: Array) -> tuple[SolvedNetwork, DifferenceNetwork]:
    """Return the network by sums over lines, and by potential differences."""
    ties = readout.ties(cells)
    return (
        SolvedNetwork.tied(cells, ties, readout),
        DifferenceNetwork.of(cells, ties, readout),
    )


def errors_of(readout: lampest.Readout, cells: Array) -> list[float]:
    """Return the errors of J·p by lines and by differences, then those of Jᵀw."""
    random = np.random.default_rng(2)
    step, weights = random.standard_normal((2, *cells.shape))
    networks = both(readout, cells)
    jacobian = exact_jacobian(cells, readout.ties(cells), networks[1].slopes)
    pairs = [(network.forward(step), jacobian @ step.ravel()) for network in networks]
    pairs += [(network.adjoint(weights), weights.ravel() @ jacobian) for network in networks]
    errors = []
    for value, exact in pairs:
        exact = exact.astype(float)
        errors.append(float(np.abs(value.ravel() - exact).max() / np.abs(exact).max()))
    return errors


def exact_jacobian(cells: Array, ties: Array, slopes: tuple[Array, ...]) -> Array:
    """Return J for slopes of h, (readings, cells), as numbers of 50 digits."""
    rows, columns = cells.shape
    lines = rows + columns
    with mpmath.workdps(DIGITS):
        conductance = [1 / mpmath.mpf(float(cell)) for cell in cells.ravel()]
        admittance = mpmath.diag([mpmath.mpf(float(tie)) for tie in ties])
        for cell, (row, column) in zip(conductance, np.ndindex(rows, columns), strict=True):
            for first, second, sign in ((row, row, 1), (rows + column, rows + column, 1)):
                admittance[first, second] += sign * cell
            admittance[row, rows + column] -= cell
            admittance[rows + column, row] -= cell
        impedance = np.array((admittance**-1).tolist()).reshape(lines, lines)
        differences = impedance[:, :rows, None] - impedance[:, None, rows:]
        flat = differences.reshape(lines, -1)
        row, column = flat[:rows, None], flat[None, rows:]
        by_row, by_column, by_mutual = (
            np.broadcast_to(slope, cells.shape)[..., None] for slope in slopes
        )
        response = by_row * row**2 + by_column * column**2 + by_mutual * (row * column)
        return np.asarray(response * np.array(conductance)).reshape(cells.size, -1)


def least_time(network: SolvedNetwork, turns: int) -> float:
    """Return the least processor time of J·p with H·p, s."""
    random = np.random.default_rng(3)
    step, weights = random.standard_normal((2, *network.shape))
    second = network.second_order(weights)
    second.products(step)
    times = []
    for _ in range(turns):
        begun = process_time()
        for _ in range(20):
            second.products(step)
        times.append((process_time() - begun) / 20)
    return min(times)


if __name__ == "__main__":
    main()
