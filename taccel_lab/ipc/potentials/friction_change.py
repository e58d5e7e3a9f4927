# SPDX-License-Identifier: Apache-2.0
"""How friction changes along a displacement when nothing of it is frozen.

Frozen friction is a potential, and its Hessian in the Newton matrix is symmetric. What freezing
leaves out is not: friction follows the normal force and the tangent plane of its contact. This is
the exact derivative of ``contact_derivatives`` along the displacement, less that Hessian.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.contact.collision_lists import CollisionLists, ContactGeometry
from taccel_lab.ipc.contact.friction import friction_hessian
from taccel_lab.ipc.device.launches import launch
from taccel_lab.ipc.device.ragged_lists import list_end
from taccel_lab.ipc.device.sums import SumStage, add_vector
from taccel_lab.ipc.distance.derivatives import outer_rows
from taccel_lab.ipc.potentials.contact_derivatives import Change, combined, rows_at, rubbing
from taccel_lab.ipc.potentials.friction import (
    FrictionPotential,
    FrozenContacts,
    StepMotion,
    sliding,
)
from taccel_lab.ipc.potentials.stencil_rows import STENCIL_THREADS
from taccel_lab.model.env_rows import lane_count

wp.set_module_options({"enable_backward": False, "block_dim": STENCIL_THREADS})


@wp.kernel
def _friction_change_kernel(
    active: wp.array(dtype=wp.int32),
    lanes: int,
    lists: CollisionLists,
    geometry: ContactGeometry,
    pair_friction: wp.array3d(dtype=wp.float64),
    frozen: FrozenContacts,
    motion: StepMotion,
    eps_u: wp.array(dtype=wp.float64),
    sharpness: wp.array(dtype=wp.float64),
    displacements: wp.array2d(dtype=wp.vec3d),
    forces: wp.array2d(dtype=wp.vec3d),
    sums: SumStage,
):
    env, lane = wp.tid()
    if active[env] == 0:
        return
    for at in range(frozen.room.starts[env] + lane, list_end(env, frozen.room), lanes):
        nodes = frozen.stencils[at]
        w = frozen.weights[at]
        mu_lambda = frozen.mu_lambdas[at]
        first = geometry.node_bodies[nodes[0]]
        second = geometry.node_bodies[nodes[3]]
        mu = pair_friction[env % pair_friction.shape[0], first, second]
        by = Change()
        by.now = rows_at(env, nodes, displacements)
        friction = rubbing(env, at, lists, geometry, motion, eps_u[env], by)
        change = mu * friction.change
        if mu_lambda > wp.float64(0.0):
            u = sliding(env, at, frozen, motion)
            core = friction_hessian(frozen.normals[at], u, mu_lambda, eps_u[env], sharpness[env])
            change -= outer_rows(w, core * combined(w, by.now))
        for i in range(4):
            if w[i] != wp.float64(0.0):
                add_vector(env, nodes[i], change[i], forces, sums)


def add_friction_change(
    friction: FrictionPotential,
    active: wp.array,
    motion: StepMotion,
    sharpness: wp.array,
    displacements: wp.array,
    forces: wp.array,
) -> None:
    """Add to ``forces`` [N] by how much more the friction of all nodes changes along
    ``displacements`` [m] than its frozen Hessian of this ``sharpness`` says, in active
    environments, whose friction was frozen where they are, from their present collisions."""
    m, c = friction.model, friction.collisions
    lanes = lane_count(m.device, m.env_count, c.largest_room)
    for stage in friction.sums.stages():
        launch(
            _friction_change_kernel,
            dim=(m.env_count, lanes),
            inputs=[active, lanes, c.lists, c.geometry, m.pair_friction, friction.frozen, motion]
            + [friction.eps_u_m, sharpness, displacements, forces, stage],
            device=m.device,
        )
