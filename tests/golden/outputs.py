"""Rows of tables, pictures, messages, commands and studies."""

import io
import json
import re
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import replace
from functools import cache, partial
from itertools import product
from math import nan
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import h5py
import numpy as np
from golden.checks import detected, tiled
from golden.circuits import COLD, FILM, Rows, cells_of
from golden.estimates import ESTIMATORS, case_row, gapped, in_scene, simulated
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from support import invented_case

import lampest as lp
from lampest import cli
from lampest.estimate.estimator import Estimator
from lampest.loads.pressure import Force
from lampest.loads.recognition import breathing
from lampest.loads.recognition.attachment import Attachment
from lampest.report import compare
from lampest.report.detect import pressed
from lampest.report.detect.answer import Detected
from lampest.report.info import describe, shaded_map, understood_lines
from lampest.report.live.engine import with_picture
from lampest.report.live.message import Message, Picture, Point, View, acknowledged, view_text, with_detected
from lampest.report.live.state import PanelState, solved_scan
from lampest.report.live.watcher import Scan
from lampest.report.page import compared, page
from lampest.report.plots import PLOTS, maps, style
from lampest.report.plots.timeline import timeline
from lampest.report.reconstruction import Reconstruction
from lampest.report.strongest import strongest_index
from lampest.report.words import digits
from lampest.runs import config
from lampest.studies import bench, common, extremes, paper, tradeoff, weights
from lampest.studies.bench import Bench, BenchFile, BenchFrame, BenchPart, run_bench
from lampest.studies.certified import correct_digits, fifty_digits
from lampest.studies.common import StudyMethod
from lampest.studies.study import Cases, Study, read_settings
from lampest.studies.weights import Curves, WeightSubject, l_curve, morozov, solve_at, tune, why_not

# Results, tables, pictures and messages

SPOKEN = ("noisy", "contacts", "faults", "diodes")
METHODS = ("LSM", "LSR-dCR", "LSR-gCR")


@cache
def invented() -> tuple[lp.CaseResult, ...]:
    """Cases with times, failures and error bars that no solver made; two recordings."""
    cases = [
        invented_case(name, mouth, (4, 6, 5), failed=(1,) * (name == "LSR-gCR")) for mouth in (
            "mouth", "second",
        ) for name in METHODS
    ]  # fmt: skip
    rng, scene = np.random.default_rng(9), replace(cases[0].scene, response=lp.PublishedResponse())
    filled = []
    for case in cases:
        errors, own = 0.05 * case.cell_resistance, np.abs(rng.normal(0.05, 0.01, case.cell_resistance.shape))
        kpa = np.where(case.relative_change < 0, -0.2 * case.relative_change, 0.0)
        known = {
            "sigma": 0.01 * case.measured, "sigma_baseline": 0.01 * case.measured_baseline,
            "cell_resistance_errors": errors, "cell_resistance_lower": case.cell_resistance - 2 * errors,
            "cell_resistance_upper": case.cell_resistance + 2 * errors,
            "relative_change_errors": np.full(errors.shape, 5.0), "relative_change_lower": case.relative_change - 9,
            "relative_change_upper": case.relative_change + 12, "sigma_own": own, "sigma_common": own / 3,
            "resolution": 1 - own, "data_share": 1 - own / 2, "pressure": kpa, "pressure_errors": 0.1 * kpa,
            "pressure_own": 0.1 * kpa, "pressure_common": 0.02 * kpa, "pressure_lower": 0.7 * kpa,
            "pressure_upper": 1.3 * kpa, "saturated": (kpa > 15).astype(np.uint8),
            "pressing": (kpa > 1).astype(np.uint8), "scene": scene, "reading_sigma": 0.02 * case.measured,
            "warnings": "a warning" * (case.estimator == "LSM"), "weight_sigma": {"gradient": np.full(4, 0.3)},
            "missing_readings": np.array([0, 2, 0, 1]), "bound_readings": np.array([0, 0, 3, 0]), "model_mark": "yes",
            "model_sentence": "the circuit explains the readings", "noise_learned": "scatter 1.1",
        }  # fmt: skip
        for name, values in known.items():
            if (
                isinstance(values, np.ndarray)
                and values.shape == errors.shape
                and name not in ("sigma", "reading_sigma")
            ):
                values[~case.solved] = np.nan if values.dtype.kind == "f" else 0
        filled.append(replace(case, **known))
    return tuple(filled)


