# SPDX-License-Identifier: Apache-2.0
"""A recording: its page, its trigger and the press that it asks for."""

from __future__ import annotations

import io
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from taccel_lab.calibration.capture import ContactCircle, import_captures, load_capture_folder
from taccel_lab.calibration.capture.camera.replay import CameraReplay, open_camera
from taccel_lab.calibration.capture.coverage import (
    CELLS,
    SHARES,
    cell_name,
    cell_of,
    contact_radius_mm,
    next_press,
)
from taccel_lab.calibration.record.folder import open_record
from taccel_lab.calibration.record.page import BLUE, LAMP_COLORS, RecordPage, tiled
from taccel_lab.calibration.record.session import Recorder, run_session
from taccel_lab.calibration.record.trigger import HOLD_S, Phase, Seen, Trigger
from taccel_lab.report.live_page import PageOptions, live_page, page_address
from tests.calibration.capture.made_up_layouts import layout_of, ruihangao, rvsathu
from tests.calibration.drawn.faults import quantise
from tests.calibration.record.sessions import FACTS, SteeredCamera, source
from tests.support.capture_sets import gel, press, spread_circles
from tests.support.real_data import real_data
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
    """The coverage table, the pixels of each cell, float [row, column, pixel, 3]."""
    with Image.open(io.BytesIO(page.locator("img").last.screenshot())) as file:
        seen = np.asarray(file.convert("RGB")).astype(float)
    high, wide = seen.shape[0] // CELLS[1], seen.shape[1] // CELLS[0]
    blocks = seen[: high * CELLS[1], : wide * CELLS[0]]
    blocks = blocks.reshape(CELLS[1], high, CELLS[0], wide, 3).transpose(0, 2, 1, 3, 4)
    return blocks.reshape(CELLS[1], CELLS[0], -1, 3)


def place_of(most: np.ndarray) -> tuple[int, int]:
    """Column and row of the cell where this is most."""
    row, column = np.unravel_index(most.argmax(), most.shape)
    return int(column), int(row)


def odd_cell(page: Any) -> tuple[int, int]:
    """The cell whose colour is farthest from that of most."""
    colors = np.median(cells(page), axis=2)
    return place_of(np.abs(colors - np.median(colors, axis=(0, 1))).max(axis=-1))


def framed_cell(page: Any) -> tuple[int, int]:
    """The cell with the blue frame."""
    return place_of((np.abs(cells(page) - BLUE).max(axis=-1) < 40).sum(axis=2))


def lamp(page: Any, name: str) -> tuple[str, str]:
    """State and words of a lamp."""
    row = page.locator(f"div:has(> span > b:text-is('{name}'))").last
    style = row.locator("span").first.get_attribute("style")
    state = next(state for state, color in LAMP_COLORS.items() if color in style)
    return state, row.inner_text()


@pytest.mark.thorough
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
    shapes = {(250, 0, 0): (240, 320), (0, 250, 0): (320, 240), (0, 0, 250): (100, 100)}
    pictures = [
        (str(color), np.full((*shape, 3), color, np.uint8)) for color, shape in shapes.items()
    ]
    sheet = tiled(pictures, aspect, 600)
    assert sheet.shape[1] == 600 and sheet.shape[0] == pytest.approx(600 / aspect, abs=1)
    for color, (height, width) in shapes.items():
        rows, columns = np.nonzero((sheet == color).all(axis=-1))
        wide, high = np.ptp(columns) + 1, np.ptp(rows) + 1
        assert wide / high == pytest.approx(width / height, rel=0.03) and wide > 60
        assert len(rows) == wide * high


FPS = 20.0


def watched(path: Path, how: CameraReplay) -> tuple[list[tuple[float, Seen]], Trigger]:
    camera, trigger, seen = open_camera(str(path), None, how), Trigger(), []
    while (shot := camera.read()) is not None:
        seen.append((shot.time_s, trigger.see(shot.image, shot.time_s)))
    return seen, trigger


@pytest.mark.thorough
@pytest.mark.parametrize("noise", [0.0, 4.0])
def test_every_press_is_taken_once_when_it_stands_still(tmp_path: Path, noise: float) -> None:
    how = CameraReplay(noise_levels=noise, hold_s=0.9)
    seen, _ = watched(source(tmp_path / "set", 2), how)
    takes = [time for time, frame in seen if frame.take]
    assert len(takes) == 2
    # Each comes after rest and way in, and after it stood still for as long as it has to.
    period = how.hold_s + 0.5 * how.rest_s + 2 * (how.blend_s - 1 / how.fps)
    for k, time in enumerate(takes):
        arrived = how.rest_s + k * period + how.blend_s - 2 / how.fps
        assert arrived + HOLD_S < time < arrived + how.hold_s + 0.05


