"""Errors that all frames of a recording share: reference, channels, contacts, series, wire, the converter's curve.

To first order the estimate moves by K·U·z with independent standard normal z, one column of U for each error: what it
does to the readings, a secant of the readout's own equations. `SHARED_ERRORS` is the table of them.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.readouts.lines import of_side
from lampest.panel.readouts.wiring import Wiring, contact_responses, wire_responses
from lampest.panel.scene import Scene, Systematic

SINES = 4  # that a converter's curve is made of; between them they are as large as specified, in the mean square
USUAL = Systematic(
    # Two channels of a CD74HC4067, 70 ohm each and 160 at most, lie within 50 ohm of what is typical; resistors of the
    # series E24 within 5 %. So large that 95 % intervals cover both at once.
    series_ohm=35.0,
    reference_tolerance=0.06,
    inl_lsb=0.5,  # rms; data sheets of microcontrollers' converters promise 1 to 2 at most
    wire_ohm_per_cell=0.2,  # copper tape has none, conductive thread and printed silver 0.1 to 1
    response_sd=0.25,  # flat film of one batch scatters by a tenth; bent, glued or old film answers otherwise
)


@dataclass(frozen=True, eq=False)
class Possible:
    """Knowledge of hidden errors.

    Attributes
    ----------
    sizes : Systematic
        Standard deviation of each.
    root : array, shape (n, n), or None
        Lower triangular root of the covariance of z in the order of the columns; None: the sizes alone are known.
    certain : bool
        Whether each reading's own error is specified, or determined beyond chance.
    """

    sizes: Systematic
    root: Array | None
    certain: bool = True


def systematic_of(scene: Scene) -> Systematic | None:
    """Return the sizes of errors that a scene names, or leaves possible by silence.

    None where it has no readout, or says that there are none.

    Kinds without a resistance in series, or of which what they sense is no voltage of lines, have no such error.
    """
    if scene.specified_systematic is not None:
        return scene.specified_systematic
    if scene.readout is None or scene.systematic == "none":
        return None
    return USUAL if scene.circuit.series_name else replace(USUAL, series_ohm=None)


def unobservable_numbers(scene: Scene) -> str:
    """Return a sentence on the numbers of a circuit that no frame shows, with the tolerances of error bars; ASCII.

    '' for a scene without a readout.
    """
    if scene.readout is None:
        return ""
    sizes = systematic_of(scene) or Systematic()
    within = f"within {100 * sizes.reference_tolerance:.3g} %", f"within {sizes.series_ohm or 0.0:.3g} ohm"
    known = {number.name: within[number.channel] for number in scene.circuit.line_numbers()}
    others = {"reference_ohm": within[0], "drive_volt": "exact", "converter_volt": "exact"}
    known |= {name: size for name, size in others.items() if hasattr(scene.readout, name)}
    named = ", ".join(f"{name} ({size})" for name, size in known.items())
    return (
        f"no frame shows the numbers with which all cells scale, assumed {named}; changes in percent hardly depend on "
        "them; lampest calibrate measures them"
    )


def recorded_share(measured: Array, scene: Scene) -> Array:
    """Return ∂(reading)/∂ log(recorded): what a factor on a recorded value does to the network's reading."""
    recorded, step = scene.circuit.to_recorded(measured, scene), 1e-6
    above, below = (scene.circuit.from_recorded(recorded * np.exp(sign * step), scene) for sign in (1, -1))
    return np.asarray((above - below) / (2 * step))


def own_errors(measured: Array, scene: Scene, size: float) -> Array:
    """Return what an error of the logarithm of each recorded value does to the readings (frames, rows, columns)."""
    if not size:
        return np.zeros(measured.shape)
    return np.asarray(size * np.abs(recorded_share(measured, scene)))


def _reference(network: Network, measured: Array, scene: Scene, size: float) -> Array:
    """Return the column of a reference off by a fraction; its tolerance is the half width of a uniform distribution."""
    return scene.circuit.shared_errors(network.cell_resistance, measured, scene, size / np.sqrt(3), 0.0)


def _channels(network: Network, measured: Array, scene: Scene, size: float) -> Array:
    """Return the columns of more resistance in the channel of each line."""
    return scene.circuit.shared_errors(network.cell_resistance, measured, scene, 0.0, size)[1:]


def _series(network: Network, measured: Array, scene: Scene, size: float) -> Array:
    """Return the column of more resistance in series with all driven lines."""
    lines = _channels(network, measured, scene, 1.0)
    driven, _ = of_side(scene.circuit.noisy_side, *np.split(lines, [measured.shape[-2]]))
    return np.asarray(size * driven.sum(axis=0)[None])


def _curve(network: Network, measured: Array, scene: Scene, size: float) -> Array:
    """Return the columns of a converter's curve: half a wave over its range, one wave and so on; none without it."""
    if scene.readout is None:
        return np.zeros((0, *measured.shape))
    circuit = scene.circuit
    volt = circuit.volt_from_recorded(circuit.to_recorded(measured, scene))
    height = size * circuit.lsb_volt * np.sqrt(2 / SINES)
    waves = height * np.sin(np.pi * np.multiply.outer(np.arange(SINES) + 1, volt / circuit.full_scale_volt))
    ends = [circuit.from_recorded(circuit.recorded_from_volt(volt + sign * waves), scene) for sign in (0.5, -0.5)]
    return np.asarray(ends[0] - ends[1])


def _wire(network: Network, measured: Array, scene: Scene, size: float) -> Array:
    """Return the columns of more resistance of the wire of all rows, and of all columns."""
    return size * wire_responses(network, (scene.wiring or Wiring()).lines)


