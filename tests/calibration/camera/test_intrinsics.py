# SPDX-License-Identifier: Apache-2.0
"""Boards are found in images, and lenses fitted to them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.chessboard import (
    charuco_board,
    detect_charuco,
    detect_chessboard,
)
from taccel_lab.calibration.camera.find_boards import detect_dots, detect_views
from taccel_lab.calibration.camera.fit import calibrate_camera
from taccel_lab.calibration.camera.intrinsics import calibrate_intrinsics, fold_of_views
from taccel_lab.calibration.camera.lens import LENSES, fit_bundle, initial_pose
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.robust_fit import rms
from taccel_lab.camera.gel_camera import CameraModel
from taccel_lab.errors import InputError
from taccel_lab.files.images import read_image
from taccel_lab.report.remark import Severity, judge
from taccel_lab.sensors.profile import catalogue_profile
from tests.calibration.camera.views import COLUMNS, PITCH, ROWS, SIZE, TRUTHS, board_of, views_of
from tests.calibration.drawn.boards import (
    chess_pattern,
    dot_pattern,
    exact_view,
    image_pattern,
    lattice_points,
    pose_over,
    render_board,
)
from tests.calibration.drawn.faults import add_gradient, add_noise, blur, quantise, vignette
from tests.support.real_data import real_data

PICTURE_PX = (320, 240)
LENS = LENSES["k1"]
PARAMETERS = np.array([260.0, 258.0, 158.0, 121.0, -0.12])
SQUARE_MM = 4.0


def picture(pattern, pose: np.ndarray, seed: int = 0) -> np.ndarray:
    """A noisy, blurred, vignetted and unevenly lit picture, RGB uint8."""
    image = render_board(LENS, PARAMETERS, pose, PICTURE_PX, pattern, SQUARE_MM, samples=2)
    image = vignette(blur(image, 0.7), 0.35)
    image = add_gradient(image, 12.0, -8.0)
    return quantise(add_noise(image, 2.0, np.random.default_rng(seed)))


def pose_of(columns: int, rows: int, **changes: object) -> np.ndarray:
    settings = {"distance_mm": 42.0, "tilt_deg": (18.0, -14.0), "turn_deg": 7.0}
    return pose_over(columns, rows, SQUARE_MM, **(settings | changes))  # type: ignore[arg-type]


def truth(columns: int, rows: int, pose: np.ndarray) -> np.ndarray:
    points = np.column_stack([lattice_points(columns, rows) * SQUARE_MM, np.zeros(columns * rows)])
    return LENS.project(points, PARAMETERS, pose)


def errors(view, columns: int, rows: int, pose: np.ndarray) -> np.ndarray:
    """Distance of every point from where it is, by its index, up to turns of the board."""
    exact = truth(columns, rows, pose).reshape(rows, columns, 2)
    best = None
    for turned in (exact, exact[::-1, ::-1]):
        wanted = turned[view.index[:, 1], view.index[:, 0]]
        off = np.linalg.norm(view.uv_px - wanted, axis=1)
        best = off if best is None or off.mean() < best.mean() else best
    assert best is not None
    return best


def test_chessboard_is_found_to_a_tenth_of_a_pixel() -> None:
    pose = pose_of(7, 5)
    view = detect_chessboard(picture(chess_pattern(7, 5), pose), 7, 5)
    assert len(view.index) == 35
    off = errors(view, 7, 5, pose)
    assert off.max() < 0.35 and np.sqrt(np.mean(off**2)) < 0.12


@pytest.mark.thorough
def test_part_of_a_chessboard_is_enough_and_too_little_is_counted() -> None:
    pose = pose_of(7, 5)
    image = picture(chess_pattern(7, 5), pose)
    hidden = image.copy()
    hidden[:, :118] = 90
    view = detect_chessboard(hidden, 7, 5)
    assert 18 <= len(view.index) < 35
    slopes = np.linalg.lstsq(
        np.column_stack([view.index, np.ones(len(view.index))]), view.uv_px, rcond=None
    )[0]
    assert np.linalg.det(slopes[:2]) > 0
    hidden[:, :230] = 90
    with pytest.raises(InputError, match=r"found \d+ of 35 inner corners"):
        detect_chessboard(hidden, 7, 5)
    with pytest.raises(InputError, match="at least 3 x 3"):
        detect_chessboard(image, 2, 5)


def charuco_image(flipped: bool = False, legacy: bool = False) -> np.ndarray:
    board = charuco_board(8, 6, 0.7, "DICT_4X4_50", legacy=legacy)
    drawing = board.generateImage((8 * 60, 6 * 60), marginSize=0)
    # Lattice point (0, 0) is the first inner corner, one square from the drawing's corner.
    pattern = image_pattern(drawing, 60.0, (59.5, 59.5))
    image = picture(pattern, pose_of(7, 5, distance_mm=36.0))
    return np.ascontiguousarray(image[:, ::-1]) if flipped else image


@pytest.mark.parametrize("legacy", [False, True])
def test_charuco_board_by_its_markers(legacy: bool) -> None:
    view = detect_charuco(charuco_image(legacy=legacy), 8, 6, marker_share=0.7)
    assert len(view.index) >= 33
    assert errors(view, 7, 5, pose_of(7, 5, distance_mm=36.0)).max() < 0.6


@pytest.mark.thorough
def test_charuco_parts_mirrors_and_strangers() -> None:
    half = charuco_image()
    half[:, 170:] = 120
    view = detect_charuco(half, 8, 6, marker_share=0.7)
    assert 6 <= len(view.index) < 30
    assert errors(view, 7, 5, pose_of(7, 5, distance_mm=36.0)).max() < 0.6
    with pytest.raises(InputError, match="mirrored"):
        detect_charuco(charuco_image(flipped=True), 8, 6, marker_share=0.7)
    with pytest.raises(InputError, match="found 0 of 35 corners"):
        detect_charuco(np.full((240, 320, 3), 90, np.uint8), 8, 6, marker_share=0.7)
    with pytest.raises(InputError, match="unknown ArUco dictionary"):
        detect_charuco(half, 8, 6, marker_share=0.7, dictionary="DICT_9X9")


@pytest.mark.thorough(cases=("0.0",))
@pytest.mark.parametrize("share", [0.0, 1 / 3])
def test_dots_with_some_missing(share: float) -> None:
    rng = np.random.default_rng(5)
    sites = lattice_points(9, 7)
    missing = sites[rng.permutation(len(sites))[: round(share * len(sites))]]
    pose = pose_of(9, 7, distance_mm=48.0, tilt_deg=(6.0, 4.0))
    image = picture(dot_pattern(9, 7, missing=missing), pose)
    view = detect_dots(image, 9, 7)
    assert len(view.index) >= 0.95 * (63 - len(missing))
    off = errors(view, 9, 7, pose)
    assert np.median(off) < 0.25 and off.max() < 1.0


@pytest.mark.thorough
def test_dots_that_are_not_there_or_too_many() -> None:
    rng = np.random.default_rng(0)
    noise = quantise(add_noise(np.full((240, 320, 3), 120.0), 3.0, rng))
    with pytest.raises(InputError, match=r"found \d+ of 63 dots"):
        detect_dots(noise, 9, 7)
    pose = pose_of(9, 7, distance_mm=48.0, tilt_deg=(6.0, 4.0))
    with pytest.raises(InputError, match="go on beyond 8 x 6"):
        detect_dots(picture(dot_pattern(9, 7), pose), 8, 6)
    with pytest.raises(InputError, match="of one size"):
        detect_dots(noise, 9, 7, reference=noise[:100])


@pytest.mark.thorough
def test_dents_of_pins_show_against_the_untouched_gel() -> None:
    """Faint dents under uneven light; without the reference nothing could be told."""
    rng = np.random.default_rng(1)
    u, v = np.meshgrid(np.arange(320), np.arange(240))
    gel = np.stack([90 + 0.2 * u, 120 + 0.1 * v, 150 - 0.15 * u], axis=-1)
    pose = pose_of(6, 5, distance_mm=40.0, tilt_deg=(3.0, 2.0))
    exact = truth(6, 5, pose)
    dents = np.zeros((240, 320))
    for at in exact:
        dents += np.exp(-((u - at[0]) ** 2 + (v - at[1]) ** 2) / (2 * 5.0**2))
    pressed = gel * (1 - 0.06 * dents[..., None])
    image = quantise(add_noise(pressed, 1.5, rng))
    reference = quantise(add_noise(gel, 1.5, rng))
    view = detect_dots(image, 6, 5, reference=reference)
    assert len(view.index) == 30
    assert errors(view, 6, 5, pose).max() < 1.0
    with pytest.raises(InputError, match="give a reference image without the board"):
        detect_dots(reference, 6, 5, reference=reference)


@pytest.mark.thorough
def test_images_of_two_sizes_are_refused_and_one_twice_counts_once() -> None:
    image = picture(chess_pattern(7, 5), pose_of(7, 5))
    larger = cv2.resize(image, (640, 480), interpolation=cv2.INTER_CUBIC)
    with pytest.raises(InputError, match="of one size"):
        detect_views([board_of([image, larger], 7, 5)])
    board = board_of([image] * 3, 7, 5)
    found = detect_views([board])
    assert len(found.views) == 1
    assert found.refused[0] == "v1.png: the same image as v0.png"
    folder = CaptureFolder(
        "memory", Path(), "flat_pad", None, None, (), None, None, None, (), boards=(board,)
    )
    with pytest.raises(InputError, match=r"1 views of the board are left.*\n.*the same image as"):
        calibrate_camera(folder, catalogue_profile("flat_pad"))


@pytest.mark.parametrize("name", list(LENSES))
def test_projection_is_that_of_the_renderer(name: str) -> None:
    """The profile's camera model and the fitted one put points at the same pixels."""
    lens, truth = LENSES[name], TRUTHS[name]
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (20, 3)) * (12, 9, 3) + (0, 0, 30)
    camera = CameraModel(lens.camera(truth, SIZE))
    fitted = lens.project(points, truth, np.zeros(6))
    np.testing.assert_allclose(camera.pixels_from_directions(points), fitted, atol=1e-8)


