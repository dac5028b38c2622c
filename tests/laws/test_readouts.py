"""Laws of every kind of readout, of installed packages, too."""

from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any

import casadi
import numpy as np
import pytest
from numpy.testing import assert_allclose

from lampest import (
    Array,
    Bounds,
    Contacts,
    DrivenReadout,
    Faults,
    GroundedReadout,
    LoadedColumnsReadout,
    Panel,
    Readings,
    Readout,
    Scene,
    SeriesPerLine,
    TwoPointReadout,
)
from lampest.files.typed import members_of
from lampest.panel.circuit import nominal_terminations
from lampest.panel.difference_network import contact_responses
from lampest.panel.equation import equation_of
from lampest.panel.joined_network import JoinedNetwork
from lampest.panel.network import Network, SolvedNetwork
from lampest.panel.readouts import AnyReadout
from lampest.panel.readouts.tolerances import simulated
from lampest.panel.readouts.two_point import ModulesReadout, ParallelDividers
from lampest.panel.readouts.wiring import Lines, NeighbourLeaks
from tests.laws.samples import examples
from tests.netlist import impedance_of

KINDS = members_of(AnyReadout)
PANELS = ((4, 6), (5, 3))
WIRES = {
    "wire": (Lines(30.0, 70.0), None),
    "from the right, to the top": (Lines(30.0, 70.0, "right", "top"), None),
    "rows of wire": (Lines(row_ohm_per_cell=50.0), None),
    "columns of wire": (Lines(column_ohm_per_cell=50.0, columns_leave="top"), None),
    "joined": (None, Faults(joined_rows=((0, 2),), joined_columns=((1, 2),))),
    "wire and joined": (Lines(30.0, 0.1), Faults(joined_rows=((1, 2),))),
}
FAR_KEYS: dict[type, list[dict[str, Any]]] = {
    LoadedColumnsReadout: [{"drive_ohm": 100.0}, {"groups": ((0, 2), (3, 1)), "polarity": "down"}],
    GroundedReadout: [
        {"sense_ohm": 70.0},
        {"sense": "one"},
        {"sense": "one", "idle_load_ohm": 0.0},
    ],
    DrivenReadout: [
        {"idle_ohm": 0.0, "drive_ohm": 70.0, "idle_load_ohm": np.inf},
        {"idle_ohm": 3300.0, "idle_load_ohm": 0.0},
        {"idle_ohm": 0.0, "load_ohm": np.inf, "drive_ohm": 70.0},
        {"drive_ohm": 95.0, "idle_ohm": 1e4, "idle_stays": True, "input_ohm": 1e6},
    ],
}
LEAKS = NeighbourLeaks(rows=6000.0, columns=4000.0)
STEP = 1e-4  # of ln r; a Taylor remainder falls with its square, a wrong derivative with itself
ROUNDING = 1e-9  # relative: float64 times the condition of cells that differ by factors of 100
CANCELLATION = 1e-12  # of the largest reading: products that are sums of both signs
MAX_CURVATURE = (
    0.1  # of the slope, over a hundred steps; 0.054 of amplifiers at twelve times the supply
)
MAX_DIFFERENCE_ERROR = 1e-6  # of the largest entry: central differences, h²; measured 1.2e-7
MAX_STAND_IN = 0.05  # of the smallest value that is positive: a voltage that is all but zero

MAX_PUBLIC_NAMES = 39  # of a readout, beside its keys


def fits(*scene: Any, **keys: Any) -> Scene | None:
    try:
        return Scene(*scene, **keys)
    except ValueError:
        return None


def scenes() -> Iterator[Any]:
    """Every configuration of every kind that fits a panel, on a wide and on a tall one.

    The first configuration of a kind has both panels at every commit. The others have one, in turn
    a wide and a tall one; the other panel is slow, as are most circuits that are read at far ends.
    """
    for kind in KINDS:
        named = {
            str(number): [fits(Panel(*shape), readout) for shape in PANELS]
            for number, readout in enumerate(examples(kind))
        }
        of_panels = [{**wired_scenes(kind, *shape), **far_scenes(kind, *shape)} for shape in PANELS]
        named |= {name: [made[name] for made in of_panels] for name in of_panels[0]}
        for turn, (name, both) in enumerate(named.items()):
            for shape, scene in zip(PANELS, both, strict=True):
                rare = turn > 0 and None not in both and shape != PANELS[turn % 2]
                rare |= name.startswith("far") and "wire" not in name
                label = f"{kind.__name__}-{name}-{shape[0]}x{shape[1]}"
                if scene is not None:
                    yield pytest.param(scene, id=label, marks=[pytest.mark.slow] * rare)


