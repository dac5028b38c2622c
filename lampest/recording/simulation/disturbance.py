"""What disturbs readings and no scene tells: ripple, gain, the converter's curve, each reading's own error, wire."""

import numpy as np

from lampest.panel.memory import in_panel_order
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.panel.readouts.wiring import Lines
from lampest.panel.scene import Scene
from lampest.recording.simulation.unmodelled import Unmodelled, random_stream

BENDS = 4  # sines that a converter's curve is made of: half a wave over its range, one wave and so on
FINENESS = 1001  # points at which its largest deviation is looked for


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
    size = random_stream(seed, "inl").standard_normal(BENDS)

    def sines(at: Array) -> Array:
        bends = (weight * np.sin(np.pi * (number + 1) * at) for number, weight in enumerate(size))
        return np.asarray(sum(bends, np.zeros_like(at)))

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
