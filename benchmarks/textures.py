# SPDX-License-Identifier: Apache-2.0
"""Textures drawn by formulas: what fine images of coarse gels are judged on."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from taccel_lab.signals.texture import Texture


def knurl() -> Texture:
    """Pyramids 0.35 mm apart."""
    x, y = _unit(128)
    u, v = (2 * (x + y)) % 1, (2 * (x - y)) % 1
    return _texture(np.minimum(1 - np.abs(2 * u - 1), 1 - np.abs(2 * v - 1)), 0.06, 1.0)


def thread() -> Texture:
    """Ridges with flat crests 0.4 mm apart."""
    u = (2 * _unit(128)[0]) % 1
    return _texture(np.minimum(1.25 * (1 - np.abs(2 * u - 1)), 1), 0.06, 0.8)


def coin() -> Texture:
    """A rim, a ring of teeth and a star, 2 mm wide."""
    x, y = (axis - 0.5 for axis in _unit(256))
    r, angle = np.hypot(x, y), np.arctan2(y, x)
    rim = (r > 0.40) & (r < 0.46)
    star = r < 0.28 * (0.62 + 0.38 * np.cos(5 * angle))
    teeth = (np.abs(r - 0.34) < 0.025) & (np.cos(16 * angle) > 0)
    return _texture(_blurred(np.maximum(rim, np.maximum(0.8 * star, 0.5 * teeth))), 0.05, 2.0)


def text() -> Texture:
    """Raised letters 0.7 mm high."""
    from PIL import Image, ImageDraw, ImageFont

    size = 256
    image = Image.new("L", (size, size), 0)
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(size=0.42 * size)
    for line, height in (("GEL", 0.28), ("724", 0.72)):
        draw.text((size / 2, height * size), line, fill=255, font=font, anchor="mm")
    return _texture(_blurred(np.asarray(image) / 255.0), 0.05, 2.0)


def fabric() -> Texture:
    """A plain weave, a thread every 0.5 mm."""
    x, y = (2 * np.pi * axis for axis in _unit(128))
    warp = np.abs(np.sin(x)) * (0.6 + 0.4 * np.cos(y) * np.sign(np.sin(x)))
    weft = np.abs(np.sin(y)) * (0.6 - 0.4 * np.cos(x) * np.sign(np.sin(y)))
    return _texture(np.maximum(warp, weft), 0.05, 1.0)


TEXTURES: dict[str, Callable[[], Texture]] = {
    make.__name__: make for make in (knurl, thread, coin, text, fabric)
}
"""By name."""


def carved_m(texture: Texture, x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
    """How deep the surface lies below its highest points [m], bilinear between pixels, at xy of the
    object."""
    from scipy.ndimage import map_coordinates

    rows, columns = texture.heights.shape
    px_per_m = columns / texture.width_m
    place = [y_m * px_per_m + (rows - 1) / 2, x_m * px_per_m + (columns - 1) / 2]
    heights = map_coordinates(texture.heights, place, order=1, mode="grid-wrap")
    return texture.depth_m * (texture.heights.max() - heights)


def _unit(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Columns and rows of a square of ``size`` pixels, 0 to 1 over it."""
    t = (np.arange(size) + 0.5) / size
    x, y = np.meshgrid(t, t)
    return x, y


def _blurred(heights: np.ndarray) -> np.ndarray:
    """Walls a few pixels wide in place of jumps."""
    from scipy.ndimage import gaussian_filter

    return gaussian_filter(heights.astype(np.float64), 2.0, mode="wrap")


def _texture(heights: np.ndarray, depth_mm: float, width_mm: float) -> Texture:
    """Of heights from 0 to 1, whatever they were."""
    heights = (heights - heights.min()) / np.ptp(heights)
    return Texture(heights, 1e-3 * depth_mm, 1e-3 * width_mm)
