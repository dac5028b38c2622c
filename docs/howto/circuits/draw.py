"""The drawings of docs/howto/readouts.md, one for each circuit.

Run it with: python docs/howto/circuits/draw.py.
"""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle

STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "lampest",
    "font.family": "sans-serif",
    "font.size": 9,
}
LIVE = "#c0392b"
IDLE = "#444444"
LINES = 3
# of the panel; row j lies at y = TOP - j, column k at x = k
TOP = 2.0
RIGHT = 2.0
# half a resistor's width, and half its length
BOX = 0.11
REACH = 0.26


class Drawing:
    """A panel of three by three cells whose row 0 and column 0 are the ones that are read."""

    def __init__(self, height: float = 5.2) -> None:
        self.figure = Figure(figsize=(5.2, height * 0.85))
        self.axes: Axes = self.figure.add_axes((0, 0, 1, 1))
        self.axes.set(xlim=(-3.3, 3.4), ylim=(TOP - height + 0.75, TOP + 0.75), aspect="equal")
        self.axes.axis("off")
        for line in range(LINES):
            colour = LIVE if line == 0 else IDLE
            self.wire([(-0.9, TOP - line), (RIGHT + 0.4, TOP - line)], colour)
            self.wire([(line, TOP + 0.4), (line, -0.6)], colour)
        for row in range(LINES):
            for column in range(LINES):
                self.cell(column, TOP - row)

    def wire(self, points: list[tuple[float, float]], colour: str = IDLE) -> None:
        self.axes.plot(
            *zip(*points, strict=True), color=colour, lw=1.2, solid_capstyle="round", zorder=1
        )

    def text(self, x: float, y: float, words: str, **options: Any) -> None:
        self.axes.text(x, y, words, **({"ha": "center", "va": "center"} | options))

    def cell(self, x: float, y: float) -> None:
        """A cell joins its lines where they cross, beside the crossing."""
        self.wire([(x, y - 0.42), (x + 0.42, y)], IDLE)
        along = np.array([1, 1]) / np.sqrt(2)
        across = np.array([1, -1]) / np.sqrt(2)
        centre = np.array([x + 0.21, y - 0.21])
        corners = [
            centre + a * 0.15 * along + b * 0.065 * across
            for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))
        ]
        self.axes.add_patch(Polygon(corners, fc="white", ec=IDLE, lw=1, zorder=2))

    def resistor(
        self, x: float, y: float, name: str, upright: bool = False, colour: str = IDLE
    ) -> None:
        width, height = (BOX, REACH) if upright else (REACH, BOX)
        box = Rectangle(
            (x - width, y - height), 2 * width, 2 * height, fc="white", ec=colour, lw=1.2, zorder=2
        )
        self.axes.add_patch(box)
        if upright:
            self.text(x + 0.18, y, name, ha="left")
        else:
            self.text(x, y + 0.25, name)

    def diode(self, x: float, y: float, colour: str) -> None:
        shape = [(x - 0.13, y + 0.14), (x - 0.13, y - 0.14), (x + 0.13, y)]
        self.axes.add_patch(Polygon(shape, fc="white", ec=colour, lw=1.2, zorder=2))
        self.wire([(x + 0.13, y + 0.14), (x + 0.13, y - 0.14)], colour)

    def ground(self, x: float, y: float, sideways: bool = False) -> None:
        for step, half in enumerate((0.17, 0.11, 0.05)):
            near = (-0.07 if sideways else 0.07) * step
            ends = (
                [(x + near, y - half), (x + near, y + half)]
                if sideways
                else [(x - half, y - near), (x + half, y - near)]
            )
            self.wire(ends)

    def open_end(self, x: float, y: float) -> None:
        self.axes.add_patch(Circle((x, y), 0.06, fc="white", ec=IDLE, lw=1.2, zorder=3))

    def converter(self, x: float, y: float, colour: str = IDLE) -> None:
        """A tap to the right of a node."""
        self.wire([(x, y), (x + 0.22, y)], colour)
        self.axes.add_patch(Circle((x, y), 0.04, fc=colour, ec=colour, zorder=3))
        self.text(x + 0.27, y, "ADC", ha="left", color=colour)

    def drive(self, line: int, to: str, name: str = "drive", diode: bool = False) -> None:
        """A driven line's way to its source: 'Vcc', 'ground' or 'nothing'."""
        y = TOP - line
        colour = LIVE if line == 0 else IDLE
        if to == "nothing":
            self.open_end(-0.96, y)
            self.text(-1.1, y, "floating", ha="right", color=IDLE)
            return
        self.wire([(-2.4, y), (-0.9, y)], colour)
        self.resistor(-1.75, y, name, colour=colour)
        if diode:
            self.diode(-1.15, y, colour)
        if to == "ground":
            self.ground(-2.4, y, sideways=True)
        else:
            self.text(-2.5, y, to, ha="right", color=colour)

    def load(
        self, column: int, start: float = -0.6, to: str = "ground", name: str = "load"
    ) -> None:
        """A sensed line's load, below it, and the converter's tap above the load."""
        colour = LIVE if column == 0 else IDLE
        self.wire([(column, start), (column, start - 1.1)], colour)
        self.resistor(column, start - 0.65, name, upright=True, colour=colour)
        self.converter(column, start - 0.15, colour)
        if to == "ground":
            self.ground(column, start - 1.1)
        else:
            self.text(column, start - 1.25, to, color=colour)

    def float_column(self, column: int) -> None:
        self.open_end(column, -0.66)
        self.text(column, -0.9, "floating")

    def channel(self, column: int, name: str) -> None:
        colour = LIVE if column == 0 else IDLE
        self.wire([(column, -0.6), (column, -1.7)], colour)
        self.resistor(column, -1.3, name, upright=True, colour=colour)

    def save(self, name: str) -> None:
        with mpl.rc_context(STYLE):
            self.figure.savefig(Path(__file__).parent / f"{name}.svg", metadata={"Date": None})


