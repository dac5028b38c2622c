"""A short selection of all attacks; `python -m tests.attack` runs the whole of them."""

from pathlib import Path

import pytest
from attack.attack import Attack
from attack.every import ATTACKS

SEED = 1


@pytest.mark.parametrize("attack", [attack for attack in ATTACKS if attack.quick], ids=lambda attack: attack.name)
def test_attack_is_survived(attack: Attack, tmp_path: Path) -> None:
    tried, fallen = attack.fallen(SEED, tmp_path, attack.quick)
    assert tried and not fallen


def test_no_two_attacks_share_a_name() -> None:
    names = [attack.name for attack in ATTACKS]
    assert len(set(names)) == len(names)
