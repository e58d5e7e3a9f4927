# SPDX-License-Identifier: Apache-2.0
"""The page in a browser: it shows the change, takes when asked to, and ends."""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.capture import load_capture_folder
from taccel_lab.calibration.capture.camera import Replay
from taccel_lab.calibration.capture.camera.replay import ReplayCamera
from taccel_lab.calibration.record.facts import QUICK_LEAVES_OUT
from taccel_lab.calibration.record.folder import open_record
from taccel_lab.calibration.record.page import RecordPage
from taccel_lab.calibration.record.run import run_session
from taccel_lab.calibration.record.session import Recorder
from taccel_lab.calibration.record.tiles import tiled
from taccel_lab.report.live_page import PageOptions, live_page, page_address
from tests.calibration.record.sessions import FACTS, source

SOFTWARE_GL = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]


def colourful_share(screenshot: bytes) -> float:
    """Share of the large picture's pixels that are far from grey."""
    image = cv2.imdecode(np.frombuffer(screenshot, np.uint8), cv2.IMREAD_COLOR).astype(float)
    return float((np.ptp(image[:, :950], axis=-1) > 60).mean())


class SteeredCamera(ReplayCamera):
    """An untouched gel until it is pressed."""

    def __init__(self, path: Path) -> None:
        self.press = threading.Event()
        folder = load_capture_folder(path)
        assert folder.background is not None
        rest, pressed = folder.background.image(), folder.presses[0].image()

        def frames() -> Iterator[np.ndarray]:
            while True:
                yield pressed if self.press.is_set() else rest

        super().__init__(path, frames, Replay(paced=True))


def test_the_page_shows_the_change_and_its_buttons_work(tmp_path: Path) -> None:
    playwright = pytest.importorskip("playwright.sync_api")
    pytest.importorskip("viser")
    chromium = shutil.which("chromium")
    if chromium is None:
        pytest.skip("no Chromium: tools/system_libraries.sh says how to get one")
    path = source(tmp_path / "set", 1)
    # A press that is there for a long while, and is not steady for long enough to be taken. The
    # browser says when it comes: a busy machine may take seconds to show what was asked for.
    camera = SteeredCamera(path)
    with (
        open_record(tmp_path / "out", FACTS) as folder,
        live_page("Recording", PageOptions(port=0, browser=False)) as server,
    ):
        page, recorder = RecordPage(server, quick=True), Recorder(folder, FACTS, 5)
        recorder.trigger.hold_s = 1000.0
        session = threading.Thread(
            target=run_session, args=(recorder, lambda: camera, [page]), daemon=True
        )
        with playwright.sync_playwright() as tools:
            browser = tools.chromium.launch(executable_path=chromium, args=SOFTWARE_GL)
            view = browser.new_page(viewport={"width": 1360, "height": 800})
            view.goto(page_address(server))
            view.wait_for_selector("text=Take now", timeout=60_000)
            session.start()
            view.wait_for_selector("text=Press next", timeout=60_000)
            untouched = colourful_share(view.screenshot())
            camera.press.set()
            view.wait_for_selector("text=Hold still", timeout=60_000)
            time.sleep(1.0)
            assert colourful_share(view.screenshot()) > untouched + 0.01
            view.click("text=Take now")
            view.wait_for_selector("text=took press_000.png", timeout=60_000)
            view.wait_for_selector("text=1 of 5", timeout=60_000)
            assert view.locator("text=saturation").count() >= 1
            assert view.locator("text=What a quick session leaves out").count() == 1
            view.click("text=Undo last")
            view.wait_for_selector("text=took press_000.png out", timeout=60_000)
            view.click("text=Take now")
            view.wait_for_selector("text=1 of 5", timeout=60_000)
            view.click("text=Finish")
            view.wait_for_selector("text=Finished", timeout=60_000)
            browser.close()
        session.join(timeout=30)
        assert not session.is_alive()
    assert len(load_capture_folder(tmp_path / "out").presses) == 1


def test_what_is_left_out_names_scale_and_force() -> None:
    begins = [line.split(":")[0] for line in QUICK_LEAVES_OUT]
    assert {"scale", "force", "lens", "presses"} <= set(begins)


@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.5])
def test_tiles_show_every_picture_whole(aspect: float) -> None:
    colors = ((250, 0, 0), (0, 250, 0), (0, 0, 250))
    shapes = ((240, 320, 3), (320, 240, 3), (100, 100, 3))
    pictures = [
        (str(k), np.full(shape, color, np.uint8))
        for k, (shape, color) in enumerate(zip(shapes, colors, strict=True))
    ]
    sheet = tiled(pictures, aspect, 600)
    assert sheet.shape[1] == 600 and sheet.shape[0] == pytest.approx(600 / aspect, abs=1)
    for shape, color in zip(shapes, colors, strict=True):
        rows, columns = np.nonzero((sheet == color).all(axis=-1))
        wide, high = np.ptp(columns) + 1, np.ptp(rows) + 1
        assert wide / high == pytest.approx(shape[1] / shape[0], rel=0.03) and wide > 60
        assert len(rows) == wide * high
