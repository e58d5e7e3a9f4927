# SPDX-License-Identifier: Apache-2.0
"""Text of profiles, presses, recordings, studies and data sets is shown in Chromium, never run."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.profile import save_profile
from taccel_lab.report.live_page import PageOptions, live_page, page_address
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.studies.design_row import DesignRow
from taccel_lab.studies.study_folder import StudyFolder
from taccel_lab.viewer.pages import source_page
from taccel_lab.viewer.sources import find_source
from tests.viewer.browser import chromium_page, wait_for
from tests.viewer.test_damaged_sources import (
    ABOUT,
    REPLAYED,
    press_arrays,
    sound_replay,
    write_press,
)

pytest.importorskip("viser", reason="the extra view is not installed")
HERE = PageOptions(port=0, browser=False)
ELSEWHERE = "http://0.0.0.0:1"
ATTACK = (
    "<img src='//0.0.0.0:1/a' onerror='hacked=1' class='f'><b onclick='hacked=2' class='f'>x</b>"
    "[x](javascript:hacked=3)|![x](http://0.0.0.0:1/b'<iframe srcdoc='<script>top.hacked=4"
    "</script>'>www.a/'<b"
)
"""At most 200 characters, as names of profiles."""


def hostile_profile(folder: Path) -> None:
    profile = catalogue_profile("flat_pad")
    named = profile.sensor.model_copy(update={"name": ATTACK, "family": ATTACK})
    save_profile(profile.with_block(named), folder)


def hostile_press(folder: Path) -> None:
    write_press(folder, press_arrays(), {**ABOUT, "sensor": ATTACK, "indenter": ATTACK})


def hostile_replay(folder: Path) -> None:
    np.savez(folder / "replay.npz", **sound_replay())
    about = {**REPLAYED, "task": ATTACK, "forces": [ATTACK]}
    (folder / "replay.json").write_text(json.dumps(about))


def hostile_study(folder: Path) -> None:
    StudyFolder(folder).add_row(
        DesignRow(id="one", family="flat_pad", parameters={}, status="done", figures={ATTACK: 1.0})
    )


def hostile_dataset(folder: Path) -> None:
    from tests.support.small_data_sets import make, saved_profile

    profile = saved_profile(folder.with_name("profile"))
    make(profile, folder, dataset={"episodes": 2}, output={"channels": ["depth_mm"]})
    about = json.loads((folder / "dataset.json").read_text())
    (folder / "dataset.json").write_text(json.dumps({**about, "name": ATTACK}))


def seen(page: Any) -> int:
    """How often the attack can be read on the page, letter by letter."""
    return page.locator("body").inner_text().count(ATTACK)


def assert_inert(page: Any, asked: list[str]) -> None:
    """The attack stands on the page as it is written, and nothing came of it."""
    wait_for(page, lambda: seen(page) > 0)
    page.wait_for_timeout(300)
    assert page.evaluate("window.hacked") is None
    assert page.locator(".f").count() == 0 == page.locator("iframe").count()
    assert [one for one in asked if one.startswith(ELSEWHERE)] == []


@pytest.mark.parametrize(
    "write",
    [
        hostile_profile,
        hostile_press,
        hostile_replay,
        hostile_study,
        pytest.param(hostile_dataset, marks=pytest.mark.slow),
    ],
)
def test_texts_of_sources_are_shown_as_they_are_written(
    write: Callable[[Path], None], tmp_path: Path
) -> None:
    folder = tmp_path / "source"
    folder.mkdir()
    write(folder)
    asked: list[str] = []
    # Without the second line, which forbids the browser scripts and what lies elsewhere.
    with (
        source_page(find_source(str(folder)), HERE) as server,
        chromium_page("about:blank", bypass_csp=True) as page,
    ):
        page.on("request", lambda request: asked.append(request.url))
        page.goto(page_address(server))
        assert_inert(page, asked)


def test_texts_of_sessions_and_designs_are_shown_as_they_are_written(tmp_path: Path) -> None:
    from types import SimpleNamespace

    from taccel_lab.calibration.live.page import LivePage
    from taccel_lab.calibration.record.lamps import Lamp
    from taccel_lab.calibration.record.page import RecordPage
    from taccel_lab.sensors.registry import sensor_family
    from taccel_lab.viewer.design_controls import DesignControls

    status: Any = SimpleNamespace(
        image=None, taken=0, wanted=5, prompt=ATTACK, messages=(ATTACK,), finished=True,
        lamps=(Lamp(ATTACK, "bad", ATTACK),), circles=(), advice=None,
    )  # fmt: skip
    asked: list[str] = []
    with (
        live_page(ATTACK, HERE) as server,
        chromium_page("about:blank", bypass_csp=True) as page,
    ):
        page.on("request", lambda request: asked.append(request.url))
        page.goto(page_address(server))
        record = RecordPage(server)
        record._taken = hash((status.circles, status.advice, status.finished))
        record.show(status)
        LivePage(server, 10.0).tell(ATTACK)
        controls = DesignControls(server, sensor_family("flat_pad"), {}, lambda _: None)
        controls.refuse(f"thickness_mm: {ATTACK}", "")
        times = 1 + 1 + 2 + 1 + 1 + 1  # Title, prompt, lamp, message, live, refusal.
        wait_for(page, lambda: seen(page) >= times)
        assert_inert(page, asked)


def test_the_browser_itself_refuses_scripts_and_what_lies_elsewhere() -> None:
    """The second line, where markup would get into a page after all."""
    with live_page("A page", HERE) as server, chromium_page(page_address(server)) as page:
        refused: list[str] = []
        page.on("console", lambda message: refused.append(message.text))
        server.gui.add_html(ATTACK.partition("<iframe")[0])
        page.locator("b.f").click()
        wait_for(page, lambda: any("Loading the image" in text for text in refused))
        wait_for(page, lambda: any("inline event handler" in text for text in refused))
        assert page.evaluate("window.hacked") is None
