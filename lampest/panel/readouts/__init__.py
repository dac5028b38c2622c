"""The kinds of readout. To add one: write its file, name it in `AnyReadout`."""

from typing import Annotated

from lampest.files.tagged import ByKind
from lampest.panel.readouts.loaded_columns.readout import LoadedColumnsReadout
from lampest.panel.readouts.readout import Readout
from lampest.panel.readouts.two_point.readout import TwoPointReadout

__all__ = ["AnyReadout", "LoadedColumnsReadout", "Readout", "TwoPointReadout"]
AnyReadout = Annotated[TwoPointReadout | LoadedColumnsReadout, ByKind("lampest.readouts", "two_point")]
