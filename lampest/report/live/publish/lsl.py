"""Lab Streaming Layer: the numbers of each frame with the arrival time of its last byte, and changed answers."""

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar, Self
from urllib.parse import SplitResult

import numpy as np

from lampest.files.errors import InputError, extra
from lampest.report.detect.answer import ANSWERS
from lampest.report.live.message import COMPACT, FORMAT, VERDICTS, Message
from lampest.report.live.publish.publish import Publish, Say, Send


@dataclass(frozen=True)
class LslPublish(Publish):
    """`lsl://NAME`: announced by name in the local network at the first frame, when its size is known.

    `NAME-answer` has a line of JSON whenever the answer or the alarm changes.
    """

    kind: ClassVar[str] = "lsl"

    @classmethod
    def at(cls, where: SplitResult, token: str | None) -> Self:
        """Return the target, as `Publish.at`."""
        return cls(path=where.netloc or cls.path)

    @contextmanager
    def opened(self, say: Say) -> Iterator[tuple[str, Send]]:
        """Open the stream, as `Publish.opened`."""
        with extra("streams"):
            try:
                import pylsl
            except RuntimeError as error:
                raise InputError(f"--publish: lsl: {' '.join(str(error).split())}") from error
        pylsl.set_config_content("[log]\nlevel = -1\n")  # of liblsl's own: errors alone
        outlets, sent = list[Any](), [(0, "", "")]

        def send(message: Message) -> None:
            row, view, (frame, *before) = message.row().astype(np.float32), message.view, sent.pop()
            if not outlets:
                number = pylsl.StreamInfo(self.path, "Pressure", len(row), pylsl.IRREGULAR_RATE, "float32", self.path)
                _describe(number.desc(), message)
                name = f"{self.path}-answer"
                text = pylsl.StreamInfo(name, "Markers", 1, pylsl.IRREGULAR_RATE, "string", name)
                outlets.extend(pylsl.StreamOutlet(info) for info in (number, text))
            sent.append(message.signature)
            if message.picture.number != frame:
                outlets[0].push_sample(row, pylsl.local_clock() - (time.time() - message.picture.arrived))
            if [*message.signature[1:]] != before:
                content = {"detection": view.detected and view.detected.content(), "alarm": view.alarm}
                outlets[1].push_sample([json.dumps(content, **COMPACT)])

        yield f"lsl://{self.path}", send
        outlets.clear()


def _describe(about: Any, message: Message) -> None:
    panel = message.panel
    texts = {"format": FORMAT, "verdicts": ",".join(VERDICTS), "answers": ",".join(ANSWERS)}
    for name, text in (texts | {"rows": panel.rows, "columns": panel.columns, "pitch_mm": panel.pitch_mm}).items():
        about.append_child_value(name, str(text))
    channels = about.append_child("channels")
    for label, unit, place in message.channels():
        channel = channels.append_child("channel")
        channel.append_child_value("label", label)
        channel.append_child_value("unit", unit)
        if place is not None:
            location = channel.append_child("location")
            location.append_child_value("X", str(place[0]))
            location.append_child_value("Y", str(place[1]))
