"""`weight: auto` on mats whose scene is right, or wrong.

What counts is its error over that of the best weight in hindsight.

Run it with: python -m docs.studies.chosen_weights [--mats 3] [--seed 1]; prints the table of the
page.

A mat of 10 × 10 cells with an uneven film is pressed at two places; a converter of 12 bits reads it
behind a divider, five frames unloaded and three pressed. The error is the rms of ln r, in the
strongest frame, with the weight of each rule; the best of weights on a grid about them counts as 1.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

import lampest
from lampest.panel.panel import Array

SIDE = 10
FRAMES = 8
UNLOADED = 5
FACTORS = 10.0 ** np.arange(-3.0, 3.1, 0.5)  # of the geometric mean of the rules' weights
PENALTIES: dict[str, lampest.Term] = {
    "log_gradient": lampest.LogGradient(),
    "gradient": lampest.Gradient(),
    "gradient_of_relative_change": lampest.GradientOfRelativeChange(),
}
RULES = ("risk", "evidence")


@dataclass(frozen=True)
class Condition:
    """How a mat differs from its scene.

    Attributes
    ----------
    noise_lsb, specified : float
        The true noise of a conversion, and the scene's.
    static : float
        Error of every reading, the same in all frames, relative.
    unloaded : bool
        Whether the recording marks its unloaded frames.
    """

    noise_lsb: float = 1.0
    specified: float = 1.0
    static: float = 0.0
    unloaded: bool = True


CONDITIONS = {
    "the scene is right": Condition(),
    "large noise": Condition(noise_lsb=8.0, specified=8.0),
    "noise specified 12 × too large": Condition(specified=12.0),
    "noise specified 12 × too large, no unloaded frames": Condition(specified=12.0, unloaded=False),
    "noise specified 12 × too small": Condition(noise_lsb=12.0),
    "static errors of 2 %": Condition(static=0.02),
    "static errors of 7 %": Condition(static=0.07),
    "static errors of 7 %, no unloaded frames": Condition(static=0.07, unloaded=False),
}


def recording_of(condition: Condition, seed: int) -> tuple[lampest.Recording, Array]:
    """A recording, and its true cells (frames, rows, columns) ohm."""
    rng = np.random.default_rng(seed)
    readout = lampest.TwoPointReadout(adc_bits=12, readings=1, noise_lsb=1.0)
    row, column = np.indices((SIDE, SIDE))
    film = 0.2 * np.sin(row / 2 + seed) * np.cos(column / 3) + 0.03 * rng.standard_normal(
        (SIDE, SIDE)
    )
    cells = np.repeat(3000 * np.exp(film)[None], FRAMES, axis=0)
    for size in (1.8, 0.8):
        place = rng.uniform(2, SIDE - 3, 2)
        load = np.exp(-((((row - place[0]) ** 2 + (column - place[1]) ** 2) / size**2) ** 2))
        cells[UNLOADED:] *= np.exp(
            -1.5 * load * np.linspace(0.7, 1, FRAMES - UNLOADED)[:, None, None]
        )
    exact = lampest.two_point_resistance(cells) * (
        1 + condition.static * rng.standard_normal((SIDE, SIDE))
    )
    codes = readout.volt_from_recorded(exact) / readout.lsb_volt
    codes = np.round(codes + condition.noise_lsb * rng.standard_normal(codes.shape))
    role = (np.arange(FRAMES) >= UNLOADED).astype(np.uint8)
    first = 0 if condition.unloaded else UNLOADED
    scene = lampest.Scene(
        lampest.Panel(SIDE, SIDE), replace(readout, noise_lsb=condition.specified)
    )
    recorded = readout.recorded_from_volt(codes * readout.lsb_volt)
    return lampest.Recording(
        scene, recorded[first:], np.arange(float(FRAMES - first)), role[first:]
    ), cells[UNLOADED:]


def excess(recording: lampest.Recording, cells: Array, penalty: lampest.Term) -> Array:
    """Error with the weight of each of RULES over that with the best weight.

    NaN where a rule has no estimate.
    """

    def fitted(weight: float | str, rule: str | None = None) -> lampest.Estimates:
        terms = [lampest.Misfit(weighting="noise"), replace(penalty, weight=weight)]
        auto = weight == "auto"
        return lampest.reconstruct(
            recording, terms, auto_weight=lampest.AutoWeight(rule=rule), error_bars=auto
        )

    def error(results: lampest.Estimates) -> float:
        return float(np.sqrt(np.mean(np.log(results.cell_resistance[-1] / cells[-1]) ** 2)))

    chosen = [fitted("auto", rule) for rule in RULES]
    middle = np.exp(np.mean([np.log(results.steps[-1].weights[1]) for results in chosen]))
    alternatives = [error(fitted(float(middle * factor))) for factor in FACTORS]
    errors = np.array([error(results) for results in chosen])
    return np.asarray(errors / np.nanmin([*alternatives, *errors]))


def table(mats: int, seed: int) -> Iterator[str]:
    """The lines of the page's table: median and largest, for each rule and penalty."""
    names = [f"`{name}`, {rule}" for name in PENALTIES for rule in RULES]
    yield f"| | {' | '.join(names)} |"
    yield "|---" * (len(names) + 1) + "|"
    for about, condition in CONDITIONS.items():
        usable = {
            name: term
            for name, term in PENALTIES.items()
            if condition.unloaded or "relative" not in name
        }
        figures = []
        for name, penalty in PENALTIES.items():
            drawn = [
                recording_of(condition, seed + number)
                for number in range(mats if name in usable else 0)
            ]
            results = np.array([excess(*each, penalty) for each in drawn]).reshape(-1, len(RULES))
            figures += [
                f"{np.median(own):.2f} / {own.max():.2f}" if len(own) else "" for own in results.T
            ]
        yield f"| {about} | {' | '.join(figures)} |"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--mats", type=int, default=3)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    for line in table(given.mats, given.seed):
        print(line, flush=True)
