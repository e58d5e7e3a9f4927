# SPDX-License-Identifier: Apache-2.0
"""Motion of the markers on the gel in millimetres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.markers.gel_view import PixelView, pixel_jacobian
from taccel_lab.calibration.markers.tracks import MarkerTracks
from taccel_lab.errors import InputError


@dataclass(frozen=True)
class MarkerFlow:
    """Where markers are at rest on the gel, and how far they have moved in each frame."""

    points_mm: np.ndarray
    """Gel xy at rest [mm], shape [marker, 2]; NaN for a marker that is not seen on the gel. Markers
    are those of the tracks, in their order."""
    displacement_mm: np.ndarray
    """Motion from rest along gel x and y [mm], shape [frame, marker, 2]; where not seen it is what
    the neighbours say."""
    seen: np.ndarray
    """Bool, shape [frame, marker]."""
    sigma_mm: np.ndarray
    """Standard deviation of the displacement along x and y [mm], shape [frame, marker, 2]."""
    time_s: np.ndarray | None = None
    """Time of each frame [s], shape [frame], where the frame rate is known."""

    @property
    def frame_count(self) -> int:
        return len(self.displacement_mm)


def marker_flow_mm(
    tracks: MarkerTracks, view: PixelView, *, fps: float | None = None
) -> MarkerFlow:
    """Displacements of tracked markers on the gel.

    Args:
        tracks: Markers in pixels.
        view: What pixels look at.
        fps: Frames a second, where known.

    Raises:
        InputError: No marker at rest is seen on the gel.
    """
    rest_mm = view.gel_from_pixel(tracks.rest_px)
    known = np.isfinite(rest_mm).all(axis=1)
    if not known.any():
        raise InputError("no marker at rest lies where the camera sees the gel")
    moved_mm = view.gel_from_pixel(tracks.uv_px) - rest_mm
    jacobian = pixel_jacobian(view, tracks.rest_px)
    variance = tracks.sigma_px**2 + tracks.rest_sigma_px**2
    sigma = np.sqrt(np.einsum("mij,fmj->fmi", jacobian**2, variance))
    on_gel = np.asarray(np.isfinite(moved_mm).all(axis=2))
    return MarkerFlow(
        points_mm=rest_mm,
        displacement_mm=np.where(on_gel[..., None], moved_mm, 0.0),
        seen=tracks.seen & on_gel,
        sigma_mm=np.where(on_gel[..., None], sigma, np.inf),
        time_s=None if fps is None else np.arange(tracks.frame_count) / fps,
    )
