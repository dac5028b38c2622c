"""Effects beside the circuit, one file each: those of lampest and those of installed packages.

A `SharedEffect` is an error of all readings that frames share. A `LineEffect` is a leak or a
contact at lines. Its file states all of an effect: key, unit, prior with its source, what it does
to readings, how it is simulated, its words. Error bars, weights, simulation, numbers that a scene
calls `estimated`, and advice follow.

The files stand in this room, because scenes, simulation and error bars need them, whose rooms are
below inference. A file is loaded where a scene has its key.

To first order the error of the estimate is K·U·z with the gain K and independent standard normal z.
Every shared effect has columns of U, what it does to the readings, computed as a secant of
the readout's equations. `Shared` has those of a scene together.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cache
from typing import Any

import numpy as np

from lampest.files.applications import loaded
from lampest.files.errors import InputError
from lampest.files.typed import installed
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.response import TYPICAL_RESPONSE_SD
from lampest.panel.scene import Scene
from lampest.panel.sizes import ESTIMATED, SIZED, Systematic, has_file, unit_of_key

GROUP = "lampest.effects"  # of entry points, for effects of installed packages
# Field of `Systematic` with its size → class of the error, in the order of columns.
LISTED_SHARED = {
    "reference_tolerance": "lampest.panel.effects.reference:ReferenceTolerance",
    "channel_spread_ohm": "lampest.panel.effects.channels:ChannelSpread",
    "series_tolerance_ohm": "lampest.panel.effects.series:SeriesTolerance",
    "inl_lsb": "lampest.panel.effects.converter_curve:ConverterCurve",
    "wire_ohm_per_cell": "lampest.panel.effects.wire:WirePerCell",
    "load_tolerance": "lampest.panel.effects.loads:LoadTolerance",
    "offset_spread_volt": "lampest.panel.effects.offsets:AmplifierOffsets",
    "reading_error": "lampest.panel.effects.reading_error:ReadingError",
}
SHARED = {setting: path for setting, path in LISTED_SHARED.items() if has_file(path)}
REFERENCE = "reference_tolerance"
CHANNELS = "channel_spread_ohm"
READINGS = "reading_error"
SERIES = "series_tolerance_ohm"
E24_TOLERANCE = 0.05  # of ordinary resistors, uniformly distributed
LOG_STEP = 1e-6  # of the logarithm of a recorded value, for central differences


class SharedEffect(ABC):
    """Kind of error that all frames share. Its object has no fields.

    Attributes
    ----------
    setting : str
        Key of `systematic` with its size, one standard deviation; without a value there is no such
        error. The end of the key is its unit, as `unit_of_key` reads it.
    name : str
        Name in sentences.
    limits : (float, float)
        Least and largest size that a scene may state.
    prior : float, or None
        Size where a scene says `estimated`, before the recording tells more. None: the posterior
        begins with all sizes.
    is_typical : bool
        Whether `systematic: typical` includes the error.
    is_advised : bool
        Whether advice searches for the error where the scene does not name it.
    if_undetermined : str
        Why a recording with unloaded and loaded frames may not determine the size, and what to do.

    >>> class CommonFactor(lampest.SharedEffect):
    ...     setting = "common_factor"
    ...     name = "factor on all readings"
    ...     limits = (0.0, 1.0)
    ...
    ...     def columns(self, network, measured, scene, size):
    ...         return size * measured[None]
    >>> CommonFactor().unit
    ''
    """

    setting: str
    name: str
    limits: tuple[float, float]
    prior: float | None = None
    is_typical: bool = False
    is_advised: bool = True
    if_undetermined: str = (
        "the load changes all cells alike: press a few cells, and leave the others free"
    )

    @abstractmethod
    def columns(self, network: Network, measured: Array, scene: Scene, size: float) -> Array:
        """Return what the error of each standard normal z does to the readings.

        Parameters
        ----------
        network : Network
        measured : array, shape (..., rows, columns)
            Readings of the network, in its unit.
        scene : Scene
        size : float
            The setting; columns are proportional to it.

        Returns
        -------
        array, shape (n, ..., rows, columns)
            U.
        """

    @property
    def unit(self) -> str:
        """Unit of the size; '' for a relative one."""
        return unit_of_key(self.setting)

    def with_errors(self, scene: Scene, errors: Array) -> Scene:
        """Return the scene whose circuit has the errors z · size of `columns`, (n,).

        Raises ValueError where the circuit cannot have them.
        """
        raise ValueError(f"no key of the scene states {self.setting} line by line")

    def sentence(self, size: float, deviation: float) -> str:
        """Return the error that a recording shows in words, with its size and its deviation."""
        return (
            f"{self.name} of {size:.2g} +- {deviation:.1g} {self.unit or '(relative)'} "
            "would explain what still cells change"
        )

    def simulated(
        self,
        network: Network,
        measured: Array,
        scene: Scene,
        size: float,
        random: np.random.Generator,
    ) -> Array:
        """Return readings with a drawn error, z of which is the same in all frames.

        Parameters
        ----------
        network, measured, scene, size
            As those of `columns`, of one frame.
        random : numpy.random.Generator
            The same state for every frame.
        """
        columns = self.columns(network, measured, scene, size)
        return measured + np.tensordot(random.standard_normal(len(columns)), columns, 1)


def shared_effects() -> tuple[SharedEffect, ...]:
    """Return all errors that frames may share, in the order of their columns.

    Those of a notebook or a script follow those of installed packages; of a class that a cell
    defines again the last one counts.

    Raises InputError if an installed package registers something else than an effect, or a key that
    exists.
    """
    effects = {setting: shared_effect_of(setting) for setting in SHARED}
    in_notebook = {
        kind.setting: kind
        for kind in SharedEffect.__subclasses__()
        if kind.__module__ == "__main__"
    }
    for kind in (*installed(GROUP, type), *in_notebook.values()):
        named = f"{GROUP}: {kind.__name__} of an installed package"
        if kind in in_notebook.values():
            named = f"{kind.__name__} of this program"
        if issubclass(kind, SharedEffect):
            if kind.setting in effects:
                raise InputError(f"{named} needs a setting unlike {', '.join(effects)}")
            effects[kind.setting] = kind()
        elif not issubclass(kind, loaded("lampest.panel.effects.line_effect:LineEffect")):
            raise InputError(f"{named} is no effect, SharedEffect or LineEffect")
    return tuple(effects.values())


def sized_effects(sizes: Systematic) -> tuple[SharedEffect, ...]:
    """Return the errors with a size, in the order of their columns.

    The files of the others are not loaded.
    """
    # a notebook may define a class again
    return _sized_effects(sizes, tuple(SharedEffect.__subclasses__()) if sizes.own else ())


@cache
def _sized_effects(
    sizes: Systematic, kinds: tuple[type[SharedEffect], ...]
) -> tuple[SharedEffect, ...]:
    """Return the errors of `sized_effects`, where these kinds are defined."""
    keys = dict.fromkeys((*SHARED, *(key for key, _ in sizes.own)))
    return tuple(shared_effect_of(key) for key in keys if sizes.entry(key))


def shared_effect_of(setting: str) -> SharedEffect:
    """Return the error whose size is the entry `setting` of `Systematic`.

    Raises ValueError if there is none.
    """
    if setting in SHARED:
        shipped: SharedEffect = loaded(SHARED[setting])()
        return shipped
    effects = {error.setting: error for error in shared_effects()}
    if setting not in effects:
        raise ValueError(f"{setting}: no installed effect has this key")
    return effects[setting]


def error_columns(
    errors: Iterable[SharedEffect],
    network: Network,
    measured: Array,
    scene: Scene,
    sizes: Systematic,
) -> Array:
    """Return U, (n, …, rows, columns), of errors of one standard deviation each.

    U is in the readings' unit. `measured` are the readings of the network, (…, rows, columns).
    """
    parts = [np.zeros((0, *measured.shape))]
    for error in errors:
        size = sizes.size(error.setting)
        if size:
            parts.append(error.columns(network, measured, scene, size))
    return np.concatenate(parts)


def recorded_share(measured: Array, scene: Scene) -> Array:
    """Return ∂(reading)/∂ log(recorded), the effect of a factor on a recorded value.

    Central differences approximate the derivative.
    """
    above, below = (recorded_times(measured, scene, np.exp(step)) for step in (LOG_STEP, -LOG_STEP))
    return (above - below) / (2 * LOG_STEP)


def recorded_times(measured: Array, scene: Scene, factor: Array | float) -> Array:
    """Return the readings, (..., rows, columns), that times as large recorded values would give."""
    circuit = scene.circuit
    return circuit.from_recorded(circuit.to_recorded(measured, scene) * factor, scene)


def own_errors(measured: Array, scene: Scene, size: float) -> Array:
    """Return the readings' standard deviations for a deviation `size` of log(recorded).

    The result has shape (frames, rows, columns).
    """
    return size * np.abs(recorded_share(measured, scene)) if size else np.zeros(measured.shape)


@dataclass(frozen=True, eq=False)
class Possible:
    """Prior or posterior of the errors whose sizes a scene leaves to its recording.

    Attributes
    ----------
    sizes : Systematic
        Standard deviation of each error, those of the others included.
    settings : tuple of str
        Fields of `Systematic` of the errors that were estimated, in the order of `shared_effects`.
    root : array, shape (n, n), or None
        Lower triangular root of the covariance of z of these errors, each with its columns; None: z
        are independent.
    log_factor : array, shape (rows, columns), or None
        Logarithm of the factor on each recorded value that readings are corrected for; None where
        they are not.
    in_circuit : mapping
        Field of `Systematic` → errors that the scene's circuit is corrected for, (columns,) in the
        setting's unit.
    film_scatter : float
        Scatter of log r of the unloaded cells beside each reading's own error; 0 where unknown.
    """

    sizes: Systematic
    settings: tuple[str, ...] = ()
    root: Array | None = None
    log_factor: Array | None = None
    in_circuit: Mapping[str, Array] = field(default_factory=dict)
    film_scatter: float = 0.0

    def corrected(self, scene: Scene) -> Scene:
        """Return the scene whose circuit has the errors that it is corrected for."""
        for setting, errors in self.in_circuit.items():
            scene = shared_effect_of(setting).with_errors(scene, errors)
        return scene


def systematic_of(scene: Scene) -> Systematic | None:
    """Return the sizes of a scene's systematic errors; None without any.

    An error that the scene calls `estimated` has the size of common electronics, its prior; without
    a size there, none.
    """
    if scene.systematic is None or scene.systematic == "none":
        return None
    if scene.systematic == "typical":
        usual = usual_sizes()
        return usual if scene.series_name else replace(usual, series_tolerance_ohm=None)
    return scene.systematic.with_entries(
        {setting: prior_size(scene, setting) for setting in estimated_errors(scene)}
    )


def usual_sizes() -> Systematic:
    """Return the sizes of common electronics and films, those of `systematic: typical`."""
    priors: dict[str, Any] = {
        error.setting: error.prior for error in shared_effects() if error.is_typical
    }
    return Systematic(response_sd=TYPICAL_RESPONSE_SD, **priors)


def prior_size(scene: Scene, setting: str) -> float | None:
    """Return the size of an error that a scene calls `estimated`; None without a prior.

    The error of the model has none, and a resistance in series where the circuit has no such part.
    """
    if setting == "model_error" or (setting == SERIES and not scene.series_name):
        return None
    return shared_effect_of(setting).prior


def usual_size(setting: str) -> float:
    """Return the size of an effect in common electronics; 0 for one that is gone."""
    path = SHARED.get(setting) or SIZED.get(setting)
    return 0.0 if path is None else float(loaded(path).prior or 0.0)


def estimated_errors(scene: Scene) -> tuple[str, ...]:
    """Return the fields of `Systematic` that a scene calls `estimated`."""
    if not isinstance(scene.systematic, Systematic):
        return ()
    names = (*(part.name for part in fields(Systematic)), *dict(scene.systematic.own))
    return tuple(name for name in names if scene.systematic.entry(name) == ESTIMATED)


@dataclass(frozen=True)
class Shared:
    """Systematic errors of a scene, with their covariance.

    Attributes
    ----------
    possible : Possible or None
        The errors with a size.
    scene : Scene
    contact_root : array, shape (lines, n), or None
        Root of the covariance of the contact resistances, ohm.
    """

    possible: Possible | None
    scene: Scene
    contact_root: Array | None = None

    @classmethod
    def of(cls, scene: Scene, possible: Possible | None = None) -> "Shared | None":
        """Return the shared errors of a scene; None without any.

        Contacts have the prior of the scene. Errors have the sizes of `systematic_of` unless
        `possible` is given.
        """
        contacts = scene.contact_prior
        possible = Possible(systematic_of(scene) or Systematic()) if possible is None else possible
        sized = None if possible.sizes == Systematic() else possible
        if sized is None and contacts is None:
            return None
        contact_root = None if contacts is None else np.diag(contacts.deviation(scene.panel.shape))
        return cls(sized, scene, contact_root)

    def beyond(self, known: "Shared | None") -> "Shared | None":
        """Return the errors that remain if a method has unknowns for the errors `known`.

        The result is None if none remain.
        """
        if self.possible is None:
            return None
        if known is None or known.possible is None:
            return replace(self, contact_root=None)
        total = self.possible.sizes.size(READINGS)
        modelled = known.possible.sizes.size(READINGS)
        if not total > modelled:
            return None
        remaining = float(np.sqrt(total**2 - modelled**2))
        return Shared(Possible(Systematic(reading_error=remaining)), self.scene)

    def columns(self, network: Network, measured: Array) -> Array:
        """Return U, (cells, n), in the readings' unit.

        The columns are those of contacts, then of reference and channels, then of hidden errors.
        `measured` are the readings of the network, (rows, columns).
        """
        parts: list[Array] = [np.zeros((measured.size, 0))]
        if self.contact_root is not None:
            from lampest.panel.difference_network import contact_responses  # for contacts alone

            parts.append(contact_responses([network]) @ self.contact_root)
        if self.possible is not None:
            sizes, root = self.possible.sizes, self.possible.root
            joint = () if root is None else self.possible.settings
            for is_joint in (False, True):
                errors = (
                    each for each in sized_effects(sizes) if (each.setting in joint) is is_joint
                )
                columns = error_columns(errors, network, measured, self.scene, sizes)
                part = columns.reshape(len(columns), measured.size).T
                parts.append(part @ root if is_joint and root is not None else part)
        return np.concatenate(parts, axis=1)
