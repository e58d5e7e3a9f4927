# SPDX-License-Identifier: Apache-2.0
"""What the inverse model sees of each pixel: how its colour changed, at several scales.

One pixel's colour change does not tell the normal well: noise and lens blur hide it, and two
normals may give one colour. So each pixel brings the change averaged over Gaussian windows, and
how that average varies across the wider of them. The features scale with the picture: a zoomed
picture has the same features at scales zoomed as much, and the same normals. Training on several
zooms therefore shows balls of other sizes than the one that was pressed, and keeps a model from
learning that single ball's curvature by heart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from taccel_lab.signals.position_encoding import band_names, encode_position

LEVELS_PER_UNIT = 32.0
"""Levels of 255 that make one unit of a feature."""
MIN_COVER = 1e-3
"""Share of a window that has to be unmasked for its average to count."""


def feature_names(
    scales_px: Sequence[float],
    slope_scales_px: Sequence[float],
    background: bool,
    position_bands: int = 0,
) -> tuple[str, ...]:
    """Names of the features in order."""
    names = [f"change_{c}_{s:g}px" for s in scales_px for c in "rgb"]
    names += [f"d{axis}_{c}_{s:g}px" for s in slope_scales_px for axis in "uv" for c in "rgb"]
    if background:
        names += [f"background_{c}" for c in "rgb"]
    return (*names, "u", "v", *band_names(position_bands))


def color_change(
    image: np.ndarray, background: np.ndarray, mask: np.ndarray | None = None
) -> np.ndarray:
    """Image minus background [levels], float32, 0 where ``mask`` is false, shape [h, w, 3]."""
    change = np.asarray(image, dtype=np.float32) - np.asarray(background, dtype=np.float32)
    if mask is not None:
        change[~mask] = 0.0
    return change


def local_features(
    change: np.ndarray,
    scales_px: Sequence[float],
    slope_scales_px: Sequence[float],
    *,
    mask: np.ndarray | None = None,
    background: np.ndarray | None = None,
    place: np.ndarray,
    zoom: float = 1.0,
    picked: np.ndarray | None = None,
) -> np.ndarray:
    """Features of every pixel of a picture or of a part of it, float32, shape [h, w, feature].

    Args:
        change: Colour change [levels], 0 in masked pixels, shape [h, w, 3].
        scales_px: Standard deviations of the windows [px]; 0 is the pixel itself.
        slope_scales_px: Windows across which the change's variation is taken [px].
        mask: Pixels that count, bool, shape [h, w]; all when None.
        background: Untouched picture [levels], shape [h, w, 3]; a feature when it is given.
        place: What each pixel knows of its place (``pixel_place``), shape [h, w, n].
        zoom: Factor on all scales: the features of the picture shrunk by it.
        picked: Pixels whose features are wanted, counted along rows, shape [n]; the result has
            shape [n, feature] then.
    """
    cover: dict[float, np.ndarray] = {}
    windows: dict[float, np.ndarray] = {}
    for scale in {*scales_px, *slope_scales_px}:
        windows[scale] = _average(change, scale * zoom, mask, cover)
    at = None if picked is None else np.divmod(picked, change.shape[1])
    parts = [_taken(windows[scale], at) for scale in scales_px]
    for scale in slope_scales_px:
        # Per standard deviation of the window, so that it does not depend on the zoom.
        parts += [_derivative(windows[scale], axis, at) * (scale * zoom) for axis in (1, 0)]
    if background is not None:
        widest = max([*scales_px, *slope_scales_px])
        average = _average(np.asarray(background, dtype=np.float32), widest, mask, {})
        parts.append(_taken(average, at))
    units = [part / np.float32(LEVELS_PER_UNIT) for part in parts]
    return np.concatenate([*units, _taken(place, at)], axis=-1, dtype=np.float32)


def pixel_place(width_px: int, height_px: int, position_bands: int = 0) -> np.ndarray:
    """Normalised (u, v) of every pixel, -1 to 1 over the image, and their positional encoding;
    float32, shape [h, w, 2 + 4 * position_bands]."""
    u = np.linspace(-1, 1, width_px, dtype=np.float32)
    v = np.linspace(-1, 1, height_px, dtype=np.float32)
    uv = np.stack(np.meshgrid(u, v), axis=-1)
    if not position_bands:
        return uv
    return np.concatenate([uv, encode_position(uv, position_bands)], axis=-1, dtype=np.float32)


def _average(
    values: np.ndarray, sigma_px: float, mask: np.ndarray | None, cover: dict[float, np.ndarray]
) -> np.ndarray:
    """Gaussian average over the unmasked pixels; 0 where a window holds next to none."""
    if sigma_px <= 0:
        return values if mask is None else np.where(mask[..., None], values, np.float32(0))
    if mask is None or mask.all():
        return blurred(values, sigma_px)
    weight = mask.astype(np.float32)
    if sigma_px not in cover:
        cover[sigma_px] = blurred(weight, sigma_px)
    share = cover[sigma_px][..., None]
    total = blurred(values * weight[..., None], sigma_px)
    return np.where(share > MIN_COVER, total / np.maximum(share, MIN_COVER), np.float32(0))


def blurred(values: np.ndarray, sigma_px: float) -> np.ndarray:
    """Gaussian average of a picture, shape [h, w] or [h, w, channel]; window cut at 3 sigma."""
    import cv2

    size = 2 * math.ceil(3 * sigma_px) + 1
    averaged: Any = cv2.GaussianBlur(values, (size, size), sigma_px)
    return averaged


Pixels = tuple[np.ndarray, np.ndarray] | None
"""Rows and columns; all when None."""


def _taken(values: np.ndarray, at: Pixels) -> np.ndarray:
    return values if at is None else values[at]


def _derivative(values: np.ndarray, axis: int, at: Pixels) -> np.ndarray:
    """Central difference along an axis, one-sided at the border [levels/px]."""
    if at is None:
        return np.gradient(values, axis=axis).astype(np.float32, copy=False)
    before, after = (np.clip(at[axis] + step, 0, values.shape[axis] - 1) for step in (-1, 1))
    left, right = (values[(at[0], end) if axis else (end, at[1])] for end in (before, after))
    return (right - left) / (after - before).astype(np.float32)[:, None]
