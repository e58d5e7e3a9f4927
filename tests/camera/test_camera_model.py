# SPDX-License-Identifier: Apache-2.0
"""Projection against OpenCV, inverses, and what a lens does not image."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.camera.camera_model import (
    CameraModel,
    resized,
)
from taccel_lab.optics import Camera

# DIGIT as calibrated by CANFNet: barrel and tangential terms of a real lens.
DIGIT = Camera(
    width_px=240,
    height_px=320,
    fx_px=328.57,
    fy_px=330.0,
    cx_px=114.5,
    cy_px=157.6,
    position_mm=(0.3, -0.2, -17.62),
    distortion=(-0.0066, -0.398, 0.0029, -0.0049, 1.169),
)
FISHEYE = replace(
    DIGIT, model="fisheye", fx_px=140.0, fy_px=141.0, distortion=(-0.02, 0.01, -0.004, 0.0006)
)
rotations = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 0.1)


def unit(q: tuple[float, ...]) -> tuple[float, float, float, float]:
    x, y, z, w = (float(v) for v in np.array(q) / np.linalg.norm(q))
    return x, y, z, w


def points_before(camera: Camera, count: int = 200, spread: float = 0.35) -> np.ndarray:
    rng = np.random.default_rng(3)
    in_camera = rng.uniform([-spread, -spread, 1.0], [spread, spread, 1.0], (count, 3))
    in_camera *= rng.uniform(8, 40, (count, 1))
    return in_camera @ camera.gel_from_camera().T + np.array(camera.position_mm)


def opencv_frame(camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rotation vector, translation, camera matrix, distortion as OpenCV takes them."""
    camera_from_gel = camera.gel_from_camera().T
    # OpenCV's own conversion from a matrix is inexact near half a turn.
    axis, w = -np.array(camera.rotation[:3]), camera.rotation[3]
    sine = np.linalg.norm(axis)
    turn = 2 * math.atan2(sine, w) * axis / sine if sine > 1e-12 else np.zeros(3)
    matrix = np.array([
        [camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1.0]
    ])  # fmt: skip
    return turn, -camera_from_gel @ camera.position_mm, matrix, np.array(camera.distortion)


@given(rotation=rotations)
@pytest.mark.parametrize(
    "distortion",
    [
        (),
        (-0.3, 0.12, 0.001, -0.002),
        DIGIT.distortion,
        (0.2, -0.1, 0.001, 0.002, 0.03, 0.1, 0.02, 0.01),
    ],
)
def test_pinhole_is_opencv(distortion: tuple[float, ...], rotation: tuple[float, ...]) -> None:
    import cv2

    camera = replace(DIGIT, distortion=distortion, rotation=unit(rotation))
    points = points_before(camera)
    expected, _ = cv2.projectPoints(points, *opencv_frame(camera))
    np.testing.assert_allclose(CameraModel(camera).project(points), expected[:, 0], atol=1e-8)


@given(rotation=rotations)
def test_fisheye_is_opencv(rotation: tuple[float, ...]) -> None:
    import cv2

    camera = replace(FISHEYE, rotation=unit(rotation))
    points = points_before(camera, spread=1.5)
    turn, shift, matrix, distortion = opencv_frame(camera)
    expected, _ = cv2.fisheye.projectPoints(points[:, None], turn, shift, matrix, distortion)
    np.testing.assert_allclose(CameraModel(camera).project(points), expected[:, 0], atol=1e-8)


TURNED = replace(DIGIT, rotation=unit((0.2, -0.3, 0.1, 0.9)))


@pytest.mark.parametrize("camera", [DIGIT, FISHEYE, replace(DIGIT, distortion=()), TURNED])
def test_every_pixel_comes_back(camera: Camera) -> None:
    model = CameraModel(camera)
    uv = np.stack(np.meshgrid(np.arange(240.0), np.arange(320.0)), axis=-1)
    origin, directions = model.rays(uv)
    assert np.isfinite(directions).all()
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0, atol=1e-12)
    np.testing.assert_allclose(model.project(origin + 21.0 * directions), uv, atol=1e-7)


@given(k1=st.floats(-0.4, 0.4), k2=st.floats(-0.1, 0.1), u=st.floats(0, 239), v=st.floats(0, 319))
def test_inverse_is_exact_or_nan(k1: float, k2: float, u: float, v: float) -> None:
    model = CameraModel(replace(DIGIT, distortion=(k1, k2, 0.001, -0.001)))
    uv = np.array([u, v])
    back = model.pixels_from_directions(model.directions_from_pixels(uv))
    assert np.isnan(back).all() or np.allclose(back, uv, atol=1e-7)


def test_beyond_the_fold_of_a_lens_is_nan() -> None:
    # r (1 - 0.5 r^2) never exceeds 0.544.
    model = CameraModel(replace(DIGIT, distortion=(-0.5, 0.0, 0.0, 0.0)))
    edge = 0.544 * DIGIT.fx_px
    inside = model.directions_from_pixels(np.array([DIGIT.cx_px + 0.99 * edge, DIGIT.cy_px]))
    outside = model.directions_from_pixels(np.array([DIGIT.cx_px + 1.02 * edge, DIGIT.cy_px]))
    assert np.isfinite(inside).all()
    assert inside[0] / inside[2] < math.sqrt(2 / 3)
    assert np.isnan(outside).all()


def test_a_fisheye_sees_sideways_a_pinhole_nothing_behind() -> None:
    behind = np.array([0.3 + 5.0, -0.2, -17.62 - 1.0])
    assert np.isfinite(CameraModel(replace(FISHEYE, distortion=())).project(behind)).all()
    assert np.isnan(CameraModel(DIGIT).project(behind)).all()


def test_resized_camera_sees_the_same() -> None:
    half = resized(DIGIT, 120, 160)
    points = points_before(DIGIT)
    full, small = CameraModel(DIGIT).project(points), CameraModel(half).project(points)
    np.testing.assert_allclose((full + 0.5) / 2, small + 0.5, atol=1e-9)
