# SPDX-License-Identifier: Apache-2.0
"""Rectified capture folders: images through the maps, what belongs to raw images left out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import taccel_lab.calibration.calibrate as whole
from taccel_lab.calibration.background.fit import calibrate_background
from taccel_lab.calibration.base_profile import base_profile, presses_on_camera
from taccel_lab.calibration.camera.rectification import RectificationMaps, rectify_captures
from taccel_lab.calibration.capture import CaptureFolder, load_capture_folder
from taccel_lab.calibration.capture.schema import CaptureManifest
from taccel_lab.calibration.depth.fit import grey_captures
from taccel_lab.calibration.scale.fit import calibrate_scale
from taccel_lab.errors import InputError
from taccel_lab.files.regular_file import file_sha256
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import CameraBlock
from taccel_lab.sensors.profile import catalogue_profile
from tests.support.capture_sets import edit_manifest, write_image
from tests.support.commands import done

LEFT, TOP = 12, 7
MANIFEST = """
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
"""


def cropping_maps(du: float = 0.0, dv: float = 0.0) -> RectificationMaps:
    """A part of the raw image, two columns of which lie beyond its border."""
    u, v = np.meshgrid(np.arange(50.0) + LEFT + du, np.arange(40.0) + TOP + dv)
    u[:, -2:] = -1e4
    grid = PixelGrid(50, 40, 0.11, 0.12)
    return RectificationMaps(
        u.astype(np.float32), v.astype(np.float32), np.ones((40, 50), bool), grid
    )


@pytest.fixture
def captures(tmp_path: Path) -> Path:
    folder, rng = tmp_path / "raw", np.random.default_rng(0)
    folder.mkdir()
    for name in ("bg", "p0", "p1", "board", "f0", "f1"):
        write_image(folder / f"{name}.png", rng.integers(0, 255, (60, 80, 3), dtype=np.uint8))
    mask = np.full((60, 80), 255, np.uint8)
    mask[TOP : TOP + 3] = 0
    write_image(folder / "mask.png", mask)
    (folder / "press.csv").write_text("depth_mm,force_n\n0.2,0.1\n0.5,0.4\n0.8,0.9\n")
    (folder / "captures.toml").write_text(MANIFEST)
    return folder


def rectified(
    captures: Path, maps: RectificationMaps | None = None
) -> tuple[CaptureFolder, list[str]]:
    """The captures through the maps, and what was left out of them."""
    out = captures.parent / "even"
    raw = load_capture_folder(captures)
    notes = rectify_captures(raw, maps or cropping_maps(), out, replace=True)
    return load_capture_folder(out), notes


def test_a_folder_is_rectified(captures: Path) -> None:
    raw, (even, notes) = load_capture_folder(captures), rectified(captures)
    part = (slice(TOP, TOP + 40), slice(LEFT, LEFT + 48))
    assert raw.background is not None and even.background is not None
    assert np.array_equal(even.background.image()[:, :48], raw.background.image()[part])
    for before, after in zip(raw.presses, even.presses, strict=True):
        assert before.name == after.name and after.circle is None
        assert np.array_equal(after.image()[:, :48], before.image()[part])
    assert even.mm_per_px == (0.11, 0.12) and even.mask is not None
    assert not even.mask[:, 48:].any() and not even.mask[:3].any() and even.mask[3:, :48].all()
    assert even.boards == () and even.markers is not None
    (video,) = even.markers.videos
    assert video.frame_count == 2 and next(video.frames()).shape == (40, 50, 3)
    assert np.array_equal(even.records[0].columns["force_n"], [0.1, 0.4, 0.9])
    assert notes == ["the contact circle of corner was left out", "boards were left out"]
    # What was rectified is recorded.
    manifest = CaptureManifest.read(even.root / "captures.toml")
    for name in ("bg.png", "p0.png", "p1.png", "captures.toml"):
        assert manifest.raw_sha256[name] == file_sha256(captures / name)
    assert even.provenance["raw_manifest_sha256"] == file_sha256(captures / "captures.toml")


def test_presses_of_one_name_are_kept_and_those_that_a_person_skipped_stay_out(captures) -> None:
    edit_manifest(captures, 'name = "corner"', 'name = "p0"')
    assert [press.name for press in rectified(captures)[0].presses] == ["p0", "p0"]
    edit_manifest(captures, 'name = "p0"', 'name = "corner"')
    (captures / "contacts.toml").write_text('[[contact]]\npress = "p0"\nskip = true\n')
    even, notes = rectified(captures)
    assert [press.name for press in even.presses] == ["corner"]
    assert "presses that contacts.toml skips were left out: p0" in notes


def test_a_calibration_names_what_the_user_gave(captures, monkeypatch) -> None:
    """Rectified captures lie in a folder that goes, and boards on the gel have given the scale."""
    seen: list[CaptureFolder] = []

    def refuse(folder: CaptureFolder, *_: object) -> None:
        seen.append(folder)
        raise InputError(f"{folder.root / 'background.png'} of {folder.source} is dark")

    found = SimpleNamespace(apply_to=lambda base: base, rectification=cropping_maps(), remarks=())
    found.scored = found
    fits = {"camera": lambda *_: found, "background": refuse}
    blocks = {
        name: SimpleNamespace(name=name, fit=fit, page=lambda *_: None, measures_scale=False)
        for name, fit in fits.items()
    }
    ready = dict.fromkeys(["camera", "background"], (None, ""))
    for name, stand_in in (("capture_check", None), ("_readiness", ready)):
        monkeypatch.setattr(whole, name, lambda *_, answer=stand_in: answer)
    monkeypatch.setattr(whole, "HOMES", blocks)
    monkeypatch.setattr(whole, "block_named", blocks.__getitem__)
    calibration = whole.calibrate(captures)
    source = f"{captures}/captures.toml"
    assert calibration.blocks[1].message == f"{captures}/background.png of {source} is dark"
    assert calibration.notes == ("the contact circle of corner was left out",)
    assert seen[0].source == source and seen[0].root != captures


def test_the_command_takes_saved_maps(captures, tmp_path, capsys) -> None:
    maps = tmp_path / "maps.npz"
    cropping_maps().save(maps)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "x.txt").write_text("keep")
    for out, code, said in (
        ("even", 0, "50x40 px at 0.11 x 0.12 mm/px"),
        ("mine", 2, "did not write"),
        ("other", 2, "not a readable .npz"),
    ):
        if out == "other":
            maps.write_bytes(b"no archive")
        ended = done(capsys, "capture", "rectify", captures, maps, tmp_path / out)
        assert ended.code == code and said in " ".join(ended.err.split())


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("map_u_px", np.full((40, 50), "x"), "map_u_px has type <U1"),
        ("map_v_px", np.full((40, 50), np.nan), r"map_v_px\[0, 0\] is nan"),
        ("measured", np.ones((3, 3), bool), "measured must have shape"),
        ("mm_per_px", np.ones(3), "mm_per_px must have shape"),
    ],
)
def test_maps_that_are_none_are_refused(key: str, value: np.ndarray, words: str, tmp_path) -> None:
    cropping_maps().save(tmp_path / "maps.npz")
    with np.load(tmp_path / "maps.npz") as stored:
        arrays: dict[str, Any] = {**stored, key: value}
    np.savez(tmp_path / "maps.npz", **arrays)
    with pytest.raises(InputError, match=words):
        RectificationMaps.load(tmp_path / "maps.npz")


@pytest.mark.parametrize(
    ("maps", "words"),
    [
        (replace(cropping_maps(), raw_size_px=(640, 480)), "of 640x480 px, these are 80x60 px"),
        (cropping_maps(80.0), "no pixel of the maps lies within .* 80x60 px"),
        (replace(cropping_maps(), grid=None), "a scale needs a board on the gel"),
    ],
)
def test_maps_that_do_not_go_with_the_captures_are_refused(maps, words: str, captures) -> None:
    with pytest.raises(InputError, match=words):
        rectified(captures, maps)
    assert not (captures.parent / "even").exists()


def test_the_picture_ends_with_the_middle_of_its_last_pixels() -> None:
    u, v = (np.array([row], np.float32) for row in ([0, 9, 9.1, -0.1, 4, 4], [0, 4, 2, 2, 4.1, -1]))
    maps = RectificationMaps(u, v, np.ones(u.shape, bool), None)
    assert maps.inside((5, 10)).tolist() == [[True, True, False, False, False, False]]


@pytest.mark.parametrize(("du", "dv"), [(45, 0), (0, -15), (-20, 25)])
def test_maps_may_reach_past_the_picture(captures: Path, du: int, dv: int) -> None:
    """As on units whose gel is not in the middle of the camera's picture."""
    maps = replace(cropping_maps(du, dv), raw_size_px=(80, 60))
    mask = rectified(captures, maps)[0].mask
    u, v = maps.map_u_px, maps.map_v_px
    outside = (u < 0) | (v < 0) | (u > 79) | (v > 59)
    assert mask is not None and outside.any() and mask.any() and not mask[outside].any()


