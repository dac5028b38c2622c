"""Rows of tables, pictures, messages and commands."""

import json
import os
import re
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import chdir
from dataclasses import replace
from functools import cache, partial
from itertools import product
from math import nan
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock, patch

import h5py
import numpy as np
from attack.attack import called
from golden.checks import ON_FILM, WATCHED, answer_row, detected, tiled
from golden.circuits import COLD, FILM, Rows, cells_of
from golden.estimates import ESTIMATORS, gapped, in_scene, simulated
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from support import invented_case

import lampest as lp
from lampest.apps.film.pressure import Force
from lampest.apps.live import publish, watcher
from lampest.apps.live.engine import Engine, with_picture
from lampest.apps.live.handover import News
from lampest.apps.live.message import (
    HISTORY_FRAMES,
    Message,
    Picture,
    Point,
    View,
    acknowledged,
    view_text,
    with_detected,
)
from lampest.apps.live.publish import publish_at
from lampest.apps.live.run import METHODS as LIVE
from lampest.apps.live.run import scan_of
from lampest.apps.live.state import PanelState, solved_scan, verdict_of
from lampest.apps.live.watcher import Scan, Unloaded, Watched, in_one_batch
from lampest.apps.page import compared, page
from lampest.apps.recognition import breathing
from lampest.apps.recognition.attachment import Attachment
from lampest.apps.recognition.detect import pressed
from lampest.apps.recognition.detect.answer import Detected, write_detections
from lampest.apps.recognition.detect.detection import detect_results
from lampest.apps.recognition.detect.timeline import timeline
from lampest.files.process import in_bytes
from lampest.panel.panel import EachModule, Modules
from lampest.report import compare, plots, words
from lampest.report.info import describe, shaded_map, text_map, understood_lines
from lampest.report.plots import PLOTS, maps, style
from lampest.report.reconstruction import Reconstruction
from lampest.report.strongest import strongest_index
from lampest.report.words import digits

# Results, tables, pictures and messages

SPOKEN = ("noisy", "contacts", "faults", "diodes", "holes")
METHODS = ("LSM", "LSR-dCR", "LSR-gCR")


@cache
def invented() -> tuple[lp.CaseResult, ...]:
    """Cases with times, failures and error bars that no solver made; two recordings."""
    cases = [
        invented_case(name, mouth, (4, 6, 5), failed=(1,) * (name == "LSR-gCR"))
        for mouth in (
            "mouth",
            "second",
        )
        for name in METHODS
    ]
    rng = np.random.default_rng(9)
    scene = replace(cases[0].scene, response=lp.PublishedResponse())
    filled = []
    for case in cases:
        errors = 0.05 * case.cell_resistance
        own = np.abs(rng.normal(0.05, 0.01, case.cell_resistance.shape))
        kpa = np.where(case.relative_change < 0, -0.2 * case.relative_change, 0.0)
        known = {
            "sigma": 0.01 * case.measured,
            "sigma_baseline": 0.01 * case.measured_baseline,
            "cell_resistance_errors": errors,
            "cell_resistance_lower": case.cell_resistance - 2 * errors,
            "cell_resistance_upper": case.cell_resistance + 2 * errors,
            "relative_change_errors": np.full(errors.shape, 5.0),
            "relative_change_lower": case.relative_change - 9,
            "relative_change_upper": case.relative_change + 12,
            "sigma_own": own,
            "sigma_common": own / 3,
            "resolution": 1 - own,
            "data_share": 1 - own / 2,
            "scene": scene,
            "reading_sigma": 0.02 * case.measured,
            "warnings": "a warning" * (case.estimator == "LSM"),
            "weight_sigma": {"gradient": np.full(4, 0.3)},
            "missing_readings": np.array([0, 2, 0, 1]),
            "bound_readings": np.array([0, 0, 3, 0]),
            "model_mark": "yes",
            "model_sentence": "the circuit explains the readings",
            "noise_learned": "scatter 1.1",
        }
        pressures = {
            "pressure": kpa,
            "pressure_errors": 0.1 * kpa,
            "pressure_own": 0.1 * kpa,
            "pressure_common": 0.02 * kpa,
            "pressure_lower": 0.7 * kpa,
            "pressure_upper": 1.3 * kpa,
            "saturated": (kpa > 15).astype(np.uint8),
            "pressing": (kpa > 1).astype(np.uint8),
        }
        for name, values in (known | pressures).items():
            if (
                isinstance(values, np.ndarray)
                and values.shape == errors.shape
                and name not in ("sigma", "reading_sigma")
            ):
                values[~case.solved] = np.nan if values.dtype.kind == "f" else 0
        filled.append(replace(case, **known, extra=pressures))
    return tuple(filled)


def swept_cases() -> tuple[lp.CaseResult, ...]:
    """An estimator without swept keys, one with a swept weight, and one with two."""
    pairs = product((1.0, 10.0), ("L2", "L1"))
    swept = [
        {},
        *({"g.weight": 10.0**n} for n in range(3)),
        *({"g.weight": n, "loss": loss} for n, loss in pairs),
    ]
    return tuple(
        replace(
            invented_case(f"a{n}", shape=(2, 4, 5)), swept_json=json.dumps(keys) if keys else ""
        )
        for n, keys in enumerate(swept)
    )


