# SPDX-License-Identifier: Apache-2.0
"""Pages answer whoever has their address, from this machine's own pages, and nobody else."""

from __future__ import annotations

import http.client
import socket
import threading
from collections.abc import Iterator
from typing import Any
from unittest.mock import Mock

import pytest

from taccel_lab.report.live_page import PageOptions, live_page, page_address
from taccel_lab.report.page_guard import run_token, start_guarded
from tests.viewer.browser import chromium_page

viser = pytest.importorskip("viser", reason="the extra view is not installed")
client = pytest.importorskip("websockets.sync.client")
HERE = PageOptions(port=0, browser=False)
TOKEN = f"/{run_token()}"
FOREIGN = "https://elsewhere.example"


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    """Port of a page that is served as by default."""
    with live_page("A page", HERE) as server:
        yield server.get_port()


def status(port: int, path: str, headers: dict[str, str]) -> int:
    """Answer to a request of a page, with nothing in it but what is given."""
    asked = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    asked.putrequest("GET", path, skip_host=True, skip_accept_encoding=True)
    for name, value in headers.items():
        asked.putheader(name, value)
    asked.endheaders()
    try:
        return asked.getresponse().status
    finally:
        asked.close()


def socket_answer(port: int, path: str, headers: dict[str, str]) -> int:
    """Answer to a WebSocket's first request; 101 where it is let in."""
    upgrade = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13",
               "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="}  # fmt: skip
    return status(port, path, {**upgrade, **headers})


REQUESTS: list[tuple[str, str, dict[str, str], bool]] = [
    ("the page itself", TOKEN + "/", {"Host": "127.0.0.1:{port}"}, True),
    ("its WebSocket", TOKEN,
     {"Host": "127.0.0.1:{port}", "Origin": "http://127.0.0.1:{port}"}, True),
    ("a query", TOKEN + "/?darkMode", {"Host": "localhost:{port}"}, True),
    ("a forwarded port", TOKEN, {"Host": "LocalHost:9", "Origin": "http://localhost:9"}, True),
    ("the machine by its number", TOKEN, {"Host": "[::1]:{port}"}, True),
    ("the machine by its name", TOKEN, {"Host": socket.gethostname()}, True),
    ("a proxy with TLS", TOKEN, {"Host": "localhost", "Origin": "https://localhost"}, True),
    ("no token", "/", {"Host": "127.0.0.1:{port}"}, False),
    ("another token", "/" + "x" * 22, {"Host": "127.0.0.1:{port}"}, False),
    ("a token cut short", TOKEN[:-1], {"Host": "127.0.0.1:{port}"}, False),
    ("a token in the query", f"/?{run_token()}", {"Host": "127.0.0.1:{port}"}, False),
    ("another website", TOKEN, {"Host": "127.0.0.1:{port}", "Origin": FOREIGN}, False),
    ("another port", TOKEN, {"Host": "127.0.0.1:{port}", "Origin": "http://127.0.0.1:1"}, False),
    ("a file's page", TOKEN, {"Host": "127.0.0.1:{port}", "Origin": "null"}, False),
    ("an empty origin", TOKEN, {"Host": "127.0.0.1:{port}", "Origin": ""}, False),
    ("a rebound name", TOKEN, {"Host": "elsewhere.example:{port}"}, False),
    ("a rebound name of its own", TOKEN,
     {"Host": "elsewhere.example", "Origin": "http://elsewhere.example"}, False),
    ("a name that begins like ours", TOKEN, {"Host": "localhost.elsewhere.example"}, False),
    ("a number in a name", TOKEN, {"Host": "127.0.0.1.elsewhere.example"}, False),
    ("a user's name", TOKEN, {"Host": "elsewhere.example@127.0.0.1"}, False),
    ("no host", TOKEN, {}, False),
]  # fmt: skip


@pytest.mark.parametrize(("path", "headers", "own"), [case[1:] for case in REQUESTS],
                         ids=[case[0] for case in REQUESTS])  # fmt: skip
