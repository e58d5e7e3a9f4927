# SPDX-License-Identifier: Apache-2.0
"""Fine surfaces of coarse gels: what touches is the object's surface, textured or not."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache, partial

import cv2
import numpy as np
import pytest
import warp as wp

import taccel_lab as tl
from taccel_lab.geometry.block import block_mesh
from taccel_lab.signals.object_heights import ObjectHeights
from taccel_lab.signals.texture import Texture
from tests.signals.pressed_surface import pixel_xy
from tests.support.blocks import pose

GRID = tl.PixelGrid(64, 56, 0.06, 0.06)
X, Y = pixel_xy(GRID)
WAVES = Texture(
    0.5 + 0.5 * np.cos(2 * np.pi * np.arange(32) / 16)[None].repeat(8, axis=0), 4e-6, 1.2e-3
)
"""Ridges along y, 0.6 mm apart."""


@lru_cache
def pressed(textured: bool) -> tl.PressEnv:
    """A ball of 4 mm, 0.3 mm deep in three places of elements of 0.75 mm; the last
    is not touched."""
    env = tl.PressEnv(
        tl.PressSetup(
            block_mesh((12, 12, 3), (9e-3, 9e-3, 4e-3)),
            tl.Material(1e5, 0.45),
            tl.parse_indenter("sphere:4", WAVES if textured else None),
        ),
        np.array([[0.0, 0.0], [0.3, 0.2], [0.0, 0.0]]),
    )
    env.move_to(np.array([0.3, 0.3, -0.5]))
    return env


def shown(env: tl.PressEnv, texture: Texture | None = None, **options: int) -> tl.SignalTactile:
    fine = tl.FineSurface(env.solver, "sphere:4", GRID, texture=texture, **options)
    signal = tl.SignalTactile.from_solver(env.solver, GRID, fine=fine)
    signal.update(env.state)
    return signal


def ball_of(env: tl.PressEnv, i: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Its centre, heights where it would be without the gap that the barrier keeps, and distances
    from its axis."""
    center = env.poses[i, 0, :3] - [0, 0, env.setback_m[i]]
    away = np.hypot(X - center[0], Y - center[1])
    return center, center[2] - np.sqrt(16e-6 - away**2), away


@pytest.mark.thorough
def test_a_smooth_ball_is_a_ball_where_it_touches():
    env, names = pressed(False), ("height_m", "contact", "pressure_pa", "normals")
    height, contact, pressure, normals = (array.numpy() for array in shown(env).read(*names))
    for i in range(2):
        center, ball, away = ball_of(env, i)
        inside = contact[i] & (away < 0.9e-3)
        assert inside.sum() > 500
        np.testing.assert_allclose(height[i][inside], ball[inside], atol=1e-6)
        lean = (center[0] - X[inside]) / 4e-3
        np.testing.assert_allclose(normals[i][inside][:, 0], lean, atol=0.01)
        # Hertz's area for this force; a pad of 3.6 radii is near a half-space. Elements of 0.7 of
        # the radius are too stiff, and their nodes hang below faces that touch.
        force = env.press_force[i, 2]
        assert pressure[i].sum() * 0.06e-3**2 == pytest.approx(force, rel=0.2)
        area = np.pi * (3 * force * 4e-3 * (1 - 0.45**2) / 4e5) ** (2 / 3)
        assert 0.92 < contact[i].sum() * 0.06e-3**2 / area < 1.08
    assert not contact[2].any() and not pressure[2].any()
    np.testing.assert_allclose(height[2], 0.0, atol=1e-8)


@pytest.mark.thorough
def test_the_texture_shows_where_it_touches_and_nowhere_else():
    env = pressed(True)
    height, contact = (a.numpy() for a in shown(env, WAVES).read("height_m", "contact"))
    for i in range(2):
        center, ball, away = ball_of(env, i)
        relief = 2e-6 * np.cos(2 * np.pi * (X - center[0] - 0.5 * 1.2e-3 / 32) / 0.6e-3)
        inside = contact[i] & (away < 0.7e-3)
        rest = (height[i] - ball)[inside]
        # A pixel is the mean of its samples, which takes 2 % of the amplitude.
        assert np.corrcoef(rest, -relief[inside])[0, 1] > 0.99
        assert np.std(rest) == pytest.approx(np.std(relief[inside]), rel=0.1)
    beside, plain = np.hypot(X, Y) > 1.7e-3, shown(env).height_m.numpy()
    np.testing.assert_allclose(height[0][beside], plain[0][beside], atol=4e-7)


