# SPDX-License-Identifier: Apache-2.0
"""Profiles to export: a catalogue sensor with a made-up background and colour model."""

from __future__ import annotations

import numpy as np

from taccel_lab.networks.color_settings import ColorModelConfig
from taccel_lab.networks.force_settings import ForceModelConfig
from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.profile import (
    BackgroundBlock,
    CameraBlock,
    ColorBlock,
    ForceBlock,
    NormalsBlock,
    Provenance,
    SensorProfile,
)
from taccel_lab.sensors.profile import catalogue_profile

MADE_UP = Provenance(
    kind="calibrated",
    method="made up for a test",
    source="none",
    inputs={"nothing": "0" * 64},
    residuals={"none_levels": 0.0},
    valid_region={"surface_tilt_deg": (0.0, 40.0), "displacement_mm": (-1.0, 0.05)},
)


def lamps() -> tuple[ColorModelConfig, dict[str, np.ndarray]]:
    """Three lamps at 120 degrees that saturate on steep slopes, and a little darkening by depth.

    The lamps are brighter on the right, so that no symmetry of the image can hide a mirror."""
    config = ColorModelConfig(320, 240, hidden=(6,), activation="tanh", output_scale=60.0)
    first = np.zeros((6, 6), dtype=np.float32)
    last = np.zeros((3, 6), dtype=np.float32)
    for k in range(3):
        angle = 2 * np.pi * k / 3 + 0.2
        lean = np.array([np.cos(angle), np.sin(angle)])
        # tanh(n + u/2) - tanh(n - u/2)-like pairs: the slope counts for more where u is large.
        first[2 * k, 2:4] = first[2 * k + 1, 2:4] = lean
        first[2 * k, 0], first[2 * k + 1, 0] = 0.4, -0.1
        last[k, 2 * k], last[k, 2 * k + 1] = 0.4, 0.7
        first[2 * k, 5] = 0.1
    weights = {
        "layer0.weight": first,
        "layer0.bias": np.full(6, -0.6, dtype=np.float32),
        "layer1.weight": last,
        "layer1.bias": np.zeros(3, dtype=np.float32),
    }
    assert {k: v.shape for k, v in weights.items()} == config.weight_shapes()
    return config, weights


def uneven_background(width: int, height: int) -> np.ndarray:
    u, v = np.meshgrid(np.linspace(0, 1, width), np.linspace(0, 1, height))
    return np.stack([100 + 30 * u, 120 - 20 * v, 90 + 20 * u * v], axis=-1).astype(np.float32)


def mini_profile() -> SensorProfile:
    """GelSight Mini of the catalogue, its image off centre, with background and colour model."""
    profile = catalogue_profile("gelsight_mini")
    camera = profile.camera
    profile = profile.with_block(
        CameraBlock(
            width_px=camera.width_px,
            height_px=camera.height_px,
            mm_per_px_x=camera.mm_per_px_x,
            mm_per_px_y=camera.mm_per_px_y,
            center_u_px=150.0,
            center_v_px=125.0,
            provenance=camera.provenance,
        )
    )
    config, weights = lamps()
    background = uneven_background(camera.width_px, camera.height_px)
    return profile.with_block(BackgroundBlock(provenance=MADE_UP), background).with_block(
        ColorBlock(architecture=config.to_dict(), provenance=MADE_UP), weights
    )


def with_encoding(profile: SensorProfile, bands: int = 3) -> SensorProfile:
    """The profile with lamps whose strength waves over the image: a positional encoding."""
    assert profile.color is not None and profile.color_weights is not None
    settings = {**profile.color.architecture, "position_bands": bands}
    weights = dict(profile.color_weights)
    first = weights["layer0.weight"]
    waves = np.random.default_rng(4).normal(0, 0.15, (len(first), 4 * bands))
    weights["layer0.weight"] = np.concatenate([first, waves.astype(np.float32)], axis=1)
    return profile.with_block(profile.color.replace(architecture=settings), weights)


def with_normals(profile: SensorProfile) -> SensorProfile:
    """The profile with a normals block of random weights."""
    config = NormalModelConfig(profile.camera.width_px, profile.camera.height_px)
    rng = np.random.default_rng(3)
    weights = {
        name: rng.normal(0, 0.3, shape).astype(np.float32)
        for name, shape in config.weight_shapes().items()
    }
    return profile.with_block(
        NormalsBlock(architecture=config.to_dict(), provenance=MADE_UP), weights
    )


def with_force(profile: SensorProfile, *, markers: bool = False) -> SensorProfile:
    """The profile with a force model of made-up weights, of a softer gel than the profile's."""
    config = ForceModelConfig(
        320, 240, columns=5, rows=3, patch_px=8, widths=(4, 6, 5), blocks=2, hidden=7,
        markers=markers, stiffness_relative=0.1,
        young_modulus_pa=0.5 * profile.material.young_modulus_pa,
        most=(4.0, 2.0, 30.0, 1.0), distance_limits=(2.0, 3.0, 1.2),
        patch_scale_n=(0.1, 0.2, 0.3), target_scale=(1.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
        sigma_factor=(1.5,) * 7,
    )  # fmt: skip
    rng = np.random.default_rng(8)
    weights = {
        name: rng.normal(0, 0.3, shape).astype(np.float32)
        for name, shape in config.weight_shapes().items()
    }
    weights["colors.most"] = rng.uniform(20, 60, 26).astype(np.float32)
    return profile.with_block(
        ForceBlock(architecture=config.to_dict(), provenance=MADE_UP), weights
    )
