# SPDX-License-Identifier: Apache-2.0
"""Markers followed through videos: tracks and flow."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from taccel_lab.calibration.capture import CaptureFolder
from taccel_lab.calibration.markers import gel_view
from taccel_lab.calibration.markers.fit import layout_on_gel
from taccel_lab.calibration.markers.tracking import associate, track_markers
from taccel_lab.calibration.markers.tracks import (
    MarkerTracks,
    TrackFigures,
    TrackStatus,
    marker_flow_mm,
    track_figures,
)
from taccel_lab.camera.gel_camera import CameraModel
from taccel_lab.camera.refraction import media_between
from taccel_lab.errors import InputError
from taccel_lab.files.images import read_image
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import Provenance, SensorProfile, optical_design
from taccel_lab.reading.dots.lattice import fit_layout, lattice_index
from taccel_lab.reading.dots.lattice_growth import Neighbourhood
from taccel_lab.reading.dots.marker_picture import find_markers
from taccel_lab.report.remark import Severity
from taccel_lab.sensors.profile import catalogue_profile
from tests.calibration.drawn.dots import HEIGHT, MARGIN, WIDTH, grid_points, nearest, picture
from tests.support.formula_model import formula_model
from tests.support.real_data import real_data

PITCH = 30.0
MIDDLE_PX = np.array([160.0, 120.0])
REST = grid_points(9, 13, (PITCH, PITCH), centre=(160.0, 119.0))
WAY = REST - MIDDLE_PX
NEAR = np.exp(-(WAY**2).sum(axis=1) / (2 * 120.0**2))
"""1 in the middle of the picture, less around."""


def shear(amount: float) -> np.ndarray:
    """Dots moved by ``amount`` pitches in the middle, less around."""
    return REST + amount * PITCH * NEAR[:, None] * (0.9, 0.43)


def twist(amount: float) -> np.ndarray:
    c, s = np.cos(0.5 * amount * NEAR), np.sin(0.5 * amount * NEAR)
    return MIDDLE_PX + np.stack([c * WAY[:, 0] - s * WAY[:, 1], s * WAY[:, 0] + c * WAY[:, 1]], 1)


def whole(amount: float) -> np.ndarray:
    return REST + amount * PITCH * np.array([0.9, 0.43])


def there_and_back(motion, frames: int, amount: float) -> np.ndarray:
    return np.array([motion(amount * np.sin(np.pi * t / (frames - 1))) for t in range(frames)])


def follow(true: np.ndarray, *, drop: float = 0.0, noise: float = 2.0, cover=None) -> MarkerTracks:
    rng, frames = np.random.default_rng(1), []
    for t, centres in enumerate(true):
        there = centres[rng.random(len(centres)) >= (drop if t else 0.0)]
        light = np.broadcast_to(150 + 25 * np.sin(np.arange(400) / 60 + 0.1 * t), (320, 400))
        image = picture(there, noise=noise, seed=t, background=light, dot=30.0)
        if cover is not None and 0 < t < len(true) - 1:
            image[cover] = 120
        frames.append(image)
    return track_markers(frames, find_markers(frames[0]))


def errors(tracks: MarkerTracks, true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Way of each marker from its own dot [f, m, 2], and whether the dot is well inside [f, m]."""
    x = true[:, nearest(tracks.rest_px, true[0])[0]]
    inside = np.asarray(((x > 8) & (x < (WIDTH - 9, HEIGHT - 9))).all(axis=2))
    return tracks.uv_px - x, inside


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
    true = there_and_back(motion, frames, 1.5)
    tracks = follow(true)
    way, inside = errors(tracks, true)
    error = np.linalg.norm(way, axis=2)
    assert np.linalg.norm(true - true[0], axis=2).max() > 1.4 * PITCH
    assert tracks.seen[inside].all()
    assert error[inside].max() < 0.1
    assert np.sqrt(((way / tracks.sigma_px)[inside] ** 2).mean()) == pytest.approx(1.0, abs=0.15)
    # Back at rest every dot is its own again, those that had left the picture too.
    assert tracks.seen[-1].mean() > 0.97
    assert error[-1][tracks.seen[-1]].max() < 0.05 * PITCH


