"""Converters with a name: their resolution, ranges and noise, by their data sheets.

Codes are those of the chip, in as many bits as it has: a library that prints the 12 bits of an
ADS1015 in the upper part of 16 prints multiples of 16.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

Known = Literal[
    "esp32",
    "avr",
    "RP2040",
    "ADS1015",
    "ADS1115",
    "ADS1118",
    "MCP3008",
    "MCP3208",
    "inverting amplifier",
]


@dataclass(frozen=True, kw_only=True)
class KnownConverter:
    """Numbers of a converter with a name.

    Attributes
    ----------
    adc_bits : int, or None
        Resolution; None: as the scene says.
    zero_volt : float
        Voltage of code 0.
    full_volt : float, or None
        Voltage of code n (`Characteristic`), of several ranges that after power-up; None: the end
        of the range, a supply or a reference.
    ranges : tuple of float
        Voltages of code n between which the chip's register chooses; empty: any.
    signed : bool
        Whether codes run from below zero.
    falls : bool
        Whether codes fall from the end of the range to 0 V.
    noise_lsb : float, or None
        Standard deviation of one reading in LSB; None: not specified.
    """

    adc_bits: int | None = None
    zero_volt: float = 0.0
    full_volt: float | None = None
    ranges: tuple[float, ...] = ()
    signed: bool = False
    falls: bool = False
    noise_lsb: float | None = None


# V: SBAS444E, table "Full-Scale Range and Corresponding LSB Size"; taken for the ADS1015, ADS1118
ADS_RANGES = (6.144, 4.096, 2.048, 1.024, 0.512, 0.256)

KNOWN_CONVERTERS: Mapping[Known, KnownConverter] = MappingProxyType(
    {
        # 11 dB, a straight line through readings that users of the Arduino core report: nothing
        # below 0.14 V, the last code at 3.12 V (Espressif's data sheet specifies 0.15 to 2.45 V).
        # Chips differ by some 6 %.
        "esp32": KnownConverter(zero_volt=0.14, full_volt=3.12),
        # Microchip, ATmega48A/328P data sheet, "ADC Conversion Result": the supply is the
        # reference; typically its zero is off by 2 steps.
        "avr": KnownConverter(),
        # Raspberry Pi, RP2040 data sheet, section 4.9: 12 bits of ADC_AVDD. It states no noise;
        # 0.97 LSB were measured (pico-adc.markomo.me, "Input-Referred Noise").
        "RP2040": KnownConverter(adc_bits=12, noise_lsb=0.97),
        # Ranges are those of the ADS1115, of 12 bits; its own data sheet (SBAS473) was not read.
        "ADS1015": KnownConverter(adc_bits=12, full_volt=2.048, ranges=ADS_RANGES, signed=True),
        # Texas Instruments, SBAS444E (ADS111x), table 6-1: 1 LSB rms at every range and rate. For
        # the ADS1118 by the copy of its table in a driver; its data sheet (SBAS457F) was not read.
        "ADS1115": KnownConverter(
            adc_bits=16, full_volt=2.048, ranges=ADS_RANGES, signed=True, noise_lsb=1.0
        ),
        "ADS1118": KnownConverter(
            adc_bits=16, full_volt=2.048, ranges=ADS_RANGES, signed=True, noise_lsb=1.0
        ),
        # Microchip, DS21295 (MCP3004/3008) and DS21298 (MCP3204/3208): V_REF is the end of the
        # range; no noise is stated.
        "MCP3008": KnownConverter(adc_bits=10),
        "MCP3208": KnownConverter(adc_bits=12),
        # Two equal resistors about half the range, V_out = 2 V_ref − V (Mancini, Op Amps for
        # Everyone, Texas Instruments SLOD006B, 2002, chapter 4).
        "inverting amplifier": KnownConverter(falls=True),
    }
)
