# SPDX-License-Identifier: Apache-2.0
"""Pages of reports: their text, their parts, and whose files they replace."""

from __future__ import annotations

import gzip
import html
import http.client
import json
import os
import re
import socket
import threading
from dataclasses import replace
from functools import partial
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest
import viser
from hypothesis import example, given
from hypothesis import strategies as st
from markdown_it import MarkdownIt
from websockets.datastructures import Headers
from websockets.sync import client

from taccel_lab.calibration.profile_page import profile_page
from taccel_lab.printable import readable
from taccel_lab.profile import DepthResponseBlock, Provenance
from taccel_lab.report.lead import Link, Picture, Score, Strip
from taccel_lab.report.live_page import PageOptions, live_page, page_address
from taccel_lab.report.page import Page, Table, page_html, to_do_first, write_page
from taccel_lab.report.page_guard import is_own_request, run_token, start_guarded
from taccel_lab.report.page_text import PageText, add_html_note, add_note, page_table
from taccel_lab.report.remark import Remark, Severity
from taccel_lab.report.style import new_figure
from taccel_lab.sensors.profile import catalogue_profile
from tests.support.synthetic_presses import GRID, tiny_profile
from tests.viewer.browser import chromium_page


def written(page: Page, folder: Path) -> str:
    """The page's text."""
    write_page(page, folder / "out")
    return (folder / "out" / "report.html").read_text(encoding="utf-8")


EMPTY = Picture("empty", lambda: new_figure(2, 2)[0], "A picture.")


def test_a_page_shows_its_verdict_and_escapes_text(tmp_path):
    page = Page(
        "Fit <of> things",
        "A summary.",
        remarks=[Remark(Severity.WARNING, "few", "only 3 frames")],
        tables=[Table("Numbers", ("name", "value"), [("x", 1.23456789), ("y", None)])],
        pictures=[EMPTY],
        figures={"x": 1.5},
    )
    html = written(page, tmp_path)
    for text in ("Fit &lt;of&gt; things", "Verdict: usable", "1.235", "data:image/png;base64,"):
        assert text in html
    assert "http" not in html
    data = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
    assert data["x"] == 1.5 and data["remarks"][0]["code"] == "few"


def test_a_page_opens_with_pictures_scores_and_links(tmp_path):
    panels = [replace(EMPTY, name=name, caption=f"the {name}") for name in ("photo", "depth")]
    page = Page(
        "Press", "Made so.", [Remark(Severity.WARNING, "few", "only 3")],
        [Table("Blocks", ("block", "look at"), [("x", (Link("page", "x/report.html"),))])],
        [EMPTY],
        strips=[Strip("p<0>: 2.10 +- 0.20 mm", panels, (Link("all of it", "../p0/"),))],
        scores=[Score("38.7", "dB", "rendered images", "12 held-out presses; bare: 20")],
        links=[Link("the profile", "../profile/")],
    )  # fmt: skip
    html = written(page, tmp_path)
    order = ("Verdict: usable", "p&lt;0&gt;: 2.10 ± 0.20 mm", "the photo", "the depth",
             'href="../p0/"', "38.7 <small>dB", "12 held-out presses", 'href="../profile/"',
             "Made so.", "To do first", "<h2>Blocks", 'href="x/report.html"',
             "A picture.")  # fmt: skip
    places = [html.index(text) for text in order]
    assert places == sorted(places)
    assert {"photo.png", "depth.png", "empty.png"} <= set(os.listdir(tmp_path / "out"))
    data = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
    assert data["scores"][0]["value"] == "38.7"
    assert data["pictures"][0] == {"file": "photo.png", "caption": "the photo"}


def test_a_page_that_judges_nothing_is_not_green_and_names_break_at_underscores():
    table = Table("T", ("a",), [("contact_area_mm2",)])
    measured = Page("Run", "", headline="3 of 9", tables=[table])
    html = page_html(measured, {})
    assert 'class="verdict plain"' in html and "contact_<wbr>area_<wbr>mm2" in html
    judged = replace(measured, remarks=[Remark(Severity.ERROR, "bad", "it is bad")])
    assert 'class="verdict plain"' not in page_html(judged, {})


