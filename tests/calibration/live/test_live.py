# SPDX-License-Identifier: Apache-2.0
"""Readings of a camera while it runs, and their page."""

from __future__ import annotations

import io
import re
import threading
import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from taccel_lab.api.read import read
from taccel_lab.calibration.capture.camera.replay import CameraReplay, open_camera
from taccel_lab.calibration.live import page as live
from taccel_lab.calibration.live.page import FIGURES_EVERY_S
from taccel_lab.calibration.live.reader import LiveReader, SeenMarkers
from taccel_lab.calibration.live.run import Latency, LiveResult, live_session, run_together
from taccel_lab.calibration.live.surface_view import LOADED_S, surface_mesh
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import NormalsBlock, SensorProfile
from taccel_lab.reading.dots import marker_picture
from taccel_lab.report.live_page import PageOptions, live_page, page_address
from taccel_lab.sensors.profile import catalogue_profile, stock_sensor
from tests.calibration.depth.test_depth import DEEPEST_MM, GRID, grey_unit
from tests.calibration.drawn.faults import quantise
from tests.calibration.record.sessions import SteeredCamera
from tests.support.capture_sets import write_image
from tests.support.real_data import real_data
from tests.support.sample_blocks import ASSUMED
from tests.support.synthetic_presses import flat_profile
from tests.viewer.browser import chromium_page, picture, wait_for
from tools.bench.readings import networks, presses


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


def written(folder: Path, frames: Sequence[np.ndarray], noise: float = 0.0) -> Path:
    folder.mkdir()
    rng = np.random.default_rng(0)
    for k, frame in enumerate(frames):
        write_image(folder / f"{k:03d}.png", quantise(frame + rng.normal(0, noise, frame.shape)))
    return folder


def session(
    folder: Path, watching: Watching, profile: SensorProfile | None = None, **how: Any
) -> Any:
    return live_session(
        lambda background: LiveReader(profile or grey_unit().profile, background),
        lambda: open_camera(str(folder), None, CameraReplay(fps=25.0)),
        [watching],
        **how,
    )


def followed(*given: Any, **how: Any) -> LiveResult:
    return run_together([session(*given, **how)])[0]


def rest_then_press(folder: Path, rest: np.ndarray | None = None) -> Path:
    """The untouched gel for two seconds, then a press."""
    frames = [grey_unit().rest if rest is None else rest] * 45 + [grey_unit().pressed] * 30
    return written(folder, frames, noise=0.5)


def reader_of(profile: SensorProfile | None = None, **how: Any) -> LiveReader:
    return LiveReader(profile or grey_unit().profile, grey_unit().rest.astype(np.float32), **how)


def colored_unit(**config: float) -> tuple[SensorProfile, np.ndarray, list[np.ndarray]]:
    """Networks of the real architecture on a small grid, their untouched gel and two presses."""
    grid = PixelGrid(160, 120, 0.12, 0.12)
    model, (images, light, _) = networks(grid, "cpu"), presses(grid, 2)
    settings = replace(model.config, **config)
    normals = NormalsBlock(architecture=settings.to_dict(), provenance=ASSUMED)
    flat = flat_profile(grid, thickness_mm=4.0)
    return flat.with_block(normals, dict(model.weights)), quantise(light), list(images)


@pytest.mark.thorough
def test_a_press_is_read_and_timed(tmp_path: Path) -> None:
    watching = Watching()
    result = followed(rest_then_press(tmp_path / "frames"), watching)
    assert watching.told[0].startswith("Touch nothing") and watching.told[-1] == ""
    first, last = watching.readings[0], watching.readings[-1]
    assert last.figures["depth_mm"] == pytest.approx(DEEPEST_MM, abs=0.1)
    assert first.figures["dent_mm2"] < 1.0
    found = result.latency.figures()
    assert found["frames"] == len(watching.readings) and found["rate_hz"] > 0
    assert set(found["stages_ms"]) >= {"light", "heights", "pictures", "wait"}
    assert 0 < found["stages_ms"]["heights"]["median"] <= found["busy_ms"]["median"]
    assert result.reader is not None
    shown = dict(live.pictures(last, result.reader.background))
    assert {"camera", "change", "normals"} <= set(shown)
    assert "mm deep" in live.figures_text(last, result.reader)
    assert "frames a second" in live.latency_text(result.latency, result.reader)


