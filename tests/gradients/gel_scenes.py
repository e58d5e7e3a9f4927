# SPDX-License-Identifier: Apache-2.0
"""Small gels under tools, with a parameter each, and the losses whose slopes are compared."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.block import block_mesh
from taccel_lab.gradients import GelMotion, MotionRecord
from taccel_lab.model import Model
from taccel_lab.scene import Ball, Element, KinematicBody, Material, Scene, SoftBody, TriangleMesh
from taccel_lab.solvers import SolverConfig

Array = np.ndarray
MESH = block_mesh((6, 6, 2), (8e-3, 8e-3, 3e-3))
TIGHT = SolverConfig(
    relative_tolerance=1e-11,
    absolute_tolerance_n=1e-13,
    friction_eps_m=2e-5,
    max_cg_iterations=5000,
)
GEL = Material(2e5, 0.42)


@dataclass(frozen=True)
class Case:
    """Gels under one tool, in one or more environments."""

    tool: TriangleMesh | Ball | None
    poses: Array
    """[step + 1, env, tool, 7]: of the tool, and of the mount where there is one."""
    friction: float = 0.0
    material: Material = GEL
    element: Element = Element.LINEAR
    mesh: TetMesh = MESH
    mounted: bool = False
    carried: Material | None = None
    """Of a second gel, which the tool holds: then it is a frame and no more."""
    config: SolverConfig = TIGHT
    scale: float = 1.0

    def model(self) -> Model:
        mesh = replace(self.mesh, nodes_m=self.scale * self.mesh.nodes_m)
        rubs = self.friction
        tools = [KinematicBody(self.tool, rubs if self.carried is None else None, name="tool")]
        if self.mounted:
            tools.append(KinematicBody(None, name="mount"))
        mount = "mount" if self.mounted else None
        gels = [SoftBody(mesh, self.material, element=self.element, mount=mount)]
        if self.carried is not None:
            other = SoftBody(MESH, self.carried, element=self.element, name="other", mount="tool")
            gels = [replace(gel, friction_coefficient=rubs) for gel in (*gels, other)]
        return Scene(gels, tuple(tools), self.poses.shape[1]).finalize("cpu")

    def run(self) -> tuple[GelMotion, MotionRecord]:
        motion = GelMotion(self.model(), self.config)
        record = motion.run(self.poses)
        assert record.causes == [None] * self.poses.shape[1]
        return motion, record


def pose(
    xyz_mm: tuple[float, float, float], turn_deg: tuple[float, float, float] = (0, 0, 0)
) -> Array:
    turn = Rotation.from_rotvec(np.radians(turn_deg)).as_quat()
    return np.concatenate([np.array(xyz_mm) * 1e-3, turn])


def press_and_shear(height_mm: float, depth_mm: float, tilt_deg: float = 0.0) -> Array:
    """Down, further with a little shear, sideways and turned, from where it touches: [4, 7]."""
    h = height_mm
    return np.stack(
        [
            pose((0.3, 0.1, h + 0.1), (tilt_deg, tilt_deg, 0)),
            pose((0.32, 0.1, h - depth_mm), (tilt_deg, tilt_deg, 0)),
            pose((0.37, 0.12, h - 1.1 * depth_mm), (tilt_deg, tilt_deg + 1, 0)),
            pose((0.45, 0.15, h - 1.1 * depth_mm), (tilt_deg, tilt_deg + 1, 4)),
        ]
    )


def moved(poses: Array, way: Array, size: float) -> Array:
    """Poses shifted by ``size`` times ``way[..., :3]`` [m], turned by it times ``way[..., 3:]``."""
    shifted = poses.copy()
    shifted[..., :3] += size * way[..., :3]
    turn = Rotation.from_rotvec(size * way[..., 3:].reshape(-1, 3))
    turned = turn * Rotation.from_quat(poses[..., 3:].reshape(-1, 4))
    shifted[..., 3:] = turned.as_quat().reshape(poses[..., 3:].shape)
    return shifted


def losses(record: MotionRecord) -> tuple[Array, Array]:
    """Weights of a loss on positions [1/m] and wrenches [1/N], in which both count alike."""
    rng = np.random.default_rng(0)
    positions = rng.normal(size=record.positions.shape) * 1e3
    wrenches = rng.normal(size=record.wrenches.shape)
    wrenches[..., 3:] *= 1e3
    return positions, wrenches


def loss(record: MotionRecord, weights: tuple[Array, Array]) -> Array:
    return np.einsum("kenx,kenx->e", weights[0], record.positions) + np.einsum(
        "ketx,ketx->e", weights[1], record.wrenches
    )


def difference(
    changed: Callable[[float], Case], step: float, weights: tuple[Array, Array]
) -> Array:
    low, high = (loss(changed(side * step).run()[1], weights) for side in (-1, 1))
    return (high - low) / (2 * step)
