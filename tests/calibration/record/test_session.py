# SPDX-License-Identifier: Apache-2.0
"""What a session writes is a capture folder, at every moment, through kills and lost cameras."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.calibrate import calibrate
from taccel_lab.calibration.capture import load_capture_folder
from taccel_lab.calibration.capture.camera.camera import CameraInfo, Shot
from taccel_lab.calibration.capture.camera.replay import CameraReplay, open_camera
from taccel_lab.calibration.capture.sensor_facts import catalogue_scale
from taccel_lab.calibration.check import check_captures
from taccel_lab.calibration.profile_page import profile_page
from taccel_lab.calibration.record.folder import QUICK_LEAVES_OUT, RecordFacts, open_record
from taccel_lab.calibration.record.lamps import FROZEN_S, Lamp
from taccel_lab.calibration.record.session import Recorder, SessionStatus
from taccel_lab.errors import InputError
from taccel_lab.profile import load_profile, save_profile
from tests.calibration.drawn.faults import quantise
from tests.calibration.record.sessions import (
    FACTS,
    NOISY,
    UnpluggedCamera,
    Watching,
    record,
    source,
)
from tests.support.capture_sets import gel, write_image
from tests.support.small_captures import everything_below

FRAMES = 50
CATALOGUE = RecordFacts("gelsight_mini", radius_mm=2.0, scale="catalogue", quick=True)


def written(folder: Path, frames: list[np.ndarray]) -> Path:
    folder.mkdir()
    for k, frame in enumerate(frames):
        write_image(folder / f"{k:03d}.png", frame)
    return folder


def noisy(count: int = FRAMES, gains: tuple[float, ...] = (1.0,)) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [
        quantise(gel() * gains[k % len(gains)] + rng.normal(0, 1, gel().shape))
        for k in range(count)
    ]


def shown(folder: Path, frames: list[np.ndarray], out: Path) -> list[SessionStatus]:
    """What a session says of frames."""
    written(folder, frames)
    return record(lambda: open_camera(str(folder), None, CameraReplay()), out, 1)


def lamp(status: SessionStatus, name: str) -> Lamp:
    return next(lamp for lamp in status.lamps if lamp.name == name)


@pytest.mark.thorough
def test_the_folder_is_one_that_checks_and_calibrations_read(tmp_path: Path) -> None:
    original = source(tmp_path / "set", 5)
    status = record(original, tmp_path / "out", 5)[-1]
    assert status.finished and status.taken == 5
    made, given = load_capture_folder(tmp_path / "out"), load_capture_folder(original)
    assert made.ball_radius_mm == given.ball_radius_mm and made.mm_per_px == given.mm_per_px
    assert made.heldout is not None and made.untouched
    for mine, theirs in zip(made.presses, given.presses, strict=True):
        apart = mine.image().astype(float) - theirs.image()
        assert apart.std() < 2 * NOISY.noise_levels  # the very press, and no frame on the way
    check = check_captures(made, fit_ball=False)
    assert all(frame.contact is not None for frame in check.frames)


@pytest.mark.thorough
def test_the_same_command_goes_on_and_clears_what_a_kill_left(tmp_path: Path) -> None:
    path, out = source(tmp_path / "set", 3), tmp_path / "out"
    record(path, out, watching=Watching({110: "finish"}))
    before = [press.sha256 for press in load_capture_folder(out).presses]
    assert 0 < len(before) < 3
    # Killed with an image in hand: whole without its line, or half under another name.
    for name in (f"press_{len(before):03d}.png", ".press_001.abc.png", ".captures.abc.toml"):
        (out / name).write_bytes(b"torn")
    status = record(path, out, facts=RecordFacts("flat_pad"))[-1]  # What is known goes unstated.
    after = load_capture_folder(out)
    assert status.finished and [p.sha256 for p in after.presses][: len(before)] == before
    assert len(after.untouched) >= 1  # The gel at the start of the second session.
    names = sorted(p.name for p in out.iterdir() if not p.name.startswith("untouched"))
    assert names == ["background.png", "captures.toml", *(f"press_{k:03d}.png" for k in range(3))]


@pytest.mark.thorough
def test_a_camera_may_go_and_come_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("taccel_lab.calibration.capture.camera.camera.AGAIN_S", 0.0)
    camera = UnpluggedCamera(source(tmp_path / "set", 3), lost_at=(30, 75, 120))
    seen = record(camera.open, tmp_path / "out")
    assert camera.opened == 4
    gone = [status.prompt for status in seen if "camera is gone" in status.prompt]
    assert len(gone) == 9 and "nothing is lost" in gone[0]  # the loss, and two refusals each
    assert len(load_capture_folder(tmp_path / "out").presses) >= 2


@pytest.mark.thorough
def test_take_undo_and_finish(tmp_path: Path) -> None:
    orders = Watching({47: "take", 55: "undo", 58: "finish"})  # Before it stands still.
    seen = record(source(tmp_path / "set", 2), tmp_path / "out", 5, watching=orders)
    counts = [status.taken for status in seen]
    assert counts[46] == 0 and counts[47] == 1 and counts[-1] == 0 and seen[-1].finished
    assert len(load_capture_folder(tmp_path / "out").presses) == 0


def test_the_picture_of_a_press_that_is_refused_does_not_stay(tmp_path: Path) -> None:
    facts, out = replace(FACTS, camera=CameraInfo("usb-1", "mine")), tmp_path / "out"
    with open_record(out, facts) as folder:
        folder.set_background(quantise(gel()), facts)
        (out / "captures.toml").rename(out / "mine.toml")
        (out / "captures.toml").symlink_to("mine.toml")
        before = everything_below(out)
        for take in (folder.add_press, folder.add_untouched):
            with pytest.raises(InputError, match=r"captures\.toml is a link"):
                take(quantise(gel()))
        assert everything_below(out) == before
        (out / "mine.toml").replace(out / "captures.toml")
        assert folder.add_press(quantise(gel())) == "press_000.png"
    assert len(load_capture_folder(out).presses) == 1


def test_all_missing_facts_are_named_at_once(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"(?s)--radius-mm.*--mm-per-px-x.*--scale later"):
        record(tmp_path, tmp_path / "out", facts=RecordFacts("gelsight_mini"))
    assert not (tmp_path / "out").exists()


@pytest.mark.thorough
def test_folders_of_others_and_other_sizes_are_refused(tmp_path: Path) -> None:
    imported, out = source(tmp_path / "set", 2), tmp_path / "out"
    (written(tmp_path / "notes", []) / "mine.txt").write_text("mine")
    wide = written(tmp_path / "wide", [np.full((100, 200, 3), 90, np.uint8)] * 20)
    record(imported, out, 1)
    for camera, folder, facts, said in (
        (imported, imported, FACTS, "did not write"),
        (imported, tmp_path / "notes", FACTS, r"mine\.txt"),
        (imported, out, replace(FACTS, radius_mm=3.0), "begun otherwise"),
        (wide, out, FACTS, "200x100"),
    ):
        with pytest.raises(InputError, match=said):
            record(camera, folder, 2, facts)
    with open_record(out, FACTS), pytest.raises(InputError, match="another taccel"):
        record(imported, out)


@pytest.mark.thorough
def test_a_scale_of_the_catalogue_is_noted_as_assumed(tmp_path: Path) -> None:
    record(source(tmp_path / "set", 1), tmp_path / "out", 1, CATALOGUE)
    made = load_capture_folder(tmp_path / "out")
    assert made.mm_per_px is not None and "mm_per_px" in made.assumed
    text = (tmp_path / "out" / "captures.toml").read_text()
    assert text.startswith("# a quick session, which leaves out:") and "# - force" in text
    with pytest.raises(InputError, match="--crop"):
        catalogue_scale(CATALOGUE.sensor, 320, 320)


@pytest.mark.thorough
def test_images_that_cannot_have_the_catalogues_scale_leave_nothing(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    turned = [quantise(rng.normal(90.0, 1.0, (320, 240, 3))) for _ in range(80)]
    path, watching = written(tmp_path / "turned", turned), Watching()
    with pytest.raises(InputError, match="turned by a quarter: turn the camera back"):
        record(path, tmp_path / "new" / "out", 1, CATALOGUE, watching)
    assert watching.seen == [], "refused at the first frame"
    assert not (tmp_path / "new").exists()


@pytest.mark.thorough
def test_lamps_say_what_is_wrong(tmp_path: Path) -> None:
    path = source(tmp_path / "set", 2)
    bright = quantise(2.2 * load_capture_folder(path).presses[0].image().astype(float))
    write_image(path / "p00.png", bright)
    seen = record(path, tmp_path / "out", 2)
    bad = {lamp.name for status in seen for lamp in status.lamps if lamp.state == "bad"}
    assert {"saturation", "drift"} <= bad
    assert {lamp(seen[50], name).state for name in ("saturation", "drift", "blur")} == {"ok"}


@pytest.mark.thorough
@pytest.mark.parametrize(("level", "said"), [(0, "black"), (255, "white")])
def test_the_untouched_gel_waits_until_one_is_seen(tmp_path: Path, level: int, said: str) -> None:
    blank = [np.full(gel().shape, level, np.uint8)] * FRAMES
    last = shown(tmp_path / "blank", blank, tmp_path / "none")[-1]
    assert said in last.prompt and said in last.unseen
    assert not (tmp_path / "none").exists()
    last = shown(tmp_path / "later", [*blank, *noisy()], tmp_path / "out")[-1]
    assert last.prompt.startswith("Press next") and last.unseen == ""
    background = load_capture_folder(tmp_path / "out").background
    assert background is not None
    assert np.abs(background.image().astype(float) - gel()).mean() < 2.0


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("gains", "state", "said"), [((1.0,), "ok", ""), ((0.9, 1.1), "bad", "10 ms")]
)
def test_light_that_flickers_lights_its_lamp(tmp_path: Path, gains, state: str, said: str) -> None:
    seen = shown(tmp_path / "frames", noisy(gains=gains), tmp_path / "out")
    flicker = lamp(seen[-1], "flicker")
    assert flicker.state == state and said in flicker.text


@pytest.mark.thorough
@pytest.mark.parametrize("replayed", [False, True])
def test_a_camera_that_hangs_is_told_a_replay_is_not(tmp_path: Path, replayed: bool) -> None:
    with open_record(tmp_path / "out", FACTS) as folder:
        recorder = Recorder(folder, FACTS, 1)
        recorder.opened(CameraInfo("usb-1", "mine", replayed=replayed), [])
        frames = noisy()
        hanging = [frames[-1]] * int(25 * (FROZEN_S + 1))
        for k, image in enumerate([*frames, *hanging]):
            status = recorder.see(Shot(image, k / 25))
        camera = lamp(status, "camera")
        assert ("hangs" in status.prompt) is not replayed
        assert ("hangs" in camera.text and camera.state == "bad") is not replayed
        status = recorder.see(Shot(frames[0], FRAMES / 25 + FROZEN_S + 1.1))
        assert "hangs" not in status.prompt


def test_images_too_small_to_calibrate_leave_nothing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="16x12 px; at least 32x32"):
        shown(tmp_path / "small", [np.full((12, 16, 3), 90, np.uint8)] * 5, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.thorough
def test_the_profile_and_its_page_say_how_captures_were_recorded(tmp_path: Path) -> None:
    path, out = source(tmp_path / "set", 2), tmp_path / "out"
    record(path, out, 2, replace(FACTS, quick=True, source="bench 2, by Ada"))
    profile = calibrate(out, only=["background"]).profile
    save_profile(profile, tmp_path / "profile")
    (session,) = load_profile(tmp_path / "profile").sensor.recorded
    assert session.blocks == ("background", "perturbation")
    assert session.camera == str(path) and session.source == "bench 2, by Ada"
    assert session.controls["exposure"] == "as it was recorded"
    assert session.left_out == QUICK_LEAVES_OUT
    assert session.begun and datetime.now(UTC) - session.begun < timedelta(minutes=5)
    (table,) = [table for table in profile_page(profile).tables if table.title == "Recordings"]
    told = {row[0]: row[1] for row in table.rows}
    assert told["camera"] == str(path) and told["blocks"] == "background, perturbation"
    assert [row[1] for row in table.rows if row[0] == "left out"] == list(QUICK_LEAVES_OUT)
    # Another session's background takes the block over; what nobody recorded says nothing.
    both = session.model_copy(update={"blocks": ("background", "color")})
    older = profile.with_block(profile.sensor.replace(recorded=(both,)))
    assert load_capture_folder(path).recorded is None
    (left,) = calibrate(path, older, only=["background"]).profile.sensor.recorded
    assert left.blocks == ("color",) and left.camera == session.camera
