"""What earlier versions found is found again: cells to eight digits, statuses and flags as they were."""

from pathlib import Path

import h5py
import pytest
from golden.make import HERE, RECORDING, reconstructed, simulated
from studies.equal import compare, equal, relative_difference, show

# Another processor adds in another order: between two of them the same commit's cells of these scenes differed by up to
# 1.4e-9.
CELLS = 1e-8
EXPECTED = {path.stem: path for path in sorted(HERE.glob("*.h5")) if path.name != RECORDING}


@pytest.fixture(scope="module")
def anew(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return reconstructed(HERE / RECORDING, tmp_path_factory.mktemp("golden"))


def test_every_estimator_has_its_file(anew: dict[str, Path]) -> None:
    assert anew.keys() == EXPECTED.keys()


@pytest.mark.parametrize("name", EXPECTED)
def test_every_estimator_gives_its_earlier_results_again(anew: dict[str, Path], name: str) -> None:
    show(*compare(EXPECTED[name], anew[name]), CELLS)
    assert equal(EXPECTED[name], anew[name], CELLS)


def test_the_simulation_gives_its_earlier_recording_again(tmp_path: Path) -> None:
    with h5py.File(HERE / RECORDING) as before, h5py.File(simulated(tmp_path)) as after:
        for path in ("two_point/resistance", "two_point/role", "truth/cell_resistance", "truth/pressure", "raw/sums"):
            assert relative_difference(before[f"entry/{path}"][()], after[f"entry/{path}"][()]) < CELLS, path
