# SPDX-License-Identifier: Apache-2.0
"""Where gels are: the frames of their meshes, which their mounts carry along.

On a kinematic body that is the body's pose. An affine body has a linear map A in its place, of
which the nearest rotation counts: U V^T of A = U S V^T [Golub and Van Loan, Matrix Computations,
section 6.4.1]; a body of 1 GPa is within some 1e-6 of it.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.affine.rigidity import affine_map
from taccel_lab.ipc.device.matrices import signed_svd_3x3
from taccel_lab.model import Model
from taccel_lab.model.launches import launch
from taccel_lab.model.turns import in_turn
from taccel_lab.state import State, check_state

wp.set_module_options({"enable_backward": False})


@wp.struct
class _Mounts:
    """Mount of each soft body: its kinematic index or -1, index of the affine body or -1, and
    principal_from_mesh there."""

    frames: wp.array(dtype=wp.int32)
    carriers: wp.array(dtype=wp.int32)
    offsets: wp.array(dtype=wp.transformd)


@wp.kernel
def _gel_frames_kernel(
    m: _Mounts,
    control_starts: wp.array(dtype=wp.int32),
    lengths: wp.array(dtype=wp.float64),
    positions: wp.array2d(dtype=wp.vec3d),
    poses: wp.array2d(dtype=wp.transformd),
    result: wp.array2d(dtype=wp.transformd),
):
    env, gel = wp.tid()
    carrier = m.carriers[gel]
    if carrier >= 0:
        y = control_starts[carrier]
        x = positions[env]
        a = affine_map(x[y + 1], x[y + 2], x[y + 3], lengths[carrier])
        u, _s, v = signed_svd_3x3(a)
        turn = wp.quat_from_matrix(u * wp.transpose(v))
        offset = m.offsets[gel]
        origin = x[y] + a * wp.transform_get_translation(offset)
        turned = wp.normalize(turn * wp.transform_get_rotation(offset))
        result[env, gel] = wp.transformd(origin, turned)
    elif m.frames[gel] >= 0:
        result[env, gel] = poses[env, m.frames[gel]]
    else:
        result[env, gel] = wp.transform_identity(dtype=wp.float64)


class GelFrames:
    """Reads the frames of a model's gels, on the device and without waiting for it."""

    @in_turn
    def __init__(self, model: Model) -> None:
        self._model = model
        scene, device = model.scene, model.device
        kinematic = [body.name for body in scene.kinematic_bodies]
        mounts = [body.mount for body in scene.soft_bodies]
        self.columns = [kinematic.index(m) if m in kinematic else -1 for m in mounts]
        """Column of ``State.poses`` of each gel's mount, -1 unless it is kinematic."""
        self.carriers = scene.carriers
        """Affine body that each gel is mounted on, -1 for none."""
        offsets = np.tile([0.0, 0, 0, 0, 0, 0, 1], (len(mounts), 1))
        for gel, carrier in enumerate(self.carriers):
            if carrier >= 0:
                solid = model.affine.properties[carrier]
                pose = scene.soft_bodies[gel].mount_pose
                pose = offsets[gel] if pose is None else pose
                turn = wp.quat_from_matrix(wp.mat33d(solid.axes.T.ravel()))
                offsets[gel, :3] = solid.to_principal(pose[:3])
                offsets[gel, 3:] = list(turn * wp.quatd(*pose[3:]))
        self._mounts = _Mounts()
        self._mounts.frames = wp.array(self.columns, dtype=wp.int32, device=device)
        self._mounts.carriers = wp.array(self.carriers, dtype=wp.int32, device=device)
        self._mounts.offsets = wp.array(offsets, dtype=wp.transformd, device=device)

    @in_turn
    def read(self, state: State) -> wp.array:
        """world_from_mesh of each soft body, transformd, shape [env_count, soft_count]; the
        identity for one without a mount."""
        model = self._model
        check_state(state, model)
        shape = (model.env_count, len(self.columns))
        result = wp.empty(shape, dtype=wp.transformd, device=model.device)
        affine = model.affine
        if result.size:
            inputs = [self._mounts, affine.control_starts, affine.lengths, state.positions]
            launch(_gel_frames_kernel, shape, *inputs, state.poses, result)
        return result

    def of(self, gel: int, state: State) -> wp.array | None:
        """Pose world_from_mesh of one soft body, transformd, [env_count], as signals take it; of a
        kinematic mount the state's own array. None without a mount."""
        if self.carriers[gel] >= 0:
            return self.read(state)[:, gel]
        check_state(state, self._model)
        return None if self.columns[gel] < 0 else state.poses[:, self.columns[gel]]
