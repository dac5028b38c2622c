"""Effects that no scene names, and the random numbers, one stream for each effect."""

import dataclasses
import zlib
from dataclasses import dataclass
from math import isfinite
from typing import Any, ClassVar

import numpy as np

from lampest.files.typed import Validated
from lampest.panel.memory import in_panel_order
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.panel.readouts.wiring import Lines
from lampest.panel.scene import Scene

SINES = 4  # sines that a converter's curve is made of: half a wave over its range, one wave and so on
FINENESS = 1001  # points at which its largest deviation is looked for


@dataclass(frozen=True)
class Unmodelled(Validated):
    """Effects that enter the data but not the recording's scene. Zero or None: absent.

    Parameters
    ----------
    series_resistance_ohm : series resistance that the scene is silent about, on top of the one it names.
    channel_spread_ohm : standard deviation of the on-resistance of a multiplexer's channels, one for each line.
    reference_tolerance : the reference resistor is off by up to this fraction, drawn uniformly.
    drift_per_minute : standard deviation of the rate at which the logarithm of a cell's resistance drifts, per minute.
    outlier_probability : chance that one reading is a random code instead of a conversion.
    noise_factor : the noise of one reading is so many times what the scene says.
    supply_ripple_lsb, supply_ripple_hz : amplitude and frequency of a sine on what the converter sees, its phase drawn
        for every frame; a scan takes the whole frame period, channel by channel. Without a frequency one period is as
        long as the scan of a line.
    gain_spread : standard deviation of a frame's gain, drawn for every frame: all its voltages by one factor.
    load_speed_mm_s : loads travel along x by TRAVEL_MM to and fro at this speed, also while the lines are scanned one
        after the other; the truth is that of the middle of the scan.
    inl_lsb : the largest deviation of the converter's curve from a straight line, smooth, in least significant bits.
    wire_ohm_per_cell : resistance of rows and columns from cell to cell, on top of what the scene says, in ohm.
    reading_error : standard deviation of the logarithm of a factor on each recorded reading, the same in all frames.
    response_loss : a film answers by this fraction less, in the logarithm of its resistance.
    response_spread : standard deviation of the logarithm of a factor on each cell's answer, likewise in the logarithm.

    Raises ValueError where a number is out of range.

    >>> lampest.Unmodelled(channel_spread_ohm=3.0).channel_spread_ohm
    3.0
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    series_resistance_ohm: float = 0.0
    channel_spread_ohm: float = 0.0
    reference_tolerance: float = 0.0
    drift_per_minute: float = 0.0
    outlier_probability: float = 0.0
    noise_factor: float | None = None
    supply_ripple_lsb: float | None = None
    supply_ripple_hz: float | None = None
    gain_spread: float | None = None
    load_speed_mm_s: float | None = None
    inl_lsb: float | None = None
    wire_ohm_per_cell: float | None = None
    reading_error: float | None = None
    response_loss: float | None = None
    response_spread: float | None = None

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if value is not None and not (isfinite(value) and value >= 0):
                raise ValueError(f"{field.name} must be zero or positive, and finite")
        if self.reference_tolerance >= 1:
            raise ValueError("reference_tolerance must be below 1")
        if self.outlier_probability > 1:
            raise ValueError("outlier_probability must not exceed 1")
        if self.response_loss is not None and self.response_loss >= 1:
            raise ValueError("response_loss must be below 1")

    @property
    def disturbs(self) -> bool:
        """Whether anything is added to what the converter sees."""
        return bool(self.supply_ripple_lsb or self.gain_spread or self.inl_lsb)

    @property
    def needs_converter(self) -> tuple[str, ...]:
        """Effects that are present and act on a converter."""
        names = ("reference_tolerance", "outlier_probability", "supply_ripple_lsb", "gain_spread", "inl_lsb")
        noisier = () if self.noise_factor is None else ("noise_factor",)
        return (*(name for name in names if getattr(self, name)), *noisier)


def random_stream(seed: int, purpose: str) -> np.random.Generator:
    """The random numbers for one purpose: those of other purposes stay the same whether or not these are drawn."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(zlib.crc32(purpose.encode()),)))


def disturbed(readout: Readout, volt: Array, unmodelled: Unmodelled, seed: int, period_s: float) -> Array:
    """V·(1 + gain) + ripple + INL(V), (frames, rows, columns) volt at the converter; period_s : between frames."""
    if unmodelled.gain_spread:
        gain = unmodelled.gain_spread * random_stream(seed, "gain").standard_normal(len(volt))
        volt = volt * (1 + gain[:, None, None])
    if unmodelled.supply_ripple_lsb:
        lines = volt.shape[2 if readout.by_columns else 1]
        hertz = lines / period_s if unmodelled.supply_ripple_hz is None else unmodelled.supply_ripple_hz
        wave = ripple(readout, volt.shape, hertz * period_s, seed)
        volt = volt + unmodelled.supply_ripple_lsb * readout.lsb_volt * wave
    if unmodelled.inl_lsb:
        volt = volt + unmodelled.inl_lsb * readout.lsb_volt * curve(volt / readout.supply_volt, seed)
    return volt


def ripple(readout: Readout, shape: tuple[int, ...], periods: float, seed: int) -> Array:
    """sin(2πt + φ), (frames, rows, columns): t in periods, so many in a scan, φ that of the frame."""
    channels = shape[1] * shape[2]
    time = (np.arange(channels) + 0.5) / channels * periods
    phase = random_stream(seed, "ripple").uniform(0, 2 * np.pi, shape[0])
    return in_panel_order(readout, np.sin(2 * np.pi * time + phase[:, None]), shape)


def curve(share: Array, seed: int) -> Array:
    """A converter's deviation from a straight line at a share of its range: a few sines, 1 at most, 0 at both ends."""
    size = random_stream(seed, "inl").standard_normal(SINES)

    def sines(at: Array) -> Array:
        waves = (weight * np.sin(np.pi * (number + 1) * at) for number, weight in enumerate(size))
        return np.asarray(sum(waves, np.zeros_like(at)))

    return np.asarray(sines(share) / np.abs(sines(np.linspace(0, 1, FINENESS))).max())


def static_factors(error: float, shape: tuple[int, int], seed: int) -> Array:
    """e^(error·z) on every recorded reading (rows, columns), the same in all frames."""
    normal = random_stream(seed, "readings").standard_normal(shape)
    return np.asarray(np.exp(error * normal))


def with_wire(scene: Scene, ohm_per_cell: float) -> Lines:
    """The scene's lines with so much more from cell to cell."""
    lines = scene.lines or Lines()
    return Lines(
        lines.row_ohm_per_cell + ohm_per_cell,
        lines.column_ohm_per_cell + ohm_per_cell,
        lines.rows_enter,
        lines.columns_leave,
    )
