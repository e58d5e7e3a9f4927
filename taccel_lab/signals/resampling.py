# SPDX-License-Identifier: Apache-2.0
"""Maps on other grids of pixels over the same view, on any device: each axis by one matrix."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.signals.tensors import tensor_of

if TYPE_CHECKING:
    import torch


def on_grid(values: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    """Maps, shape [..., h, w], on (height, width) pixels: means over larger ones, or linear between
    the middles of larger ones."""
    return _by_axes(values, size, resampling)


def smoothed_to(values: torch.Tensor, sigma_px: float, size: tuple[int, int]) -> torch.Tensor:
    """``on_grid`` of the maps' Gaussian average; what lies beside the border is as the border."""

    def smoothed(count: int, wanted: int) -> np.ndarray:
        return resampling(count, wanted) @ _smoothing(count, sigma_px)

    return _by_axes(values, size, smoothed)


def _by_axes(
    values: torch.Tensor, size: tuple[int, int], matrix: Callable[[int, int], np.ndarray]
) -> torch.Tensor:
    rows, columns = (
        tensor_of(matrix(count, wanted), values.dtype, values)
        for count, wanted in zip(values.shape[-2:], size, strict=True)
    )
    return rows @ values @ columns.T


@lru_cache(maxsize=32)
def resampling(count: int, wanted: int) -> np.ndarray:
    """Matrix of an axis, shape [wanted, count]; rows add up to 1."""
    if wanted >= count:
        at = np.clip((np.arange(wanted) + 0.5) * count / wanted - 0.5, 0, count - 1)
        return np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(count)))
    ends = np.arange(wanted + 1) * count / wanted
    pixels = np.arange(count)
    shared = np.minimum(ends[1:, None], pixels + 1) - np.maximum(ends[:-1, None], pixels)
    return np.maximum(0.0, shared) * wanted / count


@lru_cache(maxsize=32)
def _smoothing(count: int, sigma_px: float) -> np.ndarray:
    from scipy.ndimage import gaussian_filter1d

    return gaussian_filter1d(np.eye(count), sigma_px, axis=0, mode="nearest")
