"""Where `weight: auto` smooths weak loads, and whether the estimates say so.

A load of Gaussian shape is read by two multiplexers with one reading of 10 bits a frame, at
several strengths and noises. The table has the recordings with the sentence, the share of the
load's log change that is estimated, and the median of `resolution`.

Run it with: python -m docs.studies.weak_loads [--recordings 8] [--seed 20]
"""

import argparse
from collections.abc import Iterator

import numpy as np

import lampest

SIDE = 8
FRAMES = 9
UNLOADED = 5
CASES = ((0.3, 0.7), (0.3, 3.0), (0.3, 8.0), (0.15, 8.0))
PENALTIES: dict[str, lampest.Term] = {
    "log_gradient": lampest.LogGradient(),
    "gradient": lampest.Gradient(),
    "gradient_of_relative_change": lampest.GradientOfRelativeChange(),
    "log_ratio": lampest.LogRatio(),
}


def weak_load(
    seed: int, depth: float, noise_lsb: float, further: tuple[int, int] | None = None
) -> lampest.Recording:
    """A recording of a load whose strongest cell changes by −depth in log r.

    The cell `further` of the last frame changes by another 2 %.
    """
    rng = np.random.default_rng(seed)
    readout = lampest.TwoPointReadout(adc_bits=10, readings=1, noise_lsb=noise_lsb)
    row, column = np.indices((SIDE, SIDE))
    middle = rng.uniform(2.5, 4.5, 2)
    shape = np.exp(-((row - middle[0]) ** 2 + (column - middle[1]) ** 2) / 2.5)
    film = 3000 * np.exp(0.1 * rng.standard_normal((1, SIDE, SIDE)))
    cells = np.repeat(film, FRAMES, axis=0)
    cells[UNLOADED:] *= np.exp(-depth * shape)
    if further:
        cells[-1, *further] *= 1.02
    volt = readout.volt_from_recorded(lampest.two_point_resistance(cells) + 140)
    volt = volt + noise_lsb * readout.lsb_volt * rng.standard_normal(volt.shape)
    return lampest.Recording(
        lampest.Scene(lampest.Panel(SIDE, SIDE), readout, 140.0),
        readout.recorded_from_volt(volt),
        np.arange(FRAMES) / 4,
        (np.arange(FRAMES) >= UNLOADED).astype(np.uint8),
        truth_cell_resistance=cells,
    )


def figures(recording: lampest.Recording, penalty: lampest.Term) -> tuple[bool, float, float]:
    """Return whether the sentence is there, the share of the load, and the resolution."""
    estimates = lampest.reconstruct(recording, [lampest.Misfit(), penalty])
    truth = recording.truth_cell_resistance
    assert truth is not None and estimates.resolution is not None
    change = np.log(truth[-1] / truth[0])
    relative = estimates.relative_change
    assert relative is not None
    loaded = change < change.min() / 2
    share = np.median(np.log1p(relative[-1][loaded] / 100) / change[loaded])
    said = any("weak loads" in line for line in estimates.checks_without_circuit)
    return said, float(share), float(np.nanmedian(estimates.resolution))


def table(recordings: int, seed: int) -> Iterator[str]:
    """The lines of the page's table."""
    yield "| penalty | load | noise, LSB | said | share of the load | resolution |"
    yield "|---|---|---|---|---|---|"
    for name, penalty in PENALTIES.items():
        for depth, noise in CASES:
            every = [
                figures(weak_load(seed + number, depth, noise), penalty)
                for number in range(recordings)
            ]
            said = sum(one[0] for one in every)
            share, resolution = np.mean([one[1:] for one in every], axis=0)
            yield (
                f"| `{name}` | {100 * (1 - np.exp(-depth)):.0f} % | {noise:g} "
                f"| {said} of {recordings} | {share:.2f} | {resolution:.2f} |"
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--recordings", type=int, default=8)
    parser.add_argument("--seed", type=int, default=20)
    given = parser.parse_args()
    for line in table(given.recordings, given.seed):
        print(line, flush=True)
