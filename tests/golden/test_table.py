"""The golden table: public results of every room are those that were stored, to eight digits."""

import json

import pytest
from golden.content import content, difference
from golden.make import DATA
from golden.table import RELATIVE, table

TABLE = {f"{room} {name}": row for room, rows in table().items() for name, row in rows.items()}
STORED = {
    f"{path.stem} {name}": row for path in DATA.glob("*.json") for name, row in json.loads(path.read_text()).items()
}
INTENDED = "an intended change, or a new row: python -m tests.golden.make table"


def test_the_table_has_the_stored_rows() -> None:
    assert TABLE.keys() == STORED.keys(), INTENDED


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("name", TABLE)
def test_a_row_has_its_stored_results(name: str) -> None:
    computed = json.loads(json.dumps(content(TABLE[name]())))
    assert not difference(STORED.get(name), computed, RELATIVE.get(name, 1e-8)), INTENDED
