# SPDX-License-Identifier: Apache-2.0
"""Which scale the markers' millimetres rest on: the best known, and whether others agree."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from taccel_lab.calibration.capture import CaptureFolder
from taccel_lab.calibration.dots.layout import PITCH_X, PITCH_Y, LayoutFit
from taccel_lab.calibration.markers.gel_view import (
    PixelView,
    camera_view,
    grid_view,
    pixel_jacobian,
)
from taccel_lab.calibration.shared_remarks import SCALE_DISAGREES, SCALE_NOT_MEASURED
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import SensorProfile
from taccel_lab.report.remark import Remark

_MEASURED = ("calibrated", "measured")
_CAMERA_AGREES = 0.05
"""A camera whose scale at the origin is off its own pixel grid by more has another pose."""
_ASSUMED_SIGMA = 0.13
"""Of a scale that nobody measured: published ones of one and the same sensor differ by a quarter,
and an error that is as likely anywhere within has this standard deviation."""
_STATED_SIGMA = 0.01
"""Of a scale or pitch in the manifest, which says nothing of its error: a ruler or a printed board
gives one to about this."""
_AGREE = 0.02
"""Scales that differ by less than this part agree."""


@dataclass(frozen=True)
class ChosenView:
    """A view and what has to be said about it."""

    view: PixelView
    remarks: tuple[Remark, ...]


def choose_view(
    folder: CaptureFolder, profile: SensorProfile, layout: LayoutFit, size_px: tuple[int, int]
) -> ChosenView:
    """The view for the markers' captures.

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
        return ChosenView(chosen, _disagreements(chosen, stated, size_px))
    assumed = grid_view(profile, size_px)
    assumed = replace(assumed, scale_sigma=max(assumed.scale_sigma, _ASSUMED_SIGMA))
    return ChosenView(assumed, (SCALE_NOT_MEASURED(source=assumed.description),))


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
