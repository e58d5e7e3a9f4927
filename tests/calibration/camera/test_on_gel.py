# SPDX-License-Identifier: Apache-2.0
"""Scale, pose and rectification from boards on the gel: exact, noisy, in part, refracted, bent."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.board_on_gel import fit_on_gel
from taccel_lab.calibration.camera.find_boards import detect_dots
from taccel_lab.calibration.camera.intrinsics import calibrate_intrinsics
from taccel_lab.calibration.camera.lens import LENSES
from taccel_lab.calibration.camera.plane import CameraPose
from taccel_lab.calibration.camera.rectification import RectificationMaps, gel_maps
from taccel_lab.camera.refraction import FlatMedia
from taccel_lab.errors import InputError
from taccel_lab.files.images import read_image
from taccel_lab.reading.dots.marker_picture import find_markers
from tests.calibration.drawn import boards
from tests.support.real_data import real_data

MEDIA = FlatMedia((-7.0, -4.0), (1.0, 1.49, 1.41))
INDEX, PLACES_MM = boards.lattice_points(9, 7), (boards.lattice_points(9, 7) - [4, 3]) * 2.5


def flat_view(
    sx: float = 0.05, sy: float = 0.05, turn_deg: float = 0.0, noise: ArrayLike = 0.0
) -> BoardView:
    """A 9 x 7 board of 2.5 mm under an ideal scanner of unequal scales."""
    turn = Rotation.from_euler("z", turn_deg, degrees=True).as_matrix()[:2, :2]
    uv = PLACES_MM @ turn.T / (sx, sy) + (322.0, 236.0) + np.asarray(noise)
    return BoardView("flat", "flat", boards.SIZE, INDEX, uv, 63, pitch_mm=2.5)


def part_of(view: BoardView, chosen: np.ndarray) -> BoardView:
    return replace(view, index=view.index[chosen], uv_px=view.uv_px[chosen])


@pytest.mark.thorough
@settings(max_examples=8)
@given(sx=st.floats(0.02, 0.08), ratio=st.floats(0.9, 1.1), turn=st.floats(-40, 40))
def test_unequal_scales_come_back_exactly(sx: float, ratio: float, turn: float) -> None:
    found = fit_on_gel([flat_view(sx, sx * ratio, turn)])
    assert found.frame.mm_per_px_x.value == pytest.approx(sx, rel=1e-6)
    assert found.frame.mm_per_px_y.value == pytest.approx(sx * ratio, rel=1e-6)
    assert abs(found.frame.shear) < 1e-6
    assert found.fit.model.name == "unknown lens"
    # The gel frame's x runs along the image's rows, whatever the board does.
    origin, *ahead = found.pixel_from_gel(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    np.testing.assert_allclose(origin, (319.5, 239.5), atol=1e-5)
    np.testing.assert_allclose(ahead - origin, np.diag([1 / sx, 1 / (sx * ratio)]), atol=1e-4)


@pytest.mark.thorough
def test_noise_stays_within_the_predicted_uncertainty() -> None:
    scores = []
    for seed in range(10):
        noise = np.random.default_rng(seed).normal(0, 0.3, (63, 2))
        view = flat_view(0.05, 0.052, 10.0, noise)
        if seed % 2:  # Also with a third of the dots missing.
            view = part_of(view, np.random.default_rng(seed).permutation(63)[:42])
        frame = fit_on_gel([view]).frame
        for scale, true in ((frame.mm_per_px_x, 0.05), (frame.mm_per_px_y, 0.052)):
            scores.append((scale.value - true) / scale.sigma)
    assert 0.4 < np.sqrt(np.mean(np.square(scores))) < 1.4


def test_boards_at_several_places_are_one_plane() -> None:
    """The second board is turned and shifted: neither changes the scale."""
    found = fit_on_gel([flat_view(turn_deg=3.0), flat_view(turn_deg=-31.0, noise=(35.0, -20.0))])
    assert found.frame.mm_per_px_x.value == pytest.approx(0.05, rel=1e-6)
    assert found.fit.rms_px < 1e-5
    assert np.degrees(found.fit.motions[1, 0]) == pytest.approx(-34.0, abs=1e-4)


@cache
def lens_of(name: str):
    return calibrate_intrinsics(boards.views_of(name, 8), models=[name], folds=2)


def board_through(intrinsics, media: FlatMedia | None) -> tuple[BoardView, np.ndarray, np.ndarray]:
    """A board on the gel as the camera sees it, with the camera's true position and rotation."""
    model = CameraPose(
        intrinsics.lens, intrinsics.parameters, intrinsics.chosen.fit.covariance, boards.SIZE, media
    )
    gel_from_camera = Rotation.from_euler("xyz", [4.0, -3.0, 0.0], degrees=True)
    position = np.array([0.4, -0.3, -27.0])
    camera_from_gel = gel_from_camera.inv()
    theta = np.concatenate(
        [camera_from_gel.as_rotvec(), -camera_from_gel.apply(position), intrinsics.parameters]
    )
    uv = model.project(theta, PLACES_MM)
    view = BoardView("gel", "gel", boards.SIZE, INDEX, uv, 63, pitch_mm=2.5)
    return view, position, gel_from_camera.as_matrix()


