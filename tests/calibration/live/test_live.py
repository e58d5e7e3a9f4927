# SPDX-License-Identifier: Apache-2.0
"""Readings of a camera while it runs, and their page."""

from __future__ import annotations

import re
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.calibration.capture import CaptureSet
from taccel_lab.calibration.capture.camera.replay import CameraReplay, open_camera
from taccel_lab.calibration.live.page import (
    BEYOND,
    LivePage,
    LiveSheet,
    figures_text,
    latency_text,
    pictures,
)
from taccel_lab.calibration.live.reader import LiveReader
from taccel_lab.calibration.live.run import LiveResult, live_session, run_together
from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile
from taccel_lab.report.live_page import PageOptions, live_page, page_address
from taccel_lab.sensors.profile import catalogue_profile
from tests.calibration.grey.test_depth import BALL_MM, CIRCLES, GRID, grey_unit
from tests.calibration.record.sessions import SteeredCamera
from tests.support.capture_sets import write_image
from tests.support.real_data import real_data
from tests.support.synthetic_presses import flat_profile
from tests.viewer.browser import chromium_page, picture, wait_for


@pytest.fixture(scope="module")
def grey() -> tuple[CaptureSet, SensorProfile]:
    return grey_unit()


class Watching:
    """Keeps what it is shown and told; asks for a new background, or stops, at some frames."""

    def __init__(self, again_at: int = -1, stop_at: int = -1) -> None:
        self.readings, self.told = [], []
        self._again_at, self._stop_at = again_at, stop_at

    def show(self, reading, reader, latency) -> None:
        self.readings.append(reading)

    def tell(self, text: str) -> None:
        self.told.append(text)

    def wants_background(self) -> bool:
        return len(self.readings) == self._again_at

    def stopped(self) -> bool:
        return len(self.readings) == self._stop_at


def session(
    folder: Path, captures: CaptureSet, profile: SensorProfile, watching: Watching, **how
) -> LiveResult:
    """The untouched gel for two seconds, then a press."""
    if not folder.is_dir():
        folder.mkdir()
        rng = np.random.default_rng(0)
        frames = [captures.background] * 45 + [captures.presses[2].image()] * 30
        for k, frame in enumerate(frames):
            noisy = np.clip(np.rint(frame + rng.normal(0, 0.5, frame.shape)), 0, 255)
            write_image(folder / f"{k:03d}.png", noisy.astype(np.uint8))
    session = live_session(
        lambda background: LiveReader(profile, background),
        lambda: open_camera(str(folder), None, CameraReplay(fps=25.0)),
        [watching],
        **how,
    )
    return run_together([session])[0]


@pytest.mark.thorough
def test_a_press_is_read_and_timed(grey: tuple[CaptureSet, SensorProfile], tmp_path: Path) -> None:
    watching = Watching()
    result = session(tmp_path / "frames", *grey, watching)
    assert watching.told[0].startswith("Touch nothing") and watching.told[-1] == ""
    rim = CIRCLES[2].radius_px * GRID.mm_per_px_x
    deepest = BALL_MM - np.sqrt(BALL_MM**2 - rim**2)
    assert watching.readings[-1].figures["max_depth_mm"] == pytest.approx(deepest, abs=0.1)
    assert watching.readings[0].figures["touched_mm2"] < 1.0
    found = result.latency.figures()
    assert found["frames"] == len(watching.readings) and found["rate_hz"] > 0
    assert set(found["stages_ms"]) >= {"light", "depth", "pictures", "wait"}
    work = found["busy_ms"]["median"]
    assert 0 < found["stages_ms"]["depth"]["median"] <= work
    assert result.reader is not None
    shown = dict(pictures(watching.readings[-1], result.reader.background))
    assert {"camera", "change", "normals"} <= set(shown)
    assert "mm deep" in figures_text(watching.readings[-1], result.reader)
    assert "frames a second" in latency_text(result.latency, result.reader)


def test_photos_without_a_rest_say_what_was_waited_for(
    grey: tuple[CaptureSet, SensorProfile], tmp_path: Path
) -> None:
    captures, profile = grey
    folder = tmp_path / "photos"
    folder.mkdir()
    for number, press in enumerate(captures.presses):
        levels = np.clip(np.rint(press.image()), 0, 255).astype(np.uint8)
        write_image(folder / f"{number}.png", levels)
    result = session(folder, captures, profile, Watching())
    assert result.reader is None
    assert result.unseen.startswith("It waited for the untouched gel: 1.5 s (12 frames and more")


