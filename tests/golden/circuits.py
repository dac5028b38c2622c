"""Rows of panels, readouts, films and loads."""

from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

import lampest as lp
from lampest.apps.film.memory import FilmKnown, FilmMemory, drift_sd
from lampest.apps.film.pressure import (
    pressure_of,
    response_sd,
    scatter_sd,
    total_force,
)
from lampest.apps.film.tare import TareWatch
from lampest.apps.recognition import mouth_model
from lampest.apps.recognition.disc_search import TEMPLATES, DiscSearch
from lampest.files.typed import members_of, shipped
from lampest.inference.readings.free_tests import free_tests, largest_series_ohm
from lampest.inference.unobservable import unobservable_numbers
from lampest.panel import difference_network, effects
from lampest.panel.circuit import nominal_terminations
from lampest.panel.conditions import water_pressure
from lampest.panel.effects import error_columns, own_errors, shared_effects
from lampest.panel.effects.line_effect import effect_on_readings, line_effects
from lampest.panel.kirchhoff import NormalByLines, Stencil
from lampest.panel.panel import EachModule, Modules
from lampest.panel.readouts import AnyReadout, channel_memory
from lampest.panel.readouts.converter import (
    averaged_variance,
    converter_in_words,
    noise_of_variance,
    noise_volt,
    rails_reached,
    sigma_code,
)
from lampest.panel.readouts.floating import common_step
from lampest.panel.readouts.starts import least_cells, nearly_shorted, resolution
from lampest.panel.readouts.tolerances import (
    channel_errors,
    line_numbers,
    off_by,
    reference_error,
    simulated,
)
from lampest.panel.response import ratio_from_pressure
from lampest.panel.scene import OwnOfModule, scene_text
from lampest.recording.readings import Readings
from lampest.recording.shapes import AnyShape
from lampest.recording.shapes.disc import annulus_mm2, bearing_kpa, contact_of_weight
from lampest.recording.shapes.kinds import RoundShape

Thunk = Callable[[], Any]
Rows = dict[str, Thunk]
PANEL = lp.Panel(4, 5)
LISTED = lp.Panel(
    4,
    5,
    cells=tuple((j, k, 9.0 * k + j, 11.0 * j) for j, k in np.ndindex(4, 5) if j + k),
)
PER_LINE = lp.SeriesPerLine(rows=(60.0, 70.0, 80.0, 90.0), columns=65.0)
CONTACTS = lp.Contacts.of(np.linspace(10, 90, 9), np.linspace(5, 25, 9), 4)
MODULES = lp.Panel(modules=Modules(1, 2, EachModule(3, 4), seam_mm=4.0))


# Panels and readouts


def scenes() -> dict[str, lp.Scene]:
    """One of every readout by default, and every other circuit that a scene may have."""
    two = lp.TwoPointReadout(noise_lsb=0.7)
    return {kind.__name__: lp.Scene(PANEL, kind()) for kind in members_of(AnyReadout)} | {
        "noisy": lp.Scene(PANEL, two, 140.0),
        "sensor": lp.Scene(
            PANEL,
            lp.TwoPointReadout(measured_across="sensor", floor_code=3, adc_bits=12, noise_lsb=0.0),
            20.0,
        ),
        "series of lines": lp.Scene(
            PANEL, replace(two, passes_volt=(0.2, 3.9)), PER_LINE, converter_memory=0.02
        ),
        "wire": lp.Scene(PANEL, two, lines=lp.Lines(30.0, 7.0, "right", "top")),
        "contacts": lp.Scene(
            PANEL, two, contacts=CONTACTS, lines=lp.Lines(column_ohm_per_cell=9.0)
        ),
        "joined": lp.Scene(
            PANEL, two, faults=lp.Faults(joined_rows=((0, 2),), joined_columns=((1, 2),))
        ),
        "faults": lp.Scene(
            PANEL, two, 140.0, faults=lp.Faults(open=((1, 1),), shorted=((2, 3),), dead_rows=(0,))
        ),
        "holes": lp.Scene(LISTED, two, 140.0),
        "floating": lp.Scene(
            PANEL,
            lp.LoadedColumnsReadout(driven="columns", load_ohm=3e3, drive_ohm=90.0, input_ohm=1e5),
        ),
        "diodes": lp.Scene(
            PANEL, lp.LoadedColumnsReadout(polarity="down", diode=lp.Diode(), noise_lsb=1.0)
        ),
        "wired pull-ups": lp.Scene(
            PANEL, lp.LoadedColumnsReadout(drive_ohm=50.0), lines=lp.Lines(9.0, 3.0)
        ),
        "grounded one": lp.Scene(
            PANEL,
            lp.GroundedReadout(sense="one", driven="columns", load_ohm=800.0, sense_ohm=40.0),
        ),
        "amplifiers": lp.Scene(
            PANEL,
            lp.VirtualGroundReadout(
                driven="columns",
                drive_ohm=(50.0, 60, 70, 80, 90),
                sense_ohm=30.0,
                feedback_ohm=200.0,
                drive_volt=1.1,
                converter_volt=3.3,
                noise_lsb=(0.5, 1, 0.4, 0, 2),
            ),
        ),
        "modules": lp.Scene(
            MODULES, two, 140.0, modules=(OwnOfModule((0, 1), series_resistance_ohm=90.0),)
        ),
    }