@pytest.mark.thorough
def test_pose_of_the_gel_with_and_without_refraction() -> None:
    intrinsics = lens_of("pinhole")
    for media in (None, MEDIA):
        view, position, rotation = board_through(intrinsics, media)
        found = fit_on_gel([view], intrinsics=intrinsics, media=media)
        assert found.pose is not None and found.pose.refracted is (media is not None)
        assert found.pose.fit.rms_px < 1e-4
        # The gel frame has its origin at the image's middle and its x along the rows.
        origin = found.frame.board_from_gel(np.zeros((1, 2)))[0] - (10.0, 7.5)
        turn = Rotation.from_rotvec([0, 0, found.frame.angle_rad]).as_matrix()
        wanted = turn.T @ (position - [*origin, 0.0])
        np.testing.assert_allclose(found.pose.position_mm, wanted, atol=2e-3)
        camera = Rotation.from_quat(found.pose.rotation).as_matrix()
        np.testing.assert_allclose(camera, turn.T @ rotation, atol=1e-4)
        # The wrong assumption is found out by what it leaves.
        other = fit_on_gel([view], intrinsics=intrinsics, media=MEDIA)
        assert other.pose is not None and other.pose.refracted is (media is not None)
    in_air, _ = found.poses
    # Straight sight lines make the gel look nearer: sum of h (1 - 1/n) by the paraxial law.
    nearer = in_air.position_mm[2] - found.pose.position_mm[2]
    paraxial = 3.0 * (1 - 1 / 1.49) + 4.0 * (1 - 1 / 1.41)
    assert nearer == pytest.approx(paraxial, rel=0.35)
    assert in_air.fit.heldout_px > 10 * found.pose.fit.heldout_px


@pytest.mark.parametrize("turn", [0.0, 3.25, 90.0])
def test_a_pose_parallel_to_the_gel_is_where_the_search_starts(turn: float) -> None:
    """Exactly parallel planes make IPPE divide by zero; what it returned was taken."""
    pose = boards.pose_over(*boards.BOARD, distance_mm=25.0, turn_deg=turn)
    view, true = boards.view_of("fisheye", pose), boards.TRUTHS["fisheye"]
    model = CameraPose(LENSES["fisheye"], true, np.zeros((len(true), len(true))), boards.SIZE)
    start = model.start(view.board_mm()[:, :2], view.uv_px)
    np.testing.assert_allclose(start[3:6], pose[3:], atol=1e-4)


