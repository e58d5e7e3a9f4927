# SPDX-License-Identifier: Apache-2.0
"""Boards drawn through a known camera, with faults, are found where they are; bad ones refused."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.camera.charuco import charuco_board, detect_charuco
from taccel_lab.calibration.camera.chessboard import detect_chessboard
from taccel_lab.calibration.camera.dot_board import detect_dots, detect_pins
from taccel_lab.calibration.camera.find_boards import detect_views
from taccel_lab.calibration.camera.fit import calibrate_camera
from taccel_lab.calibration.camera.lens import LENSES
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.errors import InputError
from taccel_lab.sensors.profile import catalogue_profile
from tests.calibration.camera.views import board_of
from tests.calibration.drawn.boards import (
    chess_pattern,
    dot_pattern,
    image_pattern,
    lattice_points,
    pose_over,
    render_board,
)
from tests.calibration.drawn.faults import add_gradient, add_noise, blur, quantise, vignette

SIZE = (320, 240)
LENS = LENSES["k1"]
PARAMETERS = np.array([260.0, 258.0, 158.0, 121.0, -0.12])
PITCH = 4.0


def picture(pattern, pose: np.ndarray, seed: int = 0) -> np.ndarray:
    """A noisy, blurred, vignetted and unevenly lit picture, RGB uint8."""
    image = render_board(LENS, PARAMETERS, pose, SIZE, pattern, PITCH, samples=2)
    image = vignette(blur(image, 0.7), 0.35)
    image = add_gradient(image, 12.0, -8.0)
    return quantise(add_noise(image, 2.0, np.random.default_rng(seed)))


def pose_of(columns: int, rows: int, **changes: object) -> np.ndarray:
    settings = {"distance_mm": 42.0, "tilt_deg": (18.0, -14.0), "turn_deg": 7.0}
    return pose_over(columns, rows, PITCH, **(settings | changes))  # type: ignore[arg-type]


def truth(columns: int, rows: int, pose: np.ndarray) -> np.ndarray:
    points = np.column_stack([lattice_points(columns, rows) * PITCH, np.zeros(columns * rows)])
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


def test_mirrored_view_among_others_is_refused() -> None:
    """Squares are 8 x 6: a mirror swaps their colours, a half turn does not."""
    views = [
        picture(chess_pattern(7, 5), pose_of(7, 5, turn_deg=turn), seed)
        for seed, turn in enumerate((0.0, 12.0, 185.0, 30.0))
    ]
    views[2] = np.ascontiguousarray(views[2][:, ::-1])
    found = detect_views([board_of(views, 7, 5)])
    assert len(found.views) == 3
    assert any("mirrored" in reason and "v2" in reason for reason in found.refused)


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


def test_pressed_pins_show_against_the_untouched_gel() -> None:
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
    view = detect_pins(image, 6, 5, reference=reference)
    assert len(view.index) == 30
    assert errors(view, 6, 5, pose).max() < 1.0
    with pytest.raises(InputError, match="against an image of the untouched gel"):
        detect_pins(image, 6, 5, reference=None)
    with pytest.raises(InputError, match=r"nothing is pressed|found"):
        detect_pins(reference, 6, 5, reference=reference)


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
