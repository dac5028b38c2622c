"""HTTP server of the live page and its views (server-sent events).

The server answers GET of two paths and POST of three requests.
"""

import os
import re
import secrets
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from hmac import compare_digest
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from ipaddress import IPv4Address, IPv6Address, ip_address
from threading import BoundedSemaphore, Event, Thread
from urllib.parse import parse_qsl, urlsplit

from lampest.apps.live.handover import FAREWELL_SECONDS, Newest
from lampest.apps.live.message import View, view_text
from lampest.files.errors import InputError

MAX_STREAMS = 16  # simultaneous pages, each with a thread
HEARTBEAT_SECONDS = 2.0  # between messages without content
# After which a page, or a listener that takes nothing, is replaced by a waiting one.
TURN_SECONDS = 60.0
MIN_TOKEN_LENGTH = 16  # characters, 10²⁸ possible tokens
HINT = ": open the address that lampest printed when it began, with its token if it has one"
# Required header: a browser lets a foreign page send it only after a preflight, which is refused.
REQUEST_HEADER = "X-Lampest"
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; connect-src 'self'; "
    "script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}


@dataclass(frozen=True)
class Access:
    """Access control by a token and a cookie; without a token the page is public.

    Raises InputError for an invalid token.

    Attributes
    ----------
    token : str
        At least 16 letters, digits or any of - _ . ~; '' for none.
    name : str
        Name of the cookie.
    secret : str
        Value of the cookie.
    """

    token: str = ""
    name: str = "lampest"
    secret: str = field(default_factory=lambda: secrets.token_urlsafe(24))

    def __post_init__(self) -> None:
        if self.token and not re.fullmatch(rf"[A-Za-z0-9._~-]{{{MIN_TOKEN_LENGTH},}}", self.token):
            raise InputError(
                f"--token: give at least {MIN_TOKEN_LENGTH} letters, digits or any of - _ . ~ "
                "(or none: one is made up)"
            )

    @classmethod
    def of(cls, token: str | None, port: int, *, local: bool) -> "Access":
        """Return access by the given token.

        If None, visitors from elsewhere need a generated token.
        """
        return cls(token or ("" if local else secrets.token_urlsafe(24)), f"lampest-{port}")

    @property
    def query(self) -> str:
        """Query string with the token."""
        return f"?token={self.token}" if self.token else ""

    def shown_by(self, target: str, authorization: str) -> bool:
        """Return whether the requested address or the header Authorization has the token."""
        kind, _, word = authorization.partition(" ")
        brought = [value for name, value in _query(target) if name == "token"]
        brought += [word] * (kind in ("Bearer", "token"))
        return bool(self.token) and any(_same(text, self.token) for text in brought)


def _same(first: str, second: str) -> bool:
    """Compare two texts in constant time."""
    return compare_digest(*(text.encode("utf-8", "surrogatepass") for text in (first, second)))


def _query(target: str) -> list[tuple[str, str]]:
    """Return the (name, value) pairs of the query of a request."""
    try:
        return parse_qsl(urlsplit(target).query, keep_blank_values=True, max_num_fields=8)
    except ValueError:
        return [("", "")]


@dataclass(frozen=True)
class PageActions:
    """Requests of visitors of the page, called from any thread.

    Attributes
    ----------
    tare : callable
        Renew the zero.
    acknowledge : callable
        End the alarm.
    record : callable or None
        Begin a recording of the given name, or end it; raises InputError for an invalid name. None
        without a board.
    """

    tare: Callable[[], None] = lambda: None
    acknowledge: Callable[[], None] = lambda: None
    record: Callable[[str], None] | None = None


