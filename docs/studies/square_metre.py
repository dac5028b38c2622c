"""Processor time of a frame of many modules.

Run it with: python -m docs.studies.square_metre [MODULES ...] [--frames 8].

--weights: instead, errors of cells with one weight for all modules over those with a weight for
each. --disk: instead, `lampest run` of recordings of so many frames of 100 modules, from disk to
disk in one process.
"""

import argparse
import resource
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import lampest
from lampest.estimate.modules import ModulesStream, begin_networks, network_scenes
from lampest.estimate.sequence import deciding_data, first_stream
from lampest.estimate.stream import Stream
from lampest.estimate.weights import with_chosen_weights
from lampest.panel.panel import EachModule, Modules
from lampest.recording.recording import baseline_readings, deciding_frames

METHODS: dict[str, tuple[lampest.Term, ...]] = {
    "plain": (),
    "cell_resistance": (lampest.CellResistance(weight="auto"),),
    "gradient": (lampest.Gradient(weight=1e-6),),
}


@dataclass(frozen=True)
class Took:
    """Processor time, ms, and statuses.

    The time is that of what comes before the first frame, of that, and the median of later ones.
    """

    before: float
    first: float
    later: float
    statuses: tuple[str, ...]

    def __str__(self) -> str:
        bad = [status for status in self.statuses if not status.startswith("optimum")]
        return f"{self.before:7.0f} {self.first:7.0f} {self.later:7.1f} ms {bad[0] if bad else ''}"


