# SPDX-License-Identifier: Apache-2.0
"""``Control``: what a user asks of a step, of all environments or of those that begin one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass
class Control:
    """Targets and loads of a step; what is None stays as it is.

    Arrays of numpy are checked. Arrays on the solver's device, such as torch tensors of float64
    (through DLPack) and arrays of Warp, are read where they are. Their values are not checked, as
    that would wait for the device.
    """

    target_poses: Any = None
    """Where the kinematic bodies are at the end of the step: position [m], quaternion x, y, z, w,
    [env_count, kinematic_count, 7]."""
    joint_targets: Any = None
    """Targets of the drives of joints [rad, m, rad/s or m/s], [env_count, joint_count], in the
    order of the scene; they stay until changed, as ``state.joints.targets``."""
    dt_s: float | None = None
    """Length of the step [s]; the scene's when None. Steps of a quasi-static scene have one only
    where a material relaxes."""
    forces: Any = None
    """Forces on nodes [N], [env_count, node_count, 3]; they stay until changed, see
    ``State.load``."""
    wrenches: Any = None
    """Forces [N] and torques [N m] on affine bodies, [env_count, affine_count, 2, 3]; they stay
    until changed."""
