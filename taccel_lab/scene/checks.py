# SPDX-License-Identifier: Apache-2.0
"""Meshes and sizes of bodies that no simulation can use, refused before a model is built."""

from __future__ import annotations

from taccel_lab.bodies.bodies import AffineBody, SoftBody
from taccel_lab.bodies.mesh_checks import check_extent, check_surface, check_tets
from taccel_lab.bodies.primitives import TriangleMesh
from taccel_lab.bodies.scene_description import SceneDescription

SOFT_EXTENT_M = (1e-5, 1.0)
"""Sizes of a soft body: a gel of 8 m was meant in millimetres."""
RIGID_EXTENT_M = (1e-5, 10.0)
"""Sizes of an affine or kinematic body: one of 20 m was meant in millimetres."""


def check_scene(scene: SceneDescription) -> None:
    """Refuse bodies whose meshes or sizes no simulation can use; a shared mesh is checked once."""
    seen: set[tuple[int, bool]] = set()
    for index, body in enumerate(scene.bodies):
        what = f"body {index} ({body.name!r})"
        if isinstance(body, SoftBody):
            if _is_new(seen, body.mesh, True):
                check_extent(body.mesh.nodes_m, what, SOFT_EXTENT_M)
                check_tets(body.mesh, what)
            continue
        shape = getattr(body, "shape", None)
        if isinstance(shape, TriangleMesh):
            closed = isinstance(body, AffineBody)
            if _is_new(seen, shape, closed):
                check_extent(shape.vertices_m, what, RIGID_EXTENT_M)
                check_surface(shape.vertices_m, shape.faces, what, closed=closed)


def _is_new(seen: set[tuple[int, bool]], mesh: object, closed: bool) -> bool:
    key = (id(mesh), closed)
    if key in seen:
        return False
    seen.add(key)
    return True