@pytest.mark.thorough
def test_rectified_pictures_have_one_scale() -> None:
    """Dots drawn through the lens lie on a square lattice after rectification."""
    intrinsics = lens_of("k1")
    view, _, _ = board_through(intrinsics, None)
    found = fit_on_gel([view], intrinsics=intrinsics)
    picture = np.full((boards.SIZE[1], boards.SIZE[0]), 200, np.uint8)
    for u, v in view.uv_px:
        cv2.circle(picture, (round(u * 16), round(v * 16)), 6 * 16, 20, -1, cv2.LINE_AA, 4)
    maps = gel_maps(found)
    rectified = np.repeat(maps.apply(picture)[..., None], 3, axis=2)
    dots = detect_dots(rectified, 9, 7)
    xy = found.grid.gel_from_pixel(dots.uv_px)
    design = np.column_stack([dots.index, np.ones(len(dots.index))])
    slopes, *_ = np.linalg.lstsq(design, xy, rcond=None)
    left = xy - design @ slopes
    assert np.sqrt(np.mean(np.sum(left**2, axis=1))) < 0.2 * found.grid.mm_per_px_x
    np.testing.assert_allclose(slopes[:2].T @ slopes[:2], 2.5**2 * np.eye(2), rtol=4e-3, atol=0.03)
    assert maps.measured[boards.SIZE[1] // 2, boards.SIZE[0] // 2] and not maps.measured[0, 0]


def test_maps_are_saved_whole(tmp_path: Path) -> None:
    maps = gel_maps(fit_on_gel([flat_view()]))
    maps.save(tmp_path / "maps.npz")
    loaded = RectificationMaps.load(tmp_path / "maps.npz")
    for name in ("map_u_px", "map_v_px", "measured"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(maps, name))
    assert loaded.grid == maps.grid and loaded.raw_size_px == boards.SIZE
    assert loaded.grid is not None and loaded.map_u_px.shape == boards.SIZE[::-1]
    assert loaded.grid.mm_per_px_x == pytest.approx(0.05, rel=1e-6)


@pytest.mark.thorough
def test_two_pictures_of_the_dents_that_differ_widen_the_scale() -> None:
    view = flat_view(noise=np.random.default_rng(0).normal(0, 0.05, (63, 2)))
    middle = np.array([322.0, 236.0])
    others = tuple(middle + (view.uv_px - middle) * [s, 1.0] for s in (0.997, 1.01, 1.004))
    shaded = replace(view, others_uv_px=others)
    plain, wide = fit_on_gel([view]).frame, fit_on_gel([shaded]).frame
    assert wide.mm_per_px_x.value == plain.mm_per_px_x.value
    assert plain.mm_per_px_x.sigma < 1e-3 * 0.05
    assert wide.mm_per_px_x.sigma == pytest.approx(0.01 * 0.05, rel=0.1)
    assert wide.mm_per_px_y.sigma < 1.1 * plain.mm_per_px_y.sigma


def test_boards_that_give_no_scale_are_refused_and_one_beside_the_middle_is_told() -> None:
    view = flat_view()
    for bad, lens, words in (
        (replace(view, pitch_mm=None), None, "pitch_mm"),
        (part_of(view, np.arange(5)), None, "at least 8"),
        (replace(view, size_px=(320, 240)), lens_of("k1"), "use one size"),
    ):
        with pytest.raises(InputError, match=words):
            fit_on_gel([bad], intrinsics=lens)
    beside = replace(view, uv_px=flat_view(0.02, 0.02).uv_px * 0.3 + (10.0, 10.0))
    assert "off_center" in {remark.code for remark in fit_on_gel([beside]).remarks}


@pytest.mark.thorough
@pytest.mark.parametrize(("unit", "removed"), [(1, 0), pytest.param(2, 21, marks=pytest.mark.slow)])
def test_scale_of_pressed_boards_of_9dtact(unit: int, removed: int) -> None:
    """Within 1 % of the scale that the authors stored; also when a third of the dots is gone."""
    nine = "9dtact_official/shape_reconstruction/calibration"
    folder = real_data(f"{nine}/sensor_{unit}/camera_calibration")
    row, column, stored = np.load(folder / "position_scale.npy")
    image, reference = read_image(folder / "sample.png"), read_image(folder / "ref.png")
    if removed:
        change = np.asarray(image, dtype=np.float32) - reference
        dents = find_markers(128 + change.mean(axis=2)).dots.uv_px
        for u, v in np.random.default_rng(unit).permutation(dents)[:removed]:
            at = (slice(max(int(v) - 26, 0), int(v) + 27), slice(max(int(u) - 26, 0), int(u) + 27))
            image[at] = reference[at]
    view = detect_dots(image, 9, 7, reference=reference)
    assert len(view.index) >= 63 - removed - 6
    found = fit_on_gel([replace(view, pitch_mm=2.5)], center_px=(float(column), float(row)))
    for scale in (found.frame.mm_per_px_x, found.frame.mm_per_px_y):
        assert scale.value == pytest.approx(stored, rel=0.01)
        assert scale.sigma < 0.02 * stored
    assert any(remark.code == "distorted" for remark in found.remarks)


@pytest.mark.thorough
def test_a_pressed_board_is_seen_through_several_filters() -> None:
    """A dent whose shading is one-sided has its centre elsewhere in every filter."""
    v, u = np.mgrid[0:240, 0:320].astype(np.float64)
    plain, shaded = np.full((240, 320), 150.0), np.full((240, 320), 150.0)
    for column in range(7):
        for row in range(5):
            x, y = u - (40 + 40 * column), v - (40 + 40 * row)
            dent = np.exp(-(((x**2 + y**2) / 81) ** 2))
            plain -= 30 * dent
            # Light from the middle: the side that looks away from it is darker, and farther so.
            away = np.where(x * (column - 3) > 0, np.exp(-np.hypot(x, y) / 12), 0.0)
            shaded -= 30 * dent + 12 * away * abs(column - 3) / 3
    reference = np.full((240, 320, 3), 150, np.uint8)

    def scale(levels: np.ndarray) -> tuple[float, int]:
        image = np.repeat(np.clip(levels, 0, 255).astype(np.uint8)[..., None], 3, axis=2)
        view = replace(detect_dots(image, 7, 5, reference=reference), pitch_mm=2.0)
        return fit_on_gel([view]).frame.mm_per_px_x.sigma / 0.05, len(view.others_uv_px)

    (even, filters), (uneven, _) = scale(plain), scale(shaded)
    assert filters >= 3  # Of one picture, and of the other where it shows the dents.
    assert even < 0.002 and uneven > 2 * even
