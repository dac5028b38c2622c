"""Responses of readings to the wire and the contacts of a panel's lines."""

from collections.abc import Sequence

import numpy as np

from lampest.panel.difference_network import DifferenceNetwork
from lampest.panel.equation import equation_of
from lampest.panel.network import Network, SolvedNetwork
from lampest.panel.panel import Array
from lampest.panel.readouts.ladder import incidence
from lampest.panel.readouts.wiring import Lines


def contact_responses(networks: Sequence[Network]) -> Array:
    """Return ∂y/∂c of wired networks, one after the other, (networks · cells, lines)."""

    def of_one(solved: SolvedNetwork) -> Array:
        assert isinstance(solved, DifferenceNetwork)
        # ∂Z_ab/∂c_l = I_la I_lb, I_la the current that enters line l while line a is excited
        changes = (solved.entries(np.outer(line, line)) for line in solved.terminal_currents)
        return np.stack([solved.read_change(change) for change in changes], axis=-1)

    maps = (network.response_of(of_one) for network in networks)
    return np.concatenate([part.reshape(-1, part.shape[-1]) for part in maps])


def wire_responses(network: Network, lines: Lines) -> Array:
    """Return ∂y/∂ρ for the wire ρ per cell of all rows, and of all columns, (2, …, rows, columns).

    ∂Z_ab/∂ρ = Σ I_a I_b over all segments of the wire. I_a is the current through a segment for the
    excitation of line a, which is the sum of the currents through all cells beyond the segment.
    """

    def of_one(solved: SolvedNetwork) -> Array:
        # Currents through the cells, g·D, then cumulated from the far end to each segment.
        currents = solved.potential_differences * solved.flat_conductance[..., None, :]
        rows, columns = solved.conductance.shape[-2:]
        maps = currents.reshape(*currents.shape[:-1], rows, columns)
        circuit = solved.circuit
        far = np.zeros(rows + columns, dtype=bool)
        if circuit is not None:
            far = equation_of(circuit, rows, columns).read_at_far_end
        responses = []
        for axis, near, of_side in (
            (-1, lines.rows_enter == "left", slice(rows)),
            (-2, lines.columns_leave == "top", slice(rows, None)),
        ):
            from_far_end = np.flip(maps, axis) if near else maps
            beyond = np.cumsum(from_far_end, axis).reshape(currents.shape)
            if far[of_side].any():
                # A line that is read at its far end carries the current of its excitation, too.
                along = incidence(rows, columns).reshape(-1, rows + columns).T
                beyond[..., of_side, :] -= along[of_side]
            responses.append(solved.read_change(solved.entries(beyond @ beyond.swapaxes(-1, -2))))
        return np.stack(responses, axis=-1)

    return np.moveaxis(network.response_of(of_one), -1, 0)
