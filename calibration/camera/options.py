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
    """Parts that the views are split into to score the lenses."""
    refraction: Literal["auto", "media", "none"] = "auto"
    """Pose of the gel through the profile's window and gel (media) or with straight sight lines
    (none); auto takes them where the profile describes flat ones, unless the board clearly speaks
    against it. Needs views and a board on the gel; the report gives both poses."""
