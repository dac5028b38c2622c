"""Time of frames solved in blocks or one by one, and of the whole `lampest.reconstruct`.

The blocks are of many or of one.

python -m docs.studies.blocks [--sides 10 16 20] [--period 0.25] [--turns 5]: processor time of a
frame with error bars in inverses of a matrix of all lines but one, medians of turns A B A B, of 24
frames under a rod.

python -m docs.studies.blocks --jumping --period 0.1 [--sides 10 16]: the frames jump between four
rods.
"""

import argparse
from dataclasses import replace
from time import process_time

import numpy as np

import lampest
from lampest.apps.studies.common import inverse_time
from lampest.estimate.batch import push_block, push_streams
from lampest.estimate.sequence import first_stream
from lampest.files.process import ONE_BLAS_THREAD
from lampest.inference.prepared import Prepared
from lampest.solvers.projected_lbfgs import InverseHessians

FRAMES = 24
METHODS: dict[str, tuple[lampest.Term, ...]] = {
    "plain least squares": (lampest.Misfit(),),
    "gradient": (lampest.Misfit(), lampest.Gradient()),
    "log_gradient": (lampest.Misfit(weighting="noise"), lampest.LogGradient()),
}


def main() -> None:
    """Print a row of the table for every panel and method."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sides", type=int, nargs="+", default=[10, 16, 20])
    parser.add_argument("--period", type=float, default=0.25, help="s between frames")
    parser.add_argument("--turns", type=int, default=5, help="of which the median counts")
    parser.add_argument("--jumping", action="store_true", help="frames jump between four rods")
    options = parser.parse_args()
    titles = (
        "panel",
        "terms",
        "frame by frame",
        "in blocks of one",
        "in blocks",
        "the whole call, a frame",
    )
    print(f"| {' | '.join(titles)} | largest difference of ln r |")
    print("|---" * (len(titles) + 1) + "|")
    for side in options.sides:
        make = jumping_between_rods if options.jumping else under_a_rod
        recording = make(side, options.period)
        with ONE_BLAS_THREAD:
            unit = inverse_time(
                np.random.default_rng(0).random((2 * side - 1, 2 * side - 1))
                + side * np.eye(2 * side - 1)
            )
            for name, terms in METHODS.items():
                *times, difference = _measured(recording, terms, options.turns)
                figures = " | ".join(f"{1e3 * time:.1f} ms, {time / unit:.0f}" for time in times)
                print(f"| {side} × {side} | {name} | {figures} | {difference:.0e} |", flush=True)


def under_a_rod(side: int, period: float) -> lampest.Recording:
    """Return frames of a rod in the middle."""
    middle = (side - 1) / 2
    return _of_rod(side, period, (middle, middle), diameter=3.0, mass_g=800)


def jumping_between_rods(side: int, period: float) -> lampest.Recording:
    """Return frames that show four rods in turn."""
    low, middle, high = ((side - 1) * share for share in (0.25, 0.5, 0.75))
    recordings = [
        _of_rod(side, period, (middle, middle), diameter=2.5, mass_g=500),
        _of_rod(side, period, (low, low), diameter=3.0, mass_g=700),
        _of_rod(side, period, (high, middle), diameter=3.5, mass_g=900),
        _of_rod(side, period, (middle, high), diameter=4.0, mass_g=1100),
    ]
    recorded = recordings[0].recorded.copy()
    for place, frame in enumerate(recordings[0].measured_frames().tolist()):
        recorded[frame] = recordings[place % len(recordings)].recorded[frame]
    return replace(
        recordings[0],
        recorded=recorded,
        raw_sums=None,
        truth_cell_resistance=None,
        truth_pressure=None,
        simulation=None,
    )


def _of_rod(
    side: int, period: float, centre: tuple[float, float], diameter: float, mass_g: float
) -> lampest.Recording:
    """Return frames of a rod; centre and diameter in pitches."""
    panel = lampest.Panel(side, side)
    rod = lampest.Rod(
        centre_mm=(panel.pitch_mm * centre[0], panel.pitch_mm * centre[1]),
        diameter_mm=diameter * panel.pitch_mm,
        mass_g=mass_g,
    )
    scene = lampest.Scene(
        panel, lampest.TwoPointReadout(adc_bits=12, noise_lsb=1.0, readings=4), 140.0
    )
    simulation = lampest.Simulation(
        1, 4, scene, baseline_frames=5, frames=FRAMES, frame_period_s=period, loads=(rod,)
    )
    return lampest.simulate(simulation)


def _measured(
    recording: lampest.Recording, terms: tuple[lampest.Term, ...], turns: int
) -> tuple[float, ...]:
    """Return seconds of a frame alone, in a block of one and of many, and of the whole call.

    The last value is the largest difference.
    """
    prepared = Prepared(recording)
    readings = prepared.noise.readings
    frames = recording.measured_frames()
    stream = first_stream(recording, readings, lampest.Estimator(terms, "reduced"), prepared.noise)
    stream, _ = stream.push(readings[int(frames[0])])
    times = list[tuple[float, ...]]()
    for _ in range(turns):
        begin = process_time()
        later = stream
        cells = []
        for frame in frames[1:]:
            later, step = later.push(readings[int(frame)])
            cells.append(step.cell_resistance)
        alone = process_time() - begin
        begin = process_time()
        single = stream
        inverses = InverseHessians.nothing(1)
        for frame in frames[1:]:
            pushed, inverses = push_streams({0: single}, readings[frame : frame + 1], inverses)
            single, _ = pushed[0]
        single_time = process_time() - begin
        begin = process_time()
        steps = [step for _, step in push_block(stream, readings[frames[1:]])]
        blocks = process_time() - begin
        begin = process_time()
        lampest.reconstruct(recording, terms)
        whole = (process_time() - begin) / FRAMES
        times.append((*(time / (FRAMES - 1) for time in (alone, single_time, blocks)), whole))
    together = np.log([step.cell_resistance for step in steps])
    return *np.median(times, axis=0).tolist(), float(np.abs(together - np.log(cells)).max())


if __name__ == "__main__":
    main()
