# SPDX-License-Identifier: Apache-2.0
"""The face of a gel finer than its mesh: an object's surface where it touches, the gel elsewhere.

Heights and pressures of the coarse solution are sampled, and the contact with the object's own
surface is solved anew on the samples (``layer_contact``), on the device, in all environments
together. The object comes nearer by the mean gap that the barrier keeps: where it is pressed to is
where it shows. Lowered instead until it carries the force of the coarse solution, its heights were
2 to 26 um too low (elements of 0.18 to 0.8 mm under a contact 1 mm in radius) and images a tenth
worse, as nodes hang below faces that touch.
"""

# Warp compiles the kernels from their source; its type stubs describe neither vectors' operators
# nor FP64 overloads.
# pyright: reportArgumentType=false, reportAssignmentType=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.bodies.material import MaterialField
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, Region
from taccel_lab.outputs.arrays import to_torch
from taccel_lab.outputs.contact_layer import mean_gaps
from taccel_lab.scene import SoftBody
from taccel_lab.signals.contact_fields import ContactFields
from taccel_lab.signals.layer_contact import ITERATIONS, layer_compliance, solve_contact
from taccel_lab.signals.object_heights import ObjectHeights
from taccel_lab.signals.surface_sampler import SurfaceSampler
from taccel_lab.signals.texture import Texture
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.state import State

wp.set_module_options({"enable_backward": False})

SAMPLE_MM = 0.03
"""Distance at most at which surfaces are sampled; see docs/signals.md."""
_NOWHERE_M = 1.0
"""Height of no object."""


@wp.kernel
def _pixels_kernel(
    heights: wp.array3d(dtype=wp.float32),
    pressures: wp.array3d(dtype=wp.float32),
    points: int,
    sample_m: wp.vec2f,
    # Out
    samples: wp.array3d(dtype=wp.vec3f),
    pressure: wp.array3d(dtype=wp.float32),
    touched: wp.array3d(dtype=wp.bool),
):
    """Mean height, slope of the mean normal, mean pressure of each pixel's samples."""
    env, v, u = wp.tid()
    rows = heights.shape[1]
    columns = heights.shape[2]
    count = wp.int32(0)
    carrying = wp.int32(0)
    total = wp.float32(0.0)
    normal = wp.vec3f()
    load = wp.float32(0.0)
    for j in range(v * points, (v + 1) * points):
        for i in range(u * points, (u + 1) * points):
            left = wp.max(i - 1, 0)
            right = wp.min(i + 1, columns - 1)
            upper = wp.max(j - 1, 0)
            lower = wp.min(j + 1, rows - 1)
            z = heights[env, j, i]
            p = pressures[env, j, i]
            across = heights[env, j, right] - heights[env, j, left]
            along = heights[env, lower, i] - heights[env, upper, i]
            dx = across / (float(right - left) * sample_m[0])
            dy = along / (float(lower - upper) * sample_m[1])
            load += p
            if p > 0.0:
                carrying += 1
            # Beside the pad there is no height.
            if not wp.isnan(dx + dy + z):
                total += z
                normal += wp.normalize(wp.vec3f(-dx, -dy, 1.0))
                count += 1
    sample = wp.vec3f(wp.nan, wp.nan, wp.nan)
    if count > 0:
        sample = wp.vec3f(-normal[0] / normal[2], -normal[1] / normal[2], total / float(count))
    samples[env, v, u] = sample
    pressure[env, v, u] = load / float(points * points)
    touched[env, v, u] = 2 * carrying >= points * points


