# SPDX-License-Identifier: Apache-2.0
"""Photometric figures of a design: what its picture is worth before there is a sensor.

The light on a pixel is one irradiance vector per channel; stacked they map the surface normal to
the colour, so their condition number says how well a colour tells a slope from another (R. J.
Woodham, "Photometric method for determining surface orientation from multiple images", Optical
Engineering 19, 1980). Rows are scaled to unit length first: exposure and white balance are free.

The depth of field is that of a thin lens for a blur of one pixel. With the aperture A, focal
length f in pixels and focus at s, a point at distance d blurs over ``f A |1/d - 1/s|`` pixels (e.g.
Hecht, "Optics", thin lens equation); the limits solve that for 1 px. Distances are those in air: a
layer of height h and index n counts as h / n.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.camera.refraction import FlatMedia

if TYPE_CHECKING:
    from taccel_lab.optics.render import LightField, OpticalModel


@dataclass(frozen=True)
class DepthOfField:
    """Where the image is sharp to one pixel."""

    near_mm: float
    """Nearest sharp distance from the camera along its axis, in air [mm]."""
    far_mm: float
    """Farthest; infinite beyond the hyperfocal distance."""
    depth_in_gel_mm: float
    """The range between them, stretched by the gel's index [mm]."""
    sharp_fraction: float
    """Part of the seen gel at rest within the range."""
    worst_blur_px: float
    """Largest diameter of the blur on the seen gel [px]."""


def sharp_range_mm(focal_px: float, aperture_mm: float, focus_mm: float) -> tuple[float, float]:
    """Nearest and farthest distance with a blur of at most one pixel [mm]."""
    margin = 1.0 / (focal_px * aperture_mm)
    inverse_far = 1.0 / focus_mm - margin
    near = 1.0 / (1.0 / focus_mm + margin)
    return near, (1.0 / inverse_far if inverse_far > 0 else math.inf)


def blur_px(
    distance_mm: np.ndarray, focal_px: float, aperture_mm: float, focus_mm: float
) -> np.ndarray:
    """Diameter of the blur of points at distances along the axis [px]."""
    return focal_px * aperture_mm * np.abs(1.0 / distance_mm - 1.0 / focus_mm)


def depth_of_field(model: OpticalModel, light: LightField) -> DepthOfField | None:
    """Depth of field over the seen gel; None when aperture or focus is unknown."""
    camera = model.camera.camera
    if camera.aperture_mm == 0 or camera.focus_mm == 0:
        return None
    focal = math.sqrt(camera.fx_px * camera.fy_px)
    near, far = sharp_range_mm(focal, camera.aperture_mm, camera.focus_mm)
    points = light.points_mm[light.mask].astype(np.float64)
    distance = _distance_in_air(model, points)
    return DepthOfField(
        near_mm=near,
        far_mm=far,
        depth_in_gel_mm=(far - near) * model.design.gel_refractive_index,
        sharp_fraction=float(((distance >= near) & (distance <= far)).mean()),
        worst_blur_px=float(blur_px(distance, focal, camera.aperture_mm, camera.focus_mm).max()),
    )


def _distance_in_air(model: OpticalModel, points_mm: np.ndarray) -> np.ndarray:
    """Paraxial distance along the optical axis, layers of flat media shortened by their index."""
    camera = model.camera
    axis = camera.gel_from_camera[:, 2]
    offset = points_mm - camera.position_mm
    depth = offset @ axis
    if not isinstance(model.media, FlatMedia) or not model.media.planes_mm:
        return depth / model.media.indices[-1]
    edges = [camera.position_mm[2], *model.media.planes_mm]
    ahead = sum(
        (high - low) / index
        for low, high, index in zip(edges[:-1], edges[1:], model.media.indices[:-1], strict=True)
    )
    vertical = ahead + (points_mm[:, 2] - edges[-1]) / model.media.indices[-1]
    return depth * vertical / offset[:, 2]