def wired_scenes(kind: type, rows: int, columns: int) -> dict[str, Scene]:
    """Return scenes of a kind with every sort of wire, lines that touch, and contacts."""
    panel = Panel(rows, columns)
    readout = next(example for example in examples(kind) if fits(panel, example) is not None)
    contacts = contacts_of(rows, columns)
    wire = WIRES["wire"][0]
    return {
        **{
            name: Scene(panel, readout, faults=faults, lines=lines)
            for name, (lines, faults) in WIRES.items()
        },
        "contacts": Scene(panel, readout, contacts=contacts),
        "leaks": Scene(panel, readout, leak_ohm=LEAKS),
        "leaks and wire": Scene(panel, readout, leak_ohm=LEAKS, lines=wire),
        "contacts and wire": Scene(panel, readout, lines=wire, contacts=contacts),
    }


def contacts_of(rows: int, columns: int) -> Contacts:
    lines = rows + columns
    return Contacts.of(np.linspace(10, 200, lines), np.full(lines, 20.0), rows)


def far_scenes(kind: type, rows: int, columns: int) -> dict[str, Scene | None]:
    """Return scenes whose sensed lines are read at their far ends, in every state of idle lines."""
    if not hasattr(kind, "read_at"):
        return {}
    wires: dict[str, dict[str, Any]] = {
        "wire": {"lines": Lines(30.0, 70.0)},
        "turned": {"lines": Lines(30.0, 70.0, "right", "top"), "leak_ohm": LEAKS},
        "sides": {"lines": Lines(0.0, 70.0), "contacts": contacts_of(rows, columns)},
        "joined": {"lines": Lines(30.0, 0.1), "faults": WIRES["wire and joined"][1]},
    }
    return {
        f"far-{number}-{name}": fits(
            Panel(rows, columns),
            kind(read_at="far_end", driven="columns" if number % 2 else "rows", **keys),
            **wire,
        )
        for number, keys in enumerate(FAR_KEYS[kind])
        for name, wire in wires.items()
    }


SCENES = tuple(scenes())
every_scene = pytest.mark.parametrize("scene", SCENES)


def cells_of(scene: Scene) -> Array:
    """ln r, (rows, columns)."""
    rng = np.random.default_rng(7)
    return np.asarray(np.log(3000) + rng.normal(size=scene.panel.shape))


def network_of(scene: Scene, logarithm: Array, ties: Array | None = None) -> Network:
    cells = np.exp(logarithm)
    readout = scene.circuit
    return readout.network(cells, readout.ties(cells) if ties is None else ties, scene.wiring)


def size(values: Array) -> float:
    return float(np.abs(values).max())


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_a_readout_has_few_public_names_beside_its_keys(kind: Any) -> None:
    keys = {field.name for field in fields(kind)}
    names = {name for name in dir(kind) if not name.startswith("_")} - keys
    assert len(names) <= MAX_PUBLIC_NAMES, sorted(names)


def derived(kind: type) -> list[type]:
    return [deeper for each in kind.__subclasses__() for deeper in (each, *derived(each))]


def test_every_readout_of_the_package_derives_from_the_base_itself() -> None:
    of_package = [kind for kind in derived(Readout) if kind.__module__.startswith("lampest.")]
    assert {ModulesReadout, ParallelDividers, TwoPointReadout} <= {*of_package}
    assert {kind.__bases__ for kind in of_package} == {(Readout,)}


@every_scene
def test_the_forward_product_is_the_derivative(scene: Scene) -> None:
    """y(u + h·p) − y(u) − h·J·p falls as h²: a hundredfold where h falls tenfold."""
    readout = scene.circuit
    logarithm = cells_of(scene)
    ties = readout.ties(np.exp(logarithm))
    step = np.random.default_rng(2).normal(size=scene.panel.shape)
    network = network_of(scene, logarithm, ties)
    first = network.reading()
    slope = network.forward(step)

    def remainder(length: float) -> float:
        return size(
            network_of(scene, logarithm + length * step, ties).reading() - first - length * slope
        )

    large = remainder(100 * STEP)
    assert large < MAX_CURVATURE * 100 * STEP * size(slope)
    assert remainder(10 * STEP) < 2 * 0.1**2 * large + 10 * CANCELLATION * size(first)


