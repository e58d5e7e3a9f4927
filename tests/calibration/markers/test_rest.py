# SPDX-License-Identifier: Apache-2.0
"""Rest is found in a video, wherever it lies, and refused where there is none."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest

from taccel_lab.calibration.capture.captures import Frame
from taccel_lab.calibration.capture.folder import MarkerCaptures, Video
from taccel_lab.calibration.capture.schema import VideoEntry
from taccel_lab.calibration.markers.rest import find_rest, frames_before
from taccel_lab.calibration.markers.still_frames import still_stretches
from taccel_lab.errors import InputError
from taccel_lab.files.images import read_image
from taccel_lab.reading.dots.lattice import PITCH_X, PITCH_Y
from taccel_lab.reading.dots.marker_picture import find_markers
from tests.calibration.drawn.dots import grid_points, picture
from tests.support.real_data import real_data
from tests.support.variants import variants

REST = grid_points(pitch=(30.0, 29.0), turn_rad=0.02)


def pressed(depth: float) -> np.ndarray:
    """Dots pushed away from a contact, by up to ``depth`` px."""
    way = REST - (150.0, 115.0)
    reach = np.linalg.norm(way, axis=1, keepdims=True)
    return REST + depth * way / 45.0 * np.exp(0.5 - 0.5 * (reach / 45.0) ** 2)


def press(start: float, end: float, count: int) -> list[np.ndarray]:
    """Moving, so that neither end is shown."""
    return [pressed(depth) for depth in np.linspace(start, end, count + 2)[1:-1]]


def drawn(points: Sequence[np.ndarray]) -> list[np.ndarray]:
    return [picture(p, noise=1.5, seed=n) for n, p in enumerate(points)]


def captures(
    frames: Sequence[np.ndarray], rest: np.ndarray | None = None, fps: float | None = None
) -> MarkerCaptures:
    entry = VideoEntry(frames=["frames/*.png"], fps=fps)
    video = Video(entry, "frames/0.png", "0" * 64, len(frames), lambda: iter(frames))
    still = None if rest is None else Frame("rest", "rest.png", "1" * 64, lambda: rest)
    return MarkerCaptures(still, None, None, (video,))


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("points", "first", "last"),
    [
        ([*[REST] * 12, *press(0, 8, 8), *[pressed(8)] * 4], 0, 11),
        # Held pressed for longer than it rests.
        ([*[pressed(8)] * 20, *press(8, 0, 8), *[REST] * 8], 28, 35),
    ],
    ids=["first", "after a long press"],
)
def test_rest_is_found_where_it_is(points: list[np.ndarray], first: int, last: int) -> None:
    found = find_rest(captures(drawn(points)))
    assert found.remarks == ()
    assert first <= found.starts[0] <= last
    layout = find_markers(found.frame.image()).layout_px
    np.testing.assert_allclose(layout.pitch, (30.0, 29.0), atol=0.02)


@pytest.mark.thorough(cases=("held", "moving", "slowly"))
@pytest.mark.parametrize(
    ("points", "reason"),
    [
        (press(8, 2, 30), "at most 2 of 30 frames in a row"),
        ([pressed(0.06 * n) for n in range(60)], "does not drift"),
        ([*[pressed(8)] * 20, *press(8, 0.5, 12)], "held pressed"),
        ([*press(8, 0, 8), *[REST] * 4], "at most 4 of 12 frames in a row, from frame 8"),
    ],
    ids=["moving", "slowly", "held", "too short"],
)
def test_no_rest_is_refused(points: list[np.ndarray], reason: str) -> None:
    with pytest.raises(InputError, match=reason) as fault:
        find_rest(captures(drawn(points)))
    assert str(fault.value).startswith("no frame at rest")
    assert "markers.rest" in str(fault.value)


@pytest.mark.thorough
def test_a_turning_point_is_no_rest_at_a_known_frame_rate() -> None:
    """Six frames of a fast camera last no fifth of a second."""
    frames = drawn([*press(8, 0, 8), *[REST] * 6, *press(0, 8, 8)])
    assert find_rest(captures(frames)).starts == (10,)
    with pytest.raises(InputError, match="a rest has 24"):
        find_rest(captures(frames, fps=120.0))


@pytest.mark.thorough
def test_two_layouts_that_stand_still_are_told() -> None:
    """Dragged as a whole, dots lie as evenly as at rest."""
    shares = [0.0] * 14 + [*np.linspace(0, 1, 9)[1:-1]] + [1.0] * 10
    frames = drawn([REST + np.array([6.0, 2.0]) * share for share in shares])
    (remark,) = find_rest(captures(frames)).remarks
    assert remark.code == "rest_ambiguous" and "6.3" in remark.message


@pytest.mark.thorough
def test_a_stated_picture_is_taken_and_a_contradiction_told() -> None:
    frames = drawn([*press(8, 0, 8), *[REST] * 12])
    good, bad = (picture(p, noise=1.5, seed=99) for p in (REST, REST + (4.0, 0.0)))
    found = find_rest(captures(frames, good))
    assert (found.frame.name, found.remarks) == ("rest", ())
    assert 8 <= found.starts[0] < 20
    (remark,) = find_rest(captures(frames, bad)).remarks
    assert remark.code == "rest_disagrees" and "4.0" in remark.message


def test_light_that_flickers_is_no_motion() -> None:
    still = picture(REST, levels=False)
    frames = [still * (1.0 + 0.2 * np.sin(n)) for n in range(20)]
    assert still_stretches(frames, 29.0).stretches == (range(20),)


@pytest.mark.parametrize("at_once", [1, 3, 100])
def test_frames_are_read_backwards_in_parts(at_once: int) -> None:
    (video,) = captures([np.full((2, 2), n) for n in range(11)]).videos
    back = [int(frame[0, 0]) for frame in frames_before(video, 7, at_once)]
    assert back == [7, 6, 5, 4, 3, 2, 1, 0]


@cache
def real_frames() -> list[np.ndarray]:
    return [read_image(real_data(f"gsmini_markers_video/{n:04d}.png")) for n in range(121)]


PITCH_AT_REST = (30.94, 31.87)
"""Of the frames 0 to 55, which the set's description calls rest: their mean [px]."""


def parts(frames: list[np.ndarray], name: str) -> list[np.ndarray]:
    return {
        "rests briefly": frames[45:80],
        "all": frames,
        "first half": frames[:60],
        "reversed": frames[::-1],
        "every other": frames[::2],
        "begins pressed": [*frames[70:], *frames[:57]],
    }[name]


@pytest.mark.thorough
@pytest.mark.parametrize(
    "name",
    variants(
        ["rests briefly"],
        ["rests briefly", "all", "first half", "reversed", "every other", "begins pressed"],
    ),
)
def test_pitch_of_a_real_video_is_within_its_interval(name: str) -> None:
    rest = find_rest(captures(parts(real_frames(), name)))
    layout = find_markers(rest.frame.image()).layout_px
    for found, axis, true in zip(layout.pitch, (PITCH_X, PITCH_Y), PITCH_AT_REST, strict=True):
        assert abs(found - true) < 1.96 * layout.sigma(axis)
        # Nor is the interval so wide that pressed dots would lie in it.
        assert 1.96 * layout.sigma(axis) < 0.4


@pytest.mark.thorough(cases=("part0",))
@pytest.mark.parametrize("part", [slice(60, 121), slice(100, 121), slice(57, 88)])
def test_a_real_video_that_never_rests_is_refused(part: slice) -> None:
    with pytest.raises(InputError, match="no frame at rest"):
        find_rest(captures(real_frames()[part]))
