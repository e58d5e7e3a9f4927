# SPDX-License-Identifier: Apache-2.0
"""Gels on mounts, and poses of mounts from directions."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from taccel_lab.geometry import TetMesh
from taccel_lab.scene import Element, KinematicBody, SoftBody
from taccel_lab.tasks.peg_scene import GEL


def mounted(
    meshes: Mapping[str, TetMesh], friction: float, **options: Any
) -> tuple[list[SoftBody], list[KinematicBody]]:
    """A gel of linear tets for each name, and the mount that carries it; ``options``: of
    ``SoftBody``."""
    gels = [
        SoftBody(
            mesh, GEL, name=name, mount=f"{name} mount", friction_coefficient=friction,
            element=Element.LINEAR, **options,
        )
        for name, mesh in meshes.items()
    ]  # fmt: skip
    return gels, [KinematicBody(None, name=f"{name} mount") for name in meshes]


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