def test_photos_without_a_rest_say_what_was_waited_for(tmp_path: Path) -> None:
    photos = written(tmp_path / "photos", [p.image() for p in grey_unit().captures.presses])
    result = followed(photos, Watching())
    assert result.reader is None
    assert result.unseen.startswith("It waited for the untouched gel: 1.5 s (12 frames and more")


@pytest.mark.thorough
def test_a_frame_reads_alike_whatever_was_read_before_and_by_whichever_reader() -> None:
    """To the bit, by networks and by depths: live, one by one, and as a list in any order."""
    unit, (by_colors, rest, images) = grey_unit(), colored_unit()
    for profile, still, frames in (
        (by_colors, rest, [*images, rest]),
        (unit.profile, quantise(unit.rest), [quantise(unit.pressed), quantise(unit.rest)]),
    ):

        def reader() -> LiveReader:
            return LiveReader(profile, still.astype(np.float32))  # noqa: B023

        alone = [reader().read(frame) for frame in frames]
        assert alone[0].press is not None and alone[0].press.force_n > 0
        assert alone[-1].press is not None and alone[-1].press.force_n == 0
        order = [*range(len(frames)), *reversed(range(len(frames))), 0, 0]
        long_run = reader()
        listed = read(profile, [frames[k] for k in order], background=still)
        for k, one in zip(order, listed, strict=True):
            live = long_run.read(frames[k])
            assert live.figures == alone[k].figures and live.refused == alone[k].refused
            for found in (live.reading, one):
                seen = alone[k].reading
                assert found is not None and seen is not None
                assert np.array_equal(found.depth_m, seen.depth_m)
                mine, its = found.height_sigma_m, seen.height_sigma_m
                assert mine is not None and its is not None and np.array_equal(mine, its)
                assert np.array_equal(found.pressure_pa, seen.pressure_pa)
                assert found.figures() == seen.figures()


@pytest.mark.thorough
def test_a_session_ends_at_a_number_of_frames_or_by_a_watcher(tmp_path: Path) -> None:
    folder = rest_then_press(tmp_path / "frames")
    assert followed(folder, Watching(), frames=3).latency.figures()["frames"] == 3
    watching = Watching(stop_at=2)
    followed(folder, watching)
    assert len(watching.readings) == 2
    watching = Watching(again_at=2)
    result = followed(folder, watching, background=grey_unit().rest.astype(np.float32))
    assert watching.told.count("Touch nothing: the untouched gel is being measured.") == 1
    assert result.reader is not None and len(watching.readings) > 2


@pytest.mark.thorough
def test_several_sensors_go_on_in_turn_until_each_is_over(tmp_path: Path) -> None:
    seen: list[str] = []

    class Named(Watching):
        def __init__(self, name: str) -> None:
            super().__init__()
            self.name = name

        def show(self, reading, reader, latency) -> None:
            seen.append(self.name)

    unit = grey_unit()
    frames = {"left": [unit.rest] * 2, "right": [unit.pressed] * 4}
    background = unit.rest.astype(np.float32)
    left, right = run_together(
        [
            session(written(tmp_path / name, images), Named(name), background=background)
            for name, images in frames.items()
        ]
    )
    assert seen == ["left", "right", "left", "right", "right", "right"]
    assert left.latency.figures()["frames"] == 2 and right.latency.figures()["frames"] == 4
    assert left.last is not None and right.last is not None
    assert left.last.figures["dent_mm2"] < 1 < right.last.figures["dent_mm2"]


