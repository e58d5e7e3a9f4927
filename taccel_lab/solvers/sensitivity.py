# SPDX-License-Identifier: Apache-2.0
"""What a converged press would do if the tool went on, or if the gel were another.

At equilibrium the energy Pi(u, s; p) of nodes u, way s of the tool and parameters p has
Pi_u = 0, and the force on the tool along its way is F = Pi_s. The implicit function theorem gives
the motion of the nodes with the tool, one linear solve with the Hessian of the converged state,

    K u_s = -Pi_us,

and from it, because the parameters of a law act in the elastic forces g = Pi_u alone,

    dF/ds = Pi_ss + Pi_su u_s    and    dF/dp = g_p . u_s

(the adjoint: -Pi_su K^-1 g_p). So one solve serves all parameters. The Hessian is the exact one,
nothing is projected: at a stable equilibrium it is positive definite. Where it is not, as with
nodes about to slip over an edge of the tool, there is no slope.

It is what ``taccel_lab.gradients`` does, for a force along the way of the tool and without
friction, where a state has its slopes whatever led to it: u_s is minus the adjoint of that force.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.ipc.motion.unknowns import spread_solution
from taccel_lab.model.elastic import ElementArrays
from taccel_lab.scene import Material, MaterialField
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.solvers.tangent import Tangent
from taccel_lab.state import State


@dataclass(frozen=True)
class NodeRates:
    """How nodes go along with the tools of a converged state, u_s."""

    rates: wp.array
    """Motion over way [m/m], vec3d, shape [env_count, node_count]."""
    solved: np.ndarray
    """Whether the Hessian was positive definite and the system solved, bool, shape [env_count]."""
    cg_iterations: np.ndarray
    """Shape [env_count]."""


def node_rates(solver: SolverIPC, state: State, way: np.ndarray) -> NodeRates:
    """Motion of nodes while kinematic bodies translate along ``way``, from a converged state.

    Args:
        solver: Of a quasi-static scene of gels and kinematic bodies without friction, whose last
            step ended in ``state``.
        state: The equilibrium; it stays as it is.
        way: Direction of each kinematic body, usually of unit length,
            [env_count, kinematic_count, 3].

    Raises:
        InputError: A scene with friction, inertia or affine bodies.
    """
    model = solver.model
    if solver.friction is not None:
        raise InputError(
            "these are the slopes of gels without friction, where the state alone decides; with "
            "friction the way there counts: see taccel_lab.gradients"
        )
    moves = np.zeros((model.env_count, model.node_count, 3))
    moves[:, model.frame_nodes.numpy()] = np.asarray(way, dtype=np.float64)[
        :, model.frame_ids.numpy()
    ]
    tangent = Tangent(solver, state, moves)
    tangent.add_elements()
    tangent.add_contact()
    found = tangent.solve()
    spread_solution(model, tangent.active, solver.linear.solution, solver.displacements)
    solved = np.array([cause is None for cause in found.causes])
    return NodeRates(wp.clone(solver.displacements), solved, found.iterations)


def elastic_power(
    solver: SolverIPC,
    state: State,
    rates: NodeRates,
    groups: Sequence[ElementArrays] | None = None,
) -> np.ndarray:
    """Elastic forces times rates, g . u_s [N], shape [env_count]; NaN where rates are not solved.

    ``groups``: the elements of ``model.elastic`` with other moduli or volumes to take the forces
    with, see ``groups_of``; as they are when None. The difference over two gels beside the true
    one, over what they differ by, is the slope dF/dp; g is linear in the moduli, so that they may
    be very near.
    """
    gradient = elastic_gradient(solver, state, groups)
    power = np.einsum("enx,enx->e", gradient, rates.rates.numpy())
    return np.where(rates.solved, power, np.nan)


def elastic_gradient(
    solver: SolverIPC, state: State, groups: Sequence[ElementArrays] | None = None
) -> np.ndarray:
    """d(elastic energy)/dx of all nodes [N], shape [env_count, node_count, 3]; ``groups`` as those
    of ``elastic_power``."""
    active = wp.full(solver.model.env_count, 1, dtype=wp.int32, device=solver.model.device)
    gradient = wp.zeros_like(state.positions)
    for part, group in zip(solver.elastic, groups or solver.model.elastic, strict=True):
        data = part.data
        own = data.moduli.mu, data.moduli.lam, data.moduli.ratio, data.volumes
        data.moduli.mu, data.moduli.lam = group.mu, group.lam
        data.moduli.ratio, data.volumes = group.mooney_ratio, group.volumes
        try:
            part.add_gradient(active, state.positions, gradient)
        finally:
            data.moduli.mu, data.moduli.lam, data.moduli.ratio, data.volumes = own
    return gradient.numpy()


def groups_of(
    groups: Sequence[ElementArrays], materials: Sequence[Material | MaterialField]
) -> list[ElementArrays]:
    """The elements with the moduli of other materials of the same laws, one a soft body."""

    def put(group: ElementArrays, name: str) -> wp.array:
        values = [
            np.broadcast_to(getattr(materials[body], name), end - first)
            for body, first, end in group.bodies
        ]
        return wp.array(np.concatenate(values), dtype=wp.float64, device=group.mu.device)

    return [
        replace(
            group,
            mu=put(group, "shear_modulus_pa"),
            lam=put(group, "lame_lambda_pa"),
            mooney_ratio=put(group, "mooney_ratio")
            if len(group.mooney_ratio)
            else group.mooney_ratio,
        )
        for group in groups
    ]
