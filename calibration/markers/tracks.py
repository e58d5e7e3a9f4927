# SPDX-License-Identifier: Apache-2.0
"""Markers followed through a video."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np


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
