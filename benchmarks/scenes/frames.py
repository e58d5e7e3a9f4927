# SPDX-License-Identifier: Apache-2.0
"""Poses of mounts from directions."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation


def facing(outward: np.ndarray, right: np.ndarray) -> np.ndarray:
    """world_from_gel [3, 3] of a gel whose face looks to ``outward``, its x axis near ``right``."""
    z = outward / np.linalg.norm(outward)
    x = right - (right @ z) * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def turn_about_z(angle: float) -> np.ndarray:
    """Rotation matrix [3, 3]."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def pose(matrix: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Position and quaternion, [7]."""
    return np.concatenate([place, Rotation.from_matrix(matrix).as_quat(canonical=True)])


def same_side(poses: np.ndarray) -> np.ndarray:
    """The same poses [step, ..., 7], each quaternion on the side of the one before."""
    poses = poses.copy()
    for before, after in pairwise(poses):
        across = (before[..., 3:] * after[..., 3:]).sum(axis=-1, keepdims=True) < 0
        after[..., 3:] = np.where(across, -after[..., 3:], after[..., 3:])
    return poses
