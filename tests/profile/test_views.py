# SPDX-License-Identifier: Apache-2.0
"""Several cameras in one profile: each is an ordinary profile, kept and refused by name."""

from __future__ import annotations

import hashlib
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.datasets.sensor import profile_digest
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import (
    CameraBlock,
    SensorProfile,
    SensorView,
    load_profile,
    save_profile,
    validate_profile,
)
from taccel_lab.profile.quarter_turn import quarter_turned
from tests.profile.test_io import assert_same
from tests.support.edited_profiles import edit
from tests.support.sample_blocks import ASSUMED

SMALL = PixelGrid(8, 6, 0.04, 0.04)


@pytest.fixture(scope="module")
def two_eyes(full_profile: SensorProfile) -> SensorProfile:
    """The full profile, and an eye of other pixels, without colours, under the name left."""
    eye = full_profile.without("background", "color", "optics")
    return full_profile.with_view("left", eye.with_block(CameraBlock.from_grid(SMALL, ASSUMED)))


@pytest.fixture
def folder(two_eyes: SensorProfile, tmp_path: Path) -> Path:
    save_profile(two_eyes, tmp_path / "p")
    return tmp_path / "p"


def test_views_are_ordinary_profiles(two_eyes: SensorProfile, full_profile: SensorProfile) -> None:
    assert two_eyes.view_names() == ("main", "left")
    left, main = two_eyes.seen_by("left"), two_eyes.seen_by("main")
    assert left.grid() == SMALL and left.view_names() == ("main",)
    assert left.mesh is two_eyes.mesh and left.lights == two_eyes.lights
    # What an eye has not is not the main camera's.
    assert left.background_rgb is None and left.color is None and left.optics is None
    assert_same(main, full_profile)
    assert full_profile.seen_by("main") is full_profile
    stiffer = two_eyes.with_block(two_eyes.material.replace(young_modulus_pa=3e5))
    assert stiffer.seen_by("left").material.young_modulus_pa == 3e5
    with pytest.raises(InputError, match=r"has no view 'right'; known: main, left"):
        two_eyes.seen_by("right")
    # Views change places.
    swapped = two_eyes.with_view("right", two_eyes).with_view("main", left)
    assert swapped.grid() == SMALL and swapped.view_names() == ("main", "left", "right")
    assert_same(swapped.seen_by("right"), main)
    # A turned sensor turns all its cameras.
    turned = quarter_turned(two_eyes).seen_by("left")
    assert turned.grid().width_px == SMALL.height_px
    assert_same(turned, quarter_turned(left))


def test_views_are_written_and_read(two_eyes: SensorProfile, folder: Path, tmp_path: Path) -> None:
    assert validate_profile(folder) == []
    again = load_profile(folder)
    for name in two_eyes.view_names():
        assert_same(again.seen_by(name), two_eyes.seen_by(name))
        assert_same(load_profile(f"{folder}@{name}"), two_eyes.seen_by(name))
    assert profile_digest(again) == profile_digest(two_eyes)
    assert profile_digest(again) != profile_digest(two_eyes.seen_by("main"))
    save_profile(again.seen_by("left"), folder)
    assert not (folder / "views").exists()
    assert_same(pickle.loads(pickle.dumps(again.seen_by("left"))), two_eyes.seen_by("left"))
    with pytest.raises(InputError, match=r"has no view 'up'; known: main$"):
        load_profile(f"{folder}@up")


@pytest.mark.parametrize("name", ["main", "", "../left", "Left", "a" * 41, "a b"])
def test_names_that_cannot_be_are_refused(full_profile: SensorProfile, name: str) -> None:
    if name != "main":
        with pytest.raises(InputError, match="is no name of a view"):
            full_profile.with_view(name, full_profile)
    with pytest.raises(InputError, match="is no name of a view"):
        replace(full_profile, views={name: SensorView.of(full_profile)})
    # One that looks beside the gel, by its name.
    beside = CameraBlock.from_grid(PixelGrid(12, 9, 0.03, 0.03, center_u_px=5e3), ASSUMED)
    eye = replace(SensorView.of(full_profile.without("background", "color")), camera=beside)
    with pytest.raises(InputError, match=r"views\.left: camera: the image's middle lies at x"):
        replace(full_profile, views={"left": eye})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"camera": None}, "left/profile.toml: camera: the table is missing"),
        ({"sensor": None}, "left/profile.toml: sensor: the table is missing"),
        ({"lights": {}}, "left/profile.toml: lights: unknown key; allowed: schema_version"),
        ({"views": {}}, "left/profile.toml: views: unknown key"),
        ({"files": {"mesh.npz": "0" * 64}}, "files.mesh.npz: no block refers to this file"),
    ],
)
def test_faults_of_a_view_are_named(folder: Path, changes: dict[str, object], words: str) -> None:
    view = folder / "views" / "left"
    edit(view, **changes)
    with pytest.raises(InputError, match=r"SHA-256 is .* the file was changed"):
        load_profile(folder)
    digest = hashlib.sha256((view / "profile.toml").read_bytes()).hexdigest()
    edit(folder, views={"left": digest})
    with pytest.raises(InputError, match=words):
        load_profile(folder)


@pytest.mark.parametrize(
    ("views", "words"),
    [
        ({"main": "0" * 64}, "views: 'main' is no name of a view"),
        ({"up": "0" * 64}, "no such file"),
        ({"left": 3}, "lists no SHA-256"),
        (["left"], "views: must be a table of names"),
    ],
)
def test_faults_of_the_list_are_named(folder: Path, views: object, words: str) -> None:
    edit(folder, views=None)
    edit(folder, views=views)
    findings = validate_profile(folder)
    assert any(words in str(one) for one in findings if one.severity == "error")
    with pytest.raises(InputError):
        load_profile(folder)


def test_other_files_among_the_views(two_eyes: SensorProfile, folder: Path) -> None:
    (folder / "views" / "right").mkdir()
    assert [str(one.severity) for one in validate_profile(folder)] == ["warning"]
    save_profile(two_eyes, folder)
    (folder / "views" / "left" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"not part of a profile \(views/left/notes\.txt\)"):
        save_profile(two_eyes, folder)
    assert np.isfinite(load_profile(folder).seen_by("left").grid().x_mm()).all()
