# SPDX-License-Identifier: Apache-2.0
"""Analytic contact surfaces and gel meshes that sample them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial import Delaunay

from taccel_lab.geometry import PixelGrid, Region, TetMesh
from taccel_lab.geometry.tet_mesh import boundary_faces

HeightFunction = Callable[[np.ndarray, np.ndarray], np.ndarray]


def flat_pad(element_mm: float, half_mm: tuple[float, float], seed: int = 0) -> TetMesh:
    """A 1 mm thick pad with a flat contact face of irregular triangles."""
    rng = np.random.default_rng(seed)
    x = np.arange(-half_mm[0], half_mm[0] + 1e-9, element_mm)
    y = np.arange(-half_mm[1], half_mm[1] + 1e-9, element_mm * np.sqrt(3) / 2)
    grid_x, grid_y = np.meshgrid(x, y)
    grid_x = grid_x + 0.5 * element_mm * (np.arange(len(y)) % 2)[:, None]
    xy = np.stack([grid_x.ravel(), grid_y.ravel()], axis=1)
    xy += rng.uniform(-0.25, 0.25, xy.shape) * element_mm
    triangles = Delaunay(xy).simplices
    a, b, c = (xy[triangles[:, k]] for k in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    triangles = triangles[np.abs(area) > 1e-3 * element_mm**2]
    return extrude(xy * 1e-3, triangles)


def extrude(xy_m: np.ndarray, triangles: np.ndarray) -> TetMesh:
    """Prisms 1 mm high under the triangles, three tets each; the upper face is the contact face."""
    count = len(xy_m)
    top = np.column_stack([xy_m, np.zeros(count)])
    nodes = np.concatenate([top, top - [0.0, 0.0, 1e-3]])
    a, b, c = np.sort(triangles, axis=1).T
    # Splitting by node number makes the diagonals of neighbouring prisms agree.
    tets = np.concatenate(
        [
            np.stack([a, b, c, c + count], axis=1),
            np.stack([a, b, b + count, c + count], axis=1),
            np.stack([a, a + count, b + count, c + count], axis=1),
        ]
    )
    corners = nodes[tets]
    flipped = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0
    tets[flipped] = tets[flipped][:, [0, 2, 1, 3]]
    faces = boundary_faces(tets)
    regions = np.full(len(faces), int(Region.SIDE))
    regions[(faces < count).all(axis=1)] = int(Region.CONTACT)
    regions[(faces >= count).all(axis=1)] = int(Region.BOND)
    return TetMesh(nodes, tets, faces, regions)


def shaped(mesh: TetMesh, height: HeightFunction) -> np.ndarray:
    """Positions [1, node, 3] with the contact face moved to ``height(x, y)`` [m]."""
    positions = mesh.nodes_m.copy()
    top = mesh.region_nodes(Region.CONTACT)
    positions[top, 2] = height(positions[top, 0], positions[top, 1])
    return positions[None]


def pixel_xy(grid: PixelGrid) -> tuple[np.ndarray, np.ndarray]:
    """Gel xy of the pixel centres [m], each [height_px, width_px]."""
    x, y = np.meshgrid(grid.x_mm() * 1e-3, grid.y_mm() * 1e-3)
    return x, y


def angle_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle between unit vectors [degrees]."""
    return np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2, 0, 1)))


def pressed_sphere(
    contact_radius_m: float, center_xy_m: tuple[float, float] = (0.13e-3, -0.07e-3)
) -> HeightFunction:
    """Heights [m] under a ball of 2 mm, with a skirt that leaves it as in Hertz contact.

    Outside, the slope falls like the derivative of Johnson's (1985) equation 3.42a, scaled to the
    slope of the ball at the edge, times ``exp(-d / decay)`` as in a layer of finite thickness. Its
    curvature is infinite at the edge: the hard case for any interpolation.
    """
    a, ball_m, decay_m = contact_radius_m, 2e-3, 0.8e-3
    at = a + np.concatenate([[0.0], np.geomspace(1e-10, 12e-3, 6000)])
    rho = at / a
    hertz = (2 / np.pi) * (rho * np.arcsin(1 / rho) - np.sqrt(np.maximum(1 - 1 / rho**2, 0)))
    deep = np.sqrt(ball_m**2 - a**2)
    slope = a / deep * hertz * np.exp(-(at - a) / decay_m)
    rise = np.concatenate([[0.0], np.cumsum((slope[1:] + slope[:-1]) / 2 * np.diff(at))])
    rise -= rise[-1]

    def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        r = np.hypot(x - center_xy_m[0], y - center_xy_m[1])
        cap = rise[0] + deep - np.sqrt(ball_m**2 - np.minimum(r, a) ** 2)
        return np.where(r < a, cap, np.interp(r, at, rise))

    return height