@pytest.mark.thorough(cases=("rational",))
@pytest.mark.parametrize("name", list(LENSES))
def test_exact_points_give_the_lens_back(name: str) -> None:
    found = calibrate_intrinsics(views_of(name, 7), models=[name], folds=2)
    # k4..k6 of the rational lens trade against k1..k3; its pictures are what counts.
    if name == "rational":
        assert found.chosen.fit.rms_px < 1e-5
        np.testing.assert_allclose(found.parameters[:4], TRUTHS[name][:4], rtol=1e-4)
    else:
        np.testing.assert_allclose(found.parameters, TRUTHS[name], rtol=1e-5, atol=1e-6)
    assert found.chosen.heldout_px < 1e-4


@pytest.mark.thorough
def test_noise_stays_within_the_predicted_uncertainty() -> None:
    """Standardised errors over many calibrations have the spread of a normal distribution."""
    scores = []
    for seed in range(10):
        fit = fit_bundle(views_of("pinhole", 9, 0.3, seed), LENSES["pinhole"], TRUTHS["pinhole"])
        scores.append((fit.parameters - TRUTHS["pinhole"]) / fit.sigma)
    spread = np.sqrt(np.mean(np.square(scores)))
    assert 0.6 < spread < 1.3
    assert np.mean(np.abs(scores) < 1.96) > 0.87


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("true", "allowed"),
    [("k1", {"k1"}), pytest.param("fisheye", {"fisheye"}, marks=pytest.mark.slow)],
)
def test_the_simplest_lens_that_predicts_is_chosen(true: str, allowed: set[str]) -> None:
    found = calibrate_intrinsics(
        views_of(true, 12, 0.15, seed=4), models=["k1", "fisheye", "pinhole"], folds=3
    )
    assert found.lens.name in allowed
    assert found.chosen.heldout_px == pytest.approx(0.15 * np.sqrt(2), rel=0.2)
    truth = TRUTHS[true]
    assert (np.abs(found.parameters - truth) < 5 * found.chosen.fit.sigma).all()


