"""Results for other programs. To add a format: write its `Export` into a file here, name it in EXPORTS.

A package adds formats by naming them in the entry point group `lampest.exports`, a script by handing one to
`export_results`.
"""

from lampest.files.errors import InputError
from lampest.files.plugins import installed
from lampest.report.export.csv_table import CsvExport
from lampest.report.export.export import Export
from lampest.report.export.matlab import MatlabExport
from lampest.report.export.nwb import NwbExport
from lampest.report.export.parquet import ParquetExport
from lampest.report.export.zarr_archive import ZarrExport

__all__ = ["EXPORTS", "Export", "export_of"]
EXPORTS: tuple[Export, ...] = (CsvExport(), ParquetExport(), MatlabExport(), ZarrExport(), NwbExport())


def export_of(kind: str) -> Export:
    """The format of that kind, of lampest or of an installed package. Raises InputError where there is none or two."""
    exports: tuple[Export, ...] = (*EXPORTS, *installed("lampest.exports", Export))
    named = [export for export in exports if export.kind == kind]
    if len(named) != 1:
        kinds = ", ".join(dict.fromkeys(export.kind for export in exports))
        raise InputError(
            f"--to: there {'is no format' if not named else 'are two formats'} '{kind}'; there are {kinds}"
        )
    return named[0]
