# SPDX-License-Identifier: Apache-2.0
"""Shapes of newton's bodies as collision shapes of links.

What touches nothing - visuals, sites - is left out. Newton's boxes, cylinders, capsules and cones
have half sizes, their axis is z, as ours.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.bodies.mass_properties import StatedMass
from taccel_lab.errors import InputError
from taccel_lab.newton_bridge.newton_model import NewtonModel, unit_poses
from taccel_lab.robots.shapes import (
    CollisionShape,
    PrimitiveShape,
    Shape,
    SurfaceShape,
    convex_hull,
)
from taccel_lab.robots.transforms import matrix_of
from taccel_lab.scene import AffineBody, Ball, TriangleMesh, cylinder_mesh, sphere_mesh

ROUND_EDGE = 0.25
"""Edge of the triangles of what is round, over its radius."""


def touching_shapes(source: NewtonModel, body: int) -> list[int]:
    """Indices of the shapes of a body (-1: the world) that touch anything."""
    flags = source.newton.ShapeFlags
    wanted = int(flags.COLLIDE_SHAPES) | int(flags.COLLIDE_PARTICLES)
    has = source.array("shape_flags")
    return [
        int(i)
        for i in np.flatnonzero(source.array("shape_body") == body)
        if has[i] & wanted and not has[i] & int(flags.SITE)
    ]


def is_plane(source: NewtonModel, shape: int) -> bool:
    """Whether a shape is a plane without an end."""
    kind = int(source.array("shape_type")[shape])
    endless = not source.array("shape_scale")[shape][:2].any()
    return kind == int(source.newton.GeoType.PLANE) and endless


def collision_shapes(source: NewtonModel, body: int) -> tuple[CollisionShape, ...]:
    """What others touch of a body, planes without an end apart.

    Raises InputError that names a shape of another kind.
    """
    found = []
    for i in touching_shapes(source, body):
        if body < 0 and is_plane(source, i):
            continue
        pose = unit_poses(source.array("shape_transform")[i])
        found.append(CollisionShape(_shape(source, i), matrix_of(pose)))
    return tuple(found)


def affine_body(source: NewtonModel, body: int, pose: np.ndarray) -> AffineBody:
    """A body that moves freely, with the mass, centre and inertia that newton has.

    Raises InputError where it has none, no solid's, or not one closed shape.
    """
    name = source.bodies[body]
    shapes = collision_shapes(source, body)
    if len(shapes) != 1:
        raise InputError(f"body {name!r} moves freely and needs one shape, got {len(shapes)}")
    surface, offset = shapes[0].surface()
    if isinstance(surface, Ball):
        ball = sphere_mesh(surface.radius_m, ROUND_EDGE * surface.radius_m)
        surface = TriangleMesh(ball.vertices_m + offset[:3, 3], ball.faces)
    mass = float(source.array("body_mass")[body])
    if not mass > 0:
        raise InputError(f"body {name!r} moves freely and has no mass")
    stated = StatedMass(mass, source.array("body_com")[body], source.array("body_inertia")[body])
    friction = source.array("shape_material_mu")[touching_shapes(source, body)[0]]
    return AffineBody(
        surface,
        name=name,
        friction_coefficient=float(friction),
        initial_pose=pose,
        stated_mass=stated,
    )


def _shape(source: NewtonModel, shape: int) -> Shape:
    """One shape about its own origin."""
    kinds = source.newton.GeoType
    kind = int(source.array("shape_type")[shape])
    size = source.array("shape_scale")[shape]
    radius, half = float(size[0]), float(size[1])
    if kind == int(kinds.BOX):
        x, y, z = (2 * size).tolist()
        return PrimitiveShape.box((x, y, z))
    if kind == int(kinds.SPHERE):
        return PrimitiveShape.sphere(radius)
    if kind == int(kinds.CYLINDER) and not size[2]:
        return PrimitiveShape.cylinder(radius, 2 * half)
    if kind == int(kinds.CAPSULE):
        ball = sphere_mesh(radius, ROUND_EDGE * radius).vertices_m
        ends = np.concatenate([ball + [0, 0, half], ball - [0, 0, half]])
        what = f"capsule r {1e3 * radius:g}, length {2e3 * (half + radius):g} mm"
        return SurfaceShape(TriangleMesh(*convex_hull(ends)), what)
    if kind == int(kinds.ELLIPSOID):
        ball = sphere_mesh(1.0, ROUND_EDGE)
        return SurfaceShape(TriangleMesh(ball.vertices_m * size, ball.faces), "ellipsoid")
    if kind == int(kinds.CONE):
        points = cylinder_mesh(radius, 2 * half).vertices_m
        low = points[points[:, 2] < 0]
        return SurfaceShape(
            TriangleMesh(*convex_hull(np.concatenate([low, [[0, 0, half]]]))), "cone"
        )
    if kind in (int(kinds.MESH), int(kinds.CONVEX_MESH)):
        mesh = source.model.shape_source[shape]
        points = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3) * size
        faces = np.asarray(mesh.indices, dtype=np.int64).reshape(-1, 3)
        if not np.isfinite(points).all():
            label = source.model.shape_label[shape]
            raise InputError(f"mesh of shape {label!r} has vertices that are not finite")
        if np.prod(size) < 0:
            faces = faces[:, ::-1]
        return SurfaceShape(_welded(points, faces), hull=kind == int(kinds.CONVEX_MESH))
    what = "barrel" if kind == int(kinds.CYLINDER) else kinds(kind).name.lower()
    raise InputError(
        f"shape {source.model.shape_label[shape]!r} is a {what}: boxes, spheres, cylinders, "
        "capsules, ellipsoids, cones, meshes, and endless planes of the world can be taken over"
    )


def _welded(points: np.ndarray, faces: np.ndarray) -> TriangleMesh:
    """Joins vertices at the same place: newton splits them along seams of textures."""
    unique, where = np.unique(points, axis=0, return_inverse=True)
    faces = where.reshape(-1)[faces]
    flat = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    return TriangleMesh(unique, faces[~flat])
