# SPDX-License-Identifier: Apache-2.0
"""A ball pressed into a profile's gel by finite elements: the referee of closed forms."""

from __future__ import annotations

import dataclasses

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.presses import (
    PHYSICS,
    Accuracy,
    Indenter,
    PressEnv,
    PressMeshOptions,
    PressSetup,
    profile_material,
)
from taccel_lab.presses.mesh import pad_press_mesh
from taccel_lab.presses.outcome import SeenFrom, contact_radii_m, press_surface
from taccel_lab.profile import SensorProfile
from taccel_lab.scene import Ball
from taccel_lab.sensors.registry import profile_parameters
from taccel_lab.signals.rest_surface import rest_surface

SURFACE_PHYSICS = dataclasses.replace(
    PHYSICS[Accuracy.DEFAULT],
    mesh=PressMeshOptions(elements_per_radius=5.0, core=6, rings=10, layers=3),
)
"""As by default, with nodes a tenth of the contact's radius apart: forces need fewer, slopes beside
a contact do not."""


def simulated_press(
    profile: SensorProfile,
    grid: PixelGrid,
    at_mm: tuple[float, float],
    ball_mm: float,
    depth_mm: float,
    contact_mm: float,
) -> tuple[float, np.ndarray]:
    """Radius of the contact [mm] and rise of the face [mm], shape [height_px, width_px], of a ball
    that goes ``depth_mm`` into the gel without friction; the mesh is fine over ``contact_mm``."""
    physics = SURFACE_PHYSICS
    mesh = pad_press_mesh(profile_parameters(profile).pad(), at_mm, contact_mm, physics.mesh)
    ball = Indenter(f"sphere:{ball_mm:g}", Ball(1e-3 * ball_mm))
    material = profile_material(profile.material, mesh)
    setup = PressSetup(mesh, material, ball, physics=physics)
    env = PressEnv(setup, np.array([at_mm]))
    env.move_to(np.array([depth_mm]))
    window, pose = PixelGrid(121, 121, ball_mm * 1.4 / 60, ball_mm * 1.4 / 60), np.zeros((1, 7))
    pose[0, :2], pose[0, 6] = 1e-3 * np.array(at_mm), 1.0
    radius_mm = 1e3 * float(contact_radii_m(env, ball, window, pose, points=2)[0])
    seen = press_surface(env, ball, SeenFrom(grid, rest_surface(profile.mesh, grid)))
    return radius_mm, 1e3 * (seen.height_m - seen.rest_height_m)