class PageServer(ThreadingHTTPServer):
    """Server of views and of visitors' requests.

    Attributes
    ----------
    shown : Newest of View
        The newest view.
    actions : PageActions
        Requests that visitors may send.
    page : bytes
        HTML of the page.
    seats : BoundedSemaphore
        Streams that may still begin.
    refused : Event
        Whether a visitor found no seat.
    local : bool
        Whether only this computer can reach the server.
    access : Access
    """

    daemon_threads = True
    block_on_close = False
    request_queue_size = 64
    # On Windows it would share the port with another server.
    allow_reuse_address = os.name == "posix"

    def __init__(
        self, host: str, port: int, shown: Newest[View], token: str | None, actions: PageActions
    ) -> None:
        self.shown = shown
        self.actions = actions
        self.page = files("lampest.apps.live").joinpath("page.html").read_bytes()
        self.seats = BoundedSemaphore(MAX_STREAMS)
        self.refused = Event()
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        super().__init__((host, port), PageHandler)
        self.local = ip_address(str(self.server_address[0])).is_loopback
        # The loopback address needs the token, too: every user of this computer reaches it.
        self.access = Access.of(token, int(self.server_address[1]), local=False)

    @property
    def url(self) -> str:
        """Address for a browser on this computer, with the token if one is required."""
        host, port = self.server_address[:2]
        name = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(str(host), str(host))
        return f"http://{f'[{name}]' if ':' in name else name}:{port}/{self.access.query}"

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignore clients that disconnect."""


class PageHandler(BaseHTTPRequestHandler):
    """Handler of one request."""

    server: PageServer
    introduced = False
    timeout = 10.0
    disable_nagle_algorithm = True
    server_version = "lampest"
    sys_version = ""

    def parse_request(self) -> bool:
        """Refuse other methods, requests of foreign pages, and host names of theirs.

        The host names are refused on the loopback address.
        """
        if not super().parse_request():
            return False
        if self.command not in ("GET", "POST"):
            self._start("text/plain", 0, HTTPStatus.METHOD_NOT_ALLOWED, Allow="GET, POST")
            return False
        if len(self.headers.get_all("Host", [])) > 1:
            self.send_error(HTTPStatus.BAD_REQUEST)
            return False
        access = self.server.access
        header = self.headers.get
        self.introduced = access.shown_by(self.path, header("Authorization", ""))
        cookie = f"{access.name}={access.secret}"
        remembered = any(_same(crumb.strip(), cookie) for crumb in header("Cookie", "").split(";"))
        admitted = not access.token or self.introduced or remembered
        host = header("Host", "")
        foreign_name = self.server.local and not is_local_name(host)
        # A browser says which page makes the request. A link to the page itself is none of another.
        origin = header("Origin")
        foreign_origin = origin is not None and urlsplit(origin).netloc != host
        link = self.command == "GET" and urlsplit(self.path).path == "/"
        foreign_site = header("Sec-Fetch-Site", "none") not in ("none", "same-origin") and not link
        if not admitted or foreign_name or foreign_origin or foreign_site:
            self.send_error(HTTPStatus.FORBIDDEN)
            return False
        return True

    def do_GET(self) -> None:
        """Serve the page at / and the views at /views."""
        path = urlsplit(self.path).path if self.introduced else self.path
        if path == "/":
            self._start("text/html; charset=utf-8", len(self.server.page))
            self.wfile.write(self.server.page)
        elif path != "/views":
            self.send_error(HTTPStatus.NOT_FOUND)
        elif not self.server.seats.acquire(blocking=False):
            self.server.refused.set()
            self.send_error(HTTPStatus.SERVICE_UNAVAILABLE)
        else:
            try:
                self._start("text/event-stream", None)
                self._stream()
            finally:
                self.server.seats.release()

    def do_POST(self) -> None:
        """Renew the zero, end the alarm, begin or end a recording.

        The paths are /zero, /acknowledge and /record, in this order. Requires the header
        REQUEST_HEADER, which pages from elsewhere cannot send.
        """
        actions = self.server.actions
        action = urlsplit(self.path).path.removeprefix("/")
        callables = {"zero": actions.tare, "acknowledge": actions.acknowledge}
        if actions.record:
            name = dict(_query(self.path)).get("name", "")
            callables["record"] = partial(actions.record, name)
        if action not in callables:
            self.send_error(HTTPStatus.NOT_FOUND)
        elif (
            self.headers.get(REQUEST_HEADER) != action
            or self.headers.get("Content-Length", "0") != "0"
        ):
            self.send_error(HTTPStatus.FORBIDDEN)
        else:
            try:
                callables[action]()
            except InputError:
                self.send_error(HTTPStatus.BAD_REQUEST)
            else:
                self._start("text/plain; charset=utf-8", 0)

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Log the status code, without the request."""
        status = HTTPStatus(code)
        hint = HINT if status is HTTPStatus.FORBIDDEN else ""
        text = f"{status.value} {status.phrase}{hint}\n".encode()
        self.close_connection = True
        self._start("text/plain; charset=utf-8", len(text), status)
        if self.command != "HEAD":
            self.wfile.write(text)

    def _start(
        self, kind: str, length: int | None, status: HTTPStatus = HTTPStatus.OK, **further: str
    ) -> None:
        """Send the status and the headers of an answer; `length` is that of its body in bytes."""
        headers = {"Content-Type": kind} | HEADERS | further
        if length is not None:
            headers["Content-Length"] = f"{length}"
        if status is HTTPStatus.OK and self.introduced:
            access = self.server.access
            headers["Set-Cookie"] = f"{access.name}={access.secret}; HttpOnly; SameSite=Lax; Path=/"
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()

    def _stream(self) -> None:
        """Send the newest view whenever it changes; slow clients skip views."""
        version = -1
        picture_number = 0
        shown = self.server.shown
        began = time.monotonic()
        while not (self.server.refused.is_set() and time.monotonic() - began > TURN_SECONDS):
            news = shown.after(version, HEARTBEAT_SECONDS)
            if news is not None:
                version, view = news
                text = view_text(view, time.time(), picture_number)
                self.wfile.write(f"data: {text}\n\n".encode())
                picture_number = view.picture.number if view.picture else 0
            elif shown.closed:
                return
            else:
                self.wfile.write(b": still here\n\n")
        self.server.refused.clear()

    def log_message(self, format: str, *arguments: object) -> None:  # noqa: A002
        """Log no requests."""