class FineSurface:
    """Samples of the fine face of one gel under one rigid body, for many environments.

    It is what ``SignalTactile(..., fine=...)`` shows. Torch does the Fourier transforms, on the
    stream of the solver's device, and nothing waits for it.
    """

    def __init__(
        self,
        solver: SolverIPC,
        body: str,
        grid: PixelGrid,
        *,
        gel: int = 0,
        texture: Texture | None = None,
        points: int | None = None,
        iterations: int = ITERATIONS,
        env_count: int | None = None,
    ) -> None:
        """
        Args:
            solver: It keeps the forces of its last step.
            body: Name of the rigid body that touches, of the scene.
            grid: Pixels of the image.
            gel: Index of the gel among the soft bodies.
            texture: What stands out of the body's surface, which is its mean; the body must be
                kinematic. The solver does not know of it.
            points: A pixel is the mean over ``points`` x ``points`` samples; as many as lie
                ``SAMPLE_MM`` apart when None.
            iterations: Of the contact problem.
            env_count: Most environments of one call; all of the model when None.

        Raises:
            InputError: No such body or gel.
        """
        model = solver.model
        if not 0 <= gel < len(model.scene.soft_bodies):
            raise InputError(
                f"there is no soft body {gel}; the scene has {len(model.scene.soft_bodies)}"
            )
        soft = model.scene.soft_bodies[gel]
        mesh = soft.nodal_mesh
        self._solver, self._grid = solver, grid
        if points is None:
            points = max(1, int(np.ceil(max(grid.mm_per_px_x, grid.mm_per_px_y) / SAMPLE_MM - 0.1)))
        self.points = points
        fine = grid.refined(points)
        rows = self.env_count = model.env_count if env_count is None else env_count
        self._nodes = (int(model.bodies[gel].nodes[0]), int(model.bodies[gel].nodes[1]))
        self._sampler = SurfaceSampler(
            mesh, fine, env_count=rows, first_node=self._nodes[0], device=model.device
        )
        self._fields = ContactFields(solver, gel, mesh, fine, chunk_envs=rows)
        self._object = ObjectHeights(model, body, fine, rows=rows, texture=texture)
        self._iterations = iterations
        young, poisson = near_moduli(soft)
        compliance = layer_compliance(fine, young, poisson, pad_thickness_m(soft))
        device = model.device
        self._compliance = to_torch(wp.array(compliance, dtype=wp.float32, device=device))
        self._coarse_pa = self._fields.make("pressure_pa", rows)
        shape = (rows, grid.height_px, grid.width_px)
        self._samples = wp.empty(shape, dtype=wp.vec3f, device=device)
        self._pressure = wp.empty(shape, dtype=wp.float32, device=device)
        self._touched = wp.empty(shape, dtype=wp.bool, device=device)
        self._device = device
        self._gaps: Any = None
        at_rest = to_torch(self._sampler.rest_samples)[None, ..., 2].contiguous()
        self._to_pixels(at_rest, at_rest * 0, 1)
        self.rest_samples = wp.clone(self._samples[0])
        """Samples of the undeformed gel, vec3f, shape [height_px, width_px]."""

    def update(self, state: State) -> None:
        """Read nodal loads of the step that led to ``state``."""
        self._fields.read_nodes(state, {"pressure_pa"})
        gaps = mean_gaps(self._solver.collisions, state.positions, self._nodes)
        self._gaps = to_torch(gaps)

    def sample(self, state: State, frames: wp.array, envs: wp.array) -> tuple[wp.array, ...]:
        """Sample some environments, after ``update``.

        Args:
            state: That of ``update``.
            frames: world_from_gel, transformd, [env_count]; of length 0 where the gel's frame is
                the world's.
            envs: The environments, int32, at most ``env_count``.

        Returns:
            As of ``SurfaceSampler.sample``: slope along x and y and height [m], vec3f; contact
            pressure [Pa], float32; and whether half of a pixel's samples carry, bool. All of shape
            [row, height_px, width_px], valid until the next call.
        """
        import torch

        count = len(envs)
        coarse = self._sampler.sample(state.positions, frames, envs)
        pressure = self._coarse_pa[:count]
        self._fields.render(state, frames, envs, {"pressure_pa": pressure})
        over = self._object.read(state, frames, envs)
        with self._stream():
            z, obj = to_torch(coarse)[..., 2], to_torch(over)
            known = torch.isfinite(z)
            gaps = self._gaps[to_torch(envs).long()].view(-1, 1, 1)
            obj = torch.where(torch.isfinite(obj) & known, obj - gaps, _NOWHERE_M).float()
            load = torch.where(known, to_torch(pressure), 0.0)
            height, found = solve_contact(
                self._compliance, obj, torch.nan_to_num(z), load, self._iterations
            )
            height = torch.where(known, height, torch.nan).contiguous()
        return self._to_pixels(height, found.contiguous(), count)

    def _to_pixels(self, height: Any, pressure: Any, count: int) -> tuple[wp.array, ...]:
        """The first rows of what pixels show of samples, tensors of float32."""
        grid = self._grid
        sizes = 1e-3 / self.points * np.array([grid.mm_per_px_x, grid.mm_per_px_y])
        outputs = [array[:count] for array in (self._samples, self._pressure, self._touched)]
        wp.launch(
            _pixels_kernel,
            dim=outputs[0].shape,
            inputs=[wp.from_torch(height), wp.from_torch(pressure), self.points, wp.vec2f(*sizes)],
            outputs=outputs,
            device=self._device,
        )
        return tuple(outputs)

    def _stream(self) -> AbstractContextManager[Any]:
        """Torch on the stream that Warp launches on."""
        if self._device.is_cpu:
            return nullcontext()
        import torch

        return torch.cuda.stream(wp.stream_to_torch(self._device))


def near_moduli(soft: SoftBody) -> tuple[float, float]:
    """Young's modulus [Pa] and Poisson's ratio of a gel next to its contact face, the mean of the
    tets there where they differ."""
    material = soft.material
    if not isinstance(material, MaterialField):
        return material.young_modulus_pa, material.poisson_ratio
    face = soft.mesh.region_nodes(Region.CONTACT)
    near = np.isin(soft.mesh.tets, face).any(axis=1)
    found = []
    for value in (material.young_modulus_pa, material.poisson_ratio):
        found.append(float(np.mean(np.broadcast_to(value, (len(soft.mesh.tets),))[near])))
    return found[0], found[1]


def pad_thickness_m(soft: SoftBody) -> float:
    """Height of the middle of the contact face over the deepest node [m]."""
    nodes = soft.mesh.nodes_m
    return float(np.median(nodes[soft.mesh.region_nodes(Region.CONTACT), 2]) - nodes[:, 2].min())
