# SPDX-License-Identifier: Apache-2.0
"""Frames of a video that are not what the camera saw: shifted, torn, with rows of one colour, sent
twice.

A frame is held against the last one that was read. Where the light is too even to tell whether the
gel moved or the frame, the dots do: none of a gel all jump alike and are back a frame later.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy.spatial import KDTree

from taccel_lab.calibration.frame_shift import Look, Shift, shift_between
from taccel_lab.reading.dots.blobs import grey_levels
from taccel_lab.reading.dots.marker_picture import MarkerPicture
from taccel_lab.reading.whole_frame import ALIKE_LEVELS, lost_rows

_ON = 0.4
"""A tenth of the dots moved by more than this part of a shift just before it: it is no jump."""
_JUMP = 0.05
"""Motion of all dots from which on it is a jump, in pitches."""
_ALIKE = 0.15
"""Dots that jump alike differ by less than this part of the jump, at the median."""
_BACK = 0.25
"""Dots are back within this part of the jump."""
_NAMED = 8
"""Frames that a sentence names."""
_HALF = 0.42
"""Jumps of more than this, in pitches, look the same to both sides."""
REPEATED_SHARE = 0.25
"""Most of a video's frames that a camera sends twice."""
SHORT = 3
"""Frames after which a jump is a motion."""
LASTING = 25
"""Frames in a row after which a shift is no fault of the link."""


class Fault(Enum):
    """What is wrong with a frame, and what to do about it."""

    SHIFTED = "sent shifted as a whole"
    TORN = "sent with some rows shifted"
    LOST = "sent with rows of one colour"
    REPEATED = "the frame before sent once more"

    @property
    def advice(self) -> str:
        """What keeps it from happening again."""
        if self is Fault.REPEATED:
            return "record at the camera's own frame rate, with nothing else on its port"
        return "try another cable or port, or a lower resolution or frame rate"


@dataclass(frozen=True)
class Unread:
    """Why a frame is not read."""

    fault: Fault
    detail: str

    @property
    def words(self) -> str:
        """Both, for a sentence."""
        return f"{self.fault.value} {self.detail}".strip()


class FrameJudge:
    """Compares the frames of one video, in their order."""

    def __init__(self, rest: MarkerPicture) -> None:
        """``rest``: what the first frame is compared with."""
        self._dots, self._pitch_px = rest.dots, min(rest.layout_px.pitch)
        self._read = self._earlier = self._look(rest.image)
        self._rest = grey_levels(rest.image)[..., None]
        self._run = 0
        self.carried_px = np.zeros(2)
        """How far the latest frame, which is read, is shifted for good, as the camera was moved."""

    def _look(self, frame: np.ndarray) -> Look:
        return Look.at(frame, float(np.median(self._dots.radius_px)), self._dots.scale.sign)

    def fault(self, frame: np.ndarray, motion_px: np.ndarray) -> Unread | None:
        """What is wrong with the next frame; None where it can be read, and is compared with from
        now on.

        ``motion_px``: how dots moved to the frame before, shape [marker, 2]. A shift that goes on
        as many of them moved is theirs, as lamps move, too, where they are held by hand.
        """
        if np.ptp(frame) <= 2 * ALIKE_LEVELS:
            return Unread(Fault.LOST, f"rows 0 to {len(frame) - 1}")
        lost = lost_rows(grey_levels(frame)[..., None], self._rest)
        if lost is not None:
            return Unread(Fault.LOST, f"{lost.axis} {lost.first} to {lost.last}")
        look = self._look(frame)
        shift, self.carried_px = shift_between(self._read, look), np.zeros(2)
        if shift is not None and _goes_on(motion_px, shift, self._pitch_px):
            shift = None
        self._run = 0 if shift is None else self._run + 1
        if shift is not None and self._run > SHORT and shift_between(self._earlier, look) is None:
            # It is the frame before these that is shifted.
            shift = None
        if shift is not None and self._run > LASTING:
            self.carried_px, shift = np.array([shift.right_px, shift.down_px]), None
        if shift is None:
            self._run, self._earlier, self._read = 0, self._read, look
            return None
        way = shift_words(shift.right_px, shift.down_px)
        if len(shift.rows) == len(frame):
            return Unread(Fault.SHIFTED, way)
        return Unread(Fault.TORN, f"rows {shift.rows[0]} to {shift.rows[-1]} {way}")


