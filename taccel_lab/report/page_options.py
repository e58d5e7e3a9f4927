# SPDX-License-Identifier: Apache-2.0
"""Where a page in the browser is served; apart from the page itself, so that help is fast."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PageOptions:
    """Where a page is served and how it looks."""

    host: str = "127.0.0.1"
    """Address to listen at; 0.0.0.0 lets other machines in: whoever has the address that is printed
    may do what the page can. A name of this machine: the page opens by that name, too."""
    port: int = 8080
    """TCP port; 0 takes any that is free."""
    browser: bool = True
    """Open the page in the browser of this machine (--no-browser: only say where it is)."""
    dark: bool = False
    """Dark background."""
