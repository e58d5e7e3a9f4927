# SPDX-License-Identifier: Apache-2.0
"""Rectified capture folders: images through the maps, what belongs to raw images left out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import taccel_lab.calibration.calibrate as whole
from taccel_lab.calibration.base_profile import base_profile, presses_on_camera
from taccel_lab.calibration.camera.rectification import RectificationMaps, rectify_captures
from taccel_lab.calibration.capture import CaptureFolder, load_capture_folder
from taccel_lab.calibration.capture.schema import CaptureManifest
from taccel_lab.calibration.grey.fit import grey_captures
from taccel_lab.calibration.light.background import calibrate_background
from taccel_lab.calibration.scale.fit import calibrate_scale
from taccel_lab.cli.app import main
from taccel_lab.errors import InputError
from taccel_lab.files.regular_file import file_sha256
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import CameraBlock
from taccel_lab.sensors.profile import catalogue_profile

RAW = (60, 80)
LEFT, TOP = 12, 7
NOW = None, ""
"""State and message of a block that is to be fitted."""
GRID = PixelGrid(50, 40, 0.11, 0.12)


def cropping_maps() -> RectificationMaps:
    """A part of the raw image, two columns of which lie beyond its border."""
    u, v = np.meshgrid(np.arange(50.0) + LEFT, np.arange(40.0) + TOP)
    u[:, -2:] = -1e4
    return RectificationMaps(
        u.astype(np.float32), v.astype(np.float32), np.ones((40, 50), dtype=bool), GRID
    )


@pytest.fixture
def captures(tmp_path: Path) -> Path:
    folder = tmp_path / "raw"
    folder.mkdir()
    rng = np.random.default_rng(0)
    for name in ("bg", "p0", "p1", "board", "f0", "f1"):
        cv2.imwrite(str(folder / f"{name}.png"), rng.integers(0, 255, (*RAW, 3), dtype=np.uint8))
    mask = np.full(RAW, 255, dtype=np.uint8)
    mask[TOP : TOP + 3] = 0
    cv2.imwrite(str(folder / "mask.png"), mask)
    (folder / "press.csv").write_text("depth_mm,force_n\n0.2,0.1\n0.5,0.4\n0.8,0.9\n")
    (folder / "captures.toml").write_text("""
