"""The defaults that users rely on stay: every default of a public class, as the stored table has it."""

import json

import pytest
from golden.make import DEFAULTS, defaults

STORED = json.loads(DEFAULTS.read_text())


@pytest.mark.parametrize("name", sorted(STORED.keys() | defaults().keys()))
def test_public_classes_have_their_stored_defaults(name: str) -> None:
    assert defaults()[name] == STORED[name], "an intended change: python -m tests.golden.make defaults"
