"""How a residual becomes a cost. To add a loss: write its file, name it in `AnyLoss`."""

from typing import Annotated

from lampest.cost.losses.absolute import Absolute
from lampest.cost.losses.huber import Huber
from lampest.cost.losses.loss import Loss, PenaltyEvidence
from lampest.cost.losses.squared import Squared
from lampest.cost.losses.student import Student
from lampest.files.tagged import ByKind

__all__ = ["Absolute", "AnyLoss", "Huber", "Loss", "PenaltyEvidence", "Squared", "Student"]
AnyLoss = Annotated[Squared | Huber | Absolute | Student, ByKind("lampest.losses")]