def test_what_lies_beyond_the_calibration_is_marked_or_refused() -> None:
    reader, hidden = reader_of(), np.zeros((GRID.height_px, GRID.width_px, 1))
    hidden[40:80, 60:90] = 1.0
    # Its border is as soft as a lens has it.
    soft = gaussian_filter(hidden, (3.0, 3.0, 0.0))
    dark = np.rint(grey_unit().rest * (1.0 - soft)).astype(np.uint8)
    reading = reader.read(dark)
    title, picture = next(p for p in live.pictures(reading, reader.background) if "depth" in p[0])
    assert (picture[50, 75] == live.BEYOND).all() and "beyond" in title
    assert reading.figures["warnings"]
    for cone_deg, refused in ((1.0, True), (60.0, False)):
        profile, rest, images = colored_unit(cone_deg=cone_deg)
        found = LiveReader(profile, rest).read(images[0])
        assert ("no depth is given" in found.refused) is refused is (found.reading is None)
        with pytest.raises(InputError, match="no depth") if refused else nullcontext():
            read(profile, images[0], background=rest)


@pytest.mark.thorough
def test_forces_come_from_whoever_tells_them() -> None:
    pressed = grey_unit().pressed
    told = {"Fz [N]": 1.5, "Fz +- [N]": 0.12, "contact area [mm2]": 7.0}
    reader, plain = reader_of(force=lambda image, rest: told), reader_of()
    reading = reader.read(pressed)
    assert reading.forces == told and "force" in reading.stages_s
    text = live.figures_text(reading, reader)
    assert "Fz: **1.50 ± 0.12** N" in text and "contact area: **7.00** mm2" in text
    assert "+-" not in text and "no force" not in text
    assert "frame is not like" in live.figures_text(replace(reading, forces={}), reader)
    assert "has no force model" in live.figures_text(plain.read(pressed), plain)


def test_images_profiles_and_frames_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    unit = grey_unit()
    with pytest.raises(InputError, match=r"50x40.*200x150.*--crop"):
        LiveReader(unit.profile, np.zeros((40, 50, 3), np.float32))
    with pytest.raises(InputError, match="calibrate one first"):
        reader_of(flat_profile(GRID))
    folder = written(tmp_path / "frames", [unit.rest, unit.rest[::2, ::2]])
    with pytest.raises(InputError, match=r"camera is 100x75 px, it began with 200x150"):
        followed(folder, Watching(), background=unit.rest.astype(np.float32))


@pytest.mark.thorough
def test_an_untouched_gel_unlike_the_profiles_is_said(tmp_path: Path) -> None:
    rows, columns = np.indices((GRID.height_px, GRID.width_px))[..., None] + np.zeros(3)
    rest, other = ((60 + 0.7 * side).astype(np.float32) for side in (columns, rows))
    profile = replace(grey_unit().profile, background_rgb=rest)
    assert LiveReader(profile, rest).unlike_profile == ""
    assert "not as this profile knows it" in LiveReader(profile, other).unlike_profile
    watching = Watching()
    found = followed(
        rest_then_press(tmp_path / "frames", other.astype(np.uint8)), watching, profile
    )
    assert found.remarks and watching.told[-1] == found.remarks[0]


@pytest.mark.thorough
def test_markers_of_a_real_video_are_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    """They are looked for once, by whoever asks first."""
    looks, look = [], marker_picture.scale_candidates
    monkeypatch.setattr(marker_picture, "scale_candidates", lambda i: looks.append(0) or look(i))
    camera, frames = open_camera(str(real_data("gsmini_markers_video"))), []
    while (shot := camera.read()) is not None:
        frames.append(shot.image)
    reader = LiveReader(catalogue_profile("gelsight_mini"), frames[0].astype(np.float32))
    assert reader.no_markers == "" and len(looks) == 1
    moved = []
    for frame in frames[:100:8]:
        markers = reader.read(frame).markers
        assert markers is not None and markers.seen.mean() > 0.5
        moved.append(np.linalg.norm(markers.uv_px - markers.rest_px, axis=1).max())
    assert moved[0] < 1.0 and max(moved) > 3.0


