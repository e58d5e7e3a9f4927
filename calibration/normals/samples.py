# SPDX-License-Identifier: Apache-2.0
"""Pixels with known normals, drawn from ball presses: the training data of the inverse model.

Inside the contact the gel has the ball's shape: at distance (x, y) from the point below the ball's
centre the outward normal is ``(-x, -y, sqrt(R^2 - x^2 - y^2)) / R``. On a face that is tilted at
rest the ball's centre stands off the middle of the contact along the resting normal, by
``sqrt(R^2 - a^2)`` for a contact of radius a; the circle in the image is the contact's, and the
ball's centre is found from it. Outside lies the gel's sink-in, whose normals the press's surface
gives.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.press_options import UNTOUCHED_RADII
from taccel_lab.calibration.response.frame import (
    WHOLE,
    CaptureScene,
    PressFrame,
    Ring,
    draw_pixels,
)
from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.signals.normal_features import color_change, image_features
from taccel_lab.signals.normals import rotate_to_z

STEEPEST = 0.9986
"""Largest distance from the centre that gives a normal, in radii: the ball is 87 degrees steep."""
MIN_UPRIGHT = 0.2
"""Cosine of the tilt beyond which normals are as uncertain as there."""
MAX_ZOOM = 2.0
"""Zooms are drawn between its inverse and it."""


@dataclass(frozen=True)
class NormalSamples:
    """Pixels of one or several presses."""

    features: np.ndarray
    """Raw features, float32, shape [n, feature]."""
    normals: np.ndarray
    """True normals relative to the resting ones, float32, shape [n, 3]."""

    @classmethod
    def join(cls, samples: Sequence[NormalSamples]) -> NormalSamples:
        """All samples in one."""
        return cls(
            np.concatenate([s.features for s in samples]),
            np.concatenate([s.normals for s in samples]),
        )


@dataclass(frozen=True)
class KnownPress:
    """A press whose surface is known, and who may read it."""

    image: np.ndarray
    """RGB levels under the background's light, float32, shape [height_px, width_px, 3]."""
    normals: np.ndarray
    """Outward unit normals relative to rest, as a camera sees them, shape [h, w, 3]."""
    rise_m: np.ndarray
    """Rise over rest [m], shape [height_px, width_px]."""
    compared: np.ndarray
    """Pixels that are compared, bool, same shape."""
    left_out: int | None = None
    """The network that reads it, since the others saw it; all read it when None."""
    normals_sigma_deg: np.ndarray | None = None
    """Standard deviation of each component of the known normals [degrees], shape [h, w]; exact when
    None."""
    rise_sigma_m: float = 0.0
    """Standard deviation of the known rise [m]."""

    @classmethod
    def of_ball(
        cls,
        frame: PressFrame,
        scene: CaptureScene,
        *,
        left_out: int | None = None,
        rise_sigma_m: float = 0.0,
    ) -> KnownPress:
        """A captured ball, compared in its contact."""
        normals = true_normals(frame, scene)
        return cls(
            frame.image,
            normals,
            1e-3 * frame.surface.displacement_mm(),
            scene.inside(frame.circle),
            left_out,
            np.degrees(circle_angle_rad(frame, scene, normals)),
            rise_sigma_m,
        )


