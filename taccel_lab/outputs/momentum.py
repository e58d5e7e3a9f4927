# SPDX-License-Identifier: Apache-2.0
"""Mass, momentum, angular momentum and kinetic energy of each body.

With lumped masses p = sum m v, L = sum m (x - c) x v, T = 1/2 sum m v^2. The control nodes y1..y3
of an affine body are vectors: they carry angular momentum m y x v and kinetic energy, and no
linear momentum, which is all in y0. For a body without deformation this is the rigid body's
p = M v and L = (x_c - c) x p + I w.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from taccel_lab.model import BodyKind, Model
from taccel_lab.model.launches import launch

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _momentum_kernel(
    first_nodes: wp.array(dtype=wp.int32),
    last_nodes: wp.array(dtype=wp.int32),
    masses: wp.array2d(dtype=wp.float64),
    is_point: wp.array(dtype=wp.float64),
    positions: wp.array2d(dtype=wp.vec3d),
    velocities: wp.array2d(dtype=wp.vec3d),
    center: wp.vec3d,
    linear: wp.array2d(dtype=wp.vec3d),
    angular: wp.array2d(dtype=wp.vec3d),
    kinetic: wp.array2d(dtype=wp.float64),
):
    env, body = wp.tid()
    rest = env % masses.shape[0]
    p = wp.vec3d()
    turn = wp.vec3d()
    energy = wp.float64(0.0)
    for node in range(first_nodes[body], last_nodes[body]):
        v = velocities[env, node]
        impulse = masses[rest, node] * v
        p += is_point[node] * impulse
        turn += wp.cross(positions[env, node] - is_point[node] * center, impulse)
        energy += wp.float64(0.5) * wp.dot(impulse, v)
    linear[env, body] = p
    angular[env, body] = turn
    kinetic[env, body] = energy


@wp.kernel
def _height_kernel(
    first_nodes: wp.array(dtype=wp.int32),
    last_nodes: wp.array(dtype=wp.int32),
    masses: wp.array2d(dtype=wp.float64),
    is_point: wp.array(dtype=wp.float64),
    positions: wp.array2d(dtype=wp.vec3d),
    gravity: wp.vec3d,
    energies: wp.array2d(dtype=wp.float64),
):
    env, body = wp.tid()
    total = wp.float64(0.0)
    for node in range(first_nodes[body], last_nodes[body]):
        weight = is_point[node] * masses[env % masses.shape[0], node]
        total -= weight * wp.dot(gravity, positions[env, node])
    energies[env, body] = total


@dataclass(frozen=True)
class Momentum:
    """Momenta and energies of each body; sums over axis 1 are those of the environment. Kinematic
    bodies count zero."""

    linear: wp.array
    """[kg m/s], vec3d, shape [env_count, body_count]."""
    angular: wp.array
    """Angular momentum about the point asked for [kg m^2/s], vec3d, shape [env_count,
    body_count]."""
    kinetic_energy: wp.array
    """[J], float64, shape [env_count, body_count]."""


class MomentumReader:
    """Reads momenta of a model's states."""

    def __init__(self, model: Model) -> None:
        self.model = model
        ranges = np.zeros((len(model.bodies), 2), dtype=np.int32)
        affine = 0
        for index, body in enumerate(model.bodies):
            if body.kind is BodyKind.SOFT:
                ranges[index] = body.nodes
            elif body.kind is BodyKind.AFFINE:
                first = model.affine.first_control + 4 * affine
                ranges[index] = first, first + 4
                affine += 1
        self._first = wp.array(ranges[:, 0].copy(), dtype=wp.int32, device=model.device)
        self._last = wp.array(ranges[:, 1].copy(), dtype=wp.int32, device=model.device)

    def read(
        self,
        positions: wp.array,
        velocities: wp.array,
        center_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> Momentum:
        """Momenta about ``center_m`` of nodes [env_count, node_count] [m], [m/s]."""
        m = self.model
        shape = (m.env_count, len(m.bodies))
        result = Momentum(
            wp.zeros(shape, dtype=wp.vec3d, device=m.device),
            wp.zeros(shape, dtype=wp.vec3d, device=m.device),
            wp.zeros(shape, dtype=wp.float64, device=m.device),
        )
        inputs = [self._first, self._last, m.masses, m.gravity_scale, positions, velocities]
        inputs += [wp.vec3d(*center_m), result.linear, result.angular, result.kinetic_energy]
        launch(_momentum_kernel, shape, *inputs)
        return result

    def read_weight_energy(self, positions: wp.array) -> wp.array:
        """Potential energy -sum m g . x in the scene's gravity [J], float64, [env, body]."""
        m = self.model
        energies = wp.zeros((m.env_count, len(m.bodies)), dtype=wp.float64, device=m.device)
        inputs = [self._first, self._last, m.masses, m.gravity_scale, positions]
        launch(
            _height_kernel, energies.shape, *inputs, wp.vec3d(*m.scene.time.gravity_m_s2), energies
        )
        return energies
