"""Which promises have a test that fails when they are broken?

    python -m docs.studies.promises
    python -m docs.studies.promises certificate overview

The first command takes all promises, the second one those whose test or page contains a word.
"""

import ast
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from tests.promises import ROOT, Promise, promises

# What stands in a copy. Tests are run from it, so that they import the broken package.
LEFT_OUT = (".git", ".venv", "results", "_build", ".hypothesis", "__pycache__", ".*_cache")
MAX_SECONDS = 600.0  # s for one test
TESTS_FAILED = 1  # exit code of pytest


class Break(NamedTuple):
    """A change of the package that breaks a promise.

    Attributes
    ----------
    file : str
        Python file in `lampest/`, or a file of C in `firmware/`.
    place : str
        A function, `Class.function` or constant of the file; in C, the text that is replaced.
    change : str
        A statement that comes first in the function; an expression of `result` that is returned
        instead of the result; the constant's value; in C, the other text.
    """

    file: str
    place: str
    change: str


# By the name of the test, without `test_`.
BREAKS = {
    "a_mean_of_frames_keeps_the_rounding_that_noise_does_not_dither": Break(
        "panel/readouts/converter.py", "constant_share", "return 0.0 * result"
    ),
    "a_name_states_the_steps_of_a_chip": Break(
        "panel/readouts/readout.py", "Readout.lsb_volt", "return 0.5 * result"
    ),
    "the_key_makes_cells_right_where_wire_matters": Break(
        "panel/equation.py", "Equation.read_at_far_end", "return 0 * result > 0"
    ),
    "a_range_that_is_not_stated_is_told": Break(
        "panel/readouts/converter.py", "range_assumed", "return False"
    ),
    "wrong_small_cells_are_never_verified": Break(
        "solvers/certificate.py", "Certificate.settled", "return True"
    ),
    "intervals_contain_the_truth_at_their_stated_rate": Break(
        "posterior/certainty.py", "Certainty.of", "variances = tuple(0.2 * v for v in variances)"
    ),
    "the_gradient_is_the_derivative_of_the_cost": Break(
        "cost/problem.py", "Evaluation.log_gradient", "return 1.01 * result"
    ),
    "ipopt_alone_solves_every_frame_in_its_own_iterations": Break(
        "solvers/by_ipopt.py", "Ipopt.solve", "data = data.limited(1e-9)"
    ),
    "optima_of_every_circuit_equal_those_of_the_reduced_solver": Break(
        "formulation/instance.py", "Instance.cells_of", "return 1.001 * result"
    ),
    "an_end_at_a_saddle_is_no_optimum": Break(
        "solvers/certificate.py", "Modes.definiteness", "return Definiteness.POSITIVE"
    ),
    "three_commands_lead_from_the_wheel_to_a_picture": Break(
        "report/plots/__init__.py", "plot_results", "return ()"
    ),
    "a_wrong_circuit_is_rejected_and_the_right_one_named": Break(
        "files/levels.py", "MIN_EVIDENCE_GAIN", "1e9"
    ),
    "a_wrong_pull_up_scales_cells_without_a_warning_and_leaves_changes": Break(
        "inference/warnings.py",
        "warnings_of",
        "return (*result, f'load of {recording.scene.readout.load_ohm:.0f} ohm')",
    ),
    "bars_of_cells_that_an_absolute_loss_holds_are_as_wide_as_their_errors": Break(
        "posterior/sparse_prior.py", "with_sites", "return errors"
    ),
    "a_chosen_weight_says_where_it_smooths_weak_loads": Break(
        "estimate/estimates.py", "Estimates._smoothed", "return ''"
    ),
    "a_change_of_a_cell_below_the_said_threshold_does_not_show": Break(
        "posterior/sparse_prior.py",
        "Held.by",
        "return replace(result, threshold=3 * result.threshold)",
    ),
    "a_circuit_is_named_under_loads_that_change_most_cells": Break(
        "inference/evidence.py", "Changes.cost_of_field", "return 1e6"
    ),
    "the_resistor_of_idle_lines_is_named_with_its_value": Break(
        "inference/circuits/kinds.py", "open_number_of", "return ''"
    ),
    "two_feet_are_no_other_circuit": Break(
        "inference/circuits/better_alternative.py",
        "_gain",
        "return specified.evidence - best.evidence",
    ),
    "a_right_circuit_is_not_called_wrong_under_palms_feet_keys_and_bars": Break(
        "inference/circuits/explanation.py",
        "Explanation.evidence",
        "return self.linear_evidence",
    ),
    "keys_that_are_pressed_for_one_frame_are_compared": Break(
        "inference/readings/judge.py", "Cleaned.left_out", "return self.outliers"
    ),
    "the_status_says_that_the_unloaded_panel_of_a_comparison_is_not_verified": Break(
        "estimate/stream.py", "Stream._as_compared", "return step"
    ),
    "bars_hold_a_load_that_jitters_within_a_scan": Break(
        "inference/effects/motion.py",
        "interpolated",
        "share = share._replace(jitter=0.0)",
    ),
    "an_effect_without_an_entry_in_the_scene_is_not_estimated": Break(
        "estimate/estimates.py", "Estimates.solved", "self.advice"
    ),
    "a_table_is_imported_with_its_frames_times_and_notes": Break(
        "apps/foreign/table.py", "ReadingsTable.timing", "return None"
    ),
    "a_shipped_file_equals_its_simulation": Break(
        "recording/simulation/simulation.py",
        "simulate",
        "simulation = replace(simulation, seed=simulation.seed + 1)",
    ),
    "no_other_solver_reaches_a_lower_cost": Break(
        "solvers/solution.py", "solution_at", "at = at.elsewhere(1.01 * at.cell_resistance)"
    ),
    "errors_of_a_uniform_panel_grow_by_at_most_half_the_number_of_lines": Break(
        "panel/network.py", "SolvedNetwork.sensitivity", "return 1.01 * result"
    ),
    "error_bars_cover_a_specified_or_estimated_gain_of_each_frame": Break(
        "posterior/frame_noise.py", "FrameNoise._of_frame", "return 0 * result"
    ),
    "a_failed_frame_holds_nan_and_stops_nothing": Break(
        "solvers/solution.py", "blank", "return replace(result, cell_resistance=np.ones(shape))"
    ),
    "the_automatic_weight_is_better_than_the_papers_weight": Break(
        "estimate/weights.py", "WeightSearch.open_terms", "return []"
    ),
    "estimates_without_noise_have_no_error_bars": Break(
        "estimate/estimator.py", "Estimator.has_error_bars", "return True"
    ),
    "a_tap_of_one_frame_stays": Break(
        "inference/readings/outliers.py", "no_cell_moves", "return outlying"
    ),
    "a_reading_that_no_cell_gives_is_missing_and_named": Break(
        "inference/readings/outliers.py", "no_cell_moves", "return result & False"
    ),
    "an_outlier_of_an_unloaded_frame_is_left_out_of_the_mean": Break(
        "inference/readings/outliers.py",
        "outliers_of_one_frame",
        "return result[0] & ~unloaded[:, None, None], result[1], result[2]",
    ),
    "an_outlier_stays_with_its_name_unless_the_scene_excludes_it": Break(
        "inference/readings/judge.py",
        "Cleaned.of",
        "recording = replace(recording, scene=replace(recording.scene, outliers='keep'))",
    ),
    "a_robust_scene_gives_squared_misfits_students_loss": Break(
        "estimate/estimator.py", "Estimator.for_outliers", "return self"
    ),
    "the_error_of_a_missing_library_names_its_extra_unlike_own_modules": Break(
        "files/errors.py", "PACKAGES", "{}"
    ),
    "a_two_point_reading_is_at_most_its_own_cell": Break(
        "panel/readouts/floating.py", "two_point_resistance", "return 100 * result"
    ),
    "no_two_point_reading_falls_when_a_cell_rises": Break(
        "panel/readouts/floating.py", "two_point_resistance", "return 1 / result"
    ),
    "a_second_panel_with_equal_readings_is_reported_as_a_doubt": Break(
        "audit/advice.py", "_another_panel", "return; yield"
    ),
    "estimates_of_extreme_panels_meet_every_reading": Break(
        "solvers/solution.py", "solution_at", "at = at.elsewhere((1 + 1e-5) * at.cell_resistance)"
    ),
    "a_cell_without_a_finite_optimum_ends_at_the_resolution": Break(
        "solvers/solution.py", "OPEN_FRACTION", "2.0"
    ),
    "clean_recordings_of_all_circuits_raise_no_alarm": Break(
        "audit/health.py", "_noisy_lines", "return np.arange(1)"
    ),
    "lines_in_another_order_are_found_and_the_right_one_is_not_doubted": Break(
        "inference/readings/order.py", "ODDS", "1e30"
    ),
    "a_number_that_a_recording_cannot_determine_has_a_reason": Break(
        "inference/resolve.py", "never_changes", "return False"
    ),
    "two_swapped_lines_and_two_exchanged_bits_are_named_by_loads_in_several_places": Break(
        "inference/readings/order.py", "along_side", "return 0 * result"
    ),
    "advice_has_the_number_of_the_estimate": Break(
        "inference/effects/effect.py",
        "Unnamed.of",
        "stated = sentence; sentence = lambda size, deviation: stated(7.0 * size, deviation)",
    ),
    "two_feet_half_a_panel_apart_are_no_interleaved_lines": Break(
        "inference/readings/order.py", "COINCIDENCE", "1e-300"
    ),
    "a_bar_that_sweeps_tells_no_order_of_the_lines_that_it_crosses": Break(
        "inference/readings/order.py", "MIN_CONTRAST", "0.0"
    ),
    "100_frames_of_10_by_10_are_divided": Break("runs/config.py", "SECONDS_A_CELL", "1e-5"),
    "workers_that_share_a_recording_change_no_number": Break(
        "runs/batch.py",
        "_joined",
        "solved = dict(zip(solved, reversed(list(solved.values())), strict=True))",
    ),
    "unloaded_frames_that_have_a_load_are_named": Break(
        "inference/readings/unloaded.py", "MIN_CONTRAST", "1e9"
    ),
    "lines_that_repeat_each_other_are_named": Break(
        "inference/readings/repeated.py", "repeat_each_other", "return False"
    ),
    "loads_on_every_second_line_leave_the_order_open": Break(
        "inference/readings/order.py", "COMBS", "{'row': (1, 1), 'column': (1, 1)}"
    ),
    "scatter_is_a_doubt_only_where_the_scene_does_not_name_it": Break(
        "inference/prepared.py",
        "Prepared._contradicting_scatter",
        "return self.question.widening",
    ),
    "apply_writes_the_lines_into_the_scene": Break(
        "audit/finding.py", "with_lines", "return scene, (), ()"
    ),
    "printed_entries_replace_those_of_the_scene": Break(
        "audit/finding.py", "advised_entries", "return result[:-1]"
    ),
    "info_prints_its_answer_before_the_verdict": Break(
        "report/info.py",
        "_content",
        "__import__('lampest.inference.prepared', fromlist='P').Prepared(recording).check",
    ),
    "the_covariance_is_that_of_laplace": Break(
        "posterior/covariance.py", "DenseErrors.inverse", "return 1.01 * result"
    ),
    "bars_allow_for_the_uncertainty_of_a_chosen_weight": Break(
        "posterior/linear.py", "LinearModel.pulls", "return 0 * result"
    ),
    "results_equal_those_of_serial_even_if_a_worker_dies": Break(
        "runs/executors.py", "MAX_TRIES", "1"
    ),
    "memory_is_independent_of_the_number_of_frames": Break(
        "recording/stored.py", "StoredRecording.blocks", "return (range(self.frames),)"
    ),
    "a_check_beside_the_recording_serves_info_run_and_detect": Break(
        "runs/checks.py", "keep_beside", "return"
    ),
    "a_fast_estimator_does_not_speak_for_a_slow_one": Break(
        "runs/batch.py",
        "Pace.left_s",
        "return sum(case.frames for case in self.cases) - sum(self.done)",
    ),
    "a_folder_admits_one_run_at_a_time": Break("runs/batch.py", "exclusive", "yield; return"),
    "a_frame_not_solved_in_time_holds_nan_and_a_status": Break(
        "cost/problem.py", "Data.overdue", "return False"
    ),
    "every_module_is_estimated_as_if_it_stood_alone": Break(
        "estimate/modules.py", "network_readings", "return result[::-1]"
    ),
    "results_and_pictures_have_the_outline_of_the_panel": Break(
        "estimate/estimates.py", "Estimates.cell_resistance", "return np.nan_to_num(result)"
    ),
    "a_batch_skips_only_the_truncated_file": Break(
        "files/process.py", "logged_reason", "raise error"
    ),
    "a_frame_can_be_tried_and_discarded": Break(
        "estimate/methods/method.py",
        "Method.after",
        "object.__setattr__(state, 'previous', step.solution.cell_resistance[-1])",
    ),
    "every_combination_of_potentials_agrees_with_its_netlist": Break(
        "panel/readouts/keys.py",
        "load_ends",
        "return Ends(result.ohm, 0.9 * result.volt)",
    ),
    "codes_of_a_rounding_converter_leave_cells_unbiased": Break(
        "panel/readouts/readout.py",
        "Readout.volt_from_code",
        "return result + 0.5 * self.lsb_volt",
    ),
    "the_converter_memory_is_corrected_exactly_with_its_noise": Break(
        "panel/readouts/channel_memory.py", "without_memory", "fraction = 0.9 * fraction"
    ),
    "the_core_runs_without_any_application_and_names_the_missing_one": Break(
        "runs/batch.py", "run_batch", "import lampest.apps.board"
    ),
    "frames_wait_for_a_disk_that_is_full_for_a_moment": Break(
        "apps/board/journal.py", "PATIENCE_SECONDS", "0.0"
    ),
    "a_wild_clock_in_the_last_frame_costs_no_frame": Break(
        "apps/board/stream.py", "Scanning.last_sample", "return ()"
    ),
    "random_codes_never_give_nan_overruns_or_more_work_than_budgeted": Break(
        "lampest_estimate/estimate.c",
        "half <= HALVINGS && !lower && status->products < most",
        "half <= 100 && !lower",
    ),
    "an_attachment_lasts_until_the_readings_step": Break(
        "apps/recognition/watch.py", "Watch._least_step", "return 0 * result"
    ),
    "a_leak_that_begins_under_a_mouth_is_named_and_the_visit_ends": Break(
        "apps/recognition/leaks.py", "leaks_of", "return None"
    ),
    "cells_of_lower_conductance_are_not_a_contact": Break(
        "apps/recognition/suction.py", "contacts_of", "change = -np.abs(change)"
    ),
    "remote_clients_need_the_token": Break("apps/live/server.py", "Access.shown_by", "return True"),
    "an_attached_load_is_never_taken_for_the_zero": Break(
        "apps/film/tare.py",
        "TareWatch._zero",
        "return np.mean([change for change, _ in self.frames], axis=0)",
    ),
    "a_calibrated_curve_falls_whatever_the_cells_answer": Break(
        "apps/calibration/response_fit.py", "FittedResponse.curve", "return -result[0], result[1]"
    ),
    "an_import_refuses_a_date_whose_day_may_be_its_month": Break(
        "apps/foreign/clocks.py", "DATES", "{'day/month/year': '/-'}"
    ),
}


