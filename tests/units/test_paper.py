"""The paper's numbers: one file that agrees with what else is shipped, and what counts as reproduced."""

from pathlib import Path

import numpy as np

from lampest.runs.config import read_run
from lampest.studies.paper.page import PublishedNumber, counts, covered
from lampest.studies.paper.sides import FILE, read_published

CONFIGS = Path(__file__).parents[2] / "configs"


def test_table_one_is_the_same_in_the_shipped_run() -> None:
    """The run's file says it for `lampest compare`, the data file for `lampest study paper`."""
    beside = read_run(CONFIGS / "table1.yaml").published
    for row in read_published(FILE).errors:
        figures = getattr(beside[row.method], row.steps)
        assert (figures.time_s, figures.time_sd_s) == (row.time_s, row.time_sd_s)
        assert (figures.error_percent, figures.error_sd_percent) == (row.error_percent, row.error_sd_percent)


def test_a_quarter_is_of_the_published_number() -> None:
    row = PublishedNumber("Fig. 8-a", "measured", "%", -80.0, (-60.0, -59.9, -100.1, float("nan")))
    assert [row.reproduced(number) for number in range(4)] == [True, False, False, False]
    assert counts([row], ["one"]).endswith("1 of 1 (one).")


def test_a_mouth_covers_its_rim() -> None:
    change = np.full((8, 9), -5.0)
    change[2:6, 3:8] = -80.0
    change[3:5, 4:7], change[0, 0] = 300.0, -39.0
    assert covered(change) == (4, 5)