@every_scene
def test_the_second_order_is_the_derivative_of_the_adjoint(scene: Scene) -> None:
    """d(Jᵀw) along p = H·p − Jᵀw∘p, by central differences."""
    readout = scene.circuit
    logarithm = cells_of(scene)
    ties = readout.ties(np.exp(logarithm))
    step, weights = np.random.default_rng(3).normal(size=(2, *scene.panel.shape))
    network = network_of(scene, logarithm, ties)
    second = network.second_order(weights)
    forward, second_order = second.products(step)
    assert_allclose(
        forward, network.forward(step), rtol=ROUNDING, atol=CANCELLATION * size(forward)
    )
    assert_allclose(
        (second.matrix() @ step.ravel()).reshape(second_order.shape),
        second_order,
        atol=ROUNDING * size(second_order),
    )
    ends = [
        network_of(scene, logarithm + sign * STEP * step, ties).adjoint(weights) for sign in (1, -1)
    ]
    expected = (ends[0] - ends[1]) / (2 * STEP)
    assert_allclose(
        second_order - network.adjoint(weights) * step,
        expected,
        atol=MAX_DIFFERENCE_ERROR * size(expected),
    )


@every_scene
def test_the_sensitivity_is_the_matrix_of_both_products(scene: Scene) -> None:
    network = network_of(scene, cells_of(scene))
    sensitivity = network.sensitivity()
    step, weights = np.random.default_rng(4).normal(size=(2, *scene.panel.shape))
    near = ROUNDING * size(sensitivity)
    forward, adjoint = network.forward(step), network.adjoint(weights)
    assert_allclose(forward.ravel(), sensitivity @ step.ravel(), atol=near)
    assert_allclose(adjoint.ravel(), sensitivity.T @ weights.ravel(), atol=near)
    assert_allclose(network.own_response().ravel(), np.diag(sensitivity), atol=near)
    some = np.random.default_rng(8).random(scene.panel.shape) < 0.4
    solved_ones = [network]
    if isinstance(network, JoinedNetwork):
        solved_ones = [address.network for part in network.parts for address in part.addresses]
    for solved in solved_ones:
        assert isinstance(solved, SolvedNetwork)
        assert_allclose(solved.sensitivity(some), solved.sensitivity()[some.ravel()], rtol=1e-9)


@pytest.mark.parametrize("scene", [made for made in SCENES if made.values[0].contacts is not None])
def test_the_response_to_contacts_is_the_derivative(scene: Scene) -> None:
    readout = scene.circuit
    logarithm = cells_of(scene)
    shape = scene.panel.shape
    ties = readout.ties(np.exp(logarithm))
    ohm = scene.contacts.mean(shape)
    response = contact_responses([network_of(scene, logarithm, ties)]).reshape(*shape, -1)
    for line in range(sum(shape)):
        step = 0.1 * np.eye(sum(shape))[line]
        ends = [
            replace(scene, contacts=Contacts.of(ohm + sign * step, ohm, shape[0]))
            for sign in (1, -1)
        ]
        high, low = (network_of(end, logarithm, ties).reading() for end in ends)
        assert_allclose(
            response[..., line], (high - low) / 0.2, atol=MAX_DIFFERENCE_ERROR * size(response)
        )


def is_one_network(scene: Scene) -> bool:
    """Whether one impedance gives all readings; tests/oracles/test_far_ends.py has the others."""
    ties = equation_of(scene.circuit, *scene.panel.shape).ties
    return len(ties) == 1 and not np.isinf(ties).any()


@pytest.mark.parametrize("scene", [made for made in SCENES if is_one_network(made.values[0])])
def test_the_symbolic_equation_gives_the_reading_of_the_network(scene: Scene) -> None:
    """The symbolic form of the reading, at the impedances of a netlist that is solved here."""
    readout = scene.circuit
    cells = np.exp(cells_of(scene))
    rows, columns = scene.panel.shape
    impedance = impedance_of(cells, scene, readout.ties(cells))
    diagonal = np.diag(impedance)
    own_row = np.tile(diagonal[:rows, None], columns)
    own_column = np.tile(diagonal[None, rows:], (rows, 1))
    entries = [own_row, own_column, impedance[:rows, rows:]]
    symbols = [casadi.SX.sym(name, rows, columns) for name in ("row", "column", "mutual")]
    excitations = equation_of(readout, rows, columns).excitations(readout.ties(cells)[None])
    if excitations is not None:
        volt = impedance @ excitations[0]
        entries += [np.tile(volt[:rows, None], columns), np.tile(volt[None, rows:], (rows, 1))]
        symbols += [casadi.SX.sym(name, rows, columns) for name in ("at_row", "at_column")]
    equation = casadi.Function(
        "equation", symbols, [equation_of(readout, rows, columns).reading(*symbols)]
    )
    expected = np.array(equation(*entries))
    assert_allclose(
        network_of(scene, np.log(cells)).reading(), expected, atol=ROUNDING * size(expected)
    )
    assert_allclose(
        readout.exact_reading(cells, scene.wiring), expected, atol=ROUNDING * size(expected)
    )