@contextmanager
def copied_checkout() -> Iterator[Path]:
    """A copy of this checkout in which files may be changed."""
    with tempfile.TemporaryDirectory(prefix="promises-") as folder:
        copy = Path(folder) / "lampest"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(*LEFT_OUT))
        yield copy


class Returned(ast.NodeTransformer):
    """Returned values of one function, replaced by an expression of `result`."""

    def __init__(self, expression: ast.expr) -> None:
        self.expression = ast.unparse(expression)

    def visit_Return(self, node: ast.Return) -> ast.Return:
        """Return the expression, where `result` is the value that the function returned."""
        changed = ast.parse(f"(lambda result: {self.expression})(0)", mode="eval").body
        assert isinstance(changed, ast.Call) and node.value is not None
        changed.args = [node.value]
        return ast.Return(changed)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        """Leave nested functions as they are."""
        return node


def broken(source: str, change: Break) -> str:
    """Return the source of a file with a break. Raises LookupError if its place is not there."""
    if change.file.endswith(".c"):
        if source.count(change.place) != 1:
            raise LookupError(f"{change.file}: {change.place!r} does not stand there once")
        return source.replace(change.place, change.change)
    tree = ast.parse(source)
    body = tree.body
    *classes, name = change.place.split(".")
    for outer in classes:
        body = next(
            (node.body for node in body if isinstance(node, ast.ClassDef) and node.name == outer),
            [],
        )
    for node in body:
        match node:
            case ast.FunctionDef(name=place) if place == name:
                node.body = _changed(node.body, ast.parse(f"def f(): {change.change}").body[0])
                return ast.unparse(ast.fix_missing_locations(tree))
            case (
                ast.Assign(targets=[ast.Name(id=place)]) | ast.AnnAssign(target=ast.Name(id=place))
            ) if place == name:
                node.value = ast.parse(change.change, mode="eval").body
                return ast.unparse(tree)
    raise LookupError(f"{change.file} has no {change.place}")


