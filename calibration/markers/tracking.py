# SPDX-License-Identifier: Apache-2.0
"""Follow the dots of a resting gel through the frames of a motion.

Frame by frame: dots are detected at the size that they have at rest and matched to the markers
(``association``). A marker that is not seen goes along with its neighbours and is found again when
it reappears there, so that it keeps its identity through occlusion and through motions of more than
the pitch, as long as neighbours move alike from frame to frame.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from taccel_lab.calibration.dots.detection import detect_dots
from taccel_lab.calibration.dots.dots import DotFlag, Dots
from taccel_lab.calibration.dots.marker_picture import MarkerPicture
from taccel_lab.calibration.markers.association import associate
from taccel_lab.calibration.markers.neighbourhood import Neighbourhood
from taccel_lab.calibration.markers.tracks import MarkerTracks, TrackStatus
from taccel_lab.errors import InputError

LOST_AFTER = 12
"""Frames unseen after which a marker is lost rather than predicted."""
_MEMORY = 0.7
"""Share of the last motion between two frames that is expected to go on."""
_WEAKER = 0.6
"""Dots in contact may have this share of the contrast that separates dots at rest."""


def track_markers(frames: Iterable[np.ndarray], rest: MarkerPicture) -> MarkerTracks:
    """Follow the dots of ``rest`` through ``frames``.

    Args:
        frames: RGB or grey images in order, of the size of the picture at rest; the first has to
            be near rest (within half a pitch, or moved as a whole smoothly).
        rest: Dots at rest.

    Raises:
        InputError: No frame, or frames of another size.
    """
    tracker = MarkerTracker.of(rest)
    dots, row, column = tracker.dots, tracker.row, tracker.column
    places, sigmas, statuses = [], [], []
    for number, frame in enumerate(frames):
        height, width = np.shape(frame)[:2]
        if (width, height) != dots.size_px:
            raise InputError(
                f"frame {number} is {width}x{height} px, the picture at rest "
                f"{dots.size_px[0]}x{dots.size_px[1]} px"
            )
        tracker.advance(frame)
        places.append(tracker.uv.copy())
        sigmas.append(tracker.sigma.copy())
        statuses.append(tracker.status.copy())
    if not places:
        raise InputError("the video holds no frame")
    return MarkerTracks(
        uv_px=np.array(places),
        sigma_px=np.array(sigmas),
        status=np.array(statuses),
        rest_px=dots.uv_px,
        rest_sigma_px=dots.sigma_px,
        row=row,
        column=column,
        size_px=dots.size_px,
    )


def _reading_order(rest: MarkerPicture) -> np.ndarray:
    """Row by row, then those without a number from top to bottom."""
    row, column, uv = rest.lattice.row, rest.lattice.column, rest.dots.uv_px
    return np.lexsort((np.where(row >= 0, column, uv[:, 1]), row, row < 0))


class MarkerTracker:
    """State of all markers in the present frame."""

    @classmethod
    def of(cls, rest: MarkerPicture) -> MarkerTracker:
        """All markers where they are at rest."""
        order = _reading_order(rest)
        return cls(rest.dots.select(order), rest.lattice.row[order], rest.lattice.column[order])

    def __init__(self, dots: Dots, row: np.ndarray, column: np.ndarray) -> None:
        self.dots = dots
        self.row, self.column = row, column
        self.around = Neighbourhood.of(dots.uv_px)
        self.scale = replace(dots.scale, threshold=_WEAKER * dots.scale.threshold)
        self.uv = dots.uv_px.copy()
        self.sigma = dots.sigma_px.copy()
        self.status = np.full(dots.count, TrackStatus.SEEN, dtype=np.uint8)
        self.motion = np.zeros_like(self.uv)
        self.unseen = np.zeros(dots.count, dtype=int)

    def advance(self, frame: np.ndarray) -> None:
        """Match and place all markers in the next frame."""
        found = detect_dots(frame, self.scale)
        before = self.uv
        expected = before + _MEMORY * self.motion
        odd = found.flagged(DotFlag.ODD)
        chosen = associate(expected, before, found.uv_px, odd, self.around)
        seen = chosen >= 0
        place = np.full_like(before, np.nan)
        sigma = np.full_like(before, np.nan)
        place[seen], sigma[seen] = found.uv_px[chosen[seen]], found.sigma_px[chosen[seen]]
        if (~seen).any():
            guess, scatter = self._say(place, seen, expected)
            place[~seen] = guess[~seen]
            sigma[~seen] = np.maximum(scatter[~seen], 0.05)[:, None]
        self.unseen = np.where(seen, 0, self.unseen + 1)
        self._set_status(place, seen)
        self.motion = place - before
        self.uv, self.sigma = place, sigma

    def _say(
        self, place: np.ndarray, seen: np.ndarray, expected: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where the neighbours' displacements from rest put each marker."""
        rest = self.around.rest_px
        moved = np.where(seen[:, None], place - rest, 0.0)
        said, scatter, support = self.around.extrapolate(moved, seen)
        known = np.asarray(np.isfinite(said).all(axis=1))
        # The fewer neighbours are seen, the further the field has to be carried on.
        unseen = 1.0 - support / self.around.weight.sum(axis=1)
        scatter = scatter * (1.0 + 2.0 * unseen)
        return np.where(known[:, None], rest + said, expected), scatter

    def _set_status(self, place: np.ndarray, seen: np.ndarray) -> None:
        width, height = self.dots.size_px
        slack = float(np.median(self.dots.radius_px))
        outside = ((place < -slack) | (place > (width - 1 + slack, height - 1 + slack))).any(axis=1)
        lost = ~seen & (outside | (self.unseen > LOST_AFTER))
        self.status = np.where(
            seen, TrackStatus.SEEN, np.where(lost, TrackStatus.LOST, TrackStatus.PREDICTED)
        ).astype(np.uint8)
