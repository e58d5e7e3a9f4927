# SPDX-License-Identifier: Apache-2.0
"""Blocks outside of the pattern: assembly from nodes of every kind, and all solvers with them.

Row lists of extra blocks in order: the same bits however the blocks were listed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import warp as wp

from taccel_lab.ipc.linear.cg.block_cg import BlockCG
from taccel_lab.ipc.linear.cg.pipelined_cg import PipelinedCG
from taccel_lab.ipc.linear.problem.scatter import NewtonSystem, add_block
from taccel_lab.ipc.linear.system import METHODS, LinearSystem, Solver
from taccel_lab.ipc.motion.unknowns import newton_system
from taccel_lab.scene import AffineBody, KinematicBody, Scene, TimeStepping, box_mesh, sphere_mesh
from tests.ipc.linear.systems import add_extra, contact_system, list_extra, residuals, solve
from tests.support.blocks import soft_block

CPU = wp.get_device("cpu")


@wp.kernel(enable_backward=False)
def _add_pairs_kernel(
    first: wp.array(dtype=wp.int32),
    second: wp.array(dtype=wp.int32),
    blocks: wp.array(dtype=wp.mat33d),
    system: NewtonSystem,
):
    k = wp.tid()
    add_block(0, first[k], second[k], blocks[k], system)


def test_blocks_of_all_kinds_of_nodes_are_j_transposed_h_j() -> None:
    """Soft, bonded, mounted, affine and kinematic nodes: H in terms of the unknowns, and the rest
    on the right-hand side."""
    rng = np.random.default_rng(1)
    model = Scene(
        soft_block((1, 1, 1), (1e-3,) * 3, mount="hand"),
        [KinematicBody(None, name="hand"), KinematicBody(box_mesh((1e-3,) * 3))],
        time=TimeStepping(quasi_static=False),
        affine_bodies=[
            AffineBody(box_mesh((2e-3, 1e-3, 1e-3))),
            AffineBody(sphere_mesh(1e-3, 1e-3)),
        ],
    ).finalize()
    count = model.node_count
    # d node / d unknown, and d node / d prescribed motion.
    jacobian = np.zeros((count, model.free_count))
    free_index, parents = model.free_index.numpy(), model.parents.numpy()
    for node, weights in enumerate(model.weights.numpy()):
        if free_index[node] >= 0:
            jacobian[node, free_index[node]] = 1.0
        elif parents[node] >= 0:
            jacobian[node, free_index[parents[node] : parents[node] + 4]] = weights
    prescribed = ~jacobian.any(axis=1)
    assert prescribed.sum() == 4 + 8 and (parents >= 0).sum() == 20
    motion = np.where(prescribed[:, None], rng.normal(size=(count, 3)), 0.0)

    pairs = np.stack(np.meshgrid(*2 * [rng.choice(count, 30, replace=False)]), -1).reshape(-1, 2)
    upper = pairs[pairs[:, 0] <= pairs[:, 1]]
    blocks = rng.normal(size=(len(upper), 3, 3))
    blocks[upper[:, 0] == upper[:, 1]] /= 2
    hessian = np.zeros((3 * count, 3 * count))
    add_extra(hessian, upper, blocks)
    hessian = hessian.reshape(count, 3, count, 3)
    rows, columns = np.argwhere(np.abs(hessian).sum(axis=(1, 3)) > 0).T
    places = [wp.array(a.astype(np.int32), dtype=wp.int32) for a in (rows, columns)]
    inputs = [*places, wp.array(hessian[rows, :, columns], dtype=wp.mat33d)]

    linear = LinearSystem(model.pattern, 1, model.device)
    displacements = wp.array(motion[None], dtype=wp.vec3d)
    launches, extra = 0, linear.extra
    while launches == 0 or extra.fit():
        system = newton_system(model, linear, displacements)
        linear.values.zero_()
        linear.rhs.zero_()
        extra.clear()
        wp.launch(_add_pairs_kernel, dim=len(rows), inputs=[*inputs, system])
        launches += 1
    assert launches == 2, "the list was too short at first"
    full = model.pattern.dense(linear.values.numpy())[0]
    listed = extra.of(0, extra.places)
    assert len(listed) > 0 and (listed[:, 0] > listed[:, 1]).all()
    add_extra(full, listed, extra.of(0, extra.values))
    expected = np.einsum("nr,naMb,Ms->rasb", jacobian, hessian, jacobian).reshape(full.shape)
    np.testing.assert_allclose(full, expected, atol=1e-12 * np.abs(expected).max())
    pushed = -np.einsum("nr,naMb,Mb->ra", jacobian, hessian, motion)
    np.testing.assert_allclose(linear.rhs.numpy()[0], pushed, atol=1e-12 * np.abs(pushed).max())


LANES = 32
SOLVERS: dict[str, Callable[[LinearSystem], Solver]] = {
    **METHODS,
    "cg, many lanes": lambda system: BlockCG(system, system.clusters, LANES),
    "pipelined, many lanes": lambda system: PipelinedCG(system, system.clusters, LANES),
}


def solve_listed(solver: str, seed: int, in_any_order: bool) -> np.ndarray:
    """Solutions of two environments whose 200 contacts are listed in an order of the seed. Each has
    eight blocks, in the columns of twenty nodes: more of a column than one lane adds up."""
    source, dense = contact_system(2, 200)
    system = LinearSystem(
        source.pattern, 2, CPU, source.clusters, method="cg", in_any_order=in_any_order
    )
    for name in ("values", "rhs"):
        wp.copy(getattr(system, name), getattr(source, name))
    rng, extra = np.random.default_rng(seed), source.extra
    orders = [rng.permutation(int(count)) for count in extra.counts.numpy()]
    places = [extra.of(env, extra.places)[order] for env, order in enumerate(orders)]
    # Multiples of one number add up exactly, as those that an assembly lists do.
    blocks = [np.rint(extra.of(e, extra.values)[o] * 2**24) / 2**24 for e, o in enumerate(orders)]
    list_extra(system.extra, places, blocks)
    system._solver = SOLVERS[solver](system)
    assert not solve(system, 1e-8).breakdown.any() and (residuals(system, dense) <= 1e-6).all()
    return system.solution.numpy()


@pytest.mark.thorough(cases=("arrow",))
@pytest.mark.parametrize("solver", SOLVERS)
def test_bits_do_not_depend_on_the_order_of_the_list(many_lanes: None, solver: str) -> None:
    first, *others = (solve_listed(solver, seed, True) for seed in range(4))
    np.testing.assert_array_equal(others, [first] * 3)


def test_they_do_where_nobody_asks() -> None:
    first, *others = (solve_listed("cg", seed, False) for seed in range(4))
    assert any(not np.array_equal(other, first) for other in others)
