# SPDX-License-Identifier: Apache-2.0
"""The bodies of a scene, checked: soft, affine, kinematic ones and planes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np

from taccel_lab.bodies.mass_properties import (
    MassProperties,
    StatedMass,
    mass_properties,
    with_stated_mass,
)
from taccel_lab.bodies.material import Material, MaterialField
from taccel_lab.bodies.primitives import Ball, TriangleMesh, checked_pose
from taccel_lab.errors import InputError
from taccel_lab.geometry import QuadraticMesh, TetMesh, quadratic_mesh
from taccel_lab.guards import require_range, require_shape
from taccel_lab.typed import typed


class Element(StrEnum):
    """How displacements vary inside a tet of the mesh."""

    LINEAR = "linear"
    """Four nodes, one deformation gradient a tet. Cheapest by tet; far too stiff near nu = 0.5."""
    QUADRATIC = "quadratic"
    """Ten nodes, with one pressure a tet: free of volumetric locking up to nu = 0.499. Middle nodes
    are added to the edges of the mesh, whose tets stay straight at rest."""

    @property
    def point_count(self) -> int:
        """Points of a tet at which its material is evaluated."""
        return 4 if self is Element.QUADRATIC else 1


ALL_LAYERS = 0xFFFFFFFF
"""Mask of a body that may touch every layer."""


@typed
@dataclass(frozen=True)
class Surface:
    """How the surface of a body meets others."""

    layer: int = 1
    """Bits of the collision layers that the body belongs to."""
    collides_with: int = ALL_LAYERS
    """Bits of the layers it may touch; a pair collides when each allows the other's layer."""
    thickness_m: float = 0.0
    """Distance that others keep from the surface [m]: the smallest gap is the sum of a pair's."""
    environments: tuple[int, ...] | None = None
    """Environments in which the body is present; all when None. Not for soft bodies."""
    apart_from: frozenset[str] = frozenset()
    """Names of bodies that it does not touch, whatever their layers."""

    def __post_init__(self) -> None:
        for name in ("layer", "collides_with"):
            if not 0 <= getattr(self, name) <= ALL_LAYERS:
                raise InputError(f"{name} must be a mask of 32 bits, got {getattr(self, name)}")
        require_range("thickness_m", self.thickness_m, 0, 0.1, "m")

    def meets(self, other: Surface) -> bool:
        """Tell whether the layers of two bodies may touch."""
        return bool(self.layer & other.collides_with and other.layer & self.collides_with)


def check_friction(value: float | None, whose: str) -> None:
    """Refuse a friction coefficient out of [0, 10]; None is no say."""
    if value is not None:
        require_range(f"friction coefficient of {whose}", value, 0, 10)


def check_stiff_density(value: float, where: str) -> None:
    """Refuse a density that no affine body has; it may be light, as a shell that is not meshed."""
    if not (math.isfinite(value) and 0 < value <= 3e4):
        raise InputError(f"density{where} must lie in (0, 3e4] kg/m^3, got {value}")


