"""Recordings of panels with films, loads and electronics of many kinds."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lampest
from lampest import (
    GroundedReadout,
    LoadedColumnsReadout,
    Panel,
    Recording,
    Scene,
    VirtualGroundReadout,
)
from lampest.panel.panel import Array
from lampest.panel.readouts import TwoPointReadout

BITS = {"adc_bits": 12, "readings": 1, "noise_lsb": 1.0}
READOUTS: dict[str, Any] = {
    "two_point": TwoPointReadout(
        supply_volt=3.3, reference_ohm=1000.0, measured_across="reference", **BITS
    ),
    "across the sensor": TwoPointReadout(
        supply_volt=5.0, reference_ohm=1000.0, measured_across="sensor", **BITS
    ),
    "pull_ups": LoadedColumnsReadout(
        supply_volt=5.0, load_ohm=10000.0, drive_ohm=30.0, polarity="down", **BITS
    ),
    "grounded, one": GroundedReadout(
        sense="one", supply_volt=5.0, drive_ohm=50.0, load_ohm=1000.0, **BITS
    ),
    "grounded, all": GroundedReadout(
        sense="all", supply_volt=5.0, drive_ohm=50.0, load_ohm=1000.0, **BITS
    ),
    "amplifiers": VirtualGroundReadout(
        supply_volt=5.0, drive_ohm=70.0, sense_ohm=70.0, feedback_ohm=1000.0, **BITS
    ),
}
LOADS = ("none", "stands", "sways", "moves", "taps", "jumps", "arrives")


@dataclass(frozen=True)
class Plan:
    """Parts of a recording; `cells` are those of the unloaded panel, (rows, columns) ohm."""

    scene: Scene
    cells: Array
    load: str
    unloaded: int
    measured: int
    seed: int

    @classmethod
    def drawn(cls, seed: int, kind: str | None = None) -> "Plan":
        """A plan drawn at random: circuit, panel, film, load, frames."""
        rng = np.random.default_rng(seed)
        name = kind or str(rng.choice(list(READOUTS)))
        rows, columns = rng.integers(6, 17, size=2).tolist()
        readout = READOUTS[name]
        ohm = 3000.0 * float(np.exp(rng.uniform(-0.5, 0.8)))
        readout = replace(
            readout,
            adc_bits=int(rng.choice([10, 12])),
            noise_lsb=float(rng.choice([0.5, 1.0, 2.0])),
        )
        spread = float(rng.choice([0.0, 0.05, 0.15, 0.3]))
        scene = Scene(Panel(rows, columns), readout)
        cells = ohm * np.exp(spread * rng.standard_normal((rows, columns)))
        unloaded = int(rng.integers(3, 9))
        measured = int(rng.integers(6, 20))
        return cls(scene, cells, str(rng.choice(LOADS)), unloaded, measured, seed)

    @property
    def noise_lsb(self) -> float:
        """Noise of a reading, in steps of the converter."""
        readout = self.scene.readout
        assert readout is not None and isinstance(readout.noise_lsb, float)
        return readout.noise_lsb

    def loaded(self) -> Array:
        """Cells of every frame, (frames, rows, columns) ohm."""
        rng = np.random.default_rng([self.seed, 1])
        rows, columns = self.cells.shape
        down, across = np.mgrid[:rows, :columns]
        width = rng.uniform(0.8, 0.35 * min(rows, columns))
        strength = rng.uniform(0.3, 2.3)
        places = rng.uniform(0, 1, size=(4, 2)) * [rows - 1, columns - 1]
        if rng.uniform() < 0.3:  # in the very middle, as mouths of examples are
            places[0] = (rows - 1) / 2, (columns - 1) / 2

        def pressed(place: Array) -> Array:
            distance = np.hypot(down - place[0], across - place[1])
            return np.asarray(-strength / (1 + np.exp((distance - width) / 0.3)))

        frames = []
        for frame in range(self.measured):
            share = frame / max(self.measured - 1, 1)
            amount = 1.0
            place = places[0]
            if self.load == "none" or (self.load == "arrives" and share < 0.4):
                amount = 0.0
            elif self.load == "sways":
                amount = 1 + 0.05 * np.sin(frame)
            elif self.load == "moves":
                place = places[0] + share * (places[1] - places[0])
            elif self.load == "taps":
                amount = float(frame in (self.measured // 2, self.measured - 2))
            elif self.load == "jumps":
                place = places[int(rng.integers(4))]
            frames.append(self.cells * np.exp(amount * pressed(place)))
        return np.concatenate(
            [np.repeat(self.cells[None], self.unloaded, axis=0), np.array(frames)]
        )

    def volts(self, scene: Scene | None = None, cells: Array | None = None) -> Array:
        """Exact voltages, (frames, rows, columns), of this or another scene, and of other cells."""
        actual = scene or self.scene
        circuit = actual.circuit
        exact = circuit.exact_reading(self.loaded() if cells is None else cells, actual.wiring)
        recorded = circuit.to_recorded(exact, actual)
        return np.asarray(self.scene.circuit.volt_from_recorded(recorded))

    def recording(self, volts: Array | None = None, scene: Scene | None = None) -> Recording:
        """The recording, with noise and rounding, of these voltages or of its own."""
        return recorded(scene or self.scene, self.codes(volts), self.unloaded)

    def codes(self, volts: Array | None = None) -> NDArray[np.int64]:
        """Codes of the converter, (frames, rows, columns)."""
        rng = np.random.default_rng([self.seed, 2])
        readout = self.scene.readout
        assert readout is not None
        exact = self.volts() if volts is None else volts
        noisy = exact + self.noise_lsb * readout.lsb_volt * rng.standard_normal(exact.shape)
        return readout.code_from_volt(noisy)


def recorded(
    scene: Scene, codes: NDArray[np.int64], unloaded: int, time: Array | None = None
) -> Recording:
    """A recording of codes (frames, rows, columns)."""
    return lampest.Recording.from_array(
        codes, unit="code", baseline=unloaded, scene=scene, time=time
    )
