"""The live page's server: views, guests, addresses and tokens."""

import contextlib
import dataclasses
import http.client
import json
import re
import socket
import threading
import time
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from promises import promise
from support import until

from lampest.apps.live import server as server_module
from lampest.apps.live.handover import Newest
from lampest.apps.live.message import View
from lampest.apps.live.run import Outlets, Replay, chosen, live
from lampest.apps.live.server import PageActions, address, is_local_name, serving
from lampest.files.errors import InputError

LAMPREY = Path(__file__).parents[3] / "data" / "lamprey_25mm.h5"
TOKEN = "a-token-of-my-own"
# Of a server with a client that never asks; its connection times out after ten.
MAX_CLOSING_SECONDS = 3.0
MAX_SIGNS = 32_000  # of the page, in one file: 31,254 since it says where its colours end


@contextlib.contextmanager
def page_at(host: str, *given: Any, **actions: Any) -> Iterator[SimpleNamespace]:
    """Run a server, and return it with its page.

    `ask` opens a connection and returns the answer, `status` its code.

    On the loopback address requests have the cookie of a visitor, unless a token is given.
    """
    shown = Newest(View("here", "LSM", "receiving"))
    with serving(host, 0, shown, *given, **actions) as server, contextlib.ExitStack() as stack:
        port = int(server.server_address[1])
        visitor = (
            {"Cookie": f"{server.access.name}={server.access.secret}"}
            if server.local and not given
            else {}
        )

        def ask(path: str = "/", method: str = "GET", **headers: str) -> http.client.HTTPResponse:
            begun = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
            connection = stack.enter_context(contextlib.closing(begun))
            named = {name.replace("_", "-"): value for name, value in headers.items()}
            connection.request(method, path, headers=visitor | named)
            return stack.enter_context(contextlib.closing(connection.getresponse()))

        def wired(request: bytes) -> socket.socket:
            client = stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=10))
            crumbs = "".join(
                f"\r\n{name}: {value}\r\nHost: " for name, value in visitor.items()
            ).encode()
            client.sendall(request.replace(b"\r\nHost: ", crumbs, 1) if crumbs else request)
            return client

        def status(*words: str, **headers: str) -> int:
            return ask(*words, **headers).status

        yield SimpleNamespace(
            server=server, shown=shown, port=port, ask=ask, status=status, wired=wired
        )


@pytest.fixture
def page() -> Iterator[SimpleNamespace]:
    with page_at("127.0.0.1") as running:
        yield running


@pytest.fixture
def open_page() -> Iterator[SimpleNamespace]:
    """A page that listens on all addresses, with a token that was given."""
    with page_at("0.0.0.0", TOKEN) as running:
        yield running


def first_view(answer: http.client.HTTPResponse) -> Any:
    line = answer.readline()
    assert line.startswith(b"data: ")
    return json.loads(line[6:])


def test_a_slow_reader_never_misses_the_newest_item() -> None:
    """A reader that is slower than the writer skips, but sees numbers grow, and the last thing."""
    newest = Newest(0)
    received = []

    def read() -> None:
        number = 0
        while (news := newest.after(number)) is not None:
            number = news.number
            received.append(news)
            time.sleep(1e-4)

    reader = threading.Thread(target=read)
    reader.start()
    for value in range(1, 2001):
        newest.put(value)
    newest.close()
    reader.join(10)
    assert all(news.number == news.item for news in received)
    assert received == sorted(received) and received[-1].item == 2000
    assert newest.after(2000, 0.01) is None and newest.closed


