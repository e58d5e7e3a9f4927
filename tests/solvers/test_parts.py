# SPDX-License-Identifier: Apache-2.0
"""Parts of a scene, stepped apart, do what they do together: bit by bit on the CPU."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from taccel_lab.geometry.block import block_mesh
from taccel_lab.scene import (
    AffineBody,
    Ball,
    KinematicBody,
    Plane,
    PositionDrive,
    RevoluteJoint,
    Scene,
    SoftBody,
    Surface,
    TimeStepping,
    box_mesh,
)
from taccel_lab.scene.shards import shard_of, shard_slice
from taccel_lab.solvers import StepReport
from tests.solvers.steps import assert_same, begun, left
from tests.support.blocks import cube, pose, soft_block

ENVS = 5
CELLS, SIZE = (3, 3, 2), (3e-3, 3e-3, 2e-3)
RESTS = np.stack([block_mesh(CELLS, SIZE, jitter=0.1, seed=s).nodes_m for s in range(ENVS)])
YOUNG = np.array([0.8e5, 0.9e5, 1e5, 1.1e5, 1.2e5])
SIDE = 1.2e-3
CONFIG = {"relative_tolerance": 1e-6, "max_newton_iterations": 60, "max_substep_halvings": 1}
FAILS = 3


def pad(friction: float, rests: np.ndarray = RESTS, **options: str) -> SoftBody:
    rubs = {"friction_coefficient": friction}
    return soft_block(CELLS, SIZE, name="pad", rest_positions_m=rests, **rubs, **options)


def pressed() -> Scene:
    """A ball or a block presses a gel, beside a cube that falls and a flap that a drive turns."""
    envs = np.arange(ENVS)
    falling = [pose(4e-3, 0, SIDE / 2 - 2.48e-3 + 2e-6 * e, (0, 0, 1), 9.0 * e) for e in envs]
    where = np.stack([pose(-5e-3, 1e-4 * e, 0.0) for e in envs])
    axes = np.stack([[0.1 * e, 1, 0.2] for e in envs])
    drive = PositionDrive(1e-5, 1e-8, target=0.02 * envs)
    options = {"density_kg_m3": 8000, "friction_coefficient": 0.4}
    here, there, elsewhere = (Surface(environments=e) for e in ((0, 1, 2, 4), (0, 1, 3), (2, 4)))
    return Scene(
        pad(0.4),
        [
            KinematicBody(Ball(1e-3), 0.5, "ball", there),
            KinematicBody(box_mesh((2e-3, 2e-3, 2e-3)), 0.5, "block", elsewhere),
        ],
        ENVS,
        TimeStepping(False, 2e-3, (0, 0, -9.81)),
        affine_bodies=[
            cube(SIDE, np.stack(falling), surface=here, **options),
            AffineBody(box_mesh((2e-3, 3e-4, 1e-3)), 2000, name="flap", initial_pose=where),
        ],
        planes=Plane((0, 0, -2.5e-3), name="floor"),
        joints=RevoluteJoint("flap", anchor_m=where[:, :3] + [1e-3, 0, 0], axis=axes, drive=drive),
    )


def mounted() -> Scene:
    """How far a mount may turn at once depends on the size of its gel, which differs."""
    rests = RESTS * np.array([1.0, 1.4, 1.0, 1.2, 1.0])[:, None, None]
    tools = [KinematicBody(None, name="mount"), KinematicBody(Ball(1e-3), 0.5)]
    return Scene(pad(0.5, rests, mount="mount"), tools, ENVS)


def press_at(step: int) -> np.ndarray:
    """Each environment presses elsewhere; one is asked for what it cannot do in the second step."""
    down = 4e-5 * step + 5e-6 * step * np.arange(ENVS)
    down[FAILS] += 0.02 * (step == 2)
    turns = [0.5 * env * step for env in range(ENVS)]
    return np.array(
        [[pose(1e-4 * e, 0, 1.05e-3 - down[e], (0, 1, 2), turns[e])] * 2 for e in range(ENVS)]
    )


def mount_at(step: int) -> np.ndarray:
    turned = pose(0, 0, 0, (0, 1, 0.3), 20.0 * step)
    return np.array([[turned, pose(1e-4 * e, 0, 1.42e-3 - 4e-5 * step)] for e in range(ENVS)])


def motion(scene: Scene, targets: np.ndarray, part: slice) -> list[tuple[StepReport, list]]:
    solver, state = begun(scene.finalize("cpu"), targets[0][part], **CONFIG)
    solver.model.set_body("pad", young_modulus_pa=YOUNG[part])
    found = []
    for step in range(1, len(targets)):
        if step == 3:
            solver.reset(state, np.array([False, True, False, True, False])[part], targets[0][part])
        report = solver.step(state, targets[step][part])
        found.append((report, [*left(solver, state), state.poses.numpy().copy()]))
    return found


@pytest.mark.thorough(cases=("pressed-press_at",))
@pytest.mark.parametrize(("make", "at"), [(pressed, press_at), (mounted, mount_at)])
def test_parts_give_the_bits_of_the_whole(make, at) -> None:
    targets = np.array([at(step) for step in range(4)])
    whole = motion(make(), targets, slice(None))
    for rank, world in ((0, 2), (1, 2), (2, 5)):
        part = shard_slice(ENVS, rank, world)
        steps = zip(motion(shard_of(make(), rank, world), targets, part), whole, strict=True)
        for (report, arrays), (expected, values) in steps:
            for field in fields(StepReport):
                if field.name != "seconds":
                    mine, theirs = (getattr(r, field.name) for r in (report, expected))
                    np.testing.assert_array_equal(mine, theirs[part], err_msg=field.name)
            assert_same(arrays, [value[part] for value in values])
    if make is pressed:
        # Contact, environments that differ, one failure, and a reset that goes back.
        assert list(whole[1][0].failures().values()) == [[FAILS]]
        assert whole[0][0].converged.all() and whole[2][0].converged.all()
        assert (whole[0][0].contact_force_n > 1e-4).all()
        assert len(np.unique(whole[1][0].residual_n)) == ENVS
        assert np.abs(whole[2][1][0] - whole[1][1][0])[1].max() > 1e-6
