# SPDX-License-Identifier: Apache-2.0
"""Options of the commands that serve a page."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from taccel_lab.report.live_page import PageOptions


@dataclass(frozen=True)
class PageArguments:
    """Where a page is served and how it looks."""

    host: str = "127.0.0.1"
    """Address to listen at; 0.0.0.0 lets other machines in, who may then do what the page can."""
    port: int = 8080
    """TCP port; 0 takes any that is free."""
    browser: bool = True
    """Open the page in the browser of this machine (--no-browser: only say where it is)."""
    dark: bool = False
    """Dark background."""

    def options(self) -> PageOptions:
        """As the page takes them."""
        from taccel_lab.report.live_page import PageOptions

        return PageOptions(self.host, self.port, self.browser, self.dark)
