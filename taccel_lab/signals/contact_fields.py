# SPDX-License-Identifier: Apache-2.0
r"""Contact, traction and sliding of the last step on the pixels of a gel's contact face.

All of it is the solver's: no threshold on depth or pressure says what touches.

- **Contact**: nodes that carry a contact force, which the solver's area-weighted contact makes its
  quadrature points. Between them a face counts as touched where the linear interpolant of
  "carries" (1 or 0) is at least one half, so that the edge lies half way between the last node that
  carries and the first that does not. A corner of quadratic elements has next to no area and hangs
  below chords that touch: it also counts where all middles of edges around it do.
- **Traction and pressure**: those of ``SurfaceLoad``, which are linear on each face.
- **Sliding**: that of ``Sliding``, linear between the nodes that know theirs, where there is
  contact; it is slipping there where at least half of it is at the limit of friction.

Pixels look at the flat faces between the nodes, at the first one that the camera's ray meets.
"""

# Warp compiles the kernels from their source; its type stubs describe neither vectors' operators
# nor FP64 overloads.
# pyright: reportArgumentType=false, reportAssignmentType=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, QuadraticMesh, TetMesh
from taccel_lab.model.env_rows import chosen_env
from taccel_lab.outputs.arrays import negated
from taccel_lab.outputs.sliding import Sliding, read_sliding
from taccel_lab.outputs.surface_load import Middles, SurfaceLoad, SurfaceLoadReader
from taccel_lab.signals.gradient_recovery import ContactFaceMesh
from taccel_lab.signals.markers import in_gel_frame
from taccel_lab.signals.raster import GridMap, barycentric, grid_map, pixel_xy, rasterize, xy_of
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.state import State

wp.set_module_options({"enable_backward": False})

CONTACT_SIGNALS = ("contact", "pressure_pa", "traction_pa", "slip_m", "slipping")
"""What pixels know of the solver's contact."""
_DTYPES = {
    "contact": wp.bool,
    "pressure_pa": wp.float32,
    "traction_pa": wp.vec3f,
    "slip_m": wp.vec3f,
    "slipping": wp.bool,
}


@wp.func
def _carries(env: int, node: int, forces: wp.array2d(dtype=wp.vec3d), middles: Middles) -> float:
    """1 for a node in contact, or one all of whose middles are; 0 for any other."""
    if wp.length_sq(forces[env, node]) > wp.float64(0.0):
        return 1.0
    first = middles.starts[node]
    end = middles.starts[node + 1]
    for k in range(first, end):
        if wp.length_sq(forces[env, middles.nodes[k]]) == wp.float64(0.0):
            return 0.0
    return wp.where(end > first, 1.0, 0.0)


@wp.func
def _into_gel(frames: wp.array(dtype=wp.transformd), env: int, vector: wp.vec3d) -> wp.vec3f:
    """A vector of the world in the gel's axes."""
    turned = vector
    if frames.shape[0] > 0:
        turned = wp.quat_rotate_inv(wp.transform_get_rotation(frames[env]), vector)
    return wp.vec3f(float(turned[0]), float(turned[1]), float(turned[2]))


@wp.kernel
def _gather_points_kernel(
    positions: wp.array2d(dtype=wp.vec3d),
    frames: wp.array(dtype=wp.transformd),
    envs: wp.array(dtype=wp.int32),
    node_idx: wp.array(dtype=wp.int32),
    # Out
    points: wp.array2d(dtype=wp.vec3d),
):
    row, node = wp.tid()
    env = chosen_env(envs, row)
    points[row, node] = in_gel_frame(frames, env, positions[env, node_idx[node]])


@wp.kernel
def _gather_load_kernel(
    forces: wp.array2d(dtype=wp.vec3d),
    tractions: wp.array2d(dtype=wp.vec3d),
    pressures: wp.array2d(dtype=wp.float64),
    middles: Middles,
    frames: wp.array(dtype=wp.transformd),
    envs: wp.array(dtype=wp.int32),
    node_idx: wp.array(dtype=wp.int32),
    # Out
    touched: wp.array2d(dtype=wp.float32),
    pressure: wp.array2d(dtype=wp.float32),
    traction: wp.array2d(dtype=wp.vec3f),
):
    row, i = wp.tid()
    env = chosen_env(envs, row)
    node = node_idx[i]
    touched[row, i] = _carries(env, node, forces, middles)
    pressure[row, i] = float(pressures[env, node])
    traction[row, i] = _into_gel(frames, env, tractions[env, node])