@pytest.mark.thorough
def test_dots_whose_middle_is_out_of_view_are_followed_by_what_is_seen_of_them() -> None:
    """A row of them, half in view: what lies beyond the border is no second dot."""
    at_rest = grid_points(9, 11, (30.5, 30.0), centre=(159.5, 118.0))
    gone = np.any((at_rest < 0) | (at_rest > (319, 239)), axis=1)
    bent = np.exp(-((at_rest - (170, 110)) ** 2).sum(axis=1) / (2 * 80.0**2))[:, None]
    ways = [
        9.0 * np.sin(np.pi * k / 20) * bent * (0.9, 0.43) + 0.15 * np.sin(k / 3) for k in range(12)
    ]
    v, u = np.mgrid[-MARGIN : 240 + MARGIN, -MARGIN : 320 + MARGIN]
    light = 120 - 50 * ((u - 150) / 240) ** 2 + 30 * np.sin(v / 70)
    video = [
        picture(at_rest + way, 5.5, noise=1.2, seed=k, background=light)
        for k, way in enumerate(ways)
    ]
    tracks = track_markers(video, find_markers(video[0]))
    away, dot = map(np.asarray, KDTree(at_rest).query(tracks.rest_px))
    out = np.asarray(gone)[dot]
    assert away.max() < 0.1 and out.sum() >= 10
    error = np.linalg.norm(tracks.uv_px - (at_rest + np.array(ways))[:, dot], axis=2)
    assert tracks.seen[:, out].all() and error[:, out].max() < 0.06
    assert np.sqrt(np.square(error[:, ~out]).mean()) < 0.012


@pytest.mark.thorough
def test_of_a_real_motion_every_twelfth_frame_is_enough() -> None:
    """Up to 0.6 pitches between frames: matched by distance alone 46 dots are lost or mistaken."""
    frames = [read_image(real_data(f"gsmini_markers_video/{n:04d}.png")) for n in range(0, 121, 6)]
    rest = find_markers(frames[0])
    often, seldom = track_markers(frames, rest), track_markers(frames[::2], rest)
    both = often.seen[::2] & seldom.seen
    assert both.mean() > 0.9
    assert np.linalg.norm(often.uv_px[::2] - seldom.uv_px, axis=2)[both].max() < 0.1


@pytest.mark.thorough
def test_hidden_and_dropped_dots_are_predicted_and_found_again() -> None:
    true = there_and_back(shear, 16, 1.5)
    tracks = follow(true, drop=0.15, cover=(slice(70, 115), slice(120, 190)))
    way, inside = errors(tracks, true)
    error, hidden = np.linalg.norm(way, axis=2), inside & ~tracks.seen
    assert hidden.any() and (tracks.status[hidden] == TrackStatus.PREDICTED).mean() > 0.95
    # Nobody took a neighbour for himself.
    assert error[inside].max() < 0.25 * PITCH
    assert np.percentile(error[inside & tracks.seen], 95) < 0.15
    z = error[hidden] / np.linalg.norm(tracks.sigma_px, axis=2)[hidden]
    assert np.sqrt((z**2).mean()) < 2.0
    assert tracks.seen[-1].mean() > 0.75


@pytest.mark.thorough
def test_figures_of_a_video_say_what_happened() -> None:
    true = np.concatenate([[REST] * 8, there_and_back(shear, 9, 0.8)])
    tracks = follow(true, noise=1.0)
    figures = track_figures("drawn", tracks)
    assert 7 <= figures.quiet_frames <= 9
    assert figures.jitter_px == pytest.approx(np.median(tracks.sigma_px[:8]), rel=0.3)
    assert figures.largest_px == pytest.approx(0.8 * PITCH, rel=0.03)
    assert figures.return_frame == len(true) - 1
    assert figures.return_median_px is not None and figures.return_median_px < 0.05
    first = {name: getattr(tracks, name)[:8] for name in ("uv_px", "sigma_px", "status")}
    still = track_figures("still", replace(tracks, **first))
    assert (still.return_frame, still.quiet_frames) == (None, 8)


def jumped() -> np.ndarray:
    true = np.repeat(REST[None], 6, axis=0)
    true[3:] += (0.48 * PITCH, 0.0)
    return true


