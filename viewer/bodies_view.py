# SPDX-License-Identifier: Apache-2.0
"""The bodies of a scene, where they are now."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from viser import MeshHandle, ViserServer

COLORS = {"soft": (127, 178, 217), "affine": (224, 164, 88), "kinematic": (184, 184, 184)}
"""As in the films of tasks."""
CLEAR = {"kinematic": 0.35, "soft": 0.8}


class BodiesView:
    """Surfaces that move; positions are shown in mm."""

    def __init__(
        self, server: ViserServer, bodies: list[tuple[str, np.ndarray, np.ndarray]]
    ) -> None:
        """``bodies``: kind, vertices [m] and triangles of each."""
        self._server = server
        self._meshes: list[MeshHandle] = [
            server.scene.add_mesh_simple(
                f"/bodies/{k}", 1e3 * vertices, faces, color=COLORS[kind],
                opacity=CLEAR.get(kind), side="double", cast_shadow=False, receive_shadow=False,
            )
            for k, (kind, vertices, faces) in enumerate(bodies)
        ]  # fmt: skip

    def move(self, vertices_m: list[np.ndarray]) -> None:
        """Show them elsewhere; as many bodies and vertices as at first."""
        with self._server.atomic():
            for mesh, vertices in zip(self._meshes, vertices_m, strict=True):
                mesh.vertices = (1e3 * vertices).astype(np.float32)


def rise_image(rise_m: np.ndarray, reach_m: float) -> np.ndarray:
    """Rise of a face as a picture, blue below and red above 0, uint8 [height, width, 3]; grey
    beside it."""
    from matplotlib import colormaps

    share = np.clip(0.5 + 0.5 * rise_m / max(reach_m, 1e-9), 0, 1)
    rgb = np.round(255 * colormaps["RdBu_r"](np.nan_to_num(share, nan=0.5))[..., :3])
    rgb[~np.isfinite(rise_m)] = 128
    return rgb.astype(np.uint8)
