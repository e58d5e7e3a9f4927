# SPDX-License-Identifier: Apache-2.0
"""Which picture shows the dots at rest: the one that is stated, or one that is found in the videos.

A gel at rest stands still, and its dots lie as evenly as they ever do: what a lens does to them is
smooth over the whole picture, what a contact does is not. So the picture is taken from the longest
time over which a video stands still in one layout of the dots, and refused where the dots lie more
evenly while they move. What this cannot see is a gel that a flat plate holds pressed, or dragged as
a whole, from the first frame to the last.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Any

import numpy as np
from scipy.stats import f as variance_ratio

from taccel_lab.calibration.capture.captures import Frame
from taccel_lab.calibration.capture.folder import MarkerCaptures, Video
from taccel_lab.calibration.markers.remarks import REST_AMBIGUOUS, REST_DISAGREES
from taccel_lab.calibration.markers.still_frames import Stillness, still_stretches
from taccel_lab.errors import InputError
from taccel_lab.reading.dots.detection import DotFlag
from taccel_lab.reading.dots.marker_picture import MarkerPicture, markers_or_none
from taccel_lab.report.remark import Remark

_LOOKED_AT = 6
"""Longest still stretches of a video whose dots are looked at."""
_MOVING = 8
"""Moving frames of a video whose dots are looked at."""
_SURE = 0.99
"""Confidence, over all frames that are compared, that dots lie less evenly than elsewhere."""
_ONE_LAYOUT = 0.02
"""Dots of two stretches lie in one layout when they are nearer than this, in pitches."""
_FROM_STATED = 0.05
"""A stated picture at rest disagrees with a still video when its dots lie farther, in pitches."""
_RIVAL = 0.5
"""Another layout that stands still for this share of the frames is reported."""
_AVERAGED = 16
_MIN_FREE = 10
"""Coordinates beyond those that the smooth map takes, to say how evenly dots lie."""


@dataclass(frozen=True)
class MarkerRest:
    """The picture at rest."""

    frame: Frame
    remarks: tuple[Remark, ...] = ()
    starts: tuple[int, ...] = ()
    """Frame of each video from which its dots are followed: one at rest, or else the first."""


@dataclass(frozen=True)
class _Candidate:
    """A still stretch with its dots."""

    video: Video
    stretch: range
    picture: MarkerPicture

    def where(self) -> dict[str, Any]:
        """Name of the video, first and last frame, as remarks word them."""
        first, last = self.stretch[0], self.stretch[-1]
        return {"name": video_name(self.video), "first": first, "last": last}


def video_name(video: Video) -> str:
    """A short name: the file, or the folder and first frame."""
    parts = video.source.replace("\\", "/").split("/")
    return parts[-1] if video.entry.file is not None else "/".join(parts[-2:])


def find_rest(markers: MarkerCaptures) -> MarkerRest:
    """The picture at rest, found once.

    Raises:
        InputError: None is stated, and the videos show none.
    """
    return markers.once.of("rest", lambda: _find(markers))


def _find(markers: MarkerCaptures) -> MarkerRest:
    if not markers.videos:
        if markers.rest is None:
            raise InputError(
                "no frame at rest: the captures hold neither an image of the untouched gel "
                "(markers.rest or background) nor a video that could show one"
            )
        return MarkerRest(markers.rest)
    stated = None if markers.rest is None else markers_or_none(markers.rest.image())
    pitch_px = _first_pitch_px(markers.videos) if stated is None else _pitch_px(stated)
    if pitch_px is None:
        if markers.rest is None:
            raise InputError(f"{markers.videos[0].source}: no frame shows a lattice of dots")
        return MarkerRest(markers.rest, starts=(0,) * len(markers.videos))
    still = [still_stretches(v.frames(), pitch_px, v.entry.fps) for v in markers.videos]
    found = _candidates(markers.videos, still)
    if markers.rest is not None:
        return _beside_stated(markers.rest, stated, markers.videos, found)
    if not found:
        raise InputError(_nothing_still(markers.videos, still))
    even = _even_layouts(_layouts(found), _moving_frames(markers.videos, still, found))
    return _rest_of(markers.videos, even)


def _middle(stretch: range) -> int:
    return (stretch[0] + stretch[-1]) // 2


def _pitch_px(picture: MarkerPicture) -> float:
    return min(picture.layout_px.pitch)


def _first_pitch_px(videos: Sequence[Video]) -> float | None:
    """Pitch in the first of a few frames that shows a lattice: it need not be exact."""
    for video in videos:
        for image in _spread_frames(video, range(video.frame_count), 3).values():
            if (picture := markers_or_none(image)) is not None:
                return _pitch_px(picture)
    return None


def _spread_frames(video: Video, numbers: Sequence[int], count: int) -> dict[int, np.ndarray]:
    """Some of the numbered frames, evenly over the list."""
    if not numbers:
        return {}
    pick = {numbers[int(k)] for k in np.linspace(0, len(numbers) - 1, count).round()}
    return _frames_at(video, pick)


def _frames_at(video: Video, numbers: set[int]) -> dict[int, np.ndarray]:
    upto = islice(video.frames(), max(numbers, default=-1) + 1)
    return {number: frame for number, frame in enumerate(upto) if number in numbers}


def _candidates(videos: Sequence[Video], still: Sequence[Stillness]) -> list[_Candidate]:
    """The longest stretches of each video whose middle frame shows a lattice, longest first."""
    found = []
    for video, of_video in zip(videos, still, strict=True):
        longest = sorted(of_video.stretches, key=len, reverse=True)[:_LOOKED_AT]
        images = _frames_at(video, {_middle(stretch) for stretch in longest})
        for stretch in longest:
            picture = markers_or_none(images[_middle(stretch)])
            if picture is not None:
                found.append(_Candidate(video, stretch, picture))
    return sorted(found, key=lambda candidate: -len(candidate.stretch))


def _layouts(found: Sequence[_Candidate]) -> list[list[_Candidate]]:
    """Candidates whose dots lie at one place each, those of most frames first."""
    groups: list[list[_Candidate]] = []
    for candidate in found:
        near = (g for g in groups if _apart(g[0].picture, candidate.picture) < _ONE_LAYOUT)
        if (group := next(near, None)) is None:
            groups.append([candidate])
        else:
            group.append(candidate)
    return sorted(groups, key=lambda group: -_frame_count(group))


def _frame_count(group: Sequence[_Candidate]) -> int:
    return sum(len(candidate.stretch) for candidate in group)


def _apart(a: MarkerPicture, b: MarkerPicture) -> float:
    """Median way from the dots of one picture to the nearest of the other, in pitches."""
    gaps_px = np.linalg.norm(a.dots.uv_px[:, None] - b.dots.uv_px[None], axis=2).min(axis=1)
    return float(np.median(gaps_px)) / _pitch_px(a)


def unevenness(picture: MarkerPicture) -> tuple[float, int]:
    """How far whole dots lie off a smooth map of their lattice, in pitches along an axis, and the
    degrees of freedom of that figure, 0 where there are too few dots.

    The map is a cubic of rows and columns: perspective, and what lenses of tactile sensors do over
    their view. Strangers are pulled in to three times the median miss.
    """
    dots, lattice, pitch = picture.dots, picture.lattice, _pitch_px(picture)
    whole = lattice.numbered & ~dots.flagged(DotFlag.CUT) & ~dots.flagged(DotFlag.MERGED)
    steps, uv = lattice.steps()[whole], dots.uv_px[whole]
    if len(steps) == 0:
        return float("nan"), 0
    steps = (steps - steps.mean(axis=0)) / max(float(np.abs(steps - steps.mean(axis=0)).max()), 1.0)
    x, y = steps.T
    design = np.column_stack([x**i * y**j for i in range(4) for j in range(4 - i)])
    free = 2 * (len(uv) - design.shape[1])
    if free < _MIN_FREE:
        return float("nan"), 0
    weight = np.ones(len(uv))
    for _ in range(10):
        map_, *_ = np.linalg.lstsq(design * weight[:, None], uv * weight[:, None], rcond=None)
        miss = uv - design @ map_
        length = np.linalg.norm(miss, axis=1)
        usual = max(float(np.median(length)), 1e-9)
        weight = 1.0 / np.sqrt(1.0 + (length / (2.0 * usual)) ** 2)
    pulled = np.minimum(length, 3.0 * usual)
    # Neighbours miss alike, so that half of the coordinates count.
    return float(np.sqrt((pulled**2).sum() / free)) / pitch, free // 2


def _even_layouts(
    layouts: Sequence[list[_Candidate]], moving: Sequence[tuple[str, tuple[float, int]]]
) -> list[list[_Candidate]]:
    """Layouts that are not less even than another one or a moving frame.

    Raises:
        InputError: None; says where the dots lie more evenly.
    """
    of_layout = [unevenness(group[0].picture) for group in layouts]
    all_figures = [*of_layout, *(figure for _, figure in moving)]
    best, best_free = min(
        (figure for figure in all_figures if figure[1] > 0), default=(float("nan"), 0)
    )
    even = []
    for group, (miss, free) in zip(layouts, of_layout, strict=True):
        level = 1.0 - (1.0 - _SURE) / len(all_figures)
        if not free or (miss / best) ** 2 <= variance_ratio.ppf(level, free, best_free):
            even.append(group)
    if not even:
        where = next((place for place, figure in moving if figure[0] == best), "elsewhere")
        raise InputError(
            "no frame at rest: {name} stands still over frames {first} to {last}, but its dots lie "
            "{miss:.1f} % of their pitch off an even grid there and {best:.1f} % in {where}: the "
            "gel is held pressed. {advice}".format(
                **layouts[0][0].where(),
                miss=100 * of_layout[0][0],
                best=100 * best,
                where=where,
                advice=_ADVICE,
            )
        )
    return even


def _moving_frames(
    videos: Sequence[Video], still: Sequence[Stillness], candidates: Sequence[_Candidate]
) -> list[tuple[str, tuple[float, int]]]:
    """Place and unevenness of some frames outside of the still stretches."""
    found = []
    for video, of_video in zip(videos, still, strict=True):
        if not any(candidate.video is video for candidate in candidates):
            continue
        quiet = {number for stretch in of_video.stretches for number in stretch}
        numbers = [number for number in range(of_video.frames) if number not in quiet]
        for number, image in _spread_frames(video, numbers, _MOVING).items():
            picture = markers_or_none(image)
            if picture is not None and (figure := unevenness(picture))[1] > 0:
                found.append((f"frame {number} of {video_name(video)}", figure))
    return found


def _rest_of(videos: Sequence[Video], even: Sequence[list[_Candidate]]) -> MarkerRest:
    """The layout that stands still for most frames among those that are even."""
    chosen, remarks = even[0][0], []
    rivals = [g for g in even[1:] if _frame_count(g) >= _RIVAL * _frame_count(even[0])]
    if rivals:
        rival = rivals[0][0]
        way_px = _apart(chosen.picture, rival.picture) * _pitch_px(chosen.picture)
        remarks.append(REST_AMBIGUOUS(**rival.where(), way_px=way_px))
    # Motion begins before it shows: not the ends of the stretch.
    video, quarter = chosen.video, len(chosen.stretch) // 4
    inner = chosen.stretch[quarter : len(chosen.stretch) - quarter]
    numbers = f"frames {inner[0]} to {inner[-1]}"
    frame = Frame(
        f"{numbers} of {video_name(video)}",
        f"{video.source}, {numbers}",
        video.sha256,
        partial(_mean_frame, video, inner),
    )
    return MarkerRest(frame, tuple(remarks), _starts(videos, even[0]))


def _mean_frame(video: Video, numbers: range) -> np.ndarray:
    """Mean of up to 16 of the numbered frames: less noise, and no key frame's error alone."""
    images = _spread_frames(video, numbers, _AVERAGED)
    return np.mean([*images.values()], axis=0).round().astype(np.uint8)


