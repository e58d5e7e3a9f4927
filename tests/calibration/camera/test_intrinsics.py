# SPDX-License-Identifier: Apache-2.0
"""Boards are found in images, and lenses fitted to them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from hashlib import sha256
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import example, given
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
from taccel_lab.calibration.capture import BoardCaptures, CaptureFolder, Frame
from taccel_lab.calibration.capture.schema import BoardEntry
from taccel_lab.camera.gel_camera import CameraModel
from taccel_lab.errors import InputError
from taccel_lab.files.images import read_image
from taccel_lab.report.remark import Severity, judge
from taccel_lab.robust_fit import rms
from taccel_lab.sensors.profile import catalogue_profile
from tests.calibration.drawn import boards
from tests.calibration.drawn.faults import add_gradient, add_noise, blur, quantise, vignette
from tests.support.real_data import real_data

LENS, PARAMETERS = LENSES["k1"], np.array([260.0, 258.0, 158.0, 121.0, -0.12])
SQUARE_MM, FOLDS = 4.0, 3


def picture(pattern: boards.Pattern, pose: np.ndarray) -> np.ndarray:
    """A noisy, blurred, vignetted and unevenly lit picture, RGB uint8."""
    image = boards.render_board(LENS, PARAMETERS, pose, (320, 240), pattern, SQUARE_MM, samples=2)
    image = add_gradient(vignette(blur(image, 0.7), 0.35), 12.0, -8.0)
    return quantise(add_noise(image, 2.0, np.random.default_rng(0)))


def pose_of(columns: int, rows: int, distance_mm: float, tilt_deg=(18.0, -14.0)) -> np.ndarray:
    return boards.pose_over(
        columns, rows, SQUARE_MM, distance_mm=distance_mm, tilt_deg=tilt_deg, turn_deg=7.0
    )


CHESS = pose_of(7, 5, 42.0)
CHARUCO = pose_of(7, 5, 36.0)
DOTS = pose_of(9, 7, 48.0, (6.0, 4.0))


@cache
def chessboard() -> np.ndarray:
    return picture(boards.chess_pattern(7, 5), CHESS)


def truth(columns: int, rows: int, pose: np.ndarray) -> np.ndarray:
    points = np.column_stack(
        [boards.lattice_points(columns, rows) * SQUARE_MM, np.zeros(columns * rows)]
    )
    return LENS.project(points, PARAMETERS, pose)


def errors(view: BoardView, columns: int, rows: int, pose: np.ndarray) -> np.ndarray:
    """Distance of every point from where it is, by its index, up to turns of the board."""
    exact = truth(columns, rows, pose).reshape(rows, columns, 2)
    wanted = [turned[view.index[:, 1], view.index[:, 0]] for turned in (exact, exact[::-1, ::-1])]
    return min((np.linalg.norm(view.uv_px - uv, axis=1) for uv in wanted), key=np.mean)


def board_of(images: list[np.ndarray]) -> BoardCaptures:
    """The chessboard in some images, as a capture folder has it."""
    names = [f"v{k}.png" for k in range(len(images))]
    frames = tuple(
        Frame(name, name, sha256(image.tobytes()).hexdigest(), lambda image=image: image)
        for name, image in zip(names, images, strict=True)
    )
    entry = BoardEntry(kind="chessboard", columns=7, rows=5, images=names)
    return BoardCaptures(entry, frames, None)


def test_chessboard_is_found_to_a_tenth_of_a_pixel() -> None:
    view = detect_chessboard(chessboard(), 7, 5)
    assert len(view.index) == 35
    off = errors(view, 7, 5, CHESS)
    assert off.max() < 0.35 and np.sqrt(np.mean(off**2)) < 0.12


@pytest.mark.thorough
def test_part_of_a_chessboard_is_enough_and_too_little_is_counted() -> None:
    hidden = chessboard().copy()
    hidden[:, :118] = 90
    view = detect_chessboard(hidden, 7, 5)
    assert 18 <= len(view.index) < 35
    design = np.column_stack([view.index, np.ones(len(view.index))])
    assert np.linalg.det(np.linalg.lstsq(design, view.uv_px, rcond=None)[0][:2]) > 0
    hidden[:, :230] = 90
    with pytest.raises(InputError, match=r"found \d+ of 35 inner corners"):
        detect_chessboard(hidden, 7, 5)
    with pytest.raises(InputError, match="at least 3 x 3"):
        detect_chessboard(hidden, 2, 5)


def charuco_image(legacy: bool = False) -> np.ndarray:
    board = charuco_board(8, 6, 0.7, "DICT_4X4_50", legacy=legacy)
    drawing = board.generateImage((8 * 60, 6 * 60), marginSize=0)

    def pattern(xy: np.ndarray) -> np.ndarray:
        # Lattice point (0, 0) is the first inner corner, one square from the drawing's corner.
        u, v = np.rint(xy * 60 + 59.5).astype(int).T
        inside = (u >= 0) & (v >= 0) & (u < 8 * 60) & (v < 6 * 60)
        levels = np.where(inside, drawing[v.clip(0, 6 * 60 - 1), u.clip(0, 8 * 60 - 1)], 255)
        return boards.BLACK + (boards.WHITE - boards.BLACK) * levels / 255

    return picture(pattern, CHARUCO)


@pytest.mark.parametrize("legacy", [False, True])
def test_charuco_board_by_its_markers(legacy: bool) -> None:
    view = detect_charuco(charuco_image(legacy), 8, 6, marker_share=0.7)
    assert len(view.index) >= 33
    assert errors(view, 7, 5, CHARUCO).max() < 0.6


@pytest.mark.thorough
def test_charuco_parts_mirrors_and_strangers() -> None:
    whole = charuco_image()
    half = whole.copy()
    half[:, 170:] = 120
    view = detect_charuco(half, 8, 6, marker_share=0.7)
    assert 6 <= len(view.index) < 30
    assert errors(view, 7, 5, CHARUCO).max() < 0.6
    for image, kind, said in (
        (np.ascontiguousarray(whole[:, ::-1]), "DICT_4X4_50", "mirrored"),
        (np.full_like(half, 90), "DICT_4X4_50", "found 0 of 35 corners"),
        (half, "DICT_9X9", "unknown ArUco dictionary"),
    ):
        with pytest.raises(InputError, match=said):
            detect_charuco(image, 8, 6, marker_share=0.7, dictionary=kind)


@pytest.mark.thorough(cases=("0",))
@pytest.mark.parametrize("gone", [0, 21])
def test_dots_with_some_missing(gone: int) -> None:
    missing = boards.lattice_points(9, 7)[np.random.default_rng(5).permutation(63)[:gone]]
    view = detect_dots(picture(boards.dot_pattern(9, 7, missing=missing), DOTS), 9, 7)
    assert len(view.index) >= 0.95 * (63 - gone)
    off = errors(view, 9, 7, DOTS)
    assert np.median(off) < 0.25 and off.max() < 1.0


@pytest.mark.thorough
def test_dents_of_pins_show_against_the_untouched_gel() -> None:
    """Faint dents under uneven light; without the reference nothing could be told."""
    rng = np.random.default_rng(1)
    u, v = np.meshgrid(np.arange(320), np.arange(240))
    gel = np.stack([90 + 0.2 * u, 120 + 0.1 * v, 150 - 0.15 * u], axis=-1)
    pose = pose_of(6, 5, 40.0, (3.0, 2.0))
    dents = np.zeros((240, 320, 1))
    for at in truth(6, 5, pose):
        dents += np.exp(-((u - at[0]) ** 2 + (v - at[1]) ** 2) / (2 * 5.0**2))[..., None]
    image, reference = (
        quantise(add_noise(levels, 1.5, rng)) for levels in (gel * (1 - 0.06 * dents), gel)
    )
    view = detect_dots(image, 6, 5, reference=reference)
    assert len(view.index) == 30
    assert errors(view, 6, 5, pose).max() < 1.0
    with pytest.raises(InputError, match="give a reference image without the board"):
        detect_dots(reference, 6, 5, reference=reference)


@pytest.mark.thorough
def test_dots_that_are_not_there_or_too_many() -> None:
    noise = quantise(add_noise(np.full((240, 320, 3), 120.0), 3.0, np.random.default_rng(0)))
    dots = picture(boards.dot_pattern(9, 7), DOTS)
    for image, columns, rows, reference, said in (
        (noise, 9, 7, None, r"found \d+ of 63 dots"),
        (dots, 8, 6, None, "go on beyond 8 x 6"),
        (noise, 9, 7, noise[:100], "of one size"),
    ):
        with pytest.raises(InputError, match=said):
            detect_dots(image, columns, rows, reference=reference)


@pytest.mark.thorough
def test_views_keep_their_places_and_of_equal_images_one_counts() -> None:
    image = chessboard()
    board = board_of([image, np.full_like(image, 90), image, np.rot90(image, 2).copy()])
    found = detect_views([board])
    assert [view.place for view in found.views] == [0, 3]
    assert found.refused[1] == "v2.png: the same image as v0.png" and len(found.refused) == 2
    folder = CaptureFolder(
        "memory", Path(), "flat_pad", None, None, (), None, None, None, (), boards=(board,)
    )
    with pytest.raises(InputError, match=r"(?s)2 views of the board are left.*the same image as"):
        calibrate_camera(folder, catalogue_profile("flat_pad"))
    with pytest.raises(InputError, match="of one size"):
        detect_views([board_of([image, cv2.resize(image, (640, 480))])])


@pytest.mark.parametrize("name", list(LENSES))
def test_projection_is_that_of_the_renderer(name: str) -> None:
    """The profile's camera model and the fitted one put points at the same pixels."""
    points = np.random.default_rng(0).uniform(-1, 1, (20, 3)) * (12, 9, 3) + (0, 0, 30)
    camera = CameraModel(LENSES[name].camera(boards.TRUTHS[name], boards.SIZE))
    fitted = LENSES[name].project(points, boards.TRUTHS[name], np.zeros(6))
    np.testing.assert_allclose(camera.pixels_from_directions(points), fitted, atol=1e-8)


