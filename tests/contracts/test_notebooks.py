"""lampest in notebooks: tables, labelled arrays, pictures in own axes, short lines of objects."""

import ast
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest
import xarray
from matplotlib.figure import Figure

import lampest
from lampest import (
    InputError,
    LoadedColumnsReadout,
    LogGradient,
    Misfit,
    Panel,
    Reconstruction,
    Recording,
    Scene,
    TwoPointReadout,
    reconstruct,
)

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "docs" / "examples").glob("plot_*.py"))
VALUES = np.random.default_rng(3).uniform(500, 600, (4, 3, 5)).round(2)
NAMES = [f"r{row}c{column}" for row, column in np.ndindex(3, 5)]
TIMES = np.arange(4) / 2
KINDS = ("contours", "change", "resistance", "residuals", "certainty")


@pytest.fixture(scope="module")
def recording() -> Recording:
    """A narrow panel: 12 × 4 cells, a block pressed."""
    scene = Scene(Panel(12, 4), LoadedColumnsReadout(load_ohm=10_000.0, readings=1, noise_lsb=1.0))
    cells = np.full((6, 12, 4), 3000.0)
    cells[4:, 2:5, 1:3] = 800
    noise = np.random.default_rng(1).normal(0, 1, cells.shape)
    codes = np.clip(np.round(scene.circuit.exact_reading(cells) / 5 * 1024 + noise - 0.5), 0, 1023)
    return Recording.from_array(codes, "code", 4, scene)


@pytest.fixture(scope="module")
def estimate(recording: Recording) -> Reconstruction:
    return reconstruct(recording, [Misfit(weighting="noise"), LogGradient(weight=1.0)])


@pytest.fixture
def axes() -> Iterator[Any]:
    figure = Figure(layout="constrained")
    yield figure.subplots()
    figure.canvas.draw()  # nothing that was drawn into it fails later


# Tables and labelled arrays.


def long_table() -> pandas.DataFrame:
    frame, row, column = np.indices(VALUES.shape).reshape(3, -1)
    return pandas.DataFrame({"t": TIMES[frame], "row": row, "col": column, "ohm": VALUES.ravel()})


def test_a_table_of_any_layout_becomes_a_recording() -> None:
    wide = pandas.DataFrame(dict(zip(NAMES, VALUES.reshape(4, -1).T, strict=True)))
    dated = wide.set_index(pandas.date_range("2025-01-31T12:00:00", periods=4, freq="500ms"))
    shuffled = wide[NAMES[::-1]].assign(t=TIMES)
    for table in (wide.assign(t=TIMES), dated, shuffled, long_table()):
        recording = Recording.from_dataframe(table, unit="ohm", baseline=1, rows=3, columns=5)
        np.testing.assert_allclose(recording.recorded, VALUES)
        np.testing.assert_allclose(recording.time, TIMES)
        assert recording.role.tolist() == [0, 1, 1, 1]
    assert Recording.from_dataframe(dated, rows=3, columns=5).start_time == "2025-01-31T12:00:00"
    scene = Scene(Panel(3, 5), TwoPointReadout(), 140.0)
    assert Recording.from_dataframe(wide, unit="ohm", scene=scene).scene == scene


@pytest.mark.slow
def test_the_table_of_an_estimate_gives_its_recording_back(estimate: Reconstruction) -> None:
    table = estimate.to_dataframe()
    recording = Recording.from_dataframe(
        table, unit="ohm", rows=int(table.row.max() + 1), columns=int(table.column.max() + 1)
    )
    np.testing.assert_allclose(recording.recorded.ravel(), table.measured)
    np.testing.assert_allclose(recording.time, table.time.unique())


def test_an_inconsistent_table_is_refused_with_its_place() -> None:
    table = long_table()
    with pytest.raises(
        InputError, match="table: line 10, column 'row': row 2 is beyond the panel's 0 to 1"
    ):
        Recording.from_dataframe(table, rows=2, columns=5)
    with pytest.raises(InputError, match=r"needs a pandas.DataFrame, not a ndarray"):
        Recording.from_dataframe(VALUES, rows=3, columns=5)
    with pytest.raises(InputError, match="how large is the panel"):
        Recording.from_dataframe(table)
    with pytest.raises(InputError, match=r"table: the header says 'kPa'"):
        Recording.from_dataframe(
            pandas.DataFrame({f"{name} [kPa]": VALUES[:, 0, 0] for name in NAMES}),
            rows=3,
            columns=5,
        )


def test_a_labelled_array_becomes_a_recording_in_any_order_of_dimensions() -> None:
    dates = np.datetime64("2025-01-31T12:00:00") + (1000 * TIMES).astype("m8[ms]")
    for dims, times in (
        (("time", "row", "column"), TIMES),
        (("t", "y", "x"), dates),
        (("frame", "row", "col"), None),
    ):
        coordinates = {} if times is None else {dims[0]: times}
        data = xarray.DataArray(
            VALUES / 1000, dims=dims, coords=coordinates, attrs={"units": "kohm"}
        )
        for turned in (data, data.transpose(*dims[::-1])):
            recording = Recording.from_xarray(turned, baseline=2)
            np.testing.assert_allclose(recording.recorded, VALUES)
            np.testing.assert_allclose(recording.time, np.arange(4) if times is None else TIMES)
    with pytest.raises(InputError, match="must be time, row and column, not a, row, column"):
        Recording.from_xarray(xarray.DataArray(VALUES, dims=("a", "row", "column")))
    with pytest.raises(
        InputError, match=r"needs an xarray.DataArray, not a Dataset; of a Dataset name a variable"
    ):
        Recording.from_xarray(data.to_dataset(name="R"))


# Figures.