def table_row() -> dict[str, Any]:
    base = lp.StepFigures(0.2, 0.1, 3.0, 1.0)
    later = lp.StepFigures(0.4, 0.3, 5.0, 2.0)
    figures = (
        {"all": base},
        {"initial": base},
        {"following": base},
        {"all": base, "following": later},
    )
    published = {"LSM": lp.PublishedFigures(all=base)}
    rows = compare.compare(lp.Results(invented(), published), "a.h5") + compare.compare(
        lp.Results(swept_cases()),
        "b.h5",
    )
    blocks = compare.screen_blocks(rows, published=True)
    repeated = [
        row | {"recording": f"{row['recording']}{number}"} for number in range(4) for row in rows
    ]
    fast = np.full(3, 1e-7)
    failed = invented_case("LSR-CR", shape=(3, 2, 3), failed=(0, 1, 2))
    bare = compare.compare(
        lp.Results((invented_case(shape=(3, 2, 3), truth=False, solve_time=fast), failed))
    )
    with tempfile.TemporaryDirectory() as folder:
        written = pressed.write_pressed(
            Path(folder, "p.csv"), pressed.pressed(lp.Results(invented()[:1]))
        ).read_text()
    lines = compare.table_lines(rows)
    quoted = [
        compare.compare(
            lp.Results(
                (replace(invented()[0], joint_start=joint),), {"LSM": lp.PublishedFigures(**known)}
            )
        )
        for joint, known in product((False, True), figures)
    ]
    return {
        "quoted": [
            [[text for key, text in row.items() if "published" in key] for row in texts]
            for texts in quoted
        ],
        "rows": rows,
        "blocks": blocks,
        "legend": compare.legend(rows, blocks),
        "notes": compare.model_notes(rows),
        "many": compare.screen_blocks(repeated),
        "csv": compare.comma_separated([lines[0], *(line.values() for line in lines[:1])]),
        "keys": compare.swept_keys(rows),
        "pressed": [
            (table.values, table.errors, table.saturated)
            for table in pressed.pressed(lp.Results(invented()))
        ],
        "pressed table": pressed.pressed_table(pressed.pressed(lp.Results(invented()))),
        "strongest": [
            strongest_index(cases) for cases in (invented()[:3], invented()[2:3], swept_cases())
        ],
        "bare": [
            compare.screen_blocks(bare, published=True),
            compare.legend(bare, compare.screen_blocks(bare)),
        ],
        "written": written,
        "none": compare.screen_blocks([]),
    }


def weights_of(cases: Sequence[lp.CaseResult]) -> str:
    return compared.weights_text([case.weights for case in cases])


def page_row() -> dict[str, Any]:
    batch = compared.Batch(
        ("a.h5",) * 6,
        compared.without_copies(
            {
                name: {case.estimator: case for case in lp.Results(invented()).of(name)}
                for name in ("mouth", "second")
            }
        )[0],
    )
    standing = compared.comparison_of(batch)
    advice = compared.advise(batch, standing)
    unknown = [replace(case, truth=None, truth_baseline=None) for case in invented()]
    blind = [
        compared.comparison_of(
            compared.Batch(
                ("b.h5",),
                {
                    name: {case.estimator: case for case in lp.Results(cases).of(name)}
                    for name in names
                },
            )
        )
        for cases, names in (
            (unknown, ("mouth",)),
            (unknown, ("mouth", "second")),
            ((invented()[0], *unknown[1:]), ("mouth",)),
        )
    ]
    by_estimator = {
        name: [case for case in invented() if case.estimator == name] for name in METHODS
    }
    optimal = invented_case(
        status=("local optimum verified",) * 3, starts=np.array([1, 7, 3]), shape=(3, 2, 3)
    )
    starts = {
        "several": [optimal] * 2,
        "one": [replace(optimal, starts=np.ones(3, dtype=int))],
        "none": invented()[:1],
    }
    failing = {"A": (), "B": (2,), "C": (0, 1, 2)}
    cases = [
        invented_case(name, "long", (40, 2, 2), failed=failed) for name, failed in failing.items()
    ]
    cases += [
        invented_case(name, recording, (2, 2, 2))
        for recording in ("second", "third")
        for name in "AB"
    ]
    uneven = [*cases, invented_case("A", "fourth", (2, 2, 2)), replace(cases[3], recording="copy")]
    half = np.where(np.arange(2)[:, None, None] < 1, cases[3].measured, 1.0)
    uneven += [replace(case, recording="half", measured=half) for case in cases[3:5]]
    pairs = [page.Disagreement(f"pair {n}", np.ones((4, 4, 5)), n + 0.123) for n in range(15)]
    tiles = list[Any]()

    def noted(shown: Sequence[maps.Tile], *_: Any, **look: Any) -> None:
        tiles.append([[(tile.title, tile.note) for tile in shown], look])

    with (
        patch.object(page, "maps_figure", noted),
        patch.object(page, "data_uri", lambda _: "data:"),
    ):
        differences = [
            page.differences(invented()[:1], 0, pairs[:count]) for count in (15, 9, 1, 0)
        ]
    alone = [invented_case("A", "r1", (2, 2, 2)), invented_case("B", "r2", (2, 2, 2))]
    batches = [cases[:3], uneven, alone]
    for faster in (0.002, 0.0075):  # errors that hardly differ, and times
        errors = {"best": (0.02, 0.008), "near": (0.0203, faster), "far": (0.0307, 0.001)}
        alike = list[lp.CaseResult]()
        for (name, (error, time)), number in product(errors.items(), range(5)):
            case = invented_case(name, f"r{number}", (2, 2, 2), solve_time=np.full(2, time))
            alike.append(replace(case, cell_resistance=case.truth * np.exp(error + 0.001 * number)))
        batches.append(alike)
    ranked = [(each, compared.Batch.of(("c.h5",), each)) for each in batches]
    judged = [compared.comparison_of(each) for _, each in ranked]
    return {
        "blind": [(each.standings, each.values, each.units) for each in blind if each is not None],
        "standings": standing.standings,
        "values": standing.values,
        "units": standing.units,
        "milliseconds": {row.estimator: row.milliseconds for row in standing.standings},
        "advice": [
            advice,
            *(
                compared.advise(each, known)
                for (_, each), known in zip(ranked, judged, strict=True)
            ),
        ],
        "matched": [
            (known.estimators, [*known.recordings], known.chosen, known.left_out)
            for known in (compared.matched(each.recordings) for _, each in ranked)
        ],
        "tables": [page.standing_table(standing), page.unit_table(standing)],
        "cases": [page.case_table(by_estimator), page.case_table(starts)],
        "differences": differences,
        "tiles": tiles,
        "figures": page.figures(invented()[0]),
        "failed": page.failures(invented()),
        "disagreements": page.disagreements(invented()[:3]),
        "doubts": page.doubts("LSM", [page.figures(case) for case in invented()[::3]]),
        "frames": page.frames_text([3, 5, 6, 7, 9]),
        "between": [
            compared.between(compared.Interval(2.131, 1.95, 2.361), "%"),
            compared.between(compared.Interval(123.4, 123.39, 123.42)),
            weights_of(invented()[:2]),
        ],
    }