def test_single_wrong_corners_have_little_effect() -> None:
    views = views_of("k1", 8, 0.1, seed=3)
    for view in views[::3]:
        view.uv_px[7] += (25.0, -18.0)
    found = calibrate_intrinsics(views, models=["k1"], folds=2)
    assert not found.outliers or len(found.outliers) <= 4
    assert np.abs(found.parameters[:4] - TRUTHS["k1"][:4]).max() < 1.5


def views_from(
    name: str, ways: list[dict[str, Any]], noise_px: float, seed: int
) -> list[BoardView]:
    """Views from where the arguments of ``pose_over`` say."""
    rng = np.random.default_rng(seed)
    return [
        exact_view(
            LENSES[name], TRUTHS[name], pose_over(COLUMNS, ROWS, PITCH, **way), SIZE, COLUMNS, ROWS,
            PITCH, noise_px=noise_px, rng=rng, name=f"v{k}",
        )
        for k, way in enumerate(ways)
    ]  # fmt: skip


@pytest.mark.thorough(cases=("way0",))
@pytest.mark.parametrize("way", [{"turn_deg": 20.0, "tilt_deg": (1, 0.5)}, {"tilt_deg": (25, 10)}])
def test_views_that_are_not_tilted_or_from_one_side_are_called_weak(way: dict[str, Any]) -> None:
    turn = way.get("turn_deg", 0.0)
    ways = [{**way, "distance_mm": 30 + k, "turn_deg": turn * k} for k in range(6)]
    views = views_from("pinhole", ways, 0.05, seed=2)
    found = calibrate_intrinsics(views, models=["pinhole"], folds=2)
    codes = {remark.code: remark.severity for remark in found.remarks}
    assert codes["views_alike"] is Severity.ERROR and judge(found.remarks) == "weak"
    assert "too_few" in codes


