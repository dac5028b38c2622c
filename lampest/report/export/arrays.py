"""Export as labelled arrays: MATLAB 5 (for MATLAB, Octave and SciPy) and Zarr (for xarray)."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar
from zipfile import ZipFile, ZipInfo

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError, extra
from lampest.report.export.export import Export
from lampest.runs.case import CaseResult, about, places_of, series_of
from lampest.runs.held import all_columns


class MatlabExport(Export):
    """`cases{1}.cell_resistance` is frames × rows × columns; `cases{1}.units.cell_resistance` says 'ohm'.

    `long_name` has the meanings in words; `flags.open_cell.values` and `.meanings` what the values of a flag say; `y`
    and `x` the positions in mm of the lines in `row` and `column`; texts of frames are cells of texts.
    """

    kind: ClassVar[str] = "mat"
    suffix: ClassVar[str] = ".mat"

    def write(self, cases: Sequence[CaseResult], name: str, path: Path, beside: Path | None) -> None:
        """Write a cell array of structs, since cases may hold different columns."""
        from scipy.io import savemat
        from scipy.io.matlab import MatWriteError

        held = {"cases": _cells([_struct(case) for case in cases]).reshape(1, -1)}
        try:
            with path.open("wb") as file:
                savemat(file, held, long_field_names=True, do_compression=True, oned_as="column")
        except (ValueError, MatWriteError) as error:
            raise InputError(f"{name}: does not fit a MATLAB 5 file ({error})") from error


def _struct(case: CaseResult) -> dict[str, Any]:
    held, places = series_of(case, all_columns()), places_of(case)
    words = {name: zip(*series.flags, strict=True) for name, series in held.items() if series.flags}
    flags = {name: {"values": np.array(numbers), "meanings": _cells(texts)} for name, (numbers, texts) in words.items()}
    values = {name: _cells(series.values) if series.dtype is str else series.stored for name, series in held.items()}
    units = {name: series.units for name, series in (held | places).items() if name not in ("row", "column")}
    names = {name: series.long_name for name, series in held.items()}
    where = {name: series.values for name, series in places.items()}
    return about(case) | values | where | {"units": units, "long_name": names, "flags": flags}


def _cells(things: Sequence[Any]) -> NDArray[Any]:
    """Return a MATLAB cell array of shape (items, 1)."""
    cells = np.empty((len(things), 1), dtype=np.object_)
    cells[:, 0] = [*things]
    return cells


class ZarrExport(Export):
    """`xarray.open_datatree(zarr.storage.ZipStore(path), engine="zarr")`: groups recording/estimator.

    Version 2 of the format, which every library for zarr reads; one zip archive, because a folder of thousands of files
    cannot appear whole.
    """

    kind: ClassVar[str] = "zarr"
    suffix: ClassVar[str] = ".zarr.zip"

    def write(self, cases: Sequence[CaseResult], name: str, path: Path, beside: Path | None) -> None:
        """Write the zip archive."""
        with extra("export"):
            from xarray import DataTree
            from zarr.storage import MemoryStore
        tree = DataTree.from_dict({f"/{case.recording}/{case.estimator}": case.to_xarray() for case in cases})
        held: dict[str, Any] = {}  # zarr writes some keys several times, and an archive would keep them all
        tree.to_zarr(MemoryStore(held), mode="w", zarr_format=2)
        with ZipFile(path, "w") as archive:
            for key in sorted(held):
                archive.writestr(ZipInfo(key), held[key].to_bytes())
