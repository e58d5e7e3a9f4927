# SPDX-License-Identifier: Apache-2.0
"""Orthogonality energy of all affine bodies: one thread per environment and body.

A body's blocks belong to it alone, so nothing here depends on the order of execution.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.affine.rigidity import (
    body_map,
    orthogonality_block,
    orthogonality_energy,
    orthogonality_gradient,
    orthogonality_hessian,
)
from taccel_lab.ipc.linear.problem.scatter import NewtonSystem, add_block
from taccel_lab.ipc.potentials.energy import Potential
from taccel_lab.model import Model
from taccel_lab.model.env_lists import EnvMask, Envs, env_at
from taccel_lab.model.launches import WARP_THREADS, launch

wp.set_module_options({"enable_backward": False, "block_dim": WARP_THREADS})


@wp.kernel
def _affine_energy_kernel(
    active: Envs,
    positions: wp.array2d(dtype=wp.vec3d),
    control_starts: wp.array(dtype=wp.int32),
    lengths: wp.array(dtype=wp.float64),
    stiffness: wp.array(dtype=wp.float64),
    energies: wp.array2d(dtype=wp.float64),
):
    place, body = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    a = body_map(env, control_starts[body], lengths[body], positions)
    energies[env, body] = orthogonality_energy(a, stiffness[body])


@wp.kernel
def _affine_gradient_kernel(
    active: Envs,
    positions: wp.array2d(dtype=wp.vec3d),
    control_starts: wp.array(dtype=wp.int32),
    lengths: wp.array(dtype=wp.float64),
    stiffness: wp.array(dtype=wp.float64),
    gradient: wp.array2d(dtype=wp.vec3d),
):
    place, body = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    start = control_starts[body]
    length = lengths[body]
    a = body_map(env, start, length, positions)
    g = orthogonality_gradient(a, length, stiffness[body])
    for k in range(3):
        gradient[env, start + 1 + k] += wp.vec3d(g[0, k], g[1, k], g[2, k])


@wp.kernel
def _affine_hessian_kernel(
    active: Envs,
    positions: wp.array2d(dtype=wp.vec3d),
    control_starts: wp.array(dtype=wp.int32),
    lengths: wp.array(dtype=wp.float64),
    stiffness: wp.array(dtype=wp.float64),
    psd_modes: wp.array(dtype=wp.int32),
    system: NewtonSystem,
):
    place, body = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    start = control_starts[body]
    length = lengths[body]
    a = body_map(env, start, length, positions)
    h = orthogonality_hessian(a, stiffness[body], psd_modes[env])
    # Held in a variable: nine inlined copies of a block would only take longer to compile.
    count = int(3)
    for i in range(count):
        for j in range(count):
            block = orthogonality_block(h, length, i, j)
            add_block(env, start + 1 + i, start + 1 + j, block, system)


class AffinePotential(Potential):
    """Keeps affine bodies rigid; built only for a scene that has some."""

    def __init__(self, model: Model) -> None:
        self.model = model
        a = model.affine
        self._bodies = [a.control_starts, a.lengths, a.stiffness]
        self.energies = wp.zeros(
            (model.env_count, a.control_starts.shape[0]), dtype=wp.float64, device=model.device
        )
        """Energy of each affine body [J], shape [env_count, affine_count]."""
        noise = np.finfo(float).eps * a.stiffness.numpy() / a.lengths.numpy()
        self.rounding_n = float(4 * np.linalg.norm(noise))
        """Residual that rounding of the positions alone causes [N]."""
        self.energy_rounding = float(4 * np.finfo(float).eps * np.sqrt(a.stiffness.numpy().sum()))
        """Rounding of the energy over the root of the energy [J^(1/2)].

        The energy E V |G|^2 / 2 of a strain G, all of whose entries are rounded, is in doubt by
        about 3 eps E V |G| = 3 eps (2 E V e)^(1/2), and that of all bodies by no more than what
        their energy and stiffness together would be.
        """

    def write_energies(self, active: EnvMask, positions: wp.array) -> None:
        """Fill ``energies`` [J] of active environments."""
        inputs = [active, positions, *self._bodies, self.energies]
        launch(_affine_energy_kernel, self.energies.shape, *inputs)

    def add_gradient(self, active: EnvMask, positions: wp.array, gradient: wp.array) -> None:
        """Add d energy / dx [N], shape [env_count, node_count]."""
        inputs = [active, positions, *self._bodies, gradient]
        launch(_affine_gradient_kernel, self.energies.shape, *inputs)

    def add_hessian(
        self, active: EnvMask, positions: wp.array, system: NewtonSystem, psd_modes: wp.array
    ) -> None:
        """Add d^2 energy / dx^2 [N/m] to the Newton system; ``psd_modes``: PSD_* of each
        environment."""
        inputs = [active, positions, *self._bodies, psd_modes, system]
        launch(_affine_hessian_kernel, self.energies.shape, *inputs)