def two_point() -> Drawing:
    drawing = Drawing(6.2)
    drawing.drive(0, "Vcc", "channel")
    for line in (1, 2):
        drawing.drive(line, "nothing")
        drawing.float_column(line)
    drawing.channel(0, "channel")
    drawing.load(0, -1.7, name="reference")
    return drawing


def loaded_columns(diode: bool = False) -> Drawing:
    drawing = Drawing()
    drawing.drive(0, "Vcc", diode=diode)
    for line in range(LINES):
        if line:
            drawing.drive(line, "nothing")
        drawing.load(line)
    return drawing


def pull_ups() -> Drawing:
    drawing = Drawing()
    drawing.drive(0, "ground")
    for line in range(LINES):
        if line:
            drawing.drive(line, "nothing")
        drawing.load(line, to="Vcc")
    return drawing


def parallel_mux() -> Drawing:
    drawing = Drawing(6.2)
    drawing.drive(0, "Vcc", "channel")
    for line in (1, 2):
        drawing.drive(line, "nothing")
    drawing.float_column(1)
    for column in (0, 2):
        drawing.channel(column, "channel")
        drawing.load(column, -1.7, name="reference")
    return drawing


def pull_downs() -> Drawing:
    drawing = Drawing()
    for line in range(LINES):
        drawing.drive(line, "ground" if line else "Vcc", "pull-down" if line else "drive")
        drawing.load(line)
    return drawing


def grounded_all() -> Drawing:
    drawing = Drawing()
    for line in range(LINES):
        drawing.drive(line, "ground" if line else "Vcc")
        drawing.load(line)
    return drawing


def grounded_one() -> Drawing:
    drawing = Drawing(6.2)
    for line in range(LINES):
        drawing.drive(line, "ground" if line else "Vcc")
        if line:
            drawing.float_column(line)
    drawing.channel(0, "sense")
    drawing.load(0, -1.7)
    return drawing


def virtual_ground() -> Drawing:
    drawing = Drawing(6.7)
    for line in range(LINES):
        drawing.drive(line, "ground" if line else "Vcc")
        drawing.channel(line, "sense")
        if line:
            drawing.ground(line, -1.7)
    drawing.wire([(0, -1.7), (0, -2.5), (-0.35, -2.5)], LIVE)
    amplifier = [(-0.35, -2.3), (-0.35, -3.1), (-1.15, -2.7)]
    drawing.axes.add_patch(Polygon(amplifier, fc="white", ec=LIVE, lw=1.2, zorder=2))
    drawing.text(-0.46, -2.5, "−")
    drawing.text(-0.46, -2.9, "+")
    drawing.wire([(-0.35, -2.9), (0.1, -2.9), (0.1, -3.15)])
    drawing.ground(0.1, -3.15)
    drawing.wire([(0, -1.95), (-1.4, -1.95), (-1.4, -2.7), (-1.15, -2.7)], LIVE)
    drawing.resistor(-0.75, -1.95, "feedback", colour=LIVE)
    drawing.wire([(-1.4, -2.7), (-1.75, -2.7)], LIVE)
    drawing.text(-1.8, -2.7, "ADC", ha="right", color=LIVE)
    drawing.text(2.75, -1.7, "(virtual)\nground", fontsize="small")
    return drawing


def mid_supply() -> Drawing:
    drawing = Drawing()
    drawing.drive(0, "Vcc")
    for line in range(LINES):
        if line:
            drawing.drive(line, "nothing")
        drawing.load(line, to="Vcc/2")
    return drawing


def feedback() -> Drawing:
    drawing = Drawing(6.2)
    for line in range(LINES):
        drawing.drive(line, "follower" if line else "Vcc")
        if line:
            drawing.float_column(line)
    drawing.channel(0, "sense")
    drawing.load(0, -1.7)
    follower = [(-0.5, -2.1), (-0.5, -1.6), (-1.0, -1.85)]
    drawing.axes.add_patch(Polygon(follower, fc="white", ec=LIVE, lw=1.2, zorder=2))
    drawing.wire([(0, -1.85), (-0.5, -1.85)], LIVE)
    drawing.wire([(-1.0, -1.85), (-1.4, -1.85)], LIVE)
    drawing.text(-1.45, -1.85, "to idle rows", ha="right")
    return drawing


def driven_mux() -> Drawing:
    drawing = Drawing()
    drawing.drive(0, "Vcc", "channel")
    drawing.drive(1, "nothing")
    drawing.drive(2, "ground", "channel")
    for line in range(LINES):
        drawing.load(line)
    drawing.text(-3.2, 0.55, "common pin of another 4051: OUTPUT LOW", ha="left", fontsize="small")
    return drawing


def bare_inputs() -> Drawing:
    drawing = Drawing(4.2)
    for line in range(LINES):
        drawing.drive(line, "ground" if line else "Vcc", "pin")
        drawing.converter(line, -0.6, LIVE if line == 0 else IDLE)
    return drawing


CIRCUITS = (
    two_point,
    parallel_mux,
    loaded_columns,
    pull_ups,
    pull_downs,
    grounded_all,
    grounded_one,
    virtual_ground,
    mid_supply,
    feedback,
    driven_mux,
    bare_inputs,
)

if __name__ == "__main__":
    with mpl.rc_context(STYLE):
        drawings = {circuit.__name__: circuit() for circuit in CIRCUITS} | {
            "loaded_columns_diode": loaded_columns(diode=True)
        }
    for name, drawing in drawings.items():
        drawing.save(name)