def cells_of(shape: tuple[int, ...], seed: int = 7, spread: float = 0.6) -> lp.Array:
    """Resistances in ohm, with a pressed corner and a sucked cell."""
    cells = 3000 * np.exp(spread * np.random.default_rng(seed).standard_normal(shape))
    cells[..., :2, :2] *= 0.3
    cells[..., 2, 1] *= 8.0
    return np.asarray(cells)


def network_of(scene: lp.Scene) -> Any:
    cells = np.where(
        scene.open_cells, np.inf, np.where(scene.shorted_cells, 0.01, cells_of(scene.panel.shape))
    )
    ties = scene.circuit.ties(0.3 * cells_of(scene.panel.shape), scene.parts)
    return scene.circuit.network(cells, ties, scene.wiring)


def network_row(scene: lp.Scene) -> dict[str, Any]:
    network = network_of(scene)
    rng = np.random.default_rng(1)
    step, weights = rng.standard_normal((2, *scene.panel.shape))
    second = network.second_order(weights)
    nodes = np.array([1, 6, 7])
    row = {
        "reading": network.reading(),
        "forward": network.forward(step),
        "adjoint": network.adjoint(weights),
        "sensitivity": network.sensitivity(),
        "own": network.own_response(),
        "products": second.products(step),
        "second adjoint": second.adjoint(),
        "second": second.matrix(),
    }
    if scene.panel.modules is None:
        row |= {
            "some": network.sensitivity()[np.ix_(nodes[:2], nodes)],
            "some second": second.matrix()[np.ix_(nodes, nodes)],
            "potentials": network.potentials().T,
            "by lines": by_lines(network.normal_by_lines(weights**2)),
            "wire": difference_network.wire_responses(network, scene.lines or lp.Lines()),
        }
    if scene.wiring is not None:
        row["contacts"] = difference_network.contact_responses([network])
    return row


def by_lines(parts: NormalByLines) -> dict[str, Any]:
    mixed = parts.mixed.matrix()
    if len(mixed):
        # Infinite of lines without cells, whose products with others are unknown.
        alone = parts.mixed.diagonal[0, 1]
        squared = mixed[len(alone) :, len(alone) :]
        squared[squared == 0] = (0 * alone[:, None] * alone)[squared == 0]
    return {"own": parts.own, "along": parts.along, "mixed": mixed}


