# SPDX-License-Identifier: Apache-2.0
"""The page in a browser: it shows the change, takes when asked to, and ends."""

from __future__ import annotations

import io
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.calibration.capture import load_capture_folder
from taccel_lab.calibration.capture.coverage import CELLS, cell_name, cell_of
from taccel_lab.calibration.record.folder import open_record
from taccel_lab.calibration.record.page import LAMP_COLORS, RecordPage
from taccel_lab.calibration.record.pictures import BLUE
from taccel_lab.calibration.record.run import run_session
from taccel_lab.calibration.record.session import Recorder
from taccel_lab.calibration.record.tiles import tiled
from taccel_lab.report.live_page import PageOptions, live_page, page_address
from tests.calibration.record.sessions import FACTS, SteeredCamera, source
from tests.support.capture_sets import spread_circles
from tests.support.synthetic_presses import GRID
from tests.viewer.browser import chromium_page, picture, wait_for

SLOW_MS = 60_000
"""A busy machine may take long to show what was asked for."""


def change_tile(page: Any) -> np.ndarray:
    """The lower of the two pictures, without its edge and title, float [h, w, 3]."""
    seen = picture(page)[428:, :960].astype(float)
    rows, columns = np.nonzero(seen.min(axis=-1) < 190)
    if not len(rows):  # no picture has come yet
        return np.full((1, 1, 3), np.nan)
    return seen[rows.min() + 3 : rows.max() - 3, columns.min() + 3 : columns.max() - 3]


def ring(page: Any) -> tuple[float, float, float] | None:
    """Centre and radius of what is white in the change, in pixels of the camera."""
    tile = change_tile(page)
    v, u = np.nonzero(tile.min(axis=-1) > 190)
    if len(u) < 100:
        return None
    zoom = tile.shape[1] / GRID.width_px
    middle = (u.min() + u.max()) / 2, (v.min() + v.max()) / 2
    return middle[0] / zoom, middle[1] / zoom, (np.ptp(u) + np.ptp(v)) / 4 / zoom


def cells(page: Any) -> np.ndarray:
    """The coverage table, a colour for each cell, float [row, column, 3]."""
    from PIL import Image

    shot = page.locator("img").last.screenshot()
    with Image.open(io.BytesIO(shot)) as file:
        seen = np.asarray(file.convert("RGB")).astype(float)
    high, wide = seen.shape[0] // CELLS[1], seen.shape[1] // CELLS[0]
    blocks = seen[: high * CELLS[1], : wide * CELLS[0]]
    return blocks.reshape(CELLS[1], high, CELLS[0], wide, 3).transpose(0, 2, 1, 3, 4)


def odd_cell(page: Any) -> tuple[int, int]:
    """Column and row of the cell whose colour is farthest from that of most."""
    colors = np.median(cells(page), axis=(2, 3))
    apart = np.abs(colors - np.median(colors.reshape(-1, 3), axis=0)).max(axis=-1)
    row, column = np.unravel_index(apart.argmax(), apart.shape)
    return int(column), int(row)


def framed_cell(page: Any) -> tuple[int, int]:
    """Column and row of the cell with the blue frame."""
    blue = (np.abs(cells(page) - BLUE).max(axis=-1) < 40).sum(axis=(2, 3))
    row, column = np.unravel_index(blue.argmax(), blue.shape)
    return int(column), int(row)


def lamp(page: Any, name: str) -> tuple[str, str]:
    """State and words of a lamp."""
    row = page.locator(f"div:has(> span > b:text-is('{name}'))").last
    style = row.locator("span").first.get_attribute("style")
    state = next(state for state, color in LAMP_COLORS.items() if color in style)
    return state, row.inner_text()


def test_the_page_shows_all_there_is_to_see_and_its_buttons_work(tmp_path: Path) -> None:
    pytest.importorskip("viser", reason="the extra view is not installed")
    # A press that is there for a long while, and is not steady for long enough to be taken.
    path, circle = source(tmp_path / "set", 1), spread_circles(1)[0]
    folder_of = load_capture_folder(path)
    assert folder_of.background is not None
    rest, pressed = folder_of.background.image(), folder_of.presses[0].image()
    camera = SteeredCamera(path, rest)
    with (
        open_record(tmp_path / "out", FACTS) as folder,
        live_page("Recording", PageOptions(port=0, browser=False)) as server,
    ):
        page_of, recorder = RecordPage(server, quick=True), Recorder(folder, FACTS, 5)
        recorder.trigger.hold_s = 1000.0
        session = threading.Thread(
            target=run_session, args=(recorder, lambda: camera, [page_of]), daemon=True
        )
        with chromium_page(page_address(server), (1360, 800)) as page:

            def told(words: str) -> None:
                page.wait_for_selector(f"text={words}", timeout=SLOW_MS)

            told("Take now")
            session.start()
            told("Press next")
            assert page.get_by_text("0 of 5").is_visible()
            assert "top left" in page.get_by_text("Press next").inner_text()
            wait_for(page, lambda: np.ptp(change_tile(page), axis=-1).max() < 40, 60)
            wait_for(page, lambda: framed_cell(page) == (0, 0), 60)
            assert lamp(page, "camera")[0] == "unknown"
            seen = "saturation", "blur", "drift"
            wait_for(page, lambda: [lamp(page, name)[0] for name in seen] == ["ok"] * 3, 60)
            # Pressed: colours in the change, no circle before it is taken.
            camera.image = pressed
            told("Hold still")
            wait_for(page, lambda: np.ptp(change_tile(page), axis=-1).max() > 120, 60)
            assert ring(page) is None
            page.click("text=Take now")
            told("took press_000.png")
            told("1 of 5")
            wait_for(page, lambda: ring(page) is not None, 60)
            wanted = circle.u_px, circle.v_px, circle.radius_px
            assert ring(page) == pytest.approx(wanted, abs=1.5)
            # Its cell is another colour than those that are empty; the next one is named.
            camera.image = rest
            told("Press next")
            place = cell_of(circle, GRID.width_px, GRID.height_px)
            wait_for(page, lambda: odd_cell(page) == place, 60)
            asked = page.get_by_text("Press next")
            wait_for(page, lambda: cell_name(*framed_cell(page)) in asked.inner_text(), 60)
            # What would spoil the captures lights its lamp.
            camera.image = np.where(rest.sum(-1, keepdims=True) > 200, 255, rest).astype(np.uint8)
            wait_for(page, lambda: lamp(page, "saturation")[0] == "bad", 60)
            assert "turn the exposure down" in lamp(page, "saturation")[1]
            camera.image = np.clip(rest.astype(int) + [14, 0, 0], 0, 255).astype(np.uint8)
            # Burnt out, it had drifted too: the lamp is bad before this picture is looked at.
            wait_for(page, lambda: "white balance" in lamp(page, "drift")[1], 60)
            camera.image = pressed
            told("Hold still")
            assert page.locator("text=What a quick session leaves out").count() == 1
            page.click("text=Undo last")
            told("took press_000.png out")
            page.click("text=Take now")
            told("1 of 5")
            page.click("text=Finish")
            told("Finished")
        session.join(timeout=60)
        assert not session.is_alive()
    assert len(load_capture_folder(tmp_path / "out").presses) == 1


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
