"""Publication of live frames for other programs by one protocol each; see docs/reference/stream.md.

To add a protocol, write its `Publish` here and add it to WAYS.
"""

import json
import math
import re
import socket
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from http import HTTPStatus
from threading import Thread
from typing import Any, ClassVar, Self
from urllib.parse import SplitResult, unquote, urlsplit

import numpy as np

from lampest.apps.live.handover import FAREWELL_SECONDS, Newest
from lampest.apps.live.message import COMPACT, FORMAT, VERDICTS, Content, Message, View
from lampest.apps.live.server import MAX_STREAMS, TURN_SECONDS, Access, ip_named
from lampest.apps.recognition.detect.answer import ANSWERS
from lampest.files.errors import InputError, extra

LATEST_SECONDS = 0.2  # longest confirmation time of a broker before following messages are left out
MAX_DATAGRAM = 65507  # bytes: the largest payload of UDP over IPv4, 2¹⁶ − 1 less its headers
# bytes of a bundle's name and time, before its messages with four bytes each for their length
BUNDLE_HEAD = 16
NO_PREFIX = set(" #*,?[]{}")  # of OSC's addresses, which receivers would take for patterns
LOCAL_PAGES = re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?")
Send = Callable[[Message], None]
Outlet = tuple[str, Send]  # the public address, and a function that sends a message
Say = Callable[[str], None]


@dataclass(frozen=True)
class Publish(ABC):
    """A protocol with its address `KIND://USER:PASSWORD@HOST:PORT/PATH`.

    Subclasses have their own defaults for missing parts of the address. Listeners need `token`.
    """

    kind: ClassVar[str]
    host: str = "127.0.0.1"
    port: int = 0
    path: str = "lampest"
    user: str | None = None
    password: str | None = None
    token: str | None = None

    @classmethod
    def at(cls, where: SplitResult, token: str | None) -> Self:
        """Return the protocol with the parts of an address.

        Raises InputError for an invalid one.
        """
        user, password = (part and unquote(part) for part in (where.username, where.password))
        port = cls.port if where.port is None else where.port
        path = where.path.strip("/") or cls.path
        return cls(where.hostname or cls.host, port, path, user, password, token)

    @property
    def where(self) -> str:
        """Address as text."""
        return f"{self.kind}://{self.host}:{self.port}/{self.path}"

    @abstractmethod
    def opened(self, say: Say) -> AbstractContextManager[Outlet]:
        """Yield the public address and a function that sends a message.

        Sending never waits for listeners: slow ones miss messages. `say` receives sentences about
        the connection. Raises InputError for a missing library and an unreachable peer.
        """


class LslPublish(Publish):
    """`lsl://NAME`: the numbers of each frame with the arrival time of its last byte.

    Announced by name in the local network at the first frame, when its size is known. `NAME-answer`
    has a line of JSON whenever the answer or the alarm changes.
    """

    kind = "lsl"

    @classmethod
    def at(cls, where: SplitResult, token: str | None) -> Self:
        """Return the target, as `Publish.at`."""
        return cls(path=where.netloc or cls.path)

    @contextmanager
    def opened(self, say: Say) -> Iterator[Outlet]:
        """Open the stream, as `Publish.opened`."""
        with extra("streams"):
            try:
                import pylsl
            except RuntimeError as error:
                raise InputError(f"--publish: lsl: {' '.join(str(error).split())}") from error
        pylsl.set_config_content("[log]\nlevel = -1\n")  # of liblsl's own: errors alone
        outlets = list[Any]()
        sent = [(0, "", "")]

        def stream(name: str, kind: str, channels: int, form: str) -> Any:
            return pylsl.StreamInfo(name, kind, channels, pylsl.IRREGULAR_RATE, form, name)

        def send(message: Message) -> None:
            row = message.row().astype(np.float32)
            frame, *before = sent.pop()
            if not outlets:
                numbers = stream(self.path, "Pressure", len(row), "float32")
                # Channels have names, units and places in metre, as the XDF format nests them.
                channels = []
                for label, unit, place in message.channels():
                    location = (
                        {} if place is None else {"location": dict(zip("XY", place, strict=True))}
                    )
                    channels.append({"channel": {"label": label, "unit": unit} | location})
                lists = {
                    "format": FORMAT,
                    "verdicts": ",".join(VERDICTS),
                    "answers": ",".join(ANSWERS),
                }
                panel = {
                    name: getattr(message.panel, name) for name in ("rows", "columns", "pitch_mm")
                }
                _describe(numbers.desc(), lists | panel | {"channels": channels})
                answers = stream(f"{self.path}-answer", "Markers", 1, "string")
                outlets.extend(map(pylsl.StreamOutlet, (numbers, answers)))
            sent.append(message.signature)
            if message.picture.number != frame:
                outlets[0].push_sample(
                    row, pylsl.local_clock() - (time.time() - message.picture.arrived)
                )
            if [*message.signature[1:]] != before:
                content = {"detection": message.view.detection, "alarm": message.view.alarm}
                outlets[1].push_sample([json.dumps(content, **COMPACT)])

        yield f"lsl://{self.path}", send
        outlets.clear()


