"""Whether answers of `lampest detect` are as often true as their probability says, by word.

Run it with: python -m docs.studies.words [--scenes 4] [--seed 9311] [--kinds …]; or of recordings
that `docs.studies.attachments --out` kept: python -m docs.studies.words --read seen.csv

An answer is that 10 s after the touch. *Lamprey* is true of mouths, *suction cup* of cups, *sucks*
of both, and *presses* of everything else. A hand-pumped cup breathes, as far as readings show; it
is left out.
"""

import argparse
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from docs.studies.attachments import HAND_PUMPED, KINDS, LIVING, Seen, read, seen
from lampest.apps.recognition.detect.answer import CUP, LAMPREY, PRESSES, SUCKS

LEVELS = (0.0, 0.9, 0.93, 0.97, 0.99, 1.0)  # of P, between which answers are counted together


def _is_cup(kind: str) -> bool:
    return "cup" in kind


TRUE: dict[str, Callable[[str], bool]] = {
    LAMPREY: lambda kind: kind in LIVING,
    CUP: _is_cup,
    SUCKS: lambda kind: kind in LIVING or _is_cup(kind) or "mouth" in kind,
    PRESSES: lambda kind: not (kind in LIVING or _is_cup(kind) or "mouth" in kind),
}


def rows(records: Sequence[Seen]) -> list[tuple[str, str, int, float, int]]:
    """Return word, range of P, number of answers, their mean P, and how many are true."""
    counted = []
    for word, is_true in TRUE.items():
        of_word = [record for record in records if record.answer == word]
        levels = np.searchsorted(LEVELS[1:-1], [record.probability for record in of_word], "right")
        for level, (low, high) in enumerate(pairwise(LEVELS)):
            some = [record for record, own in zip(of_word, levels, strict=True) if own == level]
            if some:
                mean = float(np.mean([record.probability for record in some]))
                true = sum(is_true(record.kind) for record in some)
                counted.append((word, f"{low:g} to {high:g}", len(some), mean, true))
    return counted


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=4, help="of every kind")
    parser.add_argument("--seed", type=int, default=9311)
    parser.add_argument("--rate", type=float, default=4.0, help="frames a second")
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--read", type=Path, nargs="+", help="tables of docs.studies.attachments")
    given = parser.parse_args()
    made = [record for path in given.read or () for record in read(path)]
    for number in range(0 if given.read else given.scenes):
        made += [seen(kind, given.rate, 1000 * given.seed + number) for kind in given.kinds]
    print("| answer | P | answers | mean P | true |\n|---|---|---|---|---|")
    for row in rows([record for record in made if record.kind != HAND_PUMPED]):
        print("| {} | {} | {} | {:.3f} | {} |".format(*row))
