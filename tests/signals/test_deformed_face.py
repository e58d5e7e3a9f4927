# SPDX-License-Identifier: Apache-2.0
"""The face by way of its places at rest: walls, shear, turned frames."""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.geometry import PixelGrid
from taccel_lab.signals import SignalTactile
from taccel_lab.signals.deformed_face import DeformedFace
from tests.signals.pressed_surface import flat_pad, pixel_xy

GRID = PixelGrid(120, 90, 0.05, 0.05)
HALF_MM = (4.2, 3.4)
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
    nodes = mesh.nodes_m[face.surface.node_idx]
    height, slope = face.sample(_wall(nodes))
    x, _ = pixel_xy(GRID)
    clear = np.abs(x) > 0.15e-3
    error = np.abs(height - 0.5 * HEIGHT_M * np.sign(x))[clear]
    assert error.max() < 0.03 * HEIGHT_M
    assert np.degrees(np.arctan(np.abs(slope)))[clear].max() < 20
    positions = mesh.nodes_m.copy()
    positions[face.surface.node_idx] = _wall(nodes)
    plain = SignalTactile(mesh, GRID, env_count=1)
    plain.update(wp.array(positions[None], dtype=wp.vec3d, device="cpu"))
    over_image = np.abs(plain.height_m.numpy()[0] - 0.5 * HEIGHT_M * np.sign(x))[clear]
    assert over_image.max() > 3 * error.max()


def test_slopes_and_fields_are_those_over_the_image():
    """Of a sheared and tilted face, whose slopes over the places at rest are others."""
    mesh = flat_pad(0.3, HALF_MM)
    face = DeformedFace(mesh, GRID)
    rest = mesh.nodes_m[face.surface.node_idx]
    x = 0.8 * rest[:, 0] + 0.3 * rest[:, 1]
    y = 1.1 * rest[:, 1] - 0.1 * rest[:, 0]
    height, slope = face.sample(np.stack([x, y, 0.3 * x - 0.2 * y + 1e-4], axis=1))
    px, py = pixel_xy(GRID)
    seen = np.isfinite(height)
    assert seen.mean() > 0.8
    assert np.abs(height - (0.3 * px - 0.2 * py + 1e-4))[seen].max() < 1e-8
    assert np.abs(slope - [0.3, -0.2])[seen].max() < 1e-4
    value, gradient = face.sample_field(2.0 * x + 5.0 * y)
    assert np.abs(value - (2 * px + 5 * py))[seen].max() < 1e-7
    assert np.abs(gradient - [2.0, 5.0])[seen].max() < 1e-3


def test_a_face_that_came_from_elsewhere_is_covered():
    """Slid by 2 mm: what the image shows lay beside it at rest."""
    mesh = flat_pad(0.3, (8.0, 8.0))
    face = DeformedFace(mesh, GRID)
    rest = mesh.nodes_m[face.surface.node_idx]
    assert np.isfinite(face.sample(rest)[0]).all()
    height, _ = face.sample(rest + [2e-3, -2e-3, 1e-4])
    assert np.allclose(height, 1e-4, rtol=0, atol=1e-9)


def test_beside_the_pad_there_is_nothing():
    mesh = flat_pad(0.3, (2.0, 1.5))
    face = DeformedFace(mesh, GRID)
    height, slope = face.sample(mesh.nodes_m[face.surface.node_idx])
    x, y = pixel_xy(GRID)
    far = (np.abs(x) > 2.4e-3) | (np.abs(y) > 1.9e-3)
    near = (np.abs(x) < 1.8e-3) & (np.abs(y) < 1.2e-3)
    assert np.isnan(height[far]).all() and np.isnan(slope[far]).all()
    assert np.isfinite(height[near]).all()