def readout_row(scene: lp.Scene) -> dict[str, Any]:
    circuit = scene.circuit
    network = network_of(scene)
    reading = network.reading()
    recorded = circuit.to_recorded(reading, scene)
    readings = Readings.of(scene, recorded)
    value = reading
    sigma = np.abs(readings.sigma)
    chosen = np.indices(reading.shape).sum(axis=0) % 3 > 0
    cells = np.where(np.isfinite(network.cell_resistance), network.cell_resistance, 1e7)
    volt = circuit.volt_from_recorded(recorded)
    rng = np.random.default_rng(2)
    channels = rng.uniform(0, 9, reading.shape[0]), rng.uniform(0, 9, reading.shape[1])
    row = {
        "recorded": recorded,
        "back": circuit.from_recorded(recorded, scene),
        "sigma": readings.sigma,
        "side": readings.side,
        "seen": readings.seen,
        "apparent": circuit.apparent_resistance(value),
        "uniform": circuit.uniform_start(value),
        "start": circuit.start(value, (np.full(value.shape, 1e-6), np.full(value.shape, 1e6))),
        "least": least_cells(circuit, value, sigma),
        "least without noise": least_cells(circuit, value, None),
        "shorted": nearly_shorted(circuit, value),
        "resolution": resolution(circuit, value, sigma),
        "step": common_step(value[chosen] * 1.02, value[chosen]) if circuit.two_point else 1.0,
        "rails": circuit.rails(),
        "series": largest_series_ohm(circuit, value[None], sigma[None]),
        "codes": circuit.code_from_volt(volt),
        "volt": circuit.volt_from_code(np.array([0.0, 12.25, 900.0])),
        "sums": circuit.recorded_from_volt(circuit.volt_from_code(np.array([[4000, 9000]]) / 20)),
        "noise": noise_volt(circuit),
        "sigma of codes": sigma_code(circuit),
        "averaged": averaged_variance(circuit, 0.4),
        "noise of variance": noise_of_variance(circuit, 0.02),
        "shared": np.concatenate(
            [
                reference_error(circuit, cells, value, scene, 0.01)[None],
                channel_errors(circuit, cells, value, scene, 2.0),
            ]
        ),
        "off": off_by(circuit, 0.01),
        "numbers": line_numbers(circuit),
        "direction": nominal_terminations(circuit).sign,
        "texts": [
            circuit.description(),
            rails_reached(circuit, recorded),
            converter_in_words(circuit),
            scene_text(scene),
        ],
        "tests": [
            (test.law, test.excess, test.count, test.single)
            for test in free_tests(circuit, value[None], sigma[None])
        ],
    }
    if scene.panel.modules is None:
        row |= {
            "simulated": simulated(circuit, cells[None], scene, *channels),
            "beyond": circuit.from_recorded(
                simulated(circuit, network.cell_resistance, scene, *channels), scene
            )
            - network.reading(),
            "memory": channel_memory.with_memory(circuit, 0.1, volt[None]),
            "forgotten": channel_memory.without_memory(circuit, 0.1, recorded, sigma),
        }
    return row


def scene_row(scene: lp.Scene) -> dict[str, Any]:
    panel = scene.panel
    names = (
        "blind",
        "requested",
        "open_cells",
        "shorted_cells",
        "broken",
        "whole",
        "parts",
        "series_ohm",
        "series_text",
    )
    row = {name: getattr(scene, name) for name in names} | {"in series": scene.specified_in_series}
    row |= {
        name: getattr(panel, name) for name in ("present", "extents_mm", "places_mm", "neighbours")
    }
    return row | {
        "alike": [numbers for _, numbers in scene.alike],
        "unobservable": unobservable_numbers(scene),
        "dead": scene.dead_modules,
        "with series": scene_text(scene.with_series(33.0)),
        "centres": panel.centres_mm(),
    }


def errors_row(scene: lp.Scene) -> dict[str, Any]:
    scene = (
        scene if scene.systematic or scene.readout is None else replace(scene, systematic="typical")
    )
    network = network_of(scene)
    reading = network.reading()
    sizes = effects.systematic_of(scene)
    shared = effects.Shared.of(scene)
    every = replace(
        sizes,
        series_tolerance_ohm=9.0,
        inl_lsb=0.5,
        wire_ohm_per_cell=0.2,
        reading_error=0.02,
    )
    known = [
        None,
        *(
            effects.Shared(effects.Possible(replace(sizes, reading_error=size)), scene)
            for size in (None, 0.01, 0.05)
        ),
    ]
    return {
        "usual": sizes,
        "beyond": [
            beyond and (beyond.possible and beyond.possible.sizes, beyond.contact_root)
            for each in known
            for beyond in [shared.beyond(each)]
        ]
        + [each.beyond(known[2]) is None for each in known[1:]],
        "columns": error_columns(shared_effects(), network, reading, scene, every),
        "shared": shared.columns(network, reading),
        "own": own_errors(reading, scene, 0.02),
        "effects": [
            (
                kind.__name__,
                kind(lines, size=kind.prior).sentence(panel_rows),
                effect_on_readings([kind(lines, size=kind.prior)], scene, network),
            )
            for kind in line_effects()
            for panel_rows in [len(reading)]
            for lines in list(kind.places(*reading.shape))[:2]
        ],
    }


