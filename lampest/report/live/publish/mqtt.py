"""MQTT: the message as JSON to a topic of a broker."""

import socket
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, ClassVar

from lampest.files.errors import InputError, extra
from lampest.report.live.handover import FAREWELL_SECONDS
from lampest.report.live.message import Message
from lampest.report.live.publish.publish import Publish, Say, Send, waited

LATEST_SECONDS = 0.2  # longest confirmation time of a broker before following messages are left out


@dataclass(frozen=True)
class MqttPublish(Publish):
    """`mqtt://USER:PASSWORD@HOST:PORT/TOPIC`, quality of service 1.

    A message is lost rather than late: none is sent while another has not been confirmed for 0.2 s.
    """

    kind: ClassVar[str] = "mqtt"
    host: str = "localhost"
    port: int = 1883

    @contextmanager
    def opened(self, say: Say) -> Iterator[tuple[str, Send]]:
        """Open the stream, as `Publish.opened`."""
        with extra("streams"):
            from paho.mqtt.client import Client
            from paho.mqtt.enums import CallbackAPIVersion
        if set(self.path) & set("+#"):
            raise InputError(f"--publish: mqtt: '{self.path}' is no topic to publish to: + and # stand for others")
        client: Any = Client(CallbackAPIVersion.VERSION2)
        # A short segment does not wait until the one before is confirmed (RFC 896), up to 0.5 s later (RFC 1122).
        client.on_socket_open = lambda *event: event[2].setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client.reconnect_delay_set(1, 10)  # s
        client.username_pw_set(self.user, self.password)
        waiting, answers = deque[tuple[Any, float]](), list[Any]()  # not confirmed, and when sent

        def send(message: Message) -> None:
            while waiting and waiting[0][0].is_published():
                waiting.popleft()
            now = time.monotonic()
            if client.is_connected() and (not waiting or now - waiting[0][1] < LATEST_SECONDS):
                waiting.append((client.publish(self.path, message.text(), qos=1), now))

        try:
            client.on_connect = client.on_disconnect = lambda *event: answers.append(event[3])
            try:
                client.connect(self.host, self.port)
                client.loop_start()
            except (OSError, ValueError) as error:
                raise InputError(f"--publish: {self.where}: no broker answers ({error})") from error
            if not waited(lambda: bool(answers), client.connect_timeout):
                raise InputError(f"--publish: {self.where}: no broker answers (it says nothing)")
            if answers[0].is_failure:
                raise InputError(f"--publish: {self.where}: the broker refuses ({answers[0]})")
            gone, again = f"{self.where}: the broker is gone", f"{self.where}: the broker is back"
            client.on_disconnect = lambda *event: say(f"{gone} ({event[3]}); it is called again")
            client.on_connect = lambda *event: say(again)
            yield self.where, send
        finally:
            client.on_disconnect = None
            client.disconnect()
            waited(lambda: client.socket() is None, FAREWELL_SECONDS)  # the library would wait for ever
            with suppress(OSError, AttributeError):  # the connection may be closed meanwhile
                client.socket().shutdown(socket.SHUT_RDWR)
            client.loop_stop()
