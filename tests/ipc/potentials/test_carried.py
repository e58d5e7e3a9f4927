# SPDX-License-Identifier: Apache-2.0
"""Elements and inertia of gels on affine bodies, by the unknowns that are left: against differences
of the energy, and of the gradient."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import warp as wp

from taccel_lab.bodies.material import MaxwellBranch
from taccel_lab.geometry.block import block_mesh
from taccel_lab.ipc.elasticity.principal import PSD_NONE
from taccel_lab.ipc.motion.unknowns import newton_system, reduce_gradient
from taccel_lab.model.embedding import embed_vertices
from taccel_lab.scene import (
    AffineBody,
    Element,
    Material,
    Scene,
    SoftBody,
    Surface,
    TimeStepping,
    box_mesh,
)
from taccel_lab.solvers import SolverConfig, SolverIPC
from taccel_lab.state import initial_state
from tests.ipc.derivatives import differences

HALF = np.sqrt(0.5)
MODULUS_PA = 1e5
SIZE_M = 2e-3


def two_gels_on_a_box(element: Element) -> SolverIPC:
    """On two sides of one of two boxes; two environments."""
    mesh = block_mesh((1, 2, 2), (SIZE_M, SIZE_M, SIZE_M))
    gel = Material(MODULUS_PA, 0.4, branches=(MaxwellBranch(1.0, 0.01),))
    box = box_mesh((SIZE_M, SIZE_M, SIZE_M))
    spot = np.array([0.1, 0.2, 0.3, HALF, 0, 0, HALF])
    aside = np.array([0, -2 * SIZE_M, 0, HALF, 0, 0, HALF])
    gels = [
        SoftBody(mesh, gel, name="top", mount="box", element=element),
        SoftBody(mesh, gel, name="side", mount="box", mount_pose=aside, element=element),
    ]
    scene = Scene(
        gels,
        env_count=2,
        time=TimeStepping(quasi_static=False, dt_s=0.01, gravity_m_s2=(0, 0, -9.81)),
        affine_bodies=[
            AffineBody(box, name="other"),
            AffineBody(box, name="box", initial_pose=spot, initial_spin_rad_s=(1.0, 2.0, 3.0)),
        ],
    )
    return SolverIPC(scene.finalize("cpu"))


@pytest.fixture(scope="module", params=list(Element))
def solver(request: pytest.FixtureRequest) -> SolverIPC:
    return two_gels_on_a_box(request.param)


class Reduced:
    """Energies, gradients and matrix of potentials by the unknowns, of environment 0."""

    def __init__(self, solver: SolverIPC, parts: list[Any], start: np.ndarray) -> None:
        self.solver, self.model, self.parts, self.start = solver, solver.model, parts, start
        self.everyone = wp.full(self.model.env_count, 1, dtype=wp.int32)
        self.free = self.model.free_nodes.numpy()

    def positions(self, free: np.ndarray) -> wp.array:
        x = self.start.copy()
        x[:, self.free] = free
        placed = wp.array(x, dtype=wp.vec3d)
        embed_vertices(self.model, placed)
        return placed

    def energies(self, batch: np.ndarray) -> np.ndarray:
        """Of configurations [count, free, 3]."""
        at = map(self.positions, batch)
        return np.array([sum(p.energy(self.everyone, x)[0] for p in self.parts) for x in at])

    def gradients(self, batch: np.ndarray) -> np.ndarray:
        """The same, [count, 3 free]."""
        shape = (self.model.env_count, self.model.free_count)
        found = []
        for x in map(self.positions, batch):
            nodal, none, reduced = (wp.zeros(n, dtype=wp.vec3d) for n in (x.shape, x.shape, shape))
            for part in self.parts:
                self.add_gradient(part, x, nodal)
            reduce_gradient(self.model, self.everyone, [nodal, none, none], reduced)
            found.append(reduced.numpy()[0].ravel())
        return np.array(found)

    def add_gradient(self, part: Any, x: wp.array, nodal: wp.array) -> None:
        part.add_gradient(self.everyone, x, nodal)

    def matrix(self, free: np.ndarray) -> np.ndarray:
        linear = self.solver.linear
        linear.values.zero_()
        linear.extra.clear()
        system = newton_system(self.model, linear, self.solver.displacements)
        exact = wp.full(self.model.env_count, PSD_NONE, dtype=wp.int32)
        for part in self.parts:
            part.add_hessian(self.everyone, self.positions(free), system, exact)
        full, extra = self.model.pattern.dense(linear.values.numpy())[0], linear.extra
        for (i, j), b in zip(extra.of(0, extra.places), extra.of(0, extra.values), strict=True):
            full[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] += b
            full[3 * j : 3 * j + 3, 3 * i : 3 * i + 3] += b.T
        return full


def elements_and_inertia(solver: SolverIPC) -> tuple[Reduced, np.ndarray]:
    """What both add up to, and where the unknowns are."""
    state = initial_state(solver.model)
    everyone = wp.full(2, 1, dtype=wp.int32)
    none, dts = wp.zeros_like(everyone), wp.full(2, 0.01, dtype=wp.float64)
    assert solver.inertia is not None and solver.maxwell
    solver.inertia.begin_step(state.positions, state.velocities)
    for part in solver.maxwell:
        part.begin_step(state.positions, state.viscous_inverses, dts, everyone, none)
    parts = [*solver.elastic, *solver.maxwell, solver.inertia]
    reduced = Reduced(solver, parts, state.positions.numpy())
    noise = np.random.default_rng(4).normal(size=(solver.model.free_count, 3))
    return reduced, reduced.start[0, reduced.free] + 0.02 * SIZE_M * noise


def test_derivatives_against_differences(solver: SolverIPC) -> None:
    reduced, x = elements_and_inertia(solver)
    # All that the boxes move, and some of the rest: the boxes' rows are last.
    some = [*range(0, x.size - 24, 7), *range(x.size - 24, x.size)]
    gradient, matrix = reduced.gradients(x[None])[0], reduced.matrix(x)
    force, stiffness = np.abs(gradient).max(), np.abs(matrix).max()
    assert np.abs(gradient[-12:]).max() > 1e-3 * MODULUS_PA * SIZE_M**2, "the gels pull at the box"
    slopes = differences(reduced.energies, x, 5e-5 * SIZE_M, some)
    np.testing.assert_allclose(gradient[some], slopes, rtol=0, atol=1e-6 * force)
    columns = differences(reduced.gradients, x, 5e-5 * SIZE_M, some)
    np.testing.assert_allclose(matrix[:, some], columns.T, atol=1e-6 * stiffness)
    # The other box's rows hold its own inertia alone, and no block to the gels.
    other, own = matrix[-24:-12], np.zeros((12, x.size))
    masses = solver.model.masses.numpy()[0, reduced.free[-8:-4]] / 0.01**2
    own[:, -24:-12] = np.diag(np.repeat(masses, 3))
    np.testing.assert_allclose(other, own, rtol=1e-12)


def test_rims_of_gels_on_two_bodies_that_touch() -> None:
    """Stencils of two bodies and two free nodes, of ten unknowns: edges from the glued to the free
    face of two gels that cross, against differences of the forces."""
    gap, dhat = 1e-5, 1e-4
    gel = Material(MODULUS_PA, 0.4)
    spots = [
        np.array([-SIZE_M / 2, 0, 0, 0, 0, 0, 1]),
        np.array([SIZE_M / 2 + gap, -SIZE_M / 2, -SIZE_M / 2, HALF, 0, 0, HALF]),
    ]
    mesh = block_mesh((2, 2, 1), (SIZE_M, SIZE_M, SIZE_M))
    box = box_mesh((SIZE_M, SIZE_M, SIZE_M))
    apart = Surface(layer=2, collides_with=2)
    bodies = [
        AffineBody(box, name=f"box {i}", initial_pose=spot, surface=apart)
        for i, spot in enumerate(spots)
    ]
    gels = [
        SoftBody(mesh, gel, name=f"gel {i}", mount=f"box {i}", element=Element.LINEAR)
        for i in range(2)
    ]
    model = Scene(gels, affine_bodies=bodies, time=TimeStepping(quasi_static=False)).finalize("cpu")
    solver = SolverIPC(model, SolverConfig(dhat_m=dhat))
    state = initial_state(model)

    class Touching(Reduced):
        """Collisions are found anew at all positions."""

        def positions(self, free: np.ndarray) -> wp.array:
            placed, still = super().positions(free), solver.displacements
            still.zero_()
            poses = (state.poses, state.poses)
            solver.candidates.update(self.everyone, placed, still, *poses, dhat)
            solver.pairs.forget(self.everyone)
            solver.collisions.update(self.everyone, placed, solver.candidates)
            return placed

        def add_gradient(self, part: Any, x: wp.array, nodal: wp.array) -> None:
            part.add_gradient(self.everyone, x, nodal, wp.full(1, np.inf, dtype=wp.float64))

    reduced = Touching(solver, [solver.contact], state.positions.numpy())
    noise = np.random.default_rng(3).normal(size=(len(reduced.free), 3))
    x = reduced.start[0, reduced.free] + 0.02 * gap * noise
    matrix = reduced.matrix(x)
    nodes = solver.collisions.snapshot(0)["stencils"]
    parents, rows = model.parents.numpy(), model.free_index.numpy()
    unknowns = [
        4 * len({p for p in parents[s] if p >= 0}) + len({r for r in rows[s] if r >= 0})
        for s in nodes
    ]
    assert max(unknowns) == 10
    columns = differences(reduced.gradients, x, 1e-5 * gap)
    np.testing.assert_allclose(matrix, columns.T, atol=1e-5 * np.abs(matrix).max())
