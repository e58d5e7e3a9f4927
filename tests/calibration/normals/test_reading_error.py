# SPDX-License-Identifier: Apache-2.0
"""Radii and bands are those of the reading: of presses that were not seen, without label errors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import torch

from taccel_lab.calibration.capture import ContactCircle
from taccel_lab.calibration.normals.reading_error import KnownPress, with_reading_errors
from taccel_lab.calibration.normals.samples import (
    InverseFrame,
    Scene,
    circle_angle_rad,
    true_normals,
)
from taccel_lab.calibration.normals.skirt import ball_surface, height_sigma_m
from taccel_lab.calibration.surfaces.bonded_layer import BondedLayer
from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.normal_model import NormalModel, NormalModelConfig, expected_shapes
from taccel_lab.signals.normals import normals_from_slopes, slopes_from_height
from taccel_lab.signals.rest_surface import flat_rest

GRID = PixelGrid(60, 56, 0.1, 0.1)
BALL_MM, PAD = 3.0, BondedLayer(4.0, 0.46)
SLOPE_PER_LEVEL = 0.02
"""Of the sensor drawn here: red tells the slope along x, green that along y."""
SCENE = Scene(np.full((56, 60, 3), 120.0, dtype=np.float32), GRID, BALL_MM)


@pytest.fixture(autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)


def reader(members: int = 2, wrong: float = 0.0) -> NormalModel:
    """Linear networks that read tilts of small slopes; the first is off by the share ``wrong``."""
    config = NormalModelConfig(
        60, 56, scales_px=(0.0,), slope_scales_px=(), members=members, hidden=()
    )
    weights = {k: np.zeros(s, dtype=np.float32) for k, s in expected_shapes(config).items()}
    for axis in range(2):
        weights["layer0.weight"][:, axis, axis] = -SLOPE_PER_LEVEL * 32.0
        weights["layer0.weight"][0, axis, axis] *= 1 + wrong
    weights["layer0.bias"][:, 2] = np.log(np.radians(0.5))
    return NormalModel(config, weights)


def drawn(rise_m: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Image of a surface with noise, and its normals as the linear networks read slopes."""
    slope = slopes_from_height(rise_m, GRID)
    image = SCENE.background.copy()
    image[..., :2] += slope / SLOPE_PER_LEVEL
    tilt = np.linalg.norm(slope, axis=-1, keepdims=True)
    normals = normals_from_slopes(slope * np.tan(tilt) / np.maximum(tilt, 1e-9))
    return image + rng.normal(0, 0.4, image.shape).astype(np.float32), normals


def presses(label_px: float, stated_px: float, count: int = 8) -> Iterator[KnownPress]:
    """Balls whose labels are off by ``label_px`` to all sides and stated to be by ``stated_px``."""
    rng = np.random.default_rng(1)
    for k in range(count):
        u_px, v_px, radius_px = rng.uniform((26, 24, 7), (34, 32, 9)).tolist()
        true = ContactCircle(u_px, v_px, radius_px)
        off = label_px * (-1.0) ** (k // np.array([1, 2, 4]))
        label = ContactCircle(true.u_px + off[0], true.v_px + off[1], true.radius_px + off[2])
        rest = flat_rest(GRID)
        image, _ = drawn(1e-3 * ball_surface(true, BALL_MM, GRID, PAD, rest).displacement_mm(), rng)
        known = ball_surface(label, BALL_MM, GRID, PAD, rest)
        frame = InverseFrame("p", image, label, "", known, (stated_px, stated_px))
        normals = true_normals(frame, SCENE)
        yield KnownPress(
            image,
            normals,
            1e-3 * known.displacement_mm(),
            label.distance_px(GRID) <= 0.9 * label.radius_px,
            normals_sigma_deg=np.degrees(circle_angle_rad(frame, SCENE, normals)),
            rise_sigma_m=height_sigma_m(known, label, frame.circle_sigma_px, BALL_MM, GRID),
        )


def calibrated(label_px: float, stated_px: float) -> NormalModelConfig:
    """Practice is read without error of labels, balls with."""
    practice = [
        replace(press, normals_sigma_deg=None, rise_sigma_m=None) for press in presses(0.0, 0.0)
    ]
    model, score = with_reading_errors(reader(), practice, presses(label_px, stated_px), SCENE)
    assert score is not None and score.count == 8
    return model.config


def test_errors_of_labels_that_are_stated_widen_no_band() -> None:
    exact, stated, denied = calibrated(0.0, 0.0), calibrated(0.4, 0.4), calibrated(0.4, 0.0)
    assert denied.radius95_sigmas > 1.4 * exact.radius95_sigmas
    assert stated.radius95_sigmas < 1.15 * exact.radius95_sigmas
    assert stated.height_factor < 0.5 * denied.height_factor


def test_the_network_that_reads_a_left_out_press_does_not_tell_itself_that_it_errs() -> None:
    """On a new press nothing does: a member's distance from the others is known only where these
    saw the press."""
    rng = np.random.default_rng(2)
    surface = ball_surface(ContactCircle(30, 28, 9), BALL_MM, GRID, PAD, flat_rest(GRID))
    image, _ = drawn(1e-3 * surface.displacement_mm(), rng)
    model = reader(members=4, wrong=0.5)
    alone = model.predict(image, SCENE.background, left_out=0)
    together = model.predict(image, SCENE.background)
    agreeing = reader(members=1, wrong=0.5).predict(image, SCENE.background)
    np.testing.assert_allclose(alone.tilt_rad, agreeing.tilt_rad, atol=1e-6)
    np.testing.assert_allclose(alone.sigma_deg, agreeing.sigma_deg, rtol=1e-4)
    assert together.sigma_deg.max() > 3 * alone.sigma_deg.max()


@pytest.mark.parametrize("axis", ["u_px", "v_px", "radius_px"])
def test_a_stated_pixel_of_the_circle_moves_heights_as_it_does(axis: str) -> None:
    rest, circle = flat_rest(GRID), ContactCircle(30.0, 28.0, 18.0)
    moved = replace(circle, **{axis: getattr(circle, axis) + 1.0})
    here, there = (ball_surface(c, BALL_MM, GRID, PAD, rest) for c in (circle, moved))
    sigma = (0.0, 1.0) if axis == "radius_px" else (1.0, 0.0)
    stated2, otherwise2 = (
        (1e3 * height_sigma_m(here, circle, known_to, BALL_MM, GRID)) ** 2
        for known_to in (sigma, (0.0, 0.0))
    )
    found = np.abs(here.displacement_mm() - there.displacement_mm())
    inside = circle.distance_px(GRID) < 15.0
    expected = 1.0 if axis == "radius_px" else np.sqrt(0.5)  # a slope's part along one axis
    ratio = np.sqrt(np.mean(found[inside] ** 2) / np.mean((stated2 - otherwise2)[inside]))
    assert ratio == pytest.approx(expected, rel=0.15)
