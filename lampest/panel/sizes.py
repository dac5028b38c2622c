"""Sizes of effects in a scene: a number, or `estimated`, for the recording to determine.

`Systematic` holds those of the errors that all readings share; `lampest.panel.effects` has what
they do.
"""

from dataclasses import dataclass, field, fields
from importlib.machinery import PathFinder
from math import nextafter
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from lampest.files.applications import loaded
from lampest.files.document import INLINE, MIN_NUMBER
from lampest.files.typed import Extensible, check_range
from lampest.panel.panel import as_panels_have

ESTIMATED: Final = "estimated"  # in place of a number: the recording determines it
Size = float | Literal["estimated"]
BELOW_ONE = nextafter(1.0, 0.0)
FOLDER = str(Path(__file__).with_name("effects"))


@dataclass(frozen=True)
class Listed:
    """An effect of a file of `lampest.panel.effects`, by name.

    The file is loaded where a scene or a simulation has the effect.

    Attributes
    ----------
    path : str
        Its class, as 'module:class'.
    key : str
        Key of a scene; '' for an effect without one.
    of_frames : tuple of str
        Attributes of `FrameNoise` with the sizes of the errors that it leaves in a frame.
    at_converter : tuple of str
        Entries of `unmodelled` with its sizes, the first of which is absent or 0 without the
        effect. An effect at lines has one, and acts before the converter.
    """

    path: str
    key: str = ""
    of_frames: tuple[str, ...] = ()
    at_converter: tuple[str, ...] = ()


def has_file(path: str) -> bool:
    """Return whether the file of an effect, 'module:class', is there: a deleted effect is gone."""
    name = path.partition(":")[0].rpartition(".")[2]
    return PathFinder.find_spec(name, [FOLDER]) is not None


# In the order in which effects act at a converter, and of columns of a frame's errors: the first
# has its column at size 0, too.
LISTED = (
    Listed("lampest.panel.effects.gain:Gain", "gain", ("gain",), ("gain_spread",)),
    Listed(
        "lampest.panel.effects.ripple:Ripple",
        "ripple",
        ("common_ripple", "line_ripple"),
        ("supply_ripple_lsb", "supply_ripple_hz"),
    ),
    Listed("lampest.panel.effects.water:MovingWater", of_frames=("motion",)),
    Listed("lampest.panel.effects.motion:LoadMotion", "motion", ("jitter", "resting")),
    Listed(
        "lampest.panel.effects.converter_memory:KeptShare",
        "converter_memory",
        of_frames=("memory",),
    ),
    Listed("lampest.panel.effects.creep:FilmCreep", "creep"),
    Listed("lampest.panel.effects.converter_curve:ConverterCurve", at_converter=("inl_lsb",)),
    Listed("lampest.panel.effects.saturation:Saturation", at_converter=("saturation",)),
)
LISTED_AT_LINES = (
    Listed("lampest.panel.effects.line_leak:LineLeak", "leaks", at_converter=("leak_ohm",)),
    Listed("lampest.panel.effects.loose_contact:LooseContact", "contacts"),
    Listed("lampest.panel.effects.ground:SharedGround", "ground_ohm", at_converter=("ground_ohm",)),
)
# Those whose files are there.
EFFECTS = tuple(effect for effect in LISTED if has_file(effect.path))
LINE_EFFECTS = tuple(effect for effect in LISTED_AT_LINES if has_file(effect.path))
SIZED = {effect.key: effect.path for effect in EFFECTS if effect.key}
OF_KEYS = SIZED | {effect.key: effect.path for effect in LINE_EFFECTS if effect.key}
# Key of a size of no effect -> least and largest number that a scene may state. Those of errors
# that all readings share are in their files, too.
LIMITS = {
    "response_sd": (0.0, 10.0),
    "model_error": (0.0, 1e6),
}

# End of a key of a scene → unit; other numbers are relative. Files of effects have their own.
UNITS = {
    "_lsb": "LSB",
    "_volt": "volt",
    "_ohm": "ohm",
    "_ohm_per_cell": "ohm a cell",
    "model_error": "times the noise",
}


