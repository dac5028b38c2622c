"""What a format for other programs is."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from lampest.runs.case import CaseResult


@dataclass(frozen=True)
class Export(ABC):
    """One format.

    kind : the word that asks for it. suffix : of its files. beside : the suffix of a second file for what the first
    cannot hold; '' for none.

    >>> from lampest.report.export.tables import CsvExport
    >>> issubclass(CsvExport, lampest.Export)
    True
    """

    kind: ClassVar[str]
    suffix: ClassVar[str]
    beside: ClassVar[str] = ""

    @abstractmethod
    def write(self, cases: Sequence[CaseResult], name: str, path: Path, beside: Path | None) -> None:
        """Write the cases into the empty file `path`, and what that cannot hold into `beside`.

        name : that `path` will have once it is whole. Raises InputError where a library is missing, or the cases do not
        fit the format.
        """
