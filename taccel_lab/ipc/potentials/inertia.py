# SPDX-License-Identifier: Apache-2.0
"""Inertia as an incremental potential: |x - x_tilde|_M^2 / (2 s^2), whose gradient is in newtons.

Implicit Euler: s = dt and x_tilde = x_n + s v_n + s^2 g [Li et al. 2020, eq. 2].

BDF2 with steps of unequal length [Hairer, Norsett and Wanner 1993, Solving Ordinary Differential
Equations I, sec. III.5]: r = dt / dt_previous, s = dt (1 + r) / (1 + 2 r), c = r^2 / (1 + 2 r),

    x = x_n + c (x_n - x_{n-1}) + s v,    v = v_n + c (v_n - v_{n-1}) + s M^-1 f(x)

so that x_tilde = X + s V + s^2 g with X and V the parts known beforehand. r = 0 is implicit Euler:
that is how a step without a past is taken, and one more than 1 + sqrt(2) times as long as the last,
where BDF2 is no longer zero-stable (ibid., theorem 5.5).

BDF2 carries a third of the last change of velocity on into the next step. After an impact, a jump
that no smooth motion explains, that third is energy out of nothing: a body that is stopped dead
leaves with half of its speed. A step in which the contact force on a body jumps is therefore taken
by implicit Euler, and so is the next one, which has no past then.
"""

from __future__ import annotations

import math

import numpy as np
import warp as wp

from taccel_lab.ipc.linear.problem.scatter import NewtonSystem
from taccel_lab.ipc.potentials.carried import add_carried_inertia
from taccel_lab.ipc.potentials.energy import Potential
from taccel_lab.model import Model
from taccel_lab.model.env_lists import EnvMask, Envs, env_at
from taccel_lab.model.launches import launch
from taccel_lab.state import StepHistory

wp.set_module_options({"enable_backward": False})

MAX_GROWTH = wp.constant(wp.float64(1.0 + math.sqrt(2.0)))
"""Largest ratio of a step to the one before for which BDF2 is zero-stable."""
JUMP = wp.constant(wp.float64(0.1))
"""Change of the contact force on a body in a step, over the larger of both, that is an impact;
where contact begins or ends it is 1. Cubes that fall, of 20 kPa to 2 MPa and stiff, flat and
tilted, gain no energy with it in steps of a thirtieth of a contact to a whole one. With 0.5 soft
cubes of ten-node tets gain up to 0.9 % of m g h in a step; where only the first touch counts,
14 %."""


@wp.func
def bdf2_ratio(dt: wp.float64, previous_dt: wp.float64) -> wp.float64:
    """dt / previous_dt, or 0 (implicit Euler) without a past and after a jump in step length."""
    if previous_dt <= wp.float64(0.0) or dt > MAX_GROWTH * previous_dt:
        return wp.float64(0.0)
    return dt / previous_dt


@wp.func
def bdf2_carry(ratio: wp.float64) -> wp.float64:
    """Part c of the last step's change that is carried on."""
    return ratio * ratio / (wp.float64(1.0) + wp.float64(2.0) * ratio)


@wp.func
def bdf2_span(dt: wp.float64, ratio: wp.float64) -> wp.float64:
    """s [s]: what a rate at the end of the step is multiplied by."""
    return dt * (wp.float64(1.0) + ratio) / (wp.float64(1.0) + wp.float64(2.0) * ratio)


@wp.kernel
def _span_kernel(
    mask: wp.array(dtype=wp.int32),
    dts: wp.array(dtype=wp.float64),
    previous_dts: wp.array(dtype=wp.float64),
    carries: wp.array(dtype=wp.float64),
    spans: wp.array(dtype=wp.float64),
):
    env = wp.tid()
    if mask:
        if mask[env] == 0:
            return
    ratio = wp.float64(0.0)
    if previous_dts:
        ratio = bdf2_ratio(dts[env], previous_dts[env])
    carries[env] = bdf2_carry(ratio)
    spans[env] = bdf2_span(dts[env], ratio)


@wp.kernel
def _predict_nodes_kernel(
    mask: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    velocities: wp.array2d(dtype=wp.vec3d),
    previous_positions: wp.array2d(dtype=wp.vec3d),
    previous_velocities: wp.array2d(dtype=wp.vec3d),
    carries: wp.array(dtype=wp.float64),
    spans: wp.array(dtype=wp.float64),
    gravity: wp.vec3d,
    gravity_scale: wp.array(dtype=wp.float64),
    node_bodies: wp.array(dtype=wp.int32),
    present: wp.array2d(dtype=wp.int32),
    anchors: wp.array2d(dtype=wp.vec3d),
    predictions: wp.array2d(dtype=wp.vec3d),
):
    env, node = wp.tid()
    if mask:
        if mask[env] == 0:
            return
    x = positions[env, node]
    v = velocities[env, node]
    anchor = x
    carried = v
    if carries[env] > wp.float64(0.0):
        anchor = x + carries[env] * (x - previous_positions[env, node])
        carried = v + carries[env] * (v - previous_velocities[env, node])
    s = spans[env]
    anchors[env, node] = anchor
    weight = gravity_scale[node]
    if present[env, node_bodies[node]] == 0:
        # A body that is not there rests where it is.
        weight = wp.float64(0.0)
    predictions[env, node] = anchor + s * (carried + s * weight * gravity)


