"""Known loads of a calibration: weights, forces or pressures with their feet, from YAML or CSV."""

import csv
import json
import re
from contextlib import suppress
from dataclasses import dataclass
from math import pi
from pathlib import Path
from typing import Any, ClassVar, Literal, cast

import numpy as np

from lampest.apps.recognition.observation import patch_of
from lampest.files.document import parse_document, read_document, validated
from lampest.files.errors import InputError
from lampest.files.typed import check_not_negative, check_positive_fields
from lampest.files.whole import note_read
from lampest.panel.conditions import GRAVITY
from lampest.panel.panel import Array, Panel
from lampest.recording.shapes import Block, Rod

WRONG_ROW = "each load needs a frame in the columns first and last, and no more cells"


@dataclass(frozen=True, kw_only=True)
class KnownLoad:
    """One load that was at rest during some frames.

    Attributes
    ----------
    frames : tuple of int
        The first and the last frame, counted from 0 in the recording.
    recording : str
        File name of the recording without folder; '' where there is one recording.
    mass_g, force_newton, pressure_kpa : float or None
        One of the three; a negative pressure is suction.
    diameter_mm, length_mm, width_mm, angle_deg, x_mm, y_mm : float or None
        The foot, round or rectangular, and its centre. A pressure without foot acts on the whole
        panel.

    Raises
    ------
    ValueError
        If a number is out of range.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    frames: tuple[int, int]
    recording: str = ""
    mass_g: float | None = None
    force_newton: float | None = None
    pressure_kpa: float | None = None
    x_mm: float | None = None
    y_mm: float | None = None
    diameter_mm: float | None = None
    length_mm: float | None = None
    width_mm: float | None = None
    angle_deg: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.frames[0] <= self.frames[1]:
            raise ValueError("frames must be the first and the last of the load, counted from 0")
        check_positive_fields(
            self, "mass_g", "force_newton", "diameter_mm", "length_mm", "width_mm"
        )
        if self.pressure_kpa is not None and not 1e-6 < abs(self.pressure_kpa) < 1e4:
            raise ValueError("pressure_kpa must not be 0, and below 1e4")

    def check(self) -> None:
        """Raise ValueError unless these numbers make one load."""
        if [self.mass_g, self.force_newton, self.pressure_kpa].count(None) != 2:
            raise ValueError("a load needs one of mass_g, force_newton and pressure_kpa")
        is_round = self.diameter_mm is not None
        sides = [self.length_mm, self.width_mm]
        is_rectangular = None not in sides
        incomplete = not is_rectangular and sides != [None, None]
        if incomplete or (is_round and is_rectangular):
            raise ValueError("a foot is diameter_mm, or length_mm and width_mm")
        has_foot = is_round or is_rectangular
        if has_foot != (self.x_mm is not None and self.y_mm is not None):
            raise ValueError("a foot needs x_mm and y_mm, and they need a foot")
        if not has_foot and self.pressure_kpa is None:
            raise ValueError(
                "a weight or force needs its foot: diameter_mm, or length_mm and width_mm"
            )

    def pressure(
        self, panel: Panel, patch_mm: float, along_mm: float = 0.0, down_mm: float = 0.0
    ) -> Array:
        """Return the mean pressure on every patch, (rows, columns) kPa.

        Raises ValueError as `check`.

        Parameters
        ----------
        panel : Panel
        patch_mm : float
            Edge of a cell's film.
        along_mm, down_mm : float
            Displacement of the foot along x and y.
        """
        self.check()
        if self.x_mm is None or self.y_mm is None:
            return np.full(panel.shape, self.pressure_kpa)
        length, width, diameter = (
            size or 0.0 for size in (self.length_mm, self.width_mm, self.diameter_mm)
        )
        area = length * width or pi / 4 * diameter**2
        # a foot under 1 kPa, whose mean pressure on a patch is the share of the patch that it
        # covers
        under: dict[str, Any] = {
            "centre_mm": (self.x_mm + along_mm, self.y_mm + down_mm),
            "mass_g": area / GRAVITY,
        }
        block: dict[str, Any] = {
            "length_mm": length,
            "width_mm": width,
            "angle_deg": self.angle_deg,
        }
        foot = Rod(diameter_mm=diameter, **under) if diameter else Block(**block, **under)
        newton = self.force_newton or (self.mass_g or 0.0) * GRAVITY * 1e-3
        kpa = newton / area * 1e3 if self.pressure_kpa is None else self.pressure_kpa
        return kpa * foot.mean_pressure(panel, patch_mm)[0]


@dataclass(frozen=True, kw_only=True)
class KnownLoads:
    """All loads of a calibration.

    Raises ValueError where there is none, or a number is out of range.

    Attributes
    ----------
    loads : tuple of KnownLoad
    patch_mm : float or None
        Edge of a cell's film; None: 0.6 of the pitch.
    place_mm : float
        Standard deviation of a foot's place, along x and along y.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    schema: Literal[1]
    loads: tuple[KnownLoad, ...]
    patch_mm: float | None = None
    place_mm: float = 1.0

    def __post_init__(self) -> None:
        if not self.loads:
            raise ValueError("loads: name one at least")
        check_positive_fields(self, "patch_mm")
        check_not_negative(self, "place_mm")

    def pressures(self, panel: Panel) -> tuple[Array, Array]:
        """Return the pressures of the loads, and their standard deviations by position.

        Returns
        -------
        pressures, pressure_sd : arrays, shape (loads, rows, columns)
            In kPa.
        """
        shift = self.place_mm
        patch = patch_of(panel, self.patch_mm)

        def moved(*step: float) -> Array:
            return np.stack([load.pressure(panel, patch, *step) for load in self.loads])

        # σ_p = √((Δp_x/2)² + (Δp_y/2)²), from displacements by ± place_mm
        across = moved(shift, 0.0) - moved(-shift, 0.0)
        down = moved(0.0, shift) - moved(0.0, -shift)
        return moved(), np.hypot(across, down) / 2


