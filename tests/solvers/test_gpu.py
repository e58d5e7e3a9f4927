# SPDX-License-Identifier: Apache-2.0
"""Steps on a GPU: captured graphs, all linear methods, many environments.

Without a GPU these are skipped; `TACCEL_LAB_DEVICE=cuda:0 pytest` runs all other tests on it, of
which those that ask for the same bits twice fail: contacts come in any order there, unless
``SolverConfig.deterministic`` says that it must not matter.
"""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

from taccel_lab.benchmarks.scenes import SceneOptions, build_scene
from taccel_lab.ipc.broad_phase.candidates import Candidates
from taccel_lab.ipc.linear.system import METHODS
from taccel_lab.scene import (
    AffineBody,
    Element,
    KinematicBody,
    Plane,
    RevoluteJoint,
    Scene,
    box_mesh,
    sphere_mesh,
)
from taccel_lab.solvers import SolverIPC
from taccel_lab.state import initial_state
from tests.solvers.driven_grasp import base_poses, driven_grasp
from tests.solvers.steps import Begun, assert_same, begun, left, stepped
from tests.support.blocks import block_mesh, cube, pose, scene
from tests.support.grasps import FALLING, mount_poses, mounted_gels
from tests.support.intersection import find_intersections

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device"),
]
GPU_METHODS = [name for name in METHODS if name != "ssor"]


def grasp_poses(step: int, env_count: int = 3) -> np.ndarray:
    return mount_poses([4.05e-3 - 5e-5 * min(step, 12)] * env_count, 1e-4 * max(step - 12, 0))


def grasp(env_count: int = 3, element: Element = Element.LINEAR, **options: object) -> Begun:
    gels, mounts = mounted_gels((3, 3, 2), (element, element))
    held = cube(8e-3, friction_coefficient=1.0)
    planes = [Plane((0, 0, -5e-3), (0, 0, 1))]
    scene = Scene(gels, mounts, env_count, FALLING, affine_bodies=[held], planes=planes)
    return begun(scene.finalize("cuda:0"), grasp_poses(0, env_count), dhat_m=1e-4, **options)


def lift_cube(env_count: int = 3, element: Element = Element.LINEAR, **options: object) -> Begun:
    solver, state = grasp(env_count, element, relative_tolerance=1e-6, **options)
    for step in range(1, 25):
        stepped(solver, state, grasp_poses(step, env_count))
    assert find_intersections(solver.model, state) == [[]] * env_count
    return solver, state


@pytest.fixture(scope="module")
def lifted() -> np.ndarray:
    solver, state = lift_cube()
    assert solver.graph.launches == 23
    x = state.positions.numpy()
    assert (x[:, solver.model.affine.first_control, 2] > 1e-3).all(), "the cube is carried"
    return x


def test_environments_agree(lifted: np.ndarray) -> None:
    np.testing.assert_allclose(lifted, lifted[:1].repeat(3, axis=0), atol=1e-8)


@pytest.mark.parametrize(
    "options",
    [{"capture": False}, {"deterministic": True}, *({"linear_method": m} for m in GPU_METHODS)],
    ids=str,
)
def test_methods_and_ways_to_launch_agree(lifted: np.ndarray, options: dict) -> None:
    _, state = lift_cube(**options)
    np.testing.assert_allclose(state.positions.numpy(), lifted, atol=1e-7)


def test_quadratic_gels() -> None:
    lift_cube(2, Element.QUADRATIC)


def carried(stream: Any = None) -> list[np.ndarray]:
    """Where a model and solver of one's own, on a stream of its own, lead in a few steps."""
    if stream is not None:
        warp = isinstance(stream, wp.Stream)
        with wp.ScopedStream(stream) if warp else torch.cuda.stream(stream):
            return carried()
    solver, state = grasp(1, deterministic=True)
    found = []
    for step in range(1, 9):
        # Of torch's current stream, which is busy with other things first.
        busy = torch.ones(1500, 1500, device="cuda:0").double()
        late = 0.0 * (busy @ busy @ busy).sum()
        stepped(solver, state, torch.from_numpy(grasp_poses(step, 1)).to("cuda:0") + late)
        found += [state.positions.numpy(), solver.contact_gradient.numpy()]
    return found


def test_threads_step_solvers_of_their_own_on_streams_of_their_own() -> None:
    expected = carried()
    streams = [*(wp.Stream("cuda:0") for _ in range(2)), *(torch.cuda.Stream() for _ in range(2))]
    with ThreadPoolExecutor(len(streams)) as threads:
        for _ in range(10):
            for found in threads.map(carried, streams):
                assert_same(found, expected)


