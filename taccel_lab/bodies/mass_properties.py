# SPDX-License-Identifier: Apache-2.0
"""Volume, mass, centre and principal moments of the solid inside a closed triangle mesh.

By the divergence theorem the solid is the sum of signed tets from any point to the faces, and
polynomials over a tet integrate exactly: with corners a, b, c seen from the apex, s = a + b + c and
D = a . (b x c), the volume is D / 6, the first moment D / 24 s and the second moment
D / 120 (a a^T + b b^T + c c^T + s s^T) [Lien and Kajiya 1984, A Symbolic Method for Calculating the
Integral Properties of Arbitrary Nonconvex Polyhedra; Tonon 2005 writes the same out]. The apex is
put into the body, and then into its centre of mass, so that a distant origin costs no digits.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np

from taccel_lab.bodies.mesh_checks import check_edges
from taccel_lab.bodies.primitives import TriangleMesh
from taccel_lab.errors import InputError
from taccel_lab.geometry.connectivity import piece_of_cells
from taccel_lab.guards import require_positive, require_shape

_SOLID = 1 + 1e-6
"""Sum of two principal moments over the third one: of a flat plate 1."""
_FLAT = 1e-13
"""Volume over (area * extent) that is rounding error; a 10 um foil of 1 m has 1e-5."""


@dataclass(frozen=True)
class MassProperties:
    """What a rigid or affine body needs to know of its solid."""

    volume_m3: float
    mass_kg: float
    center_m: np.ndarray
    """Centre of mass in the mesh's frame [m], shape [3]."""
    axes: np.ndarray
    """Principal axes as columns, a rotation (mesh_from_principal), shape [3, 3]."""
    second_moments_kg_m2: np.ndarray
    """int rho X_k^2 dV about the centre along each principal axis [kg m^2], shape [3]."""
    radius_m: float
    """Largest distance of a vertex of the surface from the centre of mass [m]."""

    @property
    def inertia_kg_m2(self) -> np.ndarray:
        """Inertia tensor int rho (|X|^2 I - X X^T) dV about the centre, mesh frame, [3, 3]."""
        moments = self.second_moments_kg_m2
        return (self.axes * (moments.sum() - moments)) @ self.axes.T

    def to_principal(self, points_m: np.ndarray) -> np.ndarray:
        """Coordinates X of points of the mesh's frame in the principal frame [m], [..., 3]."""
        return (points_m - self.center_m) @ self.axes


@dataclass(frozen=True)
class StatedMass:
    """What a body weighs and where, measured or from CAD, in the frame of its mesh."""

    mass_kg: float
    center_m: np.ndarray
    """Centre of mass [m], shape [3]; it may lie outside of the mesh."""
    inertia_kg_m2: np.ndarray
    """Inertia tensor about the centre, shape [3, 3]."""

    def __post_init__(self) -> None:
        center = np.array(self.center_m, dtype=np.float64)
        inertia = np.array(self.inertia_kg_m2, dtype=np.float64)
        require_positive("mass", self.mass_kg, "kg")
        require_shape("centre", center, (3,))
        require_shape("inertia", inertia, (3, 3))
        low, middle, high = np.linalg.eigvalsh((inertia + inertia.T) / 2)
        if np.abs(inertia - inertia.T).max() > 1e-6 * high or not low + middle > high * _SOLID:
            raise InputError(
                "the inertia is that of no solid: it must be symmetric, and two principal moments "
                f"must add up to more than the third, got {low:.3g}, {middle:.3g}, {high:.3g} "
                "kg m^2"
            )
        object.__setattr__(self, "center_m", center)
        object.__setattr__(self, "inertia_kg_m2", (inertia + inertia.T) / 2)


def with_stated_mass(
    solid: MassProperties, stated: StatedMass, mesh: TriangleMesh
) -> MassProperties:
    """Properties of the solid inside ``mesh`` with the mass, centre and inertia that are stated.

    Second moments follow from the inertia I: int rho X X^T dV = tr(I) / 2 - I.
    """
    inertia = stated.inertia_kg_m2
    second = np.trace(inertia) / 2 * np.eye(3) - inertia
    axes = _principal_axes(second)
    arms = mesh.vertices_m[np.unique(mesh.faces)] - stated.center_m
    return MassProperties(
        volume_m3=solid.volume_m3,
        mass_kg=float(stated.mass_kg),
        center_m=stated.center_m,
        axes=axes,
        second_moments_kg_m2=np.diag(axes.T @ second @ axes).copy(),
        radius_m=float(np.linalg.norm(arms, axis=1).max()),
    )


