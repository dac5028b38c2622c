"""The kinds of readout. To add one: write its file, name it in `AnyReadout`."""

from typing import Annotated

from lampest.files.typed import ByKind
from lampest.panel.readouts.driven_readout import DrivenReadout as DrivenReadout
from lampest.panel.readouts.presets import GroundedReadout as GroundedReadout
from lampest.panel.readouts.presets import LoadedColumnsReadout as LoadedColumnsReadout
from lampest.panel.readouts.presets import VirtualGroundReadout as VirtualGroundReadout
from lampest.panel.readouts.readout import Readout as Readout
from lampest.panel.readouts.two_point import TwoPointReadout as TwoPointReadout

AnyReadout = Annotated[
    TwoPointReadout | DrivenReadout | LoadedColumnsReadout | GroundedReadout | VirtualGroundReadout,
    ByKind("lampest.readouts", "two_point"),
]
