# SPDX-License-Identifier: Apache-2.0
"""The face by way of its places at rest: walls, shear, turned frames."""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.geometry import PixelGrid, TetMesh
from taccel_lab.signals import ContactSurface, SignalTactile
from taccel_lab.signals.deformed_face import DeformedFace
from tests.signals.pressed_surface import flat_pad, pixel_xy

GRID = PixelGrid(120, 90, 0.05, 0.05)
HALF_MM = (4.2, 3.4)


def _seen(face: DeformedFace, mesh: TetMesh, nodes_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Heights and slopes of the face with surface nodes at [m]."""
    positions = mesh.nodes_m.copy()
    positions[ContactSurface.from_mesh(mesh).node_idx] = nodes_m
    given = wp.array(positions[None], dtype=wp.vec3d, device="cpu")
    samples = face.sample(given).numpy()[0].astype(np.float64)
    return samples[..., 2], samples[..., :2]


WALL_M, HEIGHT_M = 1.0e-3, 0.8e-3


def _wall(rest: np.ndarray) -> np.ndarray:
    """Gel with a step at x = 0: what lay within 0.4 mm of it has become a wall ten times as steep
    as the mesh could draw over the image, 20 um thick."""
    x = rest[:, 0]
    along = np.clip(x / 0.4e-3, -1, 1)
    squeezed = np.where(np.abs(x) < 0.4e-3, 10e-6 * along, x - 0.39e-3 * np.sign(x))
    rise = 0.5 * HEIGHT_M * along
    return np.stack([squeezed, rest[:, 1], rise], axis=1)


def test_a_wall_does_not_swing():
    """Over the image its triangles are slivers, on which a height overshoots."""
    mesh = flat_pad(0.2, HALF_MM)
    face = DeformedFace(mesh, GRID)
    nodes = mesh.nodes_m[ContactSurface.from_mesh(mesh).node_idx]
    height, slope = _seen(face, mesh, _wall(nodes))
    x, _ = pixel_xy(GRID)
    clear = np.abs(x) > 0.15e-3
    error = np.abs(height - 0.5 * HEIGHT_M * np.sign(x))[clear]
    assert error.max() < 0.03 * HEIGHT_M
    assert np.degrees(np.arctan(np.abs(slope)))[clear].max() < 20
    positions = mesh.nodes_m.copy()
    positions[ContactSurface.from_mesh(mesh).node_idx] = _wall(nodes)
    plain = SignalTactile(mesh, GRID, env_count=1)
    plain.update(wp.array(positions[None], dtype=wp.vec3d, device="cpu"))
    over_image = np.abs(plain.height_m.numpy()[0] - 0.5 * HEIGHT_M * np.sign(x))[clear]
    assert over_image.max() > 3 * error.max()


def test_slopes_are_those_over_the_image():
    """Of a sheared and tilted face, whose slopes over the places at rest are others."""
    mesh = flat_pad(0.3, HALF_MM)
    face = DeformedFace(mesh, GRID)
    rest = mesh.nodes_m[ContactSurface.from_mesh(mesh).node_idx]
    x = 0.8 * rest[:, 0] + 0.3 * rest[:, 1]
    y = 1.1 * rest[:, 1] - 0.1 * rest[:, 0]
    height, slope = _seen(face, mesh, np.stack([x, y, 0.3 * x - 0.2 * y + 1e-4], axis=1))
    px, py = pixel_xy(GRID)
    seen = np.isfinite(height)
    assert seen.mean() > 0.8
    assert np.abs(height - (0.3 * px - 0.2 * py + 1e-4))[seen].max() < 1e-8
    assert np.abs(slope - [0.3, -0.2])[seen].max() < 1e-4


def test_a_face_that_came_from_elsewhere_is_covered():
    """Slid by 1.5 mm: what the image shows lay beside it at rest."""
    mesh = flat_pad(0.3, (8.0, 8.0))
    face = DeformedFace(mesh, GRID)
    rest = mesh.nodes_m[ContactSurface.from_mesh(mesh).node_idx]
    assert np.isfinite(_seen(face, mesh, rest)[0]).all()
    height, _ = _seen(face, mesh, rest + [1.5e-3, -1.5e-3, 1e-4])
    assert np.allclose(height, 1e-4, rtol=0, atol=1e-9)


def test_beside_the_pad_there_is_nothing():
    mesh = flat_pad(0.3, (2.0, 1.5))
    face = DeformedFace(mesh, GRID)
    height, slope = _seen(face, mesh, mesh.nodes_m[ContactSurface.from_mesh(mesh).node_idx])
    x, y = pixel_xy(GRID)
    far = (np.abs(x) > 2.4e-3) | (np.abs(y) > 1.9e-3)
    near = (np.abs(x) < 1.8e-3) & (np.abs(y) < 1.2e-3)
    assert np.isnan(height[far]).all() and np.isnan(slope[far]).all()
    assert np.isfinite(height[near]).all()


def test_each_environment_has_its_own_rest() -> None:
    """Two pads whose nodes lie elsewhere at rest, in one batch, sunk by the same."""
    mesh = flat_pad(0.3, HALF_MM)
    rest = np.stack([mesh.nodes_m, mesh.nodes_m * [1.1, 0.9, 1.0]])
    given = wp.array(rest, dtype=wp.vec3d, device="cpu")
    face = DeformedFace(mesh, GRID, env_count=2, rest_positions=given)
    moved = rest.copy()
    moved[:, :, 2] -= 1e-4 * np.exp(-((rest[:, :, :2] / 1e-3) ** 2).sum(axis=2))
    both = face.sample(wp.array(moved, dtype=wp.vec3d, device="cpu")).numpy().copy()
    x, y = pixel_xy(GRID)
    truth = -1e-4 * np.exp(-((x / 1e-3) ** 2) - (y / 1e-3) ** 2)
    for samples in both:
        assert np.nanmax(np.abs(samples[..., 2] - truth)) < 3e-6
    envs = wp.array([1], dtype=wp.int32, device="cpu")
    alone = face.sample(wp.array(moved, dtype=wp.vec3d, device="cpu"), None, envs).numpy()
    np.testing.assert_array_equal(alone[0], both[1])