def severities(figures: TrackFigures) -> dict[str, Severity]:
    return {remark.code: remark.severity for remark in figures.remarks()}


@pytest.mark.thorough
def test_what_tracks_cannot_tell_is_said() -> None:
    assert severities(track_figures("jump", follow(jumped())))["fast_motion"] is Severity.ERROR
    slow = there_and_back(shear, 8, 0.6)
    slow[5] -= 5000.0
    dark = track_figures("dark", follow(slow))
    assert dark.unseen_frames == (5,)
    assert list(severities(dark)) == ["markers_lost"]


def test_unseen_markers_do_not_slow_the_common_motion() -> None:
    """A jump of all dots, most of which are covered while it lasts: the seen ones tell it."""
    tracks = tracks_of(jumped(), sigma=0.01)
    tracks.status[3:, np.arange(len(REST)) % 5 < 3] = TrackStatus.PREDICTED
    figures = track_figures("covered", tracks)
    assert figures.common_step_in_pitches == pytest.approx(0.48, rel=0.02)
    assert severities(figures)["fast_motion"] is Severity.ERROR


@pytest.mark.thorough
def test_a_marker_that_leaves_for_long_is_lost() -> None:
    true = np.array([REST + (0.0, 5.5 * min(t, 4)) for t in range(18)])
    tracks = follow(true)
    below = true[-1][nearest(tracks.rest_px, REST)[0]][:, 1] > HEIGHT + 5
    assert below.any()
    assert (tracks.status[-1, below] == TrackStatus.LOST).all()


def test_neighbours_extrapolate_affine_fields_exactly_and_ignore_one_liar() -> None:
    around = Neighbourhood.of(REST)
    field = REST @ np.array([[0.05, 0.02], [-0.03, 0.04]]) + (3.0, -1.0)
    lying = field.copy()
    lying[60] += 20.0
    known = np.ones(len(REST), dtype=bool)
    middle = ((REST > 60) & (REST < (WIDTH - 60, HEIGHT - 60))).all(axis=1)
    for given, within in ((field, 0.02), (lying, 1.0)):
        said, _, _ = around.extrapolate(given, known)
        assert np.abs(said - field)[middle].max() < within


def test_bad_videos_are_refused() -> None:
    image = picture(REST, 5.0)
    rest = find_markers(image)
    with pytest.raises(InputError, match="no frame"):
        track_markers([], rest)
    with pytest.raises(InputError, match="frame 1 is 100x80 px"):
        track_markers([image, image[:80, :100]], rest)


SQUARE = np.stack(np.meshgrid(np.arange(9.0), np.arange(9.0)), axis=-1).reshape(-1, 2)
MIDDLE = 40


def assigned(offset: float, scatter: float, pitch_px: float) -> np.ndarray:
    """Blobs of markers that moved alike but for ``scatter`` [pitches], the middle by ``offset``."""
    moved = np.array([1.3, 0.4]) + scatter * (1 - 2 * (SQUARE % 2))
    moved[MIDDLE] = (1.3 + offset, 0.4)
    rest, expected, found = (pitch_px * (SQUARE + way) for way in ((0, 0), (1.3, 0.4), moved))
    odd = np.zeros(len(found), dtype=bool)
    return associate(expected, rest, found, odd, Neighbourhood.of(rest))


def test_the_gate_widens_where_neighbours_scatter_whatever_the_unit_of_length() -> None:
    # Where neighbours move alike, a blob 0.42 pitches off what they say is no dot of this marker;
    # where they scatter by half as much themselves, it is.
    assert assigned(0.42, 0.01, 30.0)[MIDDLE] == -1
    assert assigned(0.42, 0.18, 30.0)[MIDDLE] == MIDDLE
    # However much they scatter, a blob beyond 0.55 pitches is nearer to another marker.
    assert assigned(0.6, 0.18, 30.0)[MIDDLE] == -1
    for scatter in (0.01, 0.1, 0.18):
        for offset in (0.3, 0.42, 0.5):
            fine, coarse = (assigned(offset, scatter, pitch_px) for pitch_px in (30.0, 0.5))
            assert (fine == coarse).all()


