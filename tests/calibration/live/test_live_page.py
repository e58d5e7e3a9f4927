# SPDX-License-Identifier: Apache-2.0
"""The live page in a browser: pictures follow the gel, figures and times are told, it ends."""

from __future__ import annotations

import re
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.calibration.depth.fit import fit_depth
from taccel_lab.calibration.depth.options import DepthOptions
from taccel_lab.calibration.live.page import LivePage
from taccel_lab.calibration.live.reader import LiveReader
from taccel_lab.calibration.live.run import LiveResult, run_live
from taccel_lab.report.live_page import PageOptions, live_page, page_address
from tests.calibration.depth.test_depth import BALL_MM, CIRCLES, GRID, captures_of
from tests.calibration.record.sessions import SteeredCamera
from tests.support.synthetic_presses import flat_profile
from tests.viewer.browser import chromium_page, picture, wait_for

SLOW_MS = 60_000


def yellow_share(page: Any) -> float:
    """Share of the pictures that is as yellow as the deepest places of a depth map."""
    seen = picture(page)[:, :950].astype(int)
    return float(((seen[..., :2].min(axis=-1) > 170) & (seen[..., 2] < 110)).mean())


def test_depth_force_and_latency_follow_the_gel_until_it_is_stopped(tmp_path: Path) -> None:
    pytest.importorskip("viser", reason="the extra view is not installed")
    captures = captures_of(CIRCLES, noise=1.0)
    captures = replace(captures, background=captures.background.astype(np.uint8))
    profile = fit_depth(captures, DepthOptions(zero="rim")).apply_to(flat_profile(GRID))
    rest, pressed = np.asarray(captures.background), captures.presses[2].image()
    pressed = np.clip(np.rint(pressed), 0, 255).astype(np.uint8)
    camera = SteeredCamera(tmp_path, rest, noise=0.5)
    results: list[LiveResult] = []

    def force(image: np.ndarray, background: np.ndarray) -> dict[str, float]:
        drop = float((background.astype(float) - image).mean())
        return {"Fz [N]": drop, "Fz +- [N]": 0.25}

    def run(page_of: LivePage) -> None:
        reader = lambda untouched: LiveReader(profile, untouched, detail=1, force=force)  # noqa: E731
        results.append(run_live(reader, lambda: camera, [page_of]))

    with live_page("Live", PageOptions(port=0, browser=False)) as server:
        session = threading.Thread(target=run, args=[LivePage(server, 15.0)], daemon=True)
        with chromium_page(page_address(server), (1360, 800)) as page:

            def heading() -> float:
                found = re.match(r"(\d\.\d+) ± \d\.\d+ mm deep", page.locator("h2").inner_text())
                return float(found[1]) if found else float("nan")

            def told_force() -> float:
                return float(page.locator("p:has-text('Fz:') strong").inner_text().split()[0])

            page.wait_for_selector("text=Stop", timeout=SLOW_MS)
            camera.time_stands = True
            session.start()
            page.wait_for_selector("text=Touch nothing", timeout=SLOW_MS)
            camera.time_stands = False
            page.wait_for_selector("text=mm deep", timeout=SLOW_MS)
            wait_for(page, lambda: page.get_by_text("Touch nothing").count() == 0)
            wait_for(page, lambda: heading() < 0.1, 60)
            untouched = yellow_share(page)
            camera.image = pressed
            rim = CIRCLES[2].radius_px * GRID.mm_per_px_x
            deepest = BALL_MM - np.sqrt(BALL_MM**2 - rim**2)
            wait_for(page, lambda: abs(heading() - deepest) < 0.15, 60)
            wait_for(page, lambda: yellow_share(page) > untouched + 0.002, 60)
            wait_for(page, lambda: told_force() > 2, 60)
            page.get_by_text("± 0.25").wait_for(timeout=SLOW_MS)
            rate = re.compile(r"(?!0\.0 )\d+\.\d frames a second")
            wait_for(page, lambda: rate.search(page.inner_text("body")))
            page.get_by_text("by the contact of an elastic layer").wait_for(timeout=SLOW_MS)
            assert page.locator(".uplot canvas").count() == 3
            for stage in ("all work", "depth", "pressure", "force", "taken to shown"):
                told = re.compile(rf"^{stage}\s*\d")  # Not the legends of the curves.
                row = page.get_by_role("row").filter(has_text=told)
                assert float(row.get_by_role("cell").nth(1).inner_text()) > 0
            # A new untouched gel, of the ball as it lies: nothing is pressed in then.
            camera.time_stands = True
            page.get_by_text("Take the untouched gel again").click()
            page.wait_for_selector("text=Touch nothing", timeout=SLOW_MS)
            camera.time_stands = False
            wait_for(page, lambda: heading() < 0.1, 60)
            page.get_by_text("Stop", exact=True).click()
            session.join(timeout=60)
            assert not session.is_alive()
    assert results[0].last is not None and results[0].latency.figures()["frames"] > 5
