# SPDX-License-Identifier: Apache-2.0
"""The discrete cosine transform of maps (DCT-II) on any device, by a real Fourier transform as
long as the axis (J. Makhoul, IEEE Trans. ASSP 28(1), 1980)."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import torch

ROWS, COLUMNS = -2, -1
"""Axes of a map."""


def cosines(values: torch.Tensor) -> torch.Tensor:
    """sum_ij x_ij cos(pi k (i + 1/2) / h) cos(pi l (j + 1/2) / w), shape [..., h, w]."""
    return _forward(_forward(values, COLUMNS), ROWS)


def from_cosines(values: torch.Tensor) -> torch.Tensor:
    """Inverse of ``cosines``, shape [..., h, w]."""
    return _backward(_backward(values, ROWS), COLUMNS)


@lru_cache(maxsize=32)
def _turns(count: int, axis: int, dtype: torch.dtype, device: torch.device) -> torch.Tensor:
    """exp(-i pi k / 2n) for k of a half of the spectrum along an axis; ``dtype``: of its parts."""
    import torch

    k = torch.arange(count // 2 + 1, dtype=dtype, device=device)
    turns = torch.polar(torch.ones_like(k), k * (-torch.pi / (2 * count)))
    return turns[:, None] if axis == ROWS else turns


@lru_cache(maxsize=32)
def _mixed(count: int, device: torch.device) -> torch.Tensor:
    """Places of even number, then those of odd number from the last one on."""
    import torch

    places = torch.arange(count, device=device)
    return torch.cat([places[::2], places[1::2].flip(0)])


@lru_cache(maxsize=32)
def _unmixed(count: int, device: torch.device) -> torch.Tensor:
    return _mixed(count, device).argsort()


def _forward(x: torch.Tensor, axis: int) -> torch.Tensor:
    import torch

    count = x.shape[axis]
    mixed = x.index_select(axis, _mixed(count, x.device))
    turned = torch.fft.rfft(mixed, dim=axis) * _turns(count, axis, x.dtype, x.device)
    rest = turned.imag.narrow(axis, 1, (count - 1) // 2).flip(axis)
    return torch.cat([turned.real, rest.neg_()], dim=axis)


def _backward(x: torch.Tensor, axis: int) -> torch.Tensor:
    import torch

    count = x.shape[axis]
    half = count // 2
    imaginary = x.narrow(axis, count - half, half).flip(axis).neg_()
    imaginary = torch.cat([torch.zeros_like(x.narrow(axis, 0, 1)), imaginary], dim=axis)
    spectrum = torch.complex(x.narrow(axis, 0, half + 1).contiguous(), imaginary)
    spectrum *= _turns(count, axis, x.dtype, x.device).conj()
    mixed = torch.fft.irfft(spectrum, n=count, dim=axis)
    return mixed.index_select(axis, _unmixed(count, x.device))