def _describe(element: Any, content: Content) -> None:
    """Append values to an XML element of liblsl; mappings and lists of them become children."""
    for name, value in content.items():
        if isinstance(value, dict | list):
            child = element.append_child(name)
            for part in value if isinstance(value, list) else [value]:
                _describe(child, part)
        else:
            element.append_child_value(name, str(value))


@dataclass(frozen=True)
class OscPublish(Publish):
    """`osc://HOST:PORT/PREFIX`: a bundle of messages for each frame over UDP, without confirmation.

    Messages beyond the size of a datagram follow in further ones. A message that is larger than a
    datagram is left out.
    """

    kind = "osc"
    port: int = 9000

    @contextmanager
    def opened(self, say: Say) -> Iterator[Outlet]:
        """Open the stream, as `Publish.opened`. A name is looked up once, here."""
        with extra("streams"):
            from pythonosc.udp_client import UDPClient
        if NO_PREFIX & set(self.path) or not (self.path.isascii() and self.path.isprintable()):
            raise InputError(
                f"--publish: osc: {self.path!r} is no prefix: "
                "it has ASCII letters, and none of # * , ? [ ] { } and spaces"
            )
        if self.port == 0:
            raise InputError("--publish: osc: there is no port 0: give one from 1 to 65535")
        try:
            addresses = socket.getaddrinfo(self.host, self.port, type=socket.SOCK_DGRAM)
            host, _ = socket.getnameinfo(addresses[0][4], socket.NI_NUMERICHOST)
            client = UDPClient(host, self.port)
        except UnicodeError as error:
            raise InputError(
                f"--publish: {self.where}: '{self.host}' is no name of a computer"
            ) from error
        except OSError as error:
            raise InputError(f"--publish: {self.where}: {error.strerror or error}") from error
        large = set[str]()

        def send(message: Message) -> None:
            bundles, left_out = self._bundles(message)
            for name, size in left_out.items():
                if name not in large:
                    say(f"{self.where}: {name} is left out: its {size:,} bytes fit no datagram")
                large.add(name)
            for bundle in bundles:
                client.send(bundle)

        with client:
            yield self.where, send

    def _bundles(self, message: Message) -> tuple[list[Any], dict[str, int]]:
        """Return bundles that fit a datagram each, and the sizes of messages that fit none.

        The sizes are by the names of the messages.
        """
        from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder

        bundles = list[Any]()
        left_out = dict[str, int]()
        room = 0
        for built in self._messages(message):
            size = 4 + built.size
            if size > MAX_DATAGRAM - BUNDLE_HEAD:
                left_out[built.address] = built.size
                continue
            if size > room:
                bundles.append(OscBundleBuilder(IMMEDIATELY))
                room = MAX_DATAGRAM - BUNDLE_HEAD
            bundles[-1].add_content(built)
            room -= size
        return [bundle.build() for bundle in bundles], left_out

    def _messages(self, message: Message) -> Iterator[Any]:
        """Yield the messages: whole numbers i, time d, other numbers f, texts s, solved T or F."""
        from pythonosc.osc_message_builder import OscMessageBuilder

        picture = message.picture
        view = message.view
        parts: Content = {
            "sequence": picture.number,
            "time": picture.time,
            "size": message.panel.shape,
            **{name: values.ravel().tolist() for name, values in message.maps.items()},
            "force": picture.force.newton,
            "force_sd": view.deviation,
            "verdict": picture.verdict,
            "solved": message.solved,
            "status": picture.status,
            "alarm": view.alarm,
        }
        if view.detected is not None:
            for name in ("answer", "probability", "sentence"):
                parts[name] = getattr(view.detected, name)
            parts["detection"] = json.dumps(view.detection, **COMPACT)
        for name, values in parts.items():
            built = OscMessageBuilder(f"/{self.path}/{name}")
            for value in values if isinstance(values, list | tuple) else [values]:
                built.add_arg(value, "d" if name == "time" else None)
            yield built.build()


