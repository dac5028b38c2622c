"""Who was measured, and for what: what no estimate depends on."""

from dataclasses import dataclass
from typing import Any, ClassVar

from lampest.files.typed import Validated


@dataclass(frozen=True)
class MeasuredSubject(Validated):
    """Who touched the panel.

    Parameters
    ----------
    id : its name in the laboratory. species : its Latin name. length_mm : of the body. mass_g : of the body.
    note : what else there is to say.

    Empty or None: not told. Raises ValueError where a number is not positive.

    >>> lampest.MeasuredSubject(species="Petromyzon marinus").species
    'Petromyzon marinus'
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    id: str = ""
    species: str = ""
    length_mm: float | None = None
    mass_g: float | None = None
    note: str = ""

    def __post_init__(self) -> None:
        for name in ("length_mm", "mass_g"):
            value = getattr(self, name)
            if value is not None and not 0 < value < float("inf"):
                raise ValueError(f"{name} must be positive and finite")


@dataclass(frozen=True)
class Experiment(Validated):
    """What it was measured for.

    Parameters
    ----------
    title : in a few words. experimenter : who did it. institution : where. water_temperature_celsius : of the water
        around the panel; what warmth does to the film is another key, `temperature`. note : what else there is to say.

    Empty or None: not told. Raises ValueError where the water is no water.

    >>> lampest.Experiment(title="attachment").title
    'attachment'
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    title: str = ""
    experimenter: str = ""
    institution: str = ""
    water_temperature_celsius: float | None = None
    note: str = ""

    def __post_init__(self) -> None:
        celsius = self.water_temperature_celsius
        if celsius is not None and not -5 <= celsius <= 100:
            raise ValueError("water_temperature_celsius must lie between -5 and 100")
