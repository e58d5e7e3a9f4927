# SPDX-License-Identifier: Apache-2.0
"""Places on the gel from pixels: through the pixel grid, or through the calibrated camera,
whichever is known best.

A dot lies on the contact face, so that its pixel's sight line, bent by window and gel, is followed
to the height that the face has at rest. A press moves dots towards the camera; the parallax of that
is not corrected.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import LinearNDInterpolator

from taccel_lab.calibration.capture import CaptureFolder
from taccel_lab.calibration.remarks import SCALE_DISAGREES, SCALE_NOT_MEASURED
from taccel_lab.camera.gel_camera import CameraModel, profile_media, resized
from taccel_lab.camera.refraction import Media, without_refraction
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, Region
from taccel_lab.profile import SensorProfile
from taccel_lab.reading.dots.lattice import PITCH_X, PITCH_Y, LayoutFit
from taccel_lab.report.remark import Remark

_FLAT_MM = 0.01
_STEPS = 40
_EXACT_MM = 1e-7
_HALF_PX = 0.25
_MEASURED = ("calibrated", "measured")
_CAMERA_AGREES = 0.05
"""A camera whose scale at the origin is off its own pixel grid by more has another pose."""
_ASSUMED_SIGMA = 0.13
"""Spread of a scale that nobody measured: published ones of one sensor differ by a quarter, and
an error that is as likely anywhere within has this standard deviation."""
_STATED_SIGMA = 0.01
"""Spread of a scale or pitch in the manifest, which says nothing of its error: a ruler or a
printed board gives one to about this."""
_AGREE = 0.02
"""Scales that differ by less than this part agree."""


@dataclass(frozen=True)
class PixelView:
    """Where on the gel a pixel looks."""

    gel_from_pixel: Callable[[np.ndarray], np.ndarray]
    """Gel xy [mm] of pixels (u, v), [.., 2] -> [.., 2]; NaN where the gel is not seen."""
    description: str
    """What the view rests on, for provenance."""
    scale_sigma: float = 0.0
    """Relative standard deviation of its scale; 0 when unknown."""


def face_seen(
    model: CameraModel, media: Media, height_mm: Callable[[np.ndarray], np.ndarray]
) -> Callable[[np.ndarray], np.ndarray]:
    """Where pixels of a camera look through media: ``PixelView.gel_from_pixel``.

    ``height_mm`` is z of the contact face at rest over gel xy, [n, 2] -> [n]; NaN beside it.
    """

    def gel_from_pixel(uv_px: np.ndarray) -> np.ndarray:
        uv = np.asarray(uv_px, dtype=np.float64)
        entry, inside, _ = media.trace(*model.rays(uv.reshape(-1, 2)))
        slope = inside[:, :2] / np.where(inside[:, 2] > 0, inside[:, 2], np.nan)[:, None]
        z, xy = np.zeros(len(slope)), np.full((len(slope), 2), np.nan)
        # The face is flat or gently domed: its height where the last guess met it is soon exact.
        for _ in range(_STEPS):
            new = entry[:, :2] + slope * (z - entry[:, 2])[:, None]
            moved = np.nanmax(np.abs(new - xy), initial=0.0) if np.isfinite(xy).any() else np.inf
            xy = new
            if moved < _EXACT_MM:
                break
            z = height_mm(xy)
        return xy.reshape(uv.shape)

    return gel_from_pixel


def pixel_jacobian(view: PixelView, uv_px: np.ndarray) -> np.ndarray:
    """Change of gel xy with the pixel [mm/px], [.., 2] -> [.., 2, 2] (last axis: along u, v)."""
    uv = np.asarray(uv_px, dtype=np.float64)
    steps = []
    for axis in (0, 1):
        offset = np.zeros(2)
        offset[axis] = _HALF_PX
        ahead, behind = view.gel_from_pixel(uv + offset), view.gel_from_pixel(uv - offset)
        steps.append((ahead - behind) / (2 * _HALF_PX))
    return np.stack(steps, axis=-1)


def camera_view(
    profile: SensorProfile, size_px: tuple[int, int], *, refraction: bool = True
) -> PixelView:
    """View through the camera of a profile, for pictures of ``size_px`` (width, height).

    Without ``refraction`` sight lines are straight, as for a pose that was fitted that way.

    Raises:
        InputError: The profile has no optics, or its picture has another shape.
    """
    optics = profile.optics
    if optics is None:
        raise InputError("the profile has no camera to look through (block optics)")
    camera = optics.camera()
    _require_shape("camera", (camera.width_px, camera.height_px), size_px)
    media = profile_media(profile, optics)
    return PixelView(
        face_seen(
            CameraModel(resized(camera, *size_px)),
            media if refraction else without_refraction(media),
            _contact_height(profile),
        ),
        f"the {optics.provenance.kind} camera of the profile, "
        + ("through window and gel" if refraction else "sight lines straight"),
        _relative_sigma(profile),
    )


def _require_shape(what: str, theirs: tuple[int, int], size_px: tuple[int, int]) -> None:
    if abs(theirs[0] * size_px[1] - theirs[1] * size_px[0]) > max(size_px):
        raise InputError(
            f"the profile's {what} has {theirs[0]}x{theirs[1]} px, the picture of the markers "
            f"{size_px[0]}x{size_px[1]}: another shape, so that it gives no millimetres; state "
            "mm_per_px_x and mm_per_px_y, or the dots' pitch_x_mm, in captures.toml"
        )


def grid_view(profile: SensorProfile, size_px: tuple[int, int]) -> PixelView:
    """View by the pixel grid of a profile, for pictures of ``size_px``; as ``camera_view``."""
    grid = profile.grid()
    _require_shape("pixel grid", (grid.width_px, grid.height_px), size_px)
    return PixelView(
        grid.resized(*size_px).gel_from_pixel,
        f"the {profile.camera.provenance.kind} scale of the profile",
        _relative_sigma(profile),
    )


def _contact_height(profile: SensorProfile) -> Callable[[np.ndarray], np.ndarray]:
    """z of the profile's contact face over gel xy [mm], [n, 2] -> [n]."""
    mesh = profile.mesh
    points = mesh.nodes_m[mesh.region_nodes(Region.CONTACT)] * 1e3
    inner = np.abs(points[:, :2]).max(axis=0) * 0.6
    middle = points[(np.abs(points[:, :2]) <= inner).all(axis=1)]
    if len(middle) and np.ptp(middle[:, 2]) < _FLAT_MM:
        level = float(np.median(middle[:, 2]))
        return lambda xy: np.full(len(xy), level)
    return LinearNDInterpolator(points[:, :2], points[:, 2])


