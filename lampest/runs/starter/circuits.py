"""The circuits that `lampest init --readout` knows: a sketch of the wiring, and the scene's lines."""

from dataclasses import dataclass


@dataclass(frozen=True)
class StarterCircuit:
    """word : as users call it. kind : of the readout. sketch : lines that show the wiring. readout : YAML lines.

    software : the firmware's wiring, or what the user's own program does. page : where the circuit is explained.
    """

    word: str
    kind: str
    sketch: str
    readout: str
    software: str
    page: str


CIRCUITS = (
    StarterCircuit(
        "two_mux",
        "two_point",
        """\
supply ── multiplexer ── one row ──[cell]── one column ── multiplexer ──┬── converter
(all other lines are open)                                              └── reference resistor ── ground""",
        """\
  kind: two_point         # one row against one column, all other lines open
  supply_volt: 5
  reference_ohm: 1000     # the divider's resistor
  measured_across: reference   # or: sensor
  adc_bits: 10
  readings: 20            # of which a frame's reading is the mean
  noise_lsb: 0.7          # standard deviation of one reading in converter steps; without it the frames tell
series_resistance_ohm: 140     # two multiplexer channels; measure yours with: lampest calibrate
""",
        "firmware/lampest_board as it is (LAMPEST_TWO_POINT)",
        "two-point",
    ),
    StarterCircuit(
        "pull_ups",
        "loaded_columns",
        """\
one row at LOW ──[cell]── every column ──┬── converter
(idle rows are INPUT: open)              └── pull-up of that column ── supply""",
        """\
  kind: loaded_columns
  driven: rows
  polarity: down          # LOW on the driven row, pull-ups on the columns; up: HIGH, and resistors to ground
  supply_volt: 5
  load_ohm: 35000         # the pull-ups, one number or one for each column; internal ones: 20 to 50 kohm
  drive_ohm: 30           # a pin at LOW
  adc_bits: 10
  readings: 1             # of which a frame's reading is the mean
  noise_lsb: 1            # standard deviation of one reading in converter steps
""",
        "your own sketch, or firmware/lampest_board with resistors to ground (LAMPEST_LOADED_COLUMNS, polarity: up)",
        "pull-ups",
    ),
    StarterCircuit(
        "grounded",
        "grounded",
        """\
one row at the supply ──[cell]── every column ──┬── converter
(all idle rows at ground)                       └── load resistor of that column ── ground""",
        """\
  kind: grounded
  sense: all              # every column has its load; one: a multiplexer brings one load to one column
  driven: rows
  supply_volt: 5
  drive_ohm: 50           # a pin, or a shift register's output
  load_ohm: 1000
  adc_bits: 10
  readings: 1
  noise_lsb: 1
""",
        "your own sketch: digitalWrite(row, LOW) on idle rows, which stay outputs",
        "grounded-drives-all-lines-loaded",
    ),
    StarterCircuit(
        "amplifiers",
        "virtual_ground",
        """\
one row at the supply ──[cell]── every column ──┬── amplifier that holds it at ground ── converter
(all idle rows at ground)                       └── feedback resistor to the amplifier's output""",
        """\
  kind: virtual_ground
  driven: rows
  supply_volt: 5
  drive_ohm: 70           # a pin or a channel before a row
  sense_ohm: 70           # a channel between a column and its amplifier; 0 without
  feedback_ohm: 1000
  adc_bits: 10
  readings: 1
  noise_lsb: 1
""",
        "your own sketch: digitalWrite(row, LOW) on idle rows, which stay outputs",
        "virtual-ground",
    ),
)
