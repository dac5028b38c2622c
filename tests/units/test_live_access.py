"""Who may see the live page: on the loopback address everybody here, elsewhere whoever brings the token."""

import http.client
import re
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing

import pytest

from lampest.files.errors import InputError
from lampest.report.live import server as server_module
from lampest.report.live.handover import Newest
from lampest.report.live.message import View
from lampest.report.live.server import PageServer, serving

TOKEN = "a-token-of-my-own"


@pytest.fixture
def open_page() -> Iterator[PageServer]:
    """A page that listens on all addresses, with a token that was given."""
    with serving("0.0.0.0", 0, Newest(View("here", "LSM", "receiving")), TOKEN) as server:
        yield server


def asked(server: PageServer, path: str = "/", method: str = "GET", **headers: str) -> tuple[int, str, bytes]:
    """Status, cookie and text of an answer."""
    with closing(http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=10)) as connection:
        connection.request(method, path, headers=headers)
        answer = connection.getresponse()
        text = answer.readline() if path.startswith("/views") and answer.status == 200 else answer.read()
        cookie = answer.headers.get("Set-Cookie", "")
        answer.close()
        return answer.status, cookie, text


def test_elsewhere_nobody_comes_in_without_the_token(open_page: PageServer) -> None:
    for path in ("/", "/views", "/nothing", "/?token=", "/?token=a-token-of-my-owN", f"/?other={TOKEN}", f"/#{TOKEN}"):
        status, cookie, text = asked(open_page, path)
        assert (status, cookie) == (403, "") and b"lampest printed" in text and b"receiving" not in text
    for headers in ({"Cookie": f"lampest={TOKEN}"}, {"Authorization": f"Basic {TOKEN}"}, {"Cookie": '="\x01'}):
        assert asked(open_page, "/views", **headers)[0] == 403
    assert asked(open_page, f"/?token={TOKEN}", "PUT")[0] == 405


def test_a_browser_needs_the_token_once(open_page: PageServer) -> None:
    assert open_page.url == f"http://127.0.0.1:{open_page.server_address[1]}/?token={TOKEN}"
    status, cookie, text = asked(open_page, f"/?token={TOKEN}")
    assert status == 200 and text.startswith(b"<!") and TOKEN not in cookie
    assert cookie.endswith("; HttpOnly; SameSite=Lax; Path=/")
    given = cookie.split(";")[0]
    assert asked(open_page, Cookie=given)[:2] == (200, "")
    assert asked(open_page, "/views", Cookie=f"theme=dark; {given}")[2].startswith(b"data: ")
    assert asked(open_page, "/views", Cookie=given[:-1])[0] == 403


def test_programs_bring_it_as_they_like(open_page: PageServer) -> None:
    assert asked(open_page, f"/views?token={TOKEN}")[0] == 200
    for kind in ("Bearer", "token"):
        assert asked(open_page, "/views", Authorization=f"{kind} {TOKEN}")[0] == 200


def test_a_token_is_made_up_and_never_the_same() -> None:
    tokens = set()
    for _ in range(2):
        with serving("0.0.0.0", 0, Newest(View("here", "LSM", "receiving"))) as server:
            assert asked(server)[0] == 403
            tokens.add(token := server.url.partition("?token=")[2])
            assert asked(server, f"/?token={token}")[0] == 200
    assert len(tokens) == 2 and all(len(token) >= 32 for token in tokens)


def test_on_the_loopback_a_token_is_asked_for_if_one_is_given() -> None:
    shown = Newest(View("here", "LSM", "receiving"))
    with serving("127.0.0.1", 0, shown) as server:
        assert server.url.endswith("/") and asked(server)[0] == 200
    with serving("127.0.0.1", 0, shown, TOKEN) as server:
        assert asked(server)[0] == 403 and asked(server, f"/?token={TOKEN}")[0] == 200


@pytest.mark.parametrize("token", ["short", "with a blank in it", "ä" * 20, "x" * 15])
def test_tokens_that_are_none(token: str) -> None:
    with (
        pytest.raises(InputError, match="--token: give at least 16"),
        serving("127.0.0.1", 0, Newest(View("here", "LSM", "receiving")), token),
    ):
        pass


def test_tokens_are_compared_in_constant_time(open_page: PageServer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is brought goes through the comparison that does not tell where texts differ."""
    compared: list[bytes] = []
    monkeypatch.setattr(server_module, "compare_digest", lambda one, other: bool(compared.append(one)))
    assert asked(open_page, f"/?token={TOKEN}")[0] == 403
    assert asked(open_page, Authorization=f"Bearer {TOKEN}")[0] == 403
    assert asked(open_page, Cookie=f"{open_page.access.name}={open_page.access.secret}")[0] == 403
    assert len(compared) == 3


@pytest.mark.parametrize(
    "request_line",
    [
        b"GET /<script>alert(1)</script> HTTP/1.1",
        b"<script>alert(1)</script> / HTTP/1.1",
        b"GET / <script>alert(1)</script>",
        b"<script>alert(1)</script>",
        b"GET /?token=<script>alert(1)</script> HTTP/1.1",
        b"GET /" + b"<script>" * 9000 + b" HTTP/1.1",
        b"GET / HTTP/1.1\r\n<script>alert(1)</script>: x\r\n" + b"<script>: 1\r\n" * 200,
        b"GET / HTTP/9.9<script>",
    ],
)
@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_error_pages_reflect_nothing_of_the_request(request_line: bytes, host: str) -> None:
    with (
        serving(host, 0, Newest(View("here", "LSM", "receiving"))) as server,
        socket.create_connection(("127.0.0.1", server.server_address[1]), timeout=10) as client,
    ):
        client.sendall(request_line + b"\r\nHost: <script>localhost\r\n\r\n")
        client.shutdown(socket.SHUT_WR)
        answer = b"".join(iter(lambda: client.recv(4096), b""))
    assert b"script" not in answer.replace(b"script-src", b"") and b"alert" not in answer
    assert re.match(rb"(HTTP/1\.[01] )?[45]\d\d [A-Z][A-Za-z -]+\r?\n", answer), answer


def test_a_request_with_two_names_of_the_host_is_refused() -> None:
    with (
        serving("127.0.0.1", 0, Newest(View("here", "LSM", "receiving"))) as server,
        socket.create_connection(("127.0.0.1", server.server_address[1]), timeout=10) as client,
    ):
        client.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n")
        answer = client.recv(4096)
    assert answer.startswith(b"HTTP/1.0 400 "), answer


def test_guests_that_never_read_give_their_seats_to_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server_module, "MAX_STREAMS", 2)
    monkeypatch.setattr(server_module, "TURN_SECONDS", 0.3)
    monkeypatch.setattr(server_module, "HEARTBEAT_SECONDS", 0.1)
    with serving("127.0.0.1", 0, Newest(View("here", "LSM", "receiving"))) as server, ExitStack() as guests:

        def status() -> bytes:
            guest = guests.enter_context(socket.create_connection(("127.0.0.1", server.server_address[1]), timeout=10))
            guest.sendall(b"GET /views HTTP/1.1\r\nHost: localhost\r\n\r\n")
            return guest.recv(12)[9:]

        assert [status(), status(), status()] == [b"200", b"200", b"503"]
        until = time.monotonic() + 10
        while (answer := status()) != b"200" and time.monotonic() < until:
            time.sleep(0.1)
        assert answer == b"200"