def _relative_sigma(profile: SensorProfile) -> float:
    """Relative standard deviation of the profile's scale; 0 when it states none."""
    camera = profile.camera
    spread = camera.provenance.spread
    scales = {"mm_per_px_x": camera.mm_per_px_x, "mm_per_px_y": camera.mm_per_px_y}
    return max(
        (spread[name] / scale for name, scale in scales.items() if name in spread), default=0.0
    )


def choose_view(
    folder: CaptureFolder, profile: SensorProfile, layout: LayoutFit, size_px: tuple[int, int]
) -> tuple[PixelView, tuple[Remark, ...]]:
    """The view for the markers' captures, and what has to be said about its scale.

    In this order: a calibrated camera of the profile, a calibrated or measured scale of the
    profile, the scale that the manifest states, the pitch that it states, what the profile assumes.

    Raises:
        InputError: None of them fits pictures of that size.
    """
    stated = _stated(folder, layout, size_px)
    chosen: PixelView | None = None
    if _has_pose(profile):
        chosen = _through_camera(profile, size_px)
    elif profile.camera.provenance.kind in _MEASURED:
        chosen = grid_view(profile, size_px)
    elif stated:
        chosen = stated[0]
    if chosen is not None:
        return chosen, _disagreements(chosen, stated, size_px)
    assumed = grid_view(profile, size_px)
    assumed = replace(assumed, scale_sigma=max(assumed.scale_sigma, _ASSUMED_SIGMA))
    return assumed, (SCALE_NOT_MEASURED(source=assumed.description),)


