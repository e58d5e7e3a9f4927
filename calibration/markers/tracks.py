# SPDX-License-Identifier: Apache-2.0
"""Markers followed through a video, in pixels and in millimetres on the gel: what the tracks say of
their own quality, and their files.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.calibration.markers.gel_view import PixelView, pixel_jacobian
from taccel_lab.calibration.markers.remarks import FAST_MOTION, MARKERS_LOST, UNREAD_FRAMES
from taccel_lab.calibration.markers.whole_frames import Unread, in_sentences
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import atomic_file, write_by
from taccel_lab.reading.dots.lattice_growth import Neighbourhood
from taccel_lab.report.remark import Remark


class TrackStatus(IntEnum):
    """What is known of a marker in a frame."""

    LOST = 0
    """Nothing near enough: out of the picture, or hidden for long; its place is a guess."""
    PREDICTED = 1
    """Not seen; placed by its neighbours, or by the frames around one that is not read."""
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
    unread: Mapping[int, Unread] = field(default_factory=dict)
    """Frames that are not what the camera saw; no marker of them is seen."""

    @classmethod
    def joined(cls, back: MarkerTracks, onward: MarkerTracks) -> MarkerTracks:
        """Tracks in order of time, of those from one frame back to the first and from it on."""
        before = {
            name: np.concatenate([getattr(back, name)[:0:-1], getattr(onward, name)])
            for name in ("uv_px", "sigma_px", "status")
        }
        start = back.frame_count - 1
        unread = {start - number: one for number, one in back.unread.items()}
        unread |= {start + number: one for number, one in onward.unread.items()}
        return replace(onward, **before, unread=unread)

    def without(self, unread: Mapping[int, Unread]) -> MarkerTracks:
        """Tracks that do not read some frames: markers lie there between the frames around, as
        uncertain as they moved in the meantime."""
        found = replace(self, unread=dict(unread))
        numbers, read = np.array(sorted(unread), dtype=int), found.read
        uv, sigma, status = self.uv_px.copy(), self.sigma_px.copy(), self.status.copy()
        status[numbers] = np.minimum(status[numbers], TrackStatus.PREDICTED)
        if len(read) == 0:
            uv[:], sigma[:] = self.rest_px, max(self.size_px)
        elif len(numbers):
            after = np.searchsorted(read, numbers)
            a, b = read[np.maximum(after - 1, 0)], read[np.minimum(after, len(read) - 1)]
            way, (gap, past) = uv[b] - uv[a], (x[:, None, None] for x in (b - a, numbers - a))
            uv[numbers] = uv[a] + np.where(gap > 0, past / np.maximum(gap, 1), 0.0) * way
            # As it moved just before and after: it may have turned in between.
            steps = np.abs(np.diff(uv[read], axis=0))
            steps = np.pad(steps, [(1, 1), (0, 0), (0, 0)])
            near = np.clip(after + np.arange(-1, 2)[:, None], 0, len(steps) - 1)
            moved = steps[near].max(axis=0) * np.where(gap > 0, 1, np.abs(past))
            sigma[numbers] = np.hypot(np.maximum(sigma[a], sigma[b]), moved)
        return replace(found, uv_px=uv, sigma_px=sigma, status=status)

    @property
    def read(self) -> np.ndarray:
        """Numbers of the frames that are read, in order, int."""
        return np.setdiff1d(np.arange(self.frame_count), sorted(self.unread))

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
    step_frame: int
    """The second of these frames."""
    common_step_in_pitches: float
    """Largest median way of the seen markers between two frames, over the pitch."""
    unseen_frames: tuple[int, ...]
    """Frames that are read, with fewer than half of the markers seen."""
    unread: tuple[str, ...]
    """Frames that are not what the camera saw, a sentence for each fault."""
    seen_share: float
    """Share of all markers and frames that is seen."""
    lost_share: float
    return_frame: int | None
    """Frame after a motion in which the gel is nearest to rest; None when it never comes back."""
    return_median_px: float | None
    """Median distance from rest in that frame."""

    def remarks(self) -> list[Remark]:
        """What the video deserves to have said of it."""
        said = [UNREAD_FRAMES(name=self.name, frames_unread=text) for text in self.unread]
        aliases = self.common_step_in_pitches > _ALIASES
        if aliases or self.step_in_pitches > _FAST:
            pitches = self.common_step_in_pitches if aliases else self.step_in_pitches
            at = self.step_frame
            said.append(FAST_MOTION(name=self.name, pitches=pitches, frame=at, grave=aliases))
        if self.lost_share > _LOST or self.unseen_frames:
            said.append(MARKERS_LOST(name=self.name, percent=100 * self.lost_share))
        return said


def track_figures(name: str, tracks: MarkerTracks, start: int = 0) -> TrackFigures:
    """Figures of one video's tracks; ``start`` is the frame that they were followed from."""
    distance = tracks.distance_px()
    median = _medians(distance)
    quiet_first, quiet = _quiet_frames(tracks, start)
    spread = _jitter_px(tracks, quiet_first, quiet)
    read = tracks.read
    seen = tracks.seen[read]
    step = np.where(
        seen[1:] & seen[:-1],
        np.linalg.norm(np.diff(tracks.uv_px[read], axis=0), axis=2),
        np.nan,
    )
    steps, common = np.nan_to_num(step).max(axis=1, initial=0.0), np.nan_to_num(_medians(step))
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
        step_in_pitches=float(steps.max(initial=0.0)) / pitch_px,
        step_frame=int(read[1 + np.argmax(steps)]) if len(steps) else 0,
        common_step_in_pitches=float(common.max(initial=0.0)) / pitch_px,
        unseen_frames=tuple(read[seen.mean(axis=1) < _HALF].tolist()),
        unread=in_sentences(tracks.unread),
        seen_share=float(tracks.seen.mean()),
        lost_share=float((tracks.status == TrackStatus.LOST).mean()),
        return_frame=back,
        return_median_px=None if back is None else float(median[back]),
    )