def got(part: Any, *names: str) -> list[Any]:
    return [getattr(part, f"get_{name}")() for name in names]


def axes_row(axes: Axes) -> dict[str, Any]:
    images = [*axes.images, *axes.collections]
    coloured = [image for image in images if image.get_array() is not None]
    legend = axes.get_legend()
    return {
        "labels": got(axes, "xlabel", "ylabel", "title", "xscale", "yscale"),
        "limits": [*axes.get_xlim(), *axes.get_ylim()],
        "ticks": got(axes, "xticks", "yticks"),
        "texts": [
            [*got(text, "text", "position", "size", "zorder"), str(text.get_color())]
            for text in axes.texts
        ],
        "lines": [np.asarray(line.get_xydata(), dtype=float) for line in axes.lines],
        "looks": [
            got(line, "linewidth", "markersize", "zorder", "alpha")
            + list(map(str, got(line, "color", "linestyle", "marker", "markerfacecolor")))
            for line in axes.lines
        ],
        "offsets": [np.asarray(image.get_offsets(), dtype=float) for image in axes.collections],
        "widths": [image.get_linewidths() for image in axes.collections],
        "shapes": [
            np.concatenate([path.vertices for path in image.get_paths()] or [np.zeros((0, 2))])
            for image in axes.collections
        ],
        "patches": [[str(part), *got(part, "linewidth", "alpha")] for part in axes.patches],
        "place": [
            *axes.get_position().bounds,
            axes.get_visible(),
            axes.axison,
            str(axes.get_facecolor()),
        ],
        "halos": [
            [halo._gc for halo in part.get_path_effects() or ()]
            for part in (*axes.texts, *axes.collections)
        ],
        "values": [
            np.ma.filled(np.ma.asarray(image.get_array(), dtype=float), np.nan)
            for image in coloured
        ],
        "missing": [image.get_cmap().get_bad() for image in coloured],
        "range": [image.get_clim() for image in coloured],
        "legend": [text.get_text() for text in legend.get_texts()] if legend else [],
    }


def drawn_row(figure: Figure) -> dict[str, Any]:
    """The visible parts of a figure, and the numbers under them."""
    figure.draw_without_rendering()
    words = [text.get_text() for text in figure.findobj(Text)]
    return {
        "axes": list(map(axes_row, figure.findobj(Axes))),
        "size": figure.get_size_inches(),
        "words": "|".join(word for word in words if word),
        "legends": [
            [legend.get_frame_on(), legend._ncols, legend._outside_loc] for legend in figure.legends
        ],
    }


