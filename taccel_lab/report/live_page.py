# SPDX-License-Identifier: Apache-2.0
"""A page in the browser that answers while it is served: viser, opened, kept open and closed.

What help needs loads fast: the guard and the browser load with the page.
"""

from __future__ import annotations

import contextlib
import io
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from viser import ViserServer


@dataclass(frozen=True)
class PageOptions:
    """Where a page is served and how it looks."""

    host: str = "127.0.0.1"
    """Address to listen at. 0.0.0.0 lets other machines in: whoever has the printed address can
    use the page. A name of this machine works too."""
    port: int = 8080
    """TCP port; 0 takes any that is free."""
    browser: bool = True
    """Open the page in this machine's browser (--no-browser: only print its address)."""
    dark: bool = False
    """Dark background."""


BRAND = (0, 114, 178)
"""Colour of buttons and sliders: the blue of the figures (``report.style``)."""


def viser_module() -> Any:
    """The package ``viser``; InputError where it is not installed."""
    try:
        import viser
    except ImportError:
        raise InputError(
            "pages are served by viser, which is not installed: pip install 'taccel-lab[view]'"
        ) from None
    return viser


@contextmanager
def live_page(
    title: str, options: PageOptions = PageOptions(), say: Callable[[str], None] | None = None
) -> Iterator[ViserServer]:
    """Serve a page while the block runs: fill it with the server's ``gui`` and ``scene``, then wait
    with ``serve_until_stopped``. The page is closed when the block is left, however that happens.

    Args:
        title: At the top of the page's panel and in the browser's tab.
        options: Where it is served.
        say: Told in one sentence where the page is, once it can be opened.

    Raises:
        InputError: viser is not installed, the port is in use or the host is not of this machine.
    """
    import webbrowser

    from taccel_lab.report.page_guard import start_guarded

    viser = viser_module()
    require_free_port(options.host, options.port)
    # viser prints where it listens and that it stopped: no results of the command.
    with contextlib.redirect_stdout(io.StringIO()):
        server = start_guarded(
            lambda: viser.ViserServer(options.host, options.port, label=title, verbose=False),
            title,
        )
    try:
        # Sharing sends the page through a server of strangers; no button for that.
        server.gui.configure_theme(
            dark_mode=options.dark, show_logo=False, show_share_button=False, brand_color=BRAND
        )
        if say is not None:
            say(f"{title}: {page_address(server)} (Ctrl-C closes it)")
        if options.browser:
            webbrowser.open(page_address(server))
        yield server
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


def page_address(server: ViserServer) -> str:
    """What to type into a browser on this machine, with the token of this run. On another machine,
    where ``host`` lets it in, this one's name or address stands in place of 127.0.0.1."""
    from taccel_lab.report.page_guard import run_token

    host = server.get_host()
    if host in ("0.0.0.0", "::", ""):
        host = "127.0.0.1"
    host = f"[{host}]" if ":" in host else host
    return f"http://{host}:{server.get_port()}/{run_token()}/"


def serve_until_stopped(stop: threading.Event | None = None) -> None:
    """Wait until ``stop`` is set; Ctrl-C leaves by KeyboardInterrupt, as everywhere."""
    stop = stop or threading.Event()
    # Waiting for an event without end would hold back Ctrl-C on some systems.
    while not stop.wait(0.2):
        pass


def require_free_port(host: str, port: int) -> None:
    """Refuse a port that cannot be listened at: viser would take another one and not say so.

    Raises:
        InputError: In use, not allowed to this user, or a host that is not this machine's.
    """
    if not 0 <= port <= 65535:
        raise InputError(f"port {port} does not exist; allowed: 0 (any that is free) to 65535")
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except OSError:
        raise InputError(f"host {host!r} is no address of this machine") from None
    for family, kind, protocol, _, address in found:
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(address)
            except PermissionError:
                raise InputError(
                    f"port {port} is kept for administrators; choose one from 1024 on"
                ) from None
            except OSError as error:
                raise InputError(
                    f"port {port} of {host} cannot be used ({error.strerror}): choose another "
                    "with --port, or --port 0 for any that is free"
                ) from None
