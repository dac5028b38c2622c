"""Lines of advice that would do harm: other meanings of values, orders that are a relabelling."""

import numpy as np

from lampest import DrivenReadout, GroundedReadout, Panel, Scene, TwoPointReadout
from lampest.audit.finding import Finding, with_lines
from lampest.inference.rivals import BY_COLUMNS, Rival, rivals_of

KIND = "readout: {kind: grounded, driven: rows, sense: one, load_ohm: 2000}"
SERIES = "series_resistance_ohm: 2140"


def finding(line: str) -> Finding:
    return Finding("circuit", "another circuit", "", line)


def test_a_line_that_changes_what_values_mean_is_refused() -> None:
    scene = Scene(Panel(8, 8), TwoPointReadout(reference_ohm=2000.0))
    changed, accepted, refused = with_lines(scene, [finding(KIND), finding(SERIES)])
    assert accepted == (SERIES,) and changed.series_resistance_ohm == 2140
    assert len(refused) == 1 and "in ohm, would mean something else" in refused[0]


def test_another_reference_changes_what_resistances_mean() -> None:
    scene = Scene(Panel(8, 8), TwoPointReadout(reference_ohm=2000.0))
    _, accepted, refused = with_lines(scene, [finding("readout: {reference_ohm: 1000}")])
    assert not accepted and refused


def test_a_circuit_of_the_same_voltages_is_written() -> None:
    scene = Scene(Panel(8, 8), GroundedReadout())
    line = "readout: {kind: driven, idle_ohm: 0, load_ohm: 2000}"
    changed, accepted, _ = with_lines(scene, [finding(line)])
    assert accepted == (line,) and isinstance(changed.readout, DrivenReadout)


def kinds(scene: Scene) -> list[str]:
    recorded = 1000 * np.exp(0.3 * np.random.default_rng(1).normal(size=(2, *scene.panel.shape)))
    rival = Rival(scene, recorded, np.ones_like(recorded))
    return [other.kind for other in rivals_of(rival)]


def test_square_two_point_panels_have_no_order_by_columns() -> None:
    """Exchanged rows and columns are a relabelling there, which would turn the picture."""
    assert BY_COLUMNS not in kinds(Scene(Panel(4, 4), TwoPointReadout()))
    assert BY_COLUMNS in kinds(Scene(Panel(4, 5), TwoPointReadout()))
