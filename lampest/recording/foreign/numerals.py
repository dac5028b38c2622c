"""Texts as numbers: decimal points and commas, thousands apart, and the words for a reading that is missing."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array

# What programs write where they have no number: NumPy, R, MATLAB, JSON, Arduino's Print (ovf), multimeters (OL),
# Microsoft's C library (1.#QNAN) and Excel (#DIV/0!).
MISSING = (
    "nan -nan +nan na n/a null none nil ovf -ovf ol o.l o.l. overload overflow over err error missing ? ?? . "
    "-inf -infinity nan(ind) -nan(ind) 1.#ind -1.#ind 1.#qnan #n/a #na #div/0! #num! #value! #ref!"
)
MISSING_WORDS = frozenset(MISSING.split())
INFINITE_WORDS = frozenset(("inf", "+inf", "infinity", "+infinity", "∞", "1.#inf"))
POINT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+|\d{1,3}(,\d{3})+(\.\d*)?)([eE][+-]?\d+)?", re.ASCII)
COMMA = re.compile(r"[+-]?(\d+(,\d+)?|,\d+|\d{1,3}(\.\d{3})+(,\d+)?)([eE][+-]?\d+)?", re.ASCII)

LONGEST = 100  # signs of a number: more are none, and the patterns would take long to say so


@dataclass(frozen=True)
class Numerals:
    """How a file writes numbers: with a decimal comma or a point; the other sign may set thousands apart."""

    comma: bool

    @classmethod
    def of(cls, fields: Sequence[str]) -> "Numerals":
        """The way that reads more of these fields; where both read the same, a comma that stands alone is decimal."""
        numbers = [field for field in fields if _is_comma(field) or _is_point(field)]
        commas = sum(map(_is_comma, numbers)) - sum(map(_is_point, numbers))
        text = "".join(numbers)
        return cls(commas > 0 or (commas == 0 and "," in text and "." not in text))

    def is_number(self, field: str) -> bool:
        """Whether a text is a number, a word for infinity, or one for a missing reading."""
        word = field.strip().lower()
        written = _is_comma(word) if self.comma else _is_point(word)
        return written or word in MISSING_WORDS or word in INFINITE_WORDS or (word != "" and not word.strip("-"))

    def numbers(self, fields: NDArray[Any]) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
        """Numbers of texts, any shape; where a reading is missing by a word or an empty field; where neither.

        NaN where there is no number.
        """
        import pandas  # takes 0.3 s

        texts = fields.ravel()
        # With commas, points may set thousands apart: those are left to `_read`.
        plain = ["" if len(text) > LONGEST or (self.comma and "." in text) else text for text in texts]
        if self.comma:
            plain = [text.replace(",", ".") for text in plain]
        values = pandas.to_numeric(pandas.Series(plain, dtype=object), errors="coerce").to_numpy(float).copy()
        missing, words = np.zeros(len(texts), dtype=bool), np.zeros(len(texts), dtype=bool)
        for number in np.flatnonzero(np.isnan(values) | np.isneginf(values)):
            values[number], missing[number] = self._read(texts[number].lower())
            words[number] = np.isnan(values[number]) and not missing[number]
        return values.reshape(fields.shape), missing.reshape(fields.shape), words.reshape(fields.shape)

    def _read(self, word: str) -> tuple[float, bool]:
        """The number of one text, NaN for none; whether it stands for a missing one."""
        if word in MISSING_WORDS or not word.strip("-"):
            return np.nan, True
        if word in INFINITE_WORDS:
            return np.inf, False
        if (_is_comma if self.comma else _is_point)(word):
            decimal, thousands = (",", ".") if self.comma else (".", ",")
            return float(word.replace(thousands, "").replace(decimal, ".")), False
        return np.nan, False


def _is_comma(field: str) -> bool:
    return len(field) <= LONGEST and COMMA.fullmatch(field) is not None


def _is_point(field: str) -> bool:
    return len(field) <= LONGEST and POINT.fullmatch(field) is not None