def swept_cases() -> tuple[lp.CaseResult, ...]:
    return tuple(
        replace(
            invented_case(f"a{n}", shape=(2, 4, 5)),
            swept_json=json.dumps({"estimators.a.terms.gradient.weight": 10.0**n}),
        )
        for n in range(3)
    )


def table_row() -> dict[str, Any]:
    published = {"LSM": lp.PublishedFigures(all=lp.StepFigures(0.2, 0.1, 3.0, 1.0))}
    rows = compare.compare(lp.Results(invented(), published), "a.h5") + compare.compare(
        lp.Results(swept_cases()), "b.h5",
    )  # fmt: skip
    blocks = compare.screen_blocks(rows, published=True)
    many = [row | {"recording": f"{row['recording']}{number}"} for number in range(4) for row in rows]
    lines = compare.table_lines(rows)
    return {
        "rows": rows, "blocks": blocks, "legend": compare.legend(rows, blocks), "notes": compare.model_notes(rows),
        "many": compare.screen_blocks(many),
        "csv": compare.comma_separated([lines[0], *(line.values() for line in lines[:1])]),
        "keys": compare.swept_keys(rows),
        "pressed": [(each.values, each.errors, each.saturated) for each in pressed.pressed(lp.Results(invented()))],
        "pressed table": pressed.pressed_table(pressed.pressed(lp.Results(invented()))),
        "strongest": strongest_index(invented()[:3]),
    }  # fmt: skip


def weights_of(cases: Sequence[lp.CaseResult]) -> str:
    return compared.weights_text([case.weights for case in cases])


def page_row() -> dict[str, Any]:
    batch = compared.Batch(
        ("a.h5",) * 6,
        compared.without_copies(
            {name: {case.estimator: case for case in lp.Results(invented()).of(name)} for name in ("mouth", "second")}
        )[0],
    )
    standing = compared.comparison_of(batch, np.random.default_rng(1))
    advice = compared.advise(batch, standing)
    unknown = [replace(case, truth=None, truth_baseline=None) for case in invented()]
    blind = [
        compared.comparison_of(
            compared.Batch(
                ("b.h5",), {name: {case.estimator: case for case in lp.Results(cases).of(name)} for name in names}
            ),
            np.random.default_rng(2),
        )
        for cases, names in (
            (unknown, ("mouth",)), (unknown, ("mouth", "second")), ((invented()[0], *unknown[1:]), ("mouth",)),
        )
    ]  # fmt: skip
    by_estimator = {name: [case for case in invented() if case.estimator == name] for name in METHODS}
    return {
        "blind": [(each.standings, each.values, each.block, each.units) for each in blind if each is not None],
        "standings": standing.standings, "values": standing.values, "block": standing.block, "units": standing.units,
        "milliseconds": {row.estimator: row.milliseconds for row in standing.standings}, "advice": advice,
        "tables": [page.standing_table(standing), page.unit_table(standing), page.case_table(by_estimator)],
        "figures": page.figures(invented()[0]), "failed": page.failures(invented()),
        "disagreements": page.disagreements(invented()[:3]),
        "doubts": page.doubts("LSM", [page.figures(case) for case in invented()[::3]]),
        "frames": page.frames_text([3, 5, 6, 7, 9]), "picks": compared.picks(10, 3, np.random.default_rng(2))[:4],
        "length": [compared.block_length(part[:, None]) for part in (np.arange(30.0), np.sin(np.arange(40.0)))],
        "between": [compared.between(compared.Interval(2.131, 1.95, 2.361), "%", "+"), weights_of(invented()[:2])],
    }  # fmt: skip