@dataclass(frozen=True)
class Systematic(Extensible):
    """Systematic errors that all readings may share; they widen error bars.

    Estimates stay, but for each reading's own error: where it is stated, or the recording shows it,
    readings are corrected by what the unloaded panel determines of it.

    None: absent. Each is a number, or `estimated`: the recording determines it once, beginning with
    the size of common electronics.

    Attributes
    ----------
    reference_tolerance : float or 'estimated', or None
        Largest relative error of the reference resistor, or of all loads or feedback resistors
        together.
    channel_spread_ohm : float or 'estimated', or None
        Standard deviation of the resistance of each line's channel, in ohm.
    series_tolerance_ohm : float or 'estimated', or None
        Standard deviation of a resistance in series with all driven lines, in addition to the
        scene's, in ohm.
    inl_lsb : float or 'estimated', or None
        Standard deviation of the converter's smooth deviation from a straight line, in least
        significant bits.
    wire_ohm_per_cell : float or 'estimated', or None
        Standard deviation of the wire of rows and columns from cell to cell, in addition to the
        scene's, in ohm.
    reading_error : float or 'estimated', or None
        Standard deviation of the logarithm of a factor on each reading, the same in all frames.
    response_sd : float, or None
        Relative standard deviation of each cell's response to pressure, in the logarithm of its
        resistance (bent film, differing patches); it widens pressures only.
    model_error : float or 'estimated', or None
        Standard deviation of the readings' errors of the model, in units of their noise σ, so that
        σ grows by √(1 + model_error²). 0: none. None: from evidence that no penalty can imitate;
        'estimated': from the residuals of loaded frames, too. See `lampest.estimate.model_error`.
    own : tuple of (str, float or 'estimated')
        Sizes of further errors, those of installed packages; each is a key in a file.

    >>> lampest.Systematic(reference_tolerance=0.01).reference_tolerance
    0.01
    """

    reference_tolerance: Size = 0.0
    channel_spread_ohm: Size = 0.0
    series_tolerance_ohm: Size | None = None
    inl_lsb: Size | None = None
    wire_ohm_per_cell: Size | None = None
    reading_error: Size | None = None
    response_sd: float | None = None
    model_error: Size | None = None
    own: tuple[tuple[str, Size], ...] = field(default=(), metadata={INLINE: True})

    @classmethod
    def added_keys(cls) -> tuple[str, ...]:
        """Return the settings of effects that are no fields."""
        return added_effects()

    def __post_init__(self) -> None:
        if not 0 <= (plain_size(self.reference_tolerance) or 0.0) < 1:
            raise ValueError("reference_tolerance must be zero or positive, and below 1")
        check_sizes(
            self,
            "reference_tolerance",
            "channel_spread_ohm",
            "series_tolerance_ohm",
            "wire_ohm_per_cell",
            "inl_lsb",
            "reading_error",
            "response_sd",
            "model_error",
        )
        for name, size in self.own:
            if size != ESTIMATED:
                check_range(name, float(size), *limits_of(name))


def added_effects() -> tuple[str, ...]:
    """Return the settings of shared effects that are no fields of `Systematic`."""
    named = {entry.name for entry in fields(Systematic)}
    settings = (error.setting for error in loaded("lampest.panel.effects:shared_effects")())
    return tuple(setting for setting in settings if setting not in named)


def limits_of(name: str) -> tuple[float, float]:
    """Return the least and the largest number that a scene may state under a key of a size.

    Raises ValueError if no effect has the key.
    """
    if name in LIMITS:
        return LIMITS[name]
    if name in OF_KEYS:
        effect = loaded(OF_KEYS[name])
    else:
        effect = loaded("lampest.panel.effects:shared_effect_of")(name)
    limits: tuple[float, float] = effect.limits
    return limits


def plain_size(size: Size | None) -> float | None:
    """Return a size that is a number; None where it is absent or `estimated`."""
    return None if isinstance(size, str) else size


def check_sizes(owner: Any, *names: str) -> None:
    """Raise ValueError unless each named field of an object is valid.

    A field is valid if it is None or 0, or there is its effect and it is 'estimated' or within its
    limits.
    """
    for name in names:
        size = getattr(owner, name)
        if size not in (None, 0):
            limits = limits_of(name)
            if size != ESTIMATED:
                check_range(name, float(size), *limits)


def nearest_allowed(key: str, number: float) -> float:
    """Return the number nearest to a determined one that a scene may state under a dotted key.

    Numbers below the range of physical quantities are zero. Numbers beyond the limits of a size are
    the limit, and without limits infinity beyond that range.
    """
    name = key.rpartition(".")[2]
    if name in LIMITS or name in OF_KEYS or key.startswith("systematic."):
        low, high = limits_of(name)
        number = min(max(number, low), high)
        return 0.0 if abs(number) < MIN_NUMBER else number
    return float(as_panels_have(np.asarray(number)))


def unit_of_key(key: str) -> str:
    """Return the unit of a number by its key; '' for a relative one."""
    if key in OF_KEYS:
        effect_unit: str = loaded(OF_KEYS[key]).unit
        return effect_unit
    return next((unit for end, unit in UNITS.items() if key.endswith(end)), "")
