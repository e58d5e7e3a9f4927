# SPDX-License-Identifier: Apache-2.0
"""Profiles to export, and one press off the image's centre as every renderer should show it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from taccel_lab.calibration.capture import ContactCircle
from taccel_lab.calibration.circles.ball_surface import BallSurface
from taccel_lab.networks.color_settings import ColorModelConfig
from taccel_lab.networks.force_settings import ForceModelConfig
from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.profile import (
    BackgroundBlock,
    ColorBlock,
    ForceBlock,
    NormalsBlock,
    PerturbationBlock,
    Provenance,
    SensorProfile,
)
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.normals import normals_from_slopes
from taccel_lab.signals.rest_surface import rest_surface
from taccel_lab.signals.tactile_image import tactile_image
from tests.support.analytic_surface import analytic_surface

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
    profile = profile.with_block(camera.replace(center_u_px=150.0, center_v_px=125.0))
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


TURN = Rotation.from_euler("xyz", [0.1, -0.2, 0.3])
STRENGTHS = (0.25, 1.0, 0.6)


def skewed_profile() -> SensorProfile:
    """The same without a symmetry that could hide a swap: pixels not square, a camera turned about
    three axes, lamps of unequal strength, dots turned with gaps, and no round figures."""
    profile = mini_profile()
    optics, lights, markers = profile.optics, profile.lights, profile.markers
    assert optics is not None and lights is not None and markers is not None
    noise = PerturbationBlock(
        gain_rgb=(0.01, 0.02, 0.03), pivot_rgb=(90.0, 100.0, 110.0), noise_levels=1.7,
        mm_per_px_relative=0.02, young_modulus_relative=0.1, friction_coefficient=0.05,
        provenance=MADE_UP,
    )  # fmt: skip
    camera = profile.camera.replace(mm_per_px_x=0.07, mm_per_px_y=0.055)
    optics = optics.replace(
        rotation=tuple(TURN.as_quat().tolist()), position_mm=(0.5, -1.0, -22.0),
        fy_px=0.8 * optics.fx_px, distortion=(-0.05, 0.01, 0.002, -0.001), crop_x=0.9, crop_y=0.8,
    )  # fmt: skip
    leds = tuple(
        led.replace(rgb=tuple(np.array(led.rgb) * strength + 0.01))
        for led, strength in zip(lights.led, STRENGTHS, strict=True)
    )
    material = profile.material.replace(
        young_modulus_pa=3.1e5, poisson_ratio=0.37, friction_coefficient=0.7, density_kg_m3=1234.0
    )
    markers = markers.replace(rotation_deg=8.0, missing=((0, 0), (3, 4)))
    for block in (camera, optics, lights.replace(led=leds), markers, material, noise):
        profile = profile.with_block(block)
    return profile


def drawn_weights(config: NormalModelConfig | ForceModelConfig, seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {
        name: rng.normal(0, 0.3, shape).astype(np.float32)
        for name, shape in config.weight_shapes().items()
    }


def with_normals(profile: SensorProfile) -> SensorProfile:
    """The profile with a normals block of random weights, a small network's among them."""
    size = profile.camera.width_px, profile.camera.height_px
    config = NormalModelConfig(*size, small_hidden=(7, 5))
    block = NormalsBlock(architecture=config.to_dict(), provenance=MADE_UP)
    return profile.with_block(block, drawn_weights(config, 3))


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
    most = np.random.default_rng(9).uniform(20, 60, 26).astype(np.float32)
    weights = drawn_weights(config, 8) | {"colors.most": most}
    block = ForceBlock(architecture=config.to_dict(), provenance=MADE_UP)
    return profile.with_block(block, weights)


CIRCLE = ContactCircle(220.0, 90.0, 30.0)
"""Right of and above the middle of 320 x 240 px."""
BALL_RADIUS_MM = 4.0


def press_over_rest(profile: SensorProfile) -> BallSurface:
    """A ball's dent in a flat gel: height and slopes over the surface at rest."""
    return analytic_surface(CIRCLE, profile.grid(), BALL_RADIUS_MM, decay_mm=4.0)


def our_image(profile: SensorProfile, press: BallSurface) -> np.ndarray:
    """What the profile's own colour model shows of that press."""
    assert profile.color is not None and profile.color_weights is not None
    assert profile.background_rgb is not None
    settings = ColorModelConfig.from_dict(profile.color.architecture)
    model = ColorModel(settings, profile.color_weights)
    rest = rest_surface(profile.mesh, profile.grid()).normals
    slope = -press.normals[..., :2] / press.normals[..., 2:] - rest[..., :2] / rest[..., 2:]
    over_rest = replace(press, normals=normals_from_slopes(slope), rest_normals=rest)
    return tactile_image(model, profile.background_rgb, over_rest)


def psnr(image: np.ndarray, truth: np.ndarray) -> float:
    return float(20 * np.log10(255 / np.sqrt(((image - truth) ** 2).mean())))


def require_upright(image: np.ndarray, truth: np.ndarray, least_db: float) -> None:
    """The image is near the truth, and its mirror images and swapped colours are far off."""
    assert psnr(image, truth) > least_db
    for wrong in (image[:, ::-1], image[::-1], image[::-1, ::-1], image[..., ::-1]):
        assert psnr(wrong, truth) < least_db - 10