def stencil_row() -> list[lp.Array]:
    """The inverse over some free cells, and over all, of a network's crosstalk by lines."""
    cells = cells_of(PANEL.shape)
    rng = np.random.default_rng(2)
    readings = lp.two_point_resistance(cells)
    values = rng.standard_normal(PANEL.shape)
    return [
        Stencil.of(1 / cells, readings, rng.random(PANEL.shape) < share).solve(values)
        for share in (0.7, 1.1)
    ]


def of_panel() -> Rows:
    rows: Rows = {"stencil": stencil_row}
    for across in ("reference", "sensor"):
        readout = lp.TwoPointReadout(noise_lsb=0.7, input_ohm=3e4, measured_across=across)
        rows[f"readout with an input {across}"] = partial(
            readout_row, lp.Scene(PANEL, readout, 140.0)
        )
    for name, scene in scenes().items():
        kinds = [network_row, readout_row, scene_row] + [errors_row] * (scene.panel.modules is None)
        for kind in kinds:
            rows[f"{kind.__name__.removesuffix('_row')} of {name}"] = partial(kind, scene)
    return rows


# Films and loads

PRESSURES = np.array([-12.0, -8.0, -3.0, -0.5, 0.0, 0.2, 1.0, 4.0, 11.0, 26.0, 39.0, 60.0])
COLD = lp.Temperature(-0.003, 20.0, 8.0, 0.001)
FILM = lp.Film(hysteresis=0.24, creep_per_decade=0.05, deviation=0.1, cell_spread=0.1)
RESPONSES = {
    "published": lp.PublishedResponse(),
    "table": lp.TableResponse(
        pressure_kpa=(0.0, 2, 8, 30),
        resistance_ohm=(4000.0, 2500, 900, 300),
        sd=(0.1, 0.1, 0.2, 0.3),
    ),
    "power": lp.PowerResponse(
        exponent=0.7,
        scale_kpa=3.0,
        sd=0.05,
        gain=((0.8, 1.0, 1.2),) * 2,
        gain_sd=((0.1, 0.2, 0.3),) * 2,
    ),
}
SHAPES = {
    "rod": lp.Rod(
        centre_mm=(21.0, 14.0), diameter_mm=23.0, mass_g=300.0, tilt=0.3, tilt_direction_deg=70.0
    ),
    "ring": lp.Ring(
        centre_mm=(21.0, 14.0), inner_diameter_mm=15.0, outer_diameter_mm=26.0, mass_g=500.0
    ),
    "suction_cup": lp.SuctionCup(
        centre_mm=(21.0, 14.0),
        inner_diameter_mm=18.0,
        outer_diameter_mm=26.0,
        pressure_kpa=-8.0,
    ),
    "oral_disc": lp.OralDisc(
        centre_mm=(21.0, 14.0),
        diameter_mm=28.0,
        rim_width_mm=5.0,
        pressure_kpa=-10.0,
        rim_kpa=60.0,
        tilt=0.2,
        elongation=1.3,
        elongation_deg=30.0,
        unevenness=0.3,
        lobes=3,
        unevenness_deg=50.0,
    ),
    "block": lp.Block(
        centre_mm=(18.0, 12.0),
        length_mm=25.0,
        width_mm=12.0,
        mass_g=400.0,
        angle_deg=25.0,
        tilt=0.2,
    ),
}
LOADED = {
    "air": lp.Scene(lp.Panel(2, 3), response=lp.PublishedResponse()),
    "cold water": lp.Scene(
        lp.Panel(2, 3), response=lp.PublishedResponse(), water=lp.Water(70.0), temperature=COLD
    ),
    "film": lp.Scene(
        lp.Panel(2, 3),
        response=lp.PublishedResponse(),
        film=replace(FILM, curvature_per_m=4.0),
        water=lp.Water(50.0),
    ),
    "creep": lp.Scene(
        lp.Panel(2, 3),
        response=lp.PublishedResponse(),
        film=lp.Film(creep_per_decade="auto", hysteresis="auto"),
    ),
    "gains of a table": lp.Scene(
        lp.Panel(2, 3),
        response=replace(RESPONSES["table"], gain=((0.7, 1.0, 1.4),) * 2),
    ),
    "gains": lp.Scene(
        lp.Panel(2, 3),
        response=RESPONSES["power"],
        systematic=lp.Systematic(response_sd=0.1),
        faults=lp.Faults(open=((1, 1),)),
    ),
}


