# SPDX-License-Identifier: Apache-2.0
"""Wrench on each soft body: ``F = sum f_i``, ``M = sum (x_i - x_gel) x f_i`` over its nodes.

What ``signals.resultant_wrench`` says on the host, on the device and without waiting for it. Its
nodes carry all contact and friction of a soft body, so that no pair has to be looked at.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.device.sums import block_total
from taccel_lab.model.env_rows import chosen_env, chosen_numbers
from taccel_lab.model.launches import WARP_THREADS, launch_blocks
from taccel_lab.model.turns import in_turn
from taccel_lab.outputs.contact_wrenches import vec6d
from taccel_lab.outputs.gel_frames import GelFrames
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.state import State

wp.set_module_options({"enable_backward": False, "block_dim": WARP_THREADS})


@wp.kernel
def _soft_wrench_kernel(
    contact: wp.array2d(dtype=wp.vec3d),
    friction: wp.array2d(dtype=wp.vec3d),
    positions: wp.array2d(dtype=wp.vec3d),
    poses: wp.array2d(dtype=wp.transformd),
    starts: wp.array(dtype=wp.int32),
    mounts: wp.array(dtype=wp.int32),
    envs: wp.array(dtype=wp.int32),
    wrenches: wp.array2d(dtype=vec6d),
):
    """Sums wrenches of the gradients of the energies of contact and friction, which are minus the
    forces. One thread block a body."""
    row, body, lane = wp.tid()
    env = chosen_env(envs, row)
    mount = mounts[body]
    origin = wp.vec3d()
    if mount >= 0:
        origin = wp.transform_get_translation(poses[env, mount])
    force = wp.vec3d()
    torque = wp.vec3d()
    for node in range(starts[body] + lane, starts[body + 1], wp.block_dim()):
        slope = contact[env, node] + friction[env, node]
        force -= slope
        torque -= wp.cross(positions[env, node] - origin, slope)
    force = wp.vec3d(block_total(force[0]), block_total(force[1]), block_total(force[2]))
    torque = wp.vec3d(block_total(torque[0]), block_total(torque[1]), block_total(torque[2]))
    if lane != 0:
        return
    if mount >= 0:
        turn = wp.transform_get_rotation(poses[env, mount])
        force = wp.quat_rotate_inv(turn, force)
        torque = wp.quat_rotate_inv(turn, torque)
    wrenches[row, body] = vec6d(force[0], force[1], force[2], torque[0], torque[1], torque[2])


class SoftWrenchReader:
    """Reads the wrenches of contact and friction on a solver's soft bodies."""

    @in_turn
    def __init__(self, solver: SolverIPC, in_mounts: bool = True) -> None:
        """``in_mounts``: in the frames of the gels, about their origins, where they have mounts;
        otherwise in the world's, as bodies without a mount in any case."""
        model = solver.model
        self._solver = solver
        soft = model.scene.soft_bodies
        starts = [*(body.nodes[0] for body in model.bodies[: len(soft)]), model.soft_count]
        self._frames = GelFrames(model)
        mounts = self._frames.columns
        self._on_affine = in_mounts and max(self._frames.carriers, default=-1) >= 0
        if self._on_affine:
            mounts = [-1 if body.mount is None else i for i, body in enumerate(soft)]
        if not in_mounts:
            mounts = [-1] * len(soft)
        self._starts = wp.array(np.array(starts), dtype=wp.int32, device=model.device)
        self._mounts = wp.array(np.array(mounts), dtype=wp.int32, device=model.device)
        self._everyone = wp.empty(0, dtype=wp.int32, device=model.device)

    @in_turn
    def read(self, state: State, who: np.ndarray | None = None) -> wp.array:
        """Wrenches of the last step, which led to ``state``; see ``Outputs.soft_wrenches``."""
        solver, model = self._solver, self._solver.model
        solver.require_latest(state)
        envs = self._everyone
        if who is not None:
            chosen = chosen_numbers(who, model.env_count)
            envs = wp.array(chosen, dtype=wp.int32, device=model.device)
        count = model.env_count if who is None else len(envs)
        poses = self._frames.read(state) if self._on_affine else state.poses
        wrenches = wp.empty((count, len(self._mounts)), dtype=vec6d, device=model.device)
        inputs = [solver.contact_gradient, solver.friction_gradient, state.positions, poses]
        inputs += [self._starts, self._mounts, envs, wrenches]
        launch_blocks(_soft_wrench_kernel, wrenches.shape, *inputs)
        return wrenches