def recording_of(modules: int, frames: int) -> lampest.Recording:
    """A mouth for every ten modules of 10 × 10 cells, as nearly square as it goes.

    0: one panel of 100 × 100.
    """
    rows = max(
        n for n in range(1, max(modules, 1) + 1) if modules % n == 0 and n * n <= max(modules, 1)
    )
    layout = Modules(rows, max(modules, 1) // rows, EachModule(10, 10))
    panel = lampest.Panel(modules=layout) if modules else lampest.Panel(100, 100)
    readout = lampest.TwoPointReadout(reference_ohm=1000, adc_bits=12, readings=20, noise_lsb=0.7)
    random = np.random.default_rng(3)
    (_, wide), (_, high) = panel.extents_mm
    mouths = tuple(
        lampest.OralDisc(
            centre_mm=(random.uniform(20, wide - 20), random.uniform(20, high - 20)),
            diameter_mm=35,
            rim_width_mm=6,
            pressure_kpa=-8,
            rim_kpa=20,
        )
        for _ in range(max(1, panel.crossings // 1000))
    )
    scene = lampest.Scene(panel, readout, 140.0)
    return lampest.simulate(
        lampest.Simulation(
            schema=1, seed=3, scene=scene, frames=frames, frame_period_s=0.02, loads=mouths
        )
    )


def took(
    recording: lampest.Recording, terms: tuple[lampest.Term, ...], bars: bool, alone: bool = False
) -> Took:
    """Return the time of one method; alone : every module by the solver for single panels."""
    estimator = lampest.Estimator((lampest.Misfit(), *terms), "reduced", error_bars=bars)
    readings = recording.readings()
    begin = time.process_time()
    stream = first_stream(recording, readings, estimator)
    layout = recording.scene.panel.modules
    before = time.process_time() - begin
    spent = []
    statuses = []
    parts = list[Stream]()
    if alone and isinstance(stream, ModulesStream):
        parts = list(stream.modules.values())
    for frame in recording.measured_frames():
        begin = time.process_time()
        if alone and layout is not None:
            steps = [
                part.push(readings[frame].of_module(layout, number))
                for number, part in enumerate(parts)
            ]
            parts = [part for part, _ in steps]
            statuses += [step.status for _, step in steps]
        else:
            stream, step = stream.push(
                lampest.Readings.of(recording.scene, recording.recorded[frame])
            )
            statuses.append(step.status)
        spent.append(1e3 * (time.process_time() - begin))
    return Took(1e3 * before, spent[0], float(np.median(spent[2:])), tuple(statuses))


def with_one_weight(penalty: lampest.Term, seed: int) -> str:
    """How own weights scatter, and the median error of cells with a shared one over theirs.

    The error is that of all, of one module.
    """
    layout = Modules(3, 4, EachModule(10, 10)) if seed != 2 else Modules(2, 3, EachModule(6, 4))
    panel = lampest.Panel(modules=layout)
    random = np.random.default_rng(seed)
    readout = lampest.TwoPointReadout(reference_ohm=1000, adc_bits=12, readings=20, noise_lsb=0.7)
    (_, wide), (_, high) = panel.extents_mm
    rods = tuple(
        lampest.Rod(
            centre_mm=(random.uniform(10, wide), random.uniform(10, high)),
            diameter_mm=30,
            mass_g=500,
        )
        for _ in range(3)
    )
    channels = lampest.Unmodelled(channel_spread_ohm=3.0 if seed == 3 else 0.0)
    scene = lampest.Scene(panel, readout, 140.0)
    made = lampest.Simulation(
        schema=1, seed=seed, scene=scene, frames=3, loads=rods, unmodelled=channels
    )
    recording = lampest.simulate(made)
    readings = recording.readings()
    truth = recording.truth_cell_resistance
    estimator = lampest.Estimator((lampest.Misfit(), penalty), "reduced", error_bars=False)
    chosen: list[float] = []

    networks = {}
    for number, own in network_scenes(scene, estimator).items():
        part = recording.modules[number]
        read = part.readings()
        resting = baseline_readings(part, read)
        frame = deciding_frames(part, read, resting)[0]
        weighted = with_chosen_weights(
            estimator, own, deciding_data(estimator, own, resting, read[frame])[0], None
        )
        chosen.append(float(weighted.terms[1].weight))
        networks[number] = weighted, own, resting
    errors = []
    apart = begin_networks(scene, networks, 1.0)
    for stream in (apart, first_stream(recording, readings, estimator)):
        state = stream
        deviations = []
        for frame in recording.measured_frames():
            state, step = state.push(readings[frame])
            assert truth is not None
            deviations.append(np.abs(np.log(step.cell_resistance / truth[frame])))
        errors.append(np.stack(deviations))
    alone, shared = (np.median(layout.split(each), axis=(0, 2, 3)) for each in errors)
    whole = np.median(errors[1]) / np.median(errors[0])
    return (
        f"weights × {max(chosen) / min(chosen):4.0f}   all {whole:.3f}   worst module "
        f"{(shared / alone).max():.3f}"
    )


ESTIMATORS = {
    "plain": "{terms: {misfit: {}}, error_bars: false}",
    "cell_resistance": "{terms: {misfit: {}, cell_resistance: {weight: auto}}, error_bars: false}",
    "plain, error bars": "{terms: {misfit: {}}}",
}
RUN = [
    sys.executable,
    "-c",
    "from lampest.cli import main; main()",
    "run",
    "run.yaml",
    "--jobs",
    "1",
    "--out",
]


def from_disk_to_disk(frames: int) -> dict[str, tuple[float, float]]:
    """Method → (s of processor time, MB of peak memory) of the command.

    The command runs on a recording of 100 modules.
    """
    measured = {}
    with TemporaryDirectory() as folder:
        recording_of(100, frames).save(Path(folder, "metre.h5"))
        for name, estimator in ESTIMATORS.items():
            text = f"schema: 1\nrecordings: [metre.h5]\nestimators: {{one: {estimator}}}\n"
            Path(folder, "run.yaml").write_text(text)
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            subprocess.run(
                [*RUN, name.replace(", ", "_").replace(" ", "_")], cwd=folder, check=True
            )
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            measured[name] = spent, after.ru_maxrss / 1024
    return measured


def main() -> None:
    """Print a line for every number of modules and method."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("modules", nargs="*", type=int, default=[1, 10, 50, 100])
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--weights", action="store_true")
    parser.add_argument("--disk", type=int, nargs="+", default=())
    given = parser.parse_args()
    runs = {frames: from_disk_to_disk(frames) for frames in given.disk}
    for name in ESTIMATORS if runs else ():
        (few, (short, _)), (many, (long, memory)) = (
            (frames, runs[frames][name]) for frames in (min(runs), max(runs))
        )
        each = (long - short) / max(many - few, 1)
        message = (
            f"{1e3 * each:5.0f} ms a frame, {short - few * each:5.1f} s once, peak {memory:.0f} MB"
        )
        print(
            f"{name:20} {few} frames {short:5.1f} s, {many} frames {long:5.1f} s: {message}",
            flush=True,
        )
    if given.disk:
        return
    for seed in (1, 2, 3) if given.weights else ():
        for penalty in (lampest.CellResistance(), lampest.Gradient(), lampest.LogGradient()):
            print(f"seed {seed} {penalty.kind:16}{with_one_weight(penalty, seed)}", flush=True)
    if given.weights:
        return
    print(f"{'':32}  before   first   later frames")
    for modules in given.modules:
        recording = recording_of(modules, given.frames)
        for name, terms in METHODS.items():
            print(f"{modules:4} modules {name:20}{took(recording, terms, False)}", flush=True)
        if modules:
            print(
                f"{modules:4} modules {'plain, error bars':20}{took(recording, (), True)}",
                flush=True,
            )
    if 0 in given.modules:
        return
    four = recording_of(4, given.frames)
    for name, terms in METHODS.items():
        print(f"   4 apart   {name:20}{took(four, terms, False, alone=True)}", flush=True)


if __name__ == "__main__":
    main()
