"""Hostile results for the C export."""

import contextlib
import dataclasses
import re
from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest
from attack.attack import PASSED, Outcomes, Rng, attack, drawn, solvable_recording, unless

from lampest import (
    CaseResult,
    DrivenReadout,
    InputError,
    LogGradient,
    Misfit,
    Readout,
    TwoPointReadout,
    reconstruct,
)
from lampest.apps.microcontroller.constants import Constants
from lampest.apps.microcontroller.header import header

NUMBERS = (0.0, -1.0, np.nan, np.inf, -np.inf, 1e39, 1e-40, 1e300, -1e300)
VALUES = (
    "baseline_resistance",
    "cell_resistance",
    "sigma",
    "sigma_own",
    "measured",
    "measured_baseline",
)
MISFIT = "terms:\n- {{kind: misfit, weighting: noise{}}}\n"
PENALTY = "terms:\n- {{kind: misfit, weighting: noise}}\n- {{kind: log_gradient, weight: 1.0{}}}\n"
LOSSES = "squared", "{}", "{kind: huber, corner: x}", "{kind: [1]}"
KEYS = ", weight: 0", ", weight: '*/ int'", "}\n- {kind: misfit", ", weight: []"
BOUNDS = "bounds: 3\n", "bounds: {lower: 'int x;', upper: yes}\n"
KINDS = "int", "gradient", "'log_ratio\\n'", "log_ratio"
CONFIGURATIONS = (
    *("", "[]", "x", "terms: 3", "terms: []", "terms: {misfit: {}}", "terms: [3]", "terms: [{}]"),
    *(MISFIT.format(f", loss: {loss}") for loss in LOSSES),
    *map(MISFIT.format, KEYS),
    *(MISFIT.format("") + bounds for bounds in BOUNDS),
    *(MISFIT.format("") + f"- {{kind: {kind}}}\n" for kind in KINDS),
)
FLOAT = re.compile(r"[-+.\w]*\df\b|\b(?:nan|inf)\w*", re.IGNORECASE)


@cache
def case_of(readout: Readout) -> CaseResult:
    """A solved case of a small panel."""
    terms = [Misfit(weighting="noise"), LogGradient(weight=1.0)]
    estimates = reconstruct(solvable_recording(readout), terms, formulation="reduced")
    return estimates.result("smooth")


def replaced(case: CaseResult, **changes: object) -> Iterator[CaseResult]:
    """The case with other content, unless results refuse it."""
    with contextlib.suppress(InputError):
        yield dataclasses.replace(case, **changes)


def hostile() -> Iterator[CaseResult]:
    """Cases with one value, or all, or the configuration replaced."""
    cases = [
        case_of(TwoPointReadout(noise_lsb=0.7, readings=20)),
        case_of(DrivenReadout(noise_lsb=0.7)),
    ]
    for case in cases:
        for number in NUMBERS:
            text = {"nan": ".nan", "inf": ".inf", "-inf": "-.inf"}.get(str(number), f"{number:e}")
            for name in VALUES:
                for chosen in (slice(None), slice(3, 4)):
                    values = getattr(case, name).copy()
                    values.reshape(-1)[chosen] = number
                    yield from replaced(case, **{name: values})
            yield from replaced(case, weights={name: np.full(3, number) for name in case.weights})
            configured = [
                pattern.format(f", loss: {{kind: huber, corner: {text}}}")
                for pattern in (MISFIT, PENALTY)
            ]
            configured += [
                MISFIT.format(f", weight: {text}"),
                PENALTY.format("") + f"bounds: {{lower: {text}}}\n",
            ]
            configured.append(PENALTY.format("") + f"bounds: {{upper: {text}}}\n")
            configured += CONFIGURATIONS
            for content in configured:
                yield from replaced(case, case_yaml=content)
        yield from replaced(case, weights={})
        codes = dataclasses.replace(case.scene.circuit, adc_bits=1, readings=1)
        yield from replaced(case, scene=dataclasses.replace(case.scene, readout=codes))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@attack(60, 1000)
def test_hostile_results_give_a_sound_header_or_are_refused(
    rng: Rng, _: object, count: int
) -> Outcomes:
    """A compiler refused NaN, and without one it was written."""
    for number, case in drawn(rng, [*hostile()], count):
        try:
            text = header(Constants.of(case), "panel", ())
        except InputError as error:
            yield PASSED if str(error).count("\n") == 0 else f"{number}: {error}"
            continue
        numbers = [
            float(word[:-1]) for word in FLOAT.findall(text.partition("lampest_estimate.h")[2])
        ]
        sound = all(value == 0 or 1e-37 <= abs(value) <= 3e38 for value in numbers)
        yield unless(sound and numbers, f"{number}: {sorted(numbers)[:2]}, {sorted(numbers)[-2:]}")


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"weights": {"log_gradient": np.full(3, -1.0)}}, "takes weights from 0 to 1e+30, not -1"),
        (
            {"baseline_resistance": np.full((3, 4), 1e-4)},
            "takes cells at rest, ohm, from 0.001 to 1e+09, not 0.0001",
        ),
        ({"case_yaml": "terms: 3"}, "its stored configuration is none that lampest writes"),
        (
            {"case_yaml": PENALTY.format("") + "bounds: {lower: 5e3, upper: 1e3}\n"},
            "the lower one, 5000 ohm, exceeds",
        ),
    ],
)
def test_constants_of_unsupported_results_are_refused(
    changes: dict[str, object], sentence: str
) -> None:
    case = dataclasses.replace(case_of(TwoPointReadout(noise_lsb=0.7, readings=20)), **changes)
    with pytest.raises(InputError, match=re.escape(sentence)):
        Constants.of(case)
