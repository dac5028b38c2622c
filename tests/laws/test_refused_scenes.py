"""Scenes whose keys contradict each other are refused with the place and one sentence."""

from pathlib import Path

import pytest

from lampest import InputError, read_scene

PULL_DOWNS = "kind: driven, drive_ohm: 95, load_ohm: 1e4, sense_ohm: 70, idle_stays: true"
CIRCUITS = [
    ("kind: driven, load_ohm: .inf", "load_ohm, idle_ohm and idle_load_ohm are all infinite"),
    ("kind: driven, idle_ohm: 0, load_ohm: .inf, idle_load_ohm: 0", "ratios of cells alone"),
    ("kind: two_point, idle_ohm: 0", ":3:28: readout.idle_ohm: "),
    ("kind: grounded, sense: all, idle_ohm: 33", "no such key of this kind; it is a key of kind"),
    (
        "kind: two_point, measured_across: sensor, groups: [[0, 1], [2]]",
        "measured_across must be reference",
    ),
    ("kind: driven, groups: [[0, 1], [1, 2]]", ":3:25: readout.groups overlap: line 1"),
    ("kind: driven, groups: [[0], [1]]", ":3:25: readout.groups: column 2 is left out"),
    ("kind: grounded, groups: [[0, 1], [2, 3]]", "readout.groups: there is no column 3"),
    (
        "kind: driven, driven: columns, groups: [[0, 1], []]",
        ":3:42: readout.groups: every multiplexer has at least one line",
    ),
    (
        "kind: driven, drive_volt: 1, polarity: down",
        "drive_volt and converter_volt have no place",
    ),
    ("kind: driven, idle_volt: 1", "idle_volt has no place where idle driven lines float"),
    (
        "kind: driven, idle_ohm: 100, idle_volt: follows, groups: [[0, 1], [2]]",
        "one sensed line at a time",
    ),
    ("kind: driven, load_volt: 5", "no current flows"),
    ("kind: driven, load_volt: 5000", "within 1000 V"),
    ("kind: driven, driven_groups: [[0, 1], [1, 2]]", "driven_groups overlap: line 1"),
    ("kind: driven, driven_groups: [[0, 1], [2, 3]], idle_ohm: 100", "idle_ohm has no place"),
    ("kind: loaded_columns, driven_groups: [[0, 1], [2]]", "driven_groups: row 3 is left out"),
    (
        "kind: driven, idle_load_ohm: .inf, idle_load_volt: 1",
        "idle sensed lines keep their load or float",
    ),
    ("kind: virtual_ground, load_volt: 2.5", "currents of both signs"),
    (
        "kind: driven, idle_ohm: 1000, idle_volt: 1, load_volt: 2, diode: {}",
        "diode: circuits with several potentials",
    ),
    (
        "kind: driven, drive_ohm: 100, driven_groups: [[0, 1], [2, 3]], diode: {}",
        "diode: circuits with driven_groups",
    ),
    (
        "kind: loaded_columns, driven_groups: [[0, 1], [2, 3]], diode: {}",
        "diode: circuits with driven_groups",
    ),
    (
        "kind: driven, drive_ohm: 50, read_at: far_end, load_volt: 2, idle_ohm: 1000",
        "read_at: circuits with several potentials",
    ),
    ("kind: driven, drive_ohm: 50, read_at: far", "read_at"),
    (f"{PULL_DOWNS}, idle_ohm: .inf", "names no resistor that could stay"),
    (f"{PULL_DOWNS}, idle_ohm: 0", "a line that 0 ohm hold cannot be driven"),
    (
        f"{PULL_DOWNS}, idle_ohm: 1e4, idle_volt: follows, idle_load_ohm: .inf",
        "no place with idle_volt: follows",
    ),
    (f"{PULL_DOWNS}, idle_ohm: 1e4, diode: {{}}", "a diode beside resistors that stay"),
    ("kind: driven, idle_ohm: 1e4, driven_groups: [[0], [1]]", "idle_stays: true"),
    (
        "kind: driven, driven_groups: [[null], [0, 1, 2, 3]]",
        "every multiplexer has at least one line",
    ),
    ("kind: driven, offset_volt: 2", "offset_volt must lie within 0.1 V of zero"),
    (
        "kind: driven, load_ohm: [.inf, 1e4, .inf], idle_load_ohm: .inf",
        "readout.load_ohm: while row 0 is driven and column 0 is read no other line",
    ),
    (
        "kind: driven, driven: columns, load_ohm: [.inf, 1e4, .inf, 1e4], idle_load_ohm: .inf",
        "readout.load_ohm: while column 0 is driven and row 0 is read no other line",
    ),
    ("kind: grounded, scan_order: [[0, 0]]", "scan_order: [0, 1] is left out"),
    ("kind: grounded, scan_order: [[0, 0], [0, 0]]", "scan_order: [0, 0] is listed twice"),
    ("kind: grounded, scan_order: [[9, 0]]", "scan_order: there is no reading [9, 0]"),
]
CONVERTERS = [
    ("ADS1113", "readout.converter: must be a mapping or 'esp32', 'avr', 'RP2040'"),
    ("{name: ADS115}", "not 'ADS115'; did you mean ADS1115"),
    ("{name: ADS1115, full_volt: 5}", "readout.converter.full_volt: ADS1115 has the"),
    ("{name: ADS1115, signed: true}", "ADS1115 states zero_volt, curve and signed"),
    ("MCP3208, adc_bits: 10", "readout.adc_bits: 10 contradicts the converter MCP3208"),
    ("{zero_volt: 1, full_volt: 1}", "must differ"),
    ("{zero_volt: 5000}", "within 1000 V"),
    ("{full_volt: estimated}", "no frame shows it"),
    ("{curve: [[0, 0]]}", "two or more points"),
    ("{curve: [[0, 0], [1, 5], [2, 4]]}", "rise or fall throughout"),
    ("{curve: [[0, 0], [1, 5]], full_volt: 3}", "takes the place"),
]
LEAKS = [
    ("{rows: [6000, 5000]}", ":3:12: leak_ohm.rows lists 2 numbers, but 4 rows have 3 gaps"),
    ("{rows: -1}", ":3:1: leak_ohm.rows must be positive and finite"),
    ("{}", ":3:1: leak_ohm names no leak: give rows, columns or both"),
    ("5", ":3:1: leak_ohm: must be a mapping, not 5"),
]
REFUSED = [
    *((f"readout: {{{keys}}}", sentence) for keys, sentence in CIRCUITS),
    *((f"readout: {{kind: grounded, converter: {keys}}}", words) for keys, words in CONVERTERS),
    *((f"leak_ohm: {leaks}", sentence) for leaks, sentence in LEAKS),
]


def refusal(path: Path, text: str) -> str:
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as refused:
        read_scene(path)
    return str(refused.value).removeprefix(str(path))


@pytest.mark.parametrize(("line", "sentence"), REFUSED)
def test_contradictory_keys_are_refused_at_their_place(
    line: str, sentence: str, tmp_path: Path
) -> None:
    said = refusal(tmp_path / "s.yaml", f"# a scene\npanel: {{rows: 4, columns: 3}}\n{line}\n")
    assert sentence in said
    assert said.startswith(":")


def test_a_leak_of_a_single_line_is_refused(tmp_path: Path) -> None:
    text = "panel: {rows: 1, columns: 4}\nleak_ohm: {rows: 6000}\n"
    assert "leak_ohm.rows: a single line has no neighbour" in refusal(tmp_path / "s.yaml", text)