def mass_properties(mesh: TriangleMesh, density_kg_m3: float) -> MassProperties:
    """Exact properties of the homogeneous solid inside ``mesh``.

    The mesh must be closed, edge-manifold and oriented outwards; several shells are allowed when
    they lie apart, and inward ones where they bound a cavity. Raises InputError naming the edges or
    faces that are not so, and for a density that is not positive.
    """
    require_positive("density", density_kg_m3, "kg/m^3")
    faces = mesh.faces.astype(np.int64)
    check_edges(mesh.vertices_m, faces, "the mesh", closed=True)

    used = np.unique(faces)
    corners = mesh.vertices_m[used]
    origin = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    points = mesh.vertices_m - origin
    scale = float(np.abs(points[used]).max())
    if scale == 0:
        raise InputError("the mesh is a single point and has no volume")
    points = points / scale
    triangles = points[faces]
    _require_outward(triangles, piece_of_cells(faces))

    volume, first, _ = _integrals(triangles)
    center = first / volume
    volume, first, second = _integrals(triangles - center)
    center = center + first / volume
    axes = _principal_axes(second)
    # Anew in the principal frame: eigenvalues would know a foil's thickness to eps / thickness^2.
    moments = np.diag(_integrals((triangles - center) @ axes)[2])
    if not (moments > 0).all():
        raise InputError(
            f"the body has no extent along a principal axis (second moments {moments} in units of "
            "its size); check that the mesh is closed and does not intersect itself"
        )
    mass = density_kg_m3 * volume * scale**3
    return MassProperties(
        volume_m3=float(volume * scale**3),
        mass_kg=float(mass),
        center_m=origin + scale * center,
        axes=axes,
        second_moments_kg_m2=density_kg_m3 * scale**5 * moments,
        radius_m=float(scale * np.linalg.norm(points[used] - center, axis=1).max()),
    )


def _require_outward(triangles: np.ndarray, shells: np.ndarray) -> None:
    """Refuse shells that are flat, inside out, or inside one another without a cavity."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    shell_count = int(shells.max()) + 1
    for shell in range(shell_count):
        own = shells == shell
        piece = triangles[own]
        middle = 0.5 * (piece.min(axis=(0, 1)) + piece.max(axis=(0, 1)))
        extent = float(np.abs(piece - middle).max())
        volume = _integrals(piece - middle)[0]
        which = "the mesh"
        if shell_count > 1:
            which = f"the shell of face {int(np.flatnonzero(own)[0])}"
        if not abs(volume) > _FLAT * area[own].sum() * extent:
            raise InputError(f"{which} encloses no volume: it is flat, or covers itself twice")
        around = 0
        if shell_count > 1:
            around = round(winding_number(piece[0, 0], triangles[~own]))
        if volume < 0 and around != 1:
            raise InputError(
                f"{which} ({own.sum()} faces) is oriented inwards; faces must be outward by the "
                "right-hand rule (swap two vertices of each face)"
            )
        if volume > 0 and around != 0:
            raise InputError(f"{which} ({own.sum()} faces) lies inside another shell of the mesh")


def winding_number(point: np.ndarray, triangles: np.ndarray) -> float:
    """How often triangles [n, 3, 3] wind about a point: their solid angle over 4 pi
    [van Oosterom and Strackee 1983, eq. 8]."""
    r = triangles - point
    d = np.linalg.norm(r, axis=-1)
    a, b, c = r[:, 0], r[:, 1], r[:, 2]
    numerator = np.einsum("ij,ij->i", a, np.cross(b, c))
    denominator = (
        d.prod(axis=1)
        + np.einsum("ij,ij->i", a, b) * d[:, 2]
        + np.einsum("ij,ij->i", b, c) * d[:, 0]
        + np.einsum("ij,ij->i", c, a) * d[:, 1]
    )
    return float(np.arctan2(numerator, denominator).sum() / (2 * np.pi))


def _integrals(triangles: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Volume, first moment [3] and second moment [3, 3] of the solid about the origin."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    det = np.einsum("ij,ij->i", a, np.cross(b, c))
    s = a + b + c
    second = sum(np.einsum("i,ij,ik->jk", det, p, p) for p in (a, b, c, s))
    return float(det.sum() / 6), det @ s / 24, np.asarray(second) / 120


def _principal_axes(second: np.ndarray) -> np.ndarray:
    """Principal axes as the columns of the rotation nearest to the identity.

    Off-diagonal terms of rounding size are dropped first: else a cube's axes would be arbitrary.
    """
    clean = 0.5 * (second + second.T)
    off = ~np.eye(3, dtype=bool)
    clean[off & (np.abs(clean) < 1e-14 * np.trace(clean))] = 0.0
    vectors = np.linalg.eigh(clean)[1]
    order = list(
        max(permutations(range(3)), key=lambda p: sum(abs(vectors[i, p[i]]) for i in range(3)))
    )
    axes = vectors[:, order]
    axes = axes * np.where(np.diag(axes) < 0, -1.0, 1.0)
    if np.linalg.det(axes) < 0:
        axes[:, int(np.argmin(np.abs(np.diag(axes))))] *= -1.0
    return axes
