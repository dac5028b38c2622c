"""The columns of a results file: which field of a case is which dataset, over which axes, in which unit."""

from typing import Any, NamedTuple

import numpy as np

AXES = ("time", "row", "column")


class Column(NamedTuple):
    """One field of a case and the dataset that holds it."""

    field: str
    dataset: str
    axes: tuple[str, ...]
    kind: type[Any]
    units: str
    long_name: str
    optional: bool = False


GIVEN = (
    Column("frame", "frame", AXES[:1], np.int64, "1", "index of the frame in the recording"),
    Column("measured", "resistance", AXES, np.float64, "ohm", "measured two-point resistance, series taken off"),
    Column(
        "measured_baseline", "baseline", AXES[1:], np.float64, "ohm", "mean of the unloaded frames, series taken off"
    ),
    Column("sigma", "sigma", AXES, np.float64, "ohm", "standard deviation of the measured two-point resistance", True),
    Column("sigma_baseline", "sigma_baseline", AXES[1:], np.float64, "ohm", "standard deviation of the baseline", True),
    Column("truth", "truth", AXES, np.float64, "ohm", "true cell resistance", True),
    Column("truth_baseline", "truth_baseline", AXES[1:], np.float64, "ohm", "mean true unloaded cell resistance", True),
)
FOUND = (
    Column("cell_resistance", "cell_resistance", AXES, np.float64, "ohm", "estimated cell resistance"),
    Column("relative_change", "relative_change", AXES, np.float64, "percent", "cell resistance against its baseline"),
    Column(
        "two_point_model", "two_point_model", AXES, np.float64, "ohm", "two-point resistance of the estimated cells"
    ),
    Column("open_cell", "open_cell", AXES, np.uint8, "1", "1: cannot be told from an open cell"),
    Column("at_lower_bound", "at_lower_bound", AXES, np.uint8, "1", "1: cell resistance stands at its lower bound"),
    Column(
        "baseline_resistance", "baseline_resistance", AXES[1:], np.float64, "ohm", "estimated unloaded cell resistance"
    ),
    Column("iterations", "iterations", AXES[:1], np.int64, "1", "iterations of the solver"),
    Column("solve_time", "solve_time", AXES[:1], np.float64, "s", "wall time of the solve"),
    Column("objective", "objective", AXES[:1], np.float64, "1", "value of the cost function"),
    Column("kkt_residual", "kkt_residual", AXES[:1], np.float64, "1", "violation of the optimality conditions"),
    Column("solved", "solved", AXES[:1], np.uint8, "1", "1: solved, 0: failed"),
)
# What is known of an estimate beyond its value; absent where the noise of the readings is unknown or nobody asked.
CERTAINTY = (
    Column(
        "cell_resistance_errors",
        "cell_resistance_errors",
        AXES,
        np.float64,
        "ohm",
        "posterior standard deviation of the cell resistance",
        True,
    ),
    Column("cell_resistance_lower", "cell_resistance_lower", AXES, np.float64, "ohm", "95 % interval, lower end", True),
    Column("cell_resistance_upper", "cell_resistance_upper", AXES, np.float64, "ohm", "95 % interval, upper end", True),
    Column(
        "relative_change_errors",
        "relative_change_errors",
        AXES,
        np.float64,
        "percent",
        "posterior standard deviation of the relative change",
        True,
    ),
    Column(
        "relative_change_lower", "relative_change_lower", AXES, np.float64, "percent", "95 % interval, lower end", True
    ),
    Column(
        "relative_change_upper", "relative_change_upper", AXES, np.float64, "percent", "95 % interval, upper end", True
    ),
    Column("resolution", "resolution", AXES, np.float64, "1", "diagonal of the averaging kernel", True),
    Column("data_share", "data_share", AXES, np.float64, "1", "share of the estimate that comes from the data", True),
    Column("error_bar_time", "error_bar_time", AXES[:1], np.float64, "s", "wall time of the error bars", True),
    Column(
        "baseline_resistance_errors",
        "baseline_resistance_errors",
        AXES[1:],
        np.float64,
        "ohm",
        "posterior standard deviation of the unloaded cell resistance",
        True,
    ),
)
PRESSURE = (
    Column("pressure", "pressure", AXES, np.float64, "kPa", "pressure of the load on the cell", True),
    Column("pressure_errors", "pressure_errors", AXES, np.float64, "kPa", "standard deviation of the pressure", True),
    Column("pressure_lower", "pressure_lower", AXES, np.float64, "kPa", "95 % interval, lower end", True),
    Column("pressure_upper", "pressure_upper", AXES, np.float64, "kPa", "95 % interval, upper end", True),
    Column("saturated", "saturated", AXES, np.uint8, "1", "1: the response does not tell the pressure", True),
)
ESTIMATED = (*FOUND, *CERTAINTY, *PRESSURE)
