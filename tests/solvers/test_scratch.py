# SPDX-License-Identifier: Apache-2.0
"""Nothing is read from memory that a step has not written itself."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import warp as wp

from taccel_lab.scene import Element, KinematicBody, Plane, Scene, TimeStepping
from taccel_lab.solvers import SolverConfig, SolverIPC
from taccel_lab.state import State, initial_state
from tests.support.blocks import cube, soft_block
from tests.support.variants import variants

ENVS = 3


def make(device: str, element: Element, **options: bool) -> tuple[SolverIPC, State]:
    """A gel on a hand lowers itself on a box that lies on the floor, and rubs."""
    gel = soft_block(
        (2, 2, 2), (4e-3, 4e-3, 3e-3), element=element, mount="hand", friction_coefficient=0.4
    )
    box = cube(2e-3, friction_coefficient=0.4, name="box")
    scene = Scene(
        [gel],
        [KinematicBody(None, name="hand")],
        ENVS,
        TimeStepping(quasi_static=False, dt_s=5e-3),
        affine_bodies=[box],
        planes=[Plane((0, 0, -1.05e-3), friction_coefficient=0.4)],
    )
    solver = SolverIPC(scene.finalize(device), SolverConfig(dhat_m=1e-4, **options))  # type: ignore[arg-type]
    return solver, initial_state(solver.model, poses(0))


def poses(step: int) -> np.ndarray:
    return np.array(
        [
            [[1e-5 * env * step, 0, 1.05e-3 - (4e-5 + 1e-5 * env) * step, 1, 0, 0, 0]]
            for env in range(ENVS)
        ]
    )


def scratch(solver: SolverIPC) -> Iterator[wp.array]:
    """What a step writes before it reads it."""
    for name in ("trial", "path", "displacements", "reduced", "gradient", "pivots"):
        yield getattr(solver, name)
    linear = solver.linear
    yield from (linear.values, linear.rhs, linear.solution)
    for part in solver.elastic:
        yield part._blocks
    for term in solver.potentials.values():
        yield term.energies
    p = solver.progress
    yield from (p.clearance.limit, p.clearance.bend, p.clearance.flight_turn_sq, p.clearance.reach)
    search = p.search
    yield from (search.derivative, search.before, search.after, search.base, search.base_after)


def poison_and_compare(device: str, element: Element, **options: bool) -> None:
    clean, poisoned = make(device, element, **options), make(device, element, **options)
    for step in range(1, 6):
        for array in scratch(poisoned[0]):
            array.fill_(np.nan)
        for solver, state in (clean, poisoned):
            report = solver.step(state, poses(step))
            assert report.converged.all(), report.summary()
    assert clean[0].contact_gradient.numpy().any(), "they touch"
    np.testing.assert_array_equal(poisoned[1].positions.numpy(), clean[1].positions.numpy())
    np.testing.assert_array_equal(poisoned[1].velocities.numpy(), clean[1].velocities.numpy())


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("element", "deterministic"),
    variants([(Element.LINEAR, True), (Element.QUADRATIC, False)], Element, [False, True]),
)
def test_what_scratch_memory_held_before_does_not_matter(
    element: Element, deterministic: bool
) -> None:
    poison_and_compare("cpu", element, deterministic=deterministic)


@pytest.mark.gpu
@pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device")
@pytest.mark.parametrize("element", [Element.LINEAR, Element.QUADRATIC])
def test_nor_on_a_gpu_where_two_runs_give_the_same_bits(element: Element) -> None:
    poison_and_compare("cuda:0", element, deterministic=True)
