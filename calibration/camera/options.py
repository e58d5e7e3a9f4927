# SPDX-License-Identifier: Apache-2.0
"""What can be chosen of a calibration of the camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

LensName = Literal["k1", "fisheye", "pinhole", "rational"]


@dataclass(frozen=True, kw_only=True)
class CameraOptions:
    """Settings of ``calibrate_camera``."""

    models: tuple[LensName, ...] = ("k1", "fisheye", "pinhole", "rational")
    """Lenses to choose from by held-out error: one radial term, fisheye (4 coefficients), pinhole
    (5) or rational (8)."""
    folds: int = 5
    """Number of cross-validation folds of the views, to score the lenses."""