@pytest.mark.thorough(cases=("rational",))
@pytest.mark.parametrize("name", list(LENSES))
def test_exact_points_give_the_lens_back(name: str) -> None:
    found = calibrate_intrinsics(boards.views_of(name, 7), models=[name], folds=2)
    # k4..k6 of the rational lens trade against k1..k3; its pictures are what counts.
    if name == "rational":
        assert found.chosen.fit.rms_px < 1e-5
        np.testing.assert_allclose(found.parameters[:4], boards.TRUTHS[name][:4], rtol=1e-4)
    else:
        np.testing.assert_allclose(found.parameters, boards.TRUTHS[name], rtol=1e-5, atol=1e-6)
    assert found.chosen.heldout_px < 1e-4


@pytest.mark.thorough
def test_noise_stays_within_the_predicted_uncertainty() -> None:
    """Standardised errors over many calibrations have the spread of a normal distribution."""
    lens, true = LENSES["pinhole"], boards.TRUTHS["pinhole"]
    fits = [fit_bundle(boards.views_of("pinhole", 9, 0.3, seed), lens, true) for seed in range(10)]
    scores = np.array([(fit.parameters - true) / fit.sigma for fit in fits])
    assert 0.6 < np.sqrt(np.mean(scores**2)) < 1.3
    assert np.mean(np.abs(scores) < 1.96) > 0.87