@wp.kernel
def _inertia_energy_kernel(
    active: Envs,
    positions: wp.array2d(dtype=wp.vec3d),
    predictions: wp.array2d(dtype=wp.vec3d),
    masses: wp.array2d(dtype=wp.float64),
    nodes: wp.array(dtype=wp.int32),
    spans: wp.array(dtype=wp.float64),
    energies: wp.array2d(dtype=wp.float64),
):
    place, i = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    node = nodes[i]
    r = positions[env, node] - predictions[env, node]
    weight = masses[env % masses.shape[0], node] / (spans[env] * spans[env])
    energies[env, i] = wp.float64(0.5) * weight * wp.dot(r, r)


@wp.kernel
def _derivative_kernel(
    active: Envs,
    positions: wp.array2d(dtype=wp.vec3d),
    predictions: wp.array2d(dtype=wp.vec3d),
    masses: wp.array2d(dtype=wp.float64),
    nodes: wp.array(dtype=wp.int32),
    spans: wp.array(dtype=wp.float64),
    gradient: wp.array2d(dtype=wp.vec3d),
):
    place, i = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    node = nodes[i]
    weight = masses[env % masses.shape[0], node] / (spans[env] * spans[env])
    gradient[env, node] += weight * (positions[env, node] - predictions[env, node])


@wp.kernel
def _inertia_hessian_kernel(
    active: Envs,
    masses: wp.array2d(dtype=wp.float64),
    free_nodes: wp.array(dtype=wp.int32),
    diagonal: wp.array(dtype=wp.int32),
    spans: wp.array(dtype=wp.float64),
    values: wp.array2d(dtype=wp.mat33d),
):
    place, row = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    weight = masses[env % masses.shape[0], free_nodes[row]] / (spans[env] * spans[env])
    values[env, diagonal[row]] += weight * wp.identity(n=3, dtype=wp.float64)


@wp.kernel
def _finish_kernel(
    done: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    anchors: wp.array2d(dtype=wp.vec3d),
    spans: wp.array(dtype=wp.float64),
    velocities: wp.array2d(dtype=wp.vec3d),
):
    env, node = wp.tid()
    if done[env] != 0:
        velocities[env, node] = (positions[env, node] - anchors[env, node]) / spans[env]


@wp.kernel
def _remember_kernel(
    done: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    velocities: wp.array2d(dtype=wp.vec3d),
    dts: wp.array(dtype=wp.float64),
    jumped: wp.array(dtype=wp.int32),
    forces: wp.array2d(dtype=wp.float64),
    previous_positions: wp.array2d(dtype=wp.vec3d),
    previous_velocities: wp.array2d(dtype=wp.vec3d),
    previous_dts: wp.array(dtype=wp.float64),
    previous_forces: wp.array2d(dtype=wp.float64),
):
    env, node = wp.tid()
    if done[env] == 0:
        return
    previous_positions[env, node] = positions[env, node]
    previous_velocities[env, node] = velocities[env, node]
    if node == 0:
        previous_dts[env] = dts[env]
        if jumped[env] != 0:
            previous_dts[env] = wp.float64(0.0)
        for body in range(forces.shape[1]):
            previous_forces[env, body] = forces[env, body]


@wp.kernel
def _find_jumps_kernel(
    forces: wp.array2d(dtype=wp.float64),
    previous_forces: wp.array2d(dtype=wp.float64),
    carries: wp.array(dtype=wp.float64),
    least_force: wp.float64,
    jumped: wp.array(dtype=wp.int32),
    refused: wp.array(dtype=wp.int32),
):
    env = wp.tid()
    jumped[env] = 0
    refused[env] = 0
    for body in range(forces.shape[1]):
        now = forces[env, body]
        then = previous_forces[env, body]
        change = wp.abs(now - then)
        if change > least_force and change > JUMP * wp.max(now, then):
            jumped[env] = 1
            if carries[env] > wp.float64(0.0):
                refused[env] = 1