@wp.kernel
def _gather_slip_kernel(
    slips: wp.array2d(dtype=wp.vec3d),
    limits: wp.array2d(dtype=wp.float64),
    slipping: wp.array2d(dtype=wp.bool),
    middles: Middles,
    frames: wp.array(dtype=wp.transformd),
    envs: wp.array(dtype=wp.int32),
    node_idx: wp.array(dtype=wp.int32),
    # Out: slip, whether at the limit, whether known
    slip: wp.array2d(dtype=wp.vec3f),
    at_limit: wp.array2d(dtype=wp.float32),
    known: wp.array2d(dtype=wp.float32),
):
    row, i = wp.tid()
    env = chosen_env(envs, row)
    node = node_idx[i]
    total = limits[env, node]
    slipped = total * slips[env, node]
    limited = wp.float64(0.0)
    if slipping[env, node]:
        limited = total
    if total == wp.float64(0.0):
        # A corner that hangs below chords which touch moves with the middles around it.
        for k in range(middles.starts[node], middles.starts[node + 1]):
            middle = middles.nodes[k]
            weight = limits[env, middle]
            total += weight
            slipped += weight * slips[env, middle]
            if slipping[env, middle]:
                limited += weight
    slip[row, i] = wp.vec3f()
    at_limit[row, i] = 0.0
    known[row, i] = 0.0
    if total > wp.float64(0.0):
        slip[row, i] = _into_gel(frames, env, slipped / total)
        at_limit[row, i] = float(limited / total)
        known[row, i] = 1.0


@wp.func
def _weights(
    env: int,
    v: int,
    u: int,
    face: int,
    points: wp.array2d(dtype=wp.vec3d),
    faces: wp.array2d(dtype=wp.int32),
    grid: GridMap,
) -> wp.vec3f:
    """Barycentric coordinates of a pixel in its face."""
    found = barycentric(
        pixel_xy(grid, u, v),
        xy_of(points[env, faces[face, 0]]),
        xy_of(points[env, faces[face, 1]]),
        xy_of(points[env, faces[face, 2]]),
    )
    return wp.vec3f(float(found[0]), float(found[1]), float(found[2]))


@wp.kernel
def _load_pixels_kernel(
    points: wp.array2d(dtype=wp.vec3d),
    faces: wp.array2d(dtype=wp.int32),
    face_at_pixel: wp.array3d(dtype=wp.int32),
    grid: GridMap,
    touched: wp.array2d(dtype=wp.float32),
    pressure: wp.array2d(dtype=wp.float32),
    traction: wp.array2d(dtype=wp.vec3f),
    # Out; those that are None are not asked for
    contact: wp.array3d(dtype=wp.bool),
    pressure_pa: wp.array3d(dtype=wp.float32),
    traction_pa: wp.array3d(dtype=wp.vec3f),
):
    env, v, u = wp.tid()
    face = face_at_pixel[env, v, u]
    share = wp.float32(0.0)
    p = wp.float32(0.0)
    t = wp.vec3f()
    if face >= 0:
        w = _weights(env, v, u, face, points, faces, grid)
        for k in range(3):
            node = faces[face, k]
            share += w[k] * touched[env, node]
            p += w[k] * pressure[env, node]
            t += w[k] * traction[env, node]
    if contact:
        contact[env, v, u] = share >= 0.5
    if pressure_pa:
        pressure_pa[env, v, u] = p
    if traction_pa:
        traction_pa[env, v, u] = t


@wp.kernel
def _slip_pixels_kernel(
    points: wp.array2d(dtype=wp.vec3d),
    faces: wp.array2d(dtype=wp.int32),
    face_at_pixel: wp.array3d(dtype=wp.int32),
    grid: GridMap,
    touched: wp.array2d(dtype=wp.float32),
    slip: wp.array2d(dtype=wp.vec3f),
    at_limit: wp.array2d(dtype=wp.float32),
    known: wp.array2d(dtype=wp.float32),
    # Out; those that are None are not asked for
    slip_m: wp.array3d(dtype=wp.vec3f),
    slipping: wp.array3d(dtype=wp.bool),
):
    env, v, u = wp.tid()
    face = face_at_pixel[env, v, u]
    share = wp.float32(0.0)
    total = wp.float32(0.0)
    limited = wp.float32(0.0)
    slipped = wp.vec3f()
    if face >= 0:
        w = _weights(env, v, u, face, points, faces, grid)
        for k in range(3):
            node = faces[face, k]
            weight = w[k] * known[env, node]
            share += w[k] * touched[env, node]
            total += weight
            limited += weight * at_limit[env, node]
            slipped += weight * slip[env, node]
    if share < 0.5 or total <= 0.0:
        slipped = wp.vec3f()
        limited = 0.0
        total = 1.0
    if slip_m:
        slip_m[env, v, u] = slipped / total
    if slipping:
        slipping[env, v, u] = limited >= 0.5 * total


