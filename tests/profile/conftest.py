# SPDX-License-Identifier: Apache-2.0
"""A small complete profile to start from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from taccel_lab import profile as blocks
from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.color_settings import ColorModelConfig
from tests.support.sample_blocks import ASSUMED, CALIBRATED, sample_blocks


@pytest.fixture(scope="session")
def full_profile() -> blocks.SensorProfile:
    shared, rng = sample_blocks(), np.random.default_rng(7)
    grid = PixelGrid(12, 9, 0.03, 0.031, center_u_px=5.25)
    color = ColorModelConfig(12, 9, hidden=(16,), activation="tanh")
    red = blocks.LightEntry(
        name="red", position_mm=(9.0, 0.0, -3.0), direction=(-1.0, 0.0, 0.0), rgb=(1.0, 0.0, 0.1),
        size_mm=(2.0, 1.0),
    )  # fmt: skip
    return blocks.SensorProfile(
        sensor=shared.sensor,
        gel=shared.gel,
        material=shared.material,
        camera=blocks.CameraBlock.from_grid(grid, ASSUMED),
        mesh=shared.mesh,
        optics=shared.optics.replace(
            raw_width_px=640, raw_height_px=480, crop_x=0.7, ambient_rgb=(0.1, 0.1, 0.2)
        ),
        window=shared.window,
        coating=shared.coating,
        lights=blocks.LightsBlock(led=(red, shared.light), provenance=ASSUMED),
        markers=shared.markers,
        housing=blocks.HousingBlock(
            size_mm=(20.0, 18.0, 25.0), wall_mm=1.2, corner_radius_mm=1.0, front_z_mm=-4.0,
            provenance=ASSUMED,
        ),
        background=blocks.BackgroundBlock(provenance=ASSUMED),
        background_rgb=rng.integers(0, 256, (9, 12, 3), dtype=np.uint8),
        color=blocks.ColorBlock(architecture=color.to_dict(), provenance=CALIBRATED),
        color_weights={
            name: rng.normal(size=shape).astype(np.float32)
            for name, shape in color.weight_shapes().items()
        },
    )  # fmt: skip


@pytest.fixture
def profile_folder(full_profile: blocks.SensorProfile, tmp_path: Path) -> Path:
    blocks.save_profile(full_profile, tmp_path / "profile")
    return tmp_path / "profile"
