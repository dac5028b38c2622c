"""MQTT: the message as JSON to a topic of a broker."""

import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, ClassVar, Self
from urllib.parse import SplitResult, unquote

from lampest.files.errors import InputError
from lampest.files.extras import extra
from lampest.report.live.publish.message import Message
from lampest.report.live.publish.publish import Publish, Say, Send

PORT = 1883
CONNECT_SECONDS = 5.0
LONGEST_PAUSE_SECONDS = 10  # between attempts to reach a broker that went away
CLOSE_SECONDS = 1.0  # for a broker to take the last message


@dataclass(frozen=True)
class MqttPublish(Publish):
    """`mqtt://USER:PASSWORD@HOST:PORT/TOPIC`; a message is lost rather than late: nothing is kept for who is away."""

    kind: ClassVar[str] = "mqtt"
    host: str = "localhost"
    port: int = PORT
    topic: str = "lampest"
    user: str | None = None
    password: str | None = None

    @classmethod
    def at(cls, where: SplitResult, token: str | None) -> Self:
        """localhost:1883/lampest by default. Raises InputError where the topic is a pattern."""
        topic = where.path.strip("/") or cls.topic
        if set(topic) & set("+#"):
            raise InputError(f"--publish: mqtt: '{topic}' is no topic to publish to: + and # stand for others")
        user, password = (None if part is None else unquote(part) for part in (where.username, where.password))
        return cls(where.hostname or cls.host, where.port or cls.port, topic, user, password)

    @contextmanager
    def opened(self, say: Say) -> Iterator[tuple[str, Send]]:
        """Connected to the broker. Raises InputError where there is none, or it refuses."""
        with extra("streams"):
            from paho.mqtt.client import Client
            from paho.mqtt.enums import CallbackAPIVersion
        where = f"mqtt://{self.host}:{self.port}/{self.topic}"
        client = Client(CallbackAPIVersion.VERSION2)
        client.connect_timeout = CONNECT_SECONDS
        client.on_socket_open = _at_once
        client.reconnect_delay_set(1, LONGEST_PAUSE_SECONDS)
        if self.user is not None:
            client.username_pw_set(self.user, self.password)
        self._connect(client, where)
        client.on_disconnect = lambda *told: say(f"{where}: the broker is gone ({told[3]}); it is called again")
        client.on_connect = lambda *told: say(f"{where}: the broker is back")
        waiting: list[Any] = []  # the last message, as long as it is not on its way

        def send(message: Message) -> None:
            if client.is_connected() and all(one.is_published() for one in waiting):
                waiting[:] = [client.publish(self.topic, message.text())]
            elif not client.is_connected():
                waiting.clear()

        client.loop_start()
        try:
            yield where, send
        finally:
            client.on_disconnect = None
            client.disconnect()
            _hang_up(client)
            client.loop_stop()

    def _connect(self, client: Any, where: str) -> None:
        """Wait until the broker has said that it takes us. Raises InputError where it does not."""
        answers: list[Any] = []
        client.on_connect = lambda *told: answers.append(told[3])
        try:
            client.connect(self.host, self.port)
            while not answers and client.loop(CONNECT_SECONDS) == 0:
                pass
        except (OSError, ValueError) as error:
            raise InputError(f"--publish: {where}: no broker answers ({error})") from error
        if not answers or answers[0].is_failure:
            said = answers[0] if answers else "it hung up"
            raise InputError(f"--publish: {where}: the broker refuses ({said})")


def _at_once(client: Any, user: Any, connection: Any) -> None:
    """Nothing waits for the broker to confirm what it got before, which it may put off for longer than a frame takes.

    RFC 896 has a short segment wait for that, RFC 1122 lets a receiver put it off for up to 0.5 s (Linux: 40 ms).
    """
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def _hang_up(client: Any) -> None:
    """Once what was said has gone out; a broker that does not read would keep the library waiting for ever."""
    until = time.monotonic() + CLOSE_SECONDS
    while client.socket() is not None and time.monotonic() < until:
        time.sleep(0.01)
    with suppress(OSError, AttributeError):  # it has gone meanwhile
        client.socket().shutdown(socket.SHUT_RDWR)
