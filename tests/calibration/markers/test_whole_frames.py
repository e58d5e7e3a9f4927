# SPDX-License-Identifier: Apache-2.0
"""Frames that a camera's link spoilt: not read, and no other frame the worse for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.frame_shift import Look, shift_between
from taccel_lab.calibration.markers.tracking import MarkerTracker, track_markers
from taccel_lab.calibration.markers.tracks import MarkerTracks, TrackStatus, track_figures
from taccel_lab.files.atomic_file import write_image
from taccel_lab.reading.dots.marker_picture import find_markers
from tests.calibration.drawn.dots import MARGIN, grid_points, picture
from tests.support.commands import done

PITCH = 48.0
REST = grid_points(5, 6, (PITCH, PITCH), centre=(160.0, 119.0))
MIDDLE = np.exp(-((REST - (160.0, 120.0)) ** 2).sum(axis=1) / (2 * 90.0**2))
COUNT = 9
V, U = np.mgrid[-MARGIN : 240 + MARGIN, -MARGIN : 320 + MARGIN]
LIGHT = 150 - 60 * ((U - 150) / 240) ** 2 + 45 * np.sin(V / 70)
"""Lamps stand still when the gel moves."""
Spoil = Callable[[np.ndarray], np.ndarray]


def sheared(number: int) -> np.ndarray:
    """Dots of a frame: sheared by up to 0.4 pitches and released."""
    way = 0.4 * PITCH * np.sin(np.pi * number / (COUNT - 1))
    return REST + way * MIDDLE[:, None] * (0.9, 0.43)


@cache
def seen(number: int, even: bool = False) -> np.ndarray:
    light = 150.0 if even else LIGHT
    return picture(sheared(number), 8.0, noise=1.5, seed=number, background=light)


def frames(bad: Sequence[int] = (), spoil: Spoil = np.copy, even: bool = False) -> list[np.ndarray]:
    shown = [seen(number, even) for number in range(COUNT)]
    return [spoil(image) if number in bad else image for number, image in enumerate(shown)]


@cache
def clean(even: bool = False) -> MarkerTracks:
    return track_markers(frames(even=even), find_markers(seen(0, even)))


def rolled(right: int, down: int = 0, from_row: int = 0) -> Spoil:
    def spoil(image: np.ndarray) -> np.ndarray:
        image = image.copy()
        image[from_row:] = np.roll(image[from_row:], (down, right), (0, 1))
        return image

    return spoil


def one_colour(from_row: int, level: int) -> Spoil:
    def spoil(image: np.ndarray) -> np.ndarray:
        image = image.copy()
        image[from_row:] = level
        return image

    return spoil


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("spoil", "bad", "words"),
    [
        pytest.param(rolled(19), (3, 6, 7), "the first by about 2", id="rolled1"),
        pytest.param(rolled(-12), (4, 5), "px to the left", id="rolled2"),
        pytest.param(rolled(70), (0, 8), "70 px to the right", id="rolled3"),
        pytest.param(rolled(0, -30), (4,), "30 px up", id="rolled4"),
        pytest.param(rolled(90, 60), (1, 2, 3, 4), "px down", id="rolled5"),
        pytest.param(rolled(22, 0, 120), (4,), "rows 120 to 239 by about 2", id="torn"),
        pytest.param(one_colour(150, 128), (3, 5), "rows 150 to 239", id="grey"),
        pytest.param(one_colour(0, 0), (3, 5), "rows 0 to 239", id="black"),
    ],
)
def test_spoilt_frames_are_named_and_leave_the_others_as_they_are(
    spoil: Spoil, bad: tuple[int, ...], words: str
) -> None:
    tracks = track_markers(frames(bad, spoil), find_markers(seen(0)))
    assert tuple(sorted(tracks.unread)) == bad
    good = np.setdiff1d(np.arange(COUNT), bad)
    assert not tracks.seen[list(bad)].any()
    np.testing.assert_array_equal(tracks.seen[good], clean().seen[good])
    assert np.abs(tracks.uv_px - clean().uv_px)[good].max() < 0.05
    # Where a dot was in a frame that is not read is as uncertain as it says.
    miss = np.linalg.norm(tracks.uv_px - clean().uv_px, axis=2)[list(bad)]
    assert (miss < 3 * np.linalg.norm(tracks.sigma_px, axis=2)[list(bad)] + 0.1).all()
    figures = track_figures("drawn", tracks)
    (remark,) = (one for one in figures.remarks() if one.code == "unread_frames")
    assert words in remark.message and "try another cable" in remark.message
    assert figures.step_in_pitches < 0.4


@pytest.mark.thorough
@pytest.mark.parametrize("shift", [(19, 0), (24, 0), (0, 20)])
def test_dots_that_jump_back_tell_it_where_the_light_is_even(shift: tuple[int, int]) -> None:
    """Half a pitch, too: the lattice of the frames after must not be left displaced."""
    tracks = track_markers(frames((3,), rolled(*shift), even=True), find_markers(seen(0, True)))
    assert tuple(tracks.unread) == (3,)
    good = np.delete(np.arange(COUNT), 3)
    assert np.abs(tracks.uv_px - clean(True).uv_px)[good].max() < 0.05


@pytest.mark.thorough
@pytest.mark.parametrize("even", [True, False])
def test_fast_motions_of_a_whole_gel_are_read(even: bool) -> None:
    """The dots alone move alike, by 0.2 pitches a frame, and back: the light stays."""
    ways = 9.0 * np.array([0, 1, 2, 3, 2, 1, 0])
    light = 150.0 if even else LIGHT
    video = [
        picture(REST + (way, 0.0), 8.0, noise=1.5, seed=k, background=light)
        for k, way in enumerate(ways)
    ]
    tracks = track_markers(video, find_markers(video[0]))
    assert not tracks.unread
    inner = np.abs(REST[:, 0] - 160).argsort()[:5]
    columns = np.argmin(np.linalg.norm(tracks.rest_px[:, None] - REST[inner], axis=2), axis=0)
    assert np.abs(tracks.displacement_px[:, columns, 0] - ways[:, None]).max() < 0.5


@pytest.mark.thorough
def test_frames_sent_twice_are_named_where_a_camera_made_them() -> None:
    video = frames()
    video[4] = video[3]
    tracks = track_markers(video, find_markers(seen(0)))
    assert tuple(tracks.unread) == (4,)
    assert (
        "frame 4 is not read, the frame before sent once more"
        in track_figures("x", tracks).unread[0]
    )
    # An encoder repeats what stands still.
    still = track_markers([seen(0)] * 5, find_markers(seen(0)))
    assert not still.unread and still.seen.all()


@pytest.mark.thorough
def test_a_live_tracker_reads_on_after_a_shifted_frame() -> None:
    tracker = MarkerTracker(find_markers(seen(0)))
    for number, image in enumerate(frames((2,), rolled(19))[:4]):
        tracker.advance(image)
        assert (tracker.status == TrackStatus.SEEN).any() == (number != 2)
    assert np.abs(tracker.uv - clean().uv_px[3]).max() < 0.05


def test_lamps_and_presses_are_no_shift() -> None:
    looks = [Look.at(image, 8.0) for image in frames()]
    assert all(shift_between(looks[0], look) is None for look in looks[1:])
    for gain, slope in ((0.85, 0), (1.15, 0), (1.0, 8)):
        lit = np.clip(seen(3) * gain + slope * np.linspace(-1, 1, 320), 0, 255)
        assert shift_between(looks[2], Look.at(lit, 8.0)) is None


@pytest.mark.thorough
def test_the_command_says_which_frames_are_not_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number, image in enumerate([seen(0)] * 6 + frames((3,), rolled(19))):
        write_image(tmp_path / f"f{number:02d}.png", np.repeat(image[..., None], 3, axis=2))
    (tmp_path / "captures.toml").write_text(
        'schema_version = 2\nsensor = "gelsight_mini"\n[markers]\nrest = "f00.png"\n'
        'pitch_x_mm = 2.0\n[[markers.videos]]\nframes = ["f*.png"]\n'
    )
    out = tmp_path.with_name("profile")
    ended = done(capsys, "calibrate", "markers", tmp_path, "--out", out)
    assert ended.code == 0
    assert "frame 9 is not read, sent shifted as a whole" in " ".join(ended.err.split())
    page = (tmp_path.with_name("profile_report") / "report.html").read_text(encoding="utf-8")
    assert "frames that are not read" in page
