# SPDX-License-Identifier: Apache-2.0
"""A profile's page as a browser shows and prints it: nothing runs over, dark is dark, pictures
open, few sheets."""

from __future__ import annotations

import base64
import io
import re
from typing import Any

import numpy as np
import pytest
from PIL import Image

from taccel_lab.calibration.profile_page import profile_page
from taccel_lab.report.page import write_page
from taccel_lab.sensors.profile import catalogue_profile
from tests.viewer.browser import chromium_page, picture, shared_browser, wait_for  # noqa: F401

pytestmark = [pytest.mark.rasterised, pytest.mark.usefixtures("shared_browser")]

WIDER = """() => [document.documentElement, ...document.querySelectorAll('.scroll, section, main')]
  .filter(e => e.scrollWidth > e.clientWidth + 1).map(e => e.className + ' ' + e.scrollWidth)"""
GROUND = "() => getComputedStyle(document.body).backgroundColor"
SMALL = (640, 600)
"""Of pages whose gel is drawn again and again, without a GPU [px]."""
MOST_SHEETS = 5
"""Of a page with 14 blocks, whose tables took 23 sheets when all of them lay open."""


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    out = tmp_path_factory.mktemp("page") / "out"
    write_page(profile_page(catalogue_profile("gelsight_mini")), out)
    return (out / "report.html").as_uri()


def levels(color: str) -> list[int]:
    return [int(part) for part in re.findall(r"\d+", color)[:3]]


def canvas_pixels(page: Any) -> np.ndarray:
    """The drawn mesh, int [height, width, 4]."""
    text = page.evaluate("() => document.querySelector('canvas').toDataURL()")
    with Image.open(io.BytesIO(base64.b64decode(text.split(",")[1]))) as file:
        return np.asarray(file.convert("RGBA")).astype(int)


def canvas_of(page: Any) -> Any:
    """The mesh, once it is drawn."""
    canvas = page.query_selector(".mesh-view canvas")
    canvas.scroll_into_view_if_needed()
    wait_for(page, lambda: (canvas_pixels(page)[..., 3] > 0).mean() > 0.1)
    return canvas


@pytest.mark.thorough
def test_nothing_runs_over_and_blocks_open_with_a_click(address):
    closed = "() => document.querySelectorAll('details:not([open])').length"
    with chromium_page(address, (1280, 900)) as page:
        assert page.evaluate(WIDER) == []
        sheets = len(re.findall(rb"/Type\s*/Page[^s]", page.pdf(format="A4")))
        assert 1 < sheets <= MOST_SHEETS
        # Every block opens with one click, and folds again with another.
        count = page.evaluate(closed)
        assert count > 0
        for left in (0, count):
            page.click(".open-all")
            assert page.evaluate(closed) == left


def test_text_of_tables_is_readable_on_a_phone(address):
    widths = """() => [...document.querySelectorAll('.wrapped td:not(.short)')]
      .filter(e => e.innerText.length > 20).map(e => e.clientWidth)"""
    with chromium_page(address, (390, 844)) as page:
        found = page.evaluate(widths)
        assert found and min(found) > 200
        assert page.evaluate("() => document.documentElement.scrollWidth") <= 390


def test_dark_is_dark_and_prints_light(address):
    with chromium_page(address) as page:
        assert min(levels(page.evaluate(GROUND))) > 200
        page.emulate_media(color_scheme="dark")
        assert max(levels(page.evaluate(GROUND))) < 60
        ink = page.evaluate("() => getComputedStyle(document.querySelector('td')).color")
        assert min(levels(ink)) > 180
        page.emulate_media(color_scheme="dark", media="print")
        assert min(levels(page.evaluate(GROUND))) > 200


def test_a_click_opens_a_picture_and_another_closes_it(address):
    def width(page):
        return page.query_selector("figure img").bounding_box()["width"]

    with chromium_page(address, (1280, 900)) as page:
        # As without scripts: the mesh's still picture is the only one of this page.
        page.evaluate("document.querySelector('.has-view').classList.remove('has-view')")
        small = width(page)
        page.click("figure .zoom")
        assert width(page) >= 1240 > small
        page.click("figure .zoom", position={"x": 300, "y": 300})
        assert width(page) == small