def test_the_server_serves_only_the_page_and_the_views(page: SimpleNamespace) -> None:
    answer = page.ask()
    assert answer.status == 200 and answer.headers["Content-Type"] == "text/html; charset=utf-8"
    assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
    text = files("lampest.apps.live").joinpath("page.html").read_text(encoding="utf-8")
    assert answer.read().decode() == text and len(text) < MAX_SIGNS
    elsewhere = r"https?://|\bsrc=|@import|url\(|<link(?! rel=\"icon\" href=\"data:,\")"
    assert not re.findall(elsewhere, text), "the page loads nothing from elsewhere"
    views = page.ask("/views")
    assert views.headers["Content-Type"] == "text/event-stream"
    assert first_view(views)["state"] == "receiving"
    page.shown.change(lambda view: dataclasses.replace(view, state="gone"))
    assert views.readline() == b"\n"
    assert first_view(views)["state"] == "gone"
    for path in ("/favicon.ico", "/page.html", "/../setup", "/views/", "/?x"):
        assert page.status(path) == 404
    for method in ("HEAD", "PUT", "DELETE", "OPTIONS", "TRACE", "NONSENSE"):
        refused = page.ask("/", method)
        assert (refused.status, refused.headers["Allow"]) == (405, "GET, POST")
    assert page.server.server_address[0] == "127.0.0.1" and "/?token=" in page.server.url


def test_actions_are_reserved_for_the_page_and_need_the_token() -> None:
    requested: list[str] = []

    def record(name: str) -> None:
        if "." in name:
            raise InputError("that is no name")
        requested.append(name)

    actions = PageActions(lambda: requested.append("zero"), lambda: requested.append("seen"))
    with page_at("127.0.0.1", actions=actions) as page:
        for path, headers, status in (
            ("/zero", {}, 403),
            ("/zero", {"X_Lampest": "one"}, 403),
            ("/", {"X_Lampest": "zero"}, 404),
            ("/zero", {"X_Lampest": "zero", "Host": "attacker.example"}, 403),
            ("/acknowledge", {}, 403),
            ("/acknowledge", {"X_Lampest": "zero"}, 403),
            ("/record", {"X_Lampest": "record"}, 404),  # there is nothing to record
        ):
            assert page.status(path, "POST", **headers) == status and not requested
        words = ("zero", "acknowledge")
        assert [page.status(f"/{word}", "POST", X_Lampest=word) for word in words] == [200, 200]
        assert requested == ["zero", "seen"]
    bearer = {"Authorization": f"Bearer {TOKEN}"}
    with page_at("127.0.0.1", TOKEN, PageActions(record=record)) as page:
        for path, headers, status in (
            ("/record", {"X_Lampest": "record"}, 403),
            ("/record", {"X_Lampest": "zero", **bearer}, 403),
            ("/record?name=x", bearer, 403),  # a foreign page's form has no such header
            ("/record?name=../x", {"X_Lampest": "record", **bearer}, 400),
        ):
            assert page.status(path, "POST", **headers) == status and len(requested) == 2
        for path in ("/record?name=x", "/record"):
            assert page.status(path, "POST", X_Lampest="record", **bearer) == 200
        assert requested[2:] == ["x", ""]


def test_the_loopback_server_refuses_foreign_host_names(page: SimpleNamespace) -> None:
    assert page.status(Host="localhost:8137") == 200
    assert page.status("/views", Host="attacker.example:8137") == 403
    assert all(
        is_local_name(name)
        for name in ("127.0.0.1", "[::1]:80", "[::1]", "localhost", "127.0.0.9:1")
    )
    assert not any(
        is_local_name(name) for name in ("", "10.0.0.1:80", "localhost.example", "[::2]:80")
    )
    for request, hosts, code in (
        ("PUT", ["localhost"], 405),
        ("GET", ["localhost", "evil.example"], 400),
        ("GET", ["evil.example"], 403),
    ):
        lines = [f"{request} / HTTP/1.1", *(f"Host: {host}" for host in hosts), "", ""]
        with page.wired("\r\n".join(lines).encode()).makefile("rb") as stream:
            answer = stream.read()
        assert (
            answer.startswith(b"HTTP/1.0 %d " % code)
            and answer.count(b"HTTP/1.") == 1
            and b"<html" not in answer
        )


def test_clients_may_connect_and_disconnect_at_any_time(
    page: SimpleNamespace, capfd: pytest.CaptureFixture[str]
) -> None:
    for request in (
        b"",
        b"GET",
        b"\0\xff\r\n\r\n",
        b"GET /views HTTP/1.1\r\nHost: localhost\r\n\r\n",
    ) * 10:
        with page.wired(request) as client:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    for _ in range(3):
        page.shown.change(lambda view: view)
        time.sleep(0.05)
    assert first_view(page.ask("/views"))["source"] == "here"
    assert page.status() == 200
    assert capfd.readouterr() == ("", "")