def read_known_loads(path: Path) -> KnownLoads:
    """Return known loads from a YAML file or a CSV file.

    The CSV file has columns `first`, `last` and fields of `KnownLoad`.

    Raises InputError with the line of the fault.
    """
    table = path.suffix.lower() == ".csv"
    try:
        document = parse_document(_as_yaml(path), str(path)) if table else read_document(path)
        known_loads = cast(KnownLoads, validated(document, KnownLoads))
        for number, load in enumerate(known_loads.loads):
            try:
                load.check()
            except ValueError as error:
                raise document.error(("loads", number), str(error)) from error
        return known_loads
    except InputError as error:
        if not table:
            raise
        # The column number refers to the YAML, and is removed.
        raise InputError(
            re.sub(rf"^({re.escape(str(path))}:\d+):\d+", r"\1", str(error))
        ) from error


def _as_yaml(path: Path) -> str:
    """Return the table as YAML with the same line numbers.

    Thus errors state the line of the table.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
        note_read(path)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"{path}: cannot be read as text ({' '.join(str(error).split())})"
        ) from error
    names, *rows = [[cell.strip() for cell in row] for row in csv.reader(lines)] or [[]]
    text = ["{schema: 1, loads: ["]
    for number, row in enumerate(rows, 2):
        cells = {name: _scalar(cell) for name, cell in zip(names, row, strict=False) if cell}
        if cells and not (cells.keys() >= {"first", "last"} and len(row) <= len(names)):
            raise InputError(f"{path}:{number}: {WRONG_ROW}")
        line = ""
        if cells:
            frames = [cells.pop("first"), cells.pop("last")]
            line = json.dumps({"frames": frames} | cells) + ","
        text.append(line)
    return "\n".join([*text, "]}"])


def _scalar(cell: str) -> float | str:
    """Return the number in a cell, or its text."""
    for kind in (int, float):
        with suppress(ValueError):
            return kind(cell)
    return cell
