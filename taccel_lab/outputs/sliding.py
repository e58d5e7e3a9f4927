# SPDX-License-Identifier: Apache-2.0
"""How far surfaces slid in a step, by node: what friction acted on.

Friction knows each contact's sliding u since the start of the step, or since the two touched if
that was later (``ipc.potentials.friction.sliding``), and its limit mu lambda. A node may have
several contacts, each with a weight w_c of it (its part of the closest point, negative on the
second of the two bodies):

    slip_i = sum_c w_c mu lambda_c u_c / sum_c |w_c| mu lambda_c

so that it is how far the node slid over what it touches, on either side. Below eps_u, the range of
static friction of the step, it sticks: friction there is below its limit and what slid is the creep
that stands for a hold; from eps_u on friction is at the limit.
"""

from __future__ import annotations

from dataclasses import dataclass

import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.ipc.device.ragged_lists import list_end
from taccel_lab.ipc.potentials.friction import FrozenContacts, StepMotion, sliding
from taccel_lab.model.env_rows import lane_count
from taccel_lab.model.launches import launch
from taccel_lab.model.turns import in_turn
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.state import State

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _add_sliding_kernel(
    lanes: int,
    frozen: FrozenContacts,
    motion: StepMotion,
    slips: wp.array2d(dtype=wp.vec3d),
    limits: wp.array2d(dtype=wp.float64),
):
    env, lane = wp.tid()
    for at in range(frozen.room.starts[env] + lane, list_end(env, frozen.room), lanes):
        u = sliding(env, at, frozen, motion)
        limit = frozen.mu_lambdas[at]
        w = frozen.weights[at]
        nodes = frozen.stencils[at]
        for i in range(4):
            if w[i] != wp.float64(0.0):
                wp.atomic_add(slips, env, nodes[i], w[i] * limit * u)
                wp.atomic_add(limits, env, nodes[i], wp.abs(w[i]) * limit)


@wp.kernel
def _mean_sliding_kernel(
    eps_u: wp.array(dtype=wp.float64),
    slips: wp.array2d(dtype=wp.vec3d),
    limits: wp.array2d(dtype=wp.float64),
    slipping: wp.array2d(dtype=wp.bool),
):
    env, node = wp.tid()
    limit = limits[env, node]
    slip = wp.vec3d()
    # Duplicates of a contact are subtracted: what is left of all of them is rounding.
    if limit > wp.float64(0.0):
        slip = slips[env, node] / limit
    else:
        limits[env, node] = wp.float64(0.0)
    slips[env, node] = slip
    slipping[env, node] = wp.length(slip) >= eps_u[env]


@dataclass(frozen=True)
class Sliding:
    """Sliding by node, shape [env_count, node_count]; zero where a node has no contact with
    friction."""

    slips: wp.array
    """How far the node slid over what it touches, in the last step or its last part where it was
    halved, in the axes of the world [m], vec3d. Over the length of that (``SolverIPC.dts``) it is a
    velocity."""
    limits: wp.array
    """Largest friction that its contacts can bear, mu times their normal force [N], float64."""
    slipping: wp.array
    """Whether friction is at that limit, bool."""

    @classmethod
    def empty(cls, solver: SolverIPC) -> Sliding:
        """Memory of a model's size."""
        shape, device = (solver.model.env_count, solver.model.node_count), solver.model.device
        return cls(
            slips=wp.empty(shape, dtype=wp.vec3d, device=device),
            limits=wp.empty(shape, dtype=wp.float64, device=device),
            slipping=wp.empty(shape, dtype=wp.bool, device=device),
        )


@in_turn
def read_sliding(solver: SolverIPC, state: State, into: Sliding | None = None) -> Sliding:
    """Sliding of the step that led to ``state``; does not wait for the device.

    Raises:
        InputError: A scene without friction, in which nothing holds.
    """
    friction = solver.friction
    if friction is None:
        raise InputError(
            "sliding needs friction: give the bodies of the scene a friction coefficient above 0"
        )
    solver.require_latest(state)
    result = Sliding.empty(solver) if into is None else into
    result.slips.zero_()
    result.limits.zero_()
    device, env_count = solver.model.device, solver.model.env_count
    lanes = lane_count(device, env_count, solver.collisions.largest_room)
    motion = solver.motion_to(state.positions, state.poses)
    inputs = [lanes, friction.frozen, motion, result.slips, result.limits]
    launch(_add_sliding_kernel, (env_count, lanes), *inputs)
    inputs = [friction.eps_u_m, result.slips, result.limits, result.slipping]
    launch(_mean_sliding_kernel, result.slips.shape, *inputs)
    return result