def seen_by(
    trigger: Trigger, frames: list[np.ndarray], noise: float, seed: int, start: int = 0
) -> list[Seen]:
    """What it sees of frames under noise, from the time of the frame ``start`` on."""
    rng = np.random.default_rng(seed)
    return [
        trigger.see(quantise(frame + rng.normal(0, noise, frame.shape)), k / FPS)
        for k, frame in enumerate(frames, start)
    ]


@pytest.mark.thorough
def test_limits_follow_the_cameras_own_noise() -> None:
    limits = []
    for noise in (4.0, 0.5):
        trigger = Trigger()
        seen_by(trigger, [gel()] * 60, noise, 3)
        assert trigger.rest is not None
        limits.append(trigger.rest.change_levels)
    assert limits[0] > 3 * limits[1]


@pytest.mark.thorough
def test_a_moving_contact_is_not_taken() -> None:
    trigger = Trigger()
    moving = [press(ContactCircle(40.0 + 1.5 * k, 60.0, 15.0)) for k in range(40)]
    phases = [seen.phase for seen in seen_by(trigger, [gel()] * 50 + moving, 1.0, 0)][50:]
    assert Phase.TAKEN not in phases and Phase.APPROACHING in phases[3:]


@pytest.mark.thorough
def test_what_moves_at_the_start_is_not_taken_for_rest() -> None:
    trigger = Trigger()
    # Two seconds of a ball that is pulled away.
    pulled = [press(ContactCircle(80.0, 60.0, 18.0 - 0.3 * k)) for k in range(40)]
    seen_by(trigger, pulled, 1.0, 1)
    assert trigger.rest is None
    seen_by(trigger, [gel()] * 80, 1.0, 2, start=40)
    assert trigger.rest is not None
    assert np.abs(trigger.rest.image.mean() - gel().mean()) < 1.0


@pytest.mark.thorough
def test_a_mark_that_stays_renews_the_untouched_picture() -> None:
    contact = press(ContactCircle(80.0, 60.0, 16.0))
    marked = gel() + 0.1 * (contact - gel())
    frames = [gel()] * 40 + [contact] * 20 + [marked] * 60 + [contact] * 20
    seen = seen_by(Trigger(), frames, 0.5, 2)
    assert sum(frame.renewed for frame in seen) == 1
    assert sum(frame.take for frame in seen) == 2


@pytest.mark.parametrize("when", [8, 20])
def test_a_clock_that_was_put_back_delays_no_picture(when: int) -> None:
    """While the gel is measured, or before a contact that stands still; by a minute."""
    trigger, dent = Trigger(), press(ContactCircle(80.0, 60.0, 18.0))
    frames = [gel()] * (when + 20) + [dent] * 8
    seen = [
        trigger.see(quantise(frame), k / 8 - (60.0 if k >= when else 0.0))
        for k, frame in enumerate(frames)
    ]
    assert [k for k, frame in enumerate(seen) if frame.take] == [when + 20 + 6]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "make", "count"),
    [("gelsight_rvsathu_sim2real", rvsathu, 22), ("gsmini_ruihangao_calib", ruihangao, 49)],
)
def test_real_presses_are_taken(
    tmp_path: Path, name: str, make: Callable[[Path], None], count: int
) -> None:
    (folder,) = import_captures(real_data(name), tmp_path / "set", layout_of(make))
    seen, _ = watched(folder, CameraReplay(noise_levels=1.0))
    assert sum(frame.take for _, frame in seen) == count


@pytest.mark.thorough
def test_a_finger_that_never_rests_is_not_taken() -> None:
    """A real video: a finger presses, shears and leaves, without ever standing still."""
    seen, trigger = watched(real_data("gsmini_markers_video"), CameraReplay(fps=25.0))
    assert trigger.rest is not None
    assert not any(frame.take for _, frame in seen)
    assert any(frame.phase == Phase.APPROACHING for _, frame in seen)


SIZE = (320, 240)


@given(st.integers(0, 47))
def test_whoever_follows_it_covers_all_cells_at_all_depths(count: int) -> None:
    circles = []
    for _ in range(count):
        advice = next_press(circles, SIZE, 40.0)
        u, v = ((advice.cell[k] + 0.5) * SIZE[k] / CELLS[k] for k in (0, 1))
        assert advice.radius_px is not None
        circles.append(ContactCircle(u, v, advice.radius_px))
    counts = np.zeros(CELLS, dtype=int)
    for circle in circles:
        counts[cell_of(circle, *SIZE)] += 1
    assert np.ptp(counts) <= 1
    if count >= 36:
        here = {circle.radius_px for circle in circles if cell_of(circle, *SIZE) == (0, 0)}
        assert here == {share * 40.0 for share in SHARES}


def test_without_a_scale_depth_is_told_by_the_contacts_so_far_none_wider_than_the_ball() -> None:
    assert next_press([], SIZE, None).radius_px is None
    assert "px wide" in str(next_press([ContactCircle(30, 30, 20)], SIZE, None))
    assert contact_radius_mm(2.0, 5.0) == 2.0 and contact_radius_mm(2.0, 0.5) < 2.0
