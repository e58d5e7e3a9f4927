# SPDX-License-Identifier: Apache-2.0
"""The discrete cosine transform of maps (DCT-II) on any device, by a real Fourier transform as
long as the axis (J. Makhoul, IEEE Trans. ASSP 28(1), 1980)."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import torch


def cosines(values: torch.Tensor) -> torch.Tensor:
    """sum_ij x_ij cos(pi k (i + 1/2) / h) cos(pi l (j + 1/2) / w), shape [..., h, w]."""
    return _forward(_forward(values).transpose(-1, -2)).transpose(-1, -2)


def from_cosines(values: torch.Tensor) -> torch.Tensor:
    """Inverse of ``cosines``, shape [..., h, w]."""
    return _backward(_backward(values).transpose(-1, -2)).transpose(-1, -2)


def _turns(count: int, like: torch.Tensor) -> torch.Tensor:
    """exp(-i pi k / 2n) for k of a half of the spectrum."""
    import torch

    k = torch.arange(count // 2 + 1, dtype=like.dtype, device=like.device)
    return torch.polar(torch.ones_like(k), k * (-torch.pi / (2 * count)))


def _forward(x: torch.Tensor) -> torch.Tensor:
    import torch

    count = x.shape[-1]
    mixed = torch.cat([x[..., ::2], x[..., 1::2].flip(-1)], dim=-1)
    turned = torch.fft.rfft(mixed) * _turns(count, x)
    return torch.cat([turned.real, -turned.imag[..., 1 : (count + 1) // 2].flip(-1)], dim=-1)


def _backward(x: torch.Tensor) -> torch.Tensor:
    import torch

    count = x.shape[-1]
    half, even = count // 2 + 1, (count + 1) // 2
    imaginary = torch.cat([torch.zeros_like(x[..., :1]), -x.flip(-1)[..., : half - 1]], dim=-1)
    spectrum = torch.complex(x[..., :half].contiguous(), imaginary)
    mixed = torch.fft.irfft(spectrum * _turns(count, x).conj(), n=count)
    found = torch.empty_like(mixed)
    found[..., ::2], found[..., 1::2] = mixed[..., :even], mixed[..., even:].flip(-1)
    return found
