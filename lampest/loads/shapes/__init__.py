"""What presses on the panel or sucks at it. To add a shape: write its file, name it in `AnyShape`."""

from typing import Annotated, get_args

from lampest.files.tagged import ByKind
from lampest.loads.shapes.block import Block as Block
from lampest.loads.shapes.oral_disc import OralDisc as OralDisc
from lampest.loads.shapes.ring import Ring as Ring
from lampest.loads.shapes.rod import Rod as Rod
from lampest.loads.shapes.shape import Shape as Shape
from lampest.loads.shapes.suction_cup import SuctionCup as SuctionCup

AnyShape = Annotated[Rod | Ring | SuctionCup | OralDisc | Block, ByKind()]


def shape_types() -> tuple[type[Shape], ...]:
    """Every member of the union, in its order."""
    return get_args(get_args(AnyShape)[0])
