# SPDX-License-Identifier: Apache-2.0
"""A rigid body on an elastic half-space, which the contact tests share.

The block is fixed on a half sphere 300 contact radii away. Far from the contact the half-space of
the closed forms moves there by F (1 - nu^2) / (pi E r); holding it still instead adds about
2 / (300 pi), 0.2 % of the depth, so that no correction is made.

Its mesh: a half cube of cells around the origin is wrapped in copies of its surface, each larger
than the last. Cells keep their angle and grow with their distance, so that a far-away outside costs
few nodes. All cells are bent towards half spheres by steps of equal angle [Ronchi, Iacono, Paolucci
1996, The Cubed Sphere]; straight cubes need about 1.5 times as many cells for the same error.
"""

from __future__ import annotations

from itertools import permutations
from typing import Any

import numpy as np

from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.tet_mesh import boundary_faces
from taccel_lab.scene import Ball, Element, KinematicBody, Material, Scene, SoftBody, TriangleMesh
from taccel_lab.solvers import StepReport
from tests.support.blocks import pose
from tests.support.scene_steps import Stepped

DOMAIN_OVER_RADIUS = 300.0
GROWTH = 2.0
"""Ratio of neighbouring shells of the block."""


class HalfSpace(Stepped):
    """A block with a rigid body above it, moved without being turned; quasi-static."""

    def __init__(
        self,
        mesh: TetMesh,
        shape: TriangleMesh | Ball,
        *,
        young_pa: float,
        poisson: float,
        start_m: float,
        friction: float = 0.0,
        element: Element = Element.QUADRATIC,
        **settings: Any,
    ) -> None:
        """``start_m``: height of the body's origin at first [m]; ``settings``: of the solver."""
        soft = SoftBody(mesh, Material(young_pa, poisson), element=element)
        scene = Scene(soft, KinematicBody(shape, friction))
        super().__init__(scene, pose(0, 0, start_m), **settings)

    def move(self, x_m: float, z_m: float) -> StepReport:
        return self.step(pose(x_m, 0, z_m))

    @property
    def positions_m(self) -> np.ndarray:
        return self.x(0)

    @property
    def rest_m(self) -> np.ndarray:
        return self.rest[self.nodes(0)]

    @property
    def areas_m2(self) -> np.ndarray:
        """Part of the surface that each node stands for at rest, shape [node]."""
        return self.model.surface.node_areas.numpy()[0, : self.model.soft_count]

    @property
    def normal_n(self) -> np.ndarray:
        return self.contact(0)

    @property
    def friction_n(self) -> np.ndarray:
        return self.friction(0)


CORE_ROUNDNESS = 0.5
"""How far the outside of the fine half cube is on its way to a half sphere, 0 to 1."""


def half_space_mesh(
    core_m: float,
    cells: int,
    total_m: float,
    growth: float,
    roundness: float = CORE_ROUNDNESS,
    grading: float = 1.0,
) -> TetMesh:
    """A block bonded outside at ``total_m``, ``cells`` cells in its fine half width ``core_m``.

    ``roundness`` 1 makes a circle of nodes of radius ``core_m``, ``grading`` above 1 cells of size
    cells^-grading near it.
    """
    unit, core_tets = _half_cube(cells)
    if grading != 1.0:
        depth = unit[:, 2:]
        sides = np.sign(unit[:, :2]) * (1 - (1 - np.abs(unit[:, :2])) ** grading)
        unit = np.concatenate([sides, -((-depth) ** grading)], axis=1)
    faces = boundary_faces(core_tets)
    skin = faces[(unit[faces][..., 2] < -1e-9).any(axis=1)]
    used, prism = np.unique(skin, return_inverse=True)
    # Corners of a triangle ascend, so that neighbouring prisms split their common wall alike.
    prism = np.sort(prism.reshape(skin.shape), axis=1)
    scales = _shell_scales(total_m / core_m, float(cells) ** -grading, growth)
    layers = [unit, *(s * unit[used] for s in scales)]
    nodes = core_m * np.concatenate([_rounded(layer, roundness) for layer in layers])
    shells = len(unit) + len(used) * np.arange(len(scales))[:, None] + np.arange(len(used))
    tets = [core_tets]
    for inner, outer in zip([used, *shells[:-1]], shells, strict=True):
        a, b, c = (inner[prism[:, k]] for k in range(3))
        d, e, f = (outer[prism[:, k]] for k in range(3))
        tets += [np.stack(t, axis=1) for t in ((a, b, c, f), (a, b, e, f), (a, d, e, f))]
    all_tets = np.concatenate(tets)
    p = nodes[all_tets]
    flipped = np.linalg.det(p[:, 1:] - p[:, :1]) < 0
    all_tets[flipped] = all_tets[flipped][:, [0, 2, 1, 3]]
    surface = boundary_faces(all_tets)
    top = (nodes[surface][..., 2] > -1e-9 * core_m).all(axis=1)
    return TetMesh(nodes, all_tets, surface, np.where(top, int(Region.CONTACT), int(Region.BOND)))


def _half_cube(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of [-1, 1]^2 x [-1, 0] in 2n x 2n x n cells of six tets, mirrored in x and y."""
    axis = np.arange(-n, n + 1) / n
    x, y, z = np.meshgrid(axis, axis, axis[: n + 1], indexing="ij")
    nodes = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    cell = np.arange(2 * n)
    i, j, k = (c.ravel() for c in np.meshgrid(cell, cell, cell[:n], indexing="ij"))
    # The diagonal of each cell points away from the middle of the contact face.
    mirrored = np.stack([i < n, j < n, np.ones(len(i), dtype=bool)], axis=1)
    low = np.stack([i, j, k], axis=1)
    tets = []
    for order in permutations(range(3)):
        path = [np.zeros(3, dtype=int)]
        for step in order:
            path.append(path[-1] + np.eye(3, dtype=int)[step])
        corners = [low + np.where(mirrored, 1 - p, p) for p in path]
        ids = [(c[:, 0] * (2 * n + 1) + c[:, 1]) * (n + 1) + c[:, 2] for c in corners]
        tets.append(np.stack(ids, axis=1))
    return nodes, np.concatenate(tets)


def _rounded(points: np.ndarray, roundness: float) -> np.ndarray:
    """Bend nested half cubes towards nested half spheres, shape [n, 3]; the larger the more."""
    size = np.abs(points).max(axis=1, keepdims=True)
    unit = points / np.maximum(size, 1e-12)
    angular = np.tan(np.pi / 4 * unit)
    sphere = angular / np.maximum(np.linalg.norm(angular, axis=1, keepdims=True), 1e-12)
    share = np.where(size < 1, roundness * size, 1 - (1 - roundness) / np.maximum(size, 1))
    return size * ((1 - share) * unit + share * sphere)


def _shell_scales(total: float, cell: float, growth: float) -> np.ndarray:
    """Sizes of the shells over the fine part's, the last one ``total``; ``cell`` is inside."""
    scale, thickness = [1.0], cell
    while scale[-1] < total:
        thickness = min(thickness * growth, (growth - 1) * scale[-1])
        scale.append(scale[-1] + thickness)
    # Shrink geometrically so that the last one fits.
    return np.array(scale[1:]) * (total / scale[-1]) ** np.linspace(0, 1, len(scale))[1:]
