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
from taccel_lab.ipc.linear.system import METHODS
from taccel_lab.scene import AffineBody, Element, Plane, RevoluteJoint, Scene, box_mesh
from taccel_lab.solvers import SolverConfig, SolverIPC
from taccel_lab.state import State, initial_state
from tests.solvers.driven_grasp import base_poses, driven_grasp
from tests.support.blocks import cube
from tests.support.grasps import FALLING, mount_poses, mounted_gels
from tests.support.intersection import find_intersections

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device"),
]
GPU_METHODS = [name for name in METHODS if name != "ssor"]


def grasp(env_count: int = 3, element: Element = Element.LINEAR) -> Scene:
    """A cube between two gels on mounts, above a plane."""
    gels, mounts = mounted_gels((3, 3, 2), (element, element))
    held = cube(8e-3, friction_coefficient=1.0)
    planes = [Plane((0, 0, -5e-3), (0, 0, 1))]
    return Scene(gels, mounts, env_count, FALLING, affine_bodies=[held], planes=planes)


def grasp_poses(step: int, env_count: int = 3) -> np.ndarray:
    """Closing, then lifting."""
    return mount_poses([4.05e-3 - 5e-5 * min(step, 12)] * env_count, 1e-4 * max(step - 12, 0))


def lift_cube(scene: Scene, **options: object) -> tuple[SolverIPC, State]:
    model = scene.finalize("cuda:0")
    solver = SolverIPC(model, SolverConfig(dhat_m=1e-4, relative_tolerance=1e-6, **options))  # type: ignore[arg-type]
    state = initial_state(model, grasp_poses(0, scene.env_count))
    for step in range(1, 25):
        report = solver.step(state, grasp_poses(step, scene.env_count))
        assert report.converged.all(), report.summary()
    assert find_intersections(model, state) == [[]] * scene.env_count
    return solver, state


@pytest.fixture(scope="module")
def lifted() -> np.ndarray:
    solver, state = lift_cube(grasp())
    assert solver.graph.launches == 23
    x = state.positions.numpy()
    rise = x[:, solver.model.affine.first_control, 2]
    assert (rise > 1e-3).all(), "the cube is carried"
    return x


def test_environments_agree(lifted: np.ndarray) -> None:
    np.testing.assert_allclose(lifted, lifted[:1].repeat(3, axis=0), atol=1e-8)


@pytest.mark.parametrize("method", GPU_METHODS)
def test_linear_methods_agree(lifted: np.ndarray, method: str) -> None:
    _, state = lift_cube(grasp(), linear_method=method)
    np.testing.assert_allclose(state.positions.numpy(), lifted, atol=1e-7)


def test_a_captured_step_is_the_same_as_launches_one_by_one(lifted: np.ndarray) -> None:
    _, state = lift_cube(grasp(), capture=False)
    np.testing.assert_allclose(state.positions.numpy(), lifted, atol=1e-7)


def carried(stream: Any = None) -> list[np.ndarray]:
    """Where a model and solver of one's own, on a stream of its own, lead in a few steps."""
    if isinstance(stream, wp.Stream):
        with wp.ScopedStream(stream):
            return carried()
    if stream is not None:
        with torch.cuda.stream(stream):
            return carried()
    solver = SolverIPC(grasp(1).finalize("cuda:0"), SolverConfig(dhat_m=1e-4, deterministic=True))
    state = initial_state(solver.model, grasp_poses(0, 1))
    found = []
    for step in range(1, 9):
        # Of torch's current stream, which is busy with other things first.
        busy = torch.ones(1500, 1500, device="cuda:0").double()
        late = 0.0 * (busy @ busy @ busy).sum()
        target = torch.from_numpy(grasp_poses(step, 1)).to("cuda:0") + late
        assert solver.step(state, target).converged.all()
        found += [state.positions.numpy(), solver.contact_gradient.numpy()]
    return found


