"""Lab Streaming Layer: one stream of numbers, a sample for each frame, stamped with when its last byte arrived."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar, Self
from urllib.parse import SplitResult

import numpy as np

from lampest.files.errors import InputError, extra
from lampest.report.live.message import FORMAT, VERDICTS, Message
from lampest.report.live.publish.publish import Publish, Say, Send

QUIET = "[log]\nlevel = -1\n"  # of liblsl's own configuration: errors alone


@dataclass(frozen=True)
class LslPublish(Publish):
    """`lsl://NAME`: found by its name in the local network, with the first frame: only then its size is known."""

    kind: ClassVar[str] = "lsl"
    name: str = "lampest"

    @classmethod
    def at(cls, where: SplitResult, token: str | None) -> Self:
        return cls(where.netloc or cls.name)

    @contextmanager
    def opened(self, say: Say) -> Iterator[tuple[str, Send]]:
        with extra("streams"):
            try:
                import pylsl
            except RuntimeError as error:
                raise InputError(f"--publish: lsl: {' '.join(str(error).split())}") from error
        pylsl.set_config_content(QUIET)
        outlets: list[Any] = []

        def send(message: Message) -> None:
            row = message.row().astype(np.float32)
            if not outlets:
                info = pylsl.StreamInfo(self.name, "Pressure", len(row), pylsl.IRREGULAR_RATE, "float32", self.name)
                _describe(info.desc(), message)
                outlets.append(pylsl.StreamOutlet(info))
            outlets[0].push_sample(row, pylsl.local_clock() - (time.time() - message.picture.arrived))

        yield f"lsl://{self.name}", send
        outlets.clear()


def _describe(about: Any, message: Message) -> None:
    panel = message.panel
    head = {"format": FORMAT, "verdicts": ",".join(VERDICTS), "rows": panel.rows, "columns": panel.columns}
    _write(about, head | {"pitch_mm": panel.pitch_mm})
    channels = about.append_child("channels")
    for label, unit, place in message.channels():
        channel = channels.append_child("channel")
        _write(channel, {"label": label, "unit": unit})
        if place is not None:
            _write(channel.append_child("location"), {"X": place[0], "Y": place[1]})


def _write(element: Any, values: dict[str, Any]) -> None:
    for name, value in values.items():
        element.append_child_value(name, str(value))
