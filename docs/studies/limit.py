"""Errors of methods against LSR-ΔCR and against the Cramér–Rao bound of the readings.

The recordings have 21 frames.

Every scene is drawn anew from the seed; nothing is what methods were tuned for but `attached`.
Run it with: python -m docs.studies.limit --recordings 6 --seed 501
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from time import process_time

import numpy as np
from numpy.typing import NDArray

from lampest import LoadedColumnsReadout
from lampest.cost.losses import Student
from lampest.cost.terms import (
    Arrival,
    LogRatio,
    Misfit,
    RelativeChange,
    Term,
    TotalVariationOfChange,
)
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods.smoother import SmootherMethod
from lampest.estimate.sequence import reconstruct
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import Readout, TwoPointReadout
from lampest.panel.response import ratio_from_pressure
from lampest.panel.scene import Scene
from lampest.panel.sizes import Systematic
from lampest.recording.recording import MEASURED, UNLOADED, Recording
from lampest.recording.shapes import OralDisc, Rod
from lampest.recording.simulation.measure import Unmodelled, measured

FRAMES = 21
RESTING = 3
PATCH_MM = 6.0
PITCH_MM = 10.0
# the latter as in the shipped recordings
CLEAN = Unmodelled()
REAL = Unmodelled(0.0, 3.0, 0.01, 0.01, 1e-4)
SYSTEMATIC = Systematic(reference_tolerance=0.01, channel_spread_ohm=3.0)
# of log r; of |x| in standard deviations
STEPPED = 0.05
NORMAL_MEDIAN = 0.6745
SMOOTHED = (Misfit(weighting="noise", loss=Student(corner=4.0)),)
METHODS: dict[str, tuple[tuple[Term, ...], str | SmootherMethod]] = {
    "LSR-dCR": ((Misfit(), RelativeChange(weight="auto")), "reduced"),
    "LSM": ((Misfit(),), "reduced"),
    "log_ratio": ((Misfit(), LogRatio(weight="auto")), "reduced"),
    "tv_of_change": ((Misfit(), TotalVariationOfChange(weight="auto")), "reduced"),
    "arrival": ((Misfit(weighting="noise"), Arrival()), "reduced"),
    "student": ((Misfit(), LogRatio(weight="auto", loss=Student(corner=3.0))), "reduced"),
    "smoother": (SMOOTHED, SmootherMethod()),
}


def mouth(rng: np.random.Generator, side: int, moved_mm: float = 0.0) -> Array:
    """Return contact and suction (2, rows, columns) of a random mouth, in kPa.

    The mouth lies `moved_mm` further along the rows.
    """
    place = rng.uniform(0.3, 0.7, 2) * (side - 1) * PITCH_MM
    load = OralDisc(
        centre_mm=(float(place[0] + moved_mm), float(place[1])),
        diameter_mm=float(rng.uniform(22, 42)),
        rim_width_mm=float(rng.uniform(4.5, 7)),
        pressure_kpa=float(-rng.uniform(5, 18)),
        rim_kpa=float(rng.uniform(50, 110)),
    )
    return np.stack(load.mean_pressure(Panel(side, side, PITCH_MM), PATCH_MM))


def attached(seed: int, side: int) -> Array:
    """Pressure (frames, rows, columns) kPa: touches, sucks in two frames, breathes."""
    frame = np.arange(FRAMES)[:, None, None]
    contact, suction = mouth(np.random.default_rng(seed), side)
    breath = 1 + 0.1 * np.sin(2 * np.pi * 1.15 * (frame + 0.8))
    return np.asarray(breath * (contact + np.minimum((frame + 0.2) / 2, 1) * suction))


def detaching(seed: int, side: int) -> Array:
    """There from the fourth to the thirteenth frame."""
    frame = np.arange(FRAMES)[:, None, None]
    return attached(seed, side) * ((frame >= 4) & (frame < 13))


def moving(seed: int, side: int) -> Array:
    """A mouth that creeps by 1.5 mm a frame."""
    return np.stack(
        [
            mouth(np.random.default_rng(seed), side, 1.5 * (t - 10)).sum(axis=0)
            for t in range(FRAMES)
        ]
    )


def rods(seed: int, side: int) -> Array:
    """Return a rod that stands, one that leaves, and one that taps for a single frame.

    The rods have no suction, and other places and times.
    """
    rng = np.random.default_rng(seed)
    panel = Panel(side, side, PITCH_MM)
    pressure = np.zeros((FRAMES, side, side))
    for first, last in ((3, FRAMES), (0, 9), (14, 15)):
        place = rng.uniform(0.15, 0.85, 2) * (side - 1) * PITCH_MM
        rod = Rod(
            centre_mm=(float(place[0]), float(place[1])),
            diameter_mm=25.0,
            mass_g=float(rng.uniform(50, 500)),
        )
        pressure[first:last] += sum(rod.mean_pressure(panel, PATCH_MM))
    return pressure


def hand(seed: int, side: int) -> Array:
    """A hand all over the panel, which never keeps still: six soft blobs whose weights walk."""
    rng = np.random.default_rng(seed)
    y, x = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    pressure = np.zeros((FRAMES, side, side))
    for _ in range(6):
        row, column = rng.uniform(0, side - 1, 2)
        weight = 8 * np.exp(np.cumsum(0.15 * rng.standard_normal(FRAMES)))
        pressure += weight[:, None, None] * np.exp(-((y - row) ** 2 + (x - column) ** 2) / 4)
    return pressure


@dataclass(frozen=True)
class Setting:
    """Course, electronics and circuit of recordings.

    noisier : the true noise over the specified noise. spread : of log r of unloaded cells.
    """

    course: Callable[[int, int], Array] = attached
    unmodelled: Unmodelled = CLEAN
    readout: Readout = TwoPointReadout(noise_lsb=0.7)
    side: int = 10
    spread: float = 0.2
    noisier: float = 1.0

    def recording(self, seed: int) -> Recording:
        """Three unloaded frames and 21 measured ones, a second apart, with their truth."""
        rng = np.random.default_rng(seed + 1)
        panel = Panel(self.side, self.side, PITCH_MM)
        two_point = self.readout.unit == "ohm"
        scene = Scene(panel, self.readout, 140.0 if two_point else 0.0)
        if self.unmodelled.channel_spread_ohm:
            scene = replace(scene, systematic=SYSTEMATIC)
        pressure = np.concatenate([np.zeros((RESTING, *panel.shape)), self.course(seed, self.side)])
        resting = 3050 * np.exp(self.spread * rng.standard_normal(panel.shape))
        time = np.arange(len(pressure), dtype=float)
        drift = np.exp(
            self.unmodelled.drift_per_minute
            / 60
            * rng.standard_normal(panel.shape)
            * time[:, None, None]
        )
        cells = resting * drift * ratio_from_pressure(pressure)
        noisy = replace(
            self.readout, noise_lsb=float(np.mean(self.readout.assumed_noise)) * self.noisier
        )
        recorded, _ = measured(replace(scene, readout=noisy), cells, self.unmodelled, seed)
        role = np.where(time < RESTING, UNLOADED, MEASURED).astype(np.uint8)
        return Recording(scene, recorded, time, role, truth_cell_resistance=cells)


SETTINGS = {
    "attached": Setting(),
    "attached, real": Setting(unmodelled=REAL),
    "detaching": Setting(detaching),
    "detaching, real": Setting(detaching, REAL),
    "moving": Setting(moving),
    "rods, one taps": Setting(rods),
    "rods, real": Setting(rods, REAL),
    "hand": Setting(hand),
    "noise 6 times": Setting(readout=TwoPointReadout(readings=1, noise_lsb=1.0)),
    "noise twice as told": Setting(noisier=2.0),
    "loaded columns": Setting(
        readout=LoadedColumnsReadout(load_ohm=3000.0, drive_ohm=100.0, adc_bits=12, noise_lsb=0.7)
    ),
    "uneven baseline": Setting(spread=0.6),
    "16 x 16": Setting(side=16),
}


def bound(recording: Recording, frames: NDArray[np.intp], cells: Array) -> Array:
    """Return the median |error| of log r at the Cramér–Rao bound, at most 1.

    The shape is (frames, rows, columns).
    """
    readings = recording.readings()
    circuit = recording.scene.circuit
    assert readings.sigma is not None
    results = []
    for number, truth in zip(frames, cells, strict=True):
        network = circuit.network(truth, circuit.ties(readings.value[number]))
        rows = network.sensitivity() / readings.sigma[number].ravel()[:, None]
        results.append(
            np.sqrt(np.diag(np.linalg.inv(rows.T @ rows + 1e-4 * np.eye(rows.shape[1]))))
        )
    return np.asarray(np.minimum(NORMAL_MEDIAN * np.stack(results), 1.0)).reshape(cells.shape)


def measure(
    recording: Recording, terms: tuple[Term, ...], formulation: str | SmootherMethod
) -> Array:
    """Median error, percent; over the bound; 95th; held; ms; solved.

    Held is of cells, changed ones, round jumps, changes.
    """
    begin = process_time()
    results = reconstruct(recording, Estimator(terms, formulation))
    lower = results.cell_resistance_lower
    upper = results.cell_resistance_upper
    seconds = process_time() - begin
    truth = recording.truth_cell_resistance
    solved = results.solved
    assert truth is not None and lower is not None and upper is not None
    cells = truth[results.frame]
    resting = truth[RESTING - 1]
    error = 100 * np.abs(results.cell_resistance / cells - 1)
    steps = np.abs(np.diff(np.log(truth), axis=0)).max(axis=(1, 2)) > STEPPED
    around = (steps[results.frame - 1] | np.append(steps, False)[results.frame]) & solved
    changed = (np.abs(np.log(cells / resting)) > STEPPED) & solved[:, None, None]
    held = 100.0 * ((lower <= cells) & (cells <= upper))
    change = 100 * (cells / resting - 1)
    low = results.relative_change_lower
    high = results.relative_change_upper
    cached = (
        np.full(cells.shape, np.nan)
        if low is None or high is None
        else 100.0 * ((low <= change) & (change <= high))
    )
    share = np.median(error[solved]) / (
        100 * np.median(bound(recording, results.frame, cells)[solved])
    )
    return np.array(
        [
            np.median(error[solved]),
            share,
            np.percentile(error[solved], 95),
            held[solved].mean(),
            held[changed].mean(),
            held[around].mean() if around.any() else np.nan,
            cached[solved].mean(),
            1e3 * seconds / len(cells),
            100.0 * solved.mean(),
        ]
    )


def study(count: int, seed: int, settings: list[str], methods: list[str]) -> None:
    """Print a table for every setting."""
    for name in settings:
        print(
            f"\n{name}: error (over LSR-dCR), over bound, 95th; held: cells, changed, round jumps, "
            "changes; ms; solved"
        )
        of_paper = np.ones(count)
        for method in methods:
            every = np.stack(
                [
                    measure(SETTINGS[name].recording(seed + 7 * k), *METHODS[method])
                    for k in range(count)
                ]
            )
            of_paper = every[:, 0] if method == "LSR-dCR" else of_paper
            error, share, high, *held, ms, solved = np.nanmean(every, axis=0)
            ratio = np.median(every[:, 0] / of_paper)
            shown = " ".join(f"{record:5.1f}" for record in held)
            text = (
                f"{error:6.3f} % ({ratio:4.2f}) {share:5.2f} {high:6.2f} %; {shown} %; "
                f"{ms:5.0f} ms; {solved:.0f} %"
            )
            print(f"  {method:14} {text}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=6)
    parser.add_argument("--seed", type=int, default=501)
    parser.add_argument("--settings", nargs="*", default=list(SETTINGS))
    parser.add_argument("--methods", nargs="*", default=list(METHODS))
    arguments = parser.parse_args()
    study(arguments.recordings, arguments.seed, arguments.settings, arguments.methods)
