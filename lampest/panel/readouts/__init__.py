"""The kinds of readout. To add one: write its file, name it in `AnyReadout`."""

from typing import Annotated

from lampest.files.typed import ByKind
from lampest.panel.readouts.grounded import GroundedReadout, VirtualGroundReadout
from lampest.panel.readouts.loaded_columns import LoadedColumnsReadout
from lampest.panel.readouts.readout import Readout
from lampest.panel.readouts.two_point import TwoPointReadout

__all__ = [
    "AnyReadout",
    "GroundedReadout",
    "LoadedColumnsReadout",
    "Readout",
    "TwoPointReadout",
    "VirtualGroundReadout",
]
AnyReadout = Annotated[
    TwoPointReadout | LoadedColumnsReadout | GroundedReadout | VirtualGroundReadout,
    ByKind("lampest.readouts", "two_point"),
]
