"""python -m tests.attack: does to lampest what its attackers do, and prints a table of what was tried and what held.

Exit code 1 where something fell. `--seed` chooses other damage; `--times 10` tries what is drawn at random that often.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from attack.attack import Attack
from attack.every import ATTACKS

MOST_SHOWN, LONGEST = 20, 700
ROW = "{:10} {:62} {:>6} {:>6} {:>7}"


def main() -> int:
    """Run the chosen attacks one after the other."""
    parser = argparse.ArgumentParser(prog="python -m tests.attack", description=__doc__)
    parser.add_argument("--group", help="only attacks of this group")
    parser.add_argument("--name", help="only attacks with this in their name")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--times", type=float, default=1.0, help="random attacks so many times as often")
    parser.add_argument("--quick", action="store_true", help="only what make test runs")
    chosen = parser.parse_args()
    print(ROW.format("group", "attack", "tried", "held", "s"))
    total, fallen = 0, list[str]()
    for attack in ATTACKS:
        if chosen.group not in (None, attack.group) or (chosen.name or "") not in attack.name:
            continue
        tried, fell = done(attack, chosen.seed, chosen.times, chosen.quick)
        total, fallen = total + tried, fallen + [f"{attack.group}, {attack.name}: {what}" for what in fell]
    print(f"\n{total} tries with seed {chosen.seed}: {total - len(fallen)} held, {len(fallen)} fell")
    for what in fallen[:MOST_SHOWN]:
        print(f"  {what[:LONGEST]}")
    return 1 if fallen or not total else 0


def done(attack: Attack, seed: int, times: float, quick: bool) -> tuple[int, list[str]]:
    """Run one attack and print its line."""
    many = attack.quick if quick else attack.full
    count = many if quick or many == 1 else max(1, round(many * times))
    begin = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="attack") as folder:
        tried, fell = attack.fallen(seed, Path(folder), count) if count else (0, [])
    row = (attack.group, attack.name[:62], tried, tried - len(fell), f"{time.monotonic() - begin:.1f}")
    print(ROW.format(*row), flush=True)
    return tried, fell


if __name__ == "__main__":
    sys.exit(main())
