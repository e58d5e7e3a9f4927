# SPDX-License-Identifier: Apache-2.0
"""Slopes and height of the contact surface at every pixel, from and to device arrays.

The gel's elements are larger than a pixel, so its piecewise-linear surface would show as facets
under grazing light. A C1 surface is rebuilt from the same nodes: gradients of least bending
(``gradient_recovery``), then Clough-Tocher cubics (``face_patches``), whose slopes are the
interpolant's, not pixel differences. Patches are built in FP64 and evaluated in FP32, which leaves
1e-10 m of the height.
"""

# Warp compiles the kernels from their source; its type stubs describe neither vectors' operators
# nor FP64 overloads.
# pyright: reportArgumentType=false, reportAssignmentType=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from taccel_lab.geometry import PixelGrid, QuadraticMesh, TetMesh
from taccel_lab.model.env_rows import chosen_env
from taccel_lab.processes.start_warp import start_warp
from taccel_lab.signals.face_patches import RECORD, build_patches_kernel
from taccel_lab.signals.gradient_recovery import (
    FEW_SWEEPS,
    ContactFaceMesh,
    NetworkScratch,
    recover_gradients,
)
from taccel_lab.signals.markers import in_gel_frame
from taccel_lab.signals.pixel_walk import PixelWalk
from taccel_lab.signals.raster import grid_map, smallest_area2


@wp.kernel
def _gather_surface_kernel(
    positions: wp.array2d(dtype=wp.vec3d),
    frames: wp.array(dtype=wp.transformd),
    envs: wp.array(dtype=wp.int32),
    node_idx: wp.array(dtype=wp.int32),
    # Out
    surface: wp.array2d(dtype=wp.vec3d),
    height: wp.array2d(dtype=wp.float64),
):
    row, node = wp.tid()
    env = chosen_env(envs, row)
    point = in_gel_frame(frames, env, positions[env, node_idx[node]])
    surface[row, node] = point
    height[row, node] = point[2]


class SurfaceSampler:
    """Samples (slope along x, slope along y, height [m]) of up to ``env_count`` environments."""

    def __init__(
        self,
        mesh: TetMesh | QuadraticMesh,
        grid: PixelGrid,
        *,
        env_count: int,
        first_node: int = 0,
        device: Any = "cpu",
    ) -> None:
        """
        Args:
            mesh: Gel pad at rest; its faces of region CONTACT are shown.
            grid: Pixels of the image.
            env_count: Most environments of one call.
            first_node: Of this gel in the arrays of positions.
            device: Warp device.
        """
        start_warp()
        self.surface = surface = ContactFaceMesh.from_mesh(mesh)
        """Topology of the contact face."""
        self._area2_m2 = smallest_area2(grid)
        self._map = grid_map(grid)
        self._device = device
        node_count, face_count = surface.node_count, len(surface.faces)
        self._node_idx = wp.array(surface.node_idx + first_node, dtype=wp.int32, device=device)
        self._ring_start = wp.array(surface.ring_start, dtype=wp.int32, device=device)
        self._ring_nodes = wp.array(surface.ring_nodes, dtype=wp.int32, device=device)
        self._points = wp.empty((env_count, node_count), dtype=wp.vec3d, device=device)
        self._height = wp.empty((env_count, node_count), dtype=wp.float64, device=device)
        entry_count = len(surface.ring_nodes)
        self._network = NetworkScratch.empty(env_count, node_count, entry_count, device)
        rest = mesh.nodes_m[surface.node_idx]
        self._walk = PixelWalk(surface, rest, grid, env_count=env_count, device=device)
        record_count = env_count * face_count * RECORD
        self._patches = wp.empty(record_count, dtype=wp.vec4f, device=device)
        self._folded = wp.zeros(env_count, dtype=wp.int32, device=device)
        shape = (env_count, grid.height_px, grid.width_px)
        self._samples = wp.empty(shape, dtype=wp.vec3f, device=device)
        at_rest = np.zeros((1, first_node + mesh.node_count, 3))
        at_rest[0, first_node:] = mesh.nodes_m
        self._no_frames = wp.empty(0, dtype=wp.transformd, device=device)
        self._all_envs = wp.empty(0, dtype=wp.int32, device=device)
        samples = self.sample(wp.array(at_rest, dtype=wp.vec3d, device=device))
        self.rest_samples = wp.clone(samples[0])
        """Samples of the undeformed gel, vec3f, shape [height_px, width_px]."""

    @property
    def rasterized(self) -> np.ndarray:
        """Environments that the latest call had to rasterise, bool; waits for the device."""
        return self._walk.unsettled

    def sample(
        self, positions: wp.array, frames: wp.array | None = None, envs: wp.array | None = None
    ) -> wp.array:
        """Sample the surface.

        Args:
            positions: Node positions [m], vec3d, shape [env, node].
            frames: world_from_gel, transformd, shape [env]; None when positions are in the gel
                frame.
            envs: The environments to sample, int32; all when None.

        Returns:
            vec3f, shape [env, height_px, width_px], NaN beside the pad; valid until the next call.
        """
        return self._interpolate(self.place(positions, frames, envs))

    def place(
        self, positions: wp.array, frames: wp.array | None = None, envs: wp.array | None = None
    ) -> int:
        """Places the surface as ``sample`` does, for fields to be sampled on it next; returns their
        rows."""
        count = positions.shape[0] if envs is None else len(envs)
        envs = self._all_envs if envs is None else envs
        points, height = self._points[:count], self._height[:count]
        wp.launch(
            _gather_surface_kernel,
            dim=points.shape,
            inputs=[positions, self._no_frames if frames is None else frames, envs, self._node_idx],
            outputs=[points, height],
            device=self._device,
        )
        return count

    def sample_field(self, values: wp.array) -> wp.array:
        """Sample another nodal field on the surface of the latest ``sample`` or ``place``.

        Args:
            values: At the surface nodes, float64, shape [env, surface_node].

        Returns:
            As of ``sample``: gradient over x and y [unit of ``values`` / m] and the field itself.
        """
        wp.copy(self._height[: len(values)], values)
        return self._interpolate(len(values))

    def _interpolate(self, count: int) -> wp.array:
        """Samples of what ``_height`` holds, in the first ``count`` environments."""
        points, height = self._points[:count], self._height[:count]
        faces, gradients = self._walk.faces, self.gradients(count)
        self._folded.zero_()
        folded = self._folded[:count]
        wp.launch(
            build_patches_kernel,
            dim=(count, len(faces)),
            inputs=[points, height, gradients, faces, self._map, self._area2_m2],
            outputs=[self._patches, folded],
            device=self._device,
        )
        samples = self._samples[:count]
        self._walk.sample(points, self._patches, folded, samples)
        return samples

    def gradients(self, count: int) -> wp.array:
        """Gradients of the height at the first ``count`` environments of the latest call, vec2d,
        shape [env, surface_node]."""
        return recover_gradients(
            self._points[:count],
            self._height[:count],
            self._ring_start,
            self._ring_nodes,
            self._network,
            FEW_SWEEPS,
        )
