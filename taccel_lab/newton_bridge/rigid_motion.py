# SPDX-License-Identifier: Apache-2.0
"""How an affine body moves, as newton says it of a rigid one."""

from __future__ import annotations

import numpy as np

from taccel_lab.bodies.mass_properties import MassProperties
from taccel_lab.robots.transforms import pose_of


def rigid_motion(
    y: np.ndarray, v: np.ndarray, solid: MassProperties
) -> tuple[np.ndarray, np.ndarray]:
    """Poses [n, 7], and velocities of the centre with angular velocities [n, 6], of the rotations
    nearest to an affine body's maps; ``y``, ``v``: its control nodes, [n, 4, 3]."""
    affine = y[:, 1:].swapaxes(1, 2) @ solid.axes.T / solid.radius_m
    rate = v[:, 1:].swapaxes(1, 2) @ solid.axes.T / solid.radius_m @ np.linalg.inv(affine)
    left, _, right = np.linalg.svd(affine)
    place = np.tile(np.eye(4), (len(y), 1, 1))
    place[:, :3, :3] = left @ right
    place[:, :3, 3] = y[:, 0] - place[:, :3, :3] @ solid.center_m
    skew = (rate - rate.swapaxes(1, 2)) / 2
    spin = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    return pose_of(place), np.concatenate([v[:, 0], spin], axis=1)
