# SPDX-License-Identifier: Apache-2.0
"""``Scene``: what a user says about a simulation, and the way from there to a device."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from taccel_lab.bodies.bodies import AffineBody, SoftBody
from taccel_lab.bodies.mesh_checks import check_extent, check_surface, check_tets
from taccel_lab.bodies.primitives import TriangleMesh
from taccel_lab.bodies.scene_description import SceneDescription
from taccel_lab.model import Model, build_model
from taccel_lab.model.turns import in_turn
from taccel_lab.processes.start_warp import start_warp
from taccel_lab.typed import typed

if TYPE_CHECKING:
    from warp import Device

SOFT_EXTENT_M = (1e-5, 1.0)
"""Sizes of a soft body: a gel of 8 m was meant in millimetres."""
RIGID_EXTENT_M = (1e-5, 10.0)
"""Sizes of an affine or kinematic body: one of 20 m was meant in millimetres."""


@typed
class Scene(SceneDescription):
    """Bodies and how they meet, in ``env_count`` copies; ``finalize`` makes a model of it."""

    @in_turn
    @typed
    def finalize(self, device: str | Device | None = None) -> Model:
        """Build the device arrays; raises InputError for meshes that cannot be used.

        ``device``: "cpu" or "cuda:0", "cuda:1", ..., or a device of Warp; when None what the
        environment variable TACCEL_LAB_DEVICE says, else the CPU.
        """
        start_warp()
        check_scene(self)
        return build_model(self, str(device or os.environ.get("TACCEL_LAB_DEVICE", "cpu")))


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
