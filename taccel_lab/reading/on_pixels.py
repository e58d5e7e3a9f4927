# SPDX-License-Identifier: Apache-2.0
"""Maps of blocks of pixels on all pixels of an image."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def on_pixels(
    maps: Sequence[np.ndarray], shape: tuple[int, ...], block_px: int
) -> list[np.ndarray]:
    """Maps of blocks of so many pixels, [h, w] or [h, w, n], on the rows and columns of an image,
    along lines between the middles of blocks, which go on beyond the outermost ones; float32 but
    for single pixels."""
    import cv2

    if block_px == 1:
        return list(maps)
    planes = [values.reshape(*values.shape[:2], -1) for values in maps]
    wide = np.pad(np.concatenate(planes, axis=-1, dtype=np.float32), ((1, 1), (1, 1), (0, 0)))
    for ring in (wide, wide.swapaxes(0, 1)):
        ring[0], ring[-1] = 2 * ring[1] - ring[2], 2 * ring[-2] - ring[-3]
    size = wide.shape[1] * block_px, wide.shape[0] * block_px
    fine = cv2.resize(wide, size, interpolation=cv2.INTER_LINEAR)
    fine = fine.reshape(*size[::-1], -1)[block_px:, block_px:][: shape[0], : shape[1]]
    ends = np.cumsum([plane.shape[-1] for plane in planes])[:-1].tolist()
    return [
        np.ascontiguousarray(part if values.ndim == 3 else part[..., 0])
        for values, part in zip(maps, np.split(fine, ends, axis=-1), strict=True)
    ]


def repeated(flags: np.ndarray, times: int, shape: tuple[int, ...]) -> np.ndarray:
    """Flags of blocks, [h, w], on ones so many times smaller, of these rows and columns."""
    wide = flags.repeat(times, axis=0).repeat(times, axis=1)
    return wide[: shape[0], : shape[1]]
