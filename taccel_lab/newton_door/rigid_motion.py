# SPDX-License-Identifier: Apache-2.0
"""How an affine body moves, as newton says it of a rigid one."""

from __future__ import annotations

import numpy as np

from taccel_lab.bodies.mass_properties import MassProperties
from taccel_lab.robots.transforms import pose_of


def rigid_motion(
    y: np.ndarray, v: np.ndarray, solid: MassProperties
) -> tuple[np.ndarray, np.ndarray]:
    """Pose [7], and velocity of the centre with angular velocity [6], of the rotation nearest to an
    affine body's map; ``y``, ``v``: its control nodes, [4, 3]."""
    affine = y[1:].T @ solid.axes.T / solid.radius_m
    rate = v[1:].T @ solid.axes.T / solid.radius_m @ np.linalg.inv(affine)
    left, _, right = np.linalg.svd(affine)
    place = np.eye(4)
    place[:3, :3] = left @ right
    place[:3, 3] = y[0] - place[:3, :3] @ solid.center_m
    skew = (rate - rate.T) / 2
    spin = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    return pose_of(place[None])[0], np.concatenate([v[0], spin])
