# SPDX-License-Identifier: Apache-2.0
"""Tracks of drawn motions: far, fast, hidden, dropped, back at rest; which blob is which."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from taccel_lab.calibration.dots.marker_picture import find_markers
from taccel_lab.calibration.markers.association import associate
from taccel_lab.calibration.markers.judgement import track_remarks
from taccel_lab.calibration.markers.neighbourhood import Neighbourhood
from taccel_lab.calibration.markers.track_figures import track_figures
from taccel_lab.calibration.markers.tracking import track_markers
from taccel_lab.calibration.markers.tracks import MarkerTracks, Status
from taccel_lab.errors import InputError
from taccel_lab.report.remark import Severity
from tests.calibration.drawn.dot_grids import HEIGHT, WIDTH, grid_points, picture

PITCH = 30.0
REST = grid_points(9, 13, (PITCH, PITCH), centre=(160.0, 119.0))


def shear(amount: float, wide_px: float = 120.0) -> np.ndarray:
    """Dots moved by so many pitches in the middle, less around."""
    way = REST - (160.0, 120.0)
    share = np.exp(-(way**2).sum(axis=1) / (2 * wide_px**2))[:, None]
    return REST + amount * PITCH * share * (0.9, 0.43)


def twist(amount: float) -> np.ndarray:
    way = REST - (160.0, 120.0)
    angle = 0.5 * amount * np.exp(-(way**2).sum(axis=1) / (2 * 120.0**2))
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * way[:, 0] - s * way[:, 1], s * way[:, 0] + c * way[:, 1]], 1) + (160, 120)


def whole(amount: float) -> np.ndarray:
    return REST + amount * PITCH * np.array([0.9, 0.43])


def there_and_back(motion, frames: int, amount: float = 1.5) -> np.ndarray:
    return np.array([motion(amount * np.sin(np.pi * t / (frames - 1))) for t in range(frames)])


def follow(true: np.ndarray, *, drop: float = 0.0, noise: float = 2.0, cover=None) -> MarkerTracks:
    rng = np.random.default_rng(1)
    frames = []
    for t, centres in enumerate(true):
        there = centres[rng.random(len(centres)) >= (drop if t else 0.0)]
        light = np.broadcast_to(150 + 25 * np.sin(np.arange(400) / 60 + 0.1 * t), (320, 400))
        image = picture(there, 5.0, noise=noise, seed=t, background=light, dot=30.0)
        if cover is not None and 0 < t < len(true) - 1:
            image[cover] = 120
        frames.append(image)
    return track_markers(frames, find_markers(frames[0]))


def errors(tracks: MarkerTracks, true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance of each marker from its own dot, and whether the dot is well inside, [f, m]."""
    own = np.argmin(np.linalg.norm(true[0][None] - tracks.rest_px[:, None], axis=2), axis=1)
    x = true[:, own]
    inside = np.asarray(((x > 8) & (x < (WIDTH - 9, HEIGHT - 9))).all(axis=2))
    return np.linalg.norm(tracks.uv_px - x, axis=2), inside


@pytest.mark.parametrize(
    ("motion", "frames"),
    [
        (shear, 12),
        pytest.param(shear, 8, id="0.65 pitches between frames"),
        (twist, 12),
        pytest.param(whole, 12, marks=pytest.mark.slow),
    ],
)
def test_dots_keep_their_identity_over_one_and_a_half_pitches(motion, frames: int) -> None:
    true = there_and_back(motion, frames)
    tracks = follow(true)
    error, inside = errors(tracks, true)
    assert np.linalg.norm(true - true[0], axis=2).max() > 1.4 * PITCH
    assert tracks.seen[inside].all()
    assert error[inside].max() < 0.1
    # Back at rest every dot is its own again, those that had left the picture too.
    assert tracks.seen[-1].mean() > 0.97
    assert error[-1][tracks.seen[-1]].max() < 0.05 * PITCH


def test_hidden_and_dropped_dots_are_predicted_and_found_again() -> None:
    true = there_and_back(shear, 16)
    tracks = follow(true, drop=0.15, cover=(slice(70, 115), slice(120, 190)))
    error, inside = errors(tracks, true)
    assert not tracks.seen[:, :][inside].all()
    assert (tracks.status[inside & ~tracks.seen] == Status.PREDICTED).mean() > 0.95
    # Nobody took a neighbour for himself.
    assert error[inside].max() < 0.25 * PITCH
    assert np.percentile(error[inside & tracks.seen], 95) < 0.15
    hidden = inside & ~tracks.seen
    z = error[hidden] / np.linalg.norm(tracks.sigma_px, axis=2)[hidden]
    assert np.sqrt((z**2).mean()) < 2.0
    assert tracks.seen[-1].mean() > 0.75


def test_seen_dots_lie_within_their_sigma_during_motion() -> None:
    true = there_and_back(shear, 8, 1.0)
    tracks = follow(true, noise=4.0)
    own = np.argmin(np.linalg.norm(true[0][None] - tracks.rest_px[:, None], axis=2), axis=1)
    _, inside = errors(tracks, true)
    z = ((tracks.uv_px - true[:, own]) / tracks.sigma_px)[inside & tracks.seen]
    assert np.sqrt((z**2).mean()) == pytest.approx(1.0, abs=0.15)


