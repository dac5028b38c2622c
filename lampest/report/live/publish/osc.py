"""Open Sound Control: a bundle of messages for each frame, over UDP."""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar

from lampest.files.errors import InputError, extra
from lampest.report.live.message import COMPACT, Message
from lampest.report.live.publish.publish import Publish, Say, Send


@dataclass(frozen=True)
class OscPublish(Publish):
    """`osc://HOST:PORT/PREFIX`: to a program that listens there, without confirmation."""

    kind: ClassVar[str] = "osc"
    port: int = 9000

    @contextmanager
    def opened(self, say: Say) -> Iterator[tuple[str, Send]]:
        """Open the stream, as `Publish.opened`."""
        with extra("streams"):
            from pythonosc.udp_client import UDPClient
        try:
            client = UDPClient(self.host, self.port)
        except OSError as error:
            raise InputError(f"--publish: {self.where}: {error.strerror or error}") from error
        with client:
            yield self.where, lambda message: client.send(self._bundle(message))

    def _bundle(self, message: Message) -> Any:
        """Return the bundle: sequence i, time d, size ii, texts s, solved T or F; maps, force and probability f."""
        from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
        from pythonosc.osc_message_builder import OscMessageBuilder

        picture, bundle, detected = message.picture, OscBundleBuilder(IMMEDIATELY), message.view.detected
        parts: list[tuple[str, str, Sequence[Any]]] = [("sequence", "i", [picture.number])]
        parts += [("time", "d", [picture.time]), ("size", "i", message.panel.shape)]
        parts += [(name, "f", values.ravel().tolist()) for name, values in message.maps.items()]
        parts += [("force", "f", [picture.force.newton]), ("force_sd", "f", [message.view.deviation])]
        parts += [("verdict", "s", [picture.verdict]), ("solved", "T" if message.solved else "F", [message.solved])]
        parts += [("status", "s", [picture.status]), ("alarm", "s", [message.view.alarm])]
        if detected is not None:
            content = json.dumps(detected.content(), **COMPACT)
            parts += [("answer", "s", [detected.answer]), ("probability", "f", [detected.probability])]
            parts += [("sentence", "s", [detected.sentence]), ("detection", "s", [content])]
        for name, kind, values in parts:
            built = OscMessageBuilder(f"/{self.path}/{name}")
            for value in values:
                built.add_arg(value, kind)
            bundle.add_content(built.build())
        return bundle.build()