def _starts(videos: Sequence[Video], at_rest: Sequence[_Candidate]) -> tuple[int, ...]:
    """Middle of the longest stretch at rest of each video; the first frame where it has none."""
    return tuple(
        next((_middle(c.stretch) for c in at_rest if c.video is video), 0) for video in videos
    )


def _beside_stated(
    rest: Frame, picture: MarkerPicture | None, videos: Sequence[Video], found: list[_Candidate]
) -> MarkerRest:
    """A stated picture is taken as it is; a video that stands still elsewhere is reported."""
    if picture is None:
        return MarkerRest(rest, starts=(0,) * len(videos))
    alike = [c for c in found if _apart(picture, c.picture) < _FROM_STATED]
    remarks = []
    for video in videos:
        own = next((c for c in found if c.video is video), None)
        if own is not None and not any(c.video is video for c in alike):
            way_px = _apart(picture, own.picture) * _pitch_px(picture)
            remarks.append(REST_DISAGREES(rest=rest.name, **own.where(), way_px=way_px))
    return MarkerRest(rest, tuple(remarks), _starts(videos, alike))


_ADVICE = (
    "Record the untouched gel for half a second at the start or end of the video, or state a "
    "picture of it as markers.rest"
)


def _nothing_still(videos: Sequence[Video], still: Sequence[Stillness]) -> str:
    which = int(np.argmax([len(of_video.longest) for of_video in still]))
    best, name = still[which], video_name(videos[which])
    return (
        f"no frame at rest: the dots of {name} lie within {best.limit_px:.2f} px of one place (1 % "
        f"of their pitch) for at most {len(best.longest)} of {best.frames} frames in a row, from "
        f"frame {best.longest[0]}; a rest has {best.needed} or more and does not drift. "
        f"{_ADVICE}"
    )


def frames_before(video: Video, number: int, at_once: int = 256) -> Iterator[np.ndarray]:
    """Frames ``number``, ``number - 1``, ... 0 of a video; reads it again for each part, so that
    few are held in memory."""
    for end in range(number + 1, 0, -at_once):
        start = max(0, end - at_once)
        yield from reversed(list(islice(video.frames(), start, end)))