def drawn_row(figure: Figure) -> dict[str, Any]:
    """What a reader of a figure sees, and the numbers under it."""
    axes = []
    figure.draw_without_rendering()
    for each in figure.findobj(Axes):
        images = [*each.images, *each.collections]
        axes.append(
            {
                "labels": [
                    each.get_xlabel(),
                    each.get_ylabel(),
                    each.get_title(),
                    each.get_xscale(),
                    each.get_yscale(),
                ],
                "limits": [*each.get_xlim(), *each.get_ylim()],
                "ticks": [each.get_xticks(), each.get_yticks()],
                "texts": [
                    (text.get_text(), text.get_position(), text.get_size(), text.zorder, str(text.get_color()))
                    for text in each.texts
                ],
                "lines": [np.asarray(line.get_xydata(), dtype=float) for line in each.lines],
                "looks": [
                    (
                        line.get_linewidth(),
                        line.get_markersize(),
                        line.zorder,
                        line.get_alpha(),
                        *map(
                            str,
                            (
                                line.get_color(),
                                line.get_linestyle(),
                                line.get_marker(),
                                line.get_markerfacecolor(),
                            ),
                        ),
                    )
                    for line in each.lines
                ],
                "widths": [image.get_linewidths() for image in each.collections],
                "place": each.get_position().bounds,
                "values": [
                    np.ma.filled(np.ma.asarray(image.get_array(), dtype=float), np.nan)
                    for image in images
                    if image.get_array() is not None
                ],
                "range": [image.get_clim() for image in images if image.get_array() is not None],
                "legend": [text.get_text() for text in each.get_legend().get_texts()] if each.get_legend() else [],
            }
        )
    words = [text.get_text() for text in figure.findobj(Text)]
    return {"axes": axes, "size": figure.get_size_inches(), "words": "|".join(word for word in words if word)}


def scales_row() -> dict[str, Any]:
    values = [np.array([0.02, 3.0, 45.0, -70.0, 900.0, np.nan])]
    scales = [
        maps.change_scale(values, "a"), maps.banded_scale(values, "b"), maps.signed_scale(values, "c", 1.0, 100.0),
        maps.log_scale([np.abs(values[0])], "d"),
    ]  # fmt: skip
    return {
        "scales": [
            (
                scale.label, scale.norm(np.array([0.1, 5.0, 50.0, 500.0])), scale.norm.vmin, scale.norm.vmax,
                scale.ticks, scale.colours.name,
            ) for scale in scales
        ],
        "numbers": [style.plain_number(x) for x in (0.0, 0.001, 12.5, 12345.0, -3.0)],
        "round": [style.round_numbers(0.3, 70.0), style.round_numbers(250.0, 900.0)],
        "texts": [
            style.change_text(250.0, 100.0), style.change_text(-3.0, 100.0),
            style.short_title("a very long name of an estimator"), digits(0.00123), digits(12345.6), digits(-1e9),
        ],
    }  # fmt: skip


def message_row() -> dict[str, Any]:
    rng, panel = np.random.default_rng(2), lp.Panel(2, 3)
    change, kpa = rng.normal(0, 30, (2, 3)), np.array([[0, 10, 30], [-5, 2, 0]]) / 1.0
    picture = Picture(
        7, 7.5, 50.0, change, change / 2, change > 20, Force(1.25, 0.1, 1), "fine", 0.02, 2, 1000 + change, kpa,
        (kpa > 20).astype(np.uint8), "pressing", 1,
    )  # fmt: skip
    answer = Detected.of(
        "here",
        (
            Attachment(
                0.99, 6.0, (44.0, 0.6), (46.0, 0.6), (35.0, 1.6), (-11.0, 1.9),
                breath=breathing.Breathing(6.0, hertz=(1.1, 0.05)),
            ),
        ),
        4.0,
    )  # fmt: skip
    view = View(
        "here", "LSM", "receiving", panel, 9, 1, 2, history=tuple(Point(n, n / 2, float(n)) for n in range(9)),
        deviation=0.25, deviation_of=6, model="w",
    )  # fmt: skip
    view = with_detected(with_picture(view, picture, "zero"), answer)
    message, blank = Message.of(view), View("here", "LSM", "waiting", panel)
    return {
        "blank": json.loads(view_text(blank, 9.0)),
        "errors": [pressed.figure(1.234, sd) for sd in (0.0, 0.1, 12.0, np.nan)],
        "content": message.content(60.0), "row": message.row(), "channels": message.channels(),
        "page": json.loads(view_text(view, 60.0, 3)), "signature": message.signature,
        "alarm": [view.alarm, acknowledged(view).alarm],
        "seen": [acknowledged(each).acknowledged for each in (view, blank)],
    }  # fmt: skip


def live_row(estimator: str) -> dict[str, Any]:
    """Pictures of frames as they come, with outliers, forces and second looks."""
    recording = simulated("outlier_probability")
    readings = recording.readings()
    state = PanelState.begin(ESTIMATORS[estimator], recording.scene, 1.0, readings[[0, 1, 2, 3]].mean(), hasty=True)
    pictures, looks = [], []
    few = 3 if estimator == "smoother" else None
    for number, frame in enumerate(recording.measured_frames()[:few], 1):
        state = replace(state, missing=2) if number == 3 and estimator == "tared" else state  # a zero is asked for
        sigma = recording.sigma if recording.sigma is None or recording.sigma.ndim == 2 else recording.sigma[frame]
        scan = Scan(recording.recorded[frame], sigma, float(number), 0.0)
        state, picture = solved_scan(state, scan, number, 0)
        pictures.append(
            (
                picture.relative_change, picture.pressure, picture.force, picture.verdict, picture.outliers,
                picture.status,
            )
        )  # fmt: skip
        if state.look is not None:
            findings = state.look.findings()
            looks.append((findings.weights, findings.lower, findings.force))
    return {"pictures": pictures, "looks": looks}