def _changed(body: list[ast.stmt], change: ast.stmt) -> list[ast.stmt]:
    """Return the body of a function with a change, the body of another function."""
    assert isinstance(change, ast.FunctionDef)
    names = {node.id for node in ast.walk(change) if isinstance(node, ast.Name)}
    match change.body:
        case [ast.Return(value=ast.expr() as expression)] if "result" in names:
            returned = Returned(expression)
            return [returned.visit(statement) for statement in body]
        case statements:
            return [*statements, *body]


def path_of(change: Break) -> Path:
    """Return the path of a broken file in a checkout."""
    return Path("firmware" if change.file.endswith(".c") else "lampest") / change.file


def fails(item: Promise, copy: Path) -> bool:
    """Return whether the test of a promise fails in the copy."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", item.test]
    environment = os.environ | {"PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    completed = subprocess.run(command, cwd=copy, env=environment, timeout=MAX_SECONDS, **silent)
    return completed.returncode == TESTS_FAILED


def main(words: list[str]) -> None:
    """Break each promise in a copy of the checkout, and print whether its test fails."""
    print("| test | place | change | fails |\n|---|---|---|---|")
    with copied_checkout() as copy:
        for item in promises():
            name = item.test.partition("::test_")[2]
            if words and not any(word in item.test or word in item.page for word in words):
                continue
            change = BREAKS[name]
            file = copy / path_of(change)
            source = file.read_text(encoding="utf-8")
            try:
                file.write_text(broken(source, change), encoding="utf-8")
                answer = "yes" if fails(item, copy) else "**no**"
            finally:
                file.write_text(source, encoding="utf-8")
            print(f"| {name} | `{change.place}` | `{change.change}` | {answer} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
