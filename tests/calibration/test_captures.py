# SPDX-License-Identifier: Apache-2.0
"""Capture folders and taxim's packs: what loads, and every way either can be refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from taccel_lab.calibration.capture import CaptureSet, ContactCircle, import_captures, load_captures
from taccel_lab.calibration.capture.captures import EQUATOR_SLACK, check_place, check_radius
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from tests.support.capture_sets import edit_manifest, write_image

MANIFEST = """
schema_version = 1
sensor = "gelsight"
background = "background.png"
mm_per_px_x = 0.1
mm_per_px_y = 0.1
[indenter]
radius_mm = 2.0
[[presses]]
image = "a.png"
contact = { u_px = 30.0, v_px = 25.0, radius_px = 12.0 }
[[presses]]
image = "b.png"
name = "second"
"""
NO_PRESSES = f"presses = []{MANIFEST[: MANIFEST.index('[[presses]]')]}"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    grey, mask = np.full((48, 64, 3), 90, np.uint8), np.full((48, 64), 255, np.uint8)
    mask[:10] = 0
    images = {"background": grey, "a": grey, "mask": mask, "black": 0 * mask}
    for name, image in {**images, "b": grey * np.array([2, 0, 0], np.uint8)}.items():
        write_image(tmp_path / f"{name}.png", image)
    (tmp_path / "captures.toml").write_text(MANIFEST)
    return tmp_path


def test_loads_a_folder_as_rgb(folder: Path) -> None:
    captures = load_captures(folder)
    first, second = captures.presses
    assert (first.name, second.name) == ("a", "second")
    assert (first.circle, second.circle) == (ContactCircle(30.0, 25.0, 12.0), None)
    assert second.image()[0, 0].tolist() == [180, 0, 0]
    assert captures.grid == PixelGrid(64, 48, 0.1, 0.1)
    hashes = captures.hashes()
    assert set(hashes) == {"background", "a", "second"}
    # a.png and background.png are the same bytes, b.png is not.
    assert hashes["a"] == hashes["background"] != hashes["second"]
    mask = load_captures(edit_manifest(folder, "sensor", 'mask = "mask.png"\nsensor')).mask
    assert not mask[:10].any() and mask[10:].all()


@pytest.mark.parametrize(
    ("name", "said"), [("nowhere", "nowhere does not exist"), ("", "an empty folder")]
)
def test_folders_without_captures_are_refused(tmp_path: Path, name: str, said: str) -> None:
    with pytest.raises(InputError, match=rf"{said}.*captures\.toml"):
        load_captures(tmp_path / name)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("mm_per_px_x = 0.1", "mm_per_px_x = nan", r"mm_per_px_x.*"),
        ("mm_per_px_x = 0.1", "mm_per_px_x = 0.0", r"mm_per_px_x.*greater than or equal.*0\.0001"),
        ("mm_per_px_y = 0.1", "mm_per_px_y = 500.0", r"mm_per_px_y.*less than or equal to 1.*500"),
        ("radius_mm = 2.0", "radius_mm = -2.0", r"indenter\.radius_mm.*greater than"),
        ("radius_mm = 2.0", "radius_mm = 1.0", r"a\.png: contact radius .*more than the ball"),
        ("schema_version = 1", "schema_version = 9", r"schema_version.*should be 1 or 2"),
        ('name = "second"', "colour = 3", r"presses\.1\.colour: unknown key"),
        ('name = "second"', 'name = "a"', r"names must differ, a appears twice"),
        ("u_px = 30.0", "u_px = nan", r"presses\.0\.contact\.u_px.*finite"),
        ("u_px = 30.0", "u_px = 99.0", r"a\.png: the contact .*outside of the image of 64x48"),
        ("radius_px = 12.0", "radius_px = 1.0", r"contact radius 1 px is too small"),
        ("radius_px = 12.0", "radius_px = -1.0", r"radius_px.*greater than 0"),
        ("schema_version = 1", "schema_version =", r"not valid TOML"),
        (MANIFEST, NO_PRESSES, r"captures\.toml holds no presses; at least one"),
        ("schema_version", 'mask = "black.png"\nschema_version', r"black\.png masks every pixel"),
    ],
)
def test_bad_manifest(folder: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        load_captures(edit_manifest(folder, old, new))
    assert str(folder) in str(caught.value)


def write_pack(folder: Path, scale: float = 0.1, **changes: object) -> Path:
    frames = np.zeros((2, 48, 64, 3), np.uint8)
    frames[..., 0] = 50  # blue
    arrays = {
        "f0": np.full((48, 64, 3), 9, np.uint8),
        "imgs": frames,
        "touch_center": np.array([[30.0, 24.0], [33.0, 24.0]]),
        "touch_radius": np.array([12, 13]),
        **changes,
    }
    path = folder / "dataPack.npz"
    np.savez(path, **{k: v for k, v in arrays.items() if v is not None})  # type: ignore[arg-type]
    (folder / "params.json").write_text(json.dumps({"sensor": {"pixmm": scale}}))
    return path


def test_pack_becomes_the_same_folder(tmp_path: Path) -> None:
    pack = write_pack(tmp_path)
    direct = load_captures(pack)
    assert direct.presses[0].image()[0, 0].tolist() == [0, 0, 50]
    imported = load_captures(import_captures(pack, tmp_path / "out", "taxim")[0])
    assert imported.grid == direct.grid
    assert np.array_equal(imported.background, direct.background)
    for a, b in zip(imported.presses, direct.presses, strict=True):
        assert (a.name, a.circle) == (b.name, b.circle)
        assert np.array_equal(a.image(), b.image())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"f0": None}, r"lacks f0"),
        ({"f0": np.uint8(3)}, r"f0 must have shape"),
        ({"imgs": np.zeros((0, 48, 64, 3), np.uint8)}, r"at least one frame"),
        ({"imgs": np.zeros((2, 40, 64, 3), np.uint8)}, r"must have shape \[frames, 48, 64, 3\]"),
        ({"touch_center": np.array([[30.0, np.nan], [33.0, 24.0]])}, r"\[0, 1\].*finite"),
        ({"touch_center": np.full((2, 2), "x")}, r"touch_center has type <U1; real numbers"),
        ({"touch_center": np.array([[30.0, 24.0], [-3.0, 24.0]])}, r"\[1\].*into the image"),
        ({"touch_radius": np.array([12, 13, 14])}, r"touch_radius must have shape \[2\]"),
        ({"touch_radius": np.array([12, 21])}, r"\[1\].*(more than the ball|outside)"),
        ({"scale": 0.0}, r"params\.json: sensor\.pixmm is"),
        ({"scale": -0.1}, r"params\.json: sensor\.pixmm is"),
        ({"scale": 40.0}, r"params\.json: sensor\.pixmm is"),
    ],
)
def test_bad_pack(tmp_path: Path, changes: dict, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        load_captures(write_pack(tmp_path, **changes))
    assert str(tmp_path) in str(caught.value)


@example(u=80.0, v=60.0, radius=25 * (1 + EQUATOR_SLACK), ball=5.0)
@given(
    u=st.floats(-50, 250), v=st.floats(-50, 200), radius=st.floats(0.1, 120), ball=st.floats(0.5, 9)
)
def test_accepted_circles_fit_image_and_ball(u, v, radius, ball) -> None:
    grid, circle = PixelGrid(160, 120, 0.1, 0.05), ContactCircle(u, v, radius)
    fits = 3 <= radius <= EQUATOR_SLACK * ball / 0.1 and 0 <= u <= 159 and 0 <= v <= 119
    rows = radius * 0.1 / 0.05
    inside = radius <= u <= 159 - radius and rows <= v <= 119 - rows
    assert abs(circle.beyond_px(grid)) < 1e-9 or (circle.beyond_px(grid) < 0) == inside
    assert circle.has_center_in(grid) == (0 <= u <= 159 and 0 <= v <= 119)
    try:
        check_place(circle, grid, "x.png")
        check_radius(circle, grid, ball, "x.png")
        accepted = True
    except InputError as error:
        assert "x.png" in str(error)
        accepted = False
    assert accepted == fits or abs(radius * 0.1 - EQUATOR_SLACK * ball) < 1e-9


def test_taxim_presses(taxim_captures: CaptureSet) -> None:
    assert len(taxim_captures.presses) == 48
    assert taxim_captures.grid == PixelGrid(640, 480, 0.0295, 0.0295)
    split = taxim_captures.split(4)
    assert len(split.train) == 36 and len(split.heldout) == 12 and split.by == "place"
