"""Systematic errors of reference, channels, contacts, series, wire and converter in all frames.

To first order the error of the estimate is K·U·z with the gain K and independent standard normal z.
Every error has one or more columns of U, its effect on the readings, computed as a secant of the
readout's equations. `SHARED_ERRORS` lists the errors.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace

import numpy as np

from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.readouts.lines import of_side
from lampest.panel.readouts.wiring import Wiring
from lampest.panel.scene import Scene
from lampest.panel.sizes import ESTIMATED, Systematic

TYPICAL_CHANNEL_OHM = 3.0  # CD74HC4067, data sheet: any two channels differ by 10 ohm
# Sines of which a converter's curve consists; the mean square of their sum is the specified one.
SINES = 4
LOG_STEP = 1e-6  # of the logarithm of a recorded value, for central differences
USUAL = Systematic(
    # Two channels of a CD74HC4067, 70 ohm each and 160 at most, lie within 50 ohm of the typical
    # value; resistors of the series E24 within 5 %. The sizes are such that 95 % intervals cover
    # both at once.
    series_tolerance_ohm=35.0,
    reference_tolerance=0.06,
    inl_lsb=0.5,  # rms; data sheets of microcontrollers' converters promise 1 to 2 at most
    wire_ohm_per_cell=0.2,  # copper tape has none, conductive thread and printed silver 0.1 to 1
    # Flat film of one batch scatters by a tenth; bent, glued or old film responds differently.
    response_sd=0.25,
)


@dataclass(frozen=True, eq=False)
class Possible:
    """Prior or posterior of the errors whose sizes a scene leaves to its recording.

    Attributes
    ----------
    sizes : Systematic
        Standard deviation of each error, those of the others included.
    settings : tuple of str
        Fields of `Systematic` of the errors that were estimated, in the order of `SHARED_ERRORS`.
    root : array, shape (n, n), or None
        Lower triangular root of the covariance of z of these errors, each with its columns; None: z
        are independent.
    in_sigma : float
        Size of each reading's own error that σ of the readings includes, and so the choice of
        weights: the median of the posterior (docs/studies/effects.md).
    """

    sizes: Systematic
    settings: tuple[str, ...] = ()
    root: Array | None = None
    in_sigma: float = 0.0


def systematic_of(scene: Scene) -> Systematic | None:
    """Return the sizes of a scene's systematic errors; None without any.

    An error that the scene calls `estimated` has the size of common electronics, its prior; without
    a size there, none.
    """
    if scene.systematic is None or scene.systematic == "none":
        return None
    usual = USUAL if scene.circuit.series_name else replace(USUAL, series_tolerance_ohm=None)
    if scene.systematic == "typical":
        return usual
    prior = replace(usual, channel_spread_ohm=TYPICAL_CHANNEL_OHM)
    return replace(
        scene.systematic, **{name: getattr(prior, name) for name in estimated_errors(scene)}
    )


def estimated_errors(scene: Scene) -> tuple[str, ...]:
    """Return the fields of `Systematic` that a scene calls `estimated`."""
    if not isinstance(scene.systematic, Systematic):
        return ()
    return tuple(
        part.name
        for part in fields(Systematic)
        if getattr(scene.systematic, part.name) == ESTIMATED
    )


def unobservable_numbers(scene: Scene, of_changes: float | None = None) -> str:
    """Return a sentence on the numbers of a circuit that frames cannot determine.

    The sentence states the numbers with their assumed tolerances, in ASCII. It is '' for a scene
    without a readout, and for a readout that states no such numbers.

    Parameters
    ----------
    scene : Scene
    of_changes : float or None
        Median error of the changes ln(r/r0) of loaded cells by numbers at the ends of their
        tolerances; None where it is unknown.
    """
    if scene.readout is None:
        return ""
    sizes = systematic_of(scene) or Systematic()
    reference, series = (error.size(sizes) for error in (REFERENCE, SERIES))
    within = (
        f"within {100 * reference:.3g} %" if reference else "exact",
        f"within {series:.3g} ohm" if series else "exact",
    )
    tolerances = {number.name: within[number.channel] for number in scene.circuit.line_numbers()}
    further = {"reference_ohm": within[0], "drive_volt": "exact", "converter_volt": "exact"}
    tolerances |= {name: size for name, size in further.items() if hasattr(scene.readout, name)}
    if not tolerances:
        return ""
    named = ", ".join(f"{name} ({size})" for name, size in tolerances.items())
    remaining = ""
    if of_changes is not None:
        remaining = (
            "; at these ends changes of loaded cells "
            f"are off by {100 * of_changes:.2g} % in the median"
        )
    return (
        f"no frame shows the numbers with which all cells scale, assumed {named}{remaining}; "
        "lampest calibrate measures them"
    )


def recorded_share(measured: Array, scene: Scene) -> Array:
    """Return ∂(reading)/∂ log(recorded), the effect of a factor on a recorded value.

    Central differences approximate the derivative.
    """
    recorded = scene.circuit.to_recorded(measured, scene)
    above = scene.circuit.from_recorded(recorded * np.exp(LOG_STEP), scene)
    below = scene.circuit.from_recorded(recorded * np.exp(-LOG_STEP), scene)
    return np.asarray((above - below) / (2 * LOG_STEP))


def own_errors(measured: Array, scene: Scene, size: float) -> Array:
    """Return the readings' standard deviations for a deviation `size` of log(recorded).

    The result has shape (frames, rows, columns).
    """
    return size * np.abs(recorded_share(measured, scene)) if size else np.zeros(measured.shape)


def _reference(network: Network, measured: Array, scene: Scene, size: float) -> Array:
    """Return the column of the reference's relative error.

    `size` is the half width of a uniform distribution.
    """
    return scene.circuit.shared_errors(
        network.cell_resistance, measured, scene, size / np.sqrt(3), 0.0
    )


def _channels(network: Network, measured: Array, scene: Scene, size: float) -> Array:
    """Return the columns of an additional resistance in the channel of each line."""
    return scene.circuit.shared_errors(network.cell_resistance, measured, scene, 0.0, size)[1:]


def _series(network: Network, measured: Array, scene: Scene, size: float) -> Array:
    """Return the column of an additional resistance in series with all driven lines."""
    lines = _channels(network, measured, scene, 1.0)
    driven, _ = of_side(scene.circuit.noisy_side, *np.split(lines, [measured.shape[-2]]))
    return np.asarray(size * driven.sum(axis=0)[None])


def _curve(network: Network, measured: Array, scene: Scene, size: float) -> Array:
    """Return the columns of a converter's curve; none without a converter.

    The columns are sines of ½, 1, 1½ and 2 periods over the converter's range.
    """
    if scene.readout is None:
        return np.zeros((0, *measured.shape))
    circuit = scene.circuit
    volt = circuit.volt_from_recorded(circuit.to_recorded(measured, scene))
    height = size * circuit.lsb_volt * np.sqrt(2 / SINES)
    least, most = circuit.range_volt
    # √(2/SINES)·size·LSB·sin(π k V/V_full), k = 1, …, SINES: the mean square of the sum over the
    # range is size²·LSB²
    waves = height * np.sin(
        np.pi * np.multiply.outer(np.arange(SINES) + 1, (volt - least) / (most - least))
    )
    above = circuit.from_recorded(circuit.recorded_from_volt(volt + 0.5 * waves), scene)
    below = circuit.from_recorded(circuit.recorded_from_volt(volt - 0.5 * waves), scene)
    return np.asarray(above - below)


def _wire(network: Network, measured: Array, scene: Scene, size: float) -> Array:
    """Return the columns of an additional wire resistance of all rows, and of all columns."""
    from lampest.panel.readouts.wired_network import wire_responses  # for this error alone

    return size * wire_responses(network, (scene.wiring or Wiring()).lines)


def _each_reading(network: Network, measured: Array, scene: Scene, size: float) -> Array:
    """Return the columns of a factor on each recorded value."""
    # Column c has the error of reading c alone: an identity over the cells times
    # size·∂y/∂log(recorded).
    shares = (size * recorded_share(measured, scene)).reshape(*measured.shape[:-2], -1)
    columns = np.zeros((shares.shape[-1], *shares.shape))
    np.einsum("c...c->...c", columns)[...] = shares
    return columns.reshape(-1, *measured.shape)


@dataclass(frozen=True)
class SharedError:
    """Kind of error that all frames share.

    Attributes
    ----------
    setting : str
        Field of `Systematic` with its size; without a value there is no such error.
    columns : callable
        Function (network, readings (…, rows, columns), scene, size) → U (n, …, rows, columns).
    name, unit : str
        Name and unit in sentences.
    """

    setting: str
    columns: Callable[[Network, Array, Scene, float], Array]
    name: str = ""
    unit: str = ""

    def size(self, sizes: Systematic) -> float:
        """Return the size of this error; 0 if it has none."""
        return float(getattr(sizes, self.setting) or 0.0)


REFERENCE = SharedError("reference_tolerance", _reference, "reference", "")
CHANNELS = SharedError("channel_spread_ohm", _channels, "channels", "ohm")
SERIES = SharedError("series_tolerance_ohm", _series, "series", "ohm")
READING_ERROR = SharedError("reading_error", _each_reading, "each reading", "")
SHARED_ERRORS = (
    REFERENCE,
    CHANNELS,
    SERIES,
    SharedError("inl_lsb", _curve, "curve", "LSB"),
    SharedError("wire_ohm_per_cell", _wire, "wire", "ohm a cell"),
    READING_ERROR,
)


def error_columns(
    errors: Iterable[SharedError],
    network: Network,
    measured: Array,
    scene: Scene,
    sizes: Systematic,
) -> Array:
    """Return U, (n, …, rows, columns), of errors of one standard deviation each.

    U is in the readings' unit. `measured` are the readings of the network, (…, rows, columns). The
    reference has a column in every scene, of zeros where its size is 0.
    """
    sized = [(error, error.size(sizes)) for error in errors]
    parts = [
        error.columns(network, measured, scene, size)
        for error, size in sized
        if size or error is REFERENCE
    ]
    return np.concatenate([np.zeros((0, *measured.shape)), *parts])


@dataclass(frozen=True)
class Shared:
    """Systematic errors of a scene, with their covariance.

    Attributes
    ----------
    systematic : Systematic or None
        Sizes of the errors.
    scene : Scene
    contact_root : array, shape (lines, n), or None
        Root of the covariance of the contact resistances, ohm.
    estimated : tuple of str
        Fields of `Systematic` of the errors with a joint posterior.
    root : array, shape (n, n), or None
        Lower triangular root of the covariance of these errors, in units of their sizes; None: they
        are independent, with their sizes as standard deviations.
    in_sigma : float
        Size of each reading's own error that σ of the readings includes.
    """

    systematic: Systematic | None
    scene: Scene
    contact_root: Array | None = None
    estimated: tuple[str, ...] = ()
    root: Array | None = None
    in_sigma: float = 0.0

    @classmethod
    def of(cls, scene: Scene, possible: Possible | None = None) -> "Shared | None":
        """Return the shared errors of a scene; None without any.

        Contacts have the prior of the scene. Errors have the sizes of `systematic_of` unless
        `possible` is given.
        """
        contacts = scene.contact_prior
        possible = Possible(systematic_of(scene) or Systematic()) if possible is None else possible
        sizes = None if possible.sizes == Systematic() else possible.sizes
        if sizes is None and contacts is None:
            return None
        contact_root = None if contacts is None else np.diag(contacts.deviation(scene.panel.shape))
        return cls(sizes, scene, contact_root, possible.settings, possible.root, possible.in_sigma)

    def beyond(self, known: "Shared | None") -> "Shared | None":
        """Return the errors that remain if a method has unknowns for the errors `known`.

        The result is None if none remain.
        """
        if self.systematic is None:
            return None
        if known is None or known.systematic is None:
            return replace(self, contact_root=None)
        total = READING_ERROR.size(self.systematic)
        modelled = READING_ERROR.size(known.systematic)
        if not total > modelled:
            return None
        remaining = float(np.sqrt(total**2 - modelled**2))
        return Shared(Systematic(reading_error=remaining), self.scene)

    def columns(self, network: Network, measured: Array) -> Array:
        """Return U, (cells, n), in the readings' unit.

        The columns are those of contacts, then of reference and channels, then of hidden errors.
        `measured` are the readings of the network, (rows, columns).
        """
        parts = list[Array]()
        if self.contact_root is not None:
            from lampest.panel.readouts.wired_network import contact_responses  # for contacts alone

            parts.append(contact_responses([network]) @ self.contact_root)
        if self.systematic is not None:
            joint = () if self.root is None else self.estimated
            apart = [error for error in SHARED_ERRORS if error.setting not in joint]
            together = [error for error in SHARED_ERRORS if error.setting in joint]
            parts.append(self._of_errors(apart, network, measured))
            if self.root is not None:
                parts.append(self._of_errors(together, network, measured) @ self.root)
        return np.concatenate(parts, axis=1) if parts else np.zeros((measured.size, 0))

    def _of_errors(self, errors: Iterable[SharedError], network: Network, measured: Array) -> Array:
        """Return U of some errors, (cells, n), in the readings' unit."""
        assert self.systematic is not None
        columns = error_columns(errors, network, measured, self.scene, self.systematic)
        return columns.reshape(len(columns), measured.size).T

    def own_error(self, measured: Array) -> Array:
        """Return the standard deviation of each reading's own error, (frames, rows, columns).

        The unit is that of the readings.
        """
        size = 0.0 if self.systematic is None else READING_ERROR.size(self.systematic)
        return own_errors(measured, self.scene, size)
