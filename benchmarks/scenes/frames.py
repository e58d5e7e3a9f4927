# SPDX-License-Identifier: Apache-2.0
"""Poses of mounts from directions."""

from __future__ import annotations

from itertools import pairwise

import numpy as np


def quaternion(matrix: np.ndarray) -> np.ndarray:
    """x, y, z, w of a rotation matrix [3, 3], by the largest of its four squares (Shepperd)."""
    m = np.asarray(matrix, dtype=np.float64)
    squares = np.array(
        [
            1 + m[0, 0] - m[1, 1] - m[2, 2],
            1 - m[0, 0] + m[1, 1] - m[2, 2],
            1 - m[0, 0] - m[1, 1] + m[2, 2],
            1 + m[0, 0] + m[1, 1] + m[2, 2],
        ]
    )
    x, y, z, w = squares / 4
    axis, wx, wy, wz = (
        int(squares.argmax()),
        *[(m[(i + 2) % 3, (i + 1) % 3] - m[(i + 1) % 3, (i + 2) % 3]) / 4 for i in range(3)],
    )
    xy, yz, zx = (m[i, j] + m[j, i] for i, j in ((0, 1), (1, 2), (2, 0)))
    rows = [
        (x, xy / 4, zx / 4, wx),
        (xy / 4, y, yz / 4, wy),
        (zx / 4, yz / 4, z, wz),
        (wx, wy, wz, w),
    ]
    found = np.array(rows[axis])
    return found / np.linalg.norm(found)


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
    return np.concatenate([place, quaternion(matrix)])


def same_side(poses: np.ndarray) -> np.ndarray:
    """The same poses [step, ..., 7], each quaternion on the side of the one before."""
    poses = poses.copy()
    for before, after in pairwise(poses):
        across = (before[..., 3:] * after[..., 3:]).sum(axis=-1, keepdims=True) < 0
        after[..., 3:] = np.where(across, -after[..., 3:], after[..., 3:])
    return poses
