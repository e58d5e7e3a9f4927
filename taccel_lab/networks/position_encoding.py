# SPDX-License-Identifier: Apache-2.0
"""Positional encoding: a pixel's place as sines and cosines of rising frequency.

A small network follows its inputs smoothly; light that changes within a part of the image is out
of its reach when it is given u and v alone. B. Mildenhall et al., "NeRF: Representing Scenes as
Neural Radiance Fields for View Synthesis", ECCV 2020, eq. 4: each coordinate p in -1..1 brings
sin(2^k pi p) and cos(2^k pi p) for k = 0 .. bands - 1. Band k has 2^k periods over the image.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.errors import InputError

MAX_BANDS = 8
"""128 periods over the image: no light changes within fewer pixels than that leaves."""


def require_bands(model: str, bands: int) -> None:
    """InputError unless ``bands`` is a number of bands that ``model`` may have."""
    if not 0 <= bands <= MAX_BANDS:
        raise InputError(f"{model} position_bands must lie in 0..{MAX_BANDS}, got {bands}")


def band_names(bands: int) -> tuple[str, ...]:
    """Names of the features in order: sines of u and v, cosines of u and v, band by band."""
    return tuple(f"{wave}_{p}_{k}" for k in range(bands) for wave in ("sin", "cos") for p in "uv")


def encode_position(uv: np.ndarray, bands: int) -> np.ndarray:
    """Sines and cosines of places (u, v) in -1..1, shape [..., 2] to [..., 4 * bands]."""
    angles = [(2.0**k * np.pi) * uv for k in range(bands)]
    parts = [wave(angle) for angle in angles for wave in (np.sin, np.cos)]
    return np.concatenate(parts, axis=-1) if parts else np.empty((*np.shape(uv)[:-1], 0))