@typed
@dataclass(frozen=True)
class SoftBody:
    """A FEM body, whose bonded nodes are prescribed."""

    mesh: TetMesh
    material: Material | MaterialField
    bonded_nodes: np.ndarray | None = None
    """Sorted node indices held fixed, or by the mount; the mesh's bond and window nodes when
    None."""
    rest_positions_m: np.ndarray | None = None
    """Rest shape per environment [m], shape [env_count, node_count, 3]: one connectivity, graded
    differently in each environment. The mesh's nodes for all environments when None."""
    name: str = "gel"
    friction_coefficient: float | None = None
    """Coulomb friction; see ``Scene.pair_friction``. None leaves it to the other body."""
    mount: str | None = None
    """Body that the bonded nodes follow exactly, fixed in the world when None: a kinematic body, in
    whose frame the mesh is given, or an affine one, which the gel pulls at and weighs on."""
    mount_pose: np.ndarray | None = None
    """mount_from_mesh, [7], on an affine body; the identity when None."""
    element: Element = Element.QUADRATIC
    self_contact: bool = False
    surface: Surface = Surface()
    initial_pose: np.ndarray | None = None
    """world_from_mesh at the start, [7] or [env, 7]; for a body without a mount."""
    initial_velocity_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Velocity of all nodes but bonded ones; on an affine mount all move as that does."""

    def __post_init__(self) -> None:
        count = self.material.tet_count
        if count is not None and count != self.mesh.tet_count:
            raise InputError(
                f"material has moduli of {count} tets, the mesh has {self.mesh.tet_count} tets"
            )
        check_friction(self.friction_coefficient, repr(self.name))
        if self.mount is not None and self.initial_pose is not None:
            raise InputError(f"{self.name!r} has a mount: its pose is the mount's")
        if self.mount_pose is not None:
            if self.mount is None:
                raise InputError(f"{self.name!r} has a mount_pose, but no mount")
            pose = checked_pose(f"mount_pose of {self.name!r}", self.mount_pose, (7,))
            object.__setattr__(self, "mount_pose", pose)
        if self.surface.environments is not None:
            raise InputError(f"soft body {self.name!r} must be present in all environments")
        _check_start(self)

    def bonded(self) -> np.ndarray:
        """Return bonded node indices of ``mesh``, int64, shape [n]."""
        if self.bonded_nodes is None:
            return self.mesh.bonded_nodes()
        return np.unique(np.asarray(self.bonded_nodes, dtype=np.int64))

    @cached_property
    def nodal_mesh(self) -> TetMesh | QuadraticMesh:
        """``mesh`` with all the nodes that the solver moves: what reads positions of nodes and
        faces that touch (signals, outputs) goes by this one."""
        return nodal_mesh(self.mesh, self.element)

    @cached_property
    def nodal_rest_m(self) -> np.ndarray:
        """Rest positions of all nodes of ``nodal_mesh``, float64, shape [rest_count, node, 3]:
        one for all environments, or one each."""
        corners = (
            self.mesh.nodes_m[None] if self.rest_positions_m is None else self.rest_positions_m
        )
        corners = np.ascontiguousarray(corners, dtype=np.float64)
        mesh = self.nodal_mesh
        return mesh.with_middles(corners) if isinstance(mesh, QuadraticMesh) else corners


def nodal_mesh(mesh: TetMesh, element: Element) -> TetMesh | QuadraticMesh:
    """A mesh with all the nodes that its elements have."""
    return quadratic_mesh(mesh) if element is Element.QUADRATIC else mesh


@typed
@dataclass(frozen=True)
class AffineBody:
    """A stiff free body of 12 degrees of freedom [Lan et al. 2022, Affine Body Dynamics]."""

    shape: TriangleMesh
    """Closed surface in the body frame; mass and inertia follow from it and the density."""
    density_kg_m3: float = 1000.0
    young_modulus_pa: float = 1e9
    """Stiffness against any deformation: large, but not so large that rounding rules."""
    name: str = "object"
    friction_coefficient: float | None = None
    surface: Surface = Surface()
    initial_pose: np.ndarray | None = None
    """world_from_body at the start, [7] or [env, 7]; the identity when None."""
    initial_velocity_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Velocity of the centre of mass."""
    initial_spin_rad_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Angular velocity in world axes."""
    stated_mass: StatedMass | None = None
    """Mass, centre and inertia of a body that is not filled evenly; the density does not count."""

    def __post_init__(self) -> None:
        check_stiff_density(self.density_kg_m3, f" of {self.name!r}")
        name = f"young_modulus_pa of {self.name!r}"
        require_range(name, self.young_modulus_pa, 1e3, 1e13, "Pa")
        check_friction(self.friction_coefficient, repr(self.name))
        _check_start(self)
        require_shape(f"initial_spin_rad_s of {self.name!r}", self.initial_spin_rad_s, (3,))

    def mass_properties(self) -> MassProperties:
        """Return those of the even solid, or those stated; InputError for a mesh that encloses
        none."""
        solid = mass_properties(self.shape, self.density_kg_m3)
        if self.stated_mass is None:
            return solid
        return with_stated_mass(solid, self.stated_mass, self.shape)


@typed
@dataclass(frozen=True)
class KinematicBody:
    """A rigid body whose pose is prescribed; it has no degrees of freedom."""

    shape: TriangleMesh | Ball | None
    """None for a frame without a surface, such as the mount of a gel."""
    friction_coefficient: float | None = 0.0
    """Coulomb friction; see ``Scene.pair_friction``. None leaves it to the other body."""
    name: str = "indenter"
    surface: Surface = Surface()

    def __post_init__(self) -> None:
        check_friction(self.friction_coefficient, repr(self.name))


@typed
@dataclass(frozen=True)
class Plane:
    """A half-space that never moves; bodies stay on the side its normal points to."""

    point_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    friction_coefficient: float | None = None
    name: str = "plane"
    surface: Surface = Surface()

    def __post_init__(self) -> None:
        require_shape(f"point_m of {self.name!r}", self.point_m, (3,))
        require_shape(f"normal of {self.name!r}", self.normal, (3,))
        length = math.hypot(*self.normal)
        if not length > 1e-9:
            raise InputError(f"normal of {self.name!r} must not be zero, got {self.normal}")
        unit = tuple(v / length for v in self.normal)
        object.__setattr__(self, "normal", unit)
        check_friction(self.friction_coefficient, repr(self.name))


def _check_start(body: SoftBody | AffineBody) -> None:
    """Refuse a pose and a velocity that no body can start with; the pose becomes an array."""
    if body.initial_pose is not None:
        pose = checked_pose(f"initial_pose of {body.name!r}", body.initial_pose)
        object.__setattr__(body, "initial_pose", pose)
    require_shape(f"initial_velocity_m_s of {body.name!r}", body.initial_velocity_m_s, (3,))


Body = SoftBody | AffineBody | KinematicBody | Plane


def combined_friction(first: Body, second: Body) -> float:
    """Coefficient of a pair from the bodies' own: the harmonic mean, as in Taccel.

    A body without a say takes the other's; two such slide freely.
    """
    a, b = first.friction_coefficient, second.friction_coefficient
    if a is None or b is None:
        return a or b or 0.0
    return 2 * a * b / (a + b) if a + b > 0 else 0.0
