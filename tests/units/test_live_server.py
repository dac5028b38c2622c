"""The live page's server: views, guests, addresses, and what the page itself may ask for."""

import dataclasses
import http.client
import json
import re
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from lampest.files.errors import InputError
from lampest.report.live import server as server_module
from lampest.report.live.handover import Newest
from lampest.report.live.message import View
from lampest.report.live.run import Outlets, Replay, chosen, live
from lampest.report.live.server import Asks, PageServer, address, is_local_name, serving

LAMPREY = Path(__file__).parents[2] / "data" / "lamprey_25mm.h5"


def test_the_newest_is_never_missed() -> None:
    """A reader that is slower than the writer skips, but sees numbers grow, and the last thing."""
    newest, seen = Newest(0), []

    def read() -> None:
        number = 0
        while (news := newest.after(number)) is not None:
            number = news.number
            seen.append(news)
            time.sleep(1e-4)

    reader = threading.Thread(target=read)
    reader.start()
    for thing in range(1, 2001):
        newest.put(thing)
    newest.close()
    reader.join(10)
    assert all(news.number == news.thing for news in seen)
    assert seen == sorted(seen) and seen[-1].thing == 2000
    assert newest.after(2000, 0.01) is None and newest.closed


@pytest.fixture
def page() -> Iterator[SimpleNamespace]:
    """A running server and what asks it."""
    shown = Newest(View("here", "LSM", "receiving"))
    with serving("127.0.0.1", 0, shown) as server:

        def ask(method: str = "GET", path: str = "/", **headers: str) -> http.client.HTTPResponse:
            connection = http.client.HTTPConnection(*server.server_address[:2], timeout=10)
            connections.append(connection)
            connection.request(method, path, headers=headers)
            answer = connection.getresponse()
            answers.append(answer)
            return answer

        connections: list[http.client.HTTPConnection] = []
        answers: list[http.client.HTTPResponse] = []
        yield SimpleNamespace(server=server, shown=shown, ask=ask)
        for item in (*answers, *connections):
            item.close()


def first_view(answer: http.client.HTTPResponse) -> Any:
    line = answer.readline()
    assert line.startswith(b"data: ")
    return json.loads(line[6:])


def test_the_server_gives_the_page_and_the_views_and_nothing_else(page: SimpleNamespace) -> None:
    answer = page.ask()
    assert answer.status == 200 and answer.headers["Content-Type"] == "text/html; charset=utf-8"
    assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
    assert answer.read() == files("lampest.report.live").joinpath("page.html").read_bytes()
    views = page.ask(path="/views")
    assert views.headers["Content-Type"] == "text/event-stream"
    assert first_view(views)["state"] == "receiving"
    page.shown.change(lambda view: dataclasses.replace(view, state="gone"))
    assert views.readline() == b"\n"
    assert first_view(views)["state"] == "gone"
    for path in ("/favicon.ico", "/page.html", "/../setup", "/views/", "/?x"):
        assert page.ask(path=path).status == 404
    for method in ("HEAD", "PUT", "DELETE", "OPTIONS", "TRACE", "NONSENSE"):
        refused = page.ask(method)
        assert (refused.status, refused.headers["Allow"]) == (405, "GET, POST")
    assert page.server.server_address[0] == "127.0.0.1"


def test_a_new_zero_is_for_the_page_itself_to_ask_for() -> None:
    asked: list[str] = []
    shown = Newest(View("here", "LSM", "receiving"))
    with serving(
        "127.0.0.1", 0, shown, asks=Asks(lambda: asked.append("zero"), lambda: asked.append("seen"))
    ) as server:

        def posted(path: str, **headers: str) -> int:
            with closing(http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=10)) as connection:
                connection.request("POST", path, headers={name.replace("_", "-"): of for name, of in headers.items()})
                return connection.getresponse().status

        assert [posted("/zero"), posted("/zero", X_Lampest="one"), posted("/", X_Lampest="zero")] == [403, 403, 404]
        assert posted("/zero", X_Lampest="zero", Host="attacker.example") == 403
        assert not asked
        assert posted("/acknowledge") == posted("/acknowledge", X_Lampest="zero") == 403
        assert posted("/zero", X_Lampest="zero") == posted("/acknowledge", X_Lampest="acknowledge") == 200
        assert asked == ["zero", "seen"]
        assert posted("/record", X_Lampest="record") == 404, "there is nothing to record"