@pytest.mark.thorough
@pytest.mark.parametrize("true", ["k1", pytest.param("fisheye", marks=pytest.mark.slow)])
def test_the_simplest_lens_that_predicts_is_chosen(true: str) -> None:
    views = boards.views_of(true, 12, 0.15, seed=4)
    found = calibrate_intrinsics(views, models=["k1", "fisheye", "pinhole"], folds=3)
    assert found.lens.name == true
    assert found.chosen.heldout_px == pytest.approx(0.15 * np.sqrt(2), rel=0.2)
    assert (np.abs(found.parameters - boards.TRUTHS[true]) < 5 * found.chosen.fit.sigma).all()


def test_single_wrong_corners_have_little_effect() -> None:
    views = boards.views_of("k1", 8, 0.1, seed=3)
    for view in views[::3]:
        view.uv_px[7] += (25.0, -18.0)
    found = calibrate_intrinsics(views, models=["k1"], folds=2)
    assert len(found.outliers) <= 4
    assert np.abs(found.parameters[:4] - boards.TRUTHS["k1"][:4]).max() < 1.5


@pytest.mark.thorough(cases=("not tilted", "of another board"))
@pytest.mark.parametrize(
    ("turn_deg", "tilt_deg", "off_px"),
    [(20.0, (1, 0.5), 0.05), (0.0, (25, 10), 0.05), (60.0, None, 8.0)],
    ids=["not tilted", "from one side", "of another board"],
)
def test_views_that_tell_no_lens_are_called_weak(turn_deg, tilt_deg, off_px: float) -> None:
    """Of another board as when a chessboard is searched for dots: points are regular there, too."""
    rng, views = np.random.default_rng(3), boards.views_of("pinhole", 6)
    for k, view in enumerate(views):
        if tilt_deg is not None:
            pose = boards.pose_over(
                *boards.BOARD, distance_mm=30 + k, tilt_deg=tilt_deg, turn_deg=k * turn_deg
            )
            view = boards.view_of("pinhole", pose)
        views[k] = replace(view, uv_px=view.uv_px + rng.normal(0, off_px, (48, 2)))
    found = calibrate_intrinsics(views, models=["pinhole"], folds=2)
    codes = {remark.code: remark.severity for remark in found.remarks}
    assert codes["views_alike" if tilt_deg else "heldout_error"] is Severity.ERROR
    assert judge(found.remarks) == "weak" and ("too_few" in codes or tilt_deg is None)