def test_raw_images_do_not_go_with_a_profile_of_rectified_ones(captures: Path) -> None:
    profile = catalogue_profile("gelsight")
    grid = replace(profile.camera.grid(), width_px=50, height_px=40)
    block = CameraBlock.from_grid(grid, profile.camera.provenance, rectified=True)
    profile = profile.without("color", "background").with_block(block)
    raw, (even, _) = load_capture_folder(captures), rectified(captures)
    calls: tuple[Any, ...] = (presses_on_camera, calibrate_background, calibrate_scale)
    for call in (*calls, lambda folder, base: grey_captures(folder, base, None)):
        with pytest.raises(InputError, match=r"images are raw.*taccel-lab capture rectify"):
            call(raw, profile)
    # A profile that is made of rectified captures says so as well.
    assert presses_on_camera(even, catalogue_profile("gelsight"))[1].camera.rectified
    assert base_profile(None, even).camera.rectified
    assert not base_profile(None, raw).camera.rectified
    assert calibrate_background(even, profile).image.shape == (40, 50, 3)


@pytest.mark.parametrize("place", ["../evil.csv", "{absolute}"])
def test_nothing_is_written_beside_the_output(captures: Path, place: str) -> None:
    evil = captures.parent / "evil.csv"
    (captures / "press.csv").replace(evil)
    before = evil.read_bytes()
    edit_manifest(captures, '"press.csv"', f'"{place.format(absolute=evil)}"')
    with pytest.raises(InputError, match="folder"):
        rectified(captures)
    assert evil.read_bytes() == before and not (captures.parent / "even").exists()
