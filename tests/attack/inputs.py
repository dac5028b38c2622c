"""Files that are nearly right, of every kind that is read: each is taken, or refused with one sentence."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from attack.attack import HELD, Attack
from fuzz.mutants import SUFFIXES, corpus
from fuzz.readers import ReceptionError, receive


def _nearly_right(kind: str) -> Callable[..., Iterator[str]]:
    def tries(rng: np.random.Generator, folder: Path, count: int) -> Iterator[str]:
        """A good file after some changes; the number that is named stands for the same input in every process."""
        inputs = corpus(folder)
        for number in map(int, rng.integers(2**31, size=count)):
            try:
                receive(inputs.mutant(number, kind), folder)
                yield HELD
            except ReceptionError as fault:
                yield f"{number}: {fault}"

    return tries


ATTACKS = tuple(Attack("inputs", f"files that are nearly a {kind}", _nearly_right(kind), 40, 2500) for kind in SUFFIXES)
