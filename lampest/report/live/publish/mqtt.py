"""MQTT: the message as JSON to a topic of a broker."""

import socket
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Any, ClassVar

from lampest.files.errors import InputError, extra
from lampest.report.live.message import Message
from lampest.report.live.publish.publish import Publish, Say, Send

CONNECT_SECONDS, CLOSE_SECONDS = 5.0, 1.0  # for a broker to answer, and to take the last message
PAUSES_SECONDS = 1, 10  # between attempts to reach a broker that went away
LATEST_SECONDS = 0.2  # that a broker may take to confirm a message before those that follow are left out


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
        with extra("streams"):
            from paho.mqtt.client import Client
            from paho.mqtt.enums import CallbackAPIVersion
        if set(self.path) & set("+#"):
            raise InputError(f"--publish: mqtt: '{self.path}' is no topic to publish to: + and # stand for others")
        client: Any = Client(CallbackAPIVersion.VERSION2)
        client.connect_timeout, client.on_socket_open = CONNECT_SECONDS, _at_once
        client.reconnect_delay_set(*PAUSES_SECONDS)
        client.username_pw_set(self.user, self.password)
        waiting: deque[tuple[Any, float]] = deque()  # messages that are not confirmed, and when each was sent

        def send(message: Message) -> None:
            while waiting and waiting[0][0].is_published():
                waiting.popleft()
            now = time.monotonic()
            if client.is_connected() and (not waiting or now - waiting[0][1] < LATEST_SECONDS):
                waiting.append((client.publish(self.path, message.text(), qos=1), now))

        try:
            self._connect(client)
            gone = f"{self.where}: the broker is gone"
            client.on_disconnect = lambda *event: say(f"{gone} ({event[3]}); it is called again")
            client.on_connect = lambda *event: say(f"{self.where}: the broker is back")
            yield self.where, send
        finally:
            client.on_disconnect = None
            client.disconnect()  # which waits for ever for a broker that does not read
            until = time.monotonic() + CLOSE_SECONDS
            while client.socket() is not None and time.monotonic() < until:
                time.sleep(0.01)
            with suppress(OSError, AttributeError):  # it has gone meanwhile
                client.socket().shutdown(socket.SHUT_RDWR)
            client.loop_stop()

    def _connect(self, client: Any) -> None:
        """Wait until the broker has said that it takes us. Raises InputError where it does not."""
        answers: SimpleQueue[Any] = SimpleQueue()
        client.on_connect = client.on_disconnect = lambda *event: answers.put(event[3])
        try:
            client.connect(self.host, self.port)
            client.loop_start()
            answer = answers.get(timeout=CONNECT_SECONDS)
        except (OSError, ValueError, Empty) as error:
            raise InputError(f"--publish: {self.where}: no broker answers ({error or 'it says nothing'})") from error
        if answer.is_failure:
            raise InputError(f"--publish: {self.where}: the broker refuses ({answer})")


def _at_once(client: Any, user: Any, connection: Any) -> None:
    """A short segment does not wait until the one before is confirmed (RFC 896), up to 0.5 s later (RFC 1122)."""
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