class ContactFields:
    """Contact signals of one gel of a solver's scene, in chunks of environments."""

    def __init__(
        self,
        solver: SolverIPC,
        gel: int,
        mesh: TetMesh | QuadraticMesh,
        grid: PixelGrid,
        *,
        chunk_envs: int,
    ) -> None:
        """
        Args:
            solver: Whose contact it is.
            gel: Index of the soft body.
            mesh: Its mesh with all its nodes.
            grid: Pixels of the image.
            chunk_envs: Most environments computed at a time.
        """
        model = solver.model
        self._solver = solver
        self._reader = SurfaceLoadReader(model)
        self._load: SurfaceLoad | None = None
        self._sliding: Sliding | None = None
        self._forces: list[wp.array] = []
        surface = ContactFaceMesh.from_mesh(mesh)
        device = self._device = model.device
        first = model.bodies[gel].node_slice.start
        self._node_idx = wp.array(surface.node_idx + first, dtype=wp.int32, device=device)
        self._faces = wp.array(surface.faces, dtype=wp.int32, device=device)
        self._grid, self._map = grid, grid_map(grid)
        nodes = (chunk_envs, surface.node_count)
        pixels = (chunk_envs, grid.height_px, grid.width_px)

        def scratch(shape: tuple[int, ...], dtype: Any) -> wp.array:
            return wp.empty(shape, dtype=dtype, device=device)

        self._points = scratch(nodes, wp.vec3d)
        self._nodal_load = [scratch(nodes, kind) for kind in (wp.float32, wp.float32, wp.vec3f)]
        self._nodal_slip = [scratch(nodes, kind) for kind in (wp.vec3f, wp.float32, wp.float32)]
        self._lowest_z = scratch(pixels, wp.float64)
        self._face_at_pixel = scratch(pixels, wp.int32)
        self._everyone = wp.full(chunk_envs, 1, dtype=wp.int32, device=device)

    def make(self, name: str, shape: tuple[int, int, int]) -> wp.array:
        """Memory of a signal, [env_count, height_px, width_px].

        Raises:
            InputError: Sliding of a scene without friction.
        """
        if name in ("slip_m", "slipping") and self._solver.friction is None:
            raise InputError(
                f"{name} needs friction: give the bodies of the scene a friction coefficient "
                "above 0"
            )
        return wp.empty(shape, dtype=_DTYPES[name], device=self._device)

    def read_nodes(self, state: State, names: set[str]) -> None:
        """Loads and sliding of all nodes that some signals need."""
        solver = self._solver
        solver.require_latest(state)
        if not self._forces:
            gradients = solver.contact_gradient, solver.friction_gradient
            self._forces = [wp.empty_like(gradient) for gradient in gradients]
            self._load = SurfaceLoad.empty(solver.model)
        negated(solver.contact_gradient, self._forces[0])
        negated(solver.friction_gradient, self._forces[1])
        self._reader.read(state.positions, *self._forces, into=self._load)
        if names & {"slip_m", "slipping"}:
            if self._sliding is None:
                self._sliding = Sliding.empty(solver)
            read_sliding(solver, state, self._sliding)

    def render(
        self, state: State, frames: wp.array, envs: wp.array, outputs: dict[str, wp.array]
    ) -> None:
        """Write signals of the environments ``envs`` (int32, as many as there are rows; all from
        the first on when empty), after ``read_nodes``.

        ``frames``: world_from_gel, transformd, [env_count], or of length 0 for none. ``outputs``:
        arrays of ``make`` by name, no more rows than ``chunk_envs``.
        """
        assert self._load is not None
        count = len(next(iter(outputs.values())))
        points, middles = self._points[:count], self._reader.middles
        where = [frames, envs, self._node_idx]
        self._launch(_gather_points_kernel, points.shape, [state.positions, *where], [points])
        lowest_z, faces_seen = self._lowest_z[:count], self._face_at_pixel[:count]
        lowest_z.fill_(np.inf)
        faces_seen.fill_(-1)
        rasterize(points, self._faces, self._grid, self._everyone, lowest_z, faces_seen)
        nodal = [array[:count] for array in self._nodal_load]
        load = [self._forces[0], self._load.tractions, self._load.pressures]
        self._launch(_gather_load_kernel, points.shape, [*load, middles, *where], nodal)
        shown = [points, self._faces, faces_seen, self._map]
        found = [outputs.get(name) for name in CONTACT_SIGNALS]
        if any(array is not None for array in found[:3]):
            self._launch(_load_pixels_kernel, faces_seen.shape, [*shown, *nodal], found[:3])
        if any(array is not None for array in found[3:]):
            assert self._sliding is not None
            slid = [array[:count] for array in self._nodal_slip]
            sliding = [self._sliding.slips, self._sliding.limits, self._sliding.slipping]
            self._launch(_gather_slip_kernel, points.shape, [*sliding, middles, *where], slid)
            inputs = [*shown, nodal[0], *slid]
            self._launch(_slip_pixels_kernel, faces_seen.shape, inputs, found[3:])

    def _launch(self, kernel: Any, dim: Any, inputs: list[Any], outputs: list[Any]) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self._device)
