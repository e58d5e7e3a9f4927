# SPDX-License-Identifier: Apache-2.0
"""Joints of affine bodies as a potential: constraints to a tolerance, limits and drives.

How the solver uses it in a step: ``begin_step``; then ``set_frames`` before energies and gradients
whenever the kinematic bodies have moved; once Newton has converged, ``update_multipliers`` and, for
environments in which a joint is still off by more than ``tolerance_m``, Newton again; ``end_step``,
or ``restore`` where the step failed.
Multipliers last from step to step, so a mechanism under steady load needs no second round.

The matrix leaves out the curvature of the rows (Gauss-Newton): it is that of a multiplier over a
length, next to a penalty some 1e4 times the inertia, and the only part that could be indefinite.

Joints of bodies that were predicted one by one (``ipc.affine.rigidity``) are closed from the root
of each mechanism on: a body is turned as little as brings its joint's directions onto those of its
parent, and shifted so that their points meet. Joints that close a loop are left to Newton's method.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.bodies.joints import ROW_COUNT
from taccel_lab.ipc.device.matrices import mat43d
from taccel_lab.ipc.joints.kernels import (
    JointStep,
    absorb_forces_kernel,
    begin_joints_kernel,
    evaluate_rows_kernel,
    joint_energy_kernel,
    joint_gradient_kernel,
    joint_hessian_kernel,
    joint_outputs_kernel,
    joint_rounding_kernel,
    joint_violation_kernel,
    largest_violation_kernel,
    node_controls,
    second_controls,
)
from taccel_lab.ipc.joints.layout import JointTable, joint_layout
from taccel_lab.ipc.joints.rows import PRISMATIC, REVOLUTE, matrix_row, with_row
from taccel_lab.ipc.linear.problem.scatter import NewtonSystem
from taccel_lab.ipc.potentials.energy import Potential
from taccel_lab.model import Model
from taccel_lab.model.env_lists import EnvMask
from taccel_lab.model.env_rows import copy_rows, device_mask, zero_rows
from taccel_lab.model.launches import launch
from taccel_lab.state import JointState

wp.set_module_options({"enable_backward": False})


@wp.func
def turn_onto(source: wp.vec3d, target: wp.vec3d) -> wp.mat33d:
    """Smallest rotation of one unit vector onto another that is not opposite."""
    n = wp.cross(source, target)
    cross = wp.skew(n)
    scale = wp.float64(1.0) / (wp.float64(1.0) + wp.dot(source, target))
    return wp.identity(n=3, dtype=wp.float64) + cross + scale * (cross * cross)


@wp.func
def _directions(frame: mat43d) -> wp.mat33d:
    return wp.matrix_from_cols(
        wp.normalize(matrix_row(frame, 1)),
        wp.normalize(matrix_row(frame, 2)),
        wp.normalize(matrix_row(frame, 3)),
    )


@wp.func
def placed_child(
    kind: int, child: mat43d, child_weights: wp.mat44d, child_frame: mat43d, parent_frame: mat43d
) -> mat43d:
    """Control vectors of a body moved so that its joint to a placed parent is closed."""
    gap = matrix_row(child_frame, 0) - matrix_row(parent_frame, 0)
    axis = wp.normalize(matrix_row(parent_frame, 1))
    if kind == REVOLUTE:
        turn = turn_onto(wp.normalize(matrix_row(child_frame, 1)), axis)
    else:
        turn = _directions(parent_frame) * wp.transpose(_directions(child_frame))
    point = matrix_row(parent_frame, 0)
    if kind == PRISMATIC:
        point += wp.dot(axis, gap) * axis
    result = child
    for k in range(1, 4):
        turned = turn * matrix_row(child, k)
        result = with_row(result, k, turned)
        point -= child_weights[0, k] * turned
    return with_row(result, 0, point)


@wp.kernel
def close_joints_kernel(
    active: wp.array(dtype=wp.int32),
    tree: wp.array(dtype=wp.vec2i),
    poses: wp.array2d(dtype=wp.transformd),
    t: JointTable,
    positions: wp.array2d(dtype=wp.vec3d),
):
    """Move control nodes along ``tree``: joint, and 1 where its second body is the one to move."""
    env = wp.tid()
    if active[env] == 0:
        return
    for entry in range(tree.shape[0]):
        joint = tree[entry][0]
        if t.present[env, joint] != 0:
            w_a = t.first_weights[env % t.first_weights.shape[0], joint]
            w_b = t.second_weights[env % t.second_weights.shape[0], joint]
            a = node_controls(env, t.first_controls[joint], positions)
            b = second_controls(env, joint, t, positions, poses)
            start = t.first_controls[joint]
            placed = placed_child(t.kinds[joint], a, w_a, w_a * a, w_b * b)
            if tree[entry][1] != 0:
                start = t.second_controls[joint]
                placed = placed_child(t.kinds[joint], b, w_b, w_b * b, w_a * a)
            for k in range(4):
                positions[env, start + k] = matrix_row(placed, k)


class JointPotential(Potential):
    """Joints of a scene; built only when it has some."""

    def __init__(self, model: Model) -> None:
        self.model = model
        layout = joint_layout(model)
        self.joints = layout.joints
        """Joints of the scene, in the order of all arrays here."""
        self.tolerance_m = 1e-9 * layout.smallest_size_m
        """Violation of a constraint that counts as none [m]."""
        self._table, self._colors, self._tree = layout.table, layout.colors, layout.tree
        self._shape = shape = (model.env_count, len(layout.joints))
        device = model.device

        def scalars() -> wp.array:
            return wp.zeros(shape, dtype=wp.float64, device=device)

        self.energies = scalars()
        """Energy of each joint [J], shape [env_count, joint_count]."""
        self.state = JointState.at_rest(model)
        """State of the step at hand: a solver copies it from and to its ``State``."""
        self.coordinates = self.state.coordinates
        """Angle [rad], whole turns included, or slide [m], shape [env_count, joint_count]."""
        self.rates = scalars()
        """Mean rate over the last step [rad/s or m/s], shape [env_count, joint_count]."""
        self.efforts = scalars()
        """Torque [N m] or force [N] of the drives, shape [env_count, joint_count]."""
        self.forces = wp.zeros(shape, dtype=wp.vec3d, device=device)
        """Force of the joint on its first body [N], world axes, shape [env_count, joint_count]."""
        self.torques = wp.zeros(shape, dtype=wp.vec3d, device=device)
        """Torque on the first body about the anchor [N m], drives and limits included, world
        axes, shape [env_count, joint_count]."""
        self.rounding_n = wp.zeros(model.env_count, dtype=wp.float64, device=device)
        """Residual that rounding of the positions alone causes [N], float64, [env_count]."""
        self.rounding_j = wp.zeros(model.env_count, dtype=wp.float64, device=device)
        """Energy that it causes [J], float64, [env_count]."""
        self.violations = wp.zeros(model.env_count, dtype=wp.float64, device=device)
        """Largest violation at the last ``update_multipliers`` [m], float64, [env_count]."""
        self._values = wp.zeros((*shape, ROW_COUNT), dtype=wp.float64, device=device)
        self._derivatives = wp.zeros((*shape, ROW_COUNT, 8), dtype=wp.vec3d, device=device)
        self._joint_violations = scalars()
        self._mask = wp.zeros(model.env_count, dtype=wp.int32, device=device)
        self._step = JointStep()
        self._step.dts = wp.full(
            model.env_count, model.scene.time.dt_s, dtype=wp.float64, device=device
        )
        self._step.starts = scalars()
        self._step.targets = scalars()
        self._step.multipliers = self.state.multipliers
        self._start_multipliers = wp.zeros_like(self._step.multipliers)
        kinematic = (model.env_count, len(model.scene.kinematic_bodies))
        self._poses = wp.zeros(kinematic, dtype=wp.transformd, device=device)
        self._goals = self._poses

    # A step ------------------------------------------------------------------------------------

    def set_frames(self, poses: wp.array, goals: wp.array | None = None) -> None:
        """Where kinematic bodies are, and where the next direction moves them (there, when None).

        Both transformd, [env_count, kinematic_count]; kept, not copied.
        """
        self._poses = poses
        self._goals = poses if goals is None else goals

    def begin_step(
        self,
        positions: wp.array,
        poses: wp.array,
        dts: wp.array | None = None,
        mask: wp.array | None = None,
    ) -> None:
        """Start a step of length ``dts`` [s], float64 [env_count], the scene's when None, in the
        environments of ``mask`` (int32, [env_count]); in all when None."""
        if dts is None:
            self._step.dts.fill_(self.model.scene.time.dt_s)
        else:
            wp.copy(self._step.dts, dts)
        self.set_frames(poses)
        if mask is None:
            self._mask.fill_(1)
            mask = self._mask
        self._bound_rounding(mask, positions)
        # The state may have been set anew since: coordinates follow it, by whole turns nearest.
        self._evaluate(mask, positions, self.coordinates, derivatives=False)
        inputs = [mask, self._values, self.state.targets, self._step, self._start_multipliers]
        launch(begin_joints_kernel, self._shape, *inputs)

    def close_predicted(self, active: EnvMask, positions: wp.array) -> None:
        """Move control nodes of affine bodies, placed each by itself, so that joints are closed."""
        inputs = [active, self._tree, self._poses, self._table, positions]
        launch(close_joints_kernel, self.model.env_count, *inputs)

    def update_multipliers(self, active: EnvMask, positions: wp.array) -> None:
        """Measure ``violations`` of constraints and limits [m] in active environments.

        Where they exceed ``tolerance_m``, the constraint forces become multipliers, and Newton has
        to converge once more; elsewhere nothing changes.
        """
        self._evaluate(active, positions, derivatives=False)
        inputs = [active, self._values, self._table, self._step, self._joint_violations]
        launch(joint_violation_kernel, self._shape, *inputs)
        inputs = [active, self._joint_violations, self.tolerance_m, self.violations, self._mask]
        launch(largest_violation_kernel, len(active), *inputs)
        self._absorb(self._mask)

    def end_step(self, done: wp.array, positions: wp.array) -> None:
        """Read coordinates and reactions where ``done`` (int32, [env_count]) is set, and keep the
        forces as multipliers of the next step."""
        self._evaluate(done, positions)
        inputs = [done, positions, self._values, self._derivatives, self._table, self._step]
        inputs += [self.coordinates, self.rates, self.efforts, self.forces, self.torques]
        launch(joint_outputs_kernel, self._shape, *inputs)
        self._absorb(done)

    def restore(self, mask: EnvMask) -> None:
        """Back to the start of the step in the environments of ``mask`` (int32, [env_count])."""
        copy_rows(mask, self._start_multipliers, self._step.multipliers)

    def reset(self, mask: np.ndarray | wp.array) -> None:
        """Forget forces, turns and what was read of the last step in the environments of ``mask``
        (bool, or int32 on the device, [env_count])."""
        mask = device_mask(mask, self.model.env_count, self.model.device)
        arrays = [self._step.multipliers, self.coordinates, self.rates, self.efforts]
        for array in [*arrays, self.forces, self.torques]:
            zero_rows(mask, array)

    # A potential -------------------------------------------------------------------------------

    def write_energies(self, active: EnvMask, positions: wp.array) -> None:
        """Fill ``energies`` [J] of active environments. Its zero has no meaning."""
        self._evaluate(active, positions, derivatives=False)
        inputs = [active, self._values, self._table, self._step, self.energies]
        launch(joint_energy_kernel, self._shape, *inputs)

    def add_gradient(self, active: EnvMask, positions: wp.array, gradient: wp.array) -> None:
        """Add d energy / dx [N], shape [env_count, node_count]."""
        self._evaluate(active, positions)
        inputs = [self._values, self._derivatives]
        self._launch_groups(joint_gradient_kernel, active, inputs, gradient)

    def add_hessian(
        self,
        active: EnvMask,
        positions: wp.array,
        system: NewtonSystem,
        psd_modes: wp.array | None = None,
    ) -> None:
        """Add the Gauss-Newton matrix [N/m], positive semidefinite in every mode, and to
        the right-hand side what the motion of kinematic frames to their goals asks for [N]."""
        self._evaluate(active, positions)
        inputs = [self._values, self._derivatives, self._poses, self._goals]
        self._launch_groups(joint_hessian_kernel, active, inputs, system)

    # Parts -------------------------------------------------------------------------------------

    def _evaluate(
        self,
        active: EnvMask,
        positions: wp.array,
        references: wp.array | None = None,
        derivatives: bool = True,
    ) -> None:
        inputs = [active, positions, self._poses, self._table]
        inputs += [self._step.starts if references is None else references, self._values]
        inputs += [self._derivatives if derivatives else None]
        launch(evaluate_rows_kernel, (*self._shape, ROW_COUNT), *inputs)

    def _bound_rounding(self, mask: EnvMask, positions: wp.array) -> None:
        affine = self.model.affine
        inputs = [mask, positions, affine.first_control, 4 * affine.count, self._table, self._step]
        launch(
            joint_rounding_kernel, self.model.env_count, *inputs, self.rounding_n, self.rounding_j
        )

    def _absorb(self, which: wp.array) -> None:
        inputs = [which, self._values, self._table, self._step]
        launch(absorb_forces_kernel, (*self._shape, ROW_COUNT), *inputs)

    def _launch_groups(
        self, kernel: wp.Kernel, active: EnvMask, inputs: list, out: wp.array | NewtonSystem
    ) -> None:
        for group in self._colors:
            dim = (self._shape[0], len(group), 8)
            launch(kernel, dim, active, group, *inputs, self._table, self._step, out)
