"""The command `lampest live` without a board: what is refused, and how it ends."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

LAMPREY = Path(__file__).parents[2] / "data" / "lamprey_25mm.h5"


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--recording", "nowhere.h5"), "nowhere.h5"),
        (
            ("--recording", LAMPREY, "--port", "/dev/null"),
            "--recording: --port, --scene, --period and --out are for a board",
        ),
        (("--recording", LAMPREY, "--speed", "0"), "--speed must be positive and finite"),
        (("--recording", LAMPREY, "--speed", "nan"), "--speed must be positive and finite"),
        (("--recording", LAMPREY, "--estimator", "best"), "no estimator is called 'best'; there are smooth, LSM"),
        (("--recording", LAMPREY, "--http", "here"), "not of the form HOST:PORT"),
        (("--port", "/nowhere/port", "--http", "127.0.0.1:0"), "/nowhere/port: cannot be opened"),
    ],
)
def test_wrong_input_of_live_is_one_sentence(
    lampest: Callable[..., SimpleNamespace], words: Any, sentence: str
) -> None:
    done = lampest("live", *words)
    assert done.code == 2
    assert sentence in done.err and done.err.count("\n") == 1


def test_live_ends_after_so_many_frames(lampest: Callable[..., SimpleNamespace]) -> None:
    done = lampest("live", "--recording", LAMPREY, "--speed", "1e6", "--count", "4", "--http", "127.0.0.1:0")
    assert done.code == 0 and done.out.startswith("http://127.0.0.1:")
