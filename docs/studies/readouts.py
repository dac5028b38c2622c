"""Every circuit through its own converter: noise of the cells, errors, and error bars.

Run it with: python -m docs.studies.readouts --draws 200 --seed 101
"""

import argparse

import numpy as np

from docs.studies.coverage import errors_of, mouth_cells
from lampest import (
    Diode,
    GroundedReadout,
    LoadedColumnsReadout,
    Panel,
    Readout,
    Recording,
    Scene,
    SeriesPerLine,
    TwoPointReadout,
    VirtualGroundReadout,
)
from lampest.cost.terms import Gradient, Misfit
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import reconstruct
from lampest.panel.panel import Array
from lampest.panel.readouts.converter import noise_volt

CONVERTER = {"adc_bits": 12, "readings": 1, "noise_lsb": 1.0}
SERIES = SeriesPerLine(70.0, 72.0)
CIRCUITS: dict[str, tuple[Readout, float | SeriesPerLine]] = {
    "two_point": (TwoPointReadout(**CONVERTER), SERIES),
    "loaded_columns": (LoadedColumnsReadout(load_ohm=10_000, drive_ohm=1080, **CONVERTER), 0.0),
    "loaded_columns, diode": (
        LoadedColumnsReadout(load_ohm=3300, drive_ohm=100, diode=Diode(), **CONVERTER),
        0.0,
    ),
    "loaded_columns, pull-ups": (
        LoadedColumnsReadout(
            load_ohm=35_000, drive_ohm=30, polarity="down", driven="columns", **CONVERTER
        ),
        0.0,
    ),
    "grounded, all": (GroundedReadout(load_ohm=1000, drive_ohm=70, **CONVERTER), 0.0),
    "grounded, one": (
        GroundedReadout(load_ohm=1000, drive_ohm=70, sense_ohm=70, sense="one", **CONVERTER),
        0.0,
    ),
    "virtual_ground": (
        VirtualGroundReadout(drive_ohm=70, sense_ohm=70, feedback_ohm=150, **CONVERTER),
        0.0,
    ),
}
METHODS = {
    "LSM": (Misfit(weighting="noise"),),
    "LSR-gCR": (Misfit(weighting="noise"), Gradient(weight="auto")),
}


def measured(scene: Scene, cells: Array, rng: np.random.Generator) -> Recording:
    """Frames (frames, rows, columns) of cells as the converter gives them.

    The first one is unloaded.
    """
    readout = scene.circuit
    volt = readout.volt_from_recorded(readout.to_recorded(readout.exact_reading(cells), scene))
    codes = readout.code_from_volt(volt + noise_volt(readout) * rng.standard_normal(volt.shape))
    role = np.minimum(np.arange(len(cells)), 1).astype(np.uint8)
    return Recording(
        scene,
        readout.recorded_from_volt(readout.volt_from_code(codes)),
        np.arange(float(len(cells))),
        role,
    )


def coverage(name: str, draws: int, seed: int) -> None:
    """Print coverage, errors over standard deviations and relative errors of one circuit.

    Sizes are 6 × 6 to 16 × 16.
    """
    readout, series = CIRCUITS[name]
    for method, terms in METHODS.items():
        rng = np.random.default_rng(seed)
        held = []
        sizes = []
        relative = []
        failed = 0
        for _ in range(draws):
            side = int(rng.integers(6, 17))
            cells = mouth_cells(rng, side)
            results = reconstruct(
                measured(Scene(Panel(side, side), readout, series), cells, rng),
                Estimator(terms, "reduced"),
            )
            errors = errors_of(results, cells[1])
            if errors is None:
                failed += 1
                continue
            held.append(errors.held)
            sizes.append(errors.standard)
            relative.append(np.abs(np.expm1(errors.every)).ravel())
        inside, size, off = (np.concatenate(part) for part in (held, sizes, relative))
        print(
            f"{name}: {method}: {100 * inside.mean():.1f} % held, error/sd "
            f"{np.sqrt(np.mean(size**2)):.2f}, "
            f"cell error {100 * np.median(off):.2f} / {100 * np.quantile(off, 0.95):.1f} % (median "
            "/ 95th), "
            f"{inside.size} cells, {failed} frames failed"
        )


def conditioning(seed: int) -> None:
    """Print √mean diag (JᵀΣ⁻¹J)⁻¹ of log r at three sizes.

    The converter alone causes these errors of cells of 1 to 10 kohm.
    """
    for name, (readout, series) in CIRCUITS.items():
        rng = np.random.default_rng(seed)
        deviations = []
        for side in (10, 16, 32):
            cells = 3162 * np.exp(rng.uniform(-0.5, 0.5, (side, side)) * np.log(10))
            scene = Scene(Panel(side, side), readout, series)
            network = readout.network(cells, readout.ties(cells))
            recorded = readout.to_recorded(network.reading(), scene)
            sigma = readout.sigma_of_reading(recorded, readout.sigma(recorded))
            factor = np.linalg.inv(network.sensitivity() / sigma.reshape(-1, 1))
            deviations.append(100 * np.sqrt(np.mean(np.sum(factor**2, axis=1))))
        numbers = " / ".join(f"{percent:.1f}" for percent in deviations)
        print(f"{name}: {numbers} % rms at 10, 16 and 32 lines a side")


def contrast(draws: int, seed: int) -> None:
    """Print the cell error of plain least squares and of the naive divider.

    The panel has 16 × 16 cells with a contrast of 77.
    """
    rng = np.random.default_rng(seed)
    readout, series = CIRCUITS["loaded_columns"]
    for middle in (3e3, 1e4, 3e4, 1e5, 3e5):
        off: dict[str, list[float]] = {"reduced": [], "naive": []}
        for _ in range(draws):
            cells = middle * np.exp(rng.uniform(-0.5, 0.5, (2, 16, 16)) * np.log(77))
            recording = measured(Scene(Panel(16, 16), readout, series), cells, rng)
            for formulation, results in off.items():
                done = reconstruct(
                    recording, Estimator(METHODS["LSM"], formulation, error_bars=False)
                )
                results.append(float(np.median(np.abs(done.cell_resistance[0] / cells[1] - 1))))
        text = ", ".join(
            f"{name} {100 * np.median(results):.2f} %" for name, results in off.items()
        )
        print(f"cells round {middle / 1e3:g} kohm: {text} off in the median cell")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--seed", type=int, default=101)
    parser.add_argument("--circuit", choices=tuple(CIRCUITS), action="append")
    arguments = parser.parse_args()
    conditioning(arguments.seed)
    contrast(min(arguments.draws, 20), arguments.seed)
    for circuit in arguments.circuit or CIRCUITS:
        coverage(circuit, arguments.draws, arguments.seed)
