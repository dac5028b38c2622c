"""What is known of an estimate beyond its value; absent where the noise of the readings is unknown or nobody asked."""

from lampest.runs.columns.checks import not_negative, told_if_solved
from lampest.runs.columns.column import CELLS, FRAMES, MAPS, Column

CERTAINTY = (
    Column(
        "cell_resistance_errors",
        MAPS,
        "ohm",
        "posterior standard deviation of the cell resistance",
        lambda done: done.cell_resistance_errors,
        (not_negative, told_if_solved),
    ),
    Column(
        "cell_resistance_lower",
        MAPS,
        "ohm",
        "95 % interval, lower end",
        lambda done: done.cell_resistance_lower,
        (told_if_solved,),
    ),
    Column(
        "cell_resistance_upper",
        MAPS,
        "ohm",
        "95 % interval, upper end",
        lambda done: done.cell_resistance_upper,
        (told_if_solved,),
    ),
    Column(
        "relative_change_errors",
        MAPS,
        "percent",
        "posterior standard deviation of the relative change",
        lambda done: done.relative_change_errors,
        (not_negative, told_if_solved),
    ),
    Column(
        "relative_change_lower",
        MAPS,
        "percent",
        "95 % interval, lower end",
        lambda done: done.relative_change_lower,
        (told_if_solved,),
    ),
    Column(
        "relative_change_upper",
        MAPS,
        "percent",
        "95 % interval, upper end",
        lambda done: done.relative_change_upper,
        (told_if_solved,),
    ),
    Column(
        "resolution",
        MAPS,
        "1",
        "diagonal of the averaging kernel",
        lambda done: done.resolution,
        (told_if_solved,),
    ),
    Column(
        "data_share",
        MAPS,
        "1",
        "share of the estimate that comes from the data",
        lambda done: done.data_share,
        (told_if_solved,),
    ),
    Column("error_bar_time", FRAMES, "s", "wall time of the error bars", lambda done: done.error_bar_time),
    Column(
        "baseline_resistance_errors",
        CELLS,
        "ohm",
        "posterior standard deviation of the unloaded cell resistance",
        lambda done: done.baseline_resistance_errors,
        (not_negative,),
    ),
)
