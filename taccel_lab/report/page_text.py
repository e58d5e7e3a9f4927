# SPDX-License-Identifier: Apache-2.0
"""Text on pages: what others wrote stands there as they wrote it, and is never more than text.

viser shows Markdown with raw HTML in it. Names of profiles, presses and data sets, and messages
that quote them, come from anybody: they are put into ``PageText``, which escapes them, and only
``Note`` gives text to viser, which escapes what is no ``PageText``. Labels, buttons, choices,
titles and names in the scene are no Markdown: viser shows them as they are.
"""

from __future__ import annotations

import html
import re
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Self

from markupsafe import Markup

from taccel_lab.printable import readable
from taccel_lab.report.markdown import markdown_table

if TYPE_CHECKING:
    from viser import GuiApi, GuiHtmlHandle, GuiMarkdownHandle


_MEANT = re.compile(
    r"""[\\`*_\[\]{}<>&~|\#"'$@]"""  # Anywhere: code, emphasis, links, HTML, tables.
    r"|:(?=//)|(?<=www)\."  # Bare addresses: links, in which nothing is unescaped.
    # What begins a list, a rule, a heading or indented code: its first character.
    r"|^(?=\s{0,3}(?:[-+=](?!\d)|\d{1,9}[.)](?:\s|$))|\s{4}).",
    re.IGNORECASE,
)


class PageText(Markup):
    """Markdown, or HTML, of ours. ``format``, ``+`` and ``join`` escape what is put into it, in
    both languages: ``PageText("**{}**").format(name)``."""

    @classmethod
    def escape(cls, s: Any, /) -> Self:
        """``s`` as text that shows itself, in one line; ``PageText`` as it is."""
        if isinstance(s, cls):
            return s
        line = " ".join(readable(str(s)).split("\n"))
        return cls(_MEANT.sub(_entity, line))


def _entity(found: re.Match[str]) -> str:
    """The reference to a character that both languages take for the character itself."""
    named = html.escape(found[0])
    return named if named != found[0] else f"&#{ord(found[0])};"


def page_table(rows: Iterable[Iterable[Any]], head: Iterable[Any] = ("", "")) -> PageText:
    """A table in Markdown; cells are escaped."""
    escaped = [[PageText.escape(cell) for cell in row] for row in rows]
    return PageText(markdown_table(map(PageText.escape, head), escaped))


class Note:
    """A text on a page, which may change."""

    def __init__(self, handle: GuiMarkdownHandle | GuiHtmlHandle) -> None:
        self._handle = handle

    @property
    def content(self) -> PageText:
        """What is shown. Anything but ``PageText`` that is assigned is escaped."""
        return PageText(self._handle.content)

    @content.setter
    def content(self, text: str) -> None:
        self._handle.content = str(PageText.escape(text))

    @property
    def visible(self) -> bool:
        """Whether it is shown."""
        return self._handle.visible

    @visible.setter
    def visible(self, shown: bool) -> None:
        self._handle.visible = shown


def add_note(gui: GuiApi, text: str = "") -> Note:
    """A note in Markdown."""
    return Note(gui.add_markdown(str(PageText.escape(text))))


def add_html_note(gui: GuiApi, text: str = "", visible: bool = True) -> Note:
    """A note in HTML."""
    return Note(gui.add_html(str(PageText.escape(text)), visible=visible))