def scales_row() -> dict[str, Any]:
    values = [np.array([0.02, 3.0, 45.0, -70.0, 900.0, np.nan])]
    scales = [
        maps.change_scale(values, "a"),
        maps.banded_scale(values, "b"),
        maps.signed_scale(values, "c", 1.0, 100.0),
        maps.log_scale([np.abs(values[0])], "d"),
        maps.log_scale([np.array([1e-5, 2e-4])], "e"),
    ]
    return {
        "scales": [
            (
                scale.label,
                scale.norm(np.array([0.1, 5.0, 50.0, 500.0])),
                scale.norm.vmin,
                scale.norm.vmax,
                scale.ticks,
                scale.colours.name,
            )
            for scale in scales
        ],
        "round": [style.round_numbers(0.3, 70.0), style.round_numbers(250.0, 900.0)],
        "texts": [
            style.change_text(250.0, 100.0),
            style.change_text(-3.0, 100.0),
            style.short_title("a very long name of an estimator"),
            *(
                style.change_text(value, 10.0)
                for value in (3.71, -82.4, 9502050701.0, -1.0e5, 99999.0)
            ),
            *map(
                digits,
                (0.00123, 12345.6, -1e9, 9.9e-5, 1e-4, 999999.0, 1e6, 0.0, nan, np.inf, -np.inf),
            ),
            digits(-3050.4, 2),
            digits(12.3456, 3, 0.0123),
            *(words.text_of(value) for value in (None, nan, 0.5)),
            words.text_of(0.5, ".1f"),
            *(pressed.figure(12.345, sd) for sd in (0.0, 0.56, 1e-4)),
            *(
                words.median_text(np.array(values))
                for values in ((3.0, nan, 1.0, 8.0), (2.0, 2.0), (nan,))
            ),
            *(words.spanned(np.array(values), "ohm") for values in ((672.91, nan, 219.5), (nan,))),
            *(
                str(words.no_formula(value))
                for value in ("=1", "+1", "-1", "@a", "\ta", "\ra", "a=1", -1)
            ),
            *(in_bytes(value) for value in (999, 1000, 3 * 2**20, 26.8 * 2**30)),
        ],
    }


def shown_views() -> tuple[View, View, View]:
    """A picture, the same with an answer, and the next picture with it."""
    rng = np.random.default_rng(2)
    panel = lp.Panel(2, 3)
    change = rng.normal(0, 30, (2, 3))
    kpa = np.array([[0, 10, 30], [-5, 2, 0]]) / 1.0
    picture = Picture(
        7,
        7.5,
        50.0,
        change,
        change / 2,
        change > 20,
        Force(1.25, 0.1, 1),
        "fine",
        0.02,
        2,
        1000 + change,
        kpa,
        (kpa > 20).astype(np.uint8),
        "pressing",
        1,
    )
    view = View(
        "here",
        "LSM",
        "receiving",
        panel,
        9,
        1,
        2,
        history=tuple(Point(n, n / 2, float(n)) for n in range(9)),
        deviation=0.25,
        deviation_of=6,
        model="w",
    )
    breath = breathing.Breathing(6.0, hertz=(1.1, 0.05))
    answer = Detected.of("here", (replace(LAMPREY, breath=breath),), 4.0)
    first = with_picture(view, picture, "zero")
    second = with_detected(first, answer)
    return first, second, with_picture(second, replace(picture, number=8), "zero")


def message_row() -> dict[str, Any]:
    view = shown_views()[1]
    message = Message.of(view)
    blank = View("here", "LSM", "waiting", view.panel, recording=("closing r.h5", False))
    return {
        "blank": json.loads(view_text(blank, 9.0)),
        "errors": [pressed.figure(1.234, sd) for sd in (0.0, 0.1, 12.0, np.nan)],
        "content": message.content(60.0),
        "row": message.row(),
        "channels": message.channels(),
        "page": json.loads(view_text(view, 60.0, 3)),
        "signature": message.signature,
        "alarm": [view.alarm, acknowledged(view).alarm],
        "seen": [acknowledged(each).acknowledged for each in (view, blank)],
    }


class Element:
    """An XML element, a stream or an outlet of liblsl: a list of its parts."""

    def __init__(self, *known: Any) -> None:
        self.parts = [known[0].parts if known and isinstance(known[0], Element) else list(known)]

    def desc(self) -> "Element":
        return self

    def append_child(self, name: str) -> "Element":
        child = Element()
        self.parts.append([name, child.parts])
        return child

    def push_sample(self, *values: Any) -> None:
        self.parts.append(list(values))

    append_child_value = push_sample