def test_a_texture_turns_and_goes_with_its_body():
    texture = Texture(np.random.default_rng(0).random((16, 24)), 1e-4, 1.2e-3)
    gel = tl.SoftBody(block_mesh((4, 4, 2), (8e-3, 8e-3, 3e-3)), tl.Material(1e5, 0.4))
    plate = tl.KinematicBody(tl.box_mesh((6e-3, 6e-3, 1e-3)), name="plate")
    model = tl.Scene(gel, plate, 3).finalize("cpu")
    poses = [pose(0, 0, 1e-3), pose(0.12e-3, -0.18e-3, 1e-3), pose(0, 0, 1e-3, (0, 0, 1), 90)]
    state = tl.initial_state(model, np.array(poses)[:, None])
    seen = ObjectHeights(model, "plate", tl.PixelGrid(41, 41, 0.03, 0.03), rows=3, texture=texture)
    none = wp.empty(0, dtype=wp.transformd, device="cpu")
    envs = wp.array([0, 1, 2], dtype=wp.int32, device="cpu")
    height, smooth = (array.numpy() for array in seen.read(state, none, envs)[:2])
    assert np.ptp(smooth[np.isfinite(smooth)]) < 1e-12
    assert np.abs((height - 0.5e-3).mean()) < 3e-6 and np.ptp(height) < 1.01e-4
    # 4 pixels along x and -6 along y.
    np.testing.assert_allclose(height[1, :-6, 4:], height[0, 6:, :-4], atol=1e-12)
    # x goes to y: what was at (x, y) is at (-y, x).
    np.testing.assert_allclose(height[2], height[0].T[:, ::-1], atol=1e-12)


def test_a_gel_is_at_rest_as_drawn_however_it_is_mounted():
    gel = tl.SoftBody(block_mesh((8, 8, 2), (6e-3, 6e-3, 2e-3), jitter=0.1), tl.Material(1e5, 0.45))
    tool = tl.KinematicBody(tl.box_mesh((2e-3, 2e-3, 1e-3)), name="tool")
    link = tl.AffineBody(tl.box_mesh((2e-2, 2e-2, 2e-2)), name="link")
    turned = replace(gel, mount="link", mount_pose=pose(0, 0, 1e-2, (1, 2, -1), 70))
    moving = tl.Scene(turned, tool, affine_bodies=link, time=tl.TimeStepping(quasi_static=False))
    drawn, mounted = (
        tl.FineSurface(tl.SolverIPC(scene.finalize("cpu")), "tool", GRID).rest_samples.numpy()
        for scene in (tl.Scene(gel, tool), moving)
    )
    assert np.isfinite(drawn).all()
    np.testing.assert_allclose(mounted, drawn, atol=1e-12)


@pytest.mark.thorough
def test_images_of_many_environments_are_those_of_each():
    env, names = pressed(True), ("height_m", "depth_m", "contact")
    whole = [array.numpy().copy() for array in shown(env, WAVES).read(*names)]
    parts = shown(env, WAVES, env_count=1)
    assert parts.chunk_envs == 1
    for array, expected in zip(parts.read(*names), whole, strict=True):
        np.testing.assert_allclose(array.numpy(), expected, atol=2e-8)
    signal, who = shown(env, WAVES), np.array([False, True, True])
    signal.update(env.state, who=who)
    np.testing.assert_allclose(signal.height_m.numpy(), whole[0][who], atol=2e-8)
    np.testing.assert_allclose(whole[1], -whole[0], atol=1e-9)
    # The contact that is read alone is the same.
    signal.update(env.state)
    assert (signal.contact.numpy() == whole[2]).all()


@pytest.mark.thorough
def test_textures_are_checked(tmp_path):
    levels = np.tile(np.arange(0, 256, 8, dtype=np.uint8), (16, 1))
    cv2.imwrite(str(tmp_path / "ramp.png"), levels)
    cv2.imwrite(str(tmp_path / "grey.png"), np.full((16, 16), 90, dtype=np.uint8))
    ramp = Texture.from_image(tmp_path / "ramp.png", 0.1, 3.2)
    assert ramp.heights.shape == (16, 32) and ramp.depth_m == 1e-4 and ramp.width_m == 3.2e-3
    assert ramp.relief_m().mean() == pytest.approx(0.0, abs=1e-12)
    assert ramp.mean_depth_m == pytest.approx(1e-4 * 124 / 255)
    env, gel_3 = pressed(False), partial(tl.FineSurface, gel=3)
    signal = shown(env)
    signal.update(env.state.positions)
    depth = r"depth_m of a texture must lie in \[1e-07, 0.01\] m, got -1"
    for call, given, words in (
        (Texture.from_image, (tmp_path / "grey.png", 0.1, 3.2), "has one level everywhere"),
        (Texture, (np.eye(4), -1.0, 1e-3), depth),
        (Texture, (2 * np.eye(4), 1e-4, 1e-3), "lie between 0 and 1"),
        (Texture, (np.full((4, 4), np.nan), 1e-4, 1e-3), "a map of finite heights"),
        (tl.FineSurface, (env.solver, "tool", GRID), r"no rigid body 'tool'; there are 'sphere:4'"),
        (gel_3, (env.solver, "sphere:4", GRID), "there is no soft body 3"),
        (signal.read, ("height_m",), "a fine surface needs the state of the solver"),
    ):
        with pytest.raises(tl.InputError, match=words):
            call(*given)
