# SPDX-License-Identifier: Apache-2.0
"""The face of a gel finer than its mesh: an object's surface where it touches, the gel elsewhere.

Heights and pressures of the coarse solution are sampled, and the contact with the object's own
surface is solved anew on the samples (``layer_contact``), on the device, in all environments
together. The object comes nearer by the mean gap that the barrier keeps: where it is pressed to is
where it shows. Lowered instead until it carries the force of the coarse solution, its heights were
2 to 26 um too low (elements of 0.18 to 0.8 mm under a contact 1 mm in radius) and images a tenth
worse, as nodes hang below faces that touch.

The one answer to what touches, too: samples with pressure. Contact radii of balls of 2 and 2.92 mm,
0.25 to 1.2 mm deep, are 0 to 2.5 % larger than on a mesh of six times as many nodes, where
different estimates differ by 1 to 2 %; docs/evidence/ablations.md has figures of tools with edges.
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
from taccel_lab.camera.gel_camera import View, face_of
from taccel_lab.geometry import Region
from taccel_lab.model.turns import in_turn
from taccel_lab.outputs.arrays import shared
from taccel_lab.outputs.contact_layer import mean_gaps
from taccel_lab.scene import SoftBody
from taccel_lab.signals.contact_fields import ContactFields
from taccel_lab.signals.deformed_face import DeformedFace, HangingCorners
from taccel_lab.signals.layer_contact import (
    NOWHERE_M,
    array_library,
    layer_compliance,
    solve_contact,
)
from taccel_lab.signals.object_heights import ObjectHeights, is_ball
from taccel_lab.signals.rest_surface import RestSurface
from taccel_lab.signals.surface_sampler import SurfaceSampler
from taccel_lab.signals.texture import Texture
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.state import State

wp.set_module_options({"enable_backward": False})

SAMPLE_MM, BALL_SAMPLE_MM = 0.03, 0.06
"""Distance at most at which surfaces are sampled, and those of balls without a texture, which bend
little within that; see docs/signals.md."""
CHUNK_SAMPLES = 2**24
"""Samples computed at a time, 100 to 200 bytes of scratch each."""


@wp.kernel
def _fine_pixels_kernel(
    heights: wp.array3d(dtype=wp.float32),
    pressures: wp.array3d(dtype=wp.float32),
    slopes: wp.array3d(dtype=wp.vec2f),
    points: int,
    sample_m: wp.vec2f,
    corrections: wp.array3d(dtype=wp.vec3f),
    beside: wp.array2d(dtype=wp.vec3f),
    envs: wp.array(dtype=wp.int32),
    # Out
    samples: wp.array3d(dtype=wp.vec3f),
    pressure: wp.array3d(dtype=wp.float32),
    touched: wp.array3d(dtype=wp.bool),
    counts: wp.array(dtype=wp.int32),
):
    """Mean height, slope of the mean normal, mean pressure of each pixel's samples: slopes of the
    object where it touches, those of the heights elsewhere, those of ``beside``, where it has any,
    in pixels that the face of the mesh does not fill. ``counts`` by environment."""
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
                own = slopes[env, j, i]
                if not wp.isnan(own[0] + own[1]):
                    dx = own[0]
                    dy = own[1]
            # Beside the pad there is no height.
            if not wp.isnan(dx + dy + z):
                total += z
                normal += wp.normalize(wp.vec3f(-dx, -dy, 1.0))
                count += 1
    sample = wp.vec3f(wp.nan, wp.nan, wp.nan)
    if count > 0:
        sample = wp.vec3f(-normal[0] / normal[2], -normal[1] / normal[2], total / float(count))
    touches = 2 * carrying >= points * points
    whole = count == points * points
    if corrections.shape[0] > 0 and not touches:
        correction = corrections[envs[env], v, u]
        if not wp.isnan(correction[2]):
            sample += correction
        else:
            whole = False
    if beside.shape[0] > 0 and not (whole or touches):
        if not wp.isnan(beside[v, u][2]):
            sample = beside[v, u]
    samples[env, v, u] = sample
    pressure[env, v, u] = load / float(points * points)
    touched[env, v, u] = touches
    if carrying > 0:
        wp.atomic_add(counts, envs[env], carrying)


class FineSurface:
    """Samples of the fine face of one gel under one rigid body, for many environments.

    It is what ``SignalTactile(..., fine=...)`` shows. On a GPU torch does the Fourier
    transforms, on the stream of the solver's device, and nothing waits for it.
    """

    @in_turn
    def __init__(
        self,
        solver: SolverIPC,
        body: str,
        grid: View,
        *,
        gel: int = 0,
        texture: Texture | None = None,
        designed_rest: RestSurface | None = None,
        points: int | None = None,
        env_count: int | None = None,
    ) -> None:
        """
        Args:
            solver: It keeps the forces of its last step.
            body: Name of the rigid body that touches, of the scene.
            grid: Pixels of the image, or the camera that sees it: then those over its gel.
            gel: Index of the gel among the soft bodies.
            texture: What stands out of the body's surface, which is its mean; the body must be
                kinematic. The solver does not know of it.
            designed_rest: The gel's contact face on those pixels where its mesh draws it more
                coarsely, see ``RestSurface.left_out_by``.
            points: A pixel is the mean over ``points`` x ``points`` samples; as many as lie
                ``SAMPLE_MM`` apart (``BALL_SAMPLE_MM``) when None.
            env_count: Most environments of one call; when None all of the model, as far as they
                have no more than ``CHUNK_SAMPLES``, and one on a CPU.

        Raises:
            InputError: No such body or gel.
        """
        model = solver.model
        soft = model.scene.soft_body(gel)
        mesh = soft.nodal_mesh
        grid = self.grid = face_of(grid)
        """Pixels over the gel."""
        self._solver = solver
        if points is None:
            smooth = texture is None and is_ball(model, body)
            sample_mm = BALL_SAMPLE_MM if smooth else SAMPLE_MM
            points = max(1, int(np.ceil(max(grid.mm_per_px_x, grid.mm_per_px_y) / sample_mm - 0.1)))
        self.points = points
        fine = grid.refined(points)
        if env_count is None:
            # On a CPU many at a time gain nothing.
            room = CHUNK_SAMPLES // (fine.width_px * fine.height_px) if model.device.is_cuda else 1
            env_count = min(model.env_count, max(1, room))
        rows = self.env_count = env_count
        device = self._device = model.device
        self._nodes = (int(model.bodies[gel].nodes[0]), int(model.bodies[gel].nodes[1]))
        self._object = ObjectHeights(model, body, fine, rows=rows, texture=texture)
        self._texture = texture
        first, last = self._nodes
        # In the gel's frame: the model has gels that are mounted in the frame of their mount.
        rest = np.zeros((model.env_count, model.node_count, 3))
        rest[:, first:last] = soft.nodal_rest_m
        at_rest = wp.array(rest, dtype=wp.vec3d, device=device)
        self._gel: SurfaceSampler | DeformedFace
        if is_ball(model, body):
            self._gel = SurfaceSampler(mesh, fine, env_count=rows, first_node=first, device=device)
        else:
            # Beside an edge the gel climbs a wall that is a few micrometres wide in the image.
            self._gel = DeformedFace(
                mesh, fine, env_count=rows, first_node=first, rest_positions=at_rest, device=device
            )
        self._corners = HangingCorners(model, gel)
        self._positions = wp.empty(
            (model.env_count, model.node_count), dtype=wp.vec3d, device=device
        )
        self._fields = ContactFields(solver, gel, mesh, fine, chunk_envs=rows)
        young, poisson = near_moduli(soft)
        compliance = layer_compliance(fine, young, poisson, pad_thickness_m(soft))
        self._compliance = shared(wp.array(compliance, dtype=wp.float32, device=device))
        over = (rows, fine.height_px, fine.width_px)
        self._coarse_pa = self._fields.make("pressure_pa", over)
        shape = (rows, grid.height_px, grid.width_px)
        self._samples = wp.empty(shape, dtype=wp.vec3f, device=device)
        self._pressure = wp.empty(shape, dtype=wp.float32, device=device)
        self._touched = wp.empty(shape, dtype=wp.bool, device=device)
        self._counts = wp.zeros(model.env_count, dtype=wp.int32, device=device)
        self._gaps: Any = None
        self._no_slopes = wp.full(over, wp.vec2f(wp.nan), dtype=wp.vec2f, device=device)
        self._corrections = wp.empty((0, 0, 0), dtype=wp.vec3f, device=device)
        self._beside = wp.empty((0, 0), dtype=wp.vec3f, device=device)
        shown = self._rest_of(at_rest, 0) if designed_rest is None else designed_rest.samples
        self.rest_samples = wp.array(shown, dtype=wp.vec3f, device=device)
        """Samples of the undeformed gel, vec3f, shape [height_px, width_px]."""
        if designed_rest is not None and not designed_rest.is_flat:
            # Far from a contact chords of the mesh cut the border of a dome's face.
            whole = np.where(designed_rest.covered[..., None], shown, np.nan)
            self._beside = wp.array(whole, dtype=wp.vec3f, device=device)
            meshed = (self._rest_of(at_rest, env) for env in range(model.env_count))
            corrections = np.stack([designed_rest.left_out_by(samples) for samples in meshed])
            self._corrections = wp.array(corrections, dtype=wp.vec3f, device=device)

    @property
    def contact_area_m2(self) -> np.ndarray:
        """Area in contact of the environments that were sampled last [m2], [env_count]; waits for
        the device."""
        grid = self.grid
        pixel_m2 = 1e-6 * grid.mm_per_px_x * grid.mm_per_px_y
        return self._counts.numpy() * (pixel_m2 / self.points**2)

    @property
    def pressed_n(self) -> float:
        """Sum of the pressures of the first environment that was sampled last, over the pixels of
        the face: force along its normal [N]; waits for the device."""
        grid = self.grid
        pixel_m2 = 1e-6 * grid.mm_per_px_x * grid.mm_per_px_y
        return float(self._pressure.numpy()[0].sum(dtype=np.float64)) * pixel_m2

    @in_turn
    def update(self, state: State) -> None:
        """Read nodal loads of the step that led to ``state``."""
        self._fields.read_nodes(state, {"pressure_pa"})
        gaps = mean_gaps(self._solver.collisions, state.positions, self._nodes)
        self._gaps = shared(gaps)
        wp.copy(self._positions, state.positions)
        self._corners.lift(self._positions, self._solver.contact_gradient)
        self._counts.zero_()

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
        count = len(envs)
        coarse = self._gel.sample(self._positions, frames, envs)
        pressure = self._coarse_pa[:count]
        self._fields.render(state, frames, envs, {"pressure_pa": pressure})
        *over, slopes = self._object.read(state, frames, envs)
        with self._stream():
            z = shared(coarse)[..., 2]
            xp = array_library(z)
            known = xp.isfinite(z)
            gaps = self._gaps[shared(envs)].reshape(-1, 1, 1)

            def lowered(heights: Any) -> Any:
                found = xp.empty_like(z)
                there = xp.isfinite(heights) & known
                found[:] = xp.where(there, heights - gaps, NOWHERE_M)
                return found

            under, smooth = (shared(heights) for heights in over)
            height, found = solve_contact(
                self._compliance,
                lowered(under),
                xp.nan_to_num(z),
                xp.where(known, shared(pressure), 0.0),
                smooth_m=None if self._texture is None else lowered(smooth),
            )
            height = xp.where(known, height, xp.nan)
        given = self._corrections, self._beside
        return self._to_pixels(height, found, slopes, *given, envs)

    def _rest_of(self, at_rest: wp.array, env: int) -> np.ndarray:
        """Samples of the gel's mesh at rest in one environment, [height_px, width_px, 3]."""
        envs = wp.array([env], dtype=wp.int32, device=self._device)
        no_frames = wp.empty(0, dtype=wp.transformd, device=self._device)
        height = shared(self._gel.sample(at_rest, no_frames, envs))[..., 2]
        none = (wp.empty((0,) * n, dtype=wp.vec3f, device=self._device) for n in (3, 2))
        found = self._to_pixels(height, height * 0, self._no_slopes[:1], *none, envs)
        self._counts.zero_()
        return found[0].numpy()[0].copy()

    def _to_pixels(
        self, height: Any, pressure: Any, slopes: wp.array, corrections: wp.array,
        beside: wp.array, envs: wp.array,
    ) -> tuple[wp.array, ...]:  # fmt: skip
        """What pixels show of samples; heights and pressures are of float32, as ``shared``."""
        grid = self.grid
        sizes = 1e-3 / self.points * np.array([grid.mm_per_px_x, grid.mm_per_px_y])
        outputs = [array[: len(envs)] for array in (self._samples, self._pressure, self._touched)]
        surface = [*map(self._on_device, (height, pressure)), slopes]
        wp.launch(
            _fine_pixels_kernel,
            dim=outputs[0].shape,
            inputs=[*surface, self.points, wp.vec2f(*sizes), corrections, beside, envs],
            outputs=[*outputs, self._counts],
            device=self._device,
        )
        return tuple(outputs)

    def _on_device(self, values: Any) -> wp.array:
        """Samples of numpy or torch as an array of the device."""
        if self._device.is_cpu:
            return wp.from_numpy(np.ascontiguousarray(values), dtype=wp.float32, device="cpu")
        return wp.from_torch(values.contiguous())

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