def published_row() -> dict[str, Any]:
    """Messages as each protocol sends them, and sentences on those that do not get through."""
    views = shown_views()
    outlets = list[Any]()
    tried = list[Any]()
    sentences = list[str]()
    messages = [Message.of(views[number]) for number in (0, 1, 1, 2, 2, 2)]
    lsl = SimpleNamespace(
        set_config_content=str,
        IRREGULAR_RATE=0.0,
        StreamInfo=Element,
        local_clock=lambda: 5.0,
        StreamOutlet=lambda info: outlets.append(Element(info)) or outlets[-1],
    )
    clock = SimpleNamespace(
        time=lambda: 60.0, monotonic=iter((0.0, 0.1, 0.35, 0.4, 0.5, 0.7)).__next__
    )
    client = MagicMock(connect_timeout=1.0)
    answer = SimpleNamespace(is_failure=False)
    ends = [
        SimpleNamespace(rc=rc, is_published=lambda done=done: done)
        for rc, done in ((0, 1), (1, 0), *[(0, 0)] * 3)
    ]
    client.publish.side_effect = ends
    client.socket.return_value = None
    client.loop_start.side_effect = lambda: client.on_connect(None, None, None, answer)
    packets = patch(
        "pythonosc.udp_client.UDPClient.send", lambda _, bundle: outlets.append(bundle.dgram)
    )
    broker = patch("paho.mqtt.client.Client", lambda _: client)
    waited = list[Any]()
    waits = patch.object(
        publish, "waited", lambda done, most: waited.append([done(), most]) or waited[-1][0]
    )
    with (
        patch.dict(sys.modules, pylsl=lsl),
        packets,
        patch.object(publish, "time", clock),
        broker,
        waits,
    ):
        for receiver in ("lsl://panel", "osc://127.0.0.1:9", "mqtt://me:no@h/t"):
            with publish_at(receiver).opened(sentences.append) as (_, send):
                for message in messages:
                    tried.append([client.publish.call_count, send(message)])
                for event in (client.on_disconnect, client.on_connect):
                    event(None, None, None, "lost")

    connected = MagicMock()
    attempts = list[str]()
    client.on_socket_open(None, None, connected)

    def send_sometimes(message: Message) -> None:
        attempts.append(message.signature)
        if len(attempts) % 4 < 3:
            raise OSError(5, "no way")

    news = [
        *views,
        views[2],
        views[0],
        replace(views[0], picture=None),
        *(replace(view, alarm="a") for view in views),
    ]
    shown: Any = SimpleNamespace(
        after=lambda number: News(number + 1, news[number]) if number < len(news) else None
    )
    publish._forward(shown, send_sometimes, "here", sentences.append)
    return {
        "outlets": [part.parts if isinstance(part, Element) else repr(part) for part in outlets],
        "said": sentences,
        "tried": tried,
        "attempts": attempts,
        "waited": waited,
        "broker": [[call.args[0], call.kwargs] for call in client.publish.mock_calls],
        "client": [
            mocked.call_args.args
            for mocked in (
                client.connect,
                client.username_pw_set,
                client.reconnect_delay_set,
                connected.setsockopt,
            )
        ],
    }


def live_row(estimator: str) -> dict[str, Any]:
    """Pictures of frames as they come, with outliers, forces and second looks."""
    recording = simulated("outlier_probability")
    readings = recording.readings()
    state = PanelState.begin(
        ESTIMATORS[estimator], recording.scene, 1.0, readings[[0, 1, 2, 3]].mean(), hasty=True
    )
    pictures = []
    looks = []
    limit = 3 if estimator == "smoother" else None
    for number, frame in enumerate(recording.measured_frames()[:limit], 1):
        # a zero is asked for
        state = replace(state, missing=2) if number == 3 and estimator == "tared" else state
        sigma = (
            recording.sigma
            if recording.sigma is None or recording.sigma.ndim == 2
            else recording.sigma[frame]
        )
        scan = Scan(recording.recorded[frame], sigma, float(number), 0.0)
        state, picture = solved_scan(state, scan, number, 0)
        pictures.append(
            (
                picture.relative_change,
                picture.pressure,
                picture.force,
                picture.verdict,
                picture.outliers,
                picture.status,
                picture.saturated,
            )
        )
        if state.look is not None:
            findings = state.look.findings()
            fixed_weights = replace(
                state.look, stream=replace(state.look.stream, keeps_weights=True)
            )
            costs = () if looks else (0.0, np.inf)
            lower = [
                replace(fixed_weights, objective=cost).findings().lower is None for cost in costs
            ]
            previous = findings.apply_to(state.stream).previous
            looks.append((findings.weights, findings.lower, findings.force, previous, lower))
    return {"pictures": pictures, "looks": looks}


VERDICTS_ON: tuple[dict[tuple[int, int], float], ...] = (
    {},
    {(1, 1): 0.98},
    {(1, 1): 0.4},
    {(1, 1): 0.4, (1, 2): 1.1},
    {(1, 1): 3.0},
    {(1, 1): 0.1, (2, 2): 6.0},
    {(1, 1): 0.9},
)
PLACES = (
    "mqtt://localhost",
    "mqtt://a/b/",
    "osc://:7/x",
    "mqtt://me:p%40ss@h:5/t",
    "lsl://panel",
    "websocket://:0",
    "mqtt://h/a#b",
    "mqtt://h:99999",
    "mqtt://h?x=1",
    "up",
)


LAMPREY = Attachment(
    0.99,
    6.0,
    (44.0, 0.6),
    (46.0, 0.6),
    (35.0, 1.6),
    ((-11.0, 1.9),),
    breath=breathing.Breathing(6.0),
)
CUP = replace(LAMPREY, breath=breathing.Breathing(-6.0, -6.0, hertz=(1.0, 0.1), max_depth=0.01))


