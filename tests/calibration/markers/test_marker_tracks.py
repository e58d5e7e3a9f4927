# SPDX-License-Identifier: Apache-2.0
"""Markers followed through videos: tracks and flow."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from taccel_lab.calibration.capture import CaptureFolder
from taccel_lab.calibration.dots.lattice import fit_layout, lattice_index
from taccel_lab.calibration.dots.lattice_growth import Neighbourhood
from taccel_lab.calibration.dots.marker_picture import find_markers
from taccel_lab.calibration.markers.fit import layout_on_gel
from taccel_lab.calibration.markers.gel_view import (
    PixelView,
    camera_view,
    choose_view,
    face_seen,
    pixel_jacobian,
)
from taccel_lab.calibration.markers.tracking import associate, track_markers
from taccel_lab.calibration.markers.tracks import (
    MarkerTracks,
    TrackStatus,
    marker_flow_mm,
    track_figures,
)
from taccel_lab.camera.gel_camera import CameraModel
from taccel_lab.camera.refraction import media_between
from taccel_lab.errors import InputError
from taccel_lab.files.images import read_image
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import Provenance
from taccel_lab.profile.optical_design import (
    Coating,
    DesignedCamera,
    Light,
    MarkerGrid,
    OpticalDesign,
    Window,
)
from taccel_lab.report.remark import Severity
from taccel_lab.sensors.profile import catalogue_profile
from tests.calibration.drawn.dot_grids import HEIGHT, WIDTH, grid_points, picture
from tests.support.formula_model import formula_model
from tests.support.real_data import real_data

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


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("motion", "frames"),
    [
        pytest.param(shear, 8, id="0.65 pitches between frames"),
        pytest.param(twist, 12, marks=pytest.mark.slow),
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


@pytest.mark.thorough
def test_of_a_real_motion_every_twelfth_frame_is_enough() -> None:
    """Up to 0.6 pitches between frames, with contact: matched by distance alone 46 dots are lost
    or taken for their neighbours."""
    frames = [read_image(real_data(f"gsmini_markers_video/{n:04d}.png")) for n in range(0, 121, 6)]
    rest = find_markers(frames[0])
    often, seldom = track_markers(frames, rest), track_markers(frames[::2], rest)
    both = often.seen[::2] & seldom.seen
    assert both.mean() > 0.9
    assert np.linalg.norm(often.uv_px[::2] - seldom.uv_px, axis=2)[both].max() < 0.1


@pytest.mark.thorough
def test_hidden_and_dropped_dots_are_predicted_and_found_again() -> None:
    true = there_and_back(shear, 16)
    tracks = follow(true, drop=0.15, cover=(slice(70, 115), slice(120, 190)))
    error, inside = errors(tracks, true)
    assert not tracks.seen[:, :][inside].all()
    assert (tracks.status[inside & ~tracks.seen] == TrackStatus.PREDICTED).mean() > 0.95
    # Nobody took a neighbour for himself.
    assert error[inside].max() < 0.25 * PITCH
    assert np.percentile(error[inside & tracks.seen], 95) < 0.15
    hidden = inside & ~tracks.seen
    z = error[hidden] / np.linalg.norm(tracks.sigma_px, axis=2)[hidden]
    assert np.sqrt((z**2).mean()) < 2.0
    assert tracks.seen[-1].mean() > 0.75


@pytest.mark.thorough
def test_seen_dots_lie_within_their_sigma_during_motion() -> None:
    true = there_and_back(shear, 8, 1.0)
    tracks = follow(true, noise=4.0)
    own = np.argmin(np.linalg.norm(true[0][None] - tracks.rest_px[:, None], axis=2), axis=1)
    _, inside = errors(tracks, true)
    z = ((tracks.uv_px - true[:, own]) / tracks.sigma_px)[inside & tracks.seen]
    assert np.sqrt((z**2).mean()) == pytest.approx(1.0, abs=0.15)


@pytest.mark.thorough
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


@pytest.mark.thorough
def test_what_tracks_cannot_tell_is_said() -> None:
    true = np.repeat(REST[None], 6, axis=0)
    true[3:] += (0.48 * PITCH, 0.0)
    codes = {r.code: r.severity for r in track_figures("jump", follow(true)).remarks()}
    assert codes["fast_motion"] is Severity.ERROR
    slow = there_and_back(shear, 8, 0.6)
    slow[5] -= 5000.0
    dark = track_figures("dark", follow(slow))
    assert dark.unseen_frames == (5,)
    assert [remark.code for remark in dark.remarks()] == ["markers_lost"]


@pytest.mark.thorough
def test_unseen_markers_do_not_slow_the_common_motion() -> None:
    """A jump of all dots, most of which are covered while it lasts: the seen ones tell it."""
    true = np.repeat(REST[None], 6, axis=0)
    true[3:] += (0.48 * PITCH, 0.0)
    tracks = follow(true[:1])
    whole = np.repeat(tracks.rest_px[None], 6, axis=0)
    whole[3:] += (0.48 * PITCH, 0.0)
    status = np.full(whole.shape[:2], TrackStatus.SEEN, dtype=np.uint8)
    status[3:, ::5] = status[3:, 1::5] = status[3:, 2::5] = TrackStatus.PREDICTED
    sigma = np.full_like(whole, 0.01)
    jumped = replace(tracks, uv_px=whole, sigma_px=sigma, status=status)
    figures = track_figures("covered", jumped)
    assert figures.common_step_in_pitches == pytest.approx(0.48, rel=0.02)
    codes = {r.code: r.severity for r in figures.remarks()}
    assert codes["fast_motion"] is Severity.ERROR


@pytest.mark.thorough
def test_a_marker_that_leaves_for_long_is_lost() -> None:
    away = REST + (0.0, 22.0)
    steps = [REST + (0.0, 22.0 * t / 4) for t in range(5)]
    true = np.array([*steps, *[away] * 13])
    tracks = follow(true)
    gone = true[-1][np.argmin(np.linalg.norm(REST[None] - tracks.rest_px[:, None], axis=2), axis=1)]
    below = gone[:, 1] > HEIGHT + 5
    assert below.any()
    assert (tracks.status[-1, below] == TrackStatus.LOST).all()


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


GRID = PixelGrid(320, 240, 0.06, 0.05)
GRID_VIEW = PixelView(GRID.gel_from_pixel, "a test")


def tracks_of(uv: np.ndarray, sigma: float = 0.02) -> MarkerTracks:
    frames, count = uv.shape[:2]
    return MarkerTracks(
        uv_px=uv,
        sigma_px=np.full(uv.shape, sigma),
        status=np.full((frames, count), 2, dtype=np.uint8),
        rest_px=uv[0],
        rest_sigma_px=np.full((count, 2), sigma),
        row=np.arange(count),
        column=np.zeros(count, dtype=int),
        size_px=(320, 240),
    )


def test_flow_through_a_grid_is_pixels_times_scale() -> None:
    rest = np.array([[100.0, 80.0], [200.0, 150.0], [40.0, 60.0]])
    uv = np.stack([rest, rest + (10.0, -4.0)])
    flow = marker_flow_mm(tracks_of(uv), GRID_VIEW, fps=25.0)
    np.testing.assert_allclose(flow.displacement_mm[1], [[0.6, -0.2]] * 3, atol=1e-12)
    np.testing.assert_allclose(flow.points_mm, GRID.gel_from_pixel(rest))
    np.testing.assert_allclose(flow.sigma_mm[1, 0], np.sqrt(2) * 0.02 * np.array([0.06, 0.05]))
    assert flow.time_s is not None
    np.testing.assert_allclose(flow.time_s, [0.0, 0.04])


def design(camera: DesignedCamera) -> OpticalDesign:
    light = Light((3.0, -2.0, -25.0), (0.0, 0.0, 1.0), (1.0, 1.0, 1.0))
    return OpticalDesign(
        camera, (light,), Coating((0.6, 0.6, 0.6)), Window(2.0, (40.0, 40.0), 1.49)
    )


def looking_at(
    position_mm: tuple[float, float, float], target_mm: tuple[float, float, float]
) -> tuple[float, float, float, float]:
    """gel_from_camera of a camera whose columns run along the gel's x as nearly as can be."""
    z = np.subtract(target_mm, position_mm)
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z / (z @ z)
    axes = np.stack([x, np.cross(z, x), z])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    q = Rotation.from_matrix(axes.T).as_quat(canonical=True)
    return float(q[0]), float(q[1]), float(q[2]), float(q[3])


