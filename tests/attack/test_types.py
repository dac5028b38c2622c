"""Values of other types at every public name."""

import dataclasses
import datetime
import inspect
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from attack.attack import PASSED, Outcomes, Rng, attack, called, unless

import lampest
from lampest.files import typed
from lampest.files.checksums import DATASETS
from lampest.files.typed import Validated

WRONG_VALUES: tuple[Any, ...] = (
    None,
    "x",
    "",
    b"x",
    True,
    -1,
    0,
    10.5,
    1e300,
    float("nan"),
    float("inf"),
    10**400,
    2 + 3j,
    [],
    {},
    set(),
    object(),
    type,
    lambda: 0,
    ["a", None],
    np.array(["a"]),
    np.ma.masked_array([1.0, 2.0], [True, False]),
    np.array([1 + 2j]),
    [[1, 2], [3]],
    Path("x"),
    datetime.date(2026, 5, 4),
    {"kind": "x"},
    lampest.Panel(2, 2),
)
MADE_BY_LAMPEST = {
    *("Data", "Estimates", "ModelCheck", "Outcome", "Readings", "Reconstruction", "Results"),
    *("OwnProgram", "OwnSolution", "Solution", "State", "Step", "Stream"),
}


@attack(3, len(WRONG_VALUES))
def test_every_field_of_every_public_class_refuses_wrong_values(
    rng: Rng, folder: Path, count: int
) -> Outcomes:
    recording = lampest.datasets.load("rod")
    good: dict[str, dict[str, Any]] = {
        "Panel": {"rows": 3, "columns": 4},
        "Scene": {"panel": lampest.Panel(3, 4)},
        "Huber": {"corner": 3.0},
        "Estimator": {"terms": (lampest.Misfit(),)},
        "Recording": {
            name: getattr(recording, name) for name in ("scene", "recorded", "time", "role")
        },
    }
    for name in sorted(set(lampest.__all__) - MADE_BY_LAMPEST):
        kind = getattr(lampest, name)
        if (
            not inspect.isclass(kind)
            or not dataclasses.is_dataclass(kind)
            or inspect.isabstract(kind)
        ):
            continue
        yield unless(
            issubclass(kind, Validated) or kind is lampest.Estimator, f"{name} is not checked"
        )
        for word in inspect.signature(kind).parameters:
            for index in rng.permutation(len(WRONG_VALUES))[:count]:
                yield _refused(
                    kind, f"{name}: {word}", good.get(name, {}) | {word: WRONG_VALUES[index]}
                )


@attack(3, len(WRONG_VALUES))
def test_public_functions_refuse_wrong_values(rng: Rng, folder: Path, count: int) -> Outcomes:
    for name in sorted(lampest.__all__):
        function = getattr(lampest, name)
        if not inspect.isfunction(function) or not inspect.signature(function).parameters:
            continue
        _, *parameters = inspect.signature(function).parameters.values()
        given = {
            parameter.name: None for parameter in parameters if parameter.default is parameter.empty
        }
        for index in rng.permutation(len(WRONG_VALUES))[:count]:
            if not isinstance(WRONG_VALUES[index], str | Path | np.ndarray):
                yield _refused(partial(function, WRONG_VALUES[index]), name, given)


@attack()
def test_inconsistent_values_are_refused_together(rng: Rng, folder: Path, count: int) -> Outcomes:
    """Earlier versions accepted these values silently."""
    recording = lampest.datasets.load("rod")
    fields = {name: getattr(recording, name) for name in ("scene", "recorded", "time", "role")}
    changes: tuple[dict[str, Any], ...] = (
        {"time": recording.time[::-1]},
        {"recorded": np.ma.masked_array(recording.recorded, recording.recorded > 600)},
        {"recorded": recording.recorded + 1j},
        *({"recorded": recording.recorded / factor} for factor in (10_000, 1_000, 200, 50)),
        {"recorded": recording.recorded.tolist(), "role": None},
    )
    for change in changes:
        yield _refused(lampest.Recording, str(list(change)), fields | change, must=True)


def test_an_object_of_a_fields_type_needs_no_schema(monkeypatch: pytest.MonkeyPatch) -> None:
    """Schemas of all that a scene contains took a quarter of a second of each command."""
    hints = list[Any]()
    schema_of = typed.schema_of

    def noted(hint: Any) -> Any:
        hints.append(hint)
        return schema_of(hint)

    monkeypatch.setattr(typed, "schema_of", noted)
    recording = lampest.datasets.load("rod")
    hints.clear()
    scene = dataclasses.replace(recording.scene, panel=recording.scene.panel)
    dataclasses.replace(recording, scene=scene)
    lampest.Estimator((lampest.Misfit(loss=lampest.Huber(3.0)), lampest.Gradient(weight=1.0)))
    kinds = (lampest.Panel, lampest.Scene, lampest.Misfit, lampest.Huber)
    held = [hint for hint in hints if any(kind.__name__ in str(hint) for kind in kinds)]
    assert not held
    with pytest.raises(lampest.InputError, match="Panel"):
        dataclasses.replace(scene, panel=scene)
    with pytest.raises(lampest.InputError, match="terms"):
        lampest.Estimator((lampest.Misfit(), scene))  # type: ignore[arg-type]
    assert hints  # of objects of a wrong type


def _refused(make: Any, call: str, given: dict[str, Any], must: bool = False) -> str:
    try:
        make(**given)
    except ValueError as error:
        return PASSED if "\n" not in str(error) and len(str(error)) < 800 else f"{call}: {error}"
    except Exception as error:
        return f"{call}: {type(error).__name__}: {error}"
    return f"{call}: is taken" if must else PASSED


@pytest.mark.slow
def test_readings_of_extended_precision_are_stored_as_doubles(tmp_path: Path) -> None:
    recording = lampest.datasets.load("rod")
    wide = recording.recorded.astype(np.longdouble)
    extended = lampest.Recording(
        recording.scene, wide, recording.time.astype(np.longdouble), recording.role
    )
    recording.save(path := tmp_path / "wide.h5")
    with h5py.File(path, "r+") as file:
        group = file["entry/two_point"]
        del group["resistance"]
        group["resistance"] = wide
        del file.attrs[DATASETS]  # a file of other programs has no digest of its datasets
    for variant in (extended, lampest.Recording.load(path)):
        assert variant.recorded.dtype == float and np.array_equal(
            variant.recorded, recording.recorded
        )
    completed = called("info", path)
    assert completed.code == 0 and "strongest change" in completed.out
