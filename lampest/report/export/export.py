"""Interface of export formats."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from lampest.runs.case import CaseResult


@dataclass(frozen=True)
class Export(ABC):
    """An export format.

    Attributes
    ----------
    kind : str
        Name on the command line.
    suffix : str
        Suffix of the file.
    beside : str
        Suffix of a second file for metadata; '' for none.

    >>> from lampest.report.export.tables import CsvExport
    >>> issubclass(CsvExport, lampest.Export)
    True
    """

    kind: ClassVar[str]
    suffix: ClassVar[str]
    beside: ClassVar[str] = ""

    @abstractmethod
    def write(self, cases: Sequence[CaseResult], name: str, path: Path, beside: Path | None) -> None:
        """Write the cases into the empty file `path`, and metadata into `beside`.

        name : final name of `path`. Raises InputError for a missing library or cases that do not fit the format.
        """