@pytest.mark.parametrize(
    ("count", "how", "said"),
    [
        (2, {}, "at least 3"),
        (4, {"models": ["wide"]}, "unknown lens model 'wide'"),
        (4, {"folds": 1}, "folds"),
    ],
)
def test_too_few_views_and_unknown_lenses_are_refused(count: int, how: dict, said: str) -> None:
    with pytest.raises(InputError, match=said):
        calibrate_intrinsics(boards.views_of("k1", count), **how)


@example(tilt=(0.0, 0.0), turn=3.25, distance=25.0)  # Parallel: IPPE divides by zero.
@given(
    tilt=st.tuples(st.floats(-50, 50), st.floats(-50, 50)),
    turn=st.floats(-180, 180),
    distance=st.floats(25, 80),
)
def test_the_pose_of_a_board_is_found_from_any_side(tilt, turn: float, distance: float) -> None:
    pose = boards.pose_over(*boards.BOARD, distance_mm=distance, tilt_deg=tilt, turn_deg=turn)
    view, lens, true = boards.view_of("fisheye", pose), LENSES["fisheye"], boards.TRUTHS["fisheye"]
    found = initial_pose(view, lens, true)
    assert np.abs(lens.project(view.board_mm(), true, found) - view.uv_px).max() < 1e-5
    np.testing.assert_allclose(cv2.Rodrigues(found[:3])[0], cv2.Rodrigues(pose[:3])[0], atol=1e-5)
    np.testing.assert_allclose(found[3:], pose[3:], atol=1e-4)


@pytest.mark.thorough
def test_real_fisheye_camera_is_predicted_to_half_a_pixel() -> None:
    """Every second board of a home-made sensor; plain OpenCV leaves 0.68 px held out."""
    paths = sorted(real_data("gelsight_osaka_photon26/fisheye/cam2").glob("*.jpg"))[::2]
    views = [detect_chessboard(read_image(path), 6, 6, name=path.name) for path in paths]
    found = calibrate_intrinsics(views, models=["fisheye"], folds=3)
    assert found.lens.name == "fisheye" and not found.outliers
    assert found.chosen.heldout_px < 0.50


@pytest.mark.thorough
def test_views_that_no_fit_takes_count_in_the_headline() -> None:
    views = boards.views_of("k1", 9, 0.1, seed=2)
    clean = calibrate_intrinsics(views, models=["k1"], folds=FOLDS)
    moved = np.random.default_rng(1).normal(0, 6.0, views[5].uv_px.shape)
    views[5] = replace(views[5], uv_px=views[5].uv_px + moved)
    found = calibrate_intrinsics(views, models=["k1"], folds=FOLDS)
    assert len(found.outliers) == 1 and "view5" in found.outliers[0]
    usual = 0.1 * np.sqrt(2)
    assert clean.chosen.heldout_px == pytest.approx(usual, rel=0.15)
    # One view of nine; its pose takes up a little.
    assert found.chosen.heldout_px == pytest.approx(rms(moved) / 3, rel=0.1)
    assert found.chosen.heldout_robust_px == pytest.approx(usual, rel=0.25)
    # It does not bend the lens, nor call it a lens of another board.
    assert np.abs(found.parameters[:4] - boards.TRUTHS["k1"][:4]).max() < 2.0
    assert "heldout_error" not in {remark.code for remark in found.remarks}


@pytest.mark.thorough
def test_spoilt_held_out_views_leave_the_fit_bit_for_bit_as_it_is() -> None:
    views = boards.views_of("k1", 9, 0.2, seed=4)
    clean = calibrate_intrinsics(views, models=["k1"], folds=FOLDS).chosen
    rng = np.random.default_rng(0)
    for i in range(1, 9, FOLDS):
        views[i] = replace(views[i], uv_px=views[i].uv_px + rng.normal(0, 40, (48, 2)))
    found = calibrate_intrinsics(views, models=["k1"], folds=FOLDS).chosen
    assert np.array_equal(found.fold_parameters[1], clean.fold_parameters[1])
    assert not np.array_equal(found.fold_parameters[0], clean.fold_parameters[0])
    assert found.heldout_px > 20


def test_parts_go_by_the_place_in_the_manifest() -> None:
    """What is held out is decided by the manifest, not by what is found in its images."""
    views = boards.views_of("k1", 7)
    assert fold_of_views(views, 3).tolist() == [0, 1, 2, 0, 1, 2, 0]
    placed = [replace(view, place=2 * i + 1) for i, view in enumerate(views)]
    assert fold_of_views(placed, 3).tolist() == [1, 0, 2, 1, 0, 2, 1]
    # All in one part, and three views in two parts: too few would be left to fit.
    assert fold_of_views(placed, 2).tolist() == list(range(7))
    assert fold_of_views(views[:3], 2).tolist() == [0, 1, 2]
