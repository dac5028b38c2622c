"""Numbers of a scene as unknowns of a program: resistances in series, references, channels.

Any voltage or current of a linear circuit is a ratio of polynomials that are linear in each of its
resistances:

    f(θ) = Σ_S a_S Π_{i∈S} θ_i / Σ_S b_S Π_{i∈S} θ_i,   S a subset of the numbers.

So are the entries of a readout's equation, the ties of its lines, and the factors between the
network's readings and the recorded ones. The polynomials follow from values of the readout at
a grid of numbers. Further values test them, and a number that acts otherwise is refused. A
readout therefore needs no statement of its own. Source: Bode, Network Analysis and Feedback
Amplifier Design, 1945, chapter 1.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, compress, product
from math import prod
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError, in_words
from lampest.panel.compiled import CasadiOwner
from lampest.panel.equation import Equation, equation_of
from lampest.panel.panel import Array
from lampest.panel.scene import Scene, specified

MAX_NUMBERS = 3  # keys: values at 3ⁿ points, and 2ⁿ⁺¹ coefficients of each entry
GRID = (0.0, 1.0, 2.0)  # in steps from the scene's number
TESTED = (0.5, 3.0)  # places beside the grid
FARTHER = 1.5  # the second of two readings whose conversion is a straight line, over the first
ROUNDING = 1e-9  # relative deviation of a value from its ratio of polynomials
# Numbers of an equation: one, or a pair, of each cell; and those of potentials of line ends
SINGLE = ("source", "drive", "load", "gain")
PAIRS = ("drive_terms", "load_terms", "current_terms")
OF_ENDS = ("of_drive", "of_load", "held_volt", "load_volt", "level", "follows")


@dataclass(frozen=True, eq=False)
class SceneNumber:
    """Number of a scene, or list of numbers of its lines, that is unknown.

    Attributes
    ----------
    key : str
        Dotted key of the scene, such as 'readout.load_ohm'.
    value : array, shape (n,)
        Numbers of the scene.
    sd : float
        Standard deviation of the prior about them.
    """

    key: str
    value: Array
    sd: float

    @classmethod
    def of(cls, scene: Scene, key: str, sd: Any) -> "SceneNumber":
        """Return the number at a key of a scene.

        Raises InputError unless the scene has numbers there, and a prior is positive and finite.
        """
        entry = specified(scene, key) if isinstance(key, str) else None
        listed = entry if isinstance(entry, tuple) else (entry,)
        if not all(type(number) in (int, float) and np.isfinite(number) for number in listed):
            raise InputError(f"numbers: the scene has no number {key!r}")
        if not isinstance(sd, int | float | np.integer) or not 0 < sd < np.inf:
            raise InputError(
                f"numbers: {key} needs the standard deviation of its prior, a positive number, "
                f"not {in_words(sd)}"
            )
        return cls(key, np.array(listed, dtype=float), float(sd))

    @property
    def least(self) -> float:
        """Least possible number: no resistance is negative."""
        return 0.0 if "_ohm" in self.key else -np.inf

    @property
    def step(self) -> Array:
        """Distance of the points of the grid, (n,)."""
        return np.maximum(np.abs(self.value) / 2, self.sd)

    def stated(self, scene: Scene, value: Array) -> Scene:
        """Return the scene with other numbers."""
        listed = isinstance(specified(scene, self.key), tuple)
        numbers = value.tolist()
        stated: Scene = _stated(scene, self.key, tuple(numbers) if listed else numbers[0])
        return stated


@dataclass(frozen=True, eq=False)
class SymbolicReadout(CasadiOwner):
    """Readout whose numbers are symbols.

    Attributes
    ----------
    numbers : sequence of SceneNumber
    symbols : mapping of str to casadi.SX
        Symbols of the numbers by key, (n, 1) each.
    reading : callable
        Equation of the readings, see `Equation.reading`.
    tie : casadi.SX, shape (lines, addresses)
        Change of the ties of the lines from those of the scene, siemens.
    slope, offset : casadi.SX, shape (cells, 1)
        The scene takes slope·y + offset for a reading y of the network.
    """

    numbers: Sequence[SceneNumber]
    symbols: Mapping[str, casadi.SX]
    reading: Callable[..., Any]
    tie: casadi.SX
    slope: casadi.SX
    offset: casadi.SX

    @classmethod
    def of(cls, scene: Scene, priors: Mapping[str, float], measured: Array) -> "SymbolicReadout":
        """Return the readout of a scene with symbols in place of some numbers.

        Parameters
        ----------
        scene : Scene
        priors : mapping of str to float
            Standard deviation of each unknown number about that of the scene, by its dotted key.
        measured : array, shape (rows, columns)
            Readings of the network.

        Raises InputError for a number that is no resistance of this circuit.
        """
        if scene.wiring is not None:
            raise InputError("numbers: wire, contacts and touching lines are not in this program")
        if scene.circuit.unit == "ohm" and not scene.circuit.two_point:
            kind = type(scene.circuit).__name__
            raise InputError(f"numbers: {kind} has no line ends of which a number could be unknown")
        if not isinstance(priors, Mapping):
            raise InputError(
                "numbers must map keys of the scene to standard deviations, such as "
                f"{{'series_resistance_ohm': 30.0}}, not {in_words(priors)}"
            )
        if len(priors) > MAX_NUMBERS:
            raise InputError(f"numbers: at most {MAX_NUMBERS} keys, not {len(priors)}")
        numbers = [SceneNumber.of(scene, key, sd) for key, sd in priors.items()]
        symbols = {each.key: casadi.SX.sym(each.key, len(each.value)) for each in numbers}
        circuit = scene.circuit
        values = _ratios(scene, numbers, symbols, measured)
        cells = measured.size
        first, last, values = values[:cells], values[cells : 2 * cells], values[2 * cells :]
        reading = casadi.DM(measured.ravel())
        slope = (last - first) / ((FARTHER - 1) * reading)
        offset = first - slope * reading
        equation = equation_of(circuit, *measured.shape)
        if circuit.two_point:
            unchanged = casadi.SX(sum(measured.shape), 1)
            return cls(numbers, symbols, equation.reading, unchanged, slope, offset)
        count = equation.ties.size
        finite = np.where(np.isfinite(equation.ties), equation.ties, 0.0)
        tied = casadi.reshape(values[:count], equation.ties.shape[1], len(equation.ties))
        symbolic = _with_arrays(equation, values[count:])
        change = tied - casadi.DM(finite.T)
        return cls(numbers, symbols, symbolic.reading, change, slope, offset)

    def as_the_scene_reads(self, reading: casadi.SX) -> casadi.SX:
        """Return what the scene takes for readings of the network, (cells, frames)."""
        slope, offset = (
            casadi.repmat(each, 1, reading.shape[1]) for each in (self.slope, self.offset)
        )
        return slope * reading + offset

    @property
    def prior(self) -> casadi.SX:
        """Cost Σ ((θ − mean)/sd)² of the prior, (1, 1)."""
        deviations = [
            (self.symbols[number.key] - casadi.DM(number.value)) / number.sd
            for number in self.numbers
        ]
        return casadi.sumsqr(casadi.vertcat(*deviations))


def _places(scene: Scene, numbers: Sequence[SceneNumber], measured: Array) -> NDArray[np.intp]:
    """Return the number of the list of each key on which an entry depends, (keys, entries).

    −1: on none.
    """
    nominal = _entries(scene, scene, measured)
    place = np.full((len(numbers), len(nominal)), -1)
    for own, number in zip(place, numbers, strict=True):
        for entry, chosen in enumerate(np.diag(number.step)):
            changed = _entries(number.stated(scene, number.value + chosen), scene, measured)
            # Entries are equal but for rounding.
            depends = ~np.isclose(changed, nominal, rtol=ROUNDING**1.5, atol=0.0)
            if np.any(own[depends] >= 0):
                raise _refusal(number.key)
            own[depends] = entry
        if np.all(own < 0):
            raise InputError(f"numbers: no reading depends on {number.key}")
    return place


def _ratios(
    scene: Scene,
    numbers: Sequence[SceneNumber],
    symbols: Mapping[str, casadi.SX],
    measured: Array,
) -> casadi.SX:
    """Return all entries of a readout as ratios of polynomials, (entries, 1).

    The arguments are those of `SymbolicReadout.of`.
    """
    place = _places(scene, numbers, measured)
    count = len(GRID) ** len(numbers)
    points = [*product(GRID, repeat=len(numbers)), *product(TESTED, repeat=len(numbers))]
    seen = []
    for point in points:
        moved = scene
        for number, step in zip(numbers, point, strict=True):
            moved = number.stated(moved, number.value + step * number.step)
        seen.append(_entries(moved, scene, measured))
    values = np.array(seen)
    # the first point is that of the scene's numbers
    column = casadi.SX(casadi.DM(np.where(np.isfinite(values[0]), values[0], 0.0)))
    for entry in np.flatnonzero((place >= 0).any(axis=0)).tolist():
        acting = place[:, entry] >= 0
        # Product of every subset of the numbers at each point, (points, subsets)
        at = np.array(points)[:, acting].tolist()
        terms = np.array([_subsets(point) for point in at], dtype=float)
        # Ratio of polynomials through the values f of the grid: Σ a − f Σ b = 0 at every point is
        # the vector of the least singular value.
        of_entry = values[:, entry]
        size = np.abs(of_entry[:count]).max()
        known = of_entry[:count, None] / size
        null = np.linalg.svd(np.hstack([terms[:count], -known * terms[:count]]))[2][-1]
        fit = np.array([[size], [1.0]]) * null.reshape(2, -1)
        upper, lower = fit @ terms.T
        if not np.all(np.abs(upper / lower - of_entry) <= ROUNDING * np.abs(of_entry).max()):
            raise _refusal(" and ".join(number.key for number in compress(numbers, acting)))
        steps = [
            (symbols[number.key][line] - number.value[line]) / number.step[line]
            for number, line in zip(numbers, place[:, entry].tolist(), strict=True)
            if line >= 0
        ]
        upper, lower = casadi.vertsplit(casadi.DM(fit) @ casadi.vertcat(*_subsets(steps)))
        column[entry] = upper / lower
    return column


def _subsets(parts: Sequence[Any]) -> list[Any]:
    """Return the product of every subset of some parts."""
    return [prod(compress(parts, powers)) for powers in product((0, 1), repeat=len(parts))]


def _entries(scene: Scene, nominal: Scene, measured: Array) -> Array:
    """Return all entries of a scene's readout as one column.

    These are the readings that the nominal scene takes for two others of the network, and, of a
    circuit of line ends, ties and numbers of the equation.

    Raises InputError for another circuit, and where a number changes more than these.
    """
    circuit = scene.circuit

    def seen(reading: Array) -> Array:
        volt = circuit.volt_from_recorded(circuit.to_recorded(reading, scene))
        recorded = nominal.circuit.recorded_from_volt(volt)
        return nominal.circuit.from_recorded(recorded, nominal)

    first, middle, last = (
        seen(factor * measured) for factor in (1.0, (1.0 + FARTHER) / 2, FARTHER)
    )
    if not np.allclose(middle - first, (last - first) / 2, rtol=ROUNDING):
        raise InputError("numbers: the converter's input beside the sensor is not in this program")
    conversion = [first.ravel(), last.ravel()]
    if circuit.two_point:
        return np.concatenate(conversion)
    equation = equation_of(circuit, *measured.shape)
    if _structure(equation) != _structure(equation_of(nominal.circuit, *measured.shape)):
        raise InputError("numbers: a line cannot pass from a resistance to none, or to another end")
    arrays = [np.broadcast_to(array, measured.shape).ravel() for array in _arrays(equation)]
    return np.concatenate([*conversion, equation.ties.ravel(), *arrays])


def _arrays(equation: Equation) -> list[Any]:
    """Return the numbers of an equation, to be broadcast to (rows, columns) each."""
    arrays = [getattr(equation, name) for name in SINGLE]
    arrays += chain(*(getattr(equation, name) for name in PAIRS))
    if equation.potentials is not None:
        arrays += [getattr(equation.potentials, name) for name in OF_ENDS]
    return [array for array in arrays if array is not None]


def _with_arrays(equation: Equation, column: casadi.SX) -> Equation:
    """Return an equation with the numbers of `_arrays` from one column, row by row."""
    rows, columns = equation.drive.shape
    parts = iter(
        casadi.reshape(part, columns, rows).T for part in casadi.vertsplit(column, rows * columns)
    )
    changes: dict[str, Any] = {name: next(parts) for name in SINGLE}
    changes |= {name: (next(parts), next(parts)) for name in PAIRS}
    if equation.potentials is not None:
        of_ends: dict[str, Any] = dict(zip(OF_ENDS, parts, strict=False))
        changes["potentials"] = replace(equation.potentials, **of_ends)
    return replace(equation, **changes)


def _structure(equation: Equation) -> list[Any]:
    """Return what an equation has beside numbers: which lines are held, tied and read together."""
    terms = equation.potentials
    structure = [
        equation.terminations.diode,
        equation.floating,
        equation.read_at.tolist(),
        None if equation.together is None else equation.together.tolist(),
        np.isinf(equation.ties).tolist(),
        (equation.ties == 0).tolist(),
    ]
    if terms is not None:
        structure += [terms.held.tolist(), terms.loaded, terms.ends.tolist(), terms.follows is None]
    return structure


def _refusal(name: str) -> InputError:
    return InputError(f"numbers: {name} does not act as a resistance of this circuit does")


def _stated(part: Any, key: str, value: Any) -> Any:
    """Return a part of a scene with another value at a dotted key.

    Raises InputError where the part does not take it.
    """
    name, _, rest = key.partition(".")
    inner = _stated(getattr(part, name), rest, value) if rest else value
    changes = {name: inner}
    try:
        return replace(part, **changes)
    except ValueError as error:
        raise InputError(f"numbers: {key} has no room for its prior: {error}") from error
