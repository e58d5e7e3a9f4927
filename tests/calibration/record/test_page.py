# SPDX-License-Identifier: Apache-2.0
"""A recording: its page, its trigger and cameras that fail."""

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

from taccel_lab.calibration.capture import ContactCircle, load_capture_folder
from taccel_lab.calibration.capture.camera.camera import CameraInfo, Shot
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
from taccel_lab.calibration.record.lamps import FROZEN_S
from taccel_lab.calibration.record.page import BLUE, LAMP_COLORS, RecordPage, tiled
from taccel_lab.calibration.record.session import (
    Recorder,
    SessionStatus,
    run_session,
)
from taccel_lab.calibration.record.trigger import HOLD_S, Phase, Seen, Trigger, UntouchedGel
from taccel_lab.errors import InputError
from taccel_lab.report.live_page import PageOptions, live_page, page_address
from tests.calibration.capture.made_up_layouts import layout_of, ruihangao, rvsathu
from tests.calibration.drawn.faults import quantise
from tests.calibration.record.sessions import FACTS, SteeredCamera, Watching, source
from tests.support.capture_sets import gel, press, spread_circles, write_image
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


FPS = 20.0


def watched(path: Path, how: CameraReplay) -> tuple[list[tuple[float, Seen]], Trigger]:
    camera, trigger = open_camera(str(path), None, how), Trigger()
    seen = []
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


@pytest.mark.thorough
def test_limits_follow_the_cameras_own_noise() -> None:
    rng = np.random.default_rng(3)

    def rest_at(noise: float) -> UntouchedGel:
        trigger, k = Trigger(), 0
        while trigger.rest is None and k < 200:
            trigger.see(quantise(gel() + rng.normal(0, noise, gel().shape)), k / FPS)
            k += 1
        assert trigger.rest is not None
        return trigger.rest

    assert rest_at(4.0).change_levels > 3 * rest_at(0.5).change_levels


@pytest.mark.thorough
def test_a_moving_contact_is_not_taken() -> None:
    rng, trigger = np.random.default_rng(0), Trigger()

    def see(image: np.ndarray, k: int) -> Seen:
        noisy = image + rng.normal(0, 1.0, image.shape)
        return trigger.see(quantise(noisy), k / FPS)

    for k in range(50):
        see(gel(), k)
    phases = [
        see(press(ContactCircle(40.0 + 1.5 * k, 60.0, 15.0)), 50 + k).phase for k in range(40)
    ]
    assert Phase.TAKEN not in phases and Phase.APPROACHING in phases[3:]


@pytest.mark.thorough
def test_what_moves_at_the_start_is_not_taken_for_rest() -> None:
    trigger = Trigger()
    rng = np.random.default_rng(1)
    for k in range(40):  # Two seconds of a ball that is pulled away.
        image = press(ContactCircle(80.0, 60.0, 18.0 - 0.3 * k))
        trigger.see(quantise(image + rng.normal(0, 1.0, image.shape)), k / FPS)
    assert trigger.rest is None
    for k in range(40, 120):
        trigger.see(quantise(gel() + rng.normal(0, 1.0, gel().shape)), k / FPS)
    assert trigger.rest is not None
    assert np.abs(trigger.rest.image.mean() - gel().mean()) < 1.0


@pytest.mark.thorough
def test_a_mark_that_stays_renews_the_untouched_picture() -> None:
    rng, trigger = np.random.default_rng(2), Trigger()
    contact = press(ContactCircle(80.0, 60.0, 16.0))
    marked = gel() + 0.1 * (contact - gel())
    frames = [gel()] * 40 + [contact] * 20 + [marked] * 60 + [contact] * 20
    seen = [
        trigger.see(quantise(f + rng.normal(0, 0.5, f.shape)), k / FPS)
        for k, f in enumerate(frames)
    ]
    assert sum(frame.renewed for frame in seen) == 1
    assert sum(frame.take for frame in seen) == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "make", "count"),
    [("gelsight_rvsathu_sim2real", rvsathu, 22), ("gsmini_ruihangao_calib", ruihangao, 49)],
)
def test_real_presses_are_taken(
    tmp_path: Path, name: str, make: Callable[[Path], None], count: int
) -> None:
    from taccel_lab.calibration.capture import import_captures

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
    cells = [cell_of(circle, *SIZE) for circle in circles]
    each = [cells.count(cell) for cell in {(c, r) for c in range(4) for r in range(3)}]
    assert max(each) - min(each) <= 1
    if count >= 36:
        here = {circle.radius_px for circle in circles if cell_of(circle, *SIZE) == (0, 0)}
        assert here == {share * 40.0 for share in SHARES}