def command(*words: str | Path) -> str:
    """What a command prints."""
    printed = io.StringIO()
    with patch.object(sys, "argv", ["lampest", *map(str, words)]), redirect_stdout(printed), redirect_stderr(printed):
        try:
            cli.main()
        except SystemExit as end:
            assert not end.code, printed.getvalue()
    return printed.getvalue()


def commands_row() -> dict[str, Any]:
    """Files of the commands and their words, of a recording on the disk and of results."""
    with tempfile.TemporaryDirectory() as name, chdir(name):
        folder = Path(name)
        simulated("outlier_probability").save(folder / "rod.h5")
        run = "schema: 1\nrecordings: [rod.h5]\nestimators:\n"
        run += "  mine: {terms: {misfit: {weighting: noise}, log_gradient: {weight: 1.0}}}\n"
        (folder / "run.yaml").write_text(
            run + "sweep: {estimators.mine.terms.log_gradient.weight: [1, 10.0]}\nsolver: {max_iterations: 200}\n"
        )  # fmt: skip
        texts = {
            word: command(*words)
            for word, words in {
                "run": ("run", "run.yaml", "--jobs", "1", "--out", "out"),
                "tare": ("tare", "rod.h5", "--frames", "4:6", "--out", "tared.h5"),
                "info": ("info", "rod.h5"),
                "info of results": ("info", "out/results.h5"),
                "terms": ("show", "terms"),
                "init": ("init", "mine", "--rows", "4", "--columns", "5"),
                "detect": ("detect", "rod.h5", "--json"),
                "detect results": ("detect", "out/results.h5", "--all", "--out", "out"),
                "check": ("check", "rod.h5"),
            }.items()
        }
        lp.write_results(folder / "invented.h5", invented())
        texts["compare"] = command("compare", "invented.h5", "--csv", "table.csv")
        texts["export"] = command("export", "invented.h5", "--to", "csv", "--recording", "mouth")
        texts["csv"] = (folder / "table.csv").read_text()
        exported = next(folder.glob("invented*.csv")).read_text().splitlines()
        texts["exported"] = "\n".join([*exported[:4], str(len(exported))])
        texts["starter"] = "\n".join(path.read_text() for path in sorted((folder / "mine").glob("*.yaml")))
        tared = lp.Recording.load(folder / "tared.h5")
        read = lp.read_results(folder / "out" / "results.h5").cases
    plain = re.compile(r"case [0-9a-f]+|\d+ bytes|\d+ datasets|in \d.* s\b|/tmp/\S*")
    return {word: plain.sub("…", text).replace(name, "") for word, text in texts.items()} | {
        "tared": tared.role, "read": [case_row(case) for case in read],
    }  # fmt: skip


def described_row() -> dict[str, Any]:
    """Descriptions of recordings with gaps, bounds, lines that touch, modules, and scenes with every entry."""
    texts = {}
    for name, recording in {"gaps": gapped(), "modules": tiled(), **{name: in_scene(name) for name in SPOKEN}}.items():
        readings = recording.recorded.copy()
        readings[:, 2] = readings[:, 1] if name == "noisy" else readings[:, 2]
        with tempfile.TemporaryDirectory() as folder, chdir(folder):
            replace(recording, recorded=readings).save("r.h5")
            texts[name] = describe("r.h5")
    film = replace(
        simulated(), scene=replace(simulated().scene, film=FILM, water=lp.Water(9.0), purpose="mat", temperature=COLD)
    )
    return texts | {
        "spoken": understood_lines(film, ("a note",)),
        "shaded": shaded_map(np.array([[-90.0, 5.0], [40.0, np.nan]])),
    }