@pytest.mark.thorough
def test_the_page_of_a_profile_shows_each_block_and_its_evidence(tmp_path):
    profile, modulus = catalogue_profile("gelsight_mini"), "young_modulus_pa"
    evidence = Provenance(
        kind="calibrated", method="fit", source="bench", inputs={"record.csv": "0" * 64},
        residuals={"force_rms_relative": 0.0123}, valid_region={"force_n": (0.0, 20.0)},
        spread={modulus: 4e3}, interval={"poisson_ratio": (0.4711, 0.4899)},
        correlation={f"{modulus}*poisson_ratio": -0.87}, verdict="weak",
        remarks=("the record does not tell nu",),
    )  # fmt: skip
    values = {modulus: 2e5, "poisson_ratio": 0.48, "provenance": evidence}
    html = written(profile_page(profile.with_block(profile.material.replace(**values))), tmp_path)
    for text in ("Verdict: weak", "0.0123", "0.4711 to 0.4899", "-0.87", "does not tell nu"):
        assert text in html
    for key in profile.blocks():
        assert f"<h2>{key}</h2>" in html


def test_the_verdict_is_followed_by_three_things_to_do_at_most(tmp_path):
    remarks = [
        Remark(Severity.INFO, "a", "just so"),
        Remark(Severity.WARNING, "block_state", "color: usable, with reservations"),
        *(Remark(Severity.WARNING, "b", f"warning {k}") for k in range(4)),
        Remark(Severity.ERROR, "c", "the worst"),
    ]
    first, others = to_do_first(remarks)
    assert [r.message for r in first] == ["the worst", "warning 0", "warning 1"]
    assert [r for r in remarks if r not in first] == others and len(others) == 4
    html = written(Page("x", "", remarks=remarks), tmp_path)
    order = ("Verdict: weak", "To do first", "the worst", "4 more remarks", "just so")
    places = [html.index(text) for text in order]
    assert places == sorted(places)
    assert html.count("<ol>") == 1 and html.count("<li>") == len(remarks)


def test_a_picture_opens_a_page_and_folded_blocks_and_long_sources_end_it(tmp_path):
    source = "measured on the bench by a person who writes long sentences, " * 3
    tables = [
        Table("Evidence", ("name", "value", "never known"), [("x", 1, None)], folded=True),
        Table("Sources", ("of", "source"), [("y", source)]),
    ]
    another = replace(EMPTY, name="another", caption="Another.")
    html = written(Page("x", "", tables=tables, pictures=[EMPTY, another]), tmp_path)
    order = ("A picture.", "<h2>Sources", "Another.", "<summary><h2>Evidence")
    places = [html.index(text) for text in order]
    assert places == sorted(places)
    assert "never known" not in html
    assert source in html and f"<td>{source}" not in html and '<details class="long">' in html


def test_what_several_blocks_remark_is_said_once_and_as_grave_as_it_is():
    profile = catalogue_profile("gelsight_mini")
    remarks = ("warning: the light drifts", "info: as always")
    for block in (profile.camera, profile.material):
        where = block.provenance.model_copy(update={"remarks": remarks})
        profile = profile.with_block(block.replace(provenance=where))
    said = {r.message: r.severity for r in profile_page(profile).remarks}
    assert said["material, camera: the light drifts"] == Severity.WARNING
    assert said["material, camera: as always"] == Severity.INFO


def test_a_depth_curve_is_drawn(tmp_path):
    provenance = Provenance(kind="measured", method="m", source="s", spread={"depth_mm": 0.05})
    block = DepthResponseBlock(drop_levels=(0.0, 40.0), depth_mm=(0.0, 1.2), provenance=provenance)
    written(profile_page(tiny_profile(GRID).with_block(block)), tmp_path)
    assert (tmp_path / "out" / "depth_response.png").stat().st_size > 5000


HERE = PageOptions(port=0, browser=False)
TOKEN = f"/{run_token()}"
FOREIGN = "https://elsewhere.example"


@pytest.fixture(scope="module")
def port():
    """Port of a page that is served as by default."""
    with live_page("A page", HERE) as server:
        yield server.get_port()


def status(port: int, path: str, **headers: str) -> int:
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


UPGRADE = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13",
           "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="}  # fmt: skip