def test_without_a_scale_the_depth_is_told_by_the_contacts_so_far() -> None:
    assert next_press([], SIZE, None).radius_px is None
    assert "px wide" in str(next_press([ContactCircle(30, 30, 20)], SIZE, None))


def test_a_balls_contact_is_never_wider_than_the_ball() -> None:
    assert contact_radius_mm(2.0, 5.0) == 2.0 and contact_radius_mm(2.0, 0.5) < 2.0


FRAMES = 50


def shown(folder: Path, frames: list[np.ndarray], out: Path) -> list[SessionStatus]:
    """What a session says of a folder of frames."""
    folder.mkdir()
    for k, frame in enumerate(frames):
        write_image(folder / f"{k:03d}.png", frame)
    watching = Watching()
    with open_record(out, FACTS) as record:
        recorder = Recorder(record, FACTS, 1)
        run_session(recorder, lambda: open_camera(str(folder), None, CameraReplay()), [watching])
    return watching.seen


def noisy(count: int = FRAMES, gains: tuple[float, ...] = (1.0,)) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [
        np.clip(gel() * gains[k % len(gains)] + rng.normal(0, 1, gel().shape), 0, 255)
        .round()
        .astype(np.uint8)
        for k in range(count)
    ]


@pytest.mark.thorough
@pytest.mark.parametrize(("level", "said"), [(0, "black"), (255, "white")])
def test_the_untouched_gel_waits_until_one_is_seen(tmp_path: Path, level: int, said: str) -> None:
    blank = [np.full(gel().shape, level, np.uint8)] * FRAMES
    seen = shown(tmp_path / "blank", blank, tmp_path / "none")
    assert said in seen[-1].prompt and said in seen[-1].unseen
    assert not (tmp_path / "none").exists()
    seen = shown(tmp_path / "later", [*blank, *noisy()], tmp_path / "out")
    assert seen[-1].prompt.startswith("Press next") and seen[-1].unseen == ""
    background = load_capture_folder(tmp_path / "out").background
    assert background is not None
    assert np.abs(background.image().astype(float) - gel()).mean() < 2.0


@pytest.mark.thorough
def test_light_that_flickers_lights_its_lamp(tmp_path: Path) -> None:
    def state(name: str, gains: tuple[float, ...]) -> tuple[str, str]:
        seen = shown(tmp_path / name, noisy(gains=gains), tmp_path / f"out_{name}")
        lamp = next(lamp for lamp in seen[-1].lamps if lamp.name == "flicker")
        return lamp.state, lamp.text

    assert state("steady", (1.0,))[0] == "ok"
    flickers, told = state("flickers", (0.9, 1.1))
    assert flickers == "bad" and "10 ms" in told


@pytest.mark.thorough
@pytest.mark.parametrize("replayed", [False, True])
def test_a_camera_that_hangs_is_told_a_replay_is_not(tmp_path: Path, replayed: bool) -> None:
    with open_record(tmp_path / "out", FACTS) as folder:
        recorder = Recorder(folder, FACTS, 1)
        recorder.opened(CameraInfo("usb-1", "mine", replayed=replayed), [])
        for k, image in enumerate(noisy()):
            status = recorder.see(Shot(image, k / 25))
        start = FRAMES / 25
        for k in range(int(25 * (FROZEN_S + 1))):
            status = recorder.see(Shot(image, start + k / 25))
        lamp = next(lamp for lamp in status.lamps if lamp.name == "camera")
        assert ("hangs" in status.prompt) is not replayed
        assert ("hangs" in lamp.text and lamp.state == "bad") is not replayed
        status = recorder.see(Shot(noisy(1)[0], start + FROZEN_S + 1.1))
        assert "hangs" not in status.prompt


def test_images_too_small_to_calibrate_leave_nothing(tmp_path: Path) -> None:
    small = [np.full((12, 16, 3), 90, np.uint8)] * 5
    with pytest.raises(InputError, match="16x12 px; at least 32x32"):
        shown(tmp_path / "small", small, tmp_path / "out")
    assert not (tmp_path / "out").exists()
