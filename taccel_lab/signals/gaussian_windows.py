# SPDX-License-Identifier: Apache-2.0
"""Gaussian averages of pictures on any device.

A window is a band matrix, the same for every stretch of an axis, so that a picture is averaged by
few products of small matrices: a convolution of torch takes six times as long on a CPU, and a
library of the CPU's alone would ask for a second implementation on a GPU.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.signals.tensors import tensor_of

if TYPE_CHECKING:
    import torch

STRETCH_PX = 32
"""Pixels of an axis that one product gives: of 16 to 80, the fastest for windows of 0.7 to 9 px."""
CUT_SIGMAS = 3.0
"""A window ends here."""


def gaussian_average(values: torch.Tensor, sigma_px: float) -> torch.Tensor:
    """Gaussian average of pictures, float, shape [..., h, w]; mirrored at the border's pixels."""
    # Products along rows need no copy of the overlapping stretches; along columns they would.
    across = _along_rows(values.transpose(-1, -2), sigma_px)
    return _along_rows(across.transpose(-1, -2), sigma_px)


def blurred(values: np.ndarray, sigma_px: float) -> np.ndarray:
    """``gaussian_average`` of a picture, shape [h, w] or [h, w, channel]."""
    channels = tensor_of(values)[None] if values.ndim == 2 else tensor_of(values).movedim(-1, 0)
    found = gaussian_average(channels, sigma_px)
    return (found[0] if values.ndim == 2 else found.movedim(0, -1)).numpy()


def _along_rows(values: torch.Tensor, sigma_px: float) -> torch.Tensor:
    """Average along the last axis but one, shape [..., n, m]."""
    count = values.shape[-2]
    reach = math.ceil(CUT_SIGMAS * sigma_px)
    stretches = -(-count // STRETCH_PX)
    band = tensor_of(_band(sigma_px, reach), values.dtype, values)
    place = tensor_of(_mirrored(count, reach, stretches * STRETCH_PX - count), like=values)
    padded = values.contiguous().index_select(-2, place)
    parts = padded.unfold(-2, STRETCH_PX + 2 * reach, STRETCH_PX).transpose(-1, -2)
    return (band @ parts).flatten(-3, -2)[..., :count, :]


@lru_cache(maxsize=64)
def _band(sigma_px: float, reach: int) -> np.ndarray:
    """Weights of the pixels of a stretch and beside it, shape [stretch, stretch + 2 reach]."""
    steps = np.arange(-reach, reach + 1)
    # A window narrower than a pixel's rounding is that pixel.
    weights = np.exp(-0.5 * (steps / max(sigma_px, 1e-3)) ** 2)
    weights /= weights.sum()
    band = np.zeros((STRETCH_PX, STRETCH_PX + 2 * reach))
    for row in range(STRETCH_PX):
        band[row, row : row + len(weights)] = weights
    return band


@lru_cache(maxsize=64)
def _mirrored(count: int, reach: int, more: int) -> np.ndarray:
    """Index of each pixel of an axis with ``reach`` more on both sides, and ``more`` at its end."""
    steps = np.arange(-reach, count + reach + more)
    if count == 1:
        return np.zeros_like(steps)
    steps %= 2 * (count - 1)
    return np.minimum(steps, 2 * (count - 1) - steps)
