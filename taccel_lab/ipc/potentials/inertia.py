# SPDX-License-Identifier: Apache-2.0
"""Inertia of implicit Euler as an incremental potential: 1/(2 dt^2) |x - x_tilde|_M^2 with the
prediction x_tilde = x + dt v + dt^2 g [Li et al. 2020, eq. 2]. Its gradient is in newtons."""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.reduce import sum_rows
from taccel_lab.model import Model

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _predict_kernel(
    positions: wp.array2d(dtype=wp.vec3d),
    velocities: wp.array2d(dtype=wp.vec3d),
    gravity: wp.vec3d,
    dt: wp.float64,
    predictions: wp.array2d(dtype=wp.vec3d),
):
    env, node = wp.tid()
    predictions[env, node] = positions[env, node] + dt * (velocities[env, node] + dt * gravity)


@wp.kernel
def _energy_kernel(
    active: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    predictions: wp.array2d(dtype=wp.vec3d),
    masses: wp.array2d(dtype=wp.float64),
    free_nodes: wp.array(dtype=wp.int32),
    inv_dt_sq: wp.float64,
    energies: wp.array2d(dtype=wp.float64),
):
    env, row = wp.tid()
    if active[env] == 0:
        return
    node = free_nodes[row]
    r = positions[env, node] - predictions[env, node]
    mass = masses[env % masses.shape[0], node]
    energies[env, row] = wp.float64(0.5) * mass * inv_dt_sq * wp.dot(r, r)


@wp.kernel
def _derivative_kernel(
    active: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    predictions: wp.array2d(dtype=wp.vec3d),
    masses: wp.array2d(dtype=wp.float64),
    free_nodes: wp.array(dtype=wp.int32),
    inv_dt_sq: wp.float64,
    gradient: wp.array2d(dtype=wp.vec3d),
):
    env, row = wp.tid()
    if active[env] == 0:
        return
    node = free_nodes[row]
    weight = masses[env % masses.shape[0], node] * inv_dt_sq
    gradient[env, node] += weight * (positions[env, node] - predictions[env, node])


@wp.kernel
def _hessian_kernel(
    active: wp.array(dtype=wp.int32),
    masses: wp.array2d(dtype=wp.float64),
    free_nodes: wp.array(dtype=wp.int32),
    diagonal: wp.array(dtype=wp.int32),
    inv_dt_sq: wp.float64,
    values: wp.array2d(dtype=wp.mat33d),
):
    env, row = wp.tid()
    if active[env] == 0:
        return
    weight = masses[env % masses.shape[0], free_nodes[row]] * inv_dt_sq
    values[env, diagonal[row]] += weight * wp.identity(n=3, dtype=wp.float64)


class InertiaPotential:
    """Inertia of the free nodes; not built for a quasi-static scene."""

    def __init__(self, model: Model) -> None:
        self.model = model
        shape = (model.env_count, model.free_count)
        self.energies = wp.zeros(shape, dtype=wp.float64, device=model.device)
        """Energy of each free node [J], shape [env_count, free_count]."""
        self._predictions = wp.zeros(
            (model.env_count, model.node_count), dtype=wp.vec3d, device=model.device
        )
        self._inv_dt_sq = 1.0 / model.scene.time.dt_s**2

    def begin_step(self, positions: wp.array, velocities: wp.array) -> None:
        """Predict where the nodes would go without forces other than gravity."""
        time = self.model.scene.time
        wp.launch(
            _predict_kernel,
            dim=positions.shape,
            inputs=[positions, velocities, wp.vec3d(*time.gravity_m_s2), time.dt_s],
            outputs=[self._predictions],
            device=self.model.device,
        )

    def _launch(self, kernel: wp.Kernel, active: wp.array, positions: wp.array, out) -> None:
        m = self.model
        wp.launch(
            kernel,
            dim=self.energies.shape,
            inputs=[active, positions, self._predictions, m.masses, m.free_nodes, self._inv_dt_sq],
            outputs=[out],
            device=m.device,
        )

    def energy(self, active: wp.array, positions: wp.array) -> np.ndarray:
        """Energy [J], shape [env_count]; stale where not active."""
        self._launch(_energy_kernel, active, positions, self.energies)
        return sum_rows(self.energies)

    def add_gradient(self, active: wp.array, positions: wp.array, gradient: wp.array) -> None:
        """Add d energy / dx [N]."""
        self._launch(_derivative_kernel, active, positions, gradient)

    def add_hessian(self, active: wp.array, values: wp.array) -> None:
        """Add M / dt^2 [N/m] to the diagonal blocks."""
        m = self.model
        wp.launch(
            _hessian_kernel,
            dim=self.energies.shape,
            inputs=[active, m.masses, m.free_nodes, m.diagonal, self._inv_dt_sq],
            outputs=[values],
            device=m.device,
        )
