# SPDX-License-Identifier: Apache-2.0
"""Where a part of the way ahead leads: each node is placed once, whatever moves it."""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations

import numpy as np
import pytest
import warp as wp

from taccel_lab.geometry.block import block_mesh
from taccel_lab.ipc.affine.bent_step import place_affine
from taccel_lab.ipc.motion.kinematic_nodes import FrameNodes
from taccel_lab.ipc.motion.trial import StraightNodes, Trial
from taccel_lab.model import Model
from taccel_lab.model.embedding import embed_vertices
from taccel_lab.model.kinematics import interpolate_poses, place_kinematic_nodes
from taccel_lab.scene import (
    AffineBody,
    KinematicBody,
    Material,
    Plane,
    Scene,
    SoftBody,
    TimeStepping,
    box_mesh,
)
from taccel_lab.state import initial_state

ENVS = 3
FRACTIONS = np.array([0.25, 0.5, 0.75])
MASK = np.array([1, 0, 1], dtype=np.int32)
"""Environments that try."""
CURVED = np.array([1, 0, 0], dtype=np.int32)


@pytest.fixture(scope="module")
def model() -> Model:
    """Gels on the second and the first of three frames, of which the last has a surface; two boxes
    and a floor."""
    gels = [
        SoftBody(
            block_mesh((2, 2, 1), (4e-3, 4e-3, 2e-3)), Material(1e5, 0.4), mount=mount, name=mount
        )
        for mount in ("b", "a")
    ]
    frames = [KinematicBody(None, name="a"), KinematicBody(None, name="b")]
    block = KinematicBody(box_mesh((1e-3, 1e-3, 1e-3)), name="c")
    boxes = [AffineBody(box_mesh((k * 1e-3, 1e-3, 1e-3)), name=f"box {k}") for k in (1, 2)]
    time = TimeStepping(quasi_static=False)
    planes = [Plane((0, 0, -1))]
    scene = Scene(gels, [*frames, block], ENVS, time, affine_bodies=boxes, planes=planes)
    return scene.finalize("cpu")


def poses(shift: float, angle: float) -> np.ndarray:
    turn = [0, np.sin(angle / 2), 0, np.cos(angle / 2)]
    return np.array([[[frame + shift, env, 0, *turn] for frame in range(3)] for env in range(ENVS)])


def nodal(values: np.ndarray) -> wp.array:
    return wp.array(values, dtype=wp.vec3d)


def test_each_node_has_one_place_in_any_order(model: Model) -> None:
    start, end = poses(0.0, 0.1), poses(1e-2, 0.5)
    x = initial_state(model, start).positions.numpy()
    way = np.random.default_rng(0).normal(size=x.shape) * 1e-3
    carried = model.frame_nodes.numpy()
    middle = interpolate_poses(start, end, FRACTIONS)

    expected = nodal(x + FRACTIONS[:, None, None] * way)
    embed_vertices(model, expected)
    place_kinematic_nodes(model, wp.array(middle, dtype=wp.transformd), expected)
    tries = MASK == 1

    straight, frames = StraightNodes(model), FrameNodes(model)
    nothing_turns = wp.zeros(ENVS, dtype=wp.float64)
    pivots = wp.zeros((ENVS, 2), dtype=wp.vec3d)
    path = tuple(wp.array(p, dtype=wp.transformd) for p in (start, end))
    trial = Trial()
    trial.mask, trial.curved = (wp.array(m, dtype=wp.int32) for m in (MASK, CURVED))
    trial.fractions = wp.array(FRACTIONS, dtype=wp.float64)
    trial.positions, trial.displacements = nodal(x), nodal(way)
    reached = wp.zeros((ENVS, 3), dtype=wp.transformd)
    parts: list[Callable[[], None]] = [
        lambda: straight.place(trial),
        lambda: frames.place(trial, (path[0], path[1]), trial.fractions, reached),
        lambda: place_affine(model, nothing_turns, pivots, trial),
    ]
    for order in permutations(parts):
        trial.result, trial.paths = (nodal(np.full(x.shape, np.nan)) for _ in range(2))
        for part in order:
            part()
        found, paths = trial.result.numpy(), trial.paths.numpy()
        np.testing.assert_array_equal(found[tries], expected.numpy()[tries])
        assert np.isnan(found[~tries]).all(), "others are left alone"
        np.testing.assert_array_equal(paths[0], found[0] - x[0])
        assert np.isnan(paths[1:]).all(), "no path but where one is asked for"
    np.testing.assert_array_equal(reached.numpy()[tries], middle[tries])
    assert not np.array_equal(found[0, carried], x[0, carried])


def test_what_a_frame_carries_aims_at_its_pose(model: Model) -> None:
    """At the end of the path, or a part of the way along it; elsewhere it stays."""
    start, end = poses(0.0, 0.1), poses(1e-2, 0.5)
    x = initial_state(model, start).positions
    path = (wp.array(start, dtype=wp.transformd), wp.array(end, dtype=wp.transformd))
    middle = interpolate_poses(start, end, FRACTIONS)
    carried = model.frame_nodes.numpy()
    active = wp.full(ENVS, 1, dtype=wp.int32)
    moving = wp.array(MASK, dtype=wp.int32)
    targets = wp.zeros((ENVS, 3), dtype=wp.transformd)
    fractions = wp.array(FRACTIONS, dtype=wp.float64)
    for rest, goal in (((), end), ((fractions, targets), middle)):
        way = wp.zeros_like(x)
        FrameNodes(model).aim(active, moving, path, x, way, *rest)
        there = wp.clone(x)
        place_kinematic_nodes(model, wp.array(goal, dtype=wp.transformd), there)
        expected = (there.numpy() - x.numpy()) * MASK[:, None, None]
        np.testing.assert_array_equal(way.numpy()[:, carried], expected[:, carried])
        assert not np.delete(way.numpy(), carried, axis=1).any(), "others are left alone"
    np.testing.assert_array_equal(targets.numpy(), middle)
