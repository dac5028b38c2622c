"""Open Sound Control: a bundle of messages for each frame, over UDP."""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar, Self
from urllib.parse import SplitResult

from lampest.files.errors import InputError, extra
from lampest.report.live.message import COMPACT, Message
from lampest.report.live.publish.publish import Publish, Say, Send

MOST_BYTES = 65_507  # of a UDP datagram over IPv4


@dataclass(frozen=True)
class OscPublish(Publish):
    """`osc://HOST:PORT/PREFIX`: to a program that listens there; nobody knows whether it does."""

    kind: ClassVar[str] = "osc"
    host: str = "127.0.0.1"
    port: int = 9000
    prefix: str = "lampest"

    @classmethod
    def at(cls, where: SplitResult, token: str | None) -> Self:
        return cls(where.hostname or cls.host, where.port or cls.port, where.path.strip("/") or cls.prefix)

    @contextmanager
    def opened(self, say: Say) -> Iterator[tuple[str, Send]]:
        with extra("streams"):
            from pythonosc.udp_client import UDPClient
        where = f"osc://{self.host}:{self.port}/{self.prefix}"
        try:
            client = UDPClient(self.host, self.port)
        except OSError as error:
            raise InputError(f"--publish: {where}: {error.strerror or error}") from error
        with client:
            yield where, lambda message: client.send(self._bundle(message))

    def _bundle(self, message: Message) -> Any:
        """Sequence i, time d, size ii, texts s, solved T or F; maps, force, force_sd and probability f."""
        from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
        from pythonosc.osc_message_builder import OscMessageBuilder

        picture, bundle, detected = message.picture, OscBundleBuilder(IMMEDIATELY), message.view.detected
        parts: list[tuple[str, str, Sequence[Any]]] = [
            ("sequence", "i", [picture.number]),
            ("time", "d", [picture.time]),
            ("size", "i", message.panel.shape),
            *((name, "f", values.ravel().tolist()) for name, values in message.maps.items()),
            ("force", "f", [picture.force.newton]),
            ("force_sd", "f", [message.view.deviation]),
            ("verdict", "s", [picture.verdict]),
            ("solved", "T" if message.solved else "F", [message.solved]),
            ("status", "s", [picture.status]),
            ("alarm", "s", [message.view.alarm]),
        ]
        if detected is not None:
            content = json.dumps(detected.content(), **COMPACT)
            parts += [
                ("answer", "s", [detected.answer]),
                ("probability", "f", [detected.probability]),
                ("sentence", "s", [detected.sentence]),
                ("detection", "s", [content]),
            ]
        for name, kind, values in parts:
            built = OscMessageBuilder(f"/{self.prefix}/{name}")
            for value in values:
                built.add_arg(value, kind)
            bundle.add_content(built.build())
        whole = bundle.build()
        if whole.size > MOST_BYTES:
            raise OSError(f"a frame has {whole.size} bytes, a datagram {MOST_BYTES} at most")
        return whole