def test_the_gel_turns_under_mouse_and_keys_and_prints_still(address):
    with chromium_page(address, SMALL) as page:
        canvas = canvas_of(page)
        box = canvas.bounding_box()
        left, top, right, bottom = (
            round(v)
            for v in (box["x"], box["y"], box["x"] + box["width"], box["y"] + box["height"])
        )
        seen = picture(page)[top:bottom, left:right].astype(int)
        drawn = np.abs(seen - seen[0, 0]).max(axis=2) > 20
        assert 0.1 < drawn.mean() < 0.9
        first = canvas_pixels(page)
        views = [first]

        def is_drawn(view):
            # Rounding of edges aside: Chromium draws a canvas that was read in another way.
            return bool((np.abs(canvas_pixels(page) - view) > 16).mean() <= 1e-3)

        def wait_for_another():
            """Until the picture is none of those before."""
            wait_for(page, lambda: not any(is_drawn(view) for view in views))
            views.append(canvas_pixels(page))

        page.mouse.move(left + 200, top + 150)
        page.wait_for_timeout(200)
        assert is_drawn(first)
        page.mouse.down()
        page.mouse.move(left + 300, top + 180)
        page.mouse.up()
        wait_for_another()
        page.keyboard.down("Control")
        page.mouse.wheel(0, -200)
        page.keyboard.up("Control")
        wait_for_another()
        canvas.focus()
        page.keyboard.press("ArrowLeft")
        wait_for_another()
        page.keyboard.press("0")
        wait_for(page, lambda: is_drawn(first))
        assert not page.is_visible(".still")
        page.emulate_media(media="print")
        assert page.is_visible(".still") and not page.is_visible(".mesh-view")


@pytest.mark.thorough
def test_the_bare_wheel_scrolls_the_page_and_says_what_zooms(address):
    with chromium_page(address, SMALL) as page:
        box = canvas_of(page).bounding_box()
        page.mouse.move(box["x"] + 200, box["y"] + 150)
        # Also after a click into it: whoever turned the gel scrolls on.
        page.mouse.down()
        page.mouse.up()
        before, seen = page.evaluate("scrollY"), canvas_pixels(page)
        assert not page.is_visible(".mesh-view .hint")

        def turned_wheel_says():
            # Once more where a busy machine has let the words pass.
            page.mouse.wheel(0, 60)
            return page.is_visible(".mesh-view .hint:has-text('Ctrl')")

        wait_for(page, turned_wheel_says)
        wait_for(page, lambda: page.evaluate("scrollY") > before)
        assert (np.abs(canvas_pixels(page) - seen) > 16).mean() < 1e-3
        page.wait_for_selector(".mesh-view .hint", state="hidden")


@pytest.mark.thorough
def test_fingers_scroll_the_page_turn_and_zoom(address):
    with chromium_page(address, (400, 700), has_touch=True) as page:
        canvas = canvas_of(page)
        touch = page.context.new_cdp_session(page)
        box = canvas.bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

        def move(*paths):
            """Fingers from points to points, about the canvas' middle."""
            for step in range(4):
                points = [
                    {"x": x + a[0] + step / 3 * (b[0] - a[0]),
                     "y": y + a[1] + step / 3 * (b[1] - a[1]), "id": k}
                    for k, (a, b) in enumerate(paths)
                ]  # fmt: skip
                kind = "touchMove" if step else "touchStart"
                touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
                page.wait_for_timeout(16)
            touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})

        def changed(seen):
            return bool((np.abs(canvas_pixels(page) - seen) > 16).mean() > 1e-3)

        seen, at = canvas_pixels(page), page.evaluate("scrollY")
        move(((-60, 0), (60, 0)))
        wait_for(page, lambda: changed(seen))
        assert page.evaluate("scrollY") == at
        seen = canvas_pixels(page)
        move(((-30, 0), (-90, 0)), ((30, 0), (90, 0)))
        wait_for(page, lambda: changed(seen))
        assert page.evaluate("scrollY") == at
        move(((0, 60), (0, -100)))
        wait_for(page, lambda: page.evaluate("scrollY") > at)