@dataclass(frozen=True)
class MqttPublish(Publish):
    """`mqtt://USER:PASSWORD@HOST:PORT/TOPIC`: the message as JSON to a topic of a broker.

    The quality of service is 1. A message is lost rather than late: none is sent while another has
    not been confirmed for 0.2 s.
    """

    kind = "mqtt"
    host: str = "localhost"
    port: int = 1883

    @contextmanager
    def opened(self, say: Say) -> Iterator[Outlet]:
        """Open the stream, as `Publish.opened`."""
        with extra("streams"):
            from paho.mqtt.client import Client
            from paho.mqtt.enums import CallbackAPIVersion
        if set(self.path) & set("+#"):
            raise InputError(
                f"--publish: mqtt: '{self.path}' "
                "is no topic to publish to: + and # stand for others"
            )
        client: Any = Client(CallbackAPIVersion.VERSION2)
        # A short segment does not wait until the one before is confirmed (RFC 896), up to 0.5 s
        # later (RFC 1122).
        client.on_socket_open = lambda *event: event[2].setsockopt(
            socket.IPPROTO_TCP, socket.TCP_NODELAY, 1
        )
        client.reconnect_delay_set(1, 10)  # s
        client.username_pw_set(self.user, self.password)
        # messages that are not confirmed, and when each was sent
        waiting = deque[tuple[Any, float]]()

        def send(message: Message) -> None:
            while waiting and waiting[0][0].is_published():
                waiting.popleft()
            time_now = time.monotonic()
            if client.is_connected() and (not waiting or time_now - waiting[0][1] < LATEST_SECONDS):
                info = client.publish(self.path, message.text(), qos=1)
                # Else the connection has just ended; such a message is never confirmed.
                if info.rc == 0:
                    waiting.append((info, time_now))

        try:
            answers = list[Any]()
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
            client.on_disconnect = lambda *event: say(
                f"{self.where}: the broker is gone ({event[3]}); it is called again"
            )
            client.on_connect = lambda *event: say(f"{self.where}: the broker is back")
            yield self.where, send
        finally:
            client.on_disconnect = None
            client.disconnect()
            # The library would wait for ever.
            waited(lambda: client.socket() is None, FAREWELL_SECONDS)
            with suppress(OSError, AttributeError):  # the connection may be closed meanwhile
                client.socket().shutdown(socket.SHUT_RDWR)
            client.loop_stop()


@dataclass(frozen=True)
class WebsocketPublish(Publish):
    """`websocket://ADDRESS:PORT`: a server that sends each message to all listeners.

    A message is sent as a line of JSON. Pages of this computer and programs may listen; from
    elsewhere a token is needed. Port 0 stands for any free port.
    """

    kind = "websocket"
    port: int = 8138

    @contextmanager
    def opened(self, say: Say) -> Iterator[Outlet]:
        """Open the stream, as `Publish.opened`."""
        with extra("streams"):
            from websockets.exceptions import ConnectionClosed
            from websockets.sync.server import serve
        host = ip_named(self.host)
        if host is None:
            raise InputError(
                f"--publish: websocket: '{self.host}' is no address such as 127.0.0.1 or 0.0.0.0"
            )
        access = Access.of(self.token, self.port, local=host.is_loopback)
        listeners = _Listeners(Newest(""), access, (ConnectionClosed, OSError))
        settings: Content = {
            "max_size": 1024,
            "compression": None,
            "process_request": listeners.refusal,
            "open_timeout": FAREWELL_SECONDS,
            "close_timeout": FAREWELL_SECONDS,
            "origins": [None, LOCAL_PAGES] if host.is_loopback else None,
            "family": socket.AF_INET6 if host.version == 6 else socket.AF_INET,
        }
        try:
            server = serve(listeners.send_to, str(host), self.port, **settings)
        except OSError as error:
            raise InputError(
                f"--publish: websocket: cannot listen at {host}:{self.port} "
                f"({error.strerror or error})"
            ) from error
        thread = Thread(target=server.serve_forever, name="lampest-websocket", daemon=True)
        thread.start()
        where = f"{f'[{host}]' if host.version == 6 else host}:{server.socket.getsockname()[1]}"
        try:
            yield (
                f"ws://{where}/{access.query}",
                lambda message: listeners.newest.put(message.text()),
            )
        finally:
            listeners.newest.close()
            waited(lambda: not listeners.sent, FAREWELL_SECONDS)
            listeners.cut_off(time.monotonic())
            server.shutdown()
            thread.join()


