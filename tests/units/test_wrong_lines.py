"""Lines of advice that would do harm: other meanings of values, orders that are a relabelling."""

from math import inf
from typing import Any

import numpy as np
import pytest

from lampest import (
    DrivenReadout,
    GroundedReadout,
    LoadedColumnsReadout,
    Panel,
    Readout,
    Scene,
    TwoPointReadout,
)
from lampest.audit.finding import PASTE, Finding, advised_entries, with_addition, with_lines
from lampest.files.document import in_one_line, parse_document
from lampest.inference.circuits.alternatives import BY_COLUMNS, Alternative, alternatives_of

KIND = {"readout": {"kind": "grounded", "driven": "rows", "sense": "one", "load_ohm": 2000}}
SERIES = {"series_resistance_ohm": 2140}


def finding(addition: dict[str, Any]) -> Finding:
    return Finding("circuit", "another circuit", "", addition)


def test_a_line_that_changes_the_meaning_of_values_is_refused() -> None:
    scene = Scene(Panel(8, 8), TwoPointReadout(reference_ohm=2000.0))
    changed, accepted, refused = with_lines(scene, [finding(KIND), finding(SERIES)])
    assert accepted == ("series_resistance_ohm: 2140",) and changed.series_resistance_ohm == 2140
    assert len(refused) == 1 and "in ohm, would mean something else" in refused[0]


def test_another_reference_changes_the_meaning_of_resistances() -> None:
    scene = Scene(Panel(8, 8), TwoPointReadout(reference_ohm=2000.0))
    _, accepted, refused = with_lines(scene, [finding({"readout": {"reference_ohm": 1000}})])
    assert not accepted and refused


def test_a_circuit_of_the_same_voltages_is_written() -> None:
    scene = Scene(Panel(8, 8), GroundedReadout())
    addition = {"readout": {"kind": "driven", "idle_ohm": 0, "load_ohm": 2000}}
    changed, accepted, _ = with_lines(scene, [finding(addition)])
    line = "readout: {kind: driven, idle_ohm: 0, load_ohm: 2000}"
    assert accepted == (line,) and isinstance(changed.readout, DrivenReadout)


def alternatives(scene: Scene) -> list[Alternative]:
    recorded = 1000 * np.exp(0.3 * np.random.default_rng(1).normal(size=(2, *scene.panel.shape)))
    return list(alternatives_of(Alternative(scene, recorded, np.ones_like(recorded))))


def kinds(scene: Scene) -> list[str]:
    return [alternative.kind for alternative in alternatives(scene)]


@pytest.mark.parametrize(
    "readout",
    [
        TwoPointReadout(reference_ohm=2000.0),
        GroundedReadout(load_ohm=1500.0),
        LoadedColumnsReadout(load_ohm=3000.0, groups=((0, 1), (2, 3))),
    ],
    ids=lambda readout: readout.kind,
)
def test_the_entries_of_a_alternative_make_its_circuit(readout: Readout) -> None:
    scene = Scene(Panel(4, 4), readout)
    for alternative in alternatives(scene):
        if alternative.order is not None:
            continue
        numbered = alternative.with_memory(0.0812)
        numbered = (
            numbered.with_series(141.3) if alternative.scene.circuit.unit == "ohm" else numbered
        )
        made = with_addition(scene, numbered.addition)
        assert made.readout == alternative.scene.readout, alternative.kind
        assert made.converter_memory == 0.081
        assert made.series_resistance_ohm == (140 if alternative.scene.circuit.unit == "ohm" else 0)


def test_another_order_of_readings_has_no_entries() -> None:
    listed = [
        alternative
        for alternative in alternatives(Scene(Panel(4, 5), GroundedReadout()))
        if alternative.order is not None
    ]
    assert listed and not any(alternative.addition for alternative in listed)


def test_a_line_of_advice_reads_back_as_its_entries() -> None:
    addition = {
        "readout": {"groups": [[0, 1], [2, 3]], "idle_ohm": 0.5, "load_ohm": inf, "sense": None},
        "motion": "estimated",
    }
    line = in_one_line(addition)
    assert parse_document(f"{{{line}}}", "the line").content == addition


def test_advised_entries_keep_what_the_finding_does_not_name() -> None:
    """A converter of 12 bits that became one of 10 bits refused its own codes."""
    readout = GroundedReadout(adc_bits=12, supply_volt=3.3, load_ohm=1500.0)
    scene = Scene(Panel(4, 4), readout)
    addition = {"readout": {"kind": "loaded_columns", "polarity": "up", "load_ohm": 1500.0}}
    sentence, line = advised_entries(scene, [finding(addition)])
    entries = parse_document(line, "the line").content["readout"]
    assert sentence == PASTE
    assert entries["adc_bits"] == 12 and entries["supply_volt"] == 3.3
    assert "sense" not in entries and entries["kind"] == "loaded_columns"


def test_advice_without_entries_prints_none() -> None:
    assert advised_entries(Scene(Panel(4, 4), GroundedReadout()), [finding({})]) == ()


def test_texts_in_one_line_read_back_as_such() -> None:
    content = {"a": "1573", "b": "two words", "c": "no", "d": [{"e": 1.5}], "f": 10203.4567}
    assert parse_document(f"{{{in_one_line(content)}}}", "the line").content == content


def test_square_two_point_panels_have_no_order_by_columns() -> None:
    """Exchanged rows and columns are a relabelling there, which would turn the picture."""
    assert BY_COLUMNS not in kinds(Scene(Panel(4, 4), TwoPointReadout()))
    assert BY_COLUMNS in kinds(Scene(Panel(4, 5), TwoPointReadout()))
