# SPDX-License-Identifier: Apache-2.0
"""Presses as both fits see them, what all presses of a set share, and pixels that are drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.capture.captures import CaptureSet, ContactCircle
from taccel_lab.calibration.circles.ball_surface import BallSurface
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.rest_surface import RestSurface

CircleSigma = tuple[float, float]
"""Standard deviations of a circle's centre along an axis and of its radius [px]."""
EXACT: CircleSigma = (0.0, 0.0)
Ring = tuple[float, float, int]
"""Inner and outer radius, in contact radii, and the most pixels that are drawn."""
WHOLE = (slice(None), slice(None))


@dataclass(frozen=True)
class CaptureScene:
    """What all presses of one capture set have in common."""

    background: np.ndarray
    """RGB levels, shape [height_px, width_px, 3]."""
    grid: PixelGrid
    ball_radius_mm: float
    mask: np.ndarray | None = None
    """Pixels that may be used, bool, shape [height_px, width_px]; all when None."""
    rest_normals: np.ndarray | None = None
    """Outward unit normals at rest, shape [height_px, width_px, 3]; flat when None."""

    @classmethod
    def of(
        cls, captures: CaptureSet, background: np.ndarray | None, rest: RestSurface | None = None
    ) -> CaptureScene:
        """Scene of ``captures``, against their own background when ``background`` is None."""
        return cls(
            (captures.background if background is None else background).astype(np.float32),
            captures.grid,
            captures.ball_radius_mm,
            None if captures.mask.all() else captures.mask,
            None if rest is None or rest.is_flat else rest.normals,
        )

    @property
    def usable(self) -> np.ndarray:
        """Pixels that may be used, bool, shape [height_px, width_px]."""
        if self.mask is not None:
            return self.mask
        return np.ones((self.grid.height_px, self.grid.width_px), dtype=bool)

    def inside(self, circle: ContactCircle) -> np.ndarray:
        """Usable pixels in a contact, bool, shape [height_px, width_px]."""
        return self.usable & (circle.distance_px(self.grid) <= circle.radius_px)


@dataclass(frozen=True)
class PressFrame:
    """One press: what the camera saw, and the gel's surface under the ball."""

    name: str
    image: np.ndarray
    """RGB levels, shape [height_px, width_px, 3]."""
    circle: ContactCircle
    surface: BallSurface
    sha256: str = ""
    circle_sigma_px: CircleSigma = EXACT
    """How far the circle may be off."""


def draw_pixels(
    frame: PressFrame,
    scene: CaptureScene,
    rings: Sequence[Ring],
    rng: np.random.Generator,
    part: tuple[slice, slice] = WHOLE,
) -> np.ndarray:
    """Indices of usable pixels drawn without replacement, counted along the rows of ``part``.

    Args:
        frame: The press.
        scene: Its pixels and which of them may be used.
        rings: Where they are drawn and how many; the contact's own first.
        rng: Draws them.
        part: Rows and columns that they are drawn in.

    Raises:
        InputError: Every pixel of the first ring is masked.
    """
    radii = frame.circle.distance_px(scene.grid)[part] / frame.circle.radius_px
    usable = scene.usable[part]
    regions = [usable & (radii >= low) & (radii < high) for low, high, _ in rings]
    if not regions[0].any():
        raise InputError(f"{frame.name}: every pixel of the contact is masked")
    return np.concatenate(
        [
            rng.permutation(np.flatnonzero(region))[:count]
            for region, (_, _, count) in zip(regions, rings, strict=True)
        ]
    )


def place_region(frames: Sequence[PressFrame]) -> dict[str, tuple[float, float]]:
    """Range of the contacts' centres [px], for a block's ``valid_region``."""
    u = [frame.circle.u_px for frame in frames]
    v = [frame.circle.v_px for frame in frames]
    return {"contact_u_px": (min(u), max(u)), "contact_v_px": (min(v), max(v))}