def is_local_name(host: str) -> bool:
    """Return whether a Host header names this computer.

    Local names are localhost and the loopback addresses, with or without a port.
    """
    ip = ip_named(host.rsplit(":", 1)[0] if host.rpartition(":")[2].isdigit() else host)
    return ip is not None and ip.is_loopback


def ip_named(name: str) -> IPv4Address | IPv6Address | None:
    """Return the address of localhost or of an IP literal, in brackets or not, or None."""
    try:
        return ip_address(
            "127.0.0.1" if name == "localhost" else name.removeprefix("[").removesuffix("]")
        )
    except ValueError:
        return None


def address(text: str) -> tuple[str, int]:
    """Parse HOST:PORT, such as 127.0.0.1:8137, [::1]:0 or 0.0.0.0:8137.

    Raises InputError for other texts.

    Returns
    -------
    host : str
        IP address without brackets.
    port : int
    """
    host, separator, port = text.rpartition(":")
    ip = ip_named(host)
    if ip is None or not separator or not (port.isascii() and port.isdigit() and int(port) < 65536):
        raise InputError(
            f"--http: '{text}' is not of the form HOST:PORT with an address, such as 127.0.0.1:8137"
        )
    return str(ip), int(port)


@contextmanager
def serving(
    host: str,
    port: int,
    shown: Newest[View],
    token: str | None = None,
    actions: PageActions | None = None,
) -> Iterator[PageServer]:
    """Run a server in a thread; at the end all clients get the last view.

    Raises InputError if the server cannot listen or the token is too short.

    Parameters
    ----------
    host : str
        Address at which it listens.
    port : int
        Port; 0 for any free one.
    shown : Newest of View
        The newest view.
    token : str or None
        Required of visitors; by default a generated one.
    actions : PageActions or None
        Requests that visitors may send.
    """
    Access(token or "")
    try:
        server = PageServer(host, port, shown, token, actions or PageActions())
    except OSError as error:
        raise InputError(
            f"--http: cannot listen at {host}:{port} ({error.strerror or error})"
        ) from error
    with server:
        thread = Thread(target=server.serve_forever, args=(0.1,), name="lampest-http", daemon=True)
        thread.start()
        try:
            yield server
        finally:
            shown.close()
            server.shutdown()
            thread.join()
            until = time.monotonic() + FAREWELL_SECONDS
            for _ in range(MAX_STREAMS):
                server.seats.acquire(timeout=max(0.0, until - time.monotonic()))