def test_figures_of_a_video_say_what_happened() -> None:
    rest = np.repeat(REST[None], 8, axis=0)
    true = np.concatenate([rest, there_and_back(shear, 9, 0.8)])
    tracks = follow(true, noise=1.0)
    figures = track_figures("drawn", tracks)
    assert 7 <= figures.quiet_frames <= 9
    assert figures.jitter_px is not None
    assert figures.jitter_px == pytest.approx(np.median(tracks.sigma_px[:8]), rel=0.3)
    assert figures.largest_px == pytest.approx(0.8 * PITCH, rel=0.03)
    assert figures.return_frame == len(true) - 1
    assert figures.return_median_px is not None
    assert figures.return_median_px < 0.05
    first = {name: getattr(tracks, name)[:8] for name in ("uv_px", "sigma_px", "status")}
    still = track_figures("still", replace(tracks, **first))
    assert still.return_frame is None
    assert still.quiet_frames == 8


def test_what_tracks_cannot_tell_is_said() -> None:
    true = np.repeat(REST[None], 6, axis=0)
    true[3:] += (0.48 * PITCH, 0.0)
    codes = {r.code: r.severity for r in track_remarks(track_figures("jump", follow(true)))}
    assert codes["fast_motion"] is Severity.ERROR
    slow = there_and_back(shear, 12, 0.8)
    slow[5] -= 5000.0
    dark = track_figures("dark", follow(slow))
    assert dark.unseen_frames == (5,)
    assert [remark.code for remark in track_remarks(dark)] == ["markers_lost"]


def test_unseen_markers_do_not_slow_the_common_motion() -> None:
    """A jump of all dots, most of which are covered while it lasts: the seen ones tell it."""
    true = np.repeat(REST[None], 6, axis=0)
    true[3:] += (0.48 * PITCH, 0.0)
    tracks = follow(true[:1])
    whole = np.repeat(tracks.rest_px[None], 6, axis=0)
    whole[3:] += (0.48 * PITCH, 0.0)
    status = np.full(whole.shape[:2], Status.SEEN, dtype=np.uint8)
    status[3:, ::5] = status[3:, 1::5] = status[3:, 2::5] = Status.PREDICTED
    sigma = np.full_like(whole, 0.01)
    jumped = replace(tracks, uv_px=whole, sigma_px=sigma, status=status)
    figures = track_figures("covered", jumped)
    assert figures.common_step_in_pitches == pytest.approx(0.48, rel=0.02)
    codes = {r.code: r.severity for r in track_remarks(figures)}
    assert codes["fast_motion"] is Severity.ERROR


def test_a_marker_that_leaves_for_long_is_lost() -> None:
    away = REST + (0.0, 22.0)
    steps = [REST + (0.0, 22.0 * t / 4) for t in range(5)]
    true = np.array([*steps, *[away] * 13])
    tracks = follow(true)
    gone = true[-1][np.argmin(np.linalg.norm(REST[None] - tracks.rest_px[:, None], axis=2), axis=1)]
    below = gone[:, 1] > HEIGHT + 5
    assert below.any()
    assert (tracks.status[-1, below] == Status.LOST).all()


def test_neighbours_extrapolate_affine_fields_exactly_and_ignore_one_liar() -> None:
    around = Neighbourhood.of(REST)
    field = REST @ np.array([[0.05, 0.02], [-0.03, 0.04]]) + (3.0, -1.0)
    lying = field.copy()
    lying[60] += 20.0
    known = np.ones(len(REST), dtype=bool)
    said, _, _ = around.extrapolate(field, known)
    middle = ((REST > 60) & (REST < (WIDTH - 60, HEIGHT - 60))).all(axis=1)
    np.testing.assert_allclose(said[middle], field[middle], atol=0.02)
    said, _, _ = around.extrapolate(lying, known)
    assert np.abs(said - field)[middle].max() < 1.0


def test_bad_videos_are_refused() -> None:
    image = picture(REST, 5.0)
    rest = find_markers(image)
    with pytest.raises(InputError, match="no frame"):
        track_markers([], rest)
    with pytest.raises(InputError, match="frame 1 is 100x80 px"):
        track_markers([image, image[:80, :100]], rest)


SQUARE = np.stack(np.meshgrid(np.arange(9.0), np.arange(9.0)), axis=-1).reshape(-1, 2)
"""A square grid of pitch 1."""
MIDDLE = 40


def assigned(offset: float, scatter: float, pitch_px: float) -> np.ndarray:
    """Blobs of markers that moved by 1.3 pitches and, in turns, a little more or less than their
    neighbours (``scatter`` [pitches], along an axis); the middle one by ``offset`` pitches more."""
    turns = 1 - 2 * (SQUARE % 2)
    moved = np.array([1.3, 0.4]) + scatter * turns
    moved[MIDDLE] = (1.3 + offset, 0.4)
    found = pitch_px * (SQUARE + moved)
    expected = pitch_px * (SQUARE + (1.3, 0.4))
    odd = np.zeros(len(found), dtype=bool)
    return associate(expected, pitch_px * SQUARE, found, odd, Neighbourhood.of(pitch_px * SQUARE))


def test_the_gate_widens_where_neighbours_scatter() -> None:
    # Where neighbours move alike, a blob 0.42 pitches off what they say is no dot of this marker;
    # where they scatter by half as much themselves, it is.
    assert assigned(0.42, 0.01, 30.0)[MIDDLE] == -1
    assert assigned(0.42, 0.18, 30.0)[MIDDLE] == MIDDLE
    # However much they scatter, a blob beyond 0.55 pitches is nearer to another marker.
    assert assigned(0.6, 0.18, 30.0)[MIDDLE] == -1


@pytest.mark.parametrize("scatter", [0.01, 0.1, 0.18])
def test_the_unit_of_length_has_no_effect(scatter: float) -> None:
    for offset in (0.3, 0.42, 0.5):
        fine, coarse = assigned(offset, scatter, 30.0), assigned(offset, scatter, 0.5)
        assert (fine == coarse).all()