def response_row(response: Any) -> dict[str, Any]:
    logarithm = response.logarithm(PRESSURES)
    ratio = ratio_from_pressure(PRESSURES, response)
    row = {"logarithm": logarithm, "pressure": response.pressure(logarithm), "ratio": ratio}
    return row | {
        "sd": response.curve_sd(PRESSURES),
        "told": response.told_kpa,
        "gains": response.gains,
    }


def film_row() -> dict[str, Any]:
    scene = LOADED["film"]
    times = np.arange(1.0, 7)
    zero = np.zeros((2, 3))
    pressure = np.array([0.0, 20, 8, -5, 12, 0])[:, None, None] + np.arange(6).reshape(2, 3) / 5
    states = [
        FilmMemory.at_rest(
            zero + 0.24, zero + 0.05, zero + 0.9, water_pressure(scene.panel, scene.water)
        )
    ]
    answers = []
    for part in pressure:
        memory, answer = states[-1].answered(part, 30.0)
        states.append(memory)
        answers.append(answer)
    last = states[-1]
    known = FilmKnown.specified(lp.Film(creep_per_decade="auto", hysteresis=0.2, deviation=0.1))
    change = np.stack(answers)
    estimated = known.estimated(change, np.full(change.shape, 0.01), 40.0 * times)
    failed = np.where(np.isin(times, (1, 4))[:, None, None], np.nan, change)
    beside_failed = known.estimated(failed, np.full(change.shape, 0.01), 40.0 * times)
    return {
        "answers": change,
        "pressure": last.pressure(answers[1], 5.0),
        "effective": last.effective(answers[1], 5.0),
        "observed": last.observed(answers[2], 5.0).fading(60.0),
        "at once": last.at_once(answers[3], 9.0),
        "resting": drift_sd(3.0),
        "known": [each.sentence for each in (known, estimated)],
        "beside failed frames": [beside_failed.creep, beside_failed.residue, beside_failed.cells],
        "estimated": estimated.creep,
        "hysteresis": known.hysteresis,
        "known at once": estimated.at_once(change, 40.0 * times),
        "remembers": [
            lp.Film(hysteresis=loss, creep_per_decade=creep).remembers
            for loss in (0.0, 0.2)
            for creep in (0.0, 0.1)
        ],
        "bent": [
            scene.film.lowering,
            scene.film.answer,
            scene.film.answer_sd,
            scene.film.strength("creep_per_decade"),
        ],
    }


def pressure_row(scene: lp.Scene, tare: lp.Tare | None = None, failed: tuple[int, ...] = ()) -> Any:
    """Pressures of frames with load, without, and out of range, with errors, and their force."""
    frames = 12
    rows, columns = scene.panel.shape
    kpa = (
        np.linspace(0, 1, rows * columns).reshape(rows, columns)
        * np.r_[0, 0, 5, 30, 70, -6, 12, np.zeros(5)][
            :,
            None,
            None,
        ]
    )
    ratio = np.exp(-0.1 * kpa + 0.002 * np.random.default_rng(3).standard_normal(kpa.shape))
    ratio[list(failed)] = np.nan
    time = 20.0 * np.arange(frames)
    known = None if scene.film is None else FilmKnown.specified(scene.film)
    load = pressure_of(
        ratio, 0.9 * ratio, 1.2 * ratio, scene, time, known, tare, np.full(ratio.shape, 0.03)
    )
    forces = [
        total_force(
            scene,
            replace(
                load,
                **{
                    field.name: getattr(load, field.name)[frame]
                    for field in fields(load)
                    if field.name != "tared"
                },
            ),
        )
        for frame in range(frames)
    ]
    return {
        "pressure": load,
        "forces": forces,
        "sd": response_sd(scene, ratio),
        "scatter": scatter_sd(scene),
    }