def watched_row() -> list[Any]:
    """Answers to an untouched panel, a broken frame, departed loads and a new zero."""
    recording = simulated(frames=6, baseline_frames=3)
    answers = []
    scans = [scan_of(recording, frame) for frame in range(9)]
    departed = [replace(LAMPREY, since_s=since, until_s=8.0) for since in (1.0, 2.0)]
    mat = replace(recording.scene, panel=lp.Panel(33, 32))
    wide, broken = (
        replace(scans[3], recorded=np.full(shape, 1000.0)) for shape in ((33, 32), (2, 2))
    )
    news: list[Any] = [
        scans[3],
        Unloaded(recording.scene, tuple(scans[:3])),
        *scans[3:5],
        broken,
        scans[5],
    ]
    news += [(CUP, *departed), scans[6], (LAMPREY,), 2, *scans[7:], Unloaded(mat, (wide,) * 3)]
    watched = Watched("rod")
    with patch.object(watcher, "MAX_REMEMBERED", 1):
        for item in news:
            loads = isinstance(item, tuple)
            watched = (
                replace(watched, watch=replace(watched.watch, attachments=item))
                if loads
                else watched.after(item)
            )
            answer = watched.detected
            rest_end = watched.watch and watched.watch.rest.until_s
            times = [(load.since_s, load.until_s) for load in answer.attachments]
            answers.append(
                [
                    answer.answer,
                    answer.why,
                    answer.frames_per_second,
                    watched.missing,
                    rest_end,
                    times,
                ]
            )
    return answers


def live_words_row() -> dict[str, Any]:
    """Verdicts on changes, alarms of answers, waiting items, the history, panels and addresses."""
    cells = cells_of((4, 5), spread=0.3)
    verdicts = []
    for change, readout, broken in product(
        VERDICTS_ON, (lp.TwoPointReadout(), None), (False, True)
    ):
        scene = lp.Scene(lp.Panel(4, 5), readout)
        ratio = np.ones((4, 5))
        open_cell = np.zeros((4, 5), dtype=bool)
        for cell, factor in change.items():
            ratio[cell] = factor
        resting, loaded = (
            lp.Readings.of(scene, lp.two_point_resistance(ohm)) for ohm in (cells, cells * ratio)
        )
        ratio[3, 4], open_cell[3, 4] = (1e6, True) if broken else (1.0, False)
        verdicts.append(verdict_of(loaded, resting, ratio, open_cell))
    past = replace(LAMPREY, until_s=9.0)
    later = replace(LAMPREY, since_s=20.0)
    view = View("here", "LSM", "receiving", lp.Panel(2, 3))
    alarms = []
    for loads, confirmed in (
        ((CUP,), 0),
        ((LAMPREY,), 0),
        ((past,), 0),
        ((), 1),
        ((past,), 0),
        ((LAMPREY, later), 0),
    ):
        view = with_detected(view, Detected.of("here", loads, 4.0))
        alarms.append((view.alarm, sorted(view.acknowledged)))
        view = acknowledged(view) if confirmed else view
    map_ = np.ones((2, 3))
    for number in range(1, HISTORY_FRAMES + 3):
        picture = Picture(
            number, number, 0.0, map_, map_, map_ > 2, Force(1.0, 0.1), "fine", 0.0, 0
        )
        view = with_picture(view, picture)
    scans: list[Any] = [
        Unloaded(simulated().scene, ()),
        *(Scan(map_, None, float(number), 0.0) for number in range(6)),
    ]
    with patch.object(watcher, "MAX_WAITING", 4):
        waiting = [
            [scans.index(scan) for scan in in_one_batch(scans[n:], [scans[:n]])[0]] for n in (2, 3)
        ]
        waiting += [
            [scans.index(scan) for scan in in_one_batch(scans[1:n], [])[0]] for n in (5, 6, 7)
        ]
    scene = lp.Scene(lp.Panel(3, 4), lp.TwoPointReadout(), 140.0)
    still = np.full((3, 4), 1000.0)
    resting, unreadable = (lp.Readings.of(scene, factor * still) for factor in (1.0, np.nan))
    methods = product(("smooth", "relative_change"), (True, False))
    states = [
        PanelState.begin(LIVE[name], scene, 1.0, resting, hasty=hasty) for name, hasty in methods
    ]
    arrivals = (1, resting), (2, resting), (1, unreadable)
    states.append(PanelState.begin(ESTIMATORS["auto"], scene, 1.0, resting, hasty=True))
    states += [
        replace(state, missing=count).after(zero, None, 1.0)
        for state in states
        for count, zero in arrivals
    ]
    states += [state.after(resting, None, 2.0) for state in states if state.missing]
    for coupled in (True, False):
        scene = lp.Scene(lp.Panel(modules=Modules(1, 2, EachModule(3, 2), coupled=coupled)))
        states.append(
            PanelState.begin(LIVE["smooth"], scene, 1.0, lp.Readings.of(scene, still), hasty=True)
        )
    engine = Engine("here", "LSM", ESTIMATORS["auto"], 2)
    engines = list[Any]()
    for state, engine._beside in product(
        states, (None, SimpleNamespace(gone=False), SimpleNamespace(gone=True))
    ):
        updated = engine._with_findings(state)
        engines.append(
            (updated.stream.keeps_weights, updated.track is None, updated.stream.track is None)
        )
    listed = lp.Panel(2, 2, cells=((0, 0, 1.5, 2.0), (1, 1, 9.0, 8.0)))
    panels = (
        lp.Panel(1, 2, 8.0),
        listed,
        lp.Panel(modules=Modules(1, 2, EachModule(2, 3, 5.0), 4.0)),
    )
    return {
        "states": [
            (
                state.missing,
                state.zeroed,
                len(state.recent),
                state.track is None,
                state.stream.track is None,
                state.stream.keeps_weights,
            )
            for state in states
        ],
        "engines": engines,
        "methods": [(name, method.terms, method.method) for name, method in LIVE.items()],
        "verdicts": verdicts,
        "alarms": alarms,
        "waiting": waiting,
        "history": (len(view.history), view.history[0].number),
        "shown": [json.loads(view_text(view, 0.0, HISTORY_FRAMES + n))["history"] for n in (-1, 2)],
        "again": json.loads(view_text(view, 0.0, HISTORY_FRAMES + 2))["picture"],
        "panels": [
            json.loads(view_text(View("here", "LSM", "on", panel), 0.0))["panel"]
            for panel in panels
        ],
        "addresses": [
            refusal(publish_at, url) if url in PLACES[-3:] else vars(publish_at(url, "key"))
            for url in PLACES
        ],
        "signatures": [
            Message.of(replace(view, alarm=alarm)).signature for alarm in ("", "an alarm")
        ],
    }