def test_surplus_clients_are_refused_and_stalled_ones_lose_their_seat(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name, value in {"MAX_STREAMS": 2, "TURN_SECONDS": 0.3, "HEARTBEAT_SECONDS": 0.1}.items():
        monkeypatch.setattr(server_module, name, value)
    with page_at("127.0.0.1") as page:

        def status() -> bytes:
            return bytes(page.wired(b"GET /views HTTP/1.1\r\nHost: localhost\r\n\r\n").recv(12)[9:])

        assert [status(), status(), status()] == [b"200", b"200", b"503"] and page.status() == 200
        until(lambda: status() == b"200")
        assert server_module.PageServer.daemon_threads


def test_the_last_view_reaches_every_client_and_no_client_delays_the_end() -> None:
    with contextlib.ExitStack() as running:
        page = running.enter_context(page_at("127.0.0.1"))
        page.wired(b"")  # a guest that never asks
        connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=10)
        connection.request("GET", f"/views{page.server.access.query}")
        answer = connection.getresponse()
        first_view(answer)
        page.shown.change(lambda view: dataclasses.replace(view, state="lampest has ended"))
        began = time.monotonic()
        running.pop_all().close()
    assert '"state":"lampest has ended"' in answer.read().decode()
    assert time.monotonic() - began < MAX_CLOSING_SECONDS
    answer.close()
    connection.close()


def test_an_address_needs_a_host_and_a_free_port(page: SimpleNamespace) -> None:
    assert address("localhost:0") == ("127.0.0.1", 0) and address("[::1]:81") == ("::1", 81)
    for text in ("", "8137", "127.0.0.1", "127.0.0.1:x", "host:80", "127.0.0.1:70000", ":80"):
        with pytest.raises(InputError, match="not of the form HOST:PORT"):
            address(text)
    with pytest.raises(
        InputError, match=rf"cannot listen at 127\.0\.0\.1:{page.port} \(Address already in use\)"
    ):
        live(Replay(LAMPREY), chosen(None, None), Outlets(f"127.0.0.1:{page.port}"))


# Who may see the page: whoever brings the token, on the loopback address as well.


@pytest.mark.parametrize("origin", ["https://attacker.example", "http://127.0.0.1:1", "null"])
def test_other_local_users_and_pages_take_no_seat(origin: str) -> None:
    with page_at("127.0.0.1", actions=PageActions()) as page:
        for path in ("/", "/views"):
            assert page.status(path, Cookie="") == page.status(path, Origin=origin) == 403
        for site in ("cross-site", "same-site"):
            for path in ("/views", "/views?x"):
                assert page.status(path, Sec_Fetch_Site=site) == 403
            assert page.status("/zero", "POST", X_Lampest="zero", Sec_Fetch_Site=site) == 403
            assert page.status("/", Sec_Fetch_Site=site) == 200, "a link to the page"
        assert page.status("/zero", "POST", X_Lampest="zero", Origin=origin) == 403
        seats = [
            page.server.seats.acquire(blocking=False) for _ in range(server_module.MAX_STREAMS)
        ]
        assert all(seats)
        for _ in seats:
            page.server.seats.release()
        own = {"Origin": f"http://127.0.0.1:{page.port}", "Sec_Fetch_Site": "same-origin"}
        assert page.status("/zero", "POST", X_Lampest="zero", **own) == 200
        assert page.status("/views", **own) == 200