schema_version = 2
sensor = "flat_pad"
background = "bg.png"
mask = "mask.png"
[indenter]
radius_mm = 2.0
[[presses]]
image = "p0.png"
[[presses]]
image = "p1.png"
name = "corner"
contact = { u_px = 40.0, v_px = 30.0, radius_px = 9.0 }
[[boards]]
kind = "dots"
columns = 5
rows = 4
pitch_mm = 1.0
on_gel = true
images = ["board.png"]
[markers]
[[markers.videos]]
frames = ["f*.png"]
[[records]]
file = "press.csv"
kind = "indentation"
tool = { kind = "sphere", radius_mm = 4.0 }
""")
    return folder


def test_a_folder_is_rectified(captures: Path, tmp_path: Path) -> None:
    raw = load_capture_folder(captures)
    notes = rectify_captures(raw, cropping_maps(), tmp_path / "even")
    even = load_capture_folder(tmp_path / "even")
    part = (slice(TOP, TOP + 40), slice(LEFT, LEFT + 48))
    assert raw.background is not None and even.background is not None
    assert np.array_equal(even.background.image()[:, :48], raw.background.image()[part])
    for before, after in zip(raw.presses, even.presses, strict=True):
        assert before.name == after.name and after.circle is None
        assert np.array_equal(after.image()[:, :48], before.image()[part])
    assert even.mm_per_px == (0.11, 0.12)
    assert even.mask is not None
    assert not even.mask[:, 48:].any() and not even.mask[:3].any() and even.mask[3:, :48].all()
    assert even.boards == () and even.markers is not None
    (video,) = even.markers.videos
    assert video.frame_count == 2 and next(video.frames()).shape == (40, 50, 3)
    assert np.array_equal(even.records[0].columns["force_n"], [0.1, 0.4, 0.9])
    assert notes == ["the contact circle of corner was left out", "boards were left out"]
    # What was rectified is recorded.
    manifest = CaptureManifest.read(tmp_path / "even" / "captures.toml")
    for name in ("bg.png", "p0.png", "p1.png", "captures.toml"):
        assert manifest.raw_sha256[name] == file_sha256(captures / name)
    assert even.provenance["raw_manifest_sha256"] == file_sha256(captures / "captures.toml")


def test_presses_that_a_person_skipped_stay_out(captures: Path, tmp_path: Path) -> None:
    (captures / "contacts.toml").write_text('[[contact]]\npress = "p0"\nskip = true\n')
    notes = rectify_captures(load_capture_folder(captures), cropping_maps(), tmp_path / "even")
    even = load_capture_folder(tmp_path / "even")
    assert [press.name for press in even.presses] == ["corner"]
    assert "presses that contacts.toml skips were left out: p0" in notes


def test_a_calibration_names_what_the_user_gave(
    captures: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rectified captures lie in a folder that goes, and boards on the gel have given the scale."""
    seen: list[CaptureFolder] = []

    def refuse(folder: CaptureFolder, *_: object) -> None:
        seen.append(folder)
        raise InputError(f"{folder.root / 'background.png'} of {folder.source} is dark")

    found = SimpleNamespace(apply_to=lambda base: base, maps=cropping_maps, remarks=())
    found.scored = found
    blocks = (
        SimpleNamespace(name="camera", fit=lambda *_: found, page=lambda *_: None),
        SimpleNamespace(name="background", fit=refuse),
    )
    monkeypatch.setattr(whole, "BLOCKS", blocks)
    monkeypatch.setattr(whole, "capture_check", lambda *_: None)
    monkeypatch.setattr(whole, "_readiness", lambda _: dict.fromkeys(["camera", "background"], NOW))
    calibration = whole.calibrate(captures)
    told = f"{captures}/background.png of {captures}/captures.toml is dark"
    assert calibration.blocks[1].message == told
    assert calibration.notes == ("the contact circle of corner was left out",)
    assert seen[0].source == f"{captures}/captures.toml" and seen[0].root != captures


def test_two_presses_of_one_name(captures: Path, tmp_path: Path) -> None:
    manifest = captures / "captures.toml"
    text = manifest.read_text()
    assert 'image = "p1.png"' in text
    manifest.write_text(text.replace('name = "corner"', 'name = "p0"'))
    rectify_captures(load_capture_folder(captures), cropping_maps(), tmp_path / "even")
    even = load_capture_folder(tmp_path / "even")
    assert [press.name for press in even.presses] == ["p0", "p0"]


def test_the_command_takes_saved_maps(
    captures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cropping_maps().save(tmp_path / "maps.npz")
    arguments = ["capture", "rectify", str(captures), str(tmp_path / "maps.npz")]
    assert main([*arguments, str(tmp_path / "even")]) == 0
    assert "50x40 px at 0.11 x 0.12 mm/px" in " ".join(capsys.readouterr().err.split())
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "x.txt").write_text("keep")
    assert main([*arguments, str(tmp_path / "mine")]) == 2
    assert "did not write" in capsys.readouterr().err
    (tmp_path / "maps.npz").write_bytes(b"no archive")
    assert main([*arguments, str(tmp_path / "other")]) == 2
    assert "not a readable .npz" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [("map_u_px", np.full((40, 50), "x"), "map_u_px has type <U1"),
     ("map_v_px", np.full((40, 50), np.nan), r"map_v_px\[0, 0\] is nan"),
     ("measured", np.ones((3, 3), bool), "measured must have shape"),
     ("mm_per_px", np.ones(3), "mm_per_px must have shape")],
)  # fmt: skip
def test_maps_that_are_none_are_refused(
    key: str, value: np.ndarray, words: str, tmp_path: Path
) -> None:
    cropping_maps().save(tmp_path / "maps.npz")
    with np.load(tmp_path / "maps.npz") as stored:
        arrays = {**stored, key: value}
    np.savez(tmp_path / "maps.npz", **arrays)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=words):
        RectificationMaps.load(tmp_path / "maps.npz")


