# SPDX-License-Identifier: Apache-2.0
"""Pages are served where they were asked to be, or refused with what to do."""

from __future__ import annotations

import socket
import sys
import urllib.request

import pytest

from taccel_lab.errors import InputError
from taccel_lab.report.live_page import (
    PageOptions,
    live_page,
    page_address,
    require_free_port,
    serve_until_stopped,
)


def test_a_page_answers_while_it_is_open_and_not_after(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("viser")
    said: list[str] = []
    with live_page("A page", PageOptions(port=0, browser=False), said.append) as server:
        address = page_address(server)
        with urllib.request.urlopen(address, timeout=10) as answer:
            assert b"<html" in answer.read()
    assert said == [f"A page: {address} (Ctrl-C closes it)"]
    with pytest.raises(OSError):
        urllib.request.urlopen(address, timeout=2)
    assert capsys.readouterr().out == ""


def test_a_port_in_use_is_refused_with_what_to_do() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(InputError, match=rf"port {port} of 127.0.0.1 .*--port 0"):
            require_free_port("127.0.0.1", port)
    require_free_port("127.0.0.1", 0)


@pytest.mark.parametrize(
    ("host", "port", "words"),
    [("127.0.0.1", 70000, "does not exist"), ("no.such.host.invalid", 8080, "no address")],
)
def test_hosts_and_ports_that_cannot_be(host: str, port: int, words: str) -> None:
    with pytest.raises(InputError, match=words):
        require_free_port(host, port)


def test_without_viser_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    with (
        pytest.raises(InputError, match=r"pip install 'taccel-lab\[view\]'"),
        live_page("x", PageOptions(port=0, browser=False)),
    ):
        pass


def test_ctrl_c_ends_a_page_without_an_error() -> None:
    class Interrupted:
        def wait(self, _: float) -> bool:
            raise KeyboardInterrupt

    serve_until_stopped(Interrupted())  # type: ignore[arg-type]