def tracks_of(uv: np.ndarray, sigma: float = 0.02) -> MarkerTracks:
    frames, count = uv.shape[:2]
    return MarkerTracks(
        uv_px=uv,
        sigma_px=np.full(uv.shape, sigma),
        status=np.full((frames, count), TrackStatus.SEEN, dtype=np.uint8),
        rest_px=uv[0],
        rest_sigma_px=np.full((count, 2), sigma),
        row=np.arange(count),
        column=np.zeros(count, dtype=int),
        size_px=(320, 240),
    )


def test_flow_through_a_grid_is_pixels_times_scale() -> None:
    grid = PixelGrid(320, 240, 0.06, 0.05)
    rest = np.array([[100.0, 80.0], [200.0, 150.0], [40.0, 60.0]])
    tracks = tracks_of(np.stack([rest, rest + (10.0, -4.0)]))
    flow = marker_flow_mm(tracks, gel_view.PixelView(grid.gel_from_pixel, "a test"), fps=25.0)
    np.testing.assert_allclose(flow.displacement_mm[1], [[0.6, -0.2]] * 3, atol=1e-12)
    np.testing.assert_allclose(flow.points_mm, grid.gel_from_pixel(rest))
    np.testing.assert_allclose(flow.sigma_mm[1, 0], np.sqrt(2) * 0.02 * np.array([0.06, 0.05]))
    assert flow.time_s is not None
    np.testing.assert_allclose(flow.time_s, [0.0, 0.04])


def design(camera: optical_design.DesignedCamera) -> optical_design.OpticalDesign:
    light = optical_design.Light((3.0, -2.0, -25.0), (0.0, 0.0, 1.0), (1.0, 1.0, 1.0))
    window = optical_design.Window(2.0, (40.0, 40.0), 1.49)
    return optical_design.OpticalDesign(
        camera, (light,), optical_design.Coating((0.6, 0.6, 0.6)), window
    )


BACK_MM = np.array([[x, y, -4.0] for x in (-14, 14) for y in (-14, 14)], dtype=float)


def looking_at(position_mm: np.ndarray, target_mm: np.ndarray) -> tuple[float, ...]:
    """gel_from_camera of a camera whose columns run along the gel's x as nearly as can be."""
    z = target_mm - position_mm
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z / (z @ z)
    axes = np.stack([x, np.cross(z, x), z])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return tuple(Rotation.from_matrix(axes.T).as_quat(canonical=True).tolist())


@pytest.mark.thorough(cases=("-5.0-0.5-missing2", "0.0-0.0-missing0"))
@pytest.mark.parametrize(
    ("turn_deg", "stagger", "missing"),
    [(0.0, 0.0, ()), (7.0, 0.0, ((1, 2), (4, 5))), (-5.0, 0.5, ((2, 3),))],
)
def test_a_rendered_grid_comes_back_through_the_camera(turn_deg, stagger, missing) -> None:
    """Our own renderer: perspective from aside, lens distortion, refraction by window and gel."""
    position = (1.5, -1.0, -24.0)
    turn = looking_at(np.array(position), np.array([0.0, 0.2, 0.0]))
    camera = optical_design.DesignedCamera(
        320, 240, 400.0, 404.0, 161.0, 118.0, position, turn,  # type: ignore[arg-type]
        distortion=(-0.12, 0.03, 0.001, -0.001),
    )  # fmt: skip
    ratio = np.sqrt(0.75) if stagger else 0.95
    truth = optical_design.MarkerGrid(
        6, 7, 2.0, 2 * ratio, 0.35, (0.3, -0.2), turn_deg, stagger, missing
    )
    optics = design(camera)
    model = formula_model(
        optics, lambda xy: np.zeros(xy.shape[:-1]), half_size_mm=(14.0, 14.0), back_z_mm=-4.0,
        step_mm=0.5, markers=truth,
    )  # fmt: skip
    image = np.nan_to_num(model.render().linear)
    picture = find_markers(255.0 * image / image.max())
    media = media_between(optics, BACK_MM)
    seen = gel_view.face_seen(CameraModel(camera), media, lambda xy: np.zeros(len(xy)))
    layout = layout_on_gel(picture, gel_view.PixelView(seen, "a test"))
    assert (layout.rows, layout.columns) == (truth.rows, truth.columns)
    np.testing.assert_allclose(layout.pitch, (truth.pitch_x_mm, truth.pitch_y_mm), rtol=1e-3)
    np.testing.assert_allclose(layout.centre, truth.offset_mm, atol=0.01)
    assert layout.rotation_deg == pytest.approx(turn_deg, abs=0.05)
    assert set(layout.missing) == set(missing)
    assert layout.residual_rms < 0.005
    # The same dots by a plain scale are bent by lens, tilt and refraction.
    scale = gel_view.PixelView(PixelGrid(320, 240, 0.055, 0.055).gel_from_pixel, "a test")
    assert layout_on_gel(picture, scale).residual_rms > 5 * layout.residual_rms
    assert picture.layout_px is not None


