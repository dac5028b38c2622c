"""Zarr: a group for every case in one zip archive, as xarray has it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar
from zipfile import ZipFile, ZipInfo

from lampest.files.extras import extra
from lampest.report.export.export import Export
from lampest.runs.case import CaseResult


class ZarrExport(Export):
    """`xarray.open_datatree(zarr.storage.ZipStore(path), engine="zarr")`: groups recording/estimator.

    Version 2 of the format, which every library for zarr reads. One archive, because a folder of thousands of files
    cannot appear whole.
    """

    kind: ClassVar[str] = "zarr"
    suffix: ClassVar[str] = ".zarr.zip"

    def write(self, cases: Sequence[CaseResult], name: str, path: Path, beside: Path | None) -> None:
        """The archive."""
        with extra("export"):
            from xarray import DataTree
            from zarr.storage import MemoryStore
        tree = DataTree.from_dict({f"/{case.recording}/{case.estimator}": case.to_xarray() for case in cases})
        held: dict[str, Any] = {}  # zarr writes some keys several times, and an archive would keep them all
        tree.to_zarr(MemoryStore(held), mode="w", zarr_format=2)
        with ZipFile(path, "w") as archive:
            for key in sorted(held):
                archive.writestr(ZipInfo(key), held[key].to_bytes())
