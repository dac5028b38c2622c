"""One key, one number: advice says what the recording determines where its scene names the key."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from contracts.own_effect import Crosstalk
from promises import promise
from units.test_own_effect import MODULE

from docs.studies.advice import keys_of
from docs.studies.effects import LOADS, Row, recording
from lampest import Recording, Systematic
from lampest.audit.advice import named, unnamed_effects
from lampest.files.document import parse_document
from lampest.inference.prepared import Prepared
from lampest.inference.resolve import ENTRIES
from lampest.panel.effects import shared_effects
from lampest.recording.simulation import simulate
from lampest.recording.simulation.file import simulation_of

SIMULATION = """\
schema: 1
seed: 3
scene: {{panel: {{rows: 8, columns: 8}}, readout: {{kind: {kind}, adc_bits: 12, readings: 20}}}}
baseline_frames: 5
frames: 4
loads: [{{kind: rod, centre_mm: [30, 20], diameter_mm: 15, mass_g: 2000}}]
unmodelled: {{{effect}}}
"""


def simulated(effect: str, kind: str = "two_point") -> Recording:
    """Return a simulated recording of a readout with an entry of `unmodelled`."""
    text = SIMULATION.format(effect=effect, kind=kind)
    return simulate(simulation_of(parse_document(text, "s.yaml")), "s")


RECORDINGS: dict[str, Callable[[], Recording]] = {
    "readout.passes_volt": lambda: simulated("saturation: 0.65"),
    "leaks": lambda: simulated("leak_ohm: 20000"),
    "ground_ohm": lambda: simulated("ground_ohm: 5", "grounded"),
    "contacts": lambda: recording(4003, LOADS["mouth"], Row(contact_ohm=60.0), {}),
    "systematic.reading_error": lambda: recording(4003, LOADS["still"], Row(static=0.01), {}),
    "systematic.channel_spread_ohm": lambda: recording(
        4003, LOADS["mouth"], Row(channel_ohm=10.0), {}
    ),
    "gain": lambda: recording(4003, LOADS["still"], Row(gain=0.01), {}),
    "ripple": lambda: recording(4003, LOADS["still"], Row(ripple_lsb=1.0), {}),
    "creep": lambda: recording(4003, LOADS["still"], Row(creep=0.03), {}),
    "converter_memory": lambda: recording(4003, LOADS["mouth"], Row(memory=0.03), {}),
    "motion": lambda: recording(4003, LOADS["still"], Row(speed=0.3), {}),
}
NEVER_ADVISED = {"readout.converter.zero_volt"}


def in_words(key: str, number: float, deviation: float) -> set[str]:
    """Return the numbers of an estimate as advice may write them."""
    match key:
        case "leaks":
            return {f"a leak of {1e-3 / number:.2g} kohm"}
        case "ground_ohm":
            return {f"a ground of {number:.2g} ohm"}
        case "contacts":
            return {f"{abs(number):.2g} ohm {'more' if number > 0 else 'less'}"}
        case "readout.passes_volt":  # a range, the end of which is its second number
            return {f"end at the same {deviation:.3g} volt"}
    # in the unit of the key, or in percent
    return {f"{f * number:.2g} +- {f * deviation:.1g} " for f in (1, 100)}


def checked(made: Recording) -> set[str]:
    """Return the keys that advice names, each of which has the number of the estimate."""
    prepared = Prepared(made)
    findings = unnamed_effects(prepared)
    estimated = named(prepared, *findings).noise.estimated if findings else {}
    keys = set[str]()
    for finding in findings:
        (key,) = keys_of(finding.addition)
        keys.add(key)
        # a line effect has the place of each behind its key
        ((number, deviation),) = (
            size for name, size in estimated.items() if name.partition(" of ")[0] == key
        )
        whole = (rf"(?<![\d.]){re.escape(text)}" for text in in_words(key, number, deviation))
        assert any(re.search(text, finding.what) for text in whole), (finding.what, number)
    return keys


def test_every_effect_that_advice_may_name_is_compared() -> None:
    shared = {f"systematic.{error.setting}" for error in shared_effects() if error.is_advised}
    others = {key for entry in ENTRIES if not entry.section for key in entry.keys}
    assert {*RECORDINGS, *NEVER_ADVISED} == shared | others


@pytest.mark.slow
@promise("theory/model_check: The number of advice is the one that its entry estimates")
@pytest.mark.parametrize("key", RECORDINGS)
def test_advice_has_the_number_of_the_estimate(key: str) -> None:
    """A droop of 0.029 +- 0.0002 was advised, and 0.019 +- 0.015 estimated."""
    assert key in checked(RECORDINGS[key]())


@pytest.mark.slow
@pytest.mark.parametrize("load", ["still", "swaying"])
def test_advice_on_an_own_effect_has_the_number_of_the_estimate(
    load: str, package: Callable[..., None]
) -> None:
    package(MODULE, effects="addon:Crosstalk")
    made = recording(4001, LOADS[load], Row(), {})
    circuit = made.scene.circuit
    exact = circuit.from_recorded(made.recorded, made.scene)
    size = 2 * Crosstalk.prior
    off = exact + size * np.roll(exact, exact.shape[-2] // 2, axis=-2)
    coupled = replace(made, recorded=circuit.to_recorded(off, made.scene))
    assert "systematic.crosstalk" in checked(coupled)
    named_so = replace(coupled.scene, systematic=Systematic(crosstalk="estimated"))
    found, deviation = Prepared(replace(coupled, scene=named_so)).noise.estimated[
        "systematic.crosstalk"
    ]
    assert abs(found - size) < 3 * deviation
    assert checked(made) == set()