@dataclass(frozen=True, eq=False)
class _Listeners:
    """Connections of a websocket server, each of which takes the newest message.

    Attributes
    ----------
    newest : Newest
        The newest message as text.
    access : Access
    ends : tuple of type
        Exceptions that end a connection.
    sent : dict
        Connection → send time of the oldest message that it has not taken; infinite without one.
    """

    newest: Newest[str]
    access: Access
    ends: tuple[type[Exception], ...]
    sent: dict[Any, float] = field(default_factory=dict)

    def refusal(self, connection: Any, request: Any) -> Any:
        """Return the response that refuses a connection; None where it is admitted."""
        shown = request.headers.get("Authorization", "")
        if self.access.token and not self.access.shown_by(request.path, shown):
            return connection.respond(HTTPStatus.FORBIDDEN, "the token is missing or wrong\n")
        self.cut_off(time.monotonic() - TURN_SECONDS)
        if len(self.sent) >= MAX_STREAMS:
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, "too many listen\n")
        return None

    def send_to(self, connection: Any) -> None:
        """Send each newest message to a connection, until it or the server ends."""
        number = 0
        self.sent[connection] = math.inf
        with suppress(*self.ends):
            while (news := self.newest.after(number)) is not None:
                number, text = news
                self.sent[connection] = time.monotonic()
                connection.send(text)
                self.sent[connection] = math.inf
        del self.sent[connection]

    def cut_off(self, before: float) -> None:
        """Close the connections that have not taken a message sent until a time."""
        for connection, sent in tuple(self.sent.items()):
            if sent <= before:
                with suppress(OSError):
                    connection.socket.shutdown(socket.SHUT_RDWR)


WAYS: tuple[type[Publish], ...] = (LslPublish, OscPublish, MqttPublish, WebsocketPublish)


def publish_at(where: str, token: str | None = None) -> Publish:
    """Parse an address such as `mqtt://localhost:1883/lampest` or `mqtt`.

    Listeners need `token`. Raises InputError for an unknown protocol and an invalid address.
    """
    kind, _, address = where.partition("://")
    ways = {way.kind: way for way in WAYS}
    if kind not in ways:
        raise InputError(f"--publish: '{where}' begins with none of {', '.join(ways)}")
    try:
        parts = urlsplit(f"//{address}", allow_fragments=False)
        if parts.query or parts.port == -1:  # `port` raises for an invalid one
            raise ValueError("what follows a question mark means nothing there")
    except ValueError as error:
        raise InputError(f"--publish: '{where}' is no address ({error})") from error
    return ways[kind].at(parts, token)


def waited(done: Callable[[], bool], seconds: float) -> bool:
    """Wait until a condition holds, at most for some seconds; return whether it holds."""
    until = time.monotonic() + seconds
    while not done() and time.monotonic() < until:
        time.sleep(0.01)
    return done()


@contextmanager
def publishing(ways: Sequence[Publish], shown: Newest[View], say: Say) -> Iterator[tuple[str, ...]]:
    """Send new pictures, answers and alarms by each protocol, until the series ends.

    A protocol has a thread of its own. The context has the public addresses. `say` receives a
    sentence at the first failure of a protocol. Raises InputError if one cannot be opened.
    """
    with ExitStack() as opened:
        outlets = [opened.enter_context(way.opened(say)) for way in ways]
        threads = [
            Thread(target=_forward, args=(shown, send, where, say), daemon=True)
            for where, send in outlets
        ]
        for thread in threads:
            thread.start()
        try:
            yield tuple(where for where, _ in outlets)
        finally:
            shown.close()
            for thread in threads:
                thread.join()


def _forward(shown: Newest[View], send: Send, where: str, say: Say) -> None:
    """Send the newest picture, skipping older ones.

    Report a failure once until sending works again.
    """
    number = 0
    failed = False
    sent = None
    while (news := shown.after(number)) is not None:
        number = news.number
        message = Message.of(news.item)
        if message is None or message.signature == sent:
            continue
        sent = message.signature
        try:
            send(message)
            failed = False
        except OSError as error:
            if not failed:
                say(
                    f"{where}: frames do not get through ({error.strerror or error}); "
                    "it is tried again with each"
                )
            failed = True