@pytest.mark.thorough(cases=("-5.0-0.5-missing2", "0.0-0.0-missing0"))
@pytest.mark.parametrize(
    ("turn_deg", "stagger", "missing"),
    [(0.0, 0.0, ()), (7.0, 0.0, ((1, 2), (4, 5))), (-5.0, 0.5, ((2, 3),))],
)
def test_a_rendered_grid_comes_back_through_the_camera(
    turn_deg: float, stagger: float, missing: tuple[tuple[int, int], ...]
) -> None:
    """Our own renderer: perspective from aside, lens distortion, refraction by window and gel."""
    position = (1.5, -1.0, -24.0)
    camera = DesignedCamera(
        320, 240, 400.0, 404.0, 161.0, 118.0, position, looking_at(position, (0.0, 0.2, 0.0)),
        distortion=(-0.12, 0.03, 0.001, -0.001),
    )  # fmt: skip
    truth = MarkerGrid(
        6, 7, 2.0, 2.0 * (np.sqrt(0.75) if stagger else 0.95), 0.35, (0.3, -0.2),
        turn_deg, stagger, missing,
    )  # fmt: skip
    optics = design(camera)
    model = formula_model(
        optics, lambda xy: np.zeros(xy.shape[:-1]), half_size_mm=(14.0, 14.0), back_z_mm=-4.0,
        step_mm=0.5, markers=truth,
    )  # fmt: skip
    image = np.nan_to_num(model.render().linear)
    picture = find_markers(255.0 * image / image.max())
    back = np.array([[x, y, -4.0] for x in (-14, 14) for y in (-14, 14)], dtype=float)
    seen = face_seen(CameraModel(camera), media_between(optics, back), lambda xy: np.zeros(len(xy)))
    view = PixelView(seen, "a test")
    layout = layout_on_gel(picture, view)
    assert (layout.rows, layout.columns) == (truth.rows, truth.columns)
    np.testing.assert_allclose(layout.pitch, (truth.pitch_x_mm, truth.pitch_y_mm), rtol=1e-3)
    np.testing.assert_allclose(layout.centre, truth.offset_mm, atol=0.01)
    assert layout.rotation_deg == pytest.approx(turn_deg, abs=0.05)
    assert set(layout.missing) == set(missing)
    assert layout.residual_rms < 0.005
    # The same dots by a plain scale are bent by lens, tilt and refraction.
    plain = layout_on_gel(
        picture, PixelView(PixelGrid(320, 240, 0.055, 0.055).gel_from_pixel, "a test")
    )
    assert plain.residual_rms > 5 * layout.residual_rms
    assert picture.layout_px is not None