def draw_samples(
    frame: PressFrame,
    scene: CaptureScene,
    config: NormalModelConfig,
    rings: Sequence[Ring],
    rng: np.random.Generator,
    zooms: int = 1,
) -> NormalSamples:
    """Pixels of one press at several zooms, the first of which is 1."""
    change = color_change(frame.image, scene.background, scene.mask)
    wanted = true_normals(frame, scene)
    reach = np.log(MAX_ZOOM)
    drawn = [1.0, *(float(np.exp(rng.uniform(-reach, reach))) for _ in range(zooms - 1))]
    parts = []
    for zoom in drawn:
        # Zoomed windows are wide; only the part of the image that is drawn from is filtered. The
        # far field is seen at its own scale: it is flat at every zoom.
        whole = zoom == 1.0
        part = WHOLE if whole else _window(frame.circle, scene.grid)
        chosen = [
            (low, high, max(1, count // zooms))
            for low, high, count in rings
            if whole or math.isfinite(high)
        ]
        picked = draw_pixels(frame, scene, chosen, rng, part)
        features = image_features(
            config, change, scene.background, mask=scene.mask, zoom=zoom, window=part,
            picked=picked,
        )  # fmt: skip
        normals = wanted[part].reshape(-1, 3)[picked].astype(np.float32)
        parts.append(NormalSamples(features, normals))
    return NormalSamples.join(parts)


def true_normals(frame: PressFrame, scene: CaptureScene) -> np.ndarray:
    """Known normals relative to rest: of the ball inside, of the surface outside."""
    inside = frame.circle.distance_px(scene.grid) <= frame.circle.radius_px
    outside = rotate_to_z(frame.surface.normals, frame.surface.rest_normals)
    ball = ball_normals(frame.circle, scene)
    if scene.rest_normals is not None:
        ball = rotate_to_z(ball, scene.rest_normals)
    return np.where(inside[..., None], ball, outside)


def circle_angle_rad(frame: PressFrame, scene: CaptureScene, normals: np.ndarray) -> np.ndarray:
    """Standard deviation [rad] of each component of the ball's normals by what the circle's centre
    is off by, shape [...] of ``normals`` relative to rest of shape [..., 3].

    A centre that is off by d turns them by ``d / R`` across the slope and by ``d / (R cos tilt)``
    along it; the root of the mean square of the two is taken.
    """
    off = frame.circle_sigma_px[0] * scene.grid.mm_per_px_x / scene.ball_radius_mm
    return off * np.sqrt(0.5 + 0.5 / np.maximum(normals[..., 2], MIN_UPRIGHT) ** 2)


def ball_center_px(circle: ContactCircle, scene: CaptureScene) -> tuple[float, float]:
    """Pixel (u, v) below the centre of the ball that touches in ``circle``."""
    if scene.rest_normals is None:
        return circle.u_px, circle.v_px
    grid, ball_mm = scene.grid, scene.ball_radius_mm
    row = int(np.clip(round(circle.v_px), 0, grid.height_px - 1))
    column = int(np.clip(round(circle.u_px), 0, grid.width_px - 1))
    normal = scene.rest_normals[row, column]
    rim_mm = min(circle.radius_px * grid.mm_per_px_x, ball_mm)
    off_mm = math.sqrt(ball_mm**2 - rim_mm**2)
    return (
        circle.u_px + float(normal[0]) * off_mm / grid.mm_per_px_x,
        circle.v_px + float(normal[1]) * off_mm / grid.mm_per_px_y,
    )


def ball_normals(circle: ContactCircle, scene: CaptureScene) -> np.ndarray:
    """Outward unit normals of the ball's shape at every pixel, shape [height_px, width_px, 3].

    They hold inside the contact only; beyond the ball's own outline they are as steep as at it.
    """
    grid, ball_mm = scene.grid, scene.ball_radius_mm
    u_px, v_px = ball_center_px(circle, scene)
    x = (np.arange(grid.width_px)[None, :] - u_px) * grid.mm_per_px_x / ball_mm
    y = (np.arange(grid.height_px)[:, None] - v_px) * grid.mm_per_px_y / ball_mm
    x, y = np.broadcast_arrays(x, y)
    distance = np.hypot(x, y)
    shrink = np.minimum(1.0, STEEPEST / np.maximum(distance, 1e-12))
    x, y = x * shrink, y * shrink
    return np.stack([-x, -y, np.sqrt(1.0 - x**2 - y**2)], axis=-1)


def angle_between_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle between unit vectors [degrees], shape [...] of [..., 3]; exact for small angles."""
    half_chord = np.linalg.norm(a - b, axis=-1) / 2
    return np.degrees(2 * np.arcsin(np.clip(half_chord, 0.0, 1.0)))


def _window(circle: ContactCircle, grid: PixelGrid) -> tuple[slice, slice]:
    """Rows and columns that a contact moves, and a margin for the filters."""
    reach_u = (UNTOUCHED_RADII + 0.6) * circle.radius_px + 4
    reach_v = reach_u * grid.mm_per_px_x / grid.mm_per_px_y
    return (
        slice(max(0, int(circle.v_px - reach_v)), int(circle.v_px + reach_v) + 2),
        slice(max(0, int(circle.u_px - reach_u)), int(circle.u_px + reach_u) + 2),
    )
