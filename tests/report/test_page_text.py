# SPDX-License-Identifier: Apache-2.0
"""What others wrote stands on pages as they wrote it, in Markdown and in HTML."""

from __future__ import annotations

import re
from html.parser import HTMLParser

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from taccel_lab.printable import readable
from taccel_lab.report.page_text import PageText, page_table

MARKDOWN = MarkdownIt("commonmark", {"html": True}).enable(["table", "strikethrough"])
HOSTILE = (
    "<img src=x onerror=alert(1)>", "<script>alert(1)</script>", "</td></table><svg onload=a>",
    "[x](javascript:alert(1))", "![x](http://elsewhere.example/x.png)", "{alert(1)}", "&lt;b&gt;",
    "<!-- begin x", "**x**", "__x__", "~~x~~", "`x`", "a | b", "\\<b>", "# x", "## x", "- x", "+ x",
    "1. x", "10) x", "---", "===", "> x", "    x", "  - x", "```\n<b>\n```", "a\n\n<b>", "a\n- b",
    "[x]: http://elsewhere.example", "<https://elsewhere.example>", "' onmouseover='alert(1)",
    '" onmouseover="alert(1)', "\u202e<b>", "\0<b>", "\udcff<b>", "a\r<b>", "-1.5", "*", "_",
)  # fmt: skip


class Page(HTMLParser):
    """Tags and text of a page, as a browser takes them."""

    def __init__(self, source: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[str] = []
        self.text = ""
        self.feed(source)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags += [tag, *(name for name, _ in attrs)]

    def handle_data(self, data: str) -> None:
        self.text += data


def bare(text: str) -> str:
    """What a browser shows of a text, between other words."""
    return re.sub(r"\s+", " ", readable(text)).strip()


def examples(test: object) -> object:
    for text in HOSTILE:
        test = example(text)(test)  # type: ignore[arg-type]
    return test


@examples
@given(st.text(max_size=40) | st.sampled_from(HOSTILE).flatmap(lambda x: st.just(x + x)))
def test_a_text_shows_itself_and_is_no_markup(text: str) -> None:
    escaped = PageText("{}").format(text)
    # Alone, in a paragraph, in a list, in a table, and as HTML inside an attribute and outside.
    for source, tags in (
        (escaped, ["p"]),
        (PageText("a\n\n") + text, ["p", "p"]),
        (PageText("- a\n- {}").format(text), ["ul", "li", "li"]),
    ):
        page = Page(MARKDOWN.render(source))
        assert [tag for tag in page.tags if tag != "p"] == [tag for tag in tags if tag != "p"]
        assert bare(page.text) in (bare(text), bare("a " + text))
    table = Page(MARKDOWN.render(page_table([(text, "b")], ("a", text))))
    assert table.tags == "table thead tr th th tbody tr td td".split()
    assert bare(table.text).replace(" ", "") == bare(f"a{text}{text}b").replace(" ", "")
    as_html = Page(f'<i title="{escaped}">{escaped}</i>')
    assert as_html.tags == ["i", "title"] and bare(as_html.text) == bare(text)


def test_what_is_ours_stays_markup_and_figures_stay_figures() -> None:
    bold = PageText("**{}**, {:.2f} N").format(PageText("<b>x</b>"), -1.5)
    assert bold == "**<b>x</b>**, -1.50 N"
    assert PageText("{}").format("force 1.5 ± 0.2 N (12 %)") == "force 1.5 ± 0.2 N (12 %)"
    assert PageText(" and ").join(["a*", PageText("*b*")]) == "a&#42; and *b*"
    assert PageText("a ") + "<b>" == "a &lt;b&gt;"


@pytest.mark.parametrize("text", ["<img src=x onerror='alert(1)'>", "![x](/etc/hostname)"])
def test_notes_escape_what_is_not_said_to_be_markup(text: str) -> None:
    """The default is the safe one: nobody has to think of it."""
    from types import SimpleNamespace

    from taccel_lab.report.page_text import Note, add_html_note, add_note

    gui = SimpleNamespace(
        add_markdown=lambda content: SimpleNamespace(content=content, visible=True),
        add_html=lambda content, visible: SimpleNamespace(content=content, visible=visible),
    )
    notes: list[Note] = [add_note(gui, text), add_html_note(gui, text)]  # type: ignore[arg-type]
    for note in notes:
        shown = note.content
        assert "<" not in shown and "[" not in shown and type(note._handle.content) is str
        note.content = "**"
        note.content += PageText("*") + text
        assert note.content == PageText("&#42;&#42;*") + text
