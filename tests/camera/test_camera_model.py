# SPDX-License-Identifier: Apache-2.0
"""Pinhole cameras with distortion, and rays that a window refracts."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.optimize import brentq

from taccel_lab.cad.mesh.gel_mesh import gel_mesh
from taccel_lab.cad.parts.dome_pad import ShellDomePad
from taccel_lab.camera.gel_camera import CameraModel, resized
from taccel_lab.camera.refraction import (
    DomeMedia,
    FlatMedia,
    glued_back_mm,
    refract,
    snell_invariant,
)
from taccel_lab.errors import InputError
from taccel_lab.geometry import quadratic_mesh
from taccel_lab.profile.optical_design import DesignedCamera

# DIGIT as calibrated by CANFNet: barrel and tangential terms of a real lens.
DIGIT = DesignedCamera(
    240, 320, 328.57, 330.0, 114.5, 157.6, (0.3, -0.2, -17.62),
    distortion=(-0.0066, -0.398, 0.0029, -0.0049, 1.169),
)  # fmt: skip
FISHEYE = replace(
    DIGIT, model="fisheye", fx_px=140.0, fy_px=141.0, distortion=(-0.02, 0.01, -0.004, 0.0006)
)


def unit(q: tuple[float, ...]) -> tuple[float, ...]:
    return tuple((np.array(q) / np.linalg.norm(q)).tolist())


rotations = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 0.1).map(unit)


def points_before(camera: DesignedCamera, spread: float = 0.35) -> np.ndarray:
    rng = np.random.default_rng(3)
    in_camera = rng.uniform([-spread, -spread, 1.0], [spread, spread, 1.0], (200, 3))
    in_camera *= rng.uniform(8, 40, (200, 1))
    return in_camera @ camera.gel_from_camera().T + np.array(camera.position_mm)


def opencv_frame(camera: DesignedCamera) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rotation vector, translation, camera matrix, distortion as OpenCV takes them."""
    camera_from_gel = camera.gel_from_camera().T
    # OpenCV's own conversion from a matrix is inexact near half a turn.
    axis, w = -np.array(camera.rotation[:3]), camera.rotation[3]
    sine = np.linalg.norm(axis)
    turn = 2 * math.atan2(sine, w) * axis / sine if sine > 1e-12 else np.zeros(3)
    matrix = np.diag([camera.fx_px, camera.fy_px, 1.0])
    matrix[:2, 2] = camera.cx_px, camera.cy_px
    return turn, -camera_from_gel @ camera.position_mm, matrix, np.array(camera.distortion)


LONG_LENS = (0.2, -0.1, 0.001, 0.002, 0.03, 0.1, 0.02, 0.01)


@given(rotation=rotations)
@pytest.mark.parametrize(
    "distortion", [(), (-0.3, 0.12, 0.001, -0.002), DIGIT.distortion, LONG_LENS]
)
def test_pinhole_is_opencv(distortion, rotation):
    camera = replace(DIGIT, distortion=distortion, rotation=rotation)
    points = points_before(camera)
    expected, _ = cv2.projectPoints(points, *opencv_frame(camera))
    np.testing.assert_allclose(CameraModel(camera).project(points), expected[:, 0], atol=1e-8)


@given(rotation=rotations)
def test_fisheye_is_opencv(rotation):
    camera = replace(FISHEYE, rotation=rotation)
    points = points_before(camera, spread=1.5)
    expected, _ = cv2.fisheye.projectPoints(points[:, None], *opencv_frame(camera))
    np.testing.assert_allclose(CameraModel(camera).project(points), expected[:, 0], atol=1e-8)


TURNED = replace(DIGIT, rotation=unit((0.2, -0.3, 0.1, 0.9)))


@pytest.mark.parametrize("camera", [DIGIT, FISHEYE, replace(DIGIT, distortion=()), TURNED])
def test_every_pixel_comes_back(camera):
    model = CameraModel(camera)
    uv = np.stack(np.meshgrid(np.arange(240.0), np.arange(320.0)), axis=-1)
    origin, directions = model.rays(uv)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0, atol=1e-12)
    np.testing.assert_allclose(model.project(origin + 21.0 * directions), uv, atol=1e-7)


@given(k1=st.floats(-0.4, 0.4), k2=st.floats(-0.1, 0.1), u=st.floats(0, 239), v=st.floats(0, 319))
def test_inverse_is_exact_or_nan(k1, k2, u, v):
    model = CameraModel(replace(DIGIT, distortion=(k1, k2, 0.001, -0.001)))
    back = model.pixels_from_directions(model.directions_from_pixels(np.array([u, v])))
    assert np.isnan(back).all() or np.allclose(back, [u, v], atol=1e-7)