def _has_pose(profile: SensorProfile) -> bool:
    """Whether the profile's camera was calibrated with its pose: a lens alone gives no scale."""
    optics = profile.optics
    if optics is None or optics.provenance.kind not in _MEASURED:
        return False
    return "position_z_mm" in optics.provenance.spread


def _through_camera(profile: SensorProfile, size_px: tuple[int, int]) -> PixelView:
    """The calibrated camera, with sight lines straight or bent, as its pose was fitted: what agrees
    with the calibrated pixel grid. The grid itself where neither does."""
    views = [camera_view(profile, size_px, refraction=bent) for bent in (True, False)]
    if profile.camera.provenance.kind not in _MEASURED:
        return views[0]
    grid, pixels = grid_view(profile, size_px), profile.grid().resized(*size_px)
    origin = np.array([pixels.center_u_px, pixels.center_v_px])
    scale = np.diag(pixel_jacobian(grid, origin))
    off = [np.abs(np.diag(pixel_jacobian(view, origin)) / scale - 1).max() for view in views]
    best = int(np.argmin(off))
    return views[best] if off[best] < _CAMERA_AGREES else grid


def _stated(folder: CaptureFolder, layout: LayoutFit, size_px: tuple[int, int]) -> list[PixelView]:
    """Views from the manifest: its scale, then its pitch."""
    views = []
    if folder.mm_per_px is not None:
        grid = PixelGrid(*size_px, *folder.mm_per_px)
        views.append(
            PixelView(grid.gel_from_pixel, "the scale stated in the manifest", _STATED_SIGMA)
        )
    markers = folder.markers
    if markers is not None and (markers.pitch_x_mm or markers.pitch_y_mm):
        pitch_x_px, pitch_y_px = layout.pitch
        x, y = markers.pitch_x_mm, markers.pitch_y_mm
        per_x = x / pitch_x_px if x else (y or 0.0) / pitch_y_px
        per_y = y / pitch_y_px if y else per_x
        quarter = abs(layout.rotation_deg) > 20.0
        if quarter and x and y:
            raise InputError(
                f"the dots' rows lie {layout.rotation_deg:.0f} degrees off the image's: pitches "
                "along x and y then give no scale; state mm_per_px_x and mm_per_px_y"
            )
        of_dots = max(layout.sigma(PITCH_X) / pitch_x_px, layout.sigma(PITCH_Y) / pitch_y_px)
        sigma = float(np.hypot(of_dots, _STATED_SIGMA))
        grid = PixelGrid(*size_px, per_x, per_y)
        square = "" if x and y else ", for square pixels"
        text = f"the pitch of the dots stated in the manifest{square}"
        views.append(PixelView(grid.gel_from_pixel, text, sigma))
    return views


def _disagreements(
    chosen: PixelView, stated: list[PixelView], size_px: tuple[int, int]
) -> tuple[Remark, ...]:
    """A warning for every stated scale that differs from the chosen one."""
    middle = np.array([(size_px[0] - 1) / 2, (size_px[1] - 1) / 2])
    ours = np.abs(np.diag(pixel_jacobian(chosen, middle)))
    remarks = []
    for other in stated:
        theirs = np.abs(np.diag(pixel_jacobian(other, middle)))
        off = theirs / ours - 1.0
        allowed = max(_AGREE, 2.0 * float(np.hypot(chosen.scale_sigma, other.scale_sigma)))
        if other is not chosen and np.abs(off).max() > allowed:
            remarks.append(
                SCALE_DISAGREES(
                    scales=f"{other.description} {theirs[0]:.4f} x {theirs[1]:.4f} mm/px, "
                    f"{chosen.description} {ours[0]:.4f} x {ours[1]:.4f}, which is used "
                    f"({100 * off[0]:+.1f} and {100 * off[1]:+.1f} %)"
                )
            )
    return tuple(remarks)
