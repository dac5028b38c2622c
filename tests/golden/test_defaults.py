"""Defaults of public classes and calibrated numbers of all modules stay as stored."""

import json

import pytest
from golden.make import CONSTANTS, DEFAULTS, constants, defaults

STORED = json.loads(DEFAULTS.read_text())
ADVICE = "an intended change: python -m tests.golden.make defaults"


@pytest.mark.parametrize("name", sorted(STORED.keys() | defaults().keys()))
def test_public_classes_have_their_stored_defaults(name: str) -> None:
    assert defaults()[name] == STORED[name], ADVICE


def test_numbers_of_modules_have_their_stored_values() -> None:
    assert constants() == json.loads(CONSTANTS.read_text()), ADVICE
