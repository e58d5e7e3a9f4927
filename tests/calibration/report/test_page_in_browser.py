# SPDX-License-Identifier: Apache-2.0
"""A profile's page as a browser shows and prints it: nothing runs over, dark is dark, pictures
open, few sheets."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from taccel_lab.calibration.report import write_page
from taccel_lab.calibration.report.profile_page import profile_page
from taccel_lab.sensors.profile import catalogue_profile
from tests.viewer.browser import chromium_page

WIDER = """() => [document.documentElement, ...document.querySelectorAll('.scroll, section, main')]
  .filter(e => e.scrollWidth > e.clientWidth + 1).map(e => e.className + ' ' + e.scrollWidth)"""
GROUND = "() => getComputedStyle(document.body).backgroundColor"
MOST_SHEETS = 5
"""Of a page with 14 blocks, whose tables took 23 sheets when all of them lay open."""


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> str:
    out = tmp_path_factory.mktemp("page") / "out"
    write_page(profile_page(catalogue_profile("gelsight_mini")), out)
    return (Path(out) / "report.html").as_uri()


def levels(color: str) -> list[int]:
    return [int(part) for part in re.findall(r"\d+", color)[:3]]


def test_nothing_runs_over_on_screen_nor_in_print(address: str) -> None:
    with chromium_page(address, (1280, 900)) as page:
        assert page.evaluate(WIDER) == []
        for details in page.query_selector_all("details"):
            details.evaluate("e => e.open = true")
        assert page.evaluate(WIDER) == []
        page.emulate_media(media="print")
        page.set_viewport_size({"width": 690, "height": 1000})
        assert page.evaluate(WIDER) == []


def test_it_prints_on_few_sheets(address: str) -> None:
    with chromium_page(address) as page:
        sheets = len(re.findall(rb"/Type\s*/Page[^s]", page.pdf(format="A4")))
        assert 1 < sheets <= MOST_SHEETS


def test_dark_is_dark_and_prints_light(address: str) -> None:
    with chromium_page(address) as page:
        assert min(levels(page.evaluate(GROUND))) > 200
        page.emulate_media(color_scheme="dark")
        assert max(levels(page.evaluate(GROUND))) < 60
        ink = page.evaluate("() => getComputedStyle(document.querySelector('td')).color")
        assert min(levels(ink)) > 180
        page.emulate_media(color_scheme="dark", media="print")
        assert min(levels(page.evaluate(GROUND))) > 200


def test_a_click_opens_a_picture_and_another_closes_it(address: str) -> None:
    def width(page: Any) -> float:
        return page.query_selector("figure img").bounding_box()["width"]

    with chromium_page(address, (1280, 900)) as page:
        small = width(page)
        page.click("figure .zoom")
        assert width(page) >= 1240 > small
        page.click("figure .zoom", position={"x": 300, "y": 300})
        assert width(page) == small