_RANK_RATIO = 0.02
"""Singular values below this share of the largest count as none."""


@dataclass(frozen=True)
class Spread:
    """A figure over the visible gel."""

    minimum: float
    median: float
    maximum: float

    @classmethod
    def of(cls, values: np.ndarray) -> Spread:
        finite = values[np.isfinite(values)]
        if finite.size == 0:
            return cls(math.nan, math.nan, math.nan)
        return cls(float(finite.min()), float(np.median(finite)), float(finite.max()))


@dataclass(frozen=True)
class Photometry:
    """Figures of the untouched gel without its dots; channels in the order red, green, blue."""

    uniformity_min_over_mean: tuple[float, float, float]
    """Darkest over mean of the linear image, 1 for an even one; NaN for a channel without light."""
    uniformity_variation: tuple[float, float, float]
    """Standard deviation over mean."""
    light_rank: int
    """Independent directions of light, over at least half of the gel: 3 lets one picture tell
    every slope, 2 leaves a line of slopes alike, 1 is a grey or single-sided sensor."""
    condition_number: Spread | None
    """Condition number of the channels' light directions; None when they do not span space
    (``light_rank`` < 3)."""
    visible_fraction: float
    """Area of the contact face that the image shows over its whole area."""
    mm_per_px_x: Spread
    """Size of a pixel on the face along image rows [mm]."""
    mm_per_px_y: Spread
    anisotropy: Spread
    """Longest over shortest side of a pixel's footprint."""
    shadowed_fraction: float
    """Part of the light facing the gel that the gel itself blocks."""
    levels_per_deg: tuple[float, float, float]
    """Grey levels that a channel changes per degree of tilt in its best direction, median."""
    weakest_levels_per_deg: float
    """The same for all channels together in the worst direction of tilt, median."""
    saturated_fraction: float
    """Values at 255 in the picture of the untouched gel."""
    depth_of_field: DepthOfField | None
    """None when the aperture or the focus is unknown."""

    def to_json(self) -> dict[str, Any]:
        """Plain numbers for JSON; NaN and infinity become None."""
        return _plain(asdict(self))


def measure_photometry(model: OpticalModel) -> Photometry:
    """Measure the photometry of a model's untouched gel."""
    light = model.light_field()
    mask = light.mask
    # Dots are no unevenness of the light.
    picture = model.radiance(light, markers=False)
    linear = picture[mask].astype(np.float64)
    mean = linear.mean(axis=0)
    lit = np.where(mean > 0, mean, np.nan)
    rank, condition = channel_independence(light.vectors[mask])
    gain, weakest = _shading_gain(model, light, picture)
    across, down, anisotropy = pixel_footprint(light.points_mm)
    return Photometry(
        uniformity_min_over_mean=_triple(linear.min(axis=0) / lit),
        uniformity_variation=_triple(linear.std(axis=0) / lit),
        light_rank=rank,
        condition_number=condition,
        visible_fraction=_visible_fraction(model, light),
        mm_per_px_x=Spread.of(across),
        mm_per_px_y=Spread.of(down),
        anisotropy=Spread.of(anisotropy),
        shadowed_fraction=float(light.blocked.sum() / max(light.facing.sum(), 1e-30)),
        levels_per_deg=_triple(np.median(gain, axis=0)),
        weakest_levels_per_deg=float(np.median(weakest)),
        saturated_fraction=float((model.display.rgb(linear) == 255).mean()),
        depth_of_field=depth_of_field(model, light),
    )


def channel_independence(vectors: np.ndarray) -> tuple[int, Spread | None]:
    """Rank and condition number of irradiance vectors, [pixel, 3 channels, 3].

    The rank is that of at least half of the pixels. Dark channels add nothing to it.
    """
    vectors = np.asarray(vectors, dtype=np.float64)
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    rows = np.where(length > 1e-12 * length.max(), vectors / np.maximum(length, 1e-300), 0.0)
    singular = np.linalg.svd(rows, compute_uv=False)
    rank = int(np.median((singular > _RANK_RATIO * singular[:, :1]).sum(axis=1)))
    if rank < 3:
        return rank, None
    return rank, Spread.of(singular[:, 0] / np.maximum(singular[:, 2], 1e-12))


