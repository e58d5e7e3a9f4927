# SPDX-License-Identifier: Apache-2.0
"""Presses of known surface: pixels to train the inverse model with, and how far it is off on those
that were not seen.

Inside the contact the gel has the ball's shape: at distance (x, y) from the point below the ball's
centre the outward normal is ``(-x, -y, sqrt(R^2 - x^2 - y^2)) / R``. On a face that is tilted at
rest the ball's centre stands off the middle of the contact along the resting normal, by
``sqrt(R^2 - a^2)`` for a contact of radius a; the circle in the image is the contact's, and the
ball's centre is found from it. Outside lies the gel's sink-in, whose normals the press's surface
gives.

Errors are those on synthetic presses that no network saw, and on every training ball as read by the
network that did not see it. Where a ball is, is known to a pixel or two only: what its centre may
be off by is taken off the errors of normals, so that their radius does not have to hold errors of
labels.

Heights are stated as absolute ones. Synthetic presses are exact and say what the reading adds.
Balls say what comes on top, an error that lies along the slope all around the dent. How much of it
is that of each circle and how much the reading's they do not tell apart, so that all of it counts.
What is wrong in all circles alike, in the scale or in the gel's law was learnt along and shows in
no error: it is given as a share of the depth.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

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
from taccel_lab.networks.normal_settings import RAYLEIGH_95, NormalModelConfig
from taccel_lab.processes.ahead import ahead
from taccel_lab.reading.features import color_change, image_features
from taccel_lab.reading.heights import (
    BAND_SIGMAS,
    HeightUncertainty,
    ReadHeights,
    read_heights,
)
from taccel_lab.reading.slopes import NormalModel, relative_normals
from taccel_lab.robust_fit import MIN_PRESSES, radius_factor
from taccel_lab.signals.normals import rotate_to_z

STEEPEST = 0.9986
"""Largest distance from the centre that gives a normal, in radii: the ball is 87 degrees steep."""
MIN_UPRIGHT = 0.2
"""Cosine of the tilt beyond which normals are as uncertain as there."""
MAX_ZOOM = 2.0
"""Zooms are drawn between its inverse and it."""
LENGTHS_PX = (4.0, 8.0, 16.0)
"""Distances over which neighbours may err together that are tried."""
EVERY_PX = 2
"""Rows and columns apart that presses are read for their errors alone. All of them take three times
as long; on FOTS they change factors by up to 2.5 %, errors of heights by 0.5 %."""
SHARE = 0.95
LEAST_M = 1e-9


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


@dataclass(frozen=True)
class DrawnPixels:
    """Pixels of a picture at one zoom."""

    zoom: float
    part: tuple[slice, slice]
    """Rows and columns that they are drawn in."""
    picked: np.ndarray
    """Counted along the rows of ``part``, shape [n]."""


def samples_of_presses(
    frames: Sequence[PressFrame],
    scene: CaptureScene,
    config: NormalModelConfig,
    rings: Sequence[Ring],
    rng: np.random.Generator,
    zooms: int = 1,
) -> list[NormalSamples]:
    """Pixels of each press at several zooms, the first of which is 1.

    All random numbers are drawn here, in order: the pixels are the same however many presses are
    worked on at once.
    """
    drawn = ((frame, _drawn_pixels(frame, scene, rings, rng, zooms)) for frame in frames)
    return list(ahead(lambda one: _samples(*one, scene, config), drawn))


def _drawn_pixels(
    frame: PressFrame,
    scene: CaptureScene,
    rings: Sequence[Ring],
    rng: np.random.Generator,
    zooms: int,
) -> list[DrawnPixels]:
    reach = np.log(MAX_ZOOM)
    drawn = [1.0, *(float(np.exp(rng.uniform(-reach, reach))) for _ in range(zooms - 1))]
    found = []
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
        found.append(DrawnPixels(zoom, part, draw_pixels(frame, scene, chosen, rng, part)))
    return found


def _samples(
    frame: PressFrame,
    drawn: Sequence[DrawnPixels],
    scene: CaptureScene,
    config: NormalModelConfig,
) -> NormalSamples:
    change = color_change(frame.image, scene.background, scene.mask)
    wanted = true_normals(frame, scene)
    parts = []
    for pixels in drawn:
        features = image_features(
            config, change, scene.background, mask=scene.mask, zoom=pixels.zoom,
            window=pixels.part, picked=pixels.picked,
        )  # fmt: skip
        normals = wanted[pixels.part].reshape(-1, 3)[pixels.picked].astype(np.float32)
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


@dataclass(frozen=True)
class SyntheticScore:
    """Absolute errors of heights on presses of other tools."""

    rmse_mm: float
    """Error over the dents: root of the mean over presses of the mean square."""
    median_press_share: float
    """Median over presses of the root mean square in the dent over its deepest point: presses go as
    deep as the balls of the captures did, on one sensor 0.1 to 0.9 mm, on another 0.3 to 2."""
    worst_press_mm: float
    within_95: float
    """Share of the dents' pixels in the band of 95 %, presses of equal weight; these presses set
    the band, so that it tells how even it is, not how true."""
    normals_within_95: float
    """Share of them in the radius of 95 %, likewise."""
    count: int


@dataclass(frozen=True)
class ReadingErrors:
    """Errors of some pixels of a press that was read, shape [n] each."""

    angle_sigmas: np.ndarray
    """Angles over the expected standard deviation, what the ball's centre may be off by taken
    off."""
    height_m: np.ndarray
    """Errors of heights."""
    spreads_m: Sequence[np.ndarray]
    """Standard deviations of heights before any factor, for each of ``LENGTHS_PX``."""
    along_m: np.ndarray
    """Height that is off where all slopes are too steep by what is expected of them."""
    deepest_m: float
    """How deep the press is."""


def with_reading_errors(
    model: NormalModel,
    synthetic_presses: Iterable[KnownPress],
    balls: Iterable[KnownPress],
    scene: CaptureScene,
    depth_share: float,
) -> tuple[NormalModel, SyntheticScore | None]:
    """The model with its radius of 95 % and the spread of its heights, and how well it read the
    synthetic presses.

    All factors are those that hold 95 % of a new press's pixels in the mean (cross-conformal): the
    radius on synthetic presses or on captured balls, whichever asks for more, the spread of the
    reading on synthetic presses, and what comes on top along the slopes on balls. Heights have a
    spread where there are synthetic presses; the length over which errors go together is
    the one with the narrowest band. ``depth_share`` is what all readings may be off by
    (``ball_surface.depth_share``).
    """
    drawn = all_errors(model, synthetic_presses, scene)
    captured = all_errors(model, balls, scene)
    groups = [group for group in (drawn, captured) if group]
    if not groups:
        return model, None
    radius = max(radius_factor([e.angle_sigmas for e in g], SHARE, RAYLEIGH_95) for g in groups)
    config = replace(model.config, radius95_sigmas=radius)
    if not drawn:
        return NormalModel(config, model.weights), None

    def band(k: int) -> tuple[float, int, float]:
        """Mean width, the length, and the factor that holds the share."""
        over = [e.height_m / e.spreads_m[k] for e in drawn]
        factor = radius_factor(over, SHARE, BAND_SIGMAS) / BAND_SIGMAS
        return factor * float(np.mean([e.spreads_m[k].mean() for e in drawn])), k, factor

    _, k, factor = min(map(band, range(len(LENGTHS_PX))))
    config = replace(
        config, error_length_px=LENGTHS_PX[k], height_factor=factor, depth_share=depth_share,
        along_factor=_along_factor(captured, k, factor),
    )  # fmt: skip
    dents = [float(1e3 * np.sqrt(np.mean(e.height_m**2))) for e in drawn]
    deepest_mm = [1e3 * e.deepest_m for e in drawn]
    score = SyntheticScore(
        rmse_mm=float(np.sqrt(np.mean(np.square(dents)))),
        median_press_share=float(np.median(np.divide(dents, deepest_mm))),
        worst_press_mm=float(np.max(dents)),
        within_95=float(
            np.mean([np.mean(e.height_m <= BAND_SIGMAS * factor * e.spreads_m[k]) for e in drawn])
        ),
        normals_within_95=float(np.mean([np.mean(e.angle_sigmas <= radius) for e in drawn])),
        count=len(dents),
    )
    return NormalModel(config, model.weights), score


def widened(model: NormalModel, found: Sequence[ReadingErrors]) -> NormalModel:
    """The model with bands that hold 95 % of presses that nothing had seen, too, where they were
    narrower; as it is where there are fewer than ``MIN_PRESSES`` of those."""
    if len(found) < MIN_PRESSES:
        return model
    config = model.config
    radius = radius_factor([e.angle_sigmas for e in found], SHARE, RAYLEIGH_95)
    along = config.along_factor
    if config.height_factor > 0:
        k = LENGTHS_PX.index(config.error_length_px)
        along = max(along, _along_factor(found, k, config.height_factor))
    config = replace(
        config, radius95_sigmas=max(config.radius95_sigmas, radius), along_factor=along
    )
    return NormalModel(config, model.weights)


def _along_factor(balls: Sequence[ReadingErrors], k: int, factor: float) -> float:
    """Share of the expected errors of slopes that has to lie along them for the heights of balls;
    all of it where too few balls tell."""
    over = [_beyond(e.height_m, BAND_SIGMAS * factor * e.spreads_m[k]) / e.along_m for e in balls]
    return radius_factor(over, SHARE, BAND_SIGMAS) / BAND_SIGMAS


def all_errors(
    model: NormalModel, presses: Iterable[KnownPress], scene: CaptureScene
) -> list[ReadingErrors]:
    """Errors of every press of which a pixel is compared."""
    found = ahead(lambda press: errors_of(model, press, scene), presses)
    return [one for one in found if one is not None]


def errors_of(
    model: NormalModel, press: KnownPress, scene: CaptureScene, read: ReadHeights | None = None
) -> ReadingErrors | None:
    """Errors of ``model`` on a press, ``read`` being what it reads there, where that is known; None
    where no pixel is compared."""
    compared = press.compared if scene.mask is None else press.compared & scene.mask
    kept = np.zeros_like(compared)
    part = np.s_[::EVERY_PX, ::EVERY_PX]
    kept[part] = compared[part]
    if not kept.any():
        return None
    read = read or read_heights(
        model, press.image, scene.background, scene.grid, mask=scene.mask,
        rest_normals=scene.rest_normals, left_out=press.left_out, uncertainty=False,
    )  # fmt: skip
    found = read.normals
    angle = angle_between_deg(relative_normals(found.tilt_rad[kept]), press.normals[kept])
    if press.normals_sigma_deg is not None:
        angle = _beyond(angle, RAYLEIGH_95 * press.normals_sigma_deg[kept])
    sigmas = angle / found.sigma_deg[kept]
    uncertain = [HeightUncertainty(scene.grid, length) for length in LENGTHS_PX]
    weights = None if scene.mask is None else scene.mask.astype(float)
    slope_sigma = found.slope_sigma()
    spreads = [each.sigma_m(slope_sigma, weights=weights, zero=read.zero) for each in uncertain]
    # Over any length alike: it is smooth, and the grid of the shortest is the finest.
    along = uncertain[0].along_m(read.slope, slope_sigma, weights=weights, zero=read.zero)
    return ReadingErrors(
        angle_sigmas=sigmas,
        height_m=_beyond(
            np.abs(read.rise_m - press.rise_m)[kept],
            np.array(BAND_SIGMAS * press.rise_sigma_m),
        ),
        spreads_m=[np.maximum(spread[kept], LEAST_M) for spread in spreads],
        along_m=np.maximum(along[kept], LEAST_M),
        deepest_m=-float(press.rise_m.min()),
    )


def _beyond(error: np.ndarray, known_to: np.ndarray) -> np.ndarray:
    """What is left of errors to explain, where something independent explains ``known_to`` in 95 %:
    radii of independent errors add by their squares."""
    return np.sqrt(np.maximum(error**2 - np.square(known_to), 0.0))
