# SPDX-License-Identifier: Apache-2.0
"""``RestCorrection``: a coarse mesh shows the designed face, and its own displacements."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.envs import PHYSICS, Accuracy, PressPath, parse_indenter, simulate_press
from taccel_lab.scene import Material
from taccel_lab.sensors.press_mesh import press_mesh
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.sensors.registry import sensor_family
from taccel_lab.signals.normals import normals_from_slopes
from taccel_lab.signals.rest_surface import RestCorrection, RestSurface, rest_surface


def test_the_designed_face_comes_back_at_rest() -> None:
    height = np.full((3, 4), 2e-4)
    slope = np.zeros((3, 4, 2))
    slope[..., 0] = 0.1
    designed = RestSurface(height, normals_from_slopes(slope), np.ones((3, 4), dtype=bool))
    meshed = height - 5e-5
    meshed[0, 0] = np.nan
    correction = RestCorrection.of(designed, meshed, np.zeros((3, 4, 2)))
    found = correction.samples() + np.dstack([np.zeros((3, 4, 2)), meshed])
    assert np.isnan(found[0, 0, 2])
    assert found[..., 2].ravel()[1:] == pytest.approx(2e-4)
    assert found[..., :2].reshape(-1, 2)[1:] == pytest.approx(slope.reshape(-1, 2)[1:])


def test_a_press_on_a_crowned_pad_is_right_far_from_the_contact() -> None:
    profile = catalogue_profile("gelsight_mini")
    family, grid = sensor_family("gelsight_mini"), profile.grid()
    tool, physics = parse_indenter("sphere:2"), PHYSICS[Accuracy.FAST]
    mesh = press_mesh("gelsight_mini", {}, (0.0, 0.0), tool.contact(0.1), physics.mesh)
    arguments = (mesh, Material(1e5, 0.46), tool, (0.0, 0.0), PressPath(0.1), grid)
    plain = simulate_press(*arguments, physics=physics)
    designed = rest_surface(profile.mesh, grid)
    corrected = simulate_press(*arguments, physics=physics, designed_rest=designed)
    columns, rows = np.meshgrid(np.arange(grid.width_px), np.arange(grid.height_px))
    xy = grid.gel_from_pixel(np.stack([columns, rows], axis=-1).astype(float))
    truth = family.parameters({}).pad().height_mm(xy) * 1e-3
    far = np.hypot(*xy.transpose(2, 0, 1)) > 5.0

    def rms(height: np.ndarray) -> float:
        return float(np.sqrt(np.nanmean((height - truth)[far] ** 2)))

    assert rms(plain.height_m) > 3e-5
    assert rms(corrected.height_m) < 5e-6
    assert rms(corrected.rest_height_m) < 5e-6
    moved = corrected.height_m - corrected.rest_height_m
    near = ~far & ~corrected.contact_mask & np.isfinite(moved)
    assert moved[near] == pytest.approx((plain.height_m - plain.rest_height_m)[near], abs=1e-9)
    # Where the ball touches, it gives the height.
    touched = corrected.contact_mask
    assert corrected.height_m[touched] == pytest.approx(plain.height_m[touched], abs=1e-12)