def test_threads_step_solvers_of_their_own_on_streams_of_their_own() -> None:
    expected = carried()
    streams = [*(wp.Stream("cuda:0") for _ in range(2)), *(torch.cuda.Stream() for _ in range(2))]
    with ThreadPoolExecutor(len(streams)) as threads:
        for _ in range(10):
            for found in threads.map(carried, streams):
                for one, other in zip(found, expected, strict=True):
                    np.testing.assert_array_equal(one, other)


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
            ends = [carried()[-1] for _ in range(5)]
        finally:
            over.set()
        assert learning.result() > 0
    for end in ends[1:]:
        np.testing.assert_array_equal(end, ends[0])


def test_lists_grow() -> None:
    scene = grasp(32)
    model = scene.finalize("cuda:0")
    solver = SolverIPC(model, SolverConfig(dhat_m=1e-4))
    for part in solver.lists:
        part._allocate(2)
    state = initial_state(model, grasp_poses(0, 32))
    for step in range(1, 8):
        assert solver.step(state, grasp_poses(step, 32)).converged.all()
    assert solver.collisions.largest_room > 2


def test_quadratic_gels() -> None:
    lift_cube(grasp(2, Element.QUADRATIC))


@pytest.mark.parametrize("method", GPU_METHODS)
def test_gels_on_bodies_that_drives_push(method: str) -> None:
    """What the CPU finds, to what a tight tolerance leaves."""
    elements = (Element.LINEAR, Element.LINEAR)
    ends = []
    for device, name in (("cpu", "ssor"), ("cuda:0", method)):
        model = driven_grasp(2, elements).finalize(device)
        config = SolverConfig(dhat_m=5e-5, relative_tolerance=1e-7, linear_method=name)
        solver, state = SolverIPC(model, config), initial_state(model, base_poses(2))
        for step in range(1, 11):
            report = solver.step(state, base_poses(2, 1e-4 * max(step - 6, 0)))
            assert report.converged.all(), report.summary()
        ends.append(state.positions.numpy())
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-7)


def test_joints() -> None:
    rod = AffineBody(box_mesh((40e-3, 6e-3, 6e-3)), name="rod")
    scene = Scene(
        affine_bodies=[rod],
        joints=[RevoluteJoint("rod", None, (20e-3, 0, 0), (0, 1, 0))],
        time=FALLING,
    )
    model = scene.finalize("cuda:0")
    solver = SolverIPC(model)
    state = initial_state(model)
    for _ in range(20):
        report = solver.step(state)
        assert report.converged.all(), report.summary()
        assert report.joint_violation_m.max() < 1e-9
    assert solver.joints is not None
    assert abs(solver.joints.coordinates.numpy()[0, 0]) > 0.3, "it swings"


def deterministic_run(name: str, env_count: int, **options: object) -> list[np.ndarray]:
    """State and forces after each of up to 30 steps of a benchmark scene whose environments
    differ."""
    chosen = SceneOptions(env_count, config={"deterministic": True, **options}, lag=5)
    bench = build_scene(name, chosen)
    model = bench.scene.finalize("cuda:0")
    solver = SolverIPC(model, bench.config)
    state = initial_state(model, bench.targets(0))
    found, rubs = [], False
    for step in range(1, min(30, bench.steps) + 1):
        report = solver.step(state, bench.targets(step))
        assert report.converged.all(), report.summary()
        forces = [solver.contact_gradient, solver.friction_gradient]
        arrays = [state.positions, state.velocities, state.poses, *forces]
        found.append(np.concatenate([array.numpy().ravel() for array in arrays]))
        rubs = rubs or bool(solver.friction_gradient.numpy().any())
    assert rubs
    return found


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
    first, second = (deterministic_run(name, env_count, **options) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_same_bits_are_those_of_the_same_motion() -> None:
    _, plain = lift_cube(grasp())
    _, ordered = lift_cube(grasp(), deterministic=True)
    np.testing.assert_allclose(ordered.positions.numpy(), plain.positions.numpy(), atol=1e-7)
