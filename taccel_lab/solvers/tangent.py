# SPDX-License-Identifier: Apache-2.0
"""The exact matrix of a converged state of gels, and its solves.

Newton's method projects its matrices; here nothing is. Without friction the matrix is the Hessian
of the energy, symmetric, and positive definite at a stable equilibrium: the solver of the Newton
systems solves it on the device, all environments at once. Friction that is frozen where the step
ends makes it unsymmetric (``ipc.potentials.contact_derivatives``): a sparse LU factorisation on the
host solves that, one environment after the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.ipc.elasticity.principal import PSD_NONE
from taccel_lab.ipc.motion.unknowns import newton_system
from taccel_lab.ipc.potentials.contact_derivatives import NOW, ContactDerivatives
from taccel_lab.ipc.potentials.friction import StepMotion
from taccel_lab.model.matrix_pattern import BlockPattern
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.state import State, check_state

LINEAR_TOLERANCE = 1e-10
"""Tolerance of the solves."""
INDEFINITE = (
    "the Hessian of the energy is not positive definite: the gel is about to buckle, or to slip "
    "over an edge"
)
"""Why there is no slope where a state is no stable equilibrium."""
_MORE_ITERATIONS = 5
"""Times the iterations of a Newton step, which is solved a million times less exactly."""


@dataclass(frozen=True)
class Solved:
    """Solutions of one system an environment."""

    solution: np.ndarray
    """[m] for a right-hand side in newtons, shape [env_count, free_count, 3]; zero where none."""
    causes: list[str | None]
    """Why there is none, by environment."""
    iterations: np.ndarray
    """Iterations of conjugate gradients; 0 of a factorisation, [env_count]."""


class Tangent:
    """The matrix at one state of a solver's scene, in the environments of a mask."""

    def __init__(
        self,
        solver: SolverIPC,
        state: State,
        moves: np.ndarray | None = None,
        who: np.ndarray | None = None,
        *,
        past: bool = False,
    ) -> None:
        """
        Args:
            solver: Of a quasi-static scene of elastic gels, kinematic bodies and planes.
            state: The equilibrium; it stays as it is. The solver's lists of contacts become its.
            moves: Motion of prescribed nodes [m], [env_count, node_count, 3]: its pull on the
                gels is added to the right-hand side. None for none.
            who: Environments to look at, bool, [env_count]; all when None.
            past: Whether Maxwell branches count with the past that they had in the last step.

        Raises:
            InputError: A scene with inertia, Maxwell branches or affine bodies.
        """
        model = solver.model
        check_state(state, model)
        if solver.maxwell and not past:
            raise InputError(
                "gradients need elastic gels: the force of a material with Maxwell branches "
                "depends on its past, which they do not follow"
            )
        if solver.inertia is not None or solver.affine is not None:
            raise InputError(
                "gradients need quasi-static steps of elastic gels and tools that are moved: "
                "a scene with inertia or affine bodies has none here"
            )
        who = np.ones(model.env_count, dtype=bool) if who is None else who
        self.solver, self.state, self.who = solver, state, who
        self.active = wp.array(who.astype(np.int32), dtype=wp.int32, device=model.device)
        self._exact = wp.full(model.env_count, PSD_NONE, dtype=wp.int32, device=model.device)
        solver.find_contacts(self.active, state)
        shape = (model.env_count, model.node_count, 3)
        solver.displacements.assign(np.zeros(shape) if moves is None else moves)

    def add_elements(self) -> None:
        """The elements' part of the matrix, and of the right-hand side what moves pull."""
        solver, linear = self.solver, self.solver.linear
        linear.values.zero_()
        linear.rhs.zero_()
        linear.extra.clear()
        system = newton_system(solver.model, linear, solver.displacements)
        for part in solver.elements:
            part.add_hessian(self.active, self.state.positions, system, self._exact)

    def pull_of(self, moves: np.ndarray) -> np.ndarray:
        """Force that elements exert on the unknowns when prescribed nodes of gels on a mount move
        by ``moves`` [m], [env_count, node_count, 3]: [N], shape [env_count, free_count, 3]."""
        solver, linear = self.solver, self.solver.linear
        solver.displacements.assign(moves)
        linear.rhs.zero_()
        system = newton_system(solver.model, linear, solver.displacements)
        for part in solver.elastic:
            part.write_hessians(self.active, self.state.positions, self._exact)
            part.gather_rim(self.active, system)
        solver.displacements.zero_()
        return linear.rhs.numpy()

    def add_contact(self, friction: StepMotion | None = None) -> None:
        """Adds the barrier's part, likewise, and that of friction frozen at the end of a motion."""
        solver, linear = self.solver, self.solver.linear
        while True:
            system = newton_system(solver.model, linear, solver.displacements)
            solver.contact.add_hessian(self.active, self.state.positions, system, self._exact)
            if friction is not None and solver.friction is not None:
                solver.friction.lag(self.active, friction.positions, friction.previous)
                solver.friction.add_hessian(self.active, friction, system)
            if not linear.extra.fit():
                return
            self.add_elements()

    def solve(self, rhs: np.ndarray | None = None) -> Solved:
        """Solve the symmetric system that was added up for ``rhs`` [N], [env_count, free_count, 3],
        or for the one that is there."""
        linear = self.solver.linear
        if rhs is not None:
            linear.rhs.assign(rhs)
        linear.tolerances.fill_(LINEAR_TOLERANCE)
        linear.solve(self.active, _MORE_ITERATIONS * self.solver.config.max_cg_iterations)
        report = linear.report()
        causes: list[str | None] = [None] * len(self.who)
        for env in np.flatnonzero(self.who):
            if report.breakdown[env]:
                causes[env] = INDEFINITE
            elif not report.relative_residual[env] < 10 * LINEAR_TOLERANCE:
                causes[env] = (
                    f"the linear system was solved to {report.relative_residual[env]:.1e} only"
                )
        return Solved(linear.solution.numpy(), causes, report.iterations)

    def solve_transposed(
        self, rhs: np.ndarray, derivatives: dict[int, ContactDerivatives]
    ) -> Solved:
        """Solve the transpose of the elements' matrix, which was added up, and the
        ``derivatives`` of contact and friction by environment, for ``rhs`` [N],
        [env_count, free_count, 3]."""
        model = self.solver.model
        values = self.solver.linear.values.numpy()
        free = model.free_index.numpy()
        solution = np.zeros_like(rhs)
        causes: list[str | None] = [None] * len(rhs)
        for env, contact in derivatives.items():
            matrix = sparse_matrix(model.pattern, values[env]) + _of_contact(contact, free)
            found, causes[env] = _solve_transposed(matrix, rhs[env].ravel())
            solution[env] = found.reshape(-1, 3)
        return Solved(solution, causes, np.zeros(len(rhs), dtype=np.int64))


