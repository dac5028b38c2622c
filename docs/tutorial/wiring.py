"""The wiring of the tutorial.

Run it with: python docs/tutorial/wiring.py. Pins are those of firmware/lampest_board/pins.h.
"""

from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, Rectangle

STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "lampest",
    "font.family": "sans-serif",
    "font.size": 9,
}
POWER = "#c0392b"
GROUND = "#222222"
SIGNAL = "#1f6fb2"
LINE = "#888888"
LINES = 8


def box(axes: Axes, corner: tuple[float, float], size: tuple[float, float], name: str) -> None:
    """A part with its name on top."""
    axes.add_patch(
        FancyBboxPatch(corner, *size, boxstyle="round,pad=0.02", fc="#f4f4f4", ec="#444444", lw=1.2)
    )
    axes.text(
        corner[0] + size[0] / 2,
        corner[1] + size[1] + 0.12,
        name,
        ha="center",
        va="bottom",
        weight="bold",
    )


def wire(axes: Axes, colour: str, *points: tuple[float, float]) -> None:
    """A line through points."""
    axes.plot(*zip(*points, strict=True), color=colour, lw=1.4, solid_capstyle="round", zorder=3)


def pin(axes: Axes, place: tuple[float, float], name: str, side: str) -> None:
    """A pin's name inside its part, at the side named."""
    shift = 0.08 if side == "left" else -0.08
    axes.text(place[0] + shift, place[1], name, ha=side, va="center", fontsize=7.5)


def panel(axes: Axes) -> None:
    """Rows to the left, columns to the bottom, a cell on every crossing."""
    box(axes, (8.1, 3.0), (3.8, 3.6), "panel")
    for line in range(LINES):
        y = 6.3 - 0.43 * line
        x = 8.4 + 0.43 * line
        wire(axes, LINE, (7.2, y), (11.7, y))
        wire(axes, LINE, (x, 2.2), (x, 6.4))
        for crossed in range(LINES):
            axes.add_patch(
                Rectangle(
                    (8.4 + 0.43 * crossed - 0.09, y - 0.09), 0.18, 0.18, fc="#555555", zorder=4
                )
            )
    axes.text(7.25, 6.42, "rows", ha="left", va="bottom", fontsize=8)
    axes.text(11.55, 2.6, "columns", ha="left", va="center", fontsize=8)


def multiplexers(axes: Axes) -> None:
    """The one of the rows beside the panel, that of the columns below it."""
    box(axes, (5.6, 3.0), (1.6, 3.6), "CD74HC4067, rows")
    box(axes, (8.1, 0.6), (3.8, 1.6), "")
    axes.text(10.0, 0.82, "CD74HC4067, columns", ha="center", va="bottom", weight="bold")
    pin(axes, (7.2, 6.3), "C0", "right")
    pin(axes, (7.2, 3.29), "C7", "right")
    axes.text(8.4, 2.1, "C0", ha="center", va="top", fontsize=7.5)
    axes.text(11.41, 2.1, "C7", ha="center", va="top", fontsize=7.5)


def board(axes: Axes) -> None:
    """The Mega, its supply, ground, selecting pins and the analog input.

    The analog input is drawn with the reference resistor.
    """
    box(axes, (0.6, 0.6), (2.2, 6.0), "Arduino Mega 2560")
    for y, name in ((6.2, "5V"), (5.2, "D22–D25"), (1.75, "D26–D29"), (1.25, "A0"), (0.85, "GND")):
        pin(axes, (2.8, y), name, "right")
    wire(axes, POWER, (2.8, 6.2), (5.6, 6.2))
    pin(axes, (5.6, 6.2), "SIG, VCC", "left")
    wire(axes, SIGNAL, (2.8, 5.2), (5.6, 5.2))
    pin(axes, (5.6, 5.2), "S0–S3", "left")
    wire(axes, SIGNAL, (2.8, 1.75), (8.1, 1.75))
    pin(axes, (8.1, 1.75), "S0–S3", "left")
    wire(axes, SIGNAL, (2.8, 1.25), (8.1, 1.25))
    pin(axes, (8.1, 1.25), "SIG", "left")
    wire(axes, GROUND, (2.8, 0.85), (4.2, 0.85), (4.2, 0.2), (7.4, 0.2), (7.4, 0.85), (8.1, 0.85))
    pin(axes, (8.1, 0.85), "GND, EN", "left")
    wire(axes, GROUND, (4.2, 0.85), (4.2, 3.5), (5.6, 3.5))
    pin(axes, (5.6, 3.5), "GND, EN", "left")
    wire(axes, GROUND, (6.4, 1.25), (6.4, 0.2))
    axes.add_patch(Rectangle((6.28, 0.5), 0.24, 0.5, fc="white", ec=GROUND, zorder=5))
    axes.text(6.62, 0.66, "1 kΩ reference", ha="left", va="center", fontsize=7.5, rotation=0)
    for junction in ((4.2, 0.85), (6.4, 1.25), (6.4, 0.2)):
        axes.plot(*junction, marker="o", color=GROUND, ms=4, zorder=6)
    axes.text(
        4.2,
        6.3,
        "supply, also to VCC\nof the other multiplexer",
        color=POWER,
        ha="center",
        va="bottom",
        fontsize=8,
    )
    axes.text(4.0, 1.83, "selects the column", color=SIGNAL, ha="left", va="bottom", fontsize=8)
    axes.text(3.0, 5.28, "selects the row", color=SIGNAL, ha="left", va="bottom", fontsize=8)


def main() -> None:
    """Draw it beside this file."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.2, 5.4))
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set(xlim=(0.3, 12.9), ylim=(-0.1, 7.3), aspect="equal")
        axes.axis("off")
        board(axes)
        multiplexers(axes)
        panel(axes)
        figure.savefig(Path(__file__).with_suffix(".svg"), metadata={"Date": None})


if __name__ == "__main__":
    main()
