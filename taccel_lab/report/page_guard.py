# SPDX-License-Identifier: Apache-2.0
"""Who may use a page: whoever opens the address that the command printed, and no other website.

Any website that its user's browser shows can send requests to servers on the user's machine, and
open WebSockets, which no browser keeps to their own origin. So every request, HTTP and WebSocket,

- begins with the token of this run, which only the printed address has;
- names this machine as its ``Host``: a stranger's name that was made to mean this machine
  (DNS rebinding) is rejected;
- has no ``Origin`` but the page's own.

What is answered forbids the browser to run scripts of attributes, and to load from elsewhere: the
second line, where text would ever get into a page as more than text (``page_text`` is the first).
"""

from __future__ import annotations

import functools
import hmac
import ipaddress
import secrets
import socket
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

if TYPE_CHECKING:
    from viser import ViserServer
    from websockets.asyncio.server import ServerConnection
    from websockets.datastructures import Headers
    from websockets.http11 import Request, Response

    Answer = Callable[[ServerConnection, Request], Response | None]

POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'wasm-unsafe-eval'; script-src-attr 'none'; "
    "style-src 'unsafe-inline'; img-src data: blob:; font-src data:; worker-src blob: data:; "
    "connect-src 'self' ws://{host} wss://{host} data: blob:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""viser's client is one file with its script, styles and fonts inside, and starts a worker."""
REFUSED = (
    "This page opens at the address that its command printed, with all of its letters. By another "
    "name of this machine it opens where the command got that name with --host.\n"
)
_STARTING = threading.Lock()


@functools.cache
def run_token() -> str:
    """The token of this run: 128 random bits, as letters that addresses take."""
    return secrets.token_urlsafe(16)


def is_own_request(path: str, headers: Headers, served: str) -> bool:
    """Whether a request comes from whoever has the address, and from no other website.

    Args:
        path: Path of the request, with its query.
        headers: Its headers.
        served: Address or name that the page was asked to listen at.
    """
    token = path.partition("?")[0].split("/")[1:2]
    if not hmac.compare_digest("".join(token).encode(errors="replace"), run_token().encode()):
        return False
    hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
    if len(hosts) != 1 or not _means_this_machine(hosts[0], served):
        return False
    # Browsers name the origin of every WebSocket; what names none is a program with the token.
    own = {f"{scheme}://{hosts[0]}".lower() for scheme in ("http", "https")}
    return len(origins) <= 1 and all(origin.lower() in own for origin in origins)


def _means_this_machine(host: str, served: str) -> bool:
    """Whether a ``Host`` is one that nobody else can have pointed here: an address in numbers, or a
    name of this machine. Ports are free: they differ where a port is forwarded."""
    try:
        parts = urlsplit(f"//{host}")
        name, _ = parts.hostname or "", parts.port
    except ValueError:
        return False
    if parts.netloc != host or "@" in host:
        return False
    try:
        ipaddress.ip_address(name)
    except ValueError:
        own = socket.gethostname().lower()
        names = {"localhost", own, f"{own}.local", served.lower()}
        return name.removesuffix(".") in names
    return True


def start_guarded(start: Callable[[], ViserServer], title: str) -> ViserServer:
    """The server that ``start`` starts, which answers ``is_own_request`` alone, under a title.

    viser has no place for such a check, so the call by which it starts to listen is caught.

    Raises:
        RuntimeError: It listens by another call, and would answer anybody. It is stopped.
    """
    import websockets.asyncio.server as module

    guarded: list[str] = []
    with _STARTING:
        listen = module.serve

        def serve(
            handler: Any, host: str, port: int, *, process_request: Answer, **options: Any
        ) -> module.serve:
            guarded.append(host)
            check = _checked(process_request, host, title)
            return listen(handler, host, port, process_request=check, **options)

        module.serve = serve  # pyright: ignore[reportAttributeAccessIssue]
        try:
            server = start()
        finally:
            module.serve = listen
    if not guarded:
        server.stop()
        raise RuntimeError("viser listens in a way that is not known here: pages would be open")
    return server


def _checked(answer: Answer, served: str, title: str) -> Answer:
    """``answer`` to requests of our own, with the token taken off their path."""
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    from taccel_lab.report.page_title import give_title

    def checked(connection: ServerConnection, request: Request) -> Response | None:
        if not is_own_request(request.path, request.headers, served):
            body, headers = REFUSED.encode(), Headers({"Content-Type": "text/plain"})
            headers["Content-Length"] = str(len(body))
            return Response(403, "Forbidden", headers, body)
        request.path = request.path.removeprefix(f"/{run_token()}") or "/"
        found = answer(connection, request)
        if found is not None:
            give_title(found, title)
            found.headers["Content-Security-Policy"] = POLICY.format(host=request.headers["Host"])
            found.headers["Referrer-Policy"] = "no-referrer"
            found.headers["X-Content-Type-Options"] = "nosniff"
        return found

    return checked