def test_a_recording_is_for_the_page_itself_to_ask_for_and_needs_the_token() -> None:
    asked: list[str] = []

    def record(name: str) -> None:
        if "." in name:
            raise InputError("that is no name")
        asked.append(name)

    shown = Newest(View("here", "LSM", "receiving"))
    with serving("127.0.0.1", 0, shown, "0123456789abcdef", Asks(record=record)) as server:

        def posted(path: str, **headers: str) -> int:
            with closing(http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=10)) as connection:
                connection.request("POST", path, headers={name.replace("_", "-"): of for name, of in headers.items()})
                return connection.getresponse().status

        told = {"Authorization": "Bearer 0123456789abcdef"}
        assert posted("/record", X_Lampest="record") == posted("/record", X_Lampest="zero", **told) == 403
        assert posted("/record?name=x", **told) == 403, "a foreign page's form has no such header"
        assert posted("/record?name=../x", X_Lampest="record", **told) == 400
        assert not asked
        assert posted("/record?name=x", X_Lampest="record", **told) == posted("/record", X_Lampest="record", **told)
        assert asked == ["x", ""]


def test_on_the_loopback_the_server_answers_to_no_foreign_name(page: SimpleNamespace) -> None:
    assert page.ask(Host="localhost:8137").status == 200
    assert page.ask(path="/views", Host="attacker.example:8137").status == 403
    assert all(is_local_name(name) for name in ("127.0.0.1", "[::1]:80", "[::1]", "localhost", "127.0.0.9:1"))
    assert not any(is_local_name(name) for name in ("", "10.0.0.1:80", "localhost.example", "[::2]:80"))


def test_clients_may_come_and_go_as_they_like(page: SimpleNamespace, capfd: pytest.CaptureFixture[str]) -> None:
    host, port = page.server.server_address[:2]
    for request in (b"", b"GET", b"\0\xff\r\n\r\n", b"GET /views HTTP/1.1\r\nHost: localhost\r\n\r\n") * 10:
        with socket.create_connection((host, port), timeout=10) as client:
            client.sendall(request)
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    for _ in range(3):
        page.shown.change(lambda view: view)
        time.sleep(0.05)
    assert first_view(page.ask(path="/views"))["source"] == "here"
    assert page.ask().status == 200
    assert capfd.readouterr() == ("", "")


def test_more_clients_than_seats_are_told_so(page: SimpleNamespace) -> None:
    for _ in range(server_module.MAX_STREAMS):
        assert page.ask(path="/views").status == 200
    assert page.ask(path="/views").status == 503
    assert page.ask().status == 200


def test_the_last_view_reaches_everybody_and_nobody_holds_up_the_end() -> None:
    shown = Newest(View("here", "LSM", "receiving"))
    with serving("127.0.0.1", 0, shown) as server, socket.create_connection(server.server_address[:2]) as silent:
        connection = http.client.HTTPConnection(*server.server_address[:2], timeout=10)
        connection.request("GET", "/views")
        answer = connection.getresponse()
        first_view(answer)
        shown.change(lambda view: dataclasses.replace(view, state="lampest has ended"))
        began = time.monotonic()
        assert silent.fileno()
    rest = answer.read().decode()
    assert '"state":"lampest has ended"' in rest
    assert time.monotonic() - began < 3
    answer.close()
    connection.close()


def test_an_address_in_use_is_one_sentence(page: SimpleNamespace) -> None:
    host, port = page.server.server_address[:2]
    with pytest.raises(InputError, match=rf"cannot listen at 127\.0\.0\.1:{port} \(Address already in use\)"):
        live(Replay(LAMPREY), chosen(None, None), Outlets(f"{host}:{port}"))


@pytest.mark.parametrize("text", ["", "8137", "127.0.0.1", "127.0.0.1:x", "host:80", "127.0.0.1:70000", ":80"])
def test_an_address_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="not of the form HOST:PORT"):
        address(text)


def test_an_address_is_a_host_and_a_port() -> None:
    assert address("localhost:0") == ("127.0.0.1", 0)
    assert address("[::1]:81") == ("::1", 81)
    shown = Newest(View("here", "LSM", "receiving"))
    with serving("0.0.0.0", 0, shown) as open_to_all:
        assert not open_to_all.local and open_to_all.url.startswith("http://127.0.0.1:")
    assert PageServer.daemon_threads


def test_the_page_loads_nothing_from_elsewhere() -> None:
    text = files("lampest.report.live").joinpath("page.html").read_text(encoding="utf-8")
    assert not re.findall(r"https?://|\bsrc=|@import|url\(|<link(?! rel=\"icon\" href=\"data:,\")", text)
    assert len(text) < 30_000
