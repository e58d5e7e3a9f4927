# SPDX-License-Identifier: Apache-2.0
"""What a video says of the tracking itself: jitter at rest, return after release, losses."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from taccel_lab.calibration.markers.neighbourhood import Neighbourhood
from taccel_lab.calibration.markers.remarks import FAST_MOTION, MARKERS_LOST
from taccel_lab.calibration.markers.tracks import MarkerTracks, TrackStatus
from taccel_lab.report.remark import Remark

_QUIET_PX = 0.05
"""Median distance from the frame at rest below which the gel is at rest in any case."""
_QUIET_NOISE = 4.0
"""And in units of the least motion between two of the frames about rest, which is noise."""
_QUIET_MOST_PX = 0.3
_QUIET_FRAMES = 5
_EDGE = 0.1
"""Share of a stretch at rest that is left out where it meets a motion, which begins unseen."""
_MOVED_PX = 1.0
_HALF = 0.5
_BACK = 0.25
"""A gel has been released when its median distance falls below this share of what it was."""
_LOST = 0.2
_FAST = 0.4
"""Motion between frames, in pitches, from which on identities may swap."""
_ALIASES = 0.45
"""Motion between frames of most dots, in pitches, that a lattice cannot tell from one backwards."""


@dataclass(frozen=True)
class TrackFigures:
    """Figures of one video."""

    name: str
    frames: int
    markers: int
    quiet_first: int
    """First frame of the stretch at rest that the dots are followed from."""
    quiet_frames: int
    """Frames of that stretch."""
    jitter_px: float | None
    """Standard deviation of a marker's place over these frames along one axis, median of all
    markers and both axes; None without at least 5 such frames."""
    largest_px: float
    """Largest distance from rest of any seen marker."""
    step_in_pitches: float
    """Largest way of a marker between two frames, over the pitch; near 0.5 a dot cannot be
    distinguished from its neighbour."""
    common_step_in_pitches: float
    """Largest median way of the seen markers between two frames, over the pitch."""
    unseen_frames: tuple[int, ...]
    """Frames in which fewer than half of the markers are seen."""
    seen_share: float
    """Share of all markers and frames that is seen."""
    lost_share: float
    return_frame: int | None
    """Frame after a motion in which the gel is nearest to rest; None when it never comes back."""
    return_median_px: float | None
    """Median distance from rest in that frame."""

    def as_dict(self) -> dict[str, Any]:
        """The figures by name, as JSON holds them."""
        return asdict(self)

    def remarks(self) -> list[Remark]:
        """What the video deserves to have said of it."""
        said = []
        aliases = self.common_step_in_pitches > _ALIASES
        if aliases or self.step_in_pitches > _FAST:
            pitches = self.common_step_in_pitches if aliases else self.step_in_pitches
            said.append(FAST_MOTION(name=self.name, pitches=pitches, grave=aliases))
        if self.lost_share > _LOST or self.unseen_frames:
            said.append(MARKERS_LOST(name=self.name, percent=100 * self.lost_share))
        return said


def track_figures(name: str, tracks: MarkerTracks, start: int = 0) -> TrackFigures:
    """Figures of one video's tracks; ``start`` is the frame that they were followed from."""
    distance = tracks.distance_px()
    median = _medians(distance)
    quiet_first, quiet = _quiet_frames(tracks, start)
    spread = _jitter_px(tracks, quiet_first, quiet)
    step = np.where(
        tracks.seen[1:] & tracks.seen[:-1],
        np.linalg.norm(np.diff(tracks.uv_px, axis=0), axis=2),
        np.nan,
    )
    largest_step = float(np.nan_to_num(step).max(initial=0.0))
    common_step = float(np.nan_to_num(_medians(step)).max(initial=0.0))
    pitch_px = Neighbourhood.of(tracks.rest_px).pitch_px
    back = _return_frame(median)
    return TrackFigures(
        name=name,
        frames=tracks.frame_count,
        markers=tracks.marker_count,
        quiet_first=quiet_first,
        quiet_frames=quiet,
        jitter_px=None if spread is None else float(np.median(spread)),
        largest_px=float(np.nanmax(distance)) if tracks.seen.any() else 0.0,
        step_in_pitches=largest_step / pitch_px,
        common_step_in_pitches=common_step / pitch_px,
        unseen_frames=tuple(np.flatnonzero(tracks.seen.mean(axis=1) < _HALF).tolist()),
        seen_share=float(tracks.seen.mean()),
        lost_share=float((tracks.status == TrackStatus.LOST).mean()),
        return_frame=back,
        return_median_px=None if back is None else float(median[back]),
    )


def _jitter_px(tracks: MarkerTracks, first: int, count: int) -> np.ndarray | None:
    """Standard deviation of each always-seen marker's u and v over a stretch at rest, flat."""
    if count < _QUIET_FRAMES:
        return None
    quiet = slice(first, first + count)
    steady = tracks.seen[quiet].all(axis=0)
    if not steady.any():
        return None
    return tracks.uv_px[quiet, steady].std(axis=0, ddof=1).ravel()


def _quiet_frames(tracks: MarkerTracks, start: int) -> tuple[int, int]:
    """First frame and length of the stretch about ``start`` over which the gel rests."""
    offset = np.linalg.norm(tracks.uv_px - tracks.uv_px[start], axis=2)
    offset = np.where(tracks.seen & tracks.seen[start], offset, np.nan)
    median = _medians(offset)
    near = tracks.uv_px[max(0, start - 5) :][:10]
    steps = [float(np.median(np.linalg.norm(d, axis=1))) for d in np.diff(near, axis=0)]
    limit = np.clip(_QUIET_NOISE * min(steps, default=0.0), _QUIET_PX, _QUIET_MOST_PX)
    moving = np.flatnonzero(~(median < limit))
    first = int(moving[moving < start].max(initial=-1)) + 1
    end = int(moving[moving >= start].min(initial=tracks.frame_count))
    edge = int(_EDGE * (end - first))
    first += edge * (first > 0)
    end -= edge * (end < tracks.frame_count)
    return first, end - first


def _return_frame(median: np.ndarray) -> int | None:
    """Frame nearest to rest among those after a motion of four times the distance."""
    known = np.nan_to_num(median, nan=0.0)
    before = np.maximum.accumulate(np.concatenate([[0.0], known[:-1]]))
    back = (before > _MOVED_PX) & (median < _BACK * before)
    if not back.any():
        return None
    return int(np.argmin(np.where(back, median, np.inf)))


def _medians(rows: np.ndarray) -> np.ndarray:
    """Median of what is known of each row, NaN where nothing is."""
    return np.array([np.nanmedian(row) if np.isfinite(row).any() else np.nan for row in rows])