@pytest.mark.thorough
def test_a_session_ends_at_a_number_of_frames_or_by_a_watcher(
    grey: tuple[CaptureSet, SensorProfile], tmp_path: Path
) -> None:
    folder = tmp_path / "frames"
    assert session(folder, *grey, Watching(), frames=3).latency.figures()["frames"] == 3
    watching = Watching(stop_at=2)
    session(folder, *grey, watching)
    assert len(watching.readings) == 2
    watching = Watching(again_at=2)
    rest = np.asarray(grey[0].background, dtype=np.float32)
    result = session(folder, *grey, watching, background=rest)
    assert watching.told.count("Touch nothing: the untouched gel is being measured.") == 1
    assert result.reader is not None and len(watching.readings) > 2


@pytest.mark.thorough
def test_several_sensors_go_on_in_turn_until_each_is_over(
    grey: tuple[CaptureSet, SensorProfile], tmp_path: Path
) -> None:
    captures, profile = grey
    rest = np.asarray(captures.background)
    seen: list[str] = []

    class Named(Watching):
        def __init__(self, name: str) -> None:
            super().__init__()
            self.name = name

        def show(self, reading, reader, latency) -> None:
            super().show(reading, reader, latency)
            seen.append(self.name)

    watchers = {"left": Named("left"), "right": Named("right")}
    for name, count in (("left", 2), ("right", 4)):
        (tmp_path / name).mkdir()
        for k in range(count):
            image = rest if name == "left" else captures.presses[2].image()
            write_image(
                tmp_path / name / f"{k}.png", np.clip(np.rint(image), 0, 255).astype(np.uint8)
            )
    left, right = run_together(
        [
            live_session(
                lambda background: LiveReader(profile, background),
                lambda name=name: open_camera(str(tmp_path / name), None, CameraReplay()),
                [watching],
                background=rest.astype(np.float32),
            )
            for name, watching in watchers.items()
        ]
    )
    assert seen == ["left", "right", "left", "right", "right", "right"]
    assert left.latency.figures()["frames"] == 2 and right.latency.figures()["frames"] == 4
    assert left.last is not None and right.last is not None
    assert left.last.figures["touched_mm2"] < 1 < right.last.figures["touched_mm2"]


def test_what_lies_beyond_the_calibration_is_marked(
    grey: tuple[CaptureSet, SensorProfile],
) -> None:
    captures, profile = grey
    reader = LiveReader(profile, np.asarray(captures.background, np.float32))
    dark = np.asarray(captures.background).astype(np.uint8).copy()
    dark[40:80, 60:90] = 0
    reading = reader.read(dark)
    title, picture = next(p for p in pictures(reading, reader.background) if "depth" in p[0])
    assert (picture[50, 75] == BEYOND).all() and "beyond" in title
    assert reading.figures["warnings"]


def test_a_depth_that_is_mostly_beyond_is_refused() -> None:
    from taccel_lab.calibration.live.reader import _refusal

    assert "no depth" in _refusal({"beyond_balls_share": 0.6})
    assert _refusal({"beyond_balls_share": 0.3}) == ""


@pytest.mark.thorough
def test_forces_come_from_whoever_tells_them(grey: tuple[CaptureSet, SensorProfile]) -> None:
    captures, profile = grey
    background = np.asarray(captures.background, np.float32)
    told = {"Fz [N]": 1.5, "Fz +- [N]": 0.12, "contact area [mm2]": 7.0}
    reader = LiveReader(profile, background, force=lambda image, rest: told)
    reading = reader.read(captures.presses[0].image())
    assert reading.forces == told and "force" in reading.stages_s
    text = figures_text(reading, reader)
    assert "Fz: **1.50 ± 0.12** N" in text and "contact area: **7.00** mm2" in text
    assert "+-" not in text and "no force" not in text
    assert "frame is not like" in figures_text(replace(reading, forces={}), reader)
    plain = LiveReader(profile, background)
    assert "has no force model" in figures_text(plain.read(captures.presses[0].image()), plain)


