"""Wire of rows and columns from cell to cell, in addition to the scene's."""

from dataclasses import replace

from lampest.panel.difference_network import wire_responses
from lampest.panel.effects import SharedEffect
from lampest.panel.lines import MAX_OHM
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.readouts.wiring import Lines, Wiring
from lampest.panel.scene import Scene


class WirePerCell(SharedEffect):
    """An additional wire resistance of all rows, and of all columns."""

    setting = "wire_ohm_per_cell"
    name = "wire"
    limits = (0.0, MAX_OHM)
    prior = 0.2  # copper tape has none, conductive thread and printed silver 0.1 to 1
    is_typical = True
    is_advised = False

    def columns(self, network: Network, measured: Array, scene: Scene, size: float) -> Array:
        """Return the column of the rows' wire, and that of the columns'."""
        return size * wire_responses(network, (scene.wiring or Wiring()).lines)

    def in_scene(self, scene: Scene, ohm: float) -> Scene:
        """Return the scene with more wire from cell to cell, in ohm."""
        lines = scene.lines or Lines()
        more = {
            name: getattr(lines, name) + ohm for name in ("row_ohm_per_cell", "column_ohm_per_cell")
        }
        return replace(scene, lines=replace(lines, **more))


WIRE = WirePerCell()
