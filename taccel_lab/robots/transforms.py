# SPDX-License-Identifier: Apache-2.0
"""Poses as 4 x 4 matrices, and as scenes take them: position [m], quaternion x, y, z, w.

Arrays are numpy's or torch's, by what is given: the kinematics are written once for both. Both have
the names and the arguments of the Python array API standard that are used here
(https://data-apis.org/array-api). torch is not imported for it.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

Array = Any
"""A numpy array, or a tensor of torch on any device."""


def is_tensor(value: Any) -> bool:
    """Whether it is a tensor of torch."""
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(value, torch.Tensor)


def namespace(value: Array) -> Any:
    """The module whose functions take it: torch for its tensors, else numpy."""
    return sys.modules["torch"] if is_tensor(value) else np


class Constants:
    """Arrays that stay as they are, copied once to each device that asks for them."""

    def __init__(self, arrays: Mapping[str, np.ndarray]) -> None:
        self._arrays = dict(arrays)
        self._copies: dict[Any, dict[str, Array]] = {}

    def beside(self, value: Array) -> dict[str, Array]:
        """They by name: of numpy, or tensors on the device of ``value``."""
        if not is_tensor(value):
            return self._arrays
        if value.device not in self._copies:
            xp = namespace(value)
            self._copies[value.device] = {
                name: xp.asarray(array, device=value.device) for name, array in self._arrays.items()
            }
        return self._copies[value.device]


def matrix_of(pose: np.ndarray) -> np.ndarray:
    """Poses [..., 7], their quaternions of unit length, as matrices [..., 4, 4]."""
    from scipy.spatial.transform import Rotation

    matrix = np.zeros((*pose.shape[:-1], 4, 4))
    turns = Rotation.from_quat(pose[..., 3:].reshape(-1, 4)).as_matrix()
    matrix[..., :3, :3] = turns.reshape(*pose.shape[:-1], 3, 3)
    matrix[..., :3, 3] = pose[..., :3]
    matrix[..., 3, 3] = 1.0
    return matrix


def pose_of(matrix: Array) -> Array:
    """Rigid matrices [..., 4, 4] of numpy or torch as poses [..., 7] of the same kind; the
    quaternion's last part is not negative."""
    xp = namespace(matrix)
    a, b, c, d, e, f, g, h, i = (
        matrix[..., row, column] for row in range(3) for column in range(3)
    )
    # Four times the quaternion times each of its parts; the row of the largest part keeps its
    # digits [Shepperd 1978; Markley 2008].
    rows = [
        [1 + a - e - i, b + d, c + g, h - f],
        [b + d, 1 - a + e - i, f + h, c - g],
        [c + g, f + h, 1 - a - e + i, d - b],
        [h - f, c - g, d - b, 1 + a + e + i],
    ]
    products = xp.stack([xp.stack(row, axis=-1) for row in rows], axis=-2)
    squares = xp.stack([row[k] for k, row in enumerate(rows)], axis=-1)
    largest = xp.argmax(squares, axis=-1)[..., None] == xp.arange(4, device=matrix.device)
    row = xp.sum(xp.where(largest[..., None], products, 0.0), axis=-2)
    length = xp.sqrt(xp.sum(row * row, axis=-1))
    turn = row * (xp.where(row[..., 3] < 0, -1.0, 1.0) / length)[..., None]
    return xp.concat([matrix[..., :3, 3], turn], axis=-1)


def rotation_vector(rotation: np.ndarray) -> np.ndarray:
    """Axis times angle [rad] of rotations [n, 3, 3], shape [n, 3]; angles up to pi."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(rotation).as_rotvec()
