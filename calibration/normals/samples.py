# SPDX-License-Identifier: Apache-2.0
"""Pixels with known normals, drawn from ball presses: the training data of the inverse model.

Inside the contact the ball gives the normal, far from it the resting face does. Between the two
lies the gel's sink-in, whose normals only a surface (``BallSurface``) gives; without one those
pixels are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.capture.captures import UNTOUCHED_RADII, ContactCircle
from taccel_lab.calibration.circles.ball_surface import BallSurface
from taccel_lab.calibration.normals.ball_normals import ball_normals
from taccel_lab.calibration.pixel_draw import draw_regions
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.signals.normal_features import color_change, image_features
from taccel_lab.signals.normals import rotate_to_z

RIM_RADII = 0.98
"""Within this many contact radii a pixel lies in the contact, as well as circles are known."""
SINK_IN_RADII = 1.03
"""Beyond this many it surely lies outside."""


CircleSigma = tuple[float, float]
"""Standard deviations of a circle's centre along an axis and of its radius [px]."""
EXACT: CircleSigma = (0.0, 0.0)


MIN_UPRIGHT = 0.2
"""Cosine of the tilt beyond which normals are as uncertain as there."""


@dataclass(frozen=True)
class InverseFrame:
    """One press as the inverse fit sees it."""

    name: str
    image: np.ndarray
    """RGB levels under the background's light, float, shape [height_px, width_px, 3]."""
    circle: ContactCircle
    sha256: str
    surface: BallSurface | None = None
    """Gel surface under the press, where one was made."""
    circle_sigma_px: CircleSigma = EXACT
    """How far the circle may be off."""


@dataclass(frozen=True)
class CaptureScene:
    """What all presses of one capture set have in common."""

    background: np.ndarray
    """RGB levels, shape [height_px, width_px, 3]."""
    grid: PixelGrid
    ball_radius_mm: float
    mask: np.ndarray | None = None
    """Pixels that may be used, bool, shape [height_px, width_px]."""
    rest_normals: np.ndarray | None = None
    """Outward unit normals at rest, shape [height_px, width_px, 3]; flat when None."""


@dataclass(frozen=True)
class NormalSamples:
    """Pixels of one or several presses."""

    features: np.ndarray
    """Raw features, float32, shape [n, feature]."""
    normals: np.ndarray
    """True normals relative to the resting ones, float32, shape [n, 3]."""


@dataclass(frozen=True)
class SampleOptions:
    """How many pixels are drawn of each press."""

    disc_pixels: int = 3000
    """Within the contact."""
    sink_in_pixels: int = 1500
    """Between the contact and the resting face, where a surface is given."""
    flat_pixels: int = 700
    """Where the gel is at rest."""
    zooms: int = 3
    """Zooms at which each press is seen; the first is 1."""
    max_zoom: float = 2.0
    """Zooms are drawn between 1 / max_zoom and max_zoom."""

    def __post_init__(self) -> None:
        for name in ("disc_pixels", "flat_pixels", "zooms"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} must be at least 1, got {getattr(self, name)}")
        if not 1.0 <= self.max_zoom <= 8.0:
            raise InputError(f"max_zoom must lie in 1..8, got {self.max_zoom}")


def draw_samples(
    frame: InverseFrame,
    scene: CaptureScene,
    config: NormalModelConfig,
    options: SampleOptions,
    rng: np.random.Generator,
) -> NormalSamples:
    """Pixels of one press at several zooms."""
    change = color_change(frame.image, scene.background, scene.mask)
    usable = usable_pixels(scene)
    distance = frame.circle.distance_px(scene.grid) / frame.circle.radius_px
    wanted = true_normals(frame, scene)
    zooms = [1.0]
    reach = np.log(options.max_zoom)
    zooms += [float(np.exp(rng.uniform(-reach, reach))) for _ in range(options.zooms - 1)]
    regions = [
        (usable & (distance <= RIM_RADII), options.disc_pixels),
        (usable & (distance > UNTOUCHED_RADII), options.flat_pixels),
    ]
    if frame.surface is not None:
        sink_in = usable & (distance > SINK_IN_RADII) & (distance <= UNTOUCHED_RADII)
        regions.insert(1, (sink_in, options.sink_in_pixels))
    window = _window(
        frame.circle, scene.grid, UNTOUCHED_RADII if frame.surface is not None else 1.0
    )
    features, normals = [], []
    for zoom in zooms:
        # Zoomed windows are wide; only the part of the image that is drawn from is filtered. The
        # far field is seen at its own scale: it is flat at every zoom.
        part = (slice(None), slice(None)) if zoom == 1.0 else window
        wide = regions if zoom == 1.0 else regions[:-1]
        chosen = [(region[part], max(1, count // len(zooms))) for region, count in wide]
        picked = np.concatenate(list(draw_regions(frame.name, chosen, rng)))
        features.append(
            image_features(
                config,
                change,
                scene.background,
                mask=scene.mask,
                zoom=zoom,
                window=part,
                picked=picked,
            )
        )
        normals.append(wanted[part].reshape(-1, 3)[picked])
    return NormalSamples(np.concatenate(features), np.concatenate(normals).astype(np.float32))


def true_normals(frame: InverseFrame, scene: CaptureScene) -> np.ndarray:
    """Known normals relative to rest: of the ball inside, of the surface (or rest) outside."""
    inside = frame.circle.distance_px(scene.grid) <= frame.circle.radius_px
    if frame.surface is not None:
        outside = rotate_to_z(frame.surface.normals, frame.surface.rest_normals)
    else:
        outside = np.array([0.0, 0.0, 1.0])
    ball = ball_normals(frame.circle, scene.grid, scene.ball_radius_mm, scene.rest_normals)
    if scene.rest_normals is not None:
        ball = rotate_to_z(ball, scene.rest_normals)
    return np.where(inside[..., None], ball, outside)


def circle_angle_rad(frame: InverseFrame, scene: CaptureScene, normals: np.ndarray) -> np.ndarray:
    """Standard deviation [rad] of each component of the ball's normals by what the circle's centre
    is off by, shape [...] of ``normals`` relative to rest of shape [..., 3].

    A centre that is off by d turns them by ``d / R`` across the slope and by ``d / (R cos tilt)``
    along it; the root of the mean square of the two is taken.
    """
    off = frame.circle_sigma_px[0] * scene.grid.mm_per_px_x / scene.ball_radius_mm
    return off * np.sqrt(0.5 + 0.5 / np.maximum(normals[..., 2], MIN_UPRIGHT) ** 2)


def usable_pixels(scene: CaptureScene) -> np.ndarray:
    """Pixels that may be used, bool, shape [height_px, width_px]."""
    if scene.mask is not None:
        return scene.mask
    return np.ones((scene.grid.height_px, scene.grid.width_px), dtype=bool)


def join(samples: Sequence[NormalSamples]) -> NormalSamples:
    """All samples in one."""
    return NormalSamples(
        np.concatenate([s.features for s in samples]), np.concatenate([s.normals for s in samples])
    )


def _window(circle: ContactCircle, grid: PixelGrid, radii: float) -> tuple[slice, slice]:
    """Rows and columns within so many radii of the contact and a margin for the filters."""
    reach_u = (radii + 0.6) * circle.radius_px + 4
    reach_v = reach_u * grid.mm_per_px_x / grid.mm_per_px_y
    return (
        slice(max(0, int(circle.v_px - reach_v)), int(circle.v_px + reach_v) + 2),
        slice(max(0, int(circle.u_px - reach_u)), int(circle.u_px + reach_u) + 2),
    )
