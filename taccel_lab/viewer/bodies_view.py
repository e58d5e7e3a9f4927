# SPDX-License-Identifier: Apache-2.0
"""The bodies of a scene, where they are now."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.geometry.shading_normals import split_at_creases

if TYPE_CHECKING:
    from viser import MeshHandle, ViserServer

COLORS = {"soft": (127, 178, 217), "affine": (224, 164, 88), "kinematic": (184, 184, 184)}
"""As in the pictures of benchmarks."""
CLEAR = {"kinematic": 0.35, "soft": 0.8}


class BodiesView:
    """Surfaces that move; positions are shown in mm."""

    def __init__(
        self, server: ViserServer, bodies: list[tuple[str, np.ndarray, np.ndarray]]
    ) -> None:
        """``bodies``: kind, vertices [m] and triangles of each; sharp edges are those of now."""
        self._server = server
        split = [split_at_creases(vertices, faces) for _, vertices, faces in bodies]
        self._copied = [copied for copied, _ in split]
        self._meshes: list[MeshHandle] = [
            server.scene.add_mesh_simple(
                f"/bodies/{k}", 1e3 * vertices[copied], faces, color=COLORS[kind],
                opacity=CLEAR.get(kind), side="double", cast_shadow=False, receive_shadow=False,
            )
            for k, ((kind, vertices, _), (copied, faces)) in enumerate(
                zip(bodies, split, strict=True)
            )
        ]  # fmt: skip

    def move(self, vertices_m: list[np.ndarray]) -> None:
        """Show them elsewhere; as many bodies and vertices as at first."""
        with self._server.atomic():
            for mesh, copied, vertices in zip(self._meshes, self._copied, vertices_m, strict=True):
                mesh.vertices = (1e3 * vertices[copied]).astype(np.float32)