@promise("apps/live/live: viewers need an access token")
def test_remote_clients_need_the_token(open_page: SimpleNamespace) -> None:
    for path in (
        "/",
        "/views",
        "/nothing",
        "/?token=",
        "/?token=a-token-of-my-owN",
        f"/?other={TOKEN}",
        f"/#{TOKEN}",
    ):
        answer = open_page.ask(path)
        text = answer.read()
        assert (answer.status, answer.headers.get("Set-Cookie")) == (403, None)
        assert b"lampest printed" in text and b"receiving" not in text
    for headers in (
        {"Cookie": f"lampest={TOKEN}"},
        {"Authorization": f"Basic {TOKEN}"},
        {"Cookie": '="\x01'},
    ):
        assert open_page.status("/views", **headers) == 403
    assert open_page.status(f"/?token={TOKEN}", "PUT") == 405


def test_a_browser_needs_the_token_once_and_programs_send_it_in_any_form(
    open_page: SimpleNamespace,
) -> None:
    assert open_page.server.url == f"http://127.0.0.1:{open_page.port}/?token={TOKEN}"
    answer = open_page.ask(f"/?token={TOKEN}")
    cookie = answer.headers["Set-Cookie"]
    assert answer.status == 200 and answer.read().startswith(b"<!") and TOKEN not in cookie
    assert cookie.endswith("; HttpOnly; SameSite=Lax; Path=/")
    crumb = cookie.split(";")[0]
    second = open_page.ask(Cookie=crumb)
    assert (second.status, second.headers.get("Set-Cookie")) == (200, None)
    assert (
        first_view(open_page.ask("/views", Cookie=f"theme=dark; {crumb}"))["state"] == "receiving"
    )
    assert open_page.status("/views", Cookie=crumb[:-1]) == 403
    assert open_page.status(f"/views?token={TOKEN}") == 200
    assert all(
        open_page.status("/views", Authorization=f"{kind} {TOKEN}") == 200
        for kind in ("Bearer", "token")
    )


def test_a_missing_token_is_generated() -> None:
    tokens = set()
    for _ in range(2):
        with page_at("0.0.0.0") as page:
            tokens.add(token := page.server.url.partition("?token=")[2])
            assert (page.status(), page.status(f"/?token={token}")) == (403, 200)
            assert not page.server.local and page.server.url.startswith("http://127.0.0.1:")
    assert len(tokens) == 2 and all(len(token) >= 32 for token in tokens)
    with page_at("127.0.0.1", TOKEN) as guarded:
        assert (guarded.status(), guarded.status(f"/?token={TOKEN}")) == (403, 200)
    for token in ("short", "with a blank in it", "ä" * 20, "x" * 15):
        with (
            pytest.raises(InputError, match="--token: give at least 16"),
            page_at("127.0.0.1", token),
        ):
            pass


def test_tokens_are_compared_in_constant_time(
    open_page: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever is brought goes through the comparison that does not tell where texts differ."""
    compared: list[bytes] = []
    monkeypatch.setattr(
        server_module, "compare_digest", lambda brought, secret: bool(compared.append(brought))
    )
    access = open_page.server.access
    assert (
        open_page.status(f"/?token={TOKEN}")
        == open_page.status(Authorization=f"Bearer {TOKEN}")
        == 403
    )
    assert open_page.status(Cookie=f"{access.name}={access.secret}") == 403
    assert len([text for text in compared if text]) == 3


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_error_pages_reflect_nothing_of_the_request(host: str) -> None:
    script = b"<script>alert(1)</script>"
    with page_at(host) as page:
        for request_line in (
            b"GET /%s HTTP/1.1" % script,
            b"%s / HTTP/1.1" % script,
            b"GET / %s" % script,
            script,
            b"GET /?token=%s HTTP/1.1" % script,
            b"GET /" + b"<script>" * 9000 + b" HTTP/1.1",
            b"GET / HTTP/1.1\r\n%s: x\r\n" % script + b"<script>: 1\r\n" * 200,
            b"GET / HTTP/9.9<script>",
        ):
            client = page.wired(request_line + b"\r\nHost: <script>localhost\r\n\r\n")
            client.shutdown(socket.SHUT_WR)
            answer = b"".join(iter(lambda client=client: client.recv(4096), b""))
            assert b"script" not in answer.replace(b"script-src", b"") and b"alert" not in answer
            assert re.match(rb"(HTTP/1\.[01] )?[45]\d\d [A-Z][A-Za-z -]+\r?\n", answer), answer