def pixel_footprint(points_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Size of each pixel on the face.

    Args:
        points_mm: Seen points, NaN where none is, shape [H, W, 3].

    Returns:
        Along rows [mm], along columns [mm] and longest over shortest side, each [H, W], NaN at the
        border of what is seen.
    """
    across = np.full(points_mm.shape, np.nan)
    down = np.full(points_mm.shape, np.nan)
    across[:, 1:-1] = 0.5 * (points_mm[:, 2:] - points_mm[:, :-2])
    down[1:-1] = 0.5 * (points_mm[2:] - points_mm[:-2])
    metric = np.stack([across, down], axis=-2).astype(np.float64)
    good = np.isfinite(metric).all(axis=(-1, -2))
    sides = np.full((*good.shape, 2), np.nan)
    sides[good] = np.linalg.svd(metric[good], compute_uv=False)
    with np.errstate(invalid="ignore", divide="ignore"):
        anisotropy = sides[..., 0] / sides[..., 1]
    return np.linalg.norm(across, axis=-1), np.linalg.norm(down, axis=-1), anisotropy


def _visible_fraction(model: OpticalModel, light: LightField) -> float:
    """Seen area over the face's area, from the footprints of the pixels.

    Each seen pixel covers the parallelogram of its two sides; at the border, where a side is
    unknown, that of the nearest seen pixel along the row or column stands in.
    """
    face = model.rest_face
    corners = face.points_mm[face.triangles]
    whole = (
        0.5
        * np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
        ).sum()
    )
    points = light.points_mm.astype(np.float64)
    across, down = _sides(points, 1), _sides(points, 0)
    area = np.linalg.norm(np.cross(across, down), axis=-1)[light.mask]
    known = np.isfinite(area)
    if not known.any():
        return 0.0
    return float(np.clip(area[known].mean() * light.mask.sum() / whole, 0.0, 1.0))


def _sides(points: np.ndarray, axis: int) -> np.ndarray:
    """Step to the next pixel along an axis, averaged over both neighbours or from the one seen."""
    points = np.moveaxis(points, axis, 0)
    forward = np.full_like(points, np.nan)
    forward[:-1] = np.diff(points, axis=0)
    backward = np.full_like(points, np.nan)
    backward[1:] = forward[:-1]
    both = 0.5 * (forward + backward)
    one = np.where(np.isnan(forward), backward, forward)
    return np.moveaxis(np.where(np.isnan(both), one, both), 0, axis)


def _shading_gain(
    model: OpticalModel, light: LightField, linear: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Grey levels per degree of tilt: best direction by channel [pixel, 3], worst of all [pixel].

    A tilt by a small angle along the tangent t changes the irradiance of a channel by its vector's
    part along t; the marker-free coating, the display's slope and the way to the camera scale it.
    """
    mask = light.mask
    normal = light.normals[mask].astype(np.float64)
    vectors = light.vectors[mask].astype(np.float64)
    tangential = vectors - np.einsum("pcx,px->pc", vectors, normal)[..., None] * normal[:, None]
    slope = model.display.levels_per_radiance(linear[mask]) * model.passed[mask][:, None]
    albedo = model.reflectance(light, markers=False)[mask] / math.pi
    if model.design.gel_scattering_per_mm > 0:
        tangential = np.zeros_like(tangential)
    change = tangential * (slope * albedo)[..., None] * math.radians(1.0)
    # The normal's own direction carries nothing, so that the third singular value is 0.
    weakest = np.linalg.svd(change, compute_uv=False)[:, 1]
    return np.linalg.norm(change, axis=-1), weakest


def _triple(values: np.ndarray) -> tuple[float, float, float]:
    r, g, b = (float(v) for v in values)
    return r, g, b


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