@pytest.mark.thorough
def test_what_is_guessed_or_known_is_not_told_of_a_frame() -> None:
    """How far unseen markers went is a guess; what the profile says of itself stands above."""
    profile = stock_sensor("gelsight_mini")
    assert profile.background_rgb is not None
    reader = LiveReader(profile, profile.background_rgb)
    reading = reader.read(quantise(profile.background_rgb))
    rest = np.array([[10.0, 10.0], [40.0, 10.0]])
    markers = SeenMarkers(rest + [[1.0, 0.0], [9.0, 0.0]], rest, np.array([True, False]), "")
    text = live.figures_text(replace(reading, markers=markers), reader)
    assert "1 of 2 markers seen, largest displacement 1.0 px" in text
    told = profile.sensor.provenance.remarks
    assert told and not any(remark in text for remark in told)


SLOW_MS = 60_000


def yellow_share(page: Any) -> float:
    """Share of the pictures that is as yellow as the deepest places of a depth map."""
    seen = picture(page)[:, :950].astype(int)
    return float(((seen[..., :2].min(axis=-1) > 170) & (seen[..., 2] < 110)).mean())


def grey_share(page: Any) -> float:
    """Share of the pictures that has no colour, white apart."""
    seen = picture(page)[:, :950].astype(int)
    return float(((np.ptp(seen, axis=-1) < 6) & (seen.max(axis=-1) < 230)).mean())


def violet_share(page: Any) -> float:
    """Share of the pictures in the pale violet of an untouched surface."""
    seen = picture(page)[:, :950].astype(int)
    return float((seen[..., 1] < seen[..., [0, 2]].min(axis=-1) - 20).mean())


def test_a_surface_in_space_has_the_heights_and_depths_of_its_reading() -> None:
    trimesh = pytest.importorskip("trimesh")
    reading = reader_of().read(grey_unit().pressed)
    surface = reading.reading
    assert surface is not None
    points_mm, glb = surface_mesh(surface, 5.0, DEEPEST_MM)
    lowest = points_mm[:, 2].argmin()
    assert points_mm[lowest, 2] == pytest.approx(-5 * DEEPEST_MM, abs=0.5)
    deepest_mm = surface.figures()["deepest_mm"]
    np.testing.assert_allclose(points_mm[lowest, :2], deepest_mm, atol=0.5)
    mesh: Any = trimesh.load(io.BytesIO(glb), file_type="glb", force="mesh", process=False)
    np.testing.assert_allclose(mesh.vertices, points_mm, rtol=1e-6, atol=1e-6)
    assert (mesh.face_normals[:, 2] > 0).all(), "triangles turn outward, where they are lit"
    share = mesh.visual.uv[:, 0]
    assert share[lowest] > 0.9 and share[0] < 0.1
    flat, _ = surface_mesh(surface, 1.0, DEEPEST_MM, 7.0)
    np.testing.assert_allclose(flat * (1, 1, 5) - (7, 0, 0), points_mm, rtol=1e-6, atol=1e-9)
    _, grey = surface_mesh(surface, 5.0, DEEPEST_MM, rejected=True)
    assert len(grey) < len(glb)


@pytest.mark.thorough
def test_the_last_frame_is_shown_whatever_the_rate(tmp_path: Path) -> None:
    """Two frames at once: figures and 3D are those of the second, and its surface alone is seen."""
    pytest.importorskip("viser", reason="the extra view is not installed")
    reader, unit = reader_of(), grey_unit()
    with live_page("Live", PageOptions(port=0, browser=False)) as server:
        sheet = live.LiveSheet(server)
        page = live.LivePage(sheet, 1.0, tmp_path)
        sheet._view.value = "3D"
        shown = [reader.read(image) for image in (unit.pressed, unit.rest)]
        for reading in shown:
            page.show(reading, reader, Latency())
        time.sleep(FIGURES_EVERY_S + 2 * LOADED_S)
        last = shown[-1].reading
        assert last is not None and last.words[0] in str(page._figures.content)
        assert sheet._surfaces._shown[""] is last
        assert [handle.visible for handle in sheet._surfaces._handles.values()] == [False, True]
        # A click shows it the other way, whether another frame comes or not.
        sheet._view.value = "pictures"
        sheet._choose()
        assert sheet._pictures[""] and not sheet._surfaces._shown