@pytest.mark.thorough
def test_points_of_another_board_are_called_weak() -> None:
    """As when a chessboard is searched for dots: regular points, but not those of the board."""
    rng = np.random.default_rng(3)
    views = [
        replace(view, uv_px=view.uv_px + rng.normal(0, 8, view.uv_px.shape))
        for view in views_of("pinhole", 6)
    ]
    found = calibrate_intrinsics(views, models=["pinhole"], folds=2)
    codes = {r.code: r.severity for r in found.remarks}
    assert codes["heldout_error"] is Severity.ERROR and judge(found.remarks) == "weak"


def test_too_few_views_and_unknown_lenses_are_refused() -> None:
    with pytest.raises(InputError, match="at least 3"):
        calibrate_intrinsics(views_of("k1", 2))
    with pytest.raises(InputError, match="unknown lens model 'wide'"):
        calibrate_intrinsics(views_of("k1", 4), models=["wide"])
    with pytest.raises(InputError, match="folds"):
        calibrate_intrinsics(views_of("k1", 4), folds=1)


@settings(max_examples=25, deadline=None)
@example(tilt=(0.0, 0.0), turn=3.25, distance=25.0)  # Parallel: IPPE divides by zero.
@given(
    tilt=st.tuples(st.floats(-50, 50), st.floats(-50, 50)),
    turn=st.floats(-180, 180),
    distance=st.floats(25, 80),
)
def test_the_pose_of_a_board_is_found_from_any_side(
    tilt: tuple[float, float], turn: float, distance: float
) -> None:
    lens, truth = LENSES["fisheye"], TRUTHS["fisheye"]
    pose = pose_over(COLUMNS, ROWS, PITCH, distance_mm=distance, tilt_deg=tilt, turn_deg=turn)
    view = exact_view(lens, truth, pose, SIZE, COLUMNS, ROWS, PITCH)
    found = initial_pose(view, lens, truth)
    assert np.abs(lens.project(view.board_mm(), truth, found) - view.uv_px).max() < 1e-5
    np.testing.assert_allclose(cv2.Rodrigues(found[:3])[0], cv2.Rodrigues(pose[:3])[0], atol=1e-5)
    np.testing.assert_allclose(found[3:], pose[3:], atol=1e-4)


@pytest.mark.thorough
def test_real_fisheye_camera_is_predicted_to_half_a_pixel() -> None:
    """Every second board of a home-made sensor; plain OpenCV leaves 0.68 px held out."""
    folder = real_data("gelsight_osaka_photon26/fisheye/cam2")
    views = [
        detect_chessboard(read_image(path), 6, 6, name=path.name)
        for path in sorted(folder.glob("*.jpg"))[::2]
    ]
    found = calibrate_intrinsics(views, models=["fisheye"], folds=3)
    assert found.lens.name == "fisheye" and not found.outliers
    assert found.chosen.heldout_px < 0.50


FOLDS = 3