def test_a_camera_view_undoes_projection_on_a_dome() -> None:
    camera = DesignedCamera(320, 240, 400.0, 400.0, 159.5, 119.5, (0.0, 0.0, -24.0))
    back = np.array([[x, y, -4.0] for x in (-14, 14) for y in (-14, 14)], dtype=float)
    media = media_between(design(camera), back)

    def dome(xy: np.ndarray) -> np.ndarray:
        return np.sqrt(40.0**2 - (xy**2).sum(axis=1)) - 40.0

    model = CameraModel(camera)
    view = PixelView(face_seen(model, media, dome), "a test")
    xy = np.random.default_rng(2).uniform(-4, 4, (30, 2))
    points = np.column_stack([xy, dome(xy)])
    sight = media.sight(np.array(camera.position_mm), points)
    uv = model.pixels_from_directions(sight @ model.gel_from_camera)
    np.testing.assert_allclose(view.gel_from_pixel(uv), xy, atol=1e-6)
    jacobian = pixel_jacobian(view, uv)
    assert (np.linalg.det(jacobian) > 0).all()


def calibrated(kind: str, spread: dict[str, float]) -> Provenance:
    evidence = {"x": (0.0, 1.0)}
    return Provenance(
        kind=kind,  # type: ignore[arg-type]
        method="a test",
        source="none",
        inputs={"a": "0" * 64},
        residuals={"r": 0.0},
        valid_region=evidence,
        spread=spread,
    )


@pytest.mark.parametrize("bent", [True, False])
def test_a_calibrated_pose_is_looked_through_as_it_was_fitted(bent: bool) -> None:
    """Whether its sight lines are bent shows in the pixel grid that was calibrated with it."""
    profile = catalogue_profile("gelsight_mini")
    assert profile.optics is not None
    grid = profile.camera
    size = (grid.width_px, grid.height_px)
    view = camera_view(profile, size, refraction=bent)
    middle = np.array([(size[0] - 1) / 2, (size[1] - 1) / 2])
    scale = np.diag(pixel_jacobian(view, middle))
    other = np.diag(pixel_jacobian(camera_view(profile, size, refraction=not bent), middle))
    assert np.abs(scale / other - 1).min() > 0.1
    posed = profile.optics.replace(
        provenance=calibrated("calibrated", {"position_z_mm": 0.1, "fx_px": 1.0})
    )
    scaled = grid.replace(
        mm_per_px_x=float(scale[0]),
        mm_per_px_y=float(scale[1]),
        provenance=calibrated("calibrated", {"mm_per_px_x": 1e-4}),
    )
    lattice = lattice_index(grid_points())
    layout = fit_layout(grid_points(), lattice)
    folder = CaptureFolder("a test", Path(), "gelsight_mini", None, None, (), None, None, None, ())
    chosen = choose_view(folder, profile.with_block(posed).with_block(scaled), layout, size)[0]
    assert "camera" in chosen.description
    np.testing.assert_allclose(np.diag(pixel_jacobian(chosen, middle)), scale, rtol=1e-9)
    # A lens without a pose says nothing of millimetres; the calibrated grid does.
    lens = profile.optics.replace(provenance=calibrated("calibrated", {"fx_px": 1.0}))
    chosen = choose_view(folder, profile.with_block(lens).with_block(scaled), layout, size)[0]
    assert "calibrated scale" in chosen.description
    # And where nothing was measured, that is said.
    _, remarks = choose_view(folder, profile, layout, size)
    assert [remark.code for remark in remarks] == ["scale_not_measured"]
