"""An optimum at which bounds keep cells from meeting readings says so: "verified" never stands beside such readings."""

from pathlib import Path

import h5py
import numpy as np
import pytest

import lampest

HELD = "an optimum, but only within the bounds"
VERIFIED = "optimum verified"
PLAIN = lampest.Scene(lampest.Panel(6, 6))
LOADED = lampest.Scene(lampest.Panel(6, 6), lampest.TwoPointReadout(adc_bits=14, noise_lsb=2.0))


def cells() -> np.ndarray:
    return np.asarray(2000 * np.exp(0.2 * np.random.default_rng(3).standard_normal((6, 6))))


def recorded(scene: lampest.Scene, *frames: np.ndarray, sigma: float | None = None) -> lampest.Recording:
    """Exact readings, the first of them unloaded; sigma : of themselves."""
    exact = lampest.two_point_resistance(np.stack(frames))
    role = np.array([lampest.UNLOADED, *[lampest.MEASURED] * (len(frames) - 1)], dtype=np.uint8)
    own = None if sigma is None else sigma * exact
    return lampest.Recording(scene, exact, np.arange(len(frames), dtype=float), role, sigma=own, name="exact")


def solved(recording: lampest.Recording, formulation: str, weight: float | None = None, **bounds: object) -> list[str]:
    terms = [lampest.Misfit(), *([] if weight is None else [lampest.Gradient(weight=weight)])]
    found = lampest.reconstruct(recording, terms, formulation=formulation, bounds=lampest.Bounds(**bounds))  # type: ignore[arg-type]
    return list(found.status)


@pytest.mark.parametrize("formulation", ["reduced", "nodal", "per_pixel"])
def test_a_bound_that_cells_lie_beyond_is_told(formulation: str) -> None:
    """Without noise a millionth counts, above and below; a bound that holds nothing back changes no word."""
    rest, loaded = cells(), cells()
    loaded[1, 2], loaded[3, 3] = 9000.0, 300.0
    recording = recorded(PLAIN, rest, loaded, loaded)
    assert all(status.startswith(HELD) for status in solved(recording, formulation, upper=8990.0))
    assert all(status.startswith(HELD) for status in solved(recording, formulation, lower=301.0))
    assert solved(recording, formulation, upper=9100.0, lower=299.0) == [VERIFIED] * 2


def test_what_noise_explains_is_not_told() -> None:
    """A cell beyond what the converter resolves takes less than σ from its reading; many such cells take more."""
    rest, open_cell = cells(), cells()
    open_cell[2, 3] *= 1e6
    found = lampest.reconstruct(recorded(LOADED, rest, open_cell), [lampest.Misfit()], formulation="reduced")
    assert found.status[0] == VERIFIED and found.result().open_cell.sum() == 1
    apart = 2000 * 10 ** np.random.default_rng(0).uniform(-3, 3, (6, 6))
    noisy = recorded(PLAIN, rest, apart, sigma=0.01)
    assert solved(noisy, "reduced")[0].startswith(HELD)
    assert solved(noisy, "reduced", upper="none") == [VERIFIED]


def test_readings_that_a_penalty_keeps_off_are_not_told_of_bounds() -> None:
    """One cell at its bound beside a penalty that outweighs the readings."""
    loaded = cells()
    loaded[1, 2] = 9000.0
    recording = recorded(PLAIN, cells(), loaded, sigma=1e-3)
    assert solved(recording, "reduced", weight=1e-12, upper=5000.0)[0].startswith(HELD)
    assert solved(recording, "reduced", weight=1.0, upper=3000.0) == [VERIFIED]


def test_frames_taken_together_tell_it_too() -> None:
    loaded = cells()
    loaded[1, 2] = 9000.0
    recording = recorded(PLAIN, cells(), loaded, loaded, loaded, sigma=1e-3)
    terms = [lampest.Misfit(weighting="noise", loss=lampest.Huber(corner=4.0))]
    found = lampest.reconstruct(recording, terms, formulation="smoother", bounds=lampest.Bounds(upper=5000.0))
    assert all(status.startswith(HELD) for status in found.status), found.status


def test_results_hold_cells_and_sentence(tmp_path: Path) -> None:
    """As a user reads it: an estimate, with flags, and no frame that says verified."""
    loaded = cells()
    loaded[1, 2] = 9000.0
    found = lampest.reconstruct(
        recorded(PLAIN, cells(), loaded), [lampest.Misfit()], formulation="reduced", bounds=lampest.Bounds(upper=5000.0)
    )
    found.save(tmp_path / "results.h5")
    with h5py.File(tmp_path / "results.h5") as file:
        [group] = [group for group in file["entry/exact"].values() if "status" in group]
        assert group["status"].asstr()[0].startswith(HELD)
        assert np.isfinite(group["cell_resistance"][0]).all() and group["open_cell"][0, 1, 2] == 1