def test_maps_that_do_not_go_with_the_captures_are_refused(captures: Path, tmp_path: Path) -> None:
    raw, maps = load_capture_folder(captures), cropping_maps()
    lens = RectificationMaps(maps.map_u_px, maps.map_v_px, maps.measured, None)
    for bad, words in (
        (replace(maps, raw_size_px=(640, 480)), "for images of 640x480 px, these are 80x60 px"),
        (
            replace(maps, map_u_px=maps.map_u_px + 80),
            "no pixel of the maps lies within .* 80x60 px",
        ),
        (lens, "a scale needs a board on the gel"),
    ):
        with pytest.raises(InputError, match=words):
            rectify_captures(raw, bad, tmp_path / "even")
    assert not (tmp_path / "even").exists()


@pytest.mark.parametrize("shift", [(45, 0), (0, -15), (-20, 25)])
def test_maps_may_reach_past_the_picture(
    captures: Path, tmp_path: Path, shift: tuple[int, int]
) -> None:
    """As on units whose gel is not in the middle of the camera's picture."""
    maps = cropping_maps()
    u, v = maps.map_u_px + np.float32(shift[0]), maps.map_v_px + np.float32(shift[1])
    rectify_captures(
        load_capture_folder(captures),
        replace(maps, map_u_px=u, map_v_px=v, raw_size_px=(80, 60)),
        tmp_path / "even",
    )
    even = load_capture_folder(tmp_path / "even")
    assert even.mask is not None
    outside = (u < 0) | (v < 0) | (u > 79) | (v > 59)
    assert outside.any() and even.mask.any() and not even.mask[outside].any()


def test_raw_images_do_not_go_with_a_profile_of_rectified_ones(
    captures: Path, tmp_path: Path
) -> None:
    profile = catalogue_profile("gelsight")
    grid = replace(profile.camera.grid(), width_px=50, height_px=40)
    block = CameraBlock.from_grid(grid, profile.camera.provenance, rectified=True)
    profile = profile.without("color", "background").with_block(block)
    raw = load_capture_folder(captures)
    rectify_captures(raw, cropping_maps(), tmp_path / "even")
    even = load_capture_folder(tmp_path / "even")
    for call in (presses_on_camera, calibrate_background, calibrate_scale, grey_captures):
        more = (None,) if call is grey_captures else ()
        with pytest.raises(InputError, match=r"images are raw.*taccel-lab capture rectify"):
            call(raw, profile, *more)
    # A profile that is made of rectified captures says so as well.
    assert presses_on_camera(even, catalogue_profile("gelsight"))[1].camera.rectified
    assert base_profile(None, even).camera.rectified
    assert not base_profile(None, raw).camera.rectified
    assert calibrate_background(even, profile).image.shape == (40, 50, 3)


@pytest.mark.parametrize("place", ["../evil.csv", "{absolute}"])
def test_nothing_is_written_beside_the_output(captures: Path, tmp_path: Path, place: str) -> None:
    evil = tmp_path / "evil.csv"
    (captures / "press.csv").replace(evil)
    text = (captures / "captures.toml").read_text()
    name = place.format(absolute=evil)
    (captures / "captures.toml").write_text(text.replace('"press.csv"', f'"{name}"'))
    before = evil.read_bytes()
    with pytest.raises(InputError, match="folder"):
        rectify_captures(load_capture_folder(captures), cropping_maps(), tmp_path / "even")
    assert evil.read_bytes() == before and not (tmp_path / "even").exists()
