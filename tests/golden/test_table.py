"""The golden table: public results of every room are those that were stored.

How exactly follows from their quantities, see `golden.content`.
"""

import json
import warnings

import pytest
from golden.content import content, difference
from golden.make import DATA
from golden.table import table

TABLE = {f"{room} {name}": row for room, rows in table().items() for name, row in rows.items()}
STORED = {
    f"{path.stem} {name}": row
    for path in DATA.glob("*.json")
    for name, row in json.loads(path.read_text()).items()
}
LONG_ROWS = {  # rows of 0.4 s or more, but those of a scene each
    "runs faults of study bench",
    "runs run files",
    "studies extremes codes at both rails",
    "whole simulation several without names",
    "whole simulation swept load",
}
SLOW_ROWS = {  # rows of a second or more on a busy machine
    "checks mistakes",
    "checks prepared amplifiers",
    "checks prepared begins_s",
    "checks prepared coarse",
    "checks prepared columns",
    "checks prepared contact",
    "checks prepared creep",
    "checks prepared disconnected",
    "checks prepared drift_per_minute",
    "checks prepared estimated",
    "checks prepared few missing",
    "checks prepared gain_spread",
    "checks prepared kind",
    "checks prepared late leak",
    "checks prepared leak",
    "checks prepared little series",
    "checks prepared loud",
    "checks prepared modules",
    "checks prepared motion",
    "checks prepared no series",
    "checks prepared outlier_probability",
    "checks prepared polarity",
    "checks prepared reading error",
    "checks prepared saturation",
    "checks prepared saturation at rest",
    "checks prepared series",
    "checks prepared supply_ripple_hz",
    "checks prepared supply_ripple_lsb",
    "checks prepared touched",
    "estimate estimate LSR-CR",
    "estimate estimate auto on modules",
    "estimate estimate auto per frame on modules",
    "estimate estimate bare with gaps",
    "estimate estimate evidence",
    "estimate estimate of coupled modules",
    "estimate estimate of modules that drop out",
    "estimate estimate smoother at bounds",
    "estimate estimate total_variation",
    "estimate estimate with film",
    "estimate estimate with gaps",
    "estimate estimate with outliers",
    "estimate estimate with ripple",
    "estimate estimate with scene GroundedReadout",
    "estimate estimate with scene LoadedColumnsReadout",
    "estimate estimate with scene VirtualGroundReadout",
    "estimate estimate with scene amplifiers",
    "estimate estimate with scene contacts",
    "estimate estimate with scene diodes",
    "estimate estimate with scene faults",
    "estimate estimate with scene floating",
    "estimate estimate with scene grounded one",
    "estimate estimate with scene holes",
    "estimate estimate with scene modules",
    "estimate estimate with scene noisy",
    "estimate estimate with scene sensor",
    "estimate estimate with scene series of lines",
    "estimate estimate with scene wire",
    "estimate estimate with scene wired pull-ups",
    "estimate known loads",
    "estimate moved resistors",
    "estimate no resistors",
    "estimate smoother of modules",
    "estimate smoother of shared errors",
    "posterior errors absolute whole True",
    "posterior errors huber whole True",
    "posterior errors penalty whole True",
    "posterior errors student whole True",
    "recognition detected block",
    "recognition detected mouth",
    "recognition detected on modules",
    "recognition detected ring",
    "recognition detected rod",
    "recognition detected two",
    "report descriptions",
    "report live smoother",
    "report pictures of files",
    "report plot certainty",
    "report plot change",
    "report plot contours",
    "report plot residuals",
    "report plot resistance",
    "report report of a fit",
    "report timeline",
    "runs damaged files",
    "runs faults of run",
    "runs faults of simulate",
    "runs refused commands",
    "studies budgets",
    "studies tradeoff",
    "whole files",
    "whole report",
}
ROWS = [
    pytest.param(
        name,
        marks=[pytest.mark.long] * (name in LONG_ROWS) + [pytest.mark.slow] * (name in SLOW_ROWS),
    )
    for name in TABLE
]
ADVICE = "an intended change, or a new row: python -m tests.golden.make table"


def difference_of(name: str) -> str:
    """Return where a row differs from the stored one; '' where it does not."""
    computed = json.loads(json.dumps(content(TABLE[name]())))
    return difference(STORED.get(name), computed)


def agree(names: list[str]) -> bool:
    """Whether rows have their stored results, for the mutation study."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return not any(map(difference_of, names))


def test_the_table_has_the_stored_rows() -> None:
    assert TABLE.keys() == STORED.keys(), ADVICE


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("name", ROWS)
def test_a_row_has_its_stored_results(name: str) -> None:
    assert not difference_of(name), ADVICE
