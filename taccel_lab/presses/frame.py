# SPDX-License-Identifier: Apache-2.0
"""The frame of a press: where its indenter comes down along -z, wherever that is in the gel.

On a dome a press goes along the contact face's normal. ``gel_from_press`` is a pose as everywhere:
position [m] and quaternion x, y, z, w, shape [7].
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.model.embedding import rotate

if TYPE_CHECKING:
    from taccel_lab.cad.parts.pad import Pad


def normal_frame(point_m: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """gel_from_press with its origin at a point and z along a unit normal, [3], [3] -> [7].

    The least turn that takes the gel's z to the normal, so that x stays as near to the image's x
    as it can. A normal along -z is turned about y.
    """
    point, n = np.asarray(point_m, dtype=np.float64), np.asarray(normal, dtype=np.float64)
    if point.shape != (3,) or n.shape != (3,) or not np.isfinite([point, n]).all():
        raise InputError(f"a press frame needs a finite point and normal, got {point}, {n}")
    length = float(np.linalg.norm(n))
    if abs(length - 1) > 1e-6:
        raise InputError(f"the normal of a press frame must have unit length, got {length:g}")
    # Half way between z and n: the quaternion (z x n, 1 + z . n), normalised; near -z the sum
    # has lost the digits that the components across z still have.
    across = float(n[0] ** 2 + n[1] ** 2)
    quaternion = np.array([-n[1], n[0], 0.0, 1 + n[2] if n[2] > 0 else across / (1 - n[2])])
    if across < np.finfo(np.float64).tiny and n[2] < 0:
        quaternion = np.array([0.0, 1.0, 0.0, 0.0])
    return np.concatenate([point, quaternion / np.linalg.norm(quaternion)])


def face_frame(pad: Pad, at_mm: tuple[float, float]) -> np.ndarray:
    """gel_from_press of a press along the normal of a pad's face at gel xy, [7].

    Raises:
        InputError: A place beside the pad.
    """
    xy = np.array(at_mm)
    top, normal = float(pad.top_mm(xy)), pad.top_normal(xy)
    if not (math.isfinite(top) and np.isfinite(normal).all()):
        raise InputError(f"({xy[0]:.3g}, {xy[1]:.3g}) mm lies beside the contact face")
    return normal_frame(np.append(xy, top) * 1e-3, normal)


class PressFrames:
    """gel_from_press of each environment; without any, press and gel frame are the same."""

    def __init__(self, gel_from_press: np.ndarray | None, env_count: int) -> None:
        """``gel_from_press``: [env_count, 7] or None. Raises InputError for anything else."""
        self._poses = None
        if gel_from_press is None:
            return
        poses = np.asarray(gel_from_press, dtype=np.float64)
        if poses.shape != (env_count, 7) or not np.isfinite(poses).all():
            raise InputError(
                f"gel_from_press must be finite, shape [{env_count}, 7], got {poses.shape}"
            )
        norm = np.linalg.norm(poses[:, 3:], axis=1)
        if (np.abs(norm - 1) > 1e-6).any():
            raise InputError(f"quaternions of gel_from_press must have unit length, got {norm}")
        self._poses = poses

    def points_in_press(self, env: int, points_in_gel: np.ndarray) -> np.ndarray:
        """Points of the gel frame [m] in the press frame of an environment, [n, 3] -> [n, 3]."""
        if self._poses is None:
            return points_in_gel
        pose = self._poses[env]
        return rotate(pose[3:] * [-1, -1, -1, 1], points_in_gel - pose[:3])

    def vectors_in_press(self, vectors_in_gel: np.ndarray) -> np.ndarray:
        """Directions of the gel frame, one an environment, in the press frames, [env, 3]."""
        if self._poses is None:
            return vectors_in_gel
        return rotate(self._poses[:, 3:] * [-1, -1, -1, 1], vectors_in_gel)

    def down_in_gel(self, env_count: int) -> np.ndarray:
        """Where the indenters come down along, in the gel frame, [env_count, 3]."""
        down = np.array([0.0, 0.0, -1.0])
        if self._poses is None:
            return np.tile(down, (env_count, 1))
        return rotate(self._poses[:, 3:], np.tile(down, (len(self._poses), 1)))

    def poses_in_gel(self, position: np.ndarray, turn_rad: np.ndarray | float) -> np.ndarray:
        """Poses of bodies at ``position`` [env, 3] of their press frames and turned about its z by
        one angle or one an environment, or by rotation vectors [env, 3], as gel_from_indenter,
        [env, 7]."""
        poses = np.zeros((len(position), 7))
        poses[:, :3] = position
        half = 0.5 * np.asarray(turn_rad, dtype=np.float64)
        if half.ndim == 2:
            angle = np.linalg.norm(half, axis=1)
            poses[:, 3:6] = half * np.sinc(angle / np.pi)[:, None]
            poses[:, 6] = np.cos(angle)
        else:
            poses[:, 5], poses[:, 6] = np.sin(half), np.cos(half)
        if self._poses is None:
            return poses
        frame, turn = self._poses[:, 3:], poses[:, 3:].copy()
        poses[:, :3] = self._poses[:, :3] + rotate(frame, position)
        # Hamilton product of the frame's quaternion and the turn about z.
        poses[:, 3:6] = (
            frame[:, 3:] * turn[:, :3]
            + turn[:, 3:] * frame[:, :3]
            + np.cross(frame[:, :3], turn[:, :3])
        )
        poses[:, 6] = frame[:, 3] * turn[:, 3] - (frame[:, :3] * turn[:, :3]).sum(axis=1)
        return poses