@pytest.mark.parametrize("kind", KINDS)
def test_a_picture_fits_into_given_axes_with_given_ends(
    kind: str, estimate: Reconstruction, axes: Any
) -> None:
    figure = estimate.plot(kind, ax=axes, vmin=1.0, vmax=7.0)
    assert figure is axes.figure
    bar = figure.axes[-1]
    assert bar is not axes
    ends = bar.get_ylim()
    assert (min(ends), max(ends)) == pytest.approx((1.0, 7.0))
    assert axes.get_xlabel() == "x [mm]" and axes.get_title()


@pytest.mark.parametrize("kind", KINDS)
def test_a_new_picture_has_the_given_size_and_is_shown_in_notebooks(
    kind: str, estimate: Reconstruction
) -> None:
    figure = estimate.plot(kind, figsize=(5.0, 4.0))
    assert tuple(figure.get_size_inches()) == (5.0, 4.0)
    assert figure._repr_png_().startswith(b"\x89PNG")


def test_a_recording_draws_its_readings(recording: Recording, axes: Any) -> None:
    assert recording.plot(ax=axes, vmin=-5.0, vmax=5.0) is axes.figure
    assert "readings of frame" in axes.get_title()
    assert tuple(recording.plot(frame=1, figsize=(3, 3)).get_size_inches()) == (3, 3)
    loaded = Recording(
        recording.scene, recording.recorded[4:], recording.time[4:], recording.role[4:]
    )
    assert "frame 0" in loaded.plot().axes[0].get_title()
    with pytest.raises(InputError, match="there is no frame 6; there are 0 to 5"):
        recording.plot(frame=6)


def test_wrong_options_of_a_picture_are_refused(estimate: Reconstruction, axes: Any) -> None:
    for options, sentence in (
        ({"ax": 3}, "ax must be Matplotlib's Axes, not 3"),
        ({"ax": axes, "figsize": (3, 3)}, "figsize is for a new figure"),
        ({"figsize": (0, 3)}, "figsize must be width and height in inches"),
        ({"vmin": 2.0, "vmax": 1.0}, "vmin and vmax must be in order"),
    ):
        with pytest.raises(InputError, match=sentence):
            estimate.plot("change", **options)
    with pytest.raises(InputError, match="in order and positive"):
        estimate.plot("certainty", vmin=-1.0)


@pytest.mark.slow
def test_the_map_of_a_wrong_circuit_has_a_warning(
    recording: Recording, estimate: Reconstruction, axes: Any
) -> None:
    words = "wrong circuit: it does not explain the readings"
    wrong = Scene(
        recording.scene.panel, TwoPointReadout(reference_ohm=10_000.0, readings=1, noise_lsb=1.0)
    )
    readout = recording.scene.readout
    assert readout is not None and wrong.readout is not None
    misread = replace(
        recording, scene=wrong, recorded=wrong.readout.recorded_from_volt(recording.recorded)
    )
    misread_estimate = reconstruct(misread, [Misfit(weighting="noise"), LogGradient(weight=1.0)])
    assert misread_estimate.model_check.mark == "no"
    for kind in KINDS:
        assert words in misread_estimate.plot(kind).get_suptitle()
        assert words not in estimate.plot(kind).get_suptitle()
    misread_estimate.plot("change", ax=axes)
    assert words in axes.get_title()


@pytest.mark.parametrize("kind", KINDS)
def test_no_text_of_a_narrow_panels_picture_is_cut_off(kind: str, estimate: Reconstruction) -> None:
    figure = estimate.plot(kind)
    figure.canvas.draw()
    drawn = figure.get_window_extent()
    for text in (
        figure._supxlabel,
        figure._supylabel,
        figure._suptitle,
        *(axes.title for axes in figure.axes),
    ):
        box = text.get_window_extent() if text is not None and text.get_text() else drawn
        assert (
            drawn.x0 - 1 <= box.x0
            and box.x1 <= drawn.x1 + 1
            and drawn.y0 - 1 <= box.y0
            and box.y1 <= drawn.y1 + 1
        )


# Lines of objects.


def test_objects_print_one_short_line(
    recording: Recording, estimate: Reconstruction, tmp_path: Path
) -> None:
    estimate.save(tmp_path / "r.h5")
    stream = lampest.Stream.begin(estimate.estimator, recording.scene, 1.0, recording.readings()[0])
    for item in (
        recording.readings(),
        lampest.read_results(tmp_path / "r.h5"),
        estimate.result(),
        estimate.steps[0],
        estimate.steps[0].solution,
        stream,
    ):
        assert (
            len(repr(item)) < 400
            and "\n" not in repr(item)
            and repr(item).startswith(type(item).__name__)
        )
    assert repr(recording.readings()).startswith("Readings(value=6 × 12 × 4, sigma=6 × 12 × 4")


# Notebooks.


@pytest.mark.parametrize("script", EXAMPLES, ids=lambda path: path.stem)
def test_the_last_line_of_an_example_shows_a_picture(script: Path) -> None:
    last = ast.parse(script.read_text(encoding="utf-8")).body[-1]
    drawn = "pyplot" in script.read_text(encoding="utf-8")
    assert (
        drawn
        or "figure" not in script.read_text(encoding="utf-8")
        or (isinstance(last, ast.Expr) and ast.unparse(last) == "figure")
    )


@pytest.mark.slow
def test_a_notebook_of_the_first_example_shows_a_picture(tmp_path: Path) -> None:
    import nbformat
    from nbclient import NotebookClient

    script = EXAMPLES[0].read_text(encoding="utf-8")
    book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(script)])
    NotebookClient(
        book, timeout=120, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    outputs = book.cells[0].outputs
    assert any("image/png" in output.get("data", {}) for output in outputs)