def test_images_and_profiles_that_do_not_fit_are_refused(
    grey: tuple[CaptureSet, SensorProfile],
) -> None:
    _, profile = grey
    with pytest.raises(InputError, match=r"50x40.*200x150.*--crop"):
        LiveReader(profile, np.zeros((40, 50, 3), np.float32))
    with pytest.raises(InputError, match="calibrate one first"):
        LiveReader(flat_profile(GRID), np.zeros((150, 200, 3), np.float32))


def test_frames_that_change_their_size_are_refused(
    grey: tuple[CaptureSet, SensorProfile], tmp_path: Path
) -> None:
    (tmp_path / "frames").mkdir()
    rest = np.asarray(grey[0].background).astype(np.uint8)
    write_image(tmp_path / "frames" / "0.png", rest)
    write_image(tmp_path / "frames" / "1.png", rest[::2, ::2])
    with pytest.raises(InputError, match=r"camera is 100x75 px, it began with 200x150"):
        session(tmp_path / "frames", *grey, Watching(), background=rest.astype(np.float32))


@pytest.mark.thorough
def test_an_untouched_gel_unlike_the_profiles_is_said(
    grey: tuple[CaptureSet, SensorProfile], tmp_path: Path
) -> None:
    captures, profile = grey
    rows, columns = np.indices((GRID.height_px, GRID.width_px))[..., None] + np.zeros(3)
    rest, other = ((60 + 0.7 * side).astype(np.float32) for side in (columns, rows))
    profile = replace(profile, background_rgb=rest)
    assert LiveReader(profile, rest).unlike_profile == ""
    assert "not as this profile knows it" in LiveReader(profile, other).unlike_profile
    watching = Watching()
    turned = replace(captures, background=other.astype(np.uint8))
    found = session(tmp_path / "frames", turned, profile, watching)
    assert found.remarks and watching.told[-1] == found.remarks[0]


@pytest.mark.thorough
def test_markers_of_a_real_video_are_followed() -> None:
    camera = open_camera(str(real_data("gsmini_markers_video")))
    profile = catalogue_profile("gelsight_mini")
    frames = []
    while (shot := camera.read()) is not None:
        frames.append(shot.image)
    reader = LiveReader(profile, frames[0].astype(np.float32))
    assert reader.no_markers == ""
    moved = []
    for frame in frames[:100:8]:
        reading = reader.read(frame)
        markers = reading.markers
        assert markers is not None and markers.seen.mean() > 0.5
        moved.append(np.linalg.norm(markers.uv_px - markers.rest_px, axis=1).max())
    assert moved[0] < 1.0 and max(moved) > 3.0


SLOW_MS = 60_000


def yellow_share(page: Any) -> float:
    """Share of the pictures that is as yellow as the deepest places of a depth map."""
    seen = picture(page)[:, :950].astype(int)
    return float(((seen[..., :2].min(axis=-1) > 170) & (seen[..., 2] < 110)).mean())


@pytest.mark.thorough
def test_depth_force_and_latency_follow_the_gel_until_it_is_stopped(
    grey: tuple[CaptureSet, SensorProfile], tmp_path: Path
) -> None:
    pytest.importorskip("viser", reason="the extra view is not installed")
    captures, profile = grey
    rest, pressed = np.asarray(captures.background), captures.presses[2].image()
    pressed = np.clip(np.rint(pressed), 0, 255).astype(np.uint8)
    camera = SteeredCamera(tmp_path, rest, noise=0.5)
    results: list[LiveResult] = []

    def force(image: np.ndarray, background: np.ndarray) -> dict[str, float]:
        drop = float((background.astype(float) - image).mean())
        return {"Fz [N]": drop, "Fz +- [N]": 0.25}

    def run(page_of: LivePage) -> None:
        reader = lambda untouched: LiveReader(profile, untouched, force=force)  # noqa: E731
        results.extend(run_together([live_session(reader, lambda: camera, [page_of])]))

    with live_page("Live", PageOptions(port=0, browser=False)) as server:
        shown = LivePage(LiveSheet(server), 15.0, tmp_path / "kept")
        session = threading.Thread(target=run, args=[shown], daemon=True)
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
            page.get_by_text("Snapshot", exact=True).click()
            page.get_by_text("snapshot_000_image.png").wait_for(timeout=SLOW_MS)
            assert (tmp_path / "kept" / "snapshot_000.json").is_file()
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