def _goes_on(motion_px: np.ndarray, shift: Shift, pitch_px: float) -> bool:
    way = np.array([shift.right_px, shift.down_px])
    # A lattice looks the same a pitch further.
    other = way - pitch_px * np.round((way - np.median(motion_px, axis=0)) / pitch_px)
    way = other if np.linalg.norm(other) > _JUMP * pitch_px else way
    along = motion_px @ way / (way @ way)
    return float(np.quantile(along, 0.9)) > _ON


def shift_words(right_px: float, down_px: float) -> str:
    """A shift in words, such as ``by about 12 px to the right``: the gel may have moved as well."""
    sides = ((right_px, "to the right", "to the left"), (down_px, "down", "up"))
    parts = [f"{abs(way):.0f} px {more if way > 0 else less}" for way, more, less in sides
             if abs(way) >= 0.5]  # fmt: skip
    return "by about " + (" and ".join(parts) or "less than a pixel")


def common_jump(
    step_px: np.ndarray, last_px: np.ndarray, seen: np.ndarray, pitch_px: float
) -> np.ndarray | None:
    """The way that all dots jumped alike [px], shape [2]; None where they did not, or went on.

    Args:
        step_px: Ways of the markers from the last frame to this one, shape [marker, 2].
        last_px: And to the last frame, likewise.
        seen: Markers that are seen in both, bool, shape [marker].
        pitch_px: Distance of neighbours.
    """
    if seen.sum() < 0.5 * len(seen):
        return None
    way, on = np.median(step_px[seen], axis=0), np.median(last_px[seen], axis=0)
    size = float(np.linalg.norm(way))
    off = float(np.median(np.linalg.norm(step_px[seen] - way, axis=1)))
    jumps = size > max(_JUMP * pitch_px, 2.0 * float(np.linalg.norm(on)))
    return way if jumps and off < _ALIKE * size else None


@dataclass(frozen=True)
class Jump:
    """A jump of all dots, which the next frames tell to be one of the gel, or not."""

    start_px: np.ndarray
    """Where the markers were before, shape [marker, 2]."""
    way_px: np.ndarray
    """Shape [2]."""
    pitch_px: float

    def is_undone(self, uv_px: np.ndarray, found_px: np.ndarray) -> bool | None:
        """Whether dots are back where they were; None where they stay where they jumped.

        Args:
            uv_px: Where the markers were in the last frame, shape [marker, 2].
            found_px: Where this frame shows dots, shape [dot, 2].
        """
        size = float(np.linalg.norm(self.way_px))
        if len(found_px) < 0.5 * len(uv_px):
            return False
        dots = KDTree(found_px)
        gaps, _ = dots.query(self.start_px)
        came = np.median(found_px[dots.query(uv_px)[1]] - uv_px, axis=0)
        # A pitch further they look as if they were back.
        turned = np.linalg.norm(came + self.way_px) < _BACK * size or size > _HALF * self.pitch_px
        if turned and float(np.median(gaps)) < _BACK * size:
            return True
        return None if np.linalg.norm(came) < _BACK * size else False


def in_sentences(unread: Mapping[int, Unread]) -> tuple[str, ...]:
    """Which frames are not read, why, and what to do about it; a sentence a fault."""
    said = []
    for fault in Fault:
        frames = [number for number, one in sorted(unread.items()) if one.fault is fault]
        if not frames:
            continue
        detail = unread[frames[0]].detail
        which, first = f"frame {frames[0]} is", ""
        if frames[1:]:
            more = f" and {len(frames) - _NAMED} more" if frames[_NAMED:] else ""
            which, first = f"frames {', '.join(map(str, frames[:_NAMED]))}{more} are", "the first "
        words = f" ({first}{detail})" if detail else ""
        said.append(f"{which} not read, {fault.value}{words}: {fault.advice}")
    return tuple(said)
