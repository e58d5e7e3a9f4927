# SPDX-License-Identifier: Apache-2.0
"""Profiles are immutable and consistent."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.profile import BackgroundBlock, ColorBlock, SensorProfile


def test_with_block_leaves_the_original(full_profile: SensorProfile) -> None:
    changed = full_profile.with_block(full_profile.material.replace(poisson_ratio=0.3))
    assert changed.material.poisson_ratio == 0.3
    assert full_profile.material.poisson_ratio == 0.48
    assert changed.mesh is full_profile.mesh


def test_with_block_wants_the_arrays_it_describes(full_profile: SensorProfile) -> None:
    assert full_profile.background is not None
    with pytest.raises(InputError, match="needs its background_rgb"):
        full_profile.with_block(full_profile.background)
    with pytest.raises(InputError, match="takes no arrays"):
        full_profile.with_block(full_profile.material, np.zeros(3))


def test_without_removes_block_and_arrays(full_profile: SensorProfile) -> None:
    bare = full_profile.without("background", "color")
    assert bare.background_rgb is None
    assert bare.color_weights is None
    assert list(bare.blocks()) == ["sensor", "gel", "material", "camera"]
    with pytest.raises(InputError, match="cannot lack 'gel'"):
        full_profile.without("gel")  # type: ignore[arg-type]


def test_arrays_are_read_only_copies(full_profile: SensorProfile) -> None:
    assert full_profile.background is not None
    image = np.zeros((9, 12, 3), np.uint8)
    profile = full_profile.with_block(full_profile.background, image)
    image[0, 0, 0] = 9
    assert profile.background_rgb is not None
    assert profile.background_rgb[0, 0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        profile.background_rgb[0, 0, 0] = 1
    assert profile.color_weights is not None
    with pytest.raises(TypeError):
        profile.color_weights["new"] = image  # type: ignore[index]


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (np.zeros((12, 9, 3), np.uint8), r"shape \[12, 9, 3\].*\[9, 12, 3\]"),
        (np.zeros((9, 12), np.uint8), "shape"),
        (np.zeros((9, 12, 3)), "uint8 or float32"),
        (np.full((9, 12, 3), np.nan, np.float32), "NaN"),
        (np.full((9, 12, 3), -1, np.float32), "0..255"),
        (np.full((9, 12, 3), 256, np.float32), "0..255"),
    ],
)
def test_background_is_checked(full_profile: SensorProfile, image: Any, words: str) -> None:
    assert full_profile.background is not None
    with pytest.raises(InputError, match=words):
        full_profile.with_block(full_profile.background, image)


@pytest.mark.parametrize(
    ("weights", "words"),
    [
        ({}, "no weights"),
        ({"w": np.array([1.0, np.inf], np.float32)}, "'w' holds NaN or infinite"),
        ({"w": np.array([1, 2])}, "'w' must be float32 or float64"),
    ],
)
def test_weights_are_checked(full_profile: SensorProfile, weights: Any, words: str) -> None:
    assert full_profile.color is not None
    with pytest.raises(InputError, match=words):
        full_profile.with_block(full_profile.color, weights)


def test_mesh_must_match_its_block(full_profile: SensorProfile) -> None:
    with pytest.raises(InputError, match=r"gel\.node_count is 6 but the mesh has 5"):
        full_profile.with_block(full_profile.gel.replace(node_count=6), full_profile.mesh)


def test_block_and_array_come_together(full_profile: SensorProfile) -> None:
    with pytest.raises(InputError, match="one is missing"):
        dataclasses.replace(full_profile, background=None)
    with pytest.raises(InputError, match="one is missing"):
        dataclasses.replace(full_profile, color_weights=None)


def test_another_camera_needs_another_background(full_profile: SensorProfile) -> None:
    wider = full_profile.camera.replace(width_px=20)
    with pytest.raises(InputError, match="camera block asks for"):
        full_profile.with_block(wider)
    provenance = wider.provenance
    changed = (
        full_profile.without("background", "color")
        .with_block(wider)
        .with_block(BackgroundBlock(provenance=provenance), np.zeros((9, 20, 3), np.float32))
        .with_block(ColorBlock(architecture={}, provenance=provenance), {"w": np.ones(2)})
    )
    assert changed.grid().width_px == 20