def test_a_step_is_captured_while_another_thread_uses_torchs_usual_stream() -> None:
    over = threading.Event()

    def learn() -> int:
        rounds = 0
        while not over.is_set():
            (torch.ones(64, 64, device="cuda:0") @ torch.ones(64, 64, device="cuda:0")).sum()
            rounds += 1
        torch.cuda.synchronize()
        return rounds

    with ThreadPoolExecutor(1) as threads:
        learning = threads.submit(learn)
        try:
            first, *others = [carried()[-1] for _ in range(5)]
        finally:
            over.set()
        assert learning.result() > 0
    assert_same(others, [first] * 4)


def pairs_of(device: str) -> list[list[tuple[int, int]]]:
    """Pairs that a search finds, of nodes and faces, then of edges, in each environment: a ball of
    fine faces right above a gel, and away from it."""
    ball = KinematicBody(sphere_mesh(2e-3, 3e-4))
    model = scene(block_mesh((6, 6, 2), (6e-3, 6e-3, 1e-3)), ball, env_count=3).finalize(device)
    poses = np.stack([pose(0, 0, height)[None] for height in (2.05e-3, 2.4e-3, 9e-3)])
    state, candidates = initial_state(model, poses), Candidates(model)
    everyone = wp.full(3, 1, dtype=wp.int32, device=device)
    rest = wp.zeros_like(state.positions)
    candidates.update(everyone, state.positions, rest, state.poses, state.poses, 3e-4)
    lists = (candidates.node_faces, candidates.edge_edges)
    return [sorted(map(tuple, p.of(e, p.pairs).tolist())) for p in lists for e in range(3)]


def test_a_search_finds_the_pairs_of_the_cpu() -> None:
    """Each once, of edges with no other near them and with more than a warp has lanes."""
    expected = pairs_of("cpu")
    firsts = np.array(expected[3])[:, 0]
    assert np.bincount(firsts).max() > 32 and expected[5] == []
    assert pairs_of("cuda:0") == expected


def test_lists_grow() -> None:
    solver, state = grasp(32)
    for part in solver.lists:
        part._allocate(2)
    for step in range(1, 8):
        stepped(solver, state, grasp_poses(step, 32))
    assert solver.collisions.largest_room > 2


@pytest.mark.parametrize("method", GPU_METHODS)
def test_gels_on_bodies_that_drives_push(method: str) -> None:
    """What the CPU finds, to what a tight tolerance leaves."""
    scene, ends = driven_grasp(2, (Element.LINEAR, Element.LINEAR)), []
    for device, name in (("cpu", "ssor"), ("cuda:0", method)):
        options = {"dhat_m": 5e-5, "relative_tolerance": 1e-7, "linear_method": name}
        solver, state = begun(scene.finalize(device), base_poses(2), **options)
        for step in range(1, 11):
            stepped(solver, state, base_poses(2, 1e-4 * max(step - 6, 0)))
        ends.append(state.positions.numpy())
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-7)


def test_joints() -> None:
    rod = AffineBody(box_mesh((40e-3, 6e-3, 6e-3)), name="rod")
    hinge = RevoluteJoint("rod", None, (20e-3, 0, 0), (0, 1, 0))
    scene = Scene(affine_bodies=[rod], joints=[hinge], time=FALLING)
    solver, state = begun(scene.finalize("cuda:0"))
    for _ in range(20):
        assert stepped(solver, state).joint_violation_m.max() < 1e-9
    assert solver.joints is not None
    assert abs(solver.joints.coordinates.numpy()[0, 0]) > 0.3, "it swings"


@pytest.mark.parametrize(
    ("name", "env_count", "options"),
    [
        ("peg", 32, {}),
        ("press_239", 32, {}),
        ("press_239", 4, {"capture": False}),
        ("press_2005", 1, {"linear_method": "pipelined"}),
        ("press_2005", 4, {"linear_method": "cg"}),
        ("bolt", 8, {}),
        ("hand", 4, {}),
        ("squeeze", 2, {}),
    ],
)
def test_two_runs_give_the_same_bits(name: str, env_count: int, options: dict[str, object]) -> None:
    """State and forces of a benchmark scene whose environments differ."""
    bench = build_scene(
        name, SceneOptions(env_count, config={"deterministic": True, **options}, lag=5)
    )

    def run() -> list[np.ndarray]:
        solver = SolverIPC(bench.scene.finalize("cuda:0"), bench.config)
        state = initial_state(solver.model, bench.targets(0))
        found, rubs = [], False
        for step in range(1, min(30, bench.steps) + 1):
            stepped(solver, state, bench.targets(step))
            found += [*left(solver, state), state.poses.numpy()]
            rubs = rubs or bool(solver.friction_gradient.numpy().any())
        assert rubs
        return found

    assert_same(run(), run())