def test_pages_answer_their_own_requests_alone(
    path: str, headers: dict[str, str], own: bool, port: int
) -> None:
    headers = {name: value.format(port=port) for name, value in headers.items()}
    assert status(port, path, headers) == (200 if own else 403)
    assert socket_answer(port, path, headers) == (101 if own else 403)


def test_two_origins_or_hosts_are_none(port: int) -> None:
    for name, value in (("Origin", f"http://127.0.0.1:{port}"), ("Host", f"127.0.0.1:{port}")):
        with socket.create_connection(("127.0.0.1", port), timeout=10) as asked:
            lines = [f"GET {TOKEN} HTTP/1.1", *[f"{name}: {value}"] * 2]
            lines += [f"Host: 127.0.0.1:{port}"] * (name != "Host")
            asked.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
            assert b" 403 " in asked.recv(100)


def test_what_a_foreign_page_sends_is_not_done(port: int) -> None:
    """Such as "Undo last" of a recording: a message on a WebSocket of its own."""
    options: dict[str, Any] = {"subprotocols": [f"viser-v{viser.__version__}"]}
    address = f"ws://127.0.0.1:{port}{TOKEN}"
    with client.connect(address, origin=f"http://127.0.0.1:{port}", **options) as own:
        assert own.recv(timeout=10)
    for path, origin in ((address, FOREIGN), (f"ws://127.0.0.1:{port}", FOREIGN)):
        with pytest.raises(Exception, match="403"):
            client.connect(path, origin=origin, **options)


def test_a_page_of_another_origin_is_refused_by_the_browsers_own_socket(port: int) -> None:
    script = """address => new Promise(done => {
        const socket = new WebSocket(address);
        socket.onopen = () => done("open"); socket.onerror = () => done("refused");
    })"""
    with chromium_page("data:text/html,elsewhere") as page:
        # Even where the address has leaked.
        assert page.evaluate(script, f"ws://127.0.0.1:{port}{TOKEN}") == "refused"


@pytest.mark.parametrize(("host", "reached"), [(None, False), ("0.0.0.0", True)])
def test_pages_listen_on_this_machine_alone_unless_asked(host: str | None, reached: bool) -> None:
    options = HERE if host is None else PageOptions(host=host, port=0, browser=False)
    with live_page("A page", options) as server:
        assert page_address(server) == f"http://127.0.0.1:{server.get_port()}{TOKEN}/"
        # All of 127.0.0.0/8 is this machine, but only what listens at every address answers there.
        with socket.socket() as other:
            other.settimeout(10)
            assert (other.connect_ex(("127.0.0.2", server.get_port())) == 0) is reached
        if reached:
            headers = {"Host": f"192.0.2.7:{server.get_port()}"}
            assert status(server.get_port(), TOKEN, headers) == 200
            assert status(server.get_port(), "/", headers) == 403


def test_a_name_that_was_asked_for_is_ours() -> None:
    from websockets.datastructures import Headers

    from taccel_lab.report.page_guard import is_own_request

    asked = Headers(Host="sensors.example:8080", Origin="http://sensors.example:8080")
    assert is_own_request(TOKEN, asked, "sensors.example")
    assert not is_own_request(TOKEN, asked, "127.0.0.1")


def test_a_server_that_nobody_guards_is_stopped() -> None:
    unknown = Mock()  # As if viser listened by other means.
    with pytest.raises(RuntimeError, match="pages would be open"):
        start_guarded(lambda: unknown)
    unknown.stop.assert_called_once()


def test_pages_of_several_threads_are_all_guarded() -> None:
    """Each once: guarded twice, a page would answer nobody."""
    found: list[tuple[int, int]] = []

    def serve() -> None:
        with live_page("A page", HERE) as server:
            headers = {"Host": "127.0.0.1", "Origin": FOREIGN}
            own = status(server.get_port(), TOKEN, {"Host": "127.0.0.1"})
            found.append((own, status(server.get_port(), TOKEN, headers)))

    threads = [threading.Thread(target=serve) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert found == [(200, 403)] * 3