def of_report() -> Rows:
    plots = {
        f"plot {plot.kind}": lambda plot=plot: drawn_row(
            plot.draw(swept_cases() if plot.kind == "sweep" else invented()[:3])
        ) for plot in PLOTS
    }  # fmt: skip
    return (
        plots
        | {
            "timeline": lambda: drawn_row(timeline(detected("mouth"))),
            "tables": table_row,
            "page": page_row,
            "scales": scales_row,
            "message": message_row,
            "commands": commands_row,
            "descriptions": described_row,
            "long columns": lambda: {name: series.values for name, series in invented()[0].long_columns().items()},
            "schema": lambda: sorted(config.json_schema()["$defs"]),
            "report of a fit": lambda: re.sub(
                r"solve time .*", "", Reconstruction.of(simulated(), ESTIMATORS["auto"]).fit_report()
            ),
        }
        | {f"live {name}": partial(live_row, name) for name in ("auto", "by nodal", "tared", "smoother")}
    )


# Studies


def timed(made: type[Any], **known: Any) -> list[Any]:
    """Frames that took some time, of two solvers, two methods and four panels."""
    frames = []
    for side, method, solver, frame in product((32, 48, 64, 8), ("LSM", "LSR-CR"), ("reduced", "nodal"), (0, 1, 2)):
        seconds = 1e-3 * side**1.5 * (1 + frame / 10) * (3 if solver == "nodal" else 1) * (
            1.2 if method == "LSM" else 1
        )  # fmt: skip
        about = {
            "rows": side, "columns": side, "recording": "0", "method": method, "solver": solver, "frame": frame,
            "seconds": seconds,
        }  # fmt: skip
        about |= {
            "objective": 1.0, "gap": 1e-7 * frame * (solver == "nodal"), "iterations": 4 + frame,
            "status": "optimum verified", "memory_mb": None if frame else 10.0 + side,
        }  # fmt: skip
        frames.append(
            made(
                **about, solved=frame < 2 or solver == "reduced",
                **{name: value(side, frame) for name, value in known.items()},
            )
        )  # fmt: skip
    return frames


def timed_bench() -> Bench:
    """A benchmark in which methods, memory and time were left out, and frames failed or have no gap."""
    frames = timed(
        BenchFrame, kind=lambda side, frame: "later" if frame else "first", inverse_s=lambda side,
        frame: 1e-6 * side**2,
    )  # fmt: skip
    frames += [replace(frames[0], rows=9, kind="pair"), replace(frames[0], rows=9), replace(frames[1], rows=9, gap=nan)]
    left_out = ((8, 8), "LSM", "recording 2"), ((8, 8), "LSR-CR", "recording 2"), ((9, 8), "LSM", "memory of nodal")
    settings = BenchFile(schema=1, sizes=(8, 16, (30, 20)), budget_s=9.0, frames=2)
    return Bench(settings, tuple(frames), left_out)


def timed_tradeoff() -> list[tradeoff.TradeoffFrame]:
    """Frames of formulations, also of a panel whose errors are unknown and of a frame that failed."""
    frames = timed(
        tradeoff.TradeoffFrame, baseline_s=lambda side, frame: 0.1, cell_error=lambda side, frame: side / 9 + frame,
        changed_error=lambda side, frame: side / 5,
    )  # fmt: skip
    bare = [replace(frame, rows=3, changed_error=nan, cell_error=nan, gap=0.0, seconds=0.1) for frame in frames[:6]]
    return [*frames, *bare, replace(frames[1], recording="1", gap=nan, cell_error=nan, solved=False)]


def judged_solves() -> list[extremes.Solve]:
    """Solves that are verified, doubtful, worse than the truth, refused and crashed."""
    known = {
        "case": extremes.GRID, "rows": 3, "columns": 4, "decades": 6.0, "noise": 0.01, "seed": 0, "part": "frame",
        "method": "LSM", "formulation": "reduced", "solved": True, "status": "optimum verified", "iterations": 4,
        "residual": 1e-9, "audited": 2e-9, "excess": -1.0, "model_digits": 11.0, "forward_digits": 12.0,
    }  # fmt: skip
    changes: tuple[dict[str, Any], ...] = (
        {}, {"audited": 1e-3, "residual": 1e-10, "excess": 1e-3, "model_digits": 9.5, "iterations": 10},
        {"solved": False, "status": "stopped", "model_digits": nan, "forward_digits": 9.0, "iterations": 7},
        {"solved": False, "status": f"{extremes.CRASHED}KeyError: no", "residual": 1.0},
        {"solved": False, "status": f"{extremes.REFUSED}a number: 3"}, {"decades": 7.0},
        {"case": "open cell", "decades": 0.0}, {"case": "open cell", "decades": 0.0, "noise": 0.1},
    )  # fmt: skip
    return [extremes.Solve(**known | change) for change in changes]