@pytest.mark.thorough
def test_depth_force_and_latency_follow_the_gel_until_it_is_stopped(tmp_path: Path) -> None:
    pytest.importorskip("viser", reason="the extra view is not installed")
    unit = grey_unit()
    camera = SteeredCamera(tmp_path, unit.rest, noise=0.5)
    results: list[LiveResult] = []

    def force(image: np.ndarray, background: np.ndarray) -> dict[str, float]:
        drop = float((background.astype(float) - image).mean())
        return {"Fz [N]": drop, "Fz +- [N]": 0.25}

    def run(page_of: live.LivePage) -> None:
        reader = lambda untouched: LiveReader(unit.profile, untouched, force=force)  # noqa: E731
        results.extend(run_together([live_session(reader, lambda: camera, [page_of])]))

    with live_page("Live", PageOptions(port=0, browser=False)) as server:
        shown = live.LivePage(live.LiveSheet(server), 15.0, tmp_path / "kept")
        session = threading.Thread(target=run, args=[shown], daemon=True)
        with chromium_page(page_address(server), (1360, 800)) as page:

            def says(words: str, **how: bool) -> None:
                page.get_by_text(words, **how).first.wait_for(timeout=SLOW_MS)

            def heading() -> float:
                said = page.locator("h2").inner_text()
                if said.startswith("no contact deeper than"):
                    return 0.0
                found = re.match(r"(\d\.\d+) ± \d\.\d+ mm deep", said)
                return float(found[1]) if found else float("nan")

            def told_force() -> float:
                return float(page.locator("p:has-text('Fz:') strong").inner_text().split()[0])

            def measure_rest(begin) -> None:
                """The message is looked for while time stands."""
                camera.time_stands = True
                begin()
                says("Touch nothing")
                camera.time_stands = False

            says("Stop")
            measure_rest(session.start)
            says("no contact deeper than")
            wait_for(page, lambda: page.get_by_text("Touch nothing").count() == 0)
            wait_for(page, lambda: heading() < 0.1, 60)
            untouched = yellow_share(page)
            camera.image = unit.pressed
            wait_for(page, lambda: abs(heading() - DEEPEST_MM) < 0.15, 60)
            wait_for(page, lambda: yellow_share(page) > untouched + 0.002, 60)
            wait_for(page, lambda: told_force() > 2, 60)
            says("± 0.25")
            rate = re.compile(r"(?!0\.0 )\d+\.\d frames a second")
            wait_for(page, lambda: rate.search(page.inner_text("body")))
            says("by the contact of an elastic layer")
            assert page.locator(".uplot canvas").count() == 3
            for stage in ("all work", "heights", "pressure", "force", "taken to shown"):
                told = re.compile(rf"^{stage}\s*\d")  # Not the legends of the curves.
                row = page.get_by_role("row").filter(has_text=told)
                assert float(row.get_by_role("cell").nth(1).inner_text()) > 0
            page.get_by_role("button", name="3D").click()
            says("mm (yellow)")
            # Pictures of an untouched gel are grey, the surface and what is around it are not.
            wait_for(page, lambda: grey_share(page) < 0.02 < violet_share(page), 60)
            page.get_by_role("button", name="pictures").click()
            wait_for(page, lambda: grey_share(page) > 0.05, 60)
            page.get_by_text("Snapshot", exact=True).click()
            says("snapshot_000_image.png")
            assert (tmp_path / "kept" / "snapshot_000.json").is_file()
            # A new untouched gel, of the ball as it lies: nothing is pressed in then.
            measure_rest(page.get_by_text("Take the untouched gel again").click)
            wait_for(page, lambda: heading() < 0.1, 60)
            page.get_by_text("Stop", exact=True).click()
            session.join(timeout=60)
            assert not session.is_alive()
    assert results[0].last is not None and results[0].latency.figures()["frames"] > 5
