# SPDX-License-Identifier: Apache-2.0
"""What a step is asked for: arrays of the host and of the device do the same, bad ones nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.scene import KinematicBody, PositionDrive, RevoluteJoint, Scene, TimeStepping
from taccel_lab.solvers import Control, SolverConfig
from tests.solvers.steps import Begun, begun, stepped
from tests.support.blocks import cube, everywhere, pose, soft_block

G = 9.81
BOTH = np.ones(2, dtype=bool)


def arm(env_count: int = 2) -> Begun:
    """A block on a driven hinge at a hand, and a block in free fall."""
    drive = PositionDrive(1e-3)
    hinge = RevoluteJoint("arm", "hand", anchor_m=(0, 0, 0), axis=(0, 1, 0), drive=drive)
    scene = Scene(
        affine_bodies=[cube(2e-3, pose(3e-3, 0, 0), "arm"), cube(2e-3, pose(0, 1e-2, 0), "free")],
        kinematic_bodies=KinematicBody(None, name="hand"),
        joints=hinge,
        time=TimeStepping(quasi_static=False, dt_s=2e-3, gravity_m_s2=(0.0, 0.0, -G)),
        env_count=env_count,
    )
    return begun(scene)


def hands(x: float, other: float | None = None) -> np.ndarray:
    found = everywhere(2, pose(x, 0, 0))
    found[1, 0, 0] = 2 * x if other is None else other
    return found


def on_warp(value: np.ndarray) -> wp.array:
    return wp.array(value, dtype=wp.float64, device="cpu")


def test_arrays_of_the_device_do_what_those_of_the_host_do() -> None:
    ends = []
    for put in (np.asarray, torch.from_numpy, on_warp):
        solver, state = arm()
        for step in (1, 2, 3):
            # Another request in each step and environment.
            wrenches = np.zeros((2, 2, 2, 3))
            wrenches[:, 1, 0, 0] = 1e-5 * step, -2e-5
            targets = np.array([[0.05 * step], [-0.02 * step]])
            control = Control(
                put(hands(1e-4 * step)), put(targets), 1e-3 * step, None, put(wrenches)
            )
            stepped(solver, state, control)
        ends.append(state.positions.numpy())
        assert state.joints is not None and solver.joints is not None
        np.testing.assert_array_equal(state.joints.targets.numpy(), targets)
        angles = solver.joints.coordinates.numpy()[:, 0]
        assert angles[0] > angles[1], "the drives were meant to turn the arms"
    np.testing.assert_array_equal(ends[1:], ends[:1] * 2)


def test_a_step_is_as_long_as_asked() -> None:
    solver, state = arm(1)
    free = solver.model.affine.first_control + 4
    z = v = 0.0
    for dt in (1e-3, 4e-3, 5e-4, None):
        stepped(solver, state, Control(dt_s=dt))
        v -= G * (dt or 2e-3)
        z += v * (dt or 2e-3)
        assert state.positions.numpy()[0, free, 2] == pytest.approx(z, rel=1e-9)
    assert state.velocities.numpy()[0, free, 2] == pytest.approx(v, rel=1e-9)


def test_poses_alone_need_no_control() -> None:
    poses, ends = hands(3e-4), []
    for control in (poses, Control(poses), Control(target_poses=torch.from_numpy(poses))):
        solver, state = arm()
        solver.step(state, control)
        ends.append(state.positions.numpy())
    np.testing.assert_array_equal(ends[1:], ends[:1] * 2)


@pytest.mark.parametrize("view", ["expanded", "sliced", "turned"])
def test_views_of_torch_are_read_as_they_look(view: str) -> None:
    """Whatever the memory below them: by a step, and by a reset, which copies rows."""
    if view == "expanded":
        poses = hands(1e-4, 1e-4)
        given = torch.cat([torch.from_numpy(poses[:1]), torch.zeros(1, 1, 7)])[:1].expand(2, 1, 7)
    else:
        poses = hands(1e-4)
        given = torch.zeros((2, 3, 7) if view == "sliced" else (7, 1, 2), dtype=torch.float64)
        given = given[:, 1:2] if view == "sliced" else given.permute(2, 1, 0)
        given[:] = torch.from_numpy(poses)
    assert not given.is_contiguous()
    solver, state = arm()
    stepped(solver, state, given)
    np.testing.assert_array_equal(state.poses.numpy(), poses)
    solver.reset(state, BOTH, hands(0))
    solver.reset(state, BOTH, given)
    np.testing.assert_array_equal(state.poses.numpy(), poses)


def test_forces_are_those_of_the_state() -> None:
    """Of the host or of the device, or loaded before; they stay until changed."""
    ends = []
    for put in (torch.from_numpy, np.asarray, None):
        solver, state = arm()
        forces = np.zeros((2, solver.model.node_count, 3))
        forces[:, solver.model.bodies[1].nodes[0], 0] = 1e-5
        if put is None:
            state.load(solver.model, forces)
        solver.step(state, Control() if put is None else Control(forces=put(forces)))
        solver.step(state)
        ends.append(state.positions.numpy())
    np.testing.assert_array_equal(ends[1:], ends[:1] * 2)


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        ({"dt_s": 0.0}, r"dt must lie in \[1e-06, 10\] s, got 0"),
        ({"dt_s": float("nan")}, "dt must lie in"),
        ({"joint_targets": np.zeros(2)}, r"joint_targets must have shape \[2, 1\], got \[2\]"),
        ({"joint_targets": [[np.nan], [0.0]]}, "joint_targets holds NaN"),
        ({"joint_targets": torch.zeros(2, 1)}, r"joint_targets on the device are float32 .*"),
        ({"wrenches": torch.zeros(2, 2, 3).double()}, r"expected float64 of shape \[2, 2, 2, 3\]"),
        ({"target_poses": np.zeros((2, 1, 7))}, "must have unit length"),
        ({"target_poses": wp.zeros((2, 2), wp.transformd, device="cpu")}, r"of shape \[2, 2\]"),
        ({"target_poses": torch.zeros(2, 1, 7)}, "expected float64 of shape"),
        ({"forces": np.zeros((2, 3))}, "forces must have shape"),
    ],
)
def test_bad_requests_are_refused_and_change_nothing(
    request_: dict[str, Any], message: str
) -> None:
    solver, state = arm()
    before = state.positions.numpy().copy()
    good = {"joint_targets": np.ones((2, 1))} if "joint_targets" not in request_ else {}
    with pytest.raises(InputError, match=message):
        solver.step(state, Control(**good, **request_))
    np.testing.assert_array_equal(state.positions.numpy(), before)
    assert state.joints is not None and not state.joints.targets.numpy().any()
    assert state.external_forces is None and state.wrenches is None


def test_what_the_scene_does_not_have_is_refused() -> None:
    solver, state = begun(Scene(soft_block((2, 2, 2), (2e-3, 2e-3, 2e-3))))
    with pytest.raises(InputError, match="needs quasi_static=False"):
        solver.step(state, Control(dt_s=1e-3))
    with pytest.raises(InputError, match="the scene has no joints"):
        solver.step(state, Control(joint_targets=np.zeros((1, 0))))


@pytest.mark.gpu
@pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device")
def test_a_state_on_another_device_is_refused() -> None:
    solver, state = arm()
    state.positions = wp.clone(state.positions, device="cuda:0")
    with pytest.raises(InputError, match="positions of the state are on cuda:0, the solver is on"):
        solver.step(state)


NAN = float("nan")
BAD = {
    "dhat_m": (0.0, -1e-5, 1.0, NAN),
    "relative_tolerance": (0.0, 2.0),
    "absolute_tolerance_n": (NAN, -1.0),
    "friction_eps_m": (0.0, float("inf")),
    "friction_speed_m_s": (0.0, NAN),
    "friction_step_share": (-0.1, 2.0, NAN),
    "kappa_pa": (0.0, NAN),
    "max_newton_iterations": (0,),
    "max_step_iterations": (0,),
    "max_cg_iterations": (-3,),
    "max_friction_lags": (0,),
    "max_line_search_cuts": (0,),
}


@pytest.mark.parametrize("field", BAD)
def test_absurd_settings_are_refused_by_name(field: str) -> None:
    for value in BAD[field]:
        with pytest.raises(InputError, match=field):
            SolverConfig(**{field: value})