def refusal(made: Callable[..., Any], *known: Any, **changes: Any) -> str:
    """Why something cannot be made."""
    try:
        return f"made: {type(made(*known, **changes)).__name__}"
    except ValueError as error:
        return str(error)


def stored(path: Path) -> dict[str, Any]:
    """Attributes and values of a file, without versions and checksums of numbers."""
    held: dict[str, Any] = {}

    def noted(name: str, node: Any) -> None:
        held[name] = {
            key: str(value)
            for key, value in sorted(node.attrs.items())
            if not key.endswith(("_version", "_sha256"))
        }
        if hasattr(node, "shape"):
            values = node[()]
            held[name]["values"] = np.char.decode(values) if values.dtype.kind == "S" else values

    with h5py.File(path) as file:
        file.visititems(noted)
    return {
        name: {key: each for key, each in about.items() if "LIST" not in key}
        for name, about in held.items()
    }


def command(*words: str | Path) -> str:
    """Return the output of a command, which must succeed."""
    completed = called(*words)
    assert completed.code == 0, completed.err
    return completed.out + completed.err


def described_row() -> dict[str, Any]:
    """Descriptions of recordings with gaps, bounds, lines that touch, and modules."""
    texts = {}
    known = {
        "untared": replace(simulated(), role=np.ones_like(simulated().role)),
        "gaps": gapped(),
        "modules": tiled(),
    }
    for name, recording in {**known, **{name: in_scene(name) for name in SPOKEN}}.items():
        readings = recording.recorded.copy()
        if name == "noisy":  # rows that are known to touch, and columns that are not
            readings[:, 2] = readings[:, 1]
            readings[:, :, 1] = readings[:, :, 0]
            joined = lp.Faults(joined_rows=((1, 2, 3),))
            recording = replace(recording, scene=replace(recording.scene, faults=joined))
        with tempfile.TemporaryDirectory() as folder, chdir(folder):
            replace(recording, recorded=readings).save("r.h5")
            texts[name] = list(describe("r.h5"))
    film = replace(
        simulated(),
        scene=replace(
            simulated().scene, film=FILM, water=lp.Water(9.0), purpose="mat", temperature=COLD
        ),
    )
    drawn = (shaded_map, lambda change: text_map(change // 7))
    with patch.dict("os.environ"), patch("os.get_terminal_size", side_effect=OSError):
        os.environ.pop("COLUMNS", None)
        large = [
            draw(np.linspace(-50, 90, np.prod(size)).reshape(size))[-3:]
            for size, draw in product(((30, 14), (60, 300), (2, 40)), drawn)
        ]
    return texts | {
        "spoken": understood_lines(film, ("a note",)),
        "shaded": shaded_map(np.array([[-90.0, 5.0], [40.0, np.nan]])),
        "large": large,
        "results": described_results(),
    }


def described_results() -> list[str]:
    """Results without a solved frame, and of estimators that look for optima or do not."""
    status = (
        "local optimum verified",
        "an optimum, but a plateau",
        "approximate, as the formulation asks; not an optimum",
    )
    unsolved = invented_case(
        shape=(3, 2, 3), failed=(0, 1, 2), baseline_resistance=np.full((2, 3), nan)
    )
    optima = [
        invented_case(name, "second", (3, 2, 3), **{"starts": np.array([1, 4, 9])} | changes)
        for name, changes in (
            ("LSM", {"status": status}),
            ("rough", {"status": status[2:] * 3}),
            ("old", {"starts": None}),
        )
    ]
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        lp.write_results(Path("r.h5"), [unsolved, *optima])
        return list(describe("r.h5"))


PICTURED: tuple[tuple[tuple[str, ...], dict[str, Any]], ...] = (
    (("two.h5",), {}),
    (("two.h5", "new"), {"frame": 6}),
    (("two.h5", "x.png"), {}),
    (("one.h5", "x.svg"), {}),
    (("two.h5", "x.png"), {"recordings": ["second"]}),
    (("two.h5",), {"recordings": ["c"]}),
    (("two.h5",), {"estimators": ["LSMx"]}),
    (("one.h5", "x.bmp"), {}),
    (("one.h5",), {"frame": 99}),
    (("swept.h5",), {}),
    (("swept.h5",), {"frame": 6}),
    (("one.h5",), {"show": "sweep"}),
    (("one.h5",), {"show": 3}),
    (("one.h5",), {"show": "contour"}),
    (("bare.h5",), {"show": "pressure"}),
    (("one.h5",), {"show": "certainty"}),
)


def pictured_row() -> list[Any]:
    """Where pictures of results go, or why none is drawn."""
    outcomes: list[Any] = []
    cases = {
        "one": invented()[:1],
        "two": invented()[:4],
        "swept": swept_cases(),
        "bare": (invented_case(),),
    }
    drawn = patch.object(plots, "write_all", lambda figures, files, *_, **__: files)
    with tempfile.TemporaryDirectory() as folder, chdir(folder), drawn:
        for name, of in cases.items():
            lp.write_results(Path(f"{name}.h5"), of)
        for way, known in PICTURED:
            try:
                outcomes.append([str(path) for path in lp.plot_results(*way, **known)])
            except lp.InputError as error:
                outcomes.append(str(error))
        batch = compared.read_batch(
            [Path(f"{name}.h5") for name in ("one", "two", "swept", "bare")]
        )
        outcomes += [
            {name: [*of] for name, of in batch.recordings.items()},
            batch.estimators,
            batch.frames,
        ]
    return outcomes


def timeline_row() -> dict[str, Any]:
    """Timelines of a mouth, of nothing, and of two loads after one or both have left."""
    present = replace(LAMPREY, since_s=2.0)
    departed = replace(
        present, since_s=1.0, until_s=1.5, sucks=0.1, x_mm=(5.0, 1.0), diameter_mm=None
    )
    known = {"course": np.stack([np.linspace(0.5, 4, 8), np.arange(8.0)]), "panel": lp.Panel(4, 6)}
    change = np.full((4, 6), np.log(1.5))
    answers = {
        "mouth": detected("mouth"),
        "none": Detected.of("none", (), 4.0, **known),
        "one left": Detected.of("mouth", (departed, present), 4.0, **known, change=change),
        "both left": Detected.of(
            "mouth", (departed, replace(present, until_s=3.0)), 4.0, **known, change=change
        ),
    }
    return {name: drawn_row(timeline(answer)) for name, answer in answers.items()}


def detected_results_row() -> list[Any]:
    """Answers to results, and the content of the file."""
    scene = replace(WATCHED, faults=lp.Faults(shorted=((0, 1),), dead_rows=(5,)))
    recording = lp.simulate(lp.Simulation(1, 3, WATCHED, frames=3, loads=ON_FILM["rod"][0]))
    readings = replace(recording, scene=scene).readings()
    cases = list[lp.CaseResult]()
    resting = readings[:3].mean()
    for name, frames in (("noisy", slice(3, 5)), ("silent", slice(0, 3)), ("one", slice(5, 6))):
        sigma = (
            (readings.sigma_of_values[frames], resting.sigma_of_values)
            if name == "noisy"
            else (None, None)
        )
        noise = {"gain": np.array(1e-3), "unloaded": np.array(4)} if name == "noisy" else {}
        known = {
            "measured": readings.value[frames],
            "measured_baseline": resting.value,
            "frame_noise": noise,
        }
        known |= dict(zip(("sigma", "sigma_baseline"), sigma, strict=True)) | {
            "warnings": "a warning\nanother one"
        }
        case = invented_case(
            "LSM", name, (frames.stop - frames.start, 6, 7), truth=False, scene=scene
        )
        cases.append(replace(case, **known))
    answers = [
        *detect_results(lp.Results(tuple(cases))),
        Detected.unknown("dark", "nothing was read"),
    ]
    with tempfile.TemporaryDirectory() as folder:
        file = stored(write_detections(Path(folder, "d.h5"), answers))
    return [file, *(answer_row(answer) for answer in answers)]


def fit_row() -> list[str]:
    fit = Reconstruction.of(simulated(), ESTIMATORS["auto"])
    bar = MagicMock()
    with patch("lampest.cli.screen.progress", bar):
        lp.reconstruct(simulated(), [lp.Misfit()], formulation="scaled", progress=True)
    shown = [
        str(call)
        for call in (bar.call_args, *bar.return_value.__enter__.return_value.call_args_list)
    ]
    return [re.sub(r"solve time .*", "", fit.fit_report()), repr(fit), repr(simulated()), *shown]


def of_report() -> Rows:
    blind = replace(
        invented_case("blind", shape=(2, 4, 5), truth=False), swept_json='{"g.weight": 3.0}'
    )
    plots = {
        f"plot {plot.kind}": lambda plot=plot: drawn_row(
            plot.draw((*swept_cases(), blind) if plot.kind == "sweep" else invented()[:3])
        )
        for plot in PLOTS
    }
    return (
        plots
        | {
            "timeline": timeline_row,
            "tables": table_row,
            "page": page_row,
            "scales": scales_row,
            "message": message_row,
            "published": published_row,
            "words of live": live_words_row,
            "watched": watched_row,
            "descriptions": described_row,
            "report of a fit": fit_row,
            "pictures of files": pictured_row,
            "results that are watched": detected_results_row,
        }
        | {
            f"live {name}": partial(live_row, name)
            for name in ("auto", "by nodal", "tared", "smoother")
        }
    )
