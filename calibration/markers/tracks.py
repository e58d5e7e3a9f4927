# SPDX-License-Identifier: Apache-2.0
"""Markers followed through a video, in pixels and in millimetres on the gel."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from taccel_lab.calibration.markers.gel_view import PixelView, pixel_jacobian
from taccel_lab.errors import InputError


class TrackStatus(IntEnum):
    """What is known of a marker in a frame."""

    LOST = 0
    """Nothing near enough: out of the picture, or hidden for long; its place is a guess."""
    PREDICTED = 1
    """Not seen; placed by its neighbours."""
    SEEN = 2


@dataclass(frozen=True)
class MarkerTracks:
    """Places of all markers in all frames."""

    uv_px: np.ndarray
    """Centres (u, v) [px], float64, shape [frame, marker, 2]."""
    sigma_px: np.ndarray
    """Their standard deviations along u and v, shape [frame, marker, 2]."""
    status: np.ndarray
    """``TrackStatus``, uint8, shape [frame, marker]."""
    rest_px: np.ndarray
    """Places at rest, shape [marker, 2]."""
    rest_sigma_px: np.ndarray
    """Shape [marker, 2]."""
    row: np.ndarray
    """Row in the lattice, -1 for none, shape [marker]."""
    column: np.ndarray
    """Column in the lattice, -1 for none, shape [marker]."""
    size_px: tuple[int, int]
    """Width and height of the frames."""

    @classmethod
    def joined(cls, back: MarkerTracks, onward: MarkerTracks) -> MarkerTracks:
        """Tracks in order of time, of those from one frame back to the first and from it on."""
        before = {
            name: np.concatenate([getattr(back, name)[:0:-1], getattr(onward, name)])
            for name in ("uv_px", "sigma_px", "status")
        }
        return replace(onward, **before)

    @property
    def frame_count(self) -> int:
        return len(self.uv_px)

    @property
    def marker_count(self) -> int:
        return self.uv_px.shape[1]

    @property
    def seen(self) -> np.ndarray:
        """Bool, shape [frame, marker]."""
        return self.status == TrackStatus.SEEN

    @property
    def displacement_px(self) -> np.ndarray:
        """Way from rest, shape [frame, marker, 2]."""
        return self.uv_px - self.rest_px

    def distance_px(self) -> np.ndarray:
        """Distance from rest where seen, NaN elsewhere, shape [frame, marker]."""
        length = np.linalg.norm(self.displacement_px, axis=2)
        return np.where(self.seen, length, np.nan)


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
