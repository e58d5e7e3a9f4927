# SPDX-License-Identifier: Apache-2.0
"""What a user says about a scene, checked, on the host, without any device array."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh
from taccel_lab.scene.material import Material, MaterialField
from taccel_lab.scene.primitives import Ball, TriangleMesh

if TYPE_CHECKING:
    from taccel_lab.model import Model


@dataclass(frozen=True)
class SoftBody:
    """A FEM body of linear tets; its bonded nodes never move and carry no degrees of freedom."""

    mesh: TetMesh
    material: Material | MaterialField
    bonded_nodes: np.ndarray | None = None
    """Sorted node indices held fixed; the mesh's bond and window nodes when None."""
    rest_positions_m: np.ndarray | None = None
    """Rest shape per environment [m], shape [env_count, node_count, 3]: one connectivity, graded
    differently in each environment. The mesh's nodes for all environments when None."""

    def __post_init__(self) -> None:
        count = self.material.tet_count
        if count is not None and count != self.mesh.tet_count:
            raise InputError(
                f"material has moduli of {count} tets, the mesh has {self.mesh.tet_count} tets"
            )

    def bonded(self) -> np.ndarray:
        """Bonded node indices, int64, shape [n]."""
        if self.bonded_nodes is None:
            return self.mesh.bonded_nodes()
        return np.unique(np.asarray(self.bonded_nodes, dtype=np.int64))


@dataclass(frozen=True)
class KinematicBody:
    """A rigid body whose pose is prescribed; it has no degrees of freedom."""

    shape: TriangleMesh | Ball
    friction_coefficient: float = 0.0
    """Coulomb friction of the pair soft body - this body; 0 switches the friction pass off."""
    name: str = "indenter"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.friction_coefficient) and 0 <= self.friction_coefficient <= 10):
            raise InputError(
                f"friction coefficient of {self.name!r} must lie in [0, 10], "
                f"got {self.friction_coefficient}"
            )


@dataclass(frozen=True)
class TimeStepping:
    """How a step advances time."""

    quasi_static: bool = True
    """Without inertia: each step is an equilibrium. Otherwise implicit Euler."""
    dt_s: float = 0.02
    gravity_m_s2: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.dt_s) and 1e-6 <= self.dt_s <= 10):
            raise InputError(f"dt must lie in [1e-6, 10] s, got {self.dt_s}")
        gravity = self.gravity_m_s2
        if len(gravity) != 3 or not all(math.isfinite(g) for g in gravity):
            raise InputError(f"gravity_m_s2 must be three finite numbers, got {gravity}")
        if self.quasi_static and any(gravity):
            raise InputError(
                f"gravity_m_s2 = {gravity} needs quasi_static=False: otherwise nothing has mass"
            )


@dataclass(frozen=True)
class Scene:
    """One soft body and any number of kinematic bodies, in ``env_count`` copies.

    Copies share connectivity and differ in rest shape, state and kinematic poses.
    """

    soft_body: SoftBody
    kinematic_bodies: tuple[KinematicBody, ...] = ()
    env_count: int = 1
    time: TimeStepping = field(default_factory=TimeStepping)

    def __post_init__(self) -> None:
        if self.env_count < 1:
            raise InputError(f"env_count must be at least 1, got {self.env_count}")
        if self.time.quasi_static and self.soft_body.material.damping_time_s > 0:
            raise InputError(
                "damping_time_s needs quasi_static=False: a quasi-static step has no strain rate"
            )
        rest = self.soft_body.rest_positions_m
        expected = (self.env_count, self.soft_body.mesh.node_count, 3)
        if rest is not None and np.shape(rest) != expected:
            raise InputError(f"rest_positions_m has shape {np.shape(rest)}, expected {expected}")
        if rest is not None and not np.isfinite(rest).all():
            env = int(np.argwhere(~np.isfinite(rest))[0, 0])
            raise InputError(f"rest_positions_m holds NaN or infinite values in environment {env}")
        bonded_count = len(self.soft_body.bonded())
        if bonded_count >= self.soft_body.mesh.node_count:
            raise InputError("all nodes of the soft body are bonded; at least one must be free")
        if self.time.quasi_static and bonded_count < 3:
            raise InputError(
                "a quasi-static soft body needs at least three bonded nodes: "
                "without inertia nothing else holds it"
            )

    def finalize(self, device: str = "cpu") -> Model:
        """Build the device arrays; raises InputError for inverted or degenerate rest tets."""
        from taccel_lab.model import build_model

        return build_model(self, device)