class InertiaPotential(Potential):
    """Inertia and weight of the nodes that move freely or with affine bodies; not built for a
    quasi-static scene."""

    def __init__(self, model: Model) -> None:
        self.model = model
        device = model.device
        self._nodes = model.free_nodes
        carried = model.affine.carried
        if len(carried):
            nodes = np.concatenate([model.free_nodes.numpy(), carried.numpy()])
            self._nodes = wp.array(nodes, dtype=wp.int32, device=device)
        shape = (model.env_count, len(self._nodes))
        self.energies = wp.zeros(shape, dtype=wp.float64, device=device)
        """Energy of each free and each carried node [J], shape [env_count, node_count of these]."""
        nodal = (model.env_count, model.node_count)
        self._anchors = wp.zeros(nodal, dtype=wp.vec3d, device=device)
        self.predictions = wp.zeros(nodal, dtype=wp.vec3d, device=device)
        """x_tilde of the step that was begun [m], vec3d, shape [env_count, node_count]."""
        self._carries = wp.zeros(model.env_count, dtype=wp.float64, device=device)
        self.spans = wp.zeros(model.env_count, dtype=wp.float64, device=device)
        """s of the step that was begun [s], float64, shape [env_count]."""
        self._jumped = wp.zeros(model.env_count, dtype=wp.int32, device=device)
        self._dts = wp.full(model.env_count, model.scene.time.dt_s, dtype=wp.float64, device=device)

    def begin_step(
        self,
        positions: wp.array,
        velocities: wp.array,
        dts: wp.array | None = None,
        history: StepHistory | None = None,
        mask: wp.array | None = None,
    ) -> None:
        """Predict where the nodes would go without forces other than gravity, in the environments
        of ``mask`` (int32, [env_count]); in all when None.

        ``dts``: length of the step [s], float64, shape [env_count]; the scene's when None.
        ``history``: the step before, for BDF2; implicit Euler without it.
        """
        m = self.model
        wp.copy(self._dts, dts) if dts is not None else self._dts.fill_(m.scene.time.dt_s)
        inputs = [mask, self._dts, history.dts if history else None, self._carries, self.spans]
        launch(_span_kernel, m.env_count, *inputs)
        inputs = [mask, positions, velocities, history.positions if history else positions]
        inputs += [history.velocities if history else velocities, self._carries, self.spans]
        inputs += [wp.vec3d(*m.scene.time.gravity_m_s2), m.gravity_scale, m.surface.node_bodies]
        inputs += [m.present, self._anchors, self.predictions]
        launch(_predict_nodes_kernel, positions.shape, *inputs)

    def find_jumps(
        self, forces: wp.array, history: StepHistory, least_force_n: float, refused: wp.array
    ) -> None:
        """Set ``refused`` (int32, [env_count]) where the step was one of BDF2 and the contact force
        on a body (``forces`` [N], [env_count, body_count]) has jumped, by more than
        ``least_force_n``."""
        inputs = [forces, history.forces, self._carries, least_force_n, self._jumped, refused]
        launch(_find_jumps_kernel, self.model.env_count, *inputs)

    def end_step(
        self,
        done: wp.array,
        start_positions: wp.array,
        positions: wp.array,
        velocities: wp.array,
        history: StepHistory | None = None,
        forces: wp.array | None = None,
    ) -> None:
        """Replace the velocities [m/s] by those at the end of the step that was begun, where
        ``done`` (int32, [env_count]) is set; the start of the step becomes the history, with the
        contact ``forces`` on the bodies [N], [env_count, body_count]."""
        if history is not None:
            forces = history.forces if forces is None else forces
            inputs = [done, start_positions, velocities, self._dts, self._jumped, forces]
            launch(_remember_kernel, positions.shape, *inputs, *history.arrays())
        launch(
            _finish_kernel, positions.shape, done, positions, self._anchors, self.spans, velocities
        )

    def _launch(self, kernel: wp.Kernel, active: EnvMask, positions: wp.array, out) -> None:
        m = self.model
        inputs = [active, positions, self.predictions, m.masses, self._nodes, self.spans, out]
        launch(kernel, self.energies.shape, *inputs)

    def write_energies(self, active: EnvMask, positions: wp.array) -> None:
        """Fill ``energies`` [J] of active environments."""
        self._launch(_inertia_energy_kernel, active, positions, self.energies)

    def add_gradient(self, active: EnvMask, positions: wp.array, gradient: wp.array) -> None:
        """Add d energy / dx [N]: mass times acceleration, less the weight."""
        self._launch(_derivative_kernel, active, positions, gradient)

    def add_hessian(
        self,
        active: EnvMask,
        positions: wp.array,
        system: NewtonSystem,
        psd_modes: wp.array | None = None,
    ) -> None:
        """Add M / s^2 [N/m] to the diagonal blocks; the same at all positions and definite. Carried
        nodes add to those of the control nodes and between them."""
        m = self.model
        inputs = [active, m.masses, m.free_nodes, m.diagonal, self.spans, system.values]
        launch(_inertia_hessian_kernel, (m.env_count, m.free_count), *inputs)
        if len(m.affine.carried):
            add_carried_inertia(m, active, self.spans, system.values)
