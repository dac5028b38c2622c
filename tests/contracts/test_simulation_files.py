"""Simulation files that are shipped."""

from pathlib import Path

from lampest import read_simulations

ROOT = Path(__file__).parents[2]


def test_cohort_is_thirty_different_lampreys() -> None:
    cohort = read_simulations(ROOT / "configs" / "cohort.yaml")
    assert len(cohort) == 30
    assert cohort[6][0] == "../results/cohort/lamprey_07.h5"
    mouths = [simulation.loads[0] for _, simulation in cohort]
    assert all(20 <= mouth.diameter_mm <= 45 for mouth in mouths)
    assert max(mouth.diameter_mm for mouth in mouths) > 40
    assert min(mouth.diameter_mm for mouth in mouths) < 25
    assert len({mouth.centre_mm for mouth in mouths}) == 30


SIMULATED = sorted(path for path in (ROOT / "data").glob("*.h5") if not path.stem.startswith("insole"))


def test_a_real_scene_is_the_clean_one_on_another_panel() -> None:
    """The same loads, times and water; one panel for all eight, which the scene does not tell of."""
    panels = set()
    for path in SIMULATED:
        ((_, clean),) = read_simulations(ROOT / "configs" / f"{path.stem}.yaml")
        ((name, real),) = read_simulations(ROOT / "configs" / f"real_{path.stem}.yaml")
        assert name == f"../results/real/real_{path.stem}.h5"
        for part in ("loads", "course", "frames", "baseline_frames"):
            assert getattr(real, part) == getattr(clean, part)
        for part in ("panel", "readout", "water"):
            assert getattr(real.scene, part) == getattr(clean.scene, part)
        assert real.scene.systematic is None and (real.unmodelled.reading_error or 0) > 0.03
        panels.add((real.seed, real.cells, real.unmodelled))
    assert len(panels) == 1