def tare_row() -> list[Any]:
    """New zeros of a panel whose deviations and memories, of several sizes, grow."""
    rng = np.random.default_rng(2)
    rows = list[Any]()
    for size, memory_share in product((0.0, 0.003, 0.02, 0.07, 0.1), (0.0, 0.1, 0.5)):
        uneven = np.ones((4, 5)) if memory_share else (-1.0) ** np.indices((4, 5)).sum(axis=0)
        zero = size * uneven * (1 + 0.4 * rng.standard_normal((4, 5)))
        memory = memory_share * rng.uniform(size=(4, 5))
        watch = TareWatch(lp.Tare(frames=6))
        for number in range(40):
            change = (
                zero * (1 + number / 8) + 0.002 * rng.standard_normal((4, 5)) + 0.2 * (number == 13)
            )
            change[1, 2] = np.nan if number > 9 else change[1, 2]
            watch, mean, reason = watch.after(
                change * (np.nan if number == 4 else 1.0), memory, 20.0 * number
            )
            rows += [[size, memory_share, number, mean, reason]] if reason else []
    return rows


def shape_row(load: lp.Shape) -> dict[str, Any]:
    row = {
        "maps": [load.mean_pressure(panel, 6.0) for panel in (PANEL, LISTED)],
        "reach": load.reach_mm,
    }
    if isinstance(load, RoundShape):
        row["disc"] = load.disc()
    return row


def mouth_model_row() -> dict[str, Any]:
    mean, sd = mouth_model.mean_and_sd(PANEL)
    disc = SHAPES["oral_disc"].disc()
    start = mouth_model.start_of(disc)
    steps = mouth_model.numbers(start[:, None] + 1e-30j * np.eye(len(start)))
    discs = [SHAPES[name].disc() for name in ("ring", "suction_cup")]
    discs += [
        disc._replace(diameter_mm=2.0, inner_mm=0.1),
        disc._replace(rim_kpa=0.01, suction_kpa=-0.02),
    ]
    return {
        "mean": mean,
        "sd": sd,
        "priors": mouth_model.priors(PANEL),
        "start": start,
        "map": mouth_model.pressure(PANEL, 6.0, start),
        "disc": mouth_model.disc_of(start),
        "slopes": steps[:8].imag / 1e-30,
        "starts": [mouth_model.start_of(each) for each in discs],
    }


def of_loads() -> Rows:
    search = DiscSearch.over(PANEL, 6.0, TEMPLATES[-3:] + TEMPLATES[:2])
    normal = np.diag(np.linspace(50, 90, 20))
    pull = np.linspace(-9, 40, 20)
    faulty = [
        np.where(np.arange(20) == 7, far, np.tile((0.0, 0.2, -0.2, 0.1), 5)).reshape(4, 5)
        for far in (-40, 40)
    ]
    assert {kind.kind for kind in shipped(AnyShape)} == SHAPES.keys()
    return (
        {
            f"response {name}": partial(response_row, response)
            for name, response in RESPONSES.items()
        }
        | {f"shape {name}": partial(shape_row, load) for name, load in SHAPES.items()}
        | {"model of a mouth": mouth_model_row}
        | {f"pressure in {name}": partial(pressure_row, scene) for name, scene in LOADED.items()}
        | {
            "pressure tared": partial(pressure_row, LOADED["air"], lp.Tare(frames=5)),
            "pressure tared on a film": partial(pressure_row, LOADED["film"], lp.Tare(frames=5)),
            "pressure beside failed frames": partial(
                pressure_row, LOADED["film"], lp.Tare(frames=5), (0, 4, 8)
            ),
            "memory of a film": film_row,
            "tare": tare_row,
            "search of discs": lambda: (
                search.faint,
                search.changes,
                search.matched(normal),
                search.lies_on(pull.reshape(4, 5)),
                [search.lies_on(logarithm) for logarithm in faulty],
            ),
            "outlines": lambda: [function(*numbers) for function, numbers in OUTLINES],
        }
    )


OUTLINES = (
    (annulus_mm2, (10.0, 20.0)),
    (contact_of_weight, (300.0, 400.0)),
    (bearing_kpa, (-9.0, 15.0, 24.0)),
)
