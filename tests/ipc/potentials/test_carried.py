# SPDX-License-Identifier: Apache-2.0
"""Elements and inertia of gels on affine bodies, by the unknowns that are left: against differences
of the energy, and of the gradient."""

from __future__ import annotations

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
    """Energy, gradient and matrix of what elements and inertia add up to, by the unknowns."""

    def __init__(self, solver: SolverIPC) -> None:
        self.solver, self.model = solver, solver.model
        state = initial_state(self.model)
        self.everyone = wp.full(self.model.env_count, 1, dtype=wp.int32)
        dts = wp.full(self.model.env_count, 0.01, dtype=wp.float64)
        assert solver.inertia is not None and solver.maxwell
        solver.inertia.begin_step(state.positions, state.velocities)
        for part in solver.maxwell:
            part.begin_step(
                state.positions,
                state.viscous_inverses,
                dts,
                self.everyone,
                wp.zeros_like(self.everyone),
            )
        self.parts = [*solver.elastic, *solver.maxwell, solver.inertia]
        self.start = state.positions.numpy()
        noise = np.random.default_rng(4).normal(size=(self.model.free_count, 3))
        self.base = self.start[0, self.model.free_nodes.numpy()] + 0.02 * SIZE_M * noise

    def positions(self, free: np.ndarray) -> wp.array:
        x = self.start.copy()
        x[:, self.model.free_nodes.numpy()] = free
        placed = wp.array(x, dtype=wp.vec3d)
        embed_vertices(self.model, placed)
        return placed

    def energy(self, free: np.ndarray) -> float:
        x = self.positions(free)
        return sum(part.energy(self.everyone, x)[0] for part in self.parts)

    def gradient(self, free: np.ndarray) -> np.ndarray:
        x = self.positions(free)
        nodal, none = wp.zeros_like(x), wp.zeros_like(x)
        for part in self.parts:
            part.add_gradient(self.everyone, x, nodal)
        shape = (self.model.env_count, self.model.free_count)
        reduced = wp.zeros(shape, dtype=wp.vec3d)
        reduce_gradient(self.model, self.everyone, [nodal, none, none], reduced)
        return reduced.numpy()[0]

    def matrix(self, free: np.ndarray) -> np.ndarray:
        linear = self.solver.linear
        linear.values.zero_()
        system = newton_system(self.model, linear, self.solver.displacements)
        exact = wp.full(self.model.env_count, PSD_NONE, dtype=wp.int32)
        for part in self.parts:
            part.add_hessian(self.everyone, self.positions(free), system, exact)
        return self.model.pattern.dense(linear.values.numpy())[0]


def test_derivatives_against_differences(solver: SolverIPC) -> None:
    reduced = Reduced(solver)
    x, count = reduced.base, reduced.base.size
    step = 5e-5 * SIZE_M
    moves = step * np.eye(count).reshape(count, *x.shape)
    # All that the boxes move, and some of the rest: the boxes' rows are last.
    some = [*range(0, count - 24, 7), *range(count - 24, count)]
    gradient, matrix = reduced.gradient(x).ravel(), reduced.matrix(x)
    force, stiffness = np.abs(gradient).max(), np.abs(matrix).max()
    assert np.abs(gradient[-12:]).max() > 1e-3 * MODULUS_PA * SIZE_M**2, "the gels pull at the box"
    for i in some:
        slope = (reduced.energy(x + moves[i]) - reduced.energy(x - moves[i])) / (2 * step)
        assert gradient[i] == pytest.approx(slope, abs=1e-6 * force)
        column = (reduced.gradient(x + moves[i]) - reduced.gradient(x - moves[i])) / (2 * step)
        np.testing.assert_allclose(matrix[:, i], column.ravel(), atol=1e-6 * stiffness)


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
    time = TimeStepping(quasi_static=False)
    model = Scene(gels, affine_bodies=bodies, time=time).finalize("cpu")
    solver = SolverIPC(model, SolverConfig(dhat_m=dhat))
    state, everyone = initial_state(model), wp.full(1, 1, dtype=wp.int32)
    free = model.free_nodes.numpy()
    noise = np.random.default_rng(3).normal(size=(len(free), 3))
    start = state.positions.numpy().copy()
    start[0, free] += 0.02 * gap * noise

    def moved(way: np.ndarray) -> wp.array:
        x = start.copy()
        x[0, free] += way
        placed = wp.array(x, dtype=wp.vec3d)
        embed_vertices(model, placed)
        solver.displacements.zero_()
        solver.candidates.update(
            everyone, placed, solver.displacements, state.poses, state.poses, dhat
        )
        solver.pairs.forget(everyone)
        solver.collisions.update(everyone, placed, solver.candidates)
        return placed

    def gradient(way: np.ndarray) -> np.ndarray:
        x = moved(way)
        nodal, none = wp.zeros_like(x), wp.zeros_like(x)
        nearest = wp.full(1, np.inf, dtype=wp.float64)
        solver.contact.add_gradient(everyone, x, nodal, nearest)
        reduced = wp.zeros((1, model.free_count), dtype=wp.vec3d)
        reduce_gradient(model, everyone, [nodal, none, none], reduced)
        return reduced.numpy()[0].ravel()

    x = moved(np.zeros((len(free), 3)))
    nodes = solver.collisions.snapshot(0)["stencils"]
    parents, rows = model.parents.numpy(), model.free_index.numpy()
    unknowns = [
        4 * len({p for p in parents[s] if p >= 0}) + len({r for r in rows[s] if r >= 0})
        for s in nodes
    ]
    assert max(unknowns) == 10
    linear = solver.linear
    linear.values.zero_()
    linear.extra.clear()
    exact = wp.full(1, PSD_NONE, dtype=wp.int32)
    solver.contact.add_hessian(
        everyone, x, newton_system(model, linear, solver.displacements), exact
    )
    matrix = model.pattern.dense(linear.values.numpy())[0]
    count = int(linear.extra.counts.numpy()[0])
    places, blocks = linear.extra.places.numpy(), linear.extra.values.numpy()
    for (row, column), block in zip(places[:count], blocks[:count], strict=True):
        matrix[3 * row : 3 * row + 3, 3 * column : 3 * column + 3] += block
        matrix[3 * column : 3 * column + 3, 3 * row : 3 * row + 3] += block.T
    step, largest = 1e-5 * gap, np.abs(matrix).max()
    for i in range(3 * len(free)):
        way = np.zeros((len(free), 3))
        way.ravel()[i] = step
        column = (gradient(way) - gradient(-way)) / (2 * step)
        np.testing.assert_allclose(matrix[:, i], column, atol=1e-5 * largest)


def test_a_box_that_carries_nothing_is_left_alone(solver: SolverIPC) -> None:
    """The other box's rows hold its own inertia alone, and no block to the gels."""
    reduced = Reduced(solver)
    matrix = reduced.matrix(reduced.base)
    other = matrix[-24:-12]
    own = np.zeros_like(other)
    masses = solver.model.masses.numpy()[0, solver.model.free_nodes.numpy()[-8:-4]] / 0.01**2
    own[:, -24:-12] = np.diag(np.repeat(masses, 3))
    np.testing.assert_allclose(other, own, rtol=1e-12)
