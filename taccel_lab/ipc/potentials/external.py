# SPDX-License-Identifier: Apache-2.0
"""Given loads: nodal forces, and wrenches on affine bodies. Energy -f . (x - x_start).

A force on an affine body acts on its centre of mass y0. A torque tau about it becomes forces on the
control nodes y1..y3, with directions a_k = y_k / |y_k| of the start of the step,

    f_k = tau x y_k / (2 |y_k|^2).

Turned by d theta, the control nodes move by d theta x y_k, and the work is
sum_k f_k . (d theta x y_k) = d theta . sum_k y_k x f_k, where y_k x (tau x y_k) / |y_k|^2 =
tau - a_k (a_k . tau). For orthonormal a_k these sum to 3 tau - tau, so that the work is
tau . d theta. Of all forces that do this work the f_k are those that do none on stretching along
the axes (f_k . a_k = 0). Loads keep their value and direction within a step.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.linear.problem.scatter import NewtonSystem
from taccel_lab.ipc.potentials.energy import Potential
from taccel_lab.model import Model
from taccel_lab.model.env_lists import EnvMask, Envs, env_at
from taccel_lab.model.env_rows import copy_rows
from taccel_lab.model.launches import launch

wp.set_module_options({"enable_backward": False})


@wp.func
def torque_control_force(torque: wp.vec3d, y: wp.vec3d) -> wp.vec3d:
    """Force [N] on a control node y1, y2 or y3 [m]; the three do the work of the torque [N m]."""
    return wp.cross(torque, y) / (wp.float64(2.0) * wp.dot(y, y))


@wp.kernel
def _wrench_kernel(
    mask: wp.array(dtype=wp.int32),
    control_starts: wp.array(dtype=wp.int32),
    wrenches: wp.array3d(dtype=wp.vec3d),
    positions: wp.array2d(dtype=wp.vec3d),
    loads: wp.array2d(dtype=wp.vec3d),
):
    env, body = wp.tid()
    if mask:
        if mask[env] == 0:
            return
    first = control_starts[body]
    loads[env, first] += wrenches[env, body, 0]
    torque = wrenches[env, body, 1]
    for k in range(1, 4):
        loads[env, first + k] += torque_control_force(torque, positions[env, first + k])


@wp.kernel
def _load_energy_kernel(
    active: Envs,
    positions: wp.array2d(dtype=wp.vec3d),
    start_positions: wp.array2d(dtype=wp.vec3d),
    loads: wp.array2d(dtype=wp.vec3d),
    energies: wp.array2d(dtype=wp.float64),
):
    place, node = wp.tid()
    env = env_at(place, active)
    if env >= 0:
        moved = positions[env, node] - start_positions[env, node]
        energies[env, node] = -wp.dot(loads[env, node], moved)


@wp.kernel
def _load_gradient_kernel(
    active: Envs,
    loads: wp.array2d(dtype=wp.vec3d),
    gradient: wp.array2d(dtype=wp.vec3d),
):
    place, node = wp.tid()
    env = env_at(place, active)
    if env >= 0:
        gradient[env, node] -= loads[env, node]


class ExternalLoad(Potential):
    """The loads of one step of all environments."""

    def __init__(self, model: Model) -> None:
        self.model = model
        nodal = (model.env_count, model.node_count)
        self._loads = wp.zeros(nodal, dtype=wp.vec3d, device=model.device)
        self._start = wp.zeros(nodal, dtype=wp.vec3d, device=model.device)
        self.energies = wp.zeros(nodal, dtype=wp.float64, device=model.device)
        """Energy of each node since the start of the step [J], shape [env_count, node_count]."""

    def begin_step(
        self,
        positions: wp.array,
        forces: wp.array,
        wrenches: wp.array,
        mask: wp.array | None = None,
    ) -> None:
        """Gather the loads of this step in the environments of ``mask`` (int32, [env_count]), in
        all when None; torques act on the bodies as they stand now.

        ``forces`` on nodes [N], vec3d, shape [env_count, node_count]: those on vertices of affine
        bodies, and on bonded nodes that these carry, act on the body, those on prescribed nodes on
        nothing. ``wrenches``: force [N] and
        torque about the centre of mass [N m] of affine bodies in world axes, vec3d, shape
        [env_count, affine_count, 2].
        """
        m = self.model
        for source, kept in ((positions, self._start), (forces, self._loads)):
            if mask is None:
                wp.copy(kept, source)
            else:
                copy_rows(mask, source, kept)
        if m.affine.count:
            inputs = [mask, m.affine.control_starts, wrenches, positions, self._loads]
            launch(_wrench_kernel, (m.env_count, m.affine.count), *inputs)

    def write_energies(self, active: EnvMask, positions: wp.array) -> None:
        """Fill ``energies`` [J] of active environments."""
        inputs = [active, positions, self._start, self._loads, self.energies]
        launch(_load_energy_kernel, positions.shape, *inputs)

    def add_gradient(self, active: EnvMask, positions: wp.array, gradient: wp.array) -> None:
        """Add -f [N]."""
        launch(_load_gradient_kernel, positions.shape, active, self._loads, gradient)

    def add_hessian(
        self,
        active: EnvMask,
        positions: wp.array,
        system: NewtonSystem,
        psd_modes: wp.array | None = None,
    ) -> None:
        """Nothing: the energy is linear."""


def traction_forces(
    positions: np.ndarray, faces: np.ndarray, traction_pa: np.ndarray
) -> np.ndarray:
    """Nodal forces of a traction on faces, a third of each face's on each corner.

    Args:
        positions: Nodes [m], shape [env, node, 3]: at rest for a dead load per area of the
            undeformed surface, deformed for one per deformed area (as at the start of a step).
        faces: Nodes of the loaded faces, shape [n, 3].
        traction_pa: Force per area, shape [3], [n, 3] or [env, n, 3].

    Returns:
        Forces [N], shape [env, node, 3].
    """
    p = positions[:, faces]
    normals = np.cross(p[:, :, 1] - p[:, :, 0], p[:, :, 2] - p[:, :, 0])
    areas = 0.5 * np.linalg.norm(normals, axis=2, keepdims=True)
    return _spread_over_corners(areas * traction_pa / 3.0, faces, positions.shape[1])


def pressure_forces(
    positions: np.ndarray, faces: np.ndarray, pressure_pa: np.ndarray | float
) -> np.ndarray:
    """Nodal forces [N] of a pressure against the outward normal of faces as they stand.

    ``positions``: [env, node, 3] [m]; ``faces``: [n, 3]; ``pressure_pa``: one number, [n] or
    [env, n]. Set anew before each step the load follows the surface. Returns [env, node, 3].
    """
    p = positions[:, faces]
    normals = np.cross(p[:, :, 1] - p[:, :, 0], p[:, :, 2] - p[:, :, 0])
    pressure = np.broadcast_to(pressure_pa, normals.shape[:2])[..., None]
    return _spread_over_corners(-pressure * normals / 6.0, faces, positions.shape[1])


def _spread_over_corners(shares: np.ndarray, faces: np.ndarray, node_count: int) -> np.ndarray:
    """Add shares [env, n, 3] to the three corners of their faces; result [env, node, 3]."""
    forces = np.zeros((len(shares), node_count, 3))
    for env, share in enumerate(shares):
        for corner in range(3):
            np.add.at(forces[env], faces[:, corner], share)
    return forces