def stored(path: Path) -> dict[str, Any]:
    """Attributes and values of a file, without versions."""
    held: dict[str, Any] = {}

    def noted(name: str, node: Any) -> None:
        held[name] = {key: str(value) for key, value in sorted(node.attrs.items()) if not key.endswith("_version")}
        if hasattr(node, "shape"):
            values = node[()]
            held[name]["values"] = np.char.decode(values) if values.dtype.kind == "S" else values

    with h5py.File(path) as file:
        file.visititems(noted)
    return {name: {key: each for key, each in about.items() if "LIST" not in key} for name, about in held.items()}


MEASURED: dict[str, tuple[Study[Any, Any], Callable[[], Any]]] = {
    "bench": (bench.STUDY, timed_bench), "tradeoff": (tradeoff.STUDY, timed_tradeoff),
    "extremes": (extremes.STUDY, judged_solves),
    "weights": (weights.STUDY, lambda: Cases([tuned_curves()], ["a/b left out: it was solved for no weight"])),
}  # fmt: skip


def study_files_row(name: str) -> dict[str, Any]:
    """Every file of a study of given measurements, and the words of its command."""
    study, measured = MEASURED[name][0], MEASURED[name][1]()
    known = replace(study, read=lambda *_: None, measure=lambda *_: measured, figures=lambda _: {})
    module = {"bench": bench, "tradeoff": tradeoff, "extremes": extremes, "weights": weights}[name]
    with tempfile.TemporaryDirectory() as folder, chdir(folder), patch.object(module, "STUDY", known):
        Path("file.yaml").touch()
        printed = command("study", name, "file.yaml")
        files = sorted(Path("results/file").iterdir())
        return {"printed": printed} | {
            path.name: stored(path) if path.suffix == ".h5" else path.read_text() for path in files
        }  # fmt: skip


def bench_row() -> dict[str, Any]:
    frames, settings, part = timed_bench().frames, timed_bench().settings, BenchPart(0, (64, 64), "LSM")
    return {
        "rows": [vars(row) for row in bench.bench_rows(frames)], "solvers": settings.solvers((16, 16)),
        "wired": replace(settings, lines=lp.Lines(1.0)).solvers((16, 16)),
        "expected": [each.expected_s(settings, frames[:number]) for number in (0, 2, 30) for each in (
            part, part._replace(shape=(8, 8)), part._replace(method="LSR-CR"),
        )],
        "recorded": [settings.recording((4, 5), number).recorded for number in (0, 1)],
        "loads": [bench.loads(number, (9, 9)) for number in range(4)],
    }  # fmt: skip


def tradeoff_row() -> dict[str, Any]:
    frames, recording = timed_tradeoff(), simulated()
    measured, factors = recording.measured_frames(), 1 + np.arange(20.0).reshape(4, 5) / 100
    cells = factors * recording.truth_cell_resistance[measured]
    untared = replace(recording, role=np.ones_like(recording.role))
    known = [
        SimpleNamespace(recording=each, frame=measured, cell_resistance=cells)
        for each in (recording, untared, replace(recording, truth_cell_resistance=None))
    ]
    return {
        "figure": drawn_row(tradeoff.tradeoff_figure(tradeoff.ladder_rows(frames, "method"))),
        "pareto": tradeoff.front([(1.0, 3.0), (2.0, 1.0), (3.0, 2.0), (0.5, 9.0)]),
        "errors": [tradeoff.errors(each) for each in known],
    }  # fmt: skip


def runs_row() -> dict[str, Any]:
    """Tiny runs of the studies of solvers and of formulations, without their times."""
    settings = {"LSM": StudyMethod(config.Terms(misfit=lp.Misfit()))}
    file = BenchFile(schema=1, sizes=(3,), frames=2, repeats=1, estimators=settings)
    steps: list[tuple[int, int]] = []
    measured = run_bench(file, lambda done, total, *_: steps.append((done, total)))
    plan = tradeoff.Plan(tradeoff.TradeoffFile(1, ("r.h5",), frames=2, repeats=1, patience_s=1e3), [simulated()])
    plan = plan._replace(
        settings=replace(
            plan.settings, formulations=("naive", "reduced"), estimators={"LSM": StudyMethod(settings["LSM"].terms)}
        )
    )
    names = ("frame", "solver", "kind", "objective", "gap", "solved", "cell_error", "changed_error")
    frames = [*measured.frames, *tradeoff.run_tradeoff(plan)]
    return {
        "frames": [{name: getattr(each, name) for name in names if hasattr(each, name)} for each in frames],
        "steps": steps,
        "left": measured.left_out,
    }


