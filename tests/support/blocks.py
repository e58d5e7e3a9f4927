# SPDX-License-Identifier: Apache-2.0
"""Meshes, poses and scenes that the verification tests share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from taccel_lab.bodies.primitives import TriangleMesh, box_mesh, sphere_mesh
from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.block import block_mesh, free_block, grid_tets, labelled
from taccel_lab.scene import (
    AffineBody,
    Element,
    KinematicBody,
    Material,
    Scene,
    SoftBody,
    TimeStepping,
)

__all__ = [
    "block_mesh",
    "bumpy_body",
    "cube",
    "everywhere",
    "free_block",
    "grid_tets",
    "labelled",
    "pose",
    "scene",
    "soft_block",
]


def pose(
    x: float, y: float, z: float, axis: Sequence[float] | np.ndarray = (0, 0, 1), deg: float = 0.0
) -> np.ndarray:
    """One pose (position [m], quaternion x, y, z, w), shape [7]."""
    half = np.deg2rad(deg) / 2
    direction = np.asarray(axis) / np.linalg.norm(axis)
    return np.array([x, y, z, *(np.sin(half) * direction), np.cos(half)])


def everywhere(env_count: int, *poses: np.ndarray) -> np.ndarray:
    """The same poses of the bodies in all environments, shape [env_count, body_count, 7]."""
    return np.tile(np.stack(poses), (env_count, 1, 1))


def bumpy_body(seed: int, radius_m: float, depth: float = 0.4) -> TriangleMesh:
    """A closed star-shaped surface of 42 vertices with random dents and spikes."""
    ball = sphere_mesh(radius_m, 0.5 * radius_m)
    scale = 1 + depth * np.random.default_rng(seed).uniform(-1, 1, (len(ball.vertices_m), 1))
    return TriangleMesh(ball.vertices_m * scale, ball.faces)


def scene(
    mesh: TetMesh,
    *bodies: KinematicBody,
    env_count: int = 1,
    young_pa: float = 1e5,
    poisson: float = 0.4,
    density: float = 1000.0,
    time: TimeStepping | None = None,
    rest_m: np.ndarray | None = None,
    bonded: np.ndarray | None = None,
) -> Scene:
    """A scene with the usual gel."""
    soft = SoftBody(
        mesh, Material(young_pa, poisson, density), bonded, rest_m, element=Element.LINEAR
    )
    return Scene(soft, tuple(bodies), env_count, time or TimeStepping())


def soft_block(
    cells: tuple[int, int, int],
    size_m: tuple[float, float, float],
    material: Material | None = None,
    element: Element = Element.LINEAR,
    **options: Any,
) -> SoftBody:
    """A block of the usual gel whose back is glued; ``options``: of ``SoftBody``."""
    mesh = block_mesh(cells, size_m)
    return SoftBody(mesh, material or Material(1e5, 0.4), element=element, **options)


def cube(
    side_m: float, at: np.ndarray | None = None, name: str = "cube", **options: Any
) -> AffineBody:
    """A stiff cube; ``at``: its initial pose, the origin when None; ``options``: of
    ``AffineBody``."""
    shape = box_mesh((side_m, side_m, side_m))
    if at is not None:
        options["initial_pose"] = at
    return AffineBody(shape, name=name, **options)
