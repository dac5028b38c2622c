"""The ground that idle driven lines share: one pin, lead or thread takes all their currents."""

from collections.abc import Iterator

import numpy as np

from lampest.panel.circuit import nominal_terminations
from lampest.panel.effects.line_effect import LineEffect
from lampest.panel.kirchhoff import laplacian
from lampest.panel.lines import MAX_OHM, MIN_OHM
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.scene import Scene

TO_GROUND = 1e-12  # siemens: lines that end nowhere have potentials, and no current flows


class SharedGround(LineEffect):
    """Resistance in ohm between the end that idle driven lines share and its potential.

    Circuits whose idle driven lines float have none. It is not in the model of those with a diode,
    with lines that follow a reading, or with wire, contacts or leaks of lines.
    """

    key = "ground_ohm"
    # A foot of conductive thread as common return (2 ply of stainless steel, Adafruit: 16 ohm).
    prior = 16.0
    unit = "ohm"
    limits = (0.0, MAX_OHM)
    positive = True
    may_begin = False

    @classmethod
    def places(cls, rows: int, columns: int) -> Iterator[tuple[int, ...]]:
        yield ()

    def sentence(self, rows: int) -> str:
        return f"a ground of {self.size:.2g} ohm that idle driven lines share"

    def added(self, scene: Scene, network: Network) -> Array:
        return np.zeros(network.conductance.shape) + self._change(scene, network)[0]

    def added_sensitivity(self, scene: Scene, network: Network) -> Array | float:
        return self._change(scene, network)[1]

    def _change(self, scene: Scene, network: Network) -> tuple[Array | float, Array | float]:
        """Return the changes of the readings and of their derivatives; 0 where none is modelled."""
        ends = nominal_terminations(scene.circuit)
        unlike = scene.circuit.unit == "ohm" or ends.diode is not None or ends.driving.follows
        shared = ends.driving.connected(own=False).size > 0
        if not shared or unlike or scene.wiring is not None:
            return 0.0, 0.0
        reading, slope = _grounded(scene, network, self.size + MIN_OHM)
        without, slope_without = _grounded(scene, network, MIN_OHM)
        return reading - without, slope - slope_without


def _grounded(scene: Scene, network: Network, ohm: float) -> tuple[Array, Array]:
    """Return readings with a ground of `ohm`, up to a constant, and their derivatives by log r.

    The ground is one more node, which is eliminated: with y the conductances from idle lines to it,
    the ends have the admittance diag(1/R) − y yᵀ/(Σ y + 1/ohm). With A that of the lines, V their
    potentials, and a, v the differences of A⁻¹e_k and of V across cell c, ∂V_k/∂g_c = −a_c v_c.

    Returns
    -------
    reading : array, shape (rows, columns)
    sensitivity : array, shape (readings, cells)
    """
    circuit = scene.circuit
    by_rows = nominal_terminations(circuit).driven == "rows"
    conductance = network.conductance if by_rows else network.conductance.T
    driven, sensed = conductance.shape
    ends = circuit.terminations(driven, sensed)
    of_driven = np.stack([ends.driving.ohm, ends.driving.volt])
    is_idle = np.pad(~np.eye(driven, dtype=bool), ((0, 0), (0, sensed)))
    reading = np.zeros((driven, sensed))
    sensitivity = np.zeros((driven, sensed, driven, sensed))
    states = np.stack([ends.sensing.ohm, ends.sensing.volt], axis=1)
    states, state_of = np.unique(states, axis=0, return_inverse=True)
    for number, state in enumerate(states):
        of_sensed = np.broadcast_to(state[:, None], (2, driven, sensed))
        end_ohm, volt = np.concatenate([of_driven, of_sensed], axis=2)
        siemens = 1 / np.maximum(end_ohm, MIN_OHM)
        idle = np.where(is_idle, siemens, 0.0)
        total = idle.sum(axis=1) + 1 / ohm
        admittance = idle[:, :, None] * idle[:, None] / -total[:, None, None]
        diagonal = np.einsum("aii->ai", admittance)
        diagonal += siemens
        current = admittance @ volt[:, :, None]
        diagonal += TO_GROUND
        impedance = np.linalg.inv(admittance + laplacian(conductance))
        potentials = (impedance @ current)[:, :, 0]
        read = state_of.ravel() == number
        reading[:, read] = potentials[:, driven:][:, read]
        adjoint = impedance[:, driven:][:, read]
        across = adjoint[:, :, :driven, None] - adjoint[:, :, None, driven:]
        drop = potentials[:, :driven, None] - potentials[:, None, driven:]
        sensitivity[:, read] = across * (conductance * drop)[:, None]
    gain = nominal_terminations(circuit).sign * ends.gain
    reading *= gain
    sensitivity *= gain[:, None, None]
    if not by_rows:
        reading, sensitivity = reading.T, sensitivity.transpose(1, 0, 3, 2)
    return reading, sensitivity.reshape(reading.size, -1)