def _jitter_px(tracks: MarkerTracks, first: int, count: int) -> np.ndarray | None:
    """Standard deviation of each always-seen marker's u and v over a stretch at rest, flat."""
    quiet = np.intersect1d(np.arange(first, first + count), tracks.read)
    if len(quiet) < _QUIET_FRAMES:
        return None
    steady = tracks.seen[quiet].all(axis=0)
    if not steady.any():
        return None
    return tracks.uv_px[quiet][:, steady].std(axis=0, ddof=1).ravel()


def _quiet_frames(tracks: MarkerTracks, start: int) -> tuple[int, int]:
    """First frame and length of the stretch about ``start`` over which the gel rests."""
    offset = np.linalg.norm(tracks.uv_px - tracks.uv_px[start], axis=2)
    offset = np.where(tracks.seen & (tracks.seen[start] | (start in tracks.unread)), offset, np.nan)
    median = _medians(offset)
    near = tracks.uv_px[tracks.read[tracks.read >= start - 5][:10]]
    steps = [float(np.median(np.linalg.norm(d, axis=1))) for d in np.diff(near, axis=0)]
    limit = np.clip(_QUIET_NOISE * min(steps, default=0.0), _QUIET_PX, _QUIET_MOST_PX)
    moving = np.intersect1d(np.flatnonzero(~(median < limit)), tracks.read)
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


SUFFIXES = (".npz", ".csv")


def require_track_file(path: Path) -> None:
    """Refuse a file of an unknown kind before any long work."""
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: tracks are written as {', '.join(SUFFIXES)}")


def write_tracks(
    path: Path, tracks: Mapping[str, MarkerTracks], flows: Mapping[str, MarkerFlow]
) -> None:
    """Write the tracks of all videos, by name, with their flow in millimetres; the suffix says how.

    Raises:
        InputError: Another suffix than .npz and .csv.
    """
    require_track_file(path)
    if path.suffix == ".npz":
        arrays = {}
        for number, (name, track) in enumerate(tracks.items()):
            prefix = f"video{number}_"
            arrays[prefix + "name"] = np.array(name)
            for key, value in _arrays(track, flows[name]).items():
                arrays[prefix + key] = value
        write_by(path, partial(np.savez_compressed, **arrays))
    else:
        with (
            atomic_file(path) as staging,
            staging.open("w", encoding="utf-8", newline="") as stream,
        ):
            writer = csv.writer(stream)
            writer.writerow(
                "video frame marker row column status u_px v_px sigma_u_px sigma_v_px x_mm y_mm "
                "dx_mm dy_mm".split()
            )
            for name, track in tracks.items():
                writer.writerows(_rows(name, track, flows[name]))


def _arrays(track: MarkerTracks, flow: MarkerFlow) -> dict[str, np.ndarray]:
    of_track = ("row", "column", "rest_px", "uv_px", "sigma_px", "status")
    arrays = {name: getattr(track, name) for name in of_track} | {
        "points_mm": flow.points_mm,
        "displacement_mm": flow.displacement_mm,
        "displacement_sigma_mm": flow.sigma_mm,
        "displacement_seen": flow.seen,
    }
    if flow.time_s is not None:
        arrays["time_s"] = flow.time_s
    return arrays


def _rows(name: str, track: MarkerTracks, flow: MarkerFlow) -> list[list[Any]]:
    rows = []
    for frame in range(track.frame_count):
        for marker in range(track.marker_count):
            on_gel = np.isfinite(flow.points_mm[marker]).all()
            mm = np.concatenate([flow.points_mm[marker], flow.displacement_mm[frame, marker]])
            rows.append(
                [
                    name,
                    frame,
                    marker,
                    track.row[marker],
                    track.column[marker],
                    TrackStatus(track.status[frame, marker]).name.lower(),
                    *track.uv_px[frame, marker].round(4),
                    *track.sigma_px[frame, marker].round(4),
                    *(mm.round(5) if on_gel else [""] * 4),
                ]
            )
    return rows
