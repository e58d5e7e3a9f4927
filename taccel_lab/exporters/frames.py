# SPDX-License-Identifier: Apache-2.0
"""Frames of other projects as rotations of the gel frame (x right, y down in the image, z out).

All are proper rotations: a mesh that was mirrored instead would swap left and right in every image.
"""

from __future__ import annotations

import numpy as np

LINK_FROM_GEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""x out of the gel, y left and z up in the image: the body axes of ROS (REP 103) and of TACTO, for
which the gel frame is the optical one."""

TACCEL_FROM_GEL = np.diag([1.0, -1.0, -1.0])
"""Half a turn about x: Taccel's pads are touched from -z, with the contact face at z = 0."""


def turn(rotation: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points or directions [..., 3] in the frame that ``rotation`` leads to."""
    return np.asarray(points, dtype=np.float64) @ rotation.T


def euler_xyz(rotation: np.ndarray) -> tuple[float, float, float]:
    """Angles [rad] about the fixed axes x, y, z in turn, ``R = Rz Ry Rx``: URDF's rpy, TACTO's
    orientation and scipy's "xyz"."""
    from scipy.spatial.transform import Rotation

    roll, pitch, yaw = Rotation.from_matrix(rotation).as_euler("xyz")
    return float(roll), float(pitch), float(yaw)