def extremes_row(case: str) -> dict[str, Any]:
    shape = (extremes.CASES[case].shapes or ((3, 4),))[0]
    sample = extremes.AtlasSample(case, *shape, 5.0 * extremes.CASES[case].contrasted, 0.01, 3)
    recording, cells = extremes.recording_of(sample)
    if shape[0] * shape[1] > 20:
        return {"recorded": recording.recorded, "cells": cells}
    method = {"mine": StudyMethod(config.Terms(misfit=lp.Misfit(), gradient=lp.Gradient(weight=1e-3)))}
    atlas = extremes.AtlasFile(1, extremes.Grid((3,)), extremes.Grid(()), estimators=method)
    solves = extremes.solves_of(atlas, sample)
    outcomes = [
        (each.part, each.status, each.verified, each.forward_digits > 9, each.excess < 1e-6, extremes.mild(each))
        for each in solves
    ]
    return {
        "recorded": recording.recorded, "sigma": recording.sigma, "cells": cells, "solves": outcomes,
        "remarks": extremes.atlas_remarks(solves),
    }  # fmt: skip


@cache
def weight_subject() -> Any:
    estimator = Estimator((lp.Misfit(weighting="noise"), lp.LogGradient(weight=3.0)), "reduced")
    return WeightSubject.of(SimpleNamespace(recording="r", name="e", estimator=estimator), simulated())


@cache
def tuned_curves() -> Curves:
    return tune(weight_subject())


def refusal(made: Callable[..., Any], *known: Any, **changes: Any) -> str:
    """Why something cannot be made."""
    try:
        return f"made: {type(made(*known, **changes)).__name__}"
    except ValueError as error:
        return str(error)


SIDES = ((10, 9), (11, 3), (3, 16), (16, 16), (17, 3), (4, 17), (1000, 1000), (1001, 1))
NO_GRID = extremes.Grid(())
REFUSED: tuple[tuple[Callable[..., Any], tuple[Any, ...], tuple[dict[str, Any], ...]], ...] = (
    (tradeoff.TradeoffFile, (1,), ({},)),
    (
        partial(tradeoff.TradeoffFile, recordings=("a.h5",)), (1,), (
            {}, {"estimators": {}}, {"formulations": ("naive",)}, {"formulations": ("reduced", "reduced")},
            {"memory": "mine"}, {"frames": 1}, {"repeats": 0}, {"patience_s": -1.0}, {"patience_s": 0.0},
        ),
    ),
    (
        tradeoff.Simulated, (), (
            {"sizes": ()}, {"sizes": (7,)}, {"sizes": (1001,)}, {"sizes": (8, (8, 8))}, {"sizes": (8,), "seed": -1},
            {"sizes": (8, (8, 1000)), "seed": 0}, {"sizes": (8,), "noise": {}}, {"sizes": (8,), "diameter_mm": 0.0},
        ),
    ),
    (BenchFile, (1,), (
        {"sizes": ()}, {"sizes": (1,)}, {"sizes": (2, 1000)}, {"sizes": (3,), "memory": (1,)},
        {"sizes": (3,), "limits": bench.BenchLimits(2, 2)}, {"sizes": (3,), "frames": 0},
        {"sizes": (3,), "budget_s": 0.0},
    )),
    (extremes.Grid, (), (
        {"sizes": (0,)}, {"sizes": (65,)}, {"sizes": (1, 64), "decades": (0, 15)}, {"sizes": (2,), "noise": (101,)},
    )),
    (extremes.AtlasFile, (1,), (
        {"grid": NO_GRID, "structured": NO_GRID},
        {"grid": extremes.Grid((2,)), "structured": NO_GRID, "estimators": {}},
    )),
)  # fmt: skip