def test_a_camera_view_undoes_projection_on_a_dome() -> None:
    camera = optical_design.DesignedCamera(320, 240, 400.0, 400.0, 159.5, 119.5, (0.0, 0.0, -24.0))
    media = media_between(design(camera), BACK_MM)

    def dome(xy: np.ndarray) -> np.ndarray:
        return np.sqrt(40.0**2 - (xy**2).sum(axis=1)) - 40.0

    model = CameraModel(camera)
    view = gel_view.PixelView(gel_view.face_seen(model, media, dome), "a test")
    xy = np.random.default_rng(2).uniform(-4, 4, (30, 2))
    points = np.column_stack([xy, dome(xy)])
    sight = media.sight(np.array(camera.position_mm), points)
    uv = model.pixels_from_directions(sight @ model.gel_from_camera)
    np.testing.assert_allclose(view.gel_from_pixel(uv), xy, atol=1e-6)
    assert (np.linalg.det(gel_view.pixel_jacobian(view, uv)) > 0).all()


def calibrated(spread: dict[str, float]) -> Provenance:
    return Provenance(
        kind="calibrated", method="a test", source="none", inputs={"a": "0" * 64},
        residuals={"r": 0.0}, valid_region={"x": (0.0, 1.0)}, spread=spread,
    )  # fmt: skip


@pytest.mark.parametrize("bent", [True, False])
def test_a_calibrated_pose_is_looked_through_as_it_was_fitted(bent: bool) -> None:
    """Whether its sight lines are bent shows in the pixel grid that was calibrated with it."""
    profile = catalogue_profile("gelsight_mini")
    assert profile.optics is not None
    size = (profile.camera.width_px, profile.camera.height_px)
    middle = (np.array(size) - 1) / 2
    scale, other = (
        np.diag(
            gel_view.pixel_jacobian(gel_view.camera_view(profile, size, refraction=each), middle)
        )
        for each in (bent, not bent)
    )
    assert np.abs(scale / other - 1).min() > 0.1
    posed = profile.optics.replace(provenance=calibrated({"position_z_mm": 0.1, "fx_px": 1.0}))
    # A lens without a pose says nothing of millimetres; the calibrated grid does.
    lens = profile.optics.replace(provenance=calibrated({"fx_px": 1.0}))
    scaled = profile.camera.replace(
        mm_per_px_x=float(scale[0]),
        mm_per_px_y=float(scale[1]),
        provenance=calibrated({"mm_per_px_x": 1e-4}),
    )
    layout = fit_layout(grid_points(), lattice_index(grid_points()))
    folder = CaptureFolder("a test", Path(), "gelsight_mini", None, None, (), None, None, None, ())

    def chosen(of: SensorProfile):
        return gel_view.choose_view(folder, of, layout, size)

    view, _ = chosen(profile.with_block(posed).with_block(scaled))
    assert "camera" in view.description
    np.testing.assert_allclose(np.diag(gel_view.pixel_jacobian(view, middle)), scale, rtol=1e-9)
    view, _ = chosen(profile.with_block(lens).with_block(scaled))
    assert "calibrated scale" in view.description
    # And where nothing was measured, that is said.
    _, remarks = chosen(profile)
    assert [remark.code for remark in remarks] == ["scale_not_measured"]
