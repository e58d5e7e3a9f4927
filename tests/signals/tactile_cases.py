# SPDX-License-Identifier: Apache-2.0
"""A pad in five shapes, its signals on a device and what the one-image classes make of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.color_settings import ColorModelConfig
from taccel_lab.signals import MarkerLayout, SignalTactile
from taccel_lab.signals.color_model import ColorModel
from tests.networks.weights import random_weights
from tests.signals.height_map_referee import HeightMapReferee
from tests.signals.host_colors import host_image
from tests.signals.pressed_surface import pressed_sphere, shaped

DEVICES = ["cpu", *(["cuda:0"] if wp.is_cuda_available() else [])]
GRID = PixelGrid(96, 72, 0.05, 0.05)
PAD_HALF_MM = (3.0, 2.4)
ENV_COUNT = 5
MARKERS_MM = np.array([[0.0, 0.0], [1.0, -0.5], [-1.5, 1.2]])
ALL = ("rgb", "rgb_levels", "height_m", "normals", "markers_px")
# FP32 network on the CPU; FP16 weights and activations on CUDA.
LEVELS = {"cpu": 1e-2, "cuda:0": 0.3}


def color_model(
    grid: PixelGrid, hidden: tuple[int, ...] = (32, 20), bands: int = 0, spread: float = 1.5
) -> ColorModel:
    """A network of random weights whose answers are as large as those of a sensor."""
    config = ColorModelConfig(
        grid.width_px, grid.height_px, hidden=hidden, position_bands=bands,
        input_mean=(0.0, 0.0, 0.0, 0.0, 0.95, -0.1), input_scale=(0.6, 0.6, 0.2, 0.2, 0.1, 0.2),
    )  # fmt: skip
    weights = random_weights(config, 4)
    return ColorModel(config, {name: spread * value for name, value in weights.items()})


def background(grid: PixelGrid) -> np.ndarray:
    rng = np.random.default_rng(5)
    return rng.uniform(0, 255, (grid.height_px, grid.width_px, 3)).astype(np.float32)


def presses(mesh: Any) -> np.ndarray:
    """At rest, pressed, pressed with shear, tilted and stretched, pressed elsewhere."""
    shapes = (
        pressed_sphere(1.0e-3),
        pressed_sphere(1.4e-3),
        lambda x, y: 0.1 * x - 0.05 * y,
        pressed_sphere(0.7e-3, (-1e-3, 0.5e-3)),
    )
    positions = np.concatenate([mesh.nodes_m[None], *(shaped(mesh, shape) for shape in shapes)])
    bulge = np.exp(-((positions[2, :, :2] / 1.1e-3) ** 2).sum(axis=-1))[:, None]
    positions[2, :, :2] += bulge * [0.5e-3, -0.35e-3]
    positions[3, :, :2] *= 1.05
    return positions


def on_device(positions: np.ndarray, device: str = "cpu") -> wp.array:
    return wp.array(positions, dtype=wp.vec3d, device=device)


def make(mesh: Any, device: str = "cpu", grid: PixelGrid = GRID, **changes: Any) -> SignalTactile:
    arguments = {
        "env_count": ENV_COUNT,
        "color_model": color_model(grid),
        "background_rgb": background(grid),
        "device": device,
        **changes,
    }
    if "markers" not in arguments:
        arguments["markers"] = MarkerLayout.from_points(mesh, MARKERS_MM)
    return SignalTactile(mesh, grid, **arguments)


def reference(mesh: Any, positions: np.ndarray, grid: PixelGrid) -> dict:
    """What the referee of the surface and the colour model on the host make of it."""
    signal = HeightMapReferee(mesh, grid)
    signal.update(np.concatenate([mesh.nodes_m[None], positions]))
    height, normals = signal.height_m, signal.normals
    seen = np.isfinite(height[1:]) & np.isfinite(height[0])
    flat = np.array([0.0, 0.0, 1.0])
    surfaces = zip(
        np.where(seen[..., None], normals[1:], flat),
        np.where(seen, height[1:] - height[0], 0.0) * 1e3,
        np.where(seen[..., None], normals[:1], flat),
        strict=True,
    )
    model, still = color_model(grid), background(grid)
    levels = np.stack([host_image(model, still, *surface) for surface in surfaces])
    return {"height_m": height[1:], "normals": normals[1:], "rgb_levels": levels}


def assert_agrees(
    signal: SignalTactile, expected: dict, device: str, normal_bound: float = 5e-6
) -> None:
    height, normals = signal.height_m.numpy(), signal.normals.numpy()
    assert np.array_equal(np.isnan(height), np.isnan(expected["height_m"]))
    assert np.array_equal(np.isnan(normals).any(axis=-1), np.isnan(height))
    assert np.nanmax(np.abs(height - expected["height_m"])) < 1e-9
    assert np.nanmax(np.abs(normals - expected["normals"])) < normal_bound
    levels = signal.rgb_levels.numpy()
    assert np.abs(levels - expected["rgb_levels"]).max() < LEVELS[device]
    assert np.array_equal(signal.rgb.numpy(), np.rint(levels))
