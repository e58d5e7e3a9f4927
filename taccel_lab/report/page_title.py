# SPDX-License-Identifier: Apache-2.0
"""The name of a live page in the browser's tab and history: viser's client calls all "Viser"."""

from __future__ import annotations

import gzip
from typing import TYPE_CHECKING

from taccel_lab.report.page_text import PageText

if TYPE_CHECKING:
    from websockets.http11 import Response

_VISERS = b"<title>Viser</title>"


def give_title(response: Response, title: str) -> None:
    """Put a title into viser's client, where the response holds it."""
    packed = response.headers.get("Content-Encoding") == "gzip"
    body = gzip.decompress(response.body) if packed else bytes(response.body)
    if _VISERS not in body:
        return
    body = body.replace(_VISERS, PageText("<title>{}</title>").format(title).encode(), 1)
    response.body = gzip.compress(body) if packed else body
    del response.headers["Content-Length"]  # Else there would be two.
    response.headers["Content-Length"] = str(len(response.body))