OURS = "127.0.0.1:{port}"
REQUESTS = {
    "the page itself": (TOKEN + "/", OURS, None, True),
    "its WebSocket": (TOKEN, OURS, f"http://{OURS}", True),
    "a query": (TOKEN + "/?darkMode", "localhost:{port}", None, True),
    "a forwarded port": (TOKEN, "LocalHost:9", "http://localhost:9", True),
    "the machine by its number": (TOKEN, "[::1]:{port}", None, True),
    "the machine by its name": (TOKEN, socket.gethostname(), None, True),
    "a proxy with TLS": (TOKEN, "localhost", "https://localhost", True),
    "no token": ("/", OURS, None, False),
    "another token": ("/" + "x" * 22, OURS, None, False),
    "a token cut short": (TOKEN[:-1], OURS, None, False),
    "a token in the query": (f"/?{run_token()}", OURS, None, False),
    "another website": (TOKEN, OURS, FOREIGN, False),
    "another port": (TOKEN, OURS, "http://127.0.0.1:1", False),
    "a file's page": (TOKEN, OURS, "null", False),
    "an empty origin": (TOKEN, OURS, "", False),
    "a rebound name": (TOKEN, "elsewhere.example:{port}", None, False),
    "a rebound name of its own": (TOKEN, "elsewhere.example", "http://elsewhere.example", False),
    "a name that begins like ours": (TOKEN, "localhost.elsewhere.example", None, False),
    "a number in a name": (TOKEN, "127.0.0.1.elsewhere.example", None, False),
    "a user's name": (TOKEN, "elsewhere.example@127.0.0.1", None, False),
    "no host": (TOKEN, None, None, False),
}


@pytest.mark.parametrize("case", REQUESTS)
def test_pages_answer_their_own_requests_alone(case, port):
    path, host, origin, own = REQUESTS[case]
    given = {"Host": host, "Origin": origin}
    headers = {name: value.format(port=port) for name, value in given.items() if value is not None}
    assert status(port, path, **headers) == (200 if own else 403)
    assert status(port, path, **UPGRADE, **headers) == (101 if own else 403)


def test_two_origins_or_hosts_are_none(port):
    for name, value in (("Origin", f"http://127.0.0.1:{port}"), ("Host", f"127.0.0.1:{port}")):
        with socket.create_connection(("127.0.0.1", port), timeout=10) as asked:
            lines = [f"GET {TOKEN} HTTP/1.1", *[f"{name}: {value}"] * 2]
            lines += [f"Host: 127.0.0.1:{port}"] * (name != "Host")
            asked.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
            assert b" 403 " in asked.recv(100)


def test_what_a_foreign_page_sends_is_not_done(port):
    """Such as "Undo last" of a recording: a message on a WebSocket of its own."""
    options: dict[str, Any] = {"subprotocols": [f"viser-v{viser.__version__}"]}
    address = f"ws://127.0.0.1:{port}{TOKEN}"
    with client.connect(address, origin=f"http://127.0.0.1:{port}", **options) as own:
        assert own.recv(timeout=10)
    for path, origin in ((address, FOREIGN), (f"ws://127.0.0.1:{port}", FOREIGN)):
        with pytest.raises(Exception, match="403"):
            client.connect(path, origin=origin, **options)


@pytest.mark.thorough
def test_a_page_of_another_origin_is_refused_by_the_browsers_own_socket(port):
    script = """address => new Promise(done => {
        const socket = new WebSocket(address);
        socket.onopen = () => done("open"); socket.onerror = () => done("refused");
    })"""
    with chromium_page("data:text/html,elsewhere") as page:
        # Even where the address has leaked.
        assert page.evaluate(script, f"ws://127.0.0.1:{port}{TOKEN}") == "refused"


@pytest.mark.parametrize(("host", "reached"), [(None, False), ("0.0.0.0", True)])
def test_pages_listen_on_this_machine_alone_unless_asked(host, reached):
    options = HERE if host is None else PageOptions(host=host, port=0, browser=False)
    with live_page("A page", options) as server:
        assert page_address(server) == f"http://127.0.0.1:{server.get_port()}{TOKEN}/"
        # All of 127.0.0.0/8 is this machine, but only what listens at every address answers there.
        with socket.socket() as other:
            other.settimeout(10)
            assert (other.connect_ex(("127.0.0.2", server.get_port())) == 0) is reached
        if reached:
            for path, answer in ((TOKEN, 200), ("/", 403)):
                host = f"192.0.2.7:{server.get_port()}"
                assert status(server.get_port(), path, Host=host) == answer


@pytest.mark.parametrize("encoding", ["gzip", "identity"])
def test_the_browsers_tab_bears_the_pages_title(encoding):
    with live_page("Press: <mini> & co", HERE) as server:
        asked = http.client.HTTPConnection("127.0.0.1", server.get_port(), timeout=10)
        asked.request("GET", f"{TOKEN}/", headers={"Accept-Encoding": encoding})
        answer = asked.getresponse()
        body = answer.read()
        asked.close()
    assert answer.headers.get_all("Content-Length") == [str(len(body))]
    text = (gzip.decompress(body) if encoding == "gzip" else body).decode()
    (title,) = re.findall("<title>(.*?)</title>", text)
    assert "<" not in title and html.unescape(title) == "Press: <mini> & co"