def settings_row() -> dict[str, Any]:
    """Panels, methods and scenes that files of studies name, and files that are refused."""
    file = tradeoff.TradeoffFile(1, ("a.h5",))
    atlas = extremes.AtlasFile(
        1, extremes.Grid((2, (3, 4)), (1.0, 9.0), (0.0, 10.0), seeds=2), extremes.Grid((3,), (6.0,), (1.0,)),
        nodal=extremes.Grid((2, 3), (1.0,), (0.0, 1.0)),
    )  # fmt: skip
    scenes = tradeoff.Simulated(sizes=(8, (9, 10)), diameter_mm=28.0, seed=5).simulations(2)
    return {
        "rungs": [[*file.rungs(shape)] for shape in SIDES], "methods": [file.methods(shape) for shape in SIDES],
        "scenes": [(name, each.scene.panel.shape, each.loads, each.seed, each.frames) for name, each in scenes],
        "first": [common.first_frames(simulated(), number).time for number in (2, 3)],
        "too few": refusal(common.first_frames, simulated(), 1),
        "shipped": len(read_settings(extremes.AtlasFile)(common.CONFIGS / "extremes.yaml").samples),
        "atlas": [(*vars(each).values(), *atlas.formulations(each)) for each in atlas.samples],
        "refused": [refusal(made, *known, **each) for made, known, changes in REFUSED for each in changes],
    }  # fmt: skip


def digits_row() -> dict[str, Any]:
    """Numbers of fifty digits, and how many digits others have in common with them."""
    cells = np.array([[1.0, 2.0], [3.0, np.inf]])
    pairs = ((1.0, 1.0), (1.0, 1 + 1e-6), (1.0, 3.0), (np.inf, np.inf), (0.0, 0.0), (np.nan, 1.0), (1.0, np.nan))
    return {
        "readings": [fifty_digits(each) for each in (cells, np.where(cells == 2, 0.0, cells), np.diag([1.0, np.nan]))],
        "digits": [correct_digits(np.array([1.0, value]), np.array([1.0, known])) for known, value in pairs],
    }


def weights_study_row() -> dict[str, Any]:
    subject, curves = weight_subject(), tuned_curves()
    points = [solve_at(subject, 10.0**n, None) for n in np.linspace(-4, 5, 10)]
    return {
        "points": points, "morozov": morozov(points, subject.count), "corner": l_curve(points),
        "units": subject.units, "count": subject.count,
        "tuned": [(each.rule, each.weight, each.error, each.excess, each.in_use) for each in curves.choices],
        "finer": [point.weight for point in Curves(subject, tuple(points[2:6])).finer().points],
        "why": why_not(subject.case.estimator, 9),
        "traced": [weights.trace(subject, [mark]).values("weight")[[0, 1, -1]] for mark in (1e-9, 1e9)],
    }  # fmt: skip


def paper_row() -> dict[str, Any]:
    """The paper beside one side: two mouths of a rod's frames, with estimates that no solver made."""
    published = paper.read_published(paper.FILE)
    mouths = [replace(simulated(), name=name) for name in ("large", "small")]
    shape, methods = mouths[0].recorded[4:].shape, {row.method for row in published.ranges} - {paper.MEASURED}
    cases = [
        invented_case(method, mouth.name, shape, joint_start="d" in method)
        for method in sorted(methods) for mouth in mouths
    ]  # fmt: skip
    loads = {load.letter: paper.load_of(mouths[0]) for load in published.loads}
    optima = paper.optima(lp.Results(tuple(cases)), mouths)
    sides = [paper.shown(paper.Side(f"{word} scenes", word, mouths, loads, *optima)) for word in ("clean", "panel")]
    numbers = [*paper.published_beside(sides, published)]
    names = tuple(side.name for side in sides)
    known = paper.Paper(published, names, numbers, {})
    page = paper.page_of(known)
    return {
        "response": drawn_row(paper.response_figure(published)),
        "bending": drawn_row(paper.bending_figure(published)), "covered": paper.covered(cells_of((4, 5)) - 3000),
        "numbers": [vars(row) for row in paper.rows(known)], "counts": paper.counts(numbers, names),
        "sheet": paper.sheet(numbers[:30], names), "tiles": paper.tiles_of(sides[0], published),
        "page": re.findall(r"<p>(?:Of|Numbers)[^<]*|<caption>[^<]*|<td>[^<]*time", page),
    }  # fmt: skip


def of_studies() -> Rows:
    rows: Rows = {f"extremes {case}": partial(extremes_row, case) for case in extremes.CASES}
    rows |= {f"files of {name}": partial(study_files_row, name) for name in MEASURED}
    rows |= {"bench": bench_row, "tradeoff": tradeoff_row, "weights": weights_study_row, "settings": settings_row}
    return rows | {"paper": paper_row, "runs": runs_row, "digits": digits_row}