@pytest.mark.thorough
def test_views_that_no_fit_takes_count_in_the_headline() -> None:
    views = views_of("k1", 9, 0.1, seed=2)
    clean = calibrate_intrinsics(views, models=["k1"], folds=FOLDS)
    rng = np.random.default_rng(1)
    moved = rng.normal(0, 6.0, views[5].uv_px.shape)
    views[5] = replace(views[5], uv_px=views[5].uv_px + moved)
    found = calibrate_intrinsics(views, models=["k1"], folds=FOLDS)
    assert len(found.outliers) == 1 and "view5" in found.outliers[0]
    usual = 0.1 * np.sqrt(2)
    assert clean.chosen.heldout_px == pytest.approx(usual, rel=0.15)
    # One view of nine; its pose takes up a little.
    assert found.chosen.heldout_px == pytest.approx(rms(moved) / 3, rel=0.1)
    assert found.chosen.heldout_robust_px == pytest.approx(usual, rel=0.25)
    # It does not bend the lens, nor call it a lens of another board.
    assert np.abs(found.parameters[:4] - TRUTHS["k1"][:4]).max() < 2.0
    assert "heldout_error" not in {remark.code for remark in found.remarks}


@pytest.mark.thorough
def test_spoilt_held_out_views_leave_the_fit_bit_for_bit_as_it_is() -> None:
    views = views_of("k1", 9, 0.2, seed=4)
    clean = calibrate_intrinsics(views, models=["k1"], folds=FOLDS).chosen
    rng = np.random.default_rng(0)
    spoilt = [
        replace(view, uv_px=view.uv_px + rng.normal(0, 40, (48, 2))) if i % FOLDS == 1 else view
        for i, view in enumerate(views)
    ]
    found = calibrate_intrinsics(spoilt, models=["k1"], folds=FOLDS).chosen
    assert np.array_equal(found.fold_parameters[1], clean.fold_parameters[1])
    assert not np.array_equal(found.fold_parameters[0], clean.fold_parameters[0])
    assert found.heldout_px > 20


@pytest.mark.slow
def test_held_out_images_of_noise_leave_the_fit_bit_for_bit_as_it_is() -> None:
    """From images on: what is held out is decided by the manifest, not by what is found in them."""
    parameters, rng = np.array([270.0, 268.0, 158.0, 121.0, -0.1]), np.random.default_rng(3)
    tilts = [(25, 0), (-25, 10), (5, 28), (0, -28), (20, 20), (-15, -20)]
    images = []
    for k, tilt in enumerate(tilts):
        pose = pose_over(7, 5, 4.0, distance_mm=40 + 2 * k, tilt_deg=tilt, turn_deg=20.0 * k)
        drawn = render_board(
            LENSES["k1"], parameters, pose, (320, 240), chess_pattern(7, 5), 4.0, samples=2
        )
        images.append(quantise(add_noise(drawn, 1.5, rng)))
    clean = detect_views([board_of(images, 7, 5)])
    assert [view.place for view in clean.views] == list(range(6))
    before = calibrate_intrinsics(clean.views, models=["k1"], folds=FOLDS).chosen
    held = 2
    noise = [
        rng.integers(0, 256, image.shape, dtype=np.uint8) if k % FOLDS == held else image
        for k, image in enumerate(images)
    ]
    left = detect_views([board_of(noise, 7, 5)])
    assert len(left.refused) == 2
    assert [view.place for view in left.views] == [k for k in range(6) if k % FOLDS != held]
    after = calibrate_intrinsics(left.views, models=["k1"], folds=FOLDS)
    assert np.array_equal(after.parameters, before.fold_parameters[held])


def test_parts_go_by_the_place_in_the_manifest() -> None:
    views = views_of("k1", 7)
    assert fold_of_views(views, 3).tolist() == [0, 1, 2, 0, 1, 2, 0]
    placed = [replace(view, place=2 * i + 1) for i, view in enumerate(views)]
    assert fold_of_views(placed, 3).tolist() == [1, 0, 2, 1, 0, 2, 1]
    # All in one part, and three views in two parts: too few would be left to fit.
    assert fold_of_views(placed, 2).tolist() == list(range(7))
    assert fold_of_views(views[:3], 2).tolist() == [0, 1, 2]