def test_a_name_that_was_asked_for_is_ours():
    asked = Headers(Host="sensors.example:8080", Origin="http://sensors.example:8080")
    assert is_own_request(TOKEN, asked, "sensors.example")
    assert not is_own_request(TOKEN, asked, "127.0.0.1")


def test_a_server_that_nobody_guards_is_stopped():
    unknown = Mock()  # As if viser listened by other means.
    with pytest.raises(RuntimeError, match="pages would be open"):
        start_guarded(lambda: unknown, "A page")
    unknown.stop.assert_called_once()


def test_pages_of_several_threads_are_all_guarded():
    """Each once: guarded twice, a page would answer nobody."""
    found = []

    def serve():
        with live_page("A page", HERE) as server:
            asked = partial(status, server.get_port(), TOKEN, Host="127.0.0.1")
            found.append((asked(), asked(Origin=FOREIGN)))

    threads = [threading.Thread(target=serve) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert found == [(200, 403)] * 3


MARKDOWN = MarkdownIt("commonmark", {"html": True}).enable(["table", "strikethrough"])
HOSTILE = (
    "<img src=x onerror=alert(1)>", "<script>alert(1)</script>", "</td></table><svg onload=a>",
    "[x](javascript:alert(1))", "![x](http://elsewhere.example/x.png)", "{alert(1)}", "&lt;b&gt;",
    "<!-- begin x", "**x**", "__x__", "~~x~~", "`x`", "a | b", "\\<b>", "# x", "## x", "- x", "+ x",
    "1. x", "10) x", "---", "===", "> x", "    x", "  - x", "```\n<b>\n```", "a\n\n<b>", "a\n- b",
    "[x]: http://elsewhere.example", "<https://elsewhere.example>", "' onmouseover='alert(1)",
    '" onmouseover="alert(1)', "\u202e<b>", "\0<b>", "\udcff<b>", "a\r<b>", "-1.5", "*", "_",
)  # fmt: skip


class Shown(HTMLParser):
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
def test_a_text_shows_itself_and_is_no_markup(text):
    escaped = PageText("{}").format(text)
    # Alone, in a paragraph, in a list, in a table, and as HTML inside an attribute and outside.
    for source, tags in (
        (escaped, []),
        (PageText("a\n\n") + text, []),
        (PageText("- a\n- {}").format(text), ["ul", "li", "li"]),
    ):
        page = Shown(MARKDOWN.render(source))
        assert [tag for tag in page.tags if tag != "p"] == tags
        assert bare(page.text) in (bare(text), bare("a " + text))
    table = Shown(MARKDOWN.render(page_table([(text, "b")], ("a", text))))
    assert table.tags == "table thead tr th th tbody tr td td".split()
    assert bare(table.text).replace(" ", "") == bare(f"a{text}{text}b").replace(" ", "")
    as_html = Shown(f'<i title="{escaped}">{escaped}</i>')
    assert as_html.tags == ["i", "title"] and bare(as_html.text) == bare(text)


def test_what_is_ours_stays_markup_and_figures_stay_figures():
    bold = PageText("**{}**, {:.2f} N").format(PageText("<b>x</b>"), -1.5)
    assert bold == "**<b>x</b>**, -1.50 N"
    assert PageText("{}").format("force 1.5 ± 0.2 N (12 %)") == "force 1.5 ± 0.2 N (12 %)"
    assert PageText(" and ").join(["a*", PageText("*b*")]) == "a&#42; and *b*"
    assert PageText("a ") + "<b>" == "a &lt;b&gt;"


@pytest.mark.parametrize("text", ["<img src=x onerror='alert(1)'>", "![x](/etc/hostname)"])
def test_notes_escape_what_is_not_said_to_be_markup(text):
    """The default is the safe one: nobody has to think of it."""
    gui = SimpleNamespace(
        add_markdown=lambda content: SimpleNamespace(content=content, visible=True),
        add_html=lambda content, visible: SimpleNamespace(content=content, visible=visible),
    )
    for note in (add_note(gui, text), add_html_note(gui, text)):
        shown = note.content
        assert "<" not in shown and "[" not in shown and type(note._handle.content) is str
        note.content = "**"
        note.content += PageText("*") + text
        assert note.content == PageText("&#42;&#42;*") + text