@every_scene
def test_a_simulation_records_the_reading_of_the_network(scene: Scene) -> None:
    rows, columns = scene.panel.shape
    cells = np.exp(cells_of(scene))
    recorded = simulated(scene.circuit, cells[None], scene, np.zeros(rows), np.zeros(columns))[0]
    expected = scene.circuit.to_recorded(network_of(scene, np.log(cells)).reading(), scene)
    assert_allclose(recorded, expected, atol=ROUNDING * size(expected))


@pytest.mark.parametrize("across", ["reference", "sensor"])
def test_channels_of_a_simulation_are_those_of_a_scene(across: str) -> None:
    readout = TwoPointReadout(measured_across=across, input_ohm=20_000.0)
    rows, columns = np.array([100.0, 150.0]), np.array([30.0, 0.0, 60.0])
    scene = Scene(Panel(2, 3), readout)
    named = Scene(Panel(2, 3), readout, SeriesPerLine(tuple(rows), tuple(columns)))
    cells = np.geomspace(500.0, 20_000.0, 6).reshape(1, 2, 3)
    expected = simulated(readout, cells, named, np.zeros(2), np.zeros(3))
    assert_allclose(simulated(readout, cells, scene, rows, columns), expected, rtol=1e-12)


@every_scene
def test_recorded_readings_and_volts_lead_back_to_the_reading(scene: Scene) -> None:
    """network ↔ recorded ↔ volt; readings are positive.

    Recorded values move as `direction` says, σ by the slope of `from_recorded`; bounds hold the
    cells.
    """
    readout = scene.circuit
    cells = np.exp(cells_of(scene))
    reading = readout.exact_reading(cells, scene.wiring)
    recorded = readout.to_recorded(reading, scene)
    near = ROUNDING * size(recorded)
    assert_allclose(readout.from_recorded(recorded, scene), reading, rtol=ROUNDING, atol=near)
    assert_allclose(
        readout.recorded_from_volt(readout.volt_from_recorded(recorded)),
        recorded,
        rtol=ROUNDING,
        atol=near,
    )
    increase = readout.from_recorded(recorded + 1e-6 * size(recorded), scene) - reading
    assert np.all(np.sign(increase) == nominal_terminations(readout).sign)
    assert np.all(reading > 0) and np.all(readout.sigma(recorded) >= 0)
    step = 1e-6 * np.abs(recorded)
    ends = [readout.from_recorded(recorded + sign * step, scene) for sign in (1, -1)]
    slope = np.abs(ends[0] - ends[1]) / (2 * step)
    assert_allclose(
        readout.sigma_of_reading(recorded, 0.01 * recorded), 0.01 * recorded * slope, rtol=1e-6
    )
    least, _ = Bounds(upper="none").limits(readout, reading, None, scene.wiring)
    assert np.all(least <= cells * (1 + ROUNDING))
    assert np.all(readout.start(reading, (1e-9 * cells, 1e9 * cells)) > 0)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_the_apparent_resistance_of_a_lone_cell_is_its_resistance(kind: Any) -> None:
    cell = np.array([[700.0]])
    readout = next(example for example in examples(kind) if fits(Panel(1, 1), example) is not None)
    assert_allclose(readout.apparent_resistance(readout.exact_reading(cell)), cell, rtol=ROUNDING)


def test_a_voltage_that_noise_makes_negative_is_an_upper_bound() -> None:
    class Shifted(LoadedColumnsReadout):
        def from_recorded(self, recorded: Array, scene: Any) -> Array:
            return recorded - 1.0

    recorded = np.array([[2.0, 0.999], [1.5, 1.2]])
    readings = Readings.of(Scene(Panel(2, 2), Shifted()), recorded)
    assert readings.side.tolist() == [[0, -1], [0, 0]]
    assert 0 < readings.value[0, 1] < MAX_STAND_IN * readings.value[1, 1]


@every_scene
def test_readings_grow_with_all_cells_where_the_kind_is_homogeneous(scene: Scene) -> None:
    readout = scene.circuit
    logarithm = cells_of(scene)
    single, triple = (readout.exact_reading(factor * np.exp(logarithm)) for factor in (1, 3))
    assert (size(triple - 3 * single) < ROUNDING * size(triple)) == readout.two_point