def test_beyond_the_fold_of_a_lens_is_nan():
    # r (1 - 0.5 r^2) never exceeds 0.544.
    model = CameraModel(replace(DIGIT, distortion=(-0.5, 0.0, 0.0, 0.0)))
    inside, outside = (
        model.directions_from_pixels(
            np.array([DIGIT.cx_px + part * 0.544 * DIGIT.fx_px, DIGIT.cy_px])
        )
        for part in (0.99, 1.02)
    )
    assert inside[0] / inside[2] < math.sqrt(2 / 3) and np.isnan(outside).all()


def test_a_fisheye_sees_sideways_a_pinhole_nothing_behind():
    behind = np.array([0.3 + 5.0, -0.2, -17.62 - 1.0])
    assert np.isfinite(CameraModel(replace(FISHEYE, distortion=())).project(behind)).all()
    assert np.isnan(CameraModel(DIGIT).project(behind)).all()


def test_resized_camera_sees_the_same():
    points = points_before(DIGIT)
    full, half = (CameraModel(c).project(points) for c in (DIGIT, resized(DIGIT, 120, 160)))
    np.testing.assert_allclose((full + 0.5) / 2, half + 0.5, atol=1e-9)


def snell_angle(angle: float, n_from: float, n_to: float) -> float:
    return math.asin(n_from * math.sin(angle) / n_to)


def shoot_flat(angle: float, heights: list[float], indices: list[float]) -> float:
    """Horizontal reach of a ray that leaves at an angle to the z axis, through layers of heights
    and indices."""
    reach = 0.0
    for height, n, n_next in zip(heights, indices, [*indices[1:], indices[-1]], strict=True):
        reach += height * math.tan(angle)
        angle = snell_angle(angle, n, n_next)
    return reach


def march_spheres(
    start: np.ndarray, direction: np.ndarray, radii: list[float], indices: list[float]
) -> tuple[np.ndarray, np.ndarray]:
    """Exit point and direction, about the spheres' centre, by angles in the plane of the ray and
    the centre, not by vectors."""
    e1 = direction
    e2 = start - (start @ e1) * e1
    e2 = e2 / np.linalg.norm(e2)
    x, y, heading = start @ e1, start @ e2, 0.0
    for radius, n_from, n_to in zip(radii, indices[:-1], indices[1:], strict=True):
        c, s = math.cos(heading), math.sin(heading)
        ahead = x * c + y * s
        on = math.sqrt(ahead**2 - x**2 - y**2 + radius**2) - ahead
        x, y = x + on * c, y + on * s
        radial = math.atan2(y, x)
        heading = radial + snell_angle(heading - radial, n_from, n_to)
    return x * e1 + y * e2, math.cos(heading) * e1 + math.sin(heading) * e2


# Newton's steps end at rounding.
@example(across=3.0, azimuth=0.5, air=0.5, window=0.5, gel=0.5, n_window=1.5, n_gel=1.4)
@given(
    across=st.floats(0.01, 15), azimuth=st.floats(-math.pi, math.pi), air=st.floats(0.5, 20),
    window=st.floats(0.3, 8), gel=st.floats(0.3, 8), n_window=st.floats(1.3, 1.8),
    n_gel=st.floats(1.3, 1.6),
)  # fmt: skip
def test_flat_media_agree_with_brute_force(across, azimuth, air, window, gel, n_window, n_gel):
    heights, indices = [air, window, gel], [1.0, n_window, n_gel]
    media = FlatMedia((-(window + gel), -gel), tuple(indices))
    camera = np.array([0.4, -0.7, -sum(heights)])
    way = [across * math.cos(azimuth), across * math.sin(azimuth), sum(heights)]
    direction = media.sight(camera, camera + way)
    # Where the ray of the formula meets the point's height, by the reference tracer.
    found = math.acos(direction[2])
    assert shoot_flat(found, heights, indices) == pytest.approx(across, abs=1e-6)
    angle = brentq(lambda angle: shoot_flat(angle, heights, indices) - across, 0.0, 1.57)
    assert found == pytest.approx(angle, abs=1e-7)
    assert math.atan2(direction[1], direction[0]) == pytest.approx(azimuth, abs=1e-9)
    # And forwards: the traced ray passes through the point.
    entry, bent, passed = media.trace(camera, direction)
    hit = entry - bent * (entry[2] / bent[2])
    np.testing.assert_allclose(hit, camera + way, atol=1e-6)
    assert 0 < passed <= 1


