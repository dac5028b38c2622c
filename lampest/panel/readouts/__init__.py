"""The kinds of readout. To add one: write its file, name it in `KINDS`.

A kind is imported when a scene has it. One whose file is deleted is gone.
"""

from importlib.util import find_spec
from typing import Annotated

from lampest.files.typed import ByKind
from lampest.panel.readouts.readout import Readout as Readout
from lampest.panel.readouts.two_point import TwoPointReadout as TwoPointReadout

KINDS = {
    kind: target
    for kind, target in {
        "two_point": "lampest.panel.readouts.two_point:TwoPointReadout",
        "driven": "lampest.panel.readouts.driven_readout:DrivenReadout",
        "loaded_columns": "lampest.panel.readouts.loaded_columns:LoadedColumnsReadout",
        "grounded": "lampest.panel.readouts.grounded:GroundedReadout",
        "virtual_ground": "lampest.panel.readouts.virtual_ground:VirtualGroundReadout",
    }.items()
    if find_spec(target.partition(":")[0]) is not None
}
AnyReadout = Annotated[Readout, ByKind("lampest.readouts", "two_point", KINDS)]
