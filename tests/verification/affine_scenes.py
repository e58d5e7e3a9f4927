# SPDX-License-Identifier: Apache-2.0
"""Scenes of affine bodies that the verification tests share, and what is measured in them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from taccel_lab.bodies.primitives import box_mesh
from taccel_lab.model import BodyKind
from taccel_lab.scene import AffineBody, Scene, TimeStepping
from taccel_lab.solvers import SolverConfig, StepReport
from tests.support.scene_steps import G, Stepped

__all__ = ["DOWN", "G", "Run", "affine_scene", "box", "turned"]

DOWN = (0.0, 0.0, -G)


def turned(axis: Sequence[float], angle: float) -> np.ndarray:
    """Quaternion (x, y, z, w) of a rotation."""
    unit = np.asarray(axis) / np.linalg.norm(axis)
    return np.append(np.sin(angle / 2) * unit, np.cos(angle / 2))


def box(
    name: str,
    size: tuple[float, float, float],
    center: Any = (0, 0, 0),
    rotation: Any = (0, 0, 0, 1),
    **options: Any,
) -> AffineBody:
    pose = np.array([*center, *rotation], dtype=float)
    return AffineBody(box_mesh(size), name=name, initial_pose=pose, **options)


def affine_scene(
    bodies: AffineBody | Sequence[AffineBody],
    joints: Any = (),
    planes: Any = (),
    kinematic: Any = (),
    dt: float = 0.01,
    gravity: tuple[float, float, float] = DOWN,
    **time: Any,
) -> Scene:
    stepping = TimeStepping(quasi_static=False, dt_s=dt, gravity_m_s2=gravity, **time)
    parts = {"joints": joints, "planes": planes, "kinematic_bodies": kinematic}
    return Scene(affine_bodies=bodies, time=stepping, **parts)


class Run(Stepped):
    def __init__(
        self, scene: Scene, config: SolverConfig | None = None, poses: np.ndarray | None = None
    ) -> None:
        super().__init__(scene, *(() if poses is None else (poses,)), config=config)
        self.dt = scene.time.dt_s
        first, count = self.model.affine.first_control, self.model.affine.count
        self.control = slice(first, first + 4 * count)
        self.masses = self.model.masses.numpy()[0, self.control].reshape(count, 4, 1)
        self.lengths = self.model.affine.lengths.numpy()

    def step(self, *target: Any, **who: Any) -> StepReport:
        """One step, which has to converge with closed joints."""
        report = super().step(*target, **who)
        if self.solver.joints is not None:
            assert (report.joint_violation_m <= self.solver.joints.tolerance_m).all()
        return report

    @property
    def y(self) -> np.ndarray:
        """Control nodes [m], shape [body, 4, 3]."""
        return self.x()[self.control].reshape(-1, 4, 3)

    @property
    def v(self) -> np.ndarray:
        """Their velocities [m/s], shape [body, 4, 3]; a copy."""
        return self.state.velocities.numpy()[0, self.control].reshape(-1, 4, 3).copy()

    @property
    def vertices(self) -> np.ndarray:
        bodies = [b for b in self.model.bodies if b.kind is BodyKind.AFFINE]
        return np.concatenate([self.x()[b.node_slice] for b in bodies])

    @property
    def maps(self) -> np.ndarray:
        """A of each body, shape [body, 3, 3]."""
        return self.y[:, 1:].transpose(0, 2, 1) / self.lengths[:, None, None]

    @property
    def strain(self) -> float:
        """Largest |A^T A - I| (Frobenius) of any body."""
        gram = self.maps.transpose(0, 2, 1) @ self.maps - np.eye(3)
        return float(np.linalg.norm(gram, axis=(1, 2)).max())

    @property
    def weight(self) -> float:
        return float(self.masses[:, 0].sum() * G)

    @property
    def momentum(self) -> np.ndarray:
        return (self.masses * self.v)[:, 0].sum(axis=0)

    @property
    def kinetic_energy(self) -> float:
        return float(0.5 * (self.masses * self.v**2).sum())

    def angular_impulse(self, change: np.ndarray) -> np.ndarray:
        """sum m y x (change of velocity) at the present positions [kg m^2/s]: the angular momentum
        that forces have given in the last step, whatever the step length."""
        return np.cross(self.y, self.masses * change).sum(axis=(0, 1))

    @property
    def angular_momentum(self) -> np.ndarray:
        return self.angular_impulse(self.v)
