"""Shapes of loads on the panel. To add one, write its class and add it to `AnyShape`."""

from typing import TYPE_CHECKING, Annotated

from lampest.files.typed import ByKind
from lampest.recording.shapes.kinds import Block as Block
from lampest.recording.shapes.kinds import OralDisc as OralDisc
from lampest.recording.shapes.kinds import Ring as Ring
from lampest.recording.shapes.kinds import Rod as Rod
from lampest.recording.shapes.kinds import SuctionCup as SuctionCup
from lampest.recording.shapes.shape import Shape as Shape

if TYPE_CHECKING:
    AnyShape = Shape  # a shape that a user derives may stand wherever these may
else:
    AnyShape = Annotated[Rod | Ring | SuctionCup | OralDisc | Block, ByKind("lampest.shapes")]
