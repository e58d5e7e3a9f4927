# SPDX-License-Identifier: Apache-2.0
"""Images with a dent, and settings of networks that read them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.normal_settings import NormalModelConfig

CONFIG = NormalModelConfig(48, 36, scales_px=(1.0, 3.0), slope_scales_px=(3.0,), members=3)
WIDE = replace(CONFIG, width_px=241, height_px=178)
WIDE_GRID = PixelGrid(241, 178, 0.06, 0.06)


def background(seed: int, width: int = 48, height: int = 36) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 255, (height, width, 3)).astype(np.float32)


def dented(seed: int, noise: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """An image with a dent whose rim is sharp and whose surroundings sink, and its background."""
    still = background(seed, 241, 178)
    v, u = np.mgrid[:178, :241]
    away = np.hypot(u - 110.0, v - 70.0)
    lean = np.where(away < 30, away / 30, np.exp(-(away - 30) / 8)) + 0.2 * np.exp(-away / 60)
    way = np.stack([u - 110.0, v - 70.0, 30.0 - away], axis=-1) / np.maximum(away, 1.0)[..., None]
    change = 60.0 * lean[..., None] * np.clip(way, -1, 1)
    change += np.random.default_rng(seed + 100).normal(0, noise, change.shape)
    return (still + change).astype(np.float32), still