def sparse_matrix(pattern: BlockPattern, values: np.ndarray):
    """The matrix of one environment with both triangles, scipy CSR [3 free_count, 3 free_count].

    ``values``: blocks of the lower triangle [N/m], shape [block_count, 3, 3].
    """
    from scipy import sparse

    size = 3 * pattern.free_count
    lower = sparse.bsr_matrix(
        (values, pattern.columns, pattern.row_starts), shape=(size, size), blocksize=(3, 3)
    ).tocsr()
    diagonal = np.zeros_like(values)
    diagonal[pattern.diagonal] = values[pattern.diagonal]
    counted_twice = sparse.bsr_matrix(
        (diagonal, pattern.columns, pattern.row_starts), shape=(size, size), blocksize=(3, 3)
    ).tocsr()
    return (lower + lower.T - counted_twice).tocsr()


def _of_contact(derivatives: ContactDerivatives, free: np.ndarray):
    """d force of contact and friction / d x of the unknowns, scipy CSR."""
    from scipy import sparse

    size = 3 * (int(free.max()) + 1)
    blocks = derivatives.columns[:, NOW].reshape(-1, 4, 3, 4, 3)
    node = free[derivatives.nodes]
    axis = np.arange(3)
    shape = (len(node), 4, 3, 4, 3)
    columns = np.broadcast_to((3 * node[:, :, None] + axis)[:, :, :, None, None], shape)
    rows = np.broadcast_to((3 * node[:, :, None] + axis)[:, None, None], shape)
    both = (node[:, :, None, None, None] >= 0) & (node[:, None, None, :, None] >= 0)
    kept = np.broadcast_to(both, shape) & (blocks != 0)
    entries = (blocks[kept], (rows[kept], columns[kept]))
    return sparse.coo_matrix(entries, shape=(size, size)).tocsr()


def _solve_transposed(matrix, rhs: np.ndarray) -> tuple[np.ndarray, str | None]:
    from scipy.sparse.linalg import splu

    try:
        factor = splu(
            matrix.tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.01,
            options={"SymmetricMode": True},
        )
    except RuntimeError:
        return np.zeros_like(rhs), "the matrix of the step is singular: nothing holds the gel there"
    found = factor.solve(rhs, "T")
    found += factor.solve(rhs - matrix.T @ found, "T")
    left = np.linalg.norm(rhs - matrix.T @ found)
    if not left <= 10 * LINEAR_TOLERANCE * np.linalg.norm(rhs):
        return np.zeros_like(rhs), "the linear system is too nearly singular to be solved"
    return found, None
