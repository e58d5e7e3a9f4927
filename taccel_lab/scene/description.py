# SPDX-License-Identifier: Apache-2.0
"""What a user says about a scene, checked, on the host, without any device array."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh
from taccel_lab.scene.primitives import Ball, TriangleMesh

if TYPE_CHECKING:
    from taccel_lab.model import Model


@dataclass(frozen=True)
class Material:
    """An isotropic hyperelastic solid (compressible Neo-Hookean)."""

    young_modulus_pa: float
    poisson_ratio: float
    density_kg_m3: float = 1000.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.young_modulus_pa) and 1e2 <= self.young_modulus_pa <= 1e12):
            raise InputError(
                f"Young's modulus must lie in [100 Pa, 1 TPa], got {self.young_modulus_pa:g} Pa "
                "(a gel is 1e4 to 1e6 Pa; the unit is pascal)"
            )
        if not (math.isfinite(self.poisson_ratio) and -1.0 < self.poisson_ratio < 0.5):
            raise InputError(
                f"Poisson's ratio must lie in (-1, 0.5), got {self.poisson_ratio:g}; 0.5 is an "
                "incompressible solid, which this energy cannot represent (use 0.45 to 0.49)"
            )
        if not (math.isfinite(self.density_kg_m3) and 1.0 <= self.density_kg_m3 <= 3e4):
            raise InputError(f"density must lie in [1, 3e4] kg/m^3, got {self.density_kg_m3:g}")

    @property
    def shear_modulus_pa(self) -> float:
        """Lame's second parameter mu [Pa]."""
        return self.young_modulus_pa / (2 * (1 + self.poisson_ratio))

    @property
    def lame_lambda_pa(self) -> float:
        """Lame's first parameter lambda [Pa]."""
        nu = self.poisson_ratio
        return self.young_modulus_pa * nu / ((1 + nu) * (1 - 2 * nu))


@dataclass(frozen=True)
class SoftBody:
    """A FEM body of linear tets; its bonded nodes never move and carry no degrees of freedom."""

    mesh: TetMesh
    material: Material
    bonded_nodes: np.ndarray | None = None
    """Sorted node indices held fixed; the mesh's bond and window nodes when None."""
    rest_positions_m: np.ndarray | None = None
    """Rest shape per environment [m], shape [env_count, node_count, 3]: one connectivity, graded
    differently in each environment. The mesh's nodes for all environments when None."""

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
        rest = self.soft_body.rest_positions_m
        expected = (self.env_count, self.soft_body.mesh.node_count, 3)
        if rest is not None and np.shape(rest) != expected:
            raise InputError(f"rest_positions_m has shape {np.shape(rest)}, expected {expected}")
        if self.time.quasi_static and len(self.soft_body.bonded()) < 3:
            raise InputError(
                "a quasi-static soft body needs at least three bonded nodes: "
                "without inertia nothing else holds it"
            )

    def finalize(self, device: str = "cpu") -> Model:
        """Build the device arrays; raises InputError for inverted or degenerate rest tets."""
        from taccel_lab.model import build_model

        return build_model(self, device)
