# SPDX-License-Identifier: Apache-2.0
"""Headless Chromium with WebGL in software, and what its pictures show."""

from __future__ import annotations

import io
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

import numpy as np
import pytest

ARGUMENTS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader",
             "--enable-unsafe-swiftshader")  # fmt: skip


_running: list[Any] = []
"""The browser that the tests of a module share."""


@pytest.fixture(scope="module")
def shared_browser():
    """One browser for all pages of a module: starting one takes longer than most pages."""
    with _chromium() as browser:
        _running.append(browser)
        yield
        _running.remove(browser)


@contextmanager
def chromium_page(
    address: str, size: tuple[int, int] = (1100, 640), **options: Any
) -> Iterator[Any]:
    """The page at an address, in a browser of its own unless the module shares one; skips the test
    where there is no Chromium or no playwright.

    ``options``: of playwright's ``new_page``.
    """
    with nullcontext(_running[0]) if _running else _chromium() as browser:
        page = browser.new_page(viewport={"width": size[0], "height": size[1]}, **options)
        try:
            # Software draws slowly where other tests share the cores.
            page.set_default_timeout(120_000)
            page.goto(address)
            yield page
        finally:
            page.close()


@contextmanager
def _chromium() -> Iterator[Any]:
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        pytest.skip("no Chromium on this machine")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=list(ARGUMENTS))
        try:
            yield browser
        finally:
            browser.close()


def picture(page: Any) -> np.ndarray:
    """A screenshot, uint8 [height, width, 3]."""
    from PIL import Image

    with Image.open(io.BytesIO(page.screenshot())) as file:
        return np.asarray(file.convert("RGB"))


def middle(page: Any) -> np.ndarray:
    """The part of the page between its panels, where the scene is."""
    seen = picture(page)
    height, width = seen.shape[:2]
    return seen[height // 4 : -height // 8, width * 3 // 8 : width * 5 // 8]


def wait_for(page: Any, true: Any, seconds: float = 120.0) -> None:
    """Wait until ``true()`` holds, while the page goes on."""
    limit = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < limit, f"not so after {seconds:g} s"
        page.wait_for_timeout(100)