@given(
    polar=st.floats(0.02, 1.3), azimuth=st.floats(-3, 3), offset=st.floats(-3, 3),
    shell=st.floats(0.5, 5), n_window=st.floats(1.3, 1.7), n_gel=st.floats(1.3, 1.6),
)  # fmt: skip
def test_domes_agree_with_brute_force(polar, azimuth, offset, shell, n_window, n_gel):
    radii, indices = [13.5 - shell, 13.5], [1.0, n_window, n_gel]
    centre, start = np.array([0.0, 0.0, -15.0]), np.array([0.3, 0.2, offset])
    media, camera = DomeMedia(tuple(centre), tuple(radii), tuple(indices)), centre + start
    side = math.sin(polar) * np.array([math.cos(azimuth), math.sin(azimuth)])
    direction = np.array([*side, math.cos(polar)])
    entry, bent, _ = media.trace(camera, direction)
    end, heading = march_spheres(start, direction, radii, indices)
    np.testing.assert_allclose(entry, centre + end, atol=1e-6)
    np.testing.assert_allclose(bent, heading, atol=1e-6)
    # Back from a point on that ray: it is seen in the direction that the ray started with.
    np.testing.assert_allclose(media.sight(camera, entry + 1.5 * bent), direction, atol=1e-7)


@pytest.mark.parametrize("media", [FlatMedia((-8.0, -5.0), (1.4,) * 3), FlatMedia((), (1.4,))])
def test_one_index_is_a_straight_line(media):
    points = np.random.default_rng(0).uniform([-9, -9, -1], [9, 9, 0], (50, 3))
    camera = np.array([1.0, 2.0, -20.0])
    straight = points - camera
    straight /= np.linalg.norm(straight, axis=1, keepdims=True)
    np.testing.assert_allclose(media.sight(camera, points), straight, atol=1e-12)
    entry, bent, passed = media.trace(camera, straight)
    np.testing.assert_allclose(bent, straight, atol=1e-12)
    np.testing.assert_allclose(passed, 1.0)
    assert entry.shape == points.shape


def test_total_reflection_ends_a_ray():
    for past, gets_through in ((-0.01, True), (0.01, False)):
        angle = math.asin(1 / 1.5) + past
        ray = np.array([math.sin(angle), 0.0, math.cos(angle)])
        _, bent, passed = FlatMedia((0.0,), (1.5, 1.0)).trace(np.array([0.0, 0.0, -1.0]), ray)
        assert np.isfinite(bent).all() == gets_through == (passed > 0)


def test_fresnel_at_normal_and_brewster_incidence():
    up, brewster = np.array([0.0, 0.0, 1.0]), math.atan(1.5)
    # Only one polarisation reflects at Brewster's angle.
    across = ((1 - 1.5**2) / (1 + 1.5**2)) ** 2
    for angle, lost in ((0.0, (0.5 / 2.5) ** 2), (brewster, 0.5 * across)):
        ray = np.array([math.sin(angle), 0.0, math.cos(angle)])
        assert refract(ray, up, 1.0, 1.5)[1] == pytest.approx(1 - lost)


@pytest.mark.parametrize(
    ("call", "given", "words"),
    [
        (FlatMedia, ((0.0, 1.0), (1.0, 1.5)), "2 interfaces separate 3 media, got 2"),
        (FlatMedia, ((1.0, 0.0), (1.0, 1.5, 1.4)), "ascend"),
        (DomeMedia, ((0, 0, 0), (2.0, 1.0), (1.0, 1.5, 1.4)), "radii"),
        (DomeMedia, ((0, 0, 0), (2.0,), (1.0,)), "1 interfaces"),
        (snell_invariant, (np.array([1.0]), [np.array([0.0])], [1.0]), "below the gel points"),
    ],
)
def test_media_that_do_not_fit(call, given, words):
    with pytest.raises(InputError, match=words):
        call(*given)


def test_back_of_a_curved_gel_is_read_at_the_corners_of_ten_node_tets():
    mesh = quadratic_mesh(gel_mesh(ShellDomePad(dome_radius_mm=15.0, thickness_mm=1.5), 3.0))
    radius = np.linalg.norm(glued_back_mm(mesh) + [0, 0, 15.0], axis=1)
    np.testing.assert_allclose(radius, 13.5, atol=1e-6)
