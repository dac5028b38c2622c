"""Whether answers of `lampest detect` are as often true as their probability says, by word.

Run it with: python -m docs.studies.words [--scenes 4] [--seed 9311] [--kinds …]; or of recordings
that `docs.studies.attachments --out` kept: python -m docs.studies.words --read seen.csv. With
--drawn, loads, films, circuits and frame rates are drawn, and a second table counts loads by the
probabilities of all words, the answer or not.

An answer is that 10 s after the touch. *Lamprey* is true of mouths, *suction cup* of cups and
limpets, *sucks* of all these, and *presses* of everything else. A hand-pumped cup breathes, as far
as readings show; it is left out.
"""

import argparse
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from docs.studies.attachments import (
    CUP_CURRENT,
    CUP_MOVING,
    CURRENT,
    DRAWN,
    HAND_PUMPED,
    IRREGULAR,
    KINDS,
    LEAKING,
    LIMPET,
    LIVING,
    MOVING,
    PAUSING,
    PLANT,
    SHAKEN,
    SUCKING,
    Seen,
    read,
    seen,
    write,
)
from lampest.apps.recognition.detect.answer import CUP, LAMPREY, PRESSES, SUCKS

LEVELS = (0.0, 0.9, 0.93, 0.97, 0.99, 1.0)  # of P, between which answers are counted together

# Drawn kinds: mouths, other things that suck, and things that press.
OF_DRAWN = (
    *("uneven mouth", "pressed mouth", "mouth and body", CURRENT, MOVING, IRREGULAR, PAUSING),
    *("cup", SHAKEN, CUP_CURRENT, CUP_MOVING, LEAKING, LIMPET),
    *("rod", "ring", "hand", "rock", "fish", PLANT),
)
BINS = (0.5, 0.75, 0.9, 0.97, 1.0)
DRAWN_HZ = (4.0, 1.0)


def _is_cup(kind: str) -> bool:
    return "cup" in kind or kind == LIMPET


def _sucks(kind: str) -> bool:
    return any(word in kind for word in SUCKING)


TRUE: dict[str, Callable[[str], bool]] = {
    LAMPREY: lambda kind: kind in LIVING,
    CUP: _is_cup,
    SUCKS: _sucks,
    PRESSES: lambda kind: not _sucks(kind),
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


def by_probability(everything: Sequence[Seen]) -> None:
    """Print how many loads with a probability within each of BINS are what it is of."""
    touched = [record for record in everything if np.isfinite(record.touched)]
    sucks = np.array([record.sucks for record in touched])
    lives = np.array([record.lives for record in touched])
    chances = {LAMPREY: sucks * lives, CUP: sucks * (1 - lives), SUCKS: sucks, PRESSES: 1 - sucks}
    columns = [f"{low:g} to {high:g}" for low, high in pairwise(BINS)]
    print("| P | " + " | ".join(columns) + " |\n|---" + "|---" * len(columns) + "|")
    for word, chance in chances.items():
        true = np.array([TRUE[word](record.kind) for record in touched])
        level = np.searchsorted(BINS[1:-1], chance, "right")
        counted = [(chance >= BINS[0]) & (level == number) for number in range(len(columns))]
        shown = (f"{true[within].sum()} of {within.sum()}" for within in counted)
        print(f"| {word} | " + " | ".join(shown) + " |")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=4, help="of every kind")
    parser.add_argument("--seed", type=int, default=9311)
    parser.add_argument("--rate", type=float, default=4.0, help="frames a second")
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), help="default: all")
    parser.add_argument("--drawn", action="store_true", help="draw films, circuits and rates")
    parser.add_argument("--out", type=Path, help="a table, to which recordings are appended")
    parser.add_argument("--read", type=Path, nargs="+", help="tables of docs.studies.attachments")
    given = parser.parse_args()
    made = [record for path in given.read or () for record in read(path)]
    curve = DRAWN if given.drawn else "published"
    for number in range(0 if given.read else given.scenes):
        for rate in DRAWN_HZ if given.drawn else (given.rate,):
            for kind in given.kinds or (OF_DRAWN if given.drawn else KINDS):
                made.append(seen(kind, rate, 1000 * given.seed + number, curve=curve))
                if given.out is not None:
                    write(given.out, made[-1])
    print("| answer | P | answers | mean P | true |\n|---|---|---|---|---|")
    for row in rows([record for record in made if record.kind != HAND_PUMPED]):
        print("| {} | {} | {} | {:.3f} | {} |".format(*row))
    if given.drawn:
        by_probability(made)
