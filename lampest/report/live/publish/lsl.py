"""Lab Streaming Layer: one stream of numbers, a sample for each frame, stamped with when its last byte arrived."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar, Self
from urllib.parse import SplitResult

import numpy as np

from lampest.files.errors import InputError
from lampest.files.extras import extra
from lampest.panel.panel import Panel
from lampest.report.live.publish.message import FORMAT, Message
from lampest.report.live.publish.publish import Publish, Say, Send
from lampest.report.live.verdict import VERDICTS

NUMBERS = (("sequence", "1"), ("force", "newton"), ("verdict", "1"), ("solved", "1"))
QUIET = "[log]\nlevel = -1\n"  # errors alone; the library tells its life otherwise
MAPS = (("change", "percent"), ("pressure", "kPa"), ("cells", "ohm"))


@dataclass(frozen=True)
class LslPublish(Publish):
    """`lsl://NAME`: found by its name in the local network."""

    kind: ClassVar[str] = "lsl"
    name: str = "lampest"

    @classmethod
    def at(cls, where: SplitResult, token: str | None) -> Self:
        """The name `lampest` by default."""
        return cls(where.netloc or cls.name)

    @contextmanager
    def opened(self, say: Say) -> Iterator[tuple[str, Send]]:
        """The stream appears with the first frame: before it nobody knows how many cells there are."""
        with extra("streams"):
            try:
                import pylsl
            except RuntimeError as error:
                raise InputError(f"--publish: lsl: {' '.join(str(error).split())}") from error
        pylsl.set_config_content(QUIET)
        outlets: list[Any] = []

        def send(message: Message) -> None:
            if not outlets:
                outlets.append(pylsl.StreamOutlet(self._info(message.panel)))
            picture = message.picture
            numbers = (picture.number, picture.total, VERDICTS.index(picture.verdict), message.solved)
            maps = (picture.relative_change, message.pressure, message.cells)
            held = (*(one.ravel() for one in maps), [message.view.deviation])
            sample = np.concatenate([np.array(numbers, dtype=float), *held])
            outlets[0].push_sample(sample.astype(np.float32), pylsl.local_clock() - (time.time() - picture.arrived))

        yield f"lsl://{self.name}", send
        outlets.clear()

    def _info(self, panel: Panel) -> Any:
        """What the stream is, and each of its channels: label, unit, and where its cell lies in metre."""
        import pylsl

        described: list[tuple[str, str, tuple[float, float] | None]]
        described = [(label, unit, None) for label, unit in NUMBERS]
        described += [
            (f"{label}_{row}_{column}", unit, (column * panel.pitch_mm / 1000, row * panel.pitch_mm / 1000))
            for label, unit in MAPS
            for row, column in np.ndindex(panel.shape)
        ]
        described.append(("force_sd", "newton", None))
        info = pylsl.StreamInfo(self.name, "Pressure", len(described), pylsl.IRREGULAR_RATE, "float32", self.name)
        about = info.desc()
        about.append_child_value("format", FORMAT).append_child_value("verdicts", ",".join(VERDICTS))
        for name, number in (("rows", panel.rows), ("columns", panel.columns), ("pitch_mm", panel.pitch_mm)):
            about.append_child_value(name, str(number))
        channels = about.append_child("channels")
        for label, unit, place in described:
            channel = channels.append_child("channel")
            channel.append_child_value("label", label).append_child_value("unit", unit)
            if place is not None:
                location = channel.append_child("location")
                location.append_child_value("X", str(place[0])).append_child_value("Y", str(place[1]))
        return info
