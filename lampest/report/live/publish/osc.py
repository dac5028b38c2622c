"""Open Sound Control: a bundle of messages for each frame, over UDP."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar, Self
from urllib.parse import SplitResult

from lampest.files.errors import InputError
from lampest.files.extras import extra
from lampest.report.live.publish.message import Message
from lampest.report.live.publish.publish import Publish, Say, Send

PORT = 9000
MOST_BYTES = 65_507  # of a datagram


@dataclass(frozen=True)
class OscPublish(Publish):
    """`osc://HOST:PORT/PREFIX`: to a program that listens there; nobody knows whether it does."""

    kind: ClassVar[str] = "osc"
    host: str = "127.0.0.1"
    port: int = PORT
    prefix: str = "lampest"

    @classmethod
    def at(cls, where: SplitResult, token: str | None) -> Self:
        """127.0.0.1:9000/lampest by default."""
        return cls(where.hostname or cls.host, where.port or cls.port, where.path.strip("/") or cls.prefix)

    @contextmanager
    def opened(self, say: Say) -> Iterator[tuple[str, Send]]:
        """Raises InputError where the host has no address."""
        with extra("streams"):
            from pythonosc.udp_client import UDPClient
        where = f"osc://{self.host}:{self.port}/{self.prefix}"
        try:
            client = UDPClient(self.host, self.port)
        except OSError as error:
            raise InputError(f"--publish: {where}: {error.strerror or error}") from error

        def send(message: Message) -> None:
            bundle = self._bundle(message)
            if bundle.size > MOST_BYTES:
                raise OSError(f"a frame has {bundle.size} bytes, a datagram {MOST_BYTES} at most")
            client.send(bundle)

        with client:
            yield where, send

    def _bundle(self, message: Message) -> Any:
        """Sequence i, time d, size ii, status s, verdict s, solved T or F; maps, force and force_sd f."""
        from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
        from pythonosc.osc_message_builder import OscMessageBuilder

        picture = message.picture
        maps = {"cells": message.cells, "change": picture.relative_change, "pressure": message.pressure}
        parts: dict[str, list[tuple[Any, str]]] = {
            "sequence": [(picture.number, "i")],
            "time": [(picture.time, "d")],
            "size": [(message.panel.rows, "i"), (message.panel.columns, "i")],
            **{name: [(value, "f") for value in held.ravel().tolist()] for name, held in maps.items()},
            "force": [(picture.total, "f")],
            "force_sd": [(message.view.deviation, "f")],
            "verdict": [(picture.verdict, "s")],
            "solved": [(message.solved, "T" if message.solved else "F")],
            "status": [(picture.status, "s")],
        }
        bundle = OscBundleBuilder(IMMEDIATELY)
        for name, values in parts.items():
            built = OscMessageBuilder(f"/{self.prefix}/{name}")
            for value, kind in values:
                built.add_arg(value, kind)
            bundle.add_content(built.build())
        return bundle.build()