def _each_reading(network: Network, measured: Array, scene: Scene, size: float) -> Array:
    """Return the columns of a factor on each recorded value."""
    each = (size * recorded_share(measured, scene)).reshape(*measured.shape[:-2], -1)
    alone = np.zeros((each.shape[-1], *each.shape))
    np.einsum("c...c->...c", alone)[...] = each
    return alone.reshape(-1, *measured.shape)


@dataclass(frozen=True)
class SharedError:
    """An error that all frames share.

    Attributes
    ----------
    setting : str
        Entry of `Systematic` with its size; without a value there is no such error.
    columns : callable
        U (n, …, rows, columns) of a network, its readings (…, rows, columns), a scene and the size.
    name, unit, count : str, str, int
        In sentences, and n, of a hidden error.
    """

    setting: str
    columns: Callable[[Network, Array, Scene, float], Array]
    name: str = ""
    unit: str = ""
    count: int = 0

    def size(self, sizes: Systematic) -> float:
        """Return its size; 0 where it has none."""
        return getattr(sizes, self.setting) or 0.0


REFERENCE = SharedError("reference_tolerance", _reference)
KNOWN_ERRORS = (  # as large as their sizes, whatever frames show
    REFERENCE,
    SharedError("channel_spread_ohm", _channels),
)
HIDDEN_ERRORS = (  # determined by still cells (`lampest.estimate.still_cells`)
    SharedError("series_ohm", _series, "series", "ohm", 1),
    SharedError("inl_lsb", _curve, "curve", "LSB", SINES),
    SharedError("wire_ohm_per_cell", _wire, "wire", "ohm a cell", 2),
)
READING_ERROR = SharedError("reading_error", _each_reading)  # determined by these, too
SHARED_ERRORS = (*KNOWN_ERRORS, *HIDDEN_ERRORS, READING_ERROR)


def error_columns(
    errors: Iterable[SharedError], network: Network, measured: Array, scene: Scene, sizes: Systematic
) -> Array:
    """U (n, …, rows, columns) of these errors in the unit of the network's readings, of one standard deviation each.

    The reference has a column in every scene, of zeros where its size is 0: channels stand behind it.
    measured : readings (…, rows, columns).
    """
    sized = [(error, error.size(sizes)) for error in errors]
    parts = [error.columns(network, measured, scene, size) for error, size in sized if size or error is REFERENCE]
    return np.concatenate([np.zeros((0, *measured.shape)), *parts])


@dataclass(frozen=True)
class Shared:
    """Errors that all readings have in common.

    Attributes
    ----------
    systematic : Systematic or None
        How large such errors are, or None.
    scene : Scene
        What they are errors of.
    contact_root : array, shape (lines, n) or None
        Ohm, a root of the covariance of contacts, or None.
    hidden_root : array, shape (n, n) or None
        Of what is possible of the hidden errors, in units of their sizes, lower triangular; None: of each on its own as
        much as its size.
    in_sigma : bool
        Whether the readings' σ includes each reading's own error.
    """

    systematic: Systematic | None
    scene: Scene
    contact_root: Array | None = None
    hidden_root: Array | None = None
    in_sigma: bool = False

    @classmethod
    def of(cls, scene: Scene, contact_root: Array | None = None, hidden: Possible | None = None) -> "Shared | None":
        """None where there is no such error.

        Contacts are known as the scene says unless a root is given; hidden errors as the scene says, or as usual where
        it is open, unless a recording has determined it.
        """
        if contact_root is None and scene.contacts is not None:
            contact_root = np.diag(scene.contacts.deviation(scene.panel.shape))
        sizes = systematic_of(scene) if hidden is None else hidden.sizes
        if sizes is None and contact_root is None:
            return None
        return cls(sizes, scene, contact_root, None if hidden is None else hidden.root, hidden is not None)

    def beyond(self, known: "Shared | None") -> "Shared | None":
        """Return the errors that remain where a method has unknowns for the specified ones; None where none do."""
        if self.systematic is None:
            return None
        if known is None or known.systematic is None:
            return replace(self, contact_root=None)
        own, size = (errors.reading_error or 0.0 for errors in (self.systematic, known.systematic))
        return Shared(Systematic(reading_error=float(np.sqrt(own**2 - size**2))), self.scene) if own > size else None

    def columns(self, network: Network, measured: Array) -> Array:
        """U (cells, n) in the readings' unit: contacts, reference and channels, hidden errors.

        measured : readings (rows, columns).
        """
        columns = self.unrelated(network, measured)
        if self.contact_root is None:
            return self.related(columns)
        contacts = contact_responses([network]) @ self.contact_root
        return np.concatenate([contacts, self.related(columns)], axis=1)

    def unrelated(self, network: Network, measured: Array) -> Array:
        """Return the columns without contacts, as if hidden errors were independent of each other.

        They are (…, cells, n) of readings (…, rows, columns).
        """
        if self.systematic is None:
            return np.zeros((measured.size, 0))
        errors = error_columns(SHARED_ERRORS, network, measured, self.scene, self.systematic)
        return np.moveaxis(errors.reshape(*errors.shape[:-2], -1), 0, -1)

    def related(self, columns: Array) -> Array:
        """Return these columns with the covariance of hidden errors, the last of them."""
        root = np.zeros((0, 0)) if self.hidden_root is None else self.hidden_root
        first = columns.shape[-1] - len(root)
        return np.concatenate([columns[..., :first], columns[..., first:] @ root], axis=-1)

    def own_error(self, measured: Array) -> Array:
        """Return the standard deviation of each reading's own error, in the readings' unit, (frames, rows, columns)."""
        size = None if self.systematic is None else self.systematic.reading_error
        return own_errors(measured, self.scene, size or 0.0)
