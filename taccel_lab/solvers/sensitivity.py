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
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.ipc.elasticity.principal import PSD_NONE
from taccel_lab.ipc.motion import newton_system, spread_solution
from taccel_lab.model.elastic import ElementArrays
from taccel_lab.scene import Material, MaterialField
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.state import State

LINEAR_TOLERANCE = 1e-7
"""Of the solve."""
_MORE_ITERATIONS = 5
"""Times the iterations of a Newton step, which is solved a hundred times less exactly."""


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
    if solver.friction is not None or solver.inertia is not None or solver.affine is not None:
        raise InputError(
            "sensitivities are those of quasi-static gels without friction; lagged friction has no "
            "energy whose second derivatives are the slopes of the forces"
        )
    active = wp.full(model.env_count, 1, dtype=wp.int32, device=model.device)
    exact = wp.full(model.env_count, PSD_NONE, dtype=wp.int32, device=model.device)
    _find_contacts(solver, state, active)
    moves = np.zeros((model.env_count, model.node_count, 3))
    moves[:, model.frame_nodes.numpy()] = np.asarray(way, dtype=np.float64)[
        :, model.frame_ids.numpy()
    ]
    solver.displacements.assign(moves)
    linear, x = solver.linear, state.positions
    system = newton_system(model, linear, solver.displacements)
    while True:
        linear.values.zero_()
        linear.rhs.zero_()
        linear.extra.clear()
        solver.contact.add_hessian(active, x, system, exact)
        for part in solver.elastic:
            part.add_hessian(active, x, system, exact)
        if not linear.extra.fit():
            break
        system = newton_system(model, linear, solver.displacements)
    linear.tolerances.fill_(LINEAR_TOLERANCE)
    linear.solve(active, _MORE_ITERATIONS * solver.config.max_cg_iterations)
    report = linear.report()
    solved = ~report.breakdown & (report.relative_residual < 10 * LINEAR_TOLERANCE)
    spread_solution(model, active, linear.solution, solver.displacements)
    return NodeRates(wp.clone(solver.displacements), solved, report.iterations)


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
    power = np.einsum("enx,enx->e", gradient.numpy(), rates.rates.numpy())
    return np.where(rates.solved, power, np.nan)


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


def _find_contacts(solver: SolverIPC, state: State, active: wp.array) -> None:
    """Collisions at the positions of ``state``."""
    room = [part.capacity for part in solver.lists]
    solver.displacements.zero_()
    solver.candidates.update(
        active, state.positions, solver.displacements, state.poses, state.poses,
        solver.config.dhat_m,
    )  # fmt: skip
    solver.pairs.forget(active)
    solver.collisions.update(active, state.positions, solver.candidates)
    if [part.capacity for part in solver.lists] != room:
        solver.graphs.clear()
