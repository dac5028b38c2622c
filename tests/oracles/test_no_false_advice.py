"""Recordings without an effect, by the right circuit, which once were advised one."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from docs.studies.effects import LOADS, Load, Row
from docs.studies.effects import recording as on_film
from docs.studies.model_check import sound
from docs.studies.wrong_readings import drawn, of_load, with_starter
from lampest import Panel, Recording, Scene, datasets
from lampest.audit.advice import unnamed_effects
from lampest.inference.effects.converter_ends import saturated
from lampest.inference.prepared import Prepared
from lampest.panel.panel import Array
from lampest.panel.readouts import TwoPointReadout
from tests.estimates import recording_of

TWO_POINT = TwoPointReadout(readings=20, noise_lsb=0.7)
# Seeds of docs.studies.model_check, and what was taken for an effect or another circuit.
SOUND = {
    **dict.fromkeys(range(6), "nothing"),
    90026: "small readings of dissimilar cells, which crowd near zero",
    93008: "small readings of dissimilar cells, within the noise of the converter's end",
    90079: "cells that 8 bits leave uncertain",
    90220: "cells at their bounds",
    91002: "a bar over whole lines: 17 cells cost more than two under crosstalk of 28 ohm",
    94000: "cells of 72 ohm to 10 kilohm, whose scatter is no spread of channels",
    94002: "cells that differ by a factor of ten",
    94147: "cells that differ by a factor of ten",
    94026: "codes without noise, of which ten in 216 differ in each frame",
    94030: "a spread of channels that any larger one explains",
}
SOUND_WITHOUT_DRIFT = {
    93044: "cells that scatter by a factor of e",
    94120: "noise below the rounding",
    94145: "readings near a fold, where linear theory does not hold",
    96020: "readings near a fold, where linear theory does not hold",
    262152: "cells that readings hardly determine",
    462029: "noise that a rail cuts off: half of the codes are the last one",
}
# A palm once was creep of all cells, feet that stand once were motion, and a bar a contact.
UNDER_LOADS = [
    ("palm", 1000, None),
    ("palm", 1005, None),
    ("feet", 6004, "two_mux"),
    ("feet", 6022, "pull_ups"),
    ("sweep", 7002, "two_mux"),
    ("sweep", 12005, "two_mux"),
]
# Equal cells stand at one voltage, which was taken for the end of a stage; 901 was creep.
EQUAL_LOADS = [
    ("parallel_mux", "keys", 910),
    ("pull_ups", "keys", 919),
    ("pull_downs_on_columns", "keys", 928),
    ("driven_mux", "keys", 7100),
    ("driven_mux", "places", 7105),
    ("two_mux", "keys", 901),
]


def of_study(seed: int, *, drifts: bool = True) -> Recording:
    made = sound(seed, drifts=drifts)
    assert made is not None
    return made[1]


def under_load(load: str, seed: int, word: str | None) -> Recording:
    plan = drawn(seed, of_load(load))
    return (plan if word is None else with_starter(plan, word)).recording()


def equal_loads(word: str, load: str, seed: int, scatter: float = 0.0) -> Recording:
    """Return equal loads on a film of little scatter, by a starter's circuit."""
    plan = drawn(seed, of_load(load))
    random = np.random.default_rng([seed, 5])
    level = float(np.exp(np.mean(np.log(plan.cells))))
    alike = level * np.exp(scatter * random.standard_normal(plan.cells.shape))
    return with_starter(replace(plan, cells=alike), word).recording()


def breathing(seed: int, covered: Array) -> Recording:
    """Return a recording, scanned in no time, of a breathing load on the covered cells."""
    rng = np.random.default_rng(seed)
    load = 4.0 * (1 + 0.1 * np.sin(2.1 * np.arange(15) + rng.uniform(0, 6)))
    cells = np.repeat(3050 * np.exp(0.2 * rng.standard_normal((1, 10, 10))), 20, axis=0)
    cells[5:] *= np.exp(-0.2 * load[:, None, None] * covered)
    code = 1023 * 1000 / (TWO_POINT.exact_reading(cells) + 1140)
    noise = 0.7 * rng.standard_normal((20, *cells.shape))
    codes = np.clip(np.round(code + noise), 0, 1023).mean(axis=0)
    recorded = 1000 * (1023 - codes) / codes
    return recording_of(Scene(Panel(10, 10), TWO_POINT, 140.0), recorded, 5)


def covers() -> list[Array]:
    """A hand whose edge presses ever less, half a panel, and a mouth whose inside sucks."""
    down, across = np.indices((10, 10)) - 4.5
    distance = np.hypot(down, across)
    mouth = np.exp(-((distance - 1.7) ** 2) / 0.3) - 0.8 * (distance < 1.2)
    return [np.exp(-((distance / 3) ** 2)), 1.0 * (across < 0), mouth]


RECORDINGS: dict[str, Callable[[], Recording]] = {
    "channels alike under a mouth": lambda: on_film(100, LOADS["mouth"], Row(), {}),
    "channels alike under a hand": lambda: on_film(4001, Load(("hand",), swaying=0.05), Row(), {}),
}
RECORDINGS |= {f"{seed}: {why}": lambda seed=seed: of_study(seed) for seed, why in SOUND.items()}
RECORDINGS |= {
    f"{seed}: {why}": lambda seed=seed: of_study(seed, drifts=False)
    for seed, why in SOUND_WITHOUT_DRIFT.items()
}
RECORDINGS |= {f"{load[:2]}": lambda load=load: under_load(*load) for load in UNDER_LOADS}
RECORDINGS |= {f"equal {load}": lambda load=load: equal_loads(*load) for load in EQUAL_LOADS}
RECORDINGS |= {
    f"breathing {seed} {number}": lambda seed=seed, number=number: breathing(seed, covers()[number])
    for seed in range(6)
    for number in range(3)
}


@pytest.mark.parametrize("name", RECORDINGS)
def test_a_right_scene_is_advised_nothing(name: str) -> None:
    prepared = Prepared(RECORDINGS[name]())
    assert unnamed_effects(prepared) == ()
    assert prepared.check.explains is not False, prepared.check.sentence
    assert prepared.effects.name == ""
    assert prepared.noise.sentence == ""


def test_differences_that_a_load_makes_small_are_no_saturated_stage() -> None:
    """Where a pull-up has little on a pressed cell, 5 % of its resistance are two steps."""
    assert saturated(equal_loads("feedback", "keys", 7091, scatter=0.05)) is None


@pytest.mark.slow
@pytest.mark.parametrize("mouth", ["lamprey_25mm", "lamprey_35mm"])
def test_differing_channels_under_a_mouth_are_no_contact(mouth: str) -> None:
    """Channels of 3 ohm shift the cells of a rim, as low as 100 ohm, by several percent."""
    warnings = Prepared(datasets.load(mouth)).warnings
    assert not [line for line in warnings if "in one frame" not in line]
