# SPDX-License-Identifier: Apache-2.0
"""How much of a force the guard against inside-out tets is answerable for.

The guard keeps the Bernstein coefficients b_a of det F above zero by forces that no material asks
for (``ipc.elasticity.volume_bounds``). Take it for bounds, b_a >= t_a, with the multipliers
p_a = -w g'(b_a) that the balance of forces has found. Lowering all bounds from where the b_a are to
zero changes the energy by -sum_a p_a b_a to first order, and the force that does work along a
parameter d by the derivative of that,

    -sum_a b_a dp_a/dd = sum_a w b_a g''(b_a) db_a/dd = h . dx/dd,

with the load h = sum_a w b_a g''(b_a) db_a/dx. The guard's own force, w g' db_a/dx, says something
else: it is in balance with the element's, and mostly stays inside the gel.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from taccel_lab.bodies.bodies import Element
from taccel_lab.ipc.elasticity.volume_bounds import COEFFICIENTS, ratio_barrier
from taccel_lab.ipc.potentials.elements.data import ElementData, ElementSum, modulus_index
from taccel_lab.ipc.potentials.elements.inversion import BEARS_INVERSION
from taccel_lab.ipc.potentials.elements.quadratic_shape import (
    GUARD_WEIGHT,
    guard_coefficient,
    guard_gradient,
    needs_guard,
    row_of,
)
from taccel_lab.model import BodyKind
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.solvers.tangent import Tangent
from taccel_lab.state import State

MOST_SHARE = 0.01
"""Part of a force that the guard may be answerable for unsaid [1]."""

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _guard_load_kernel(
    active: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    d: ElementData,
    parts: wp.array3d(dtype=wp.vec3d),
):
    env, tet = wp.tid()
    if active[env] == 0:
        return
    for a in range(d.nodes.shape[1]):
        parts[env, tet, a] = wp.vec3d()
    if not needs_guard(env, tet, positions, d):
        return
    volume = d.volumes[env % d.volumes.shape[0], tet]
    weight = volume * GUARD_WEIGHT * d.moduli.mu[modulus_index(env, tet, d)]
    q = int(0)
    while q < COEFFICIENTS:
        b = guard_coefficient(env, tet, q, positions, d)
        stiffness = ratio_barrier(b)[2]
        if stiffness != wp.float64(0.0):
            rows = (weight * b * stiffness) * guard_gradient(env, tet, q, positions, d)
            for a in range(d.nodes.shape[1]):
                parts[env, tet, a] = parts[env, tet, a] + row_of(rows, a)
        q += 1


def add_guard_load(
    parts: Sequence[ElementSum], active: wp.array, positions: wp.array, load: wp.array
) -> None:
    """Add h [N] to ``load``, vec3d, [env_count, node_count], in the environments of ``active``;
    exactly zero where no tet of ``parts`` is near turning inside out."""
    for part in parts:
        if part.group.element is Element.QUADRATIC and part.group.law not in BEARS_INVERSION:
            part.write_forces(active, positions, _guard_load_kernel)
            part.gather_forces(active, load)


def guard_shares(solver: SolverIPC, state: State) -> np.ndarray:
    """Part of the force on each kinematic body, along that force, that depends on the guard:
    ``guard_force`` over it [1], [env_count, kinematic_count]; 0 of bodies without a force."""
    nodal = -(solver.contact_gradient.numpy() + solver.friction_gradient.numpy())
    tools = [body for body in solver.model.bodies if body.kind is BodyKind.KINEMATIC]
    shares = np.zeros((len(nodal), len(tools)))
    for index, tool in enumerate(tools):
        force = nodal[:, tool.node_slice].sum(axis=1)
        size = np.linalg.norm(force, axis=-1)
        size[size == 0.0] = np.inf
        moves = np.zeros_like(nodal)
        moves[:, tool.node_slice] = -(force / size[:, None])[:, None]
        shares[:, index] = np.abs(guard_force(solver, state, moves)) / size
    return shares


def guard_force(solver: SolverIPC, state: State, moves: np.ndarray) -> np.ndarray:
    """Change of a force on tools if the guard let tets be squeezed to nothing [N], [env_count].

    ``moves``: motion of the tools' nodes per metre along the force [1], [env_count, node_count, 3].
    The force is that against the motion, at the end of the solver's last step, which led to
    ``state``. First order, see above, by one solve with the exact matrix where the guard acts and
    nothing elsewhere: exactly 0 there. NaN where the matrix is not positive definite.
    """
    model = solver.model
    everyone = wp.full(model.env_count, 1, dtype=wp.int32, device=model.device)
    load = wp.zeros_like(state.positions)
    add_guard_load(solver.elastic, everyone, state.positions, load)
    loads = load.numpy()[:, model.free_nodes.numpy()]
    guarded = loads.any(axis=(1, 2))
    if not guarded.any():
        return np.zeros(model.env_count)
    tangent = Tangent(solver, state, moves, guarded, past=True)
    tangent.add_elements()
    friction = solver.friction
    motion = solver.motion_to(state.positions, state.poses)
    tangent.add_contact(None if friction is None else motion)
    solved = tangent.solve()
    found = (loads * solved.solution).sum(axis=(1, 2))
    known = np.array([cause is None for cause in solved.causes])
    return np.where(guarded, np.where(known, found, np.nan), 0.0)
