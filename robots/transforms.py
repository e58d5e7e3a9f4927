# SPDX-License-Identifier: Apache-2.0
"""Poses as 4 x 4 matrices, and as scenes take them: position [m], quaternion x, y, z, w."""

from __future__ import annotations

import numpy as np


def matrix_of(pose: np.ndarray) -> np.ndarray:
    """Poses [..., 7], their quaternions of unit length, as matrices [..., 4, 4]."""
    from scipy.spatial.transform import Rotation

    matrix = np.zeros((*pose.shape[:-1], 4, 4))
    turns = Rotation.from_quat(pose[..., 3:].reshape(-1, 4)).as_matrix()
    matrix[..., :3, :3] = turns.reshape(*pose.shape[:-1], 3, 3)
    matrix[..., :3, 3] = pose[..., :3]
    matrix[..., 3, 3] = 1.0
    return matrix


def pose_of(matrix: np.ndarray) -> np.ndarray:
    """Rigid matrices [..., 4, 4] as poses [..., 7]; the quaternion's last part is not negative."""
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_matrix(matrix[..., :3, :3].reshape(-1, 3, 3)).as_quat(canonical=True)
    return np.concatenate([matrix[..., :3, 3], turns.reshape(*matrix.shape[:-2], 4)], axis=-1)


def rotation_vector(rotation: np.ndarray) -> np.ndarray:
    """Axis times angle [rad] of rotations [n, 3, 3], shape [n, 3]; angles up to pi."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(rotation).as_rotvec()
