"""MQTT: the message as JSON to a topic of a broker."""

import socket
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Any, ClassVar, Self
from urllib.parse import SplitResult, unquote

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
    topic: str = "lampest"
    user: str | None = None
    password: str | None = None

    @classmethod
    def at(cls, where: SplitResult, token: str | None) -> Self:
        topic = where.path.strip("/") or cls.topic
        if set(topic) & set("+#"):
            raise InputError(f"--publish: mqtt: '{topic}' is no topic to publish to: + and # stand for others")
        user, password = (None if part is None else unquote(part) for part in (where.username, where.password))
        return cls(where.hostname or cls.host, where.port or cls.port, topic, user, password)

    @contextmanager
    def opened(self, say: Say) -> Iterator[tuple[str, Send]]:
        with extra("streams"):
            from paho.mqtt.client import Client
            from paho.mqtt.enums import CallbackAPIVersion
        where = f"mqtt://{self.host}:{self.port}/{self.topic}"
        client = Client(CallbackAPIVersion.VERSION2)
        client.connect_timeout, client.on_socket_open = CONNECT_SECONDS, _at_once
        client.reconnect_delay_set(*PAUSES_SECONDS)
        client.username_pw_set(self.user, self.password)
        waiting: deque[tuple[Any, float]] = deque()  # messages that are not confirmed, and when each was sent

        def send(message: Message) -> None:
            while waiting and waiting[0][0].is_published():
                waiting.popleft()
            now = time.monotonic()
            if client.is_connected() and (not waiting or now - waiting[0][1] < LATEST_SECONDS):
                waiting.append((client.publish(self.topic, message.text(), qos=1), now))

        try:
            _connect(client, self.host, self.port, where)
            client.on_disconnect = lambda *event: say(f"{where}: the broker is gone ({event[3]}); it is called again")
            client.on_connect = lambda *event: say(f"{where}: the broker is back")
            yield where, send
        finally:
            client.on_disconnect = None
            _close(client)


def _connect(client: Any, host: str, port: int, where: str) -> None:
    """Wait until the broker has said that it takes us. Raises InputError where it does not."""
    answers: SimpleQueue[Any] = SimpleQueue()
    client.on_connect = client.on_disconnect = lambda *event: answers.put(event[3])
    try:
        client.connect(host, port)
        client.loop_start()
        answer = answers.get(timeout=CONNECT_SECONDS)
    except (OSError, ValueError, Empty) as error:
        raise InputError(f"--publish: {where}: no broker answers ({error or 'it says nothing'})") from error
    if answer.is_failure:
        raise InputError(f"--publish: {where}: the broker refuses ({answer})")


def _at_once(client: Any, user: Any, connection: Any) -> None:
    """A short segment does not wait until the one before is confirmed (RFC 896), up to 0.5 s later (RFC 1122)."""
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def _close(client: Any) -> None:
    """Once what was said has gone out; a broker that does not read would keep the library waiting for ever."""
    client.disconnect()
    until = time.monotonic() + CLOSE_SECONDS
    while client.socket() is not None and time.monotonic() < until:
        time.sleep(0.01)
    with suppress(OSError, AttributeError):  # it has gone meanwhile
        client.socket().shutdown(socket.SHUT_RDWR)
    client.loop_stop()
