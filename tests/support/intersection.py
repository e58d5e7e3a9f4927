# SPDX-License-Identifier: Apache-2.0
"""Do any surfaces intersect? A referee in numpy that shares no code with the solver.

Two closed surfaces intersect exactly when an edge of one crosses a face of the other, or when one
lies inside the other as a whole. Crossings are found from the signs of tet volumes, containment
from the winding number. Only bodies that may touch are looked at, a soft body with itself where it
has self-contact. Surfaces that only touch in a plane they share are not told apart from surfaces
that do not. Thickness is left out: it is a distance to keep, not a body. A curved tet is inverted
where it is at any of 84 points; its faces may reach into a ball by an inset, its nodes may not.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from taccel_lab.benchmarks.stress.balance import quadratic_gradients
from taccel_lab.bodies.bodies import SoftBody
from taccel_lab.bodies.crossings import crossing_pairs, point_triangle_distances, self_crossings
from taccel_lab.bodies.mass_properties import winding_number
from taccel_lab.bodies.primitives import Ball, unique_edges
from taccel_lab.bodies.surface_topology import ball_insets, is_closed, one_node_of_each_part
from taccel_lab.geometry.quadratic import TET_EDGES
from taccel_lab.model import BodyKind, Model
from taccel_lab.state import State, check_state


class IntersectionKind(StrEnum):
    """How two things overlap."""

    CROSSING = "crossing"
    """An edge of one surface passes through a face of the other, or the ball reaches a face."""
    SELF_CROSSING = "crossing itself"
    INSIDE = "inside"
    """The first body, or a separate part of it, is inside the second as a whole."""
    BELOW_PLANE = "below a plane"
    INVERTED_TET = "inverted tet"


class Intersection(NamedTuple):
    """One kind of overlap of two bodies in one environment."""

    kind: IntersectionKind
    first: str
    """Name of a body; of two, the stiffer one unless the other is inside it."""
    second: str
    """Name of the other body; the same for inverted tets and crossings of a body with itself."""


@dataclass(frozen=True)
class _Body:
    """A body where it is now."""

    name: str
    kind: BodyKind
    nodes: np.ndarray
    """[m], shape [n, 3]; of a ball its centre, of a plane its origin."""
    faces: np.ndarray
    radius_m: float
    """Of a ball, else 0."""
    normal: np.ndarray
    """Of a plane."""
    face_reaches_sq: np.ndarray
    """See ``SurfaceArrays`` [m^2], one for each face."""


def find_intersections(model: Model, state: State) -> list[list[Intersection]]:
    """All overlaps of bodies that may touch, and inverted tets: one list per environment.

    Environments whose nodes are bitwise those of an earlier one are not looked at again.
    """
    check_state(state, model)
    positions, present = state.positions.numpy(), model.present.numpy() != 0
    seen: dict[tuple[bytes, bytes, int], list[Intersection]] = {}
    found = []
    for env, (x, here) in enumerate(zip(positions, present, strict=True)):
        key = (x.tobytes(), here.tobytes(), env % model.rest_count)
        if key not in seen:
            seen[key] = _intersections(model, x, here, env)
        found.append(list(seen[key]))
    return found


def _bodies(model: Model, x: np.ndarray, env: int) -> list[_Body]:
    scene, normals = model.scene, model.surface.plane_normals.numpy()
    reaches_sq = model.surface.face_reaches_sq.numpy()[env % model.rest_count]
    bodies = []
    for part, body in zip(model.bodies, scene.bodies, strict=True):
        mesh = body.nodal_mesh if isinstance(body, SoftBody) else getattr(body, "shape", None)
        is_ball = isinstance(mesh, Ball)
        bodies.append(
            _Body(
                name=part.name,
                kind=part.kind,
                nodes=x[part.node_slice],
                faces=np.zeros((0, 3), dtype=int) if mesh is None or is_ball else mesh.faces,
                radius_m=mesh.radius_m if is_ball else 0.0,
                normal=normals[part.nodes[0]] if part.kind is BodyKind.PLANE else np.zeros(3),
                face_reaches_sq=reaches_sq[part.faces[0] : part.faces[1]],
            )
        )
    return bodies


def _intersections(
    model: Model, x: np.ndarray, present: np.ndarray, env: int
) -> list[Intersection]:
    """Overlaps of one environment; positions [node_count, 3], present [body_count]."""
    bodies = _bodies(model, x, env)
    found: list[Intersection] = []
    for part, body in zip(model.bodies, model.scene.bodies, strict=True):
        nodes = x[part.node_slice]
        if isinstance(body, SoftBody) and _any_inverted(nodes[body.nodal_mesh.tets]):
            found.append(Intersection(IntersectionKind.INVERTED_TET, part.name, part.name))
    for i, j in model.contact_plan.pairs:
        first, second = bodies[i], bodies[j]
        if not (present[i] and present[j]):
            continue
        if i != j:
            found += _overlaps(first, second)
        elif len(self_crossings(first.nodes, first.faces)[0]):
            found.append(Intersection(IntersectionKind.SELF_CROSSING, first.name, first.name))
    return found


def _lattice(order: int) -> np.ndarray:
    """Points of a tet whose barycentric coordinates [n, 4] are multiples of 1 / ``order``."""
    counts = np.indices((order + 1,) * 3).reshape(3, -1).T
    counts = counts[counts.sum(axis=1) <= order]
    return np.column_stack([order - counts.sum(axis=1), counts]) / order


_SAMPLES = _lattice(6)
"""Where the volume of a curved tet is looked at: corners, middles of edges and of faces, more."""
_STRAIGHT = 1e-12
"""Farthest that the middle of a straight edge lies off, over the size of its tet: rounding."""


def _volume_ratios(nodes: np.ndarray) -> np.ndarray:
    """Determinants of the derivative by the last three barycentric coordinates: of tets [n, 4, 3]
    one each, of ten nodes [n, 10, 3] at all samples, [n, sample]."""
    if nodes.shape[1] == 4:
        return np.linalg.det(nodes[:, 1:] - nodes[:, :1])[:, None]
    slopes = np.vstack([-np.ones(3), np.eye(3)])[None]
    weights = quadratic_gradients(slopes, _SAMPLES)[0].transpose(0, 2, 1).reshape(-1, 10)
    tangents = weights @ (nodes - nodes[:, :1])
    return np.linalg.det(tangents.reshape(len(nodes), len(_SAMPLES), 3, 3))


def _bent(nodes: np.ndarray) -> np.ndarray:
    """Which tets of ten nodes [n, 10, 3] have an edge that is not straight, bool [n]."""
    ends = nodes[:, np.array(TET_EDGES)]
    off = np.abs(nodes[:, 4:] - ends.mean(axis=2)).max(axis=(1, 2))
    return off > _STRAIGHT * np.ptp(nodes[:, :4], axis=1).max(axis=1)


def _any_inverted(nodes: np.ndarray) -> bool:
    """Whether a tet [n, 4, 3] is inverted, or one of ten nodes [n, 10, 3] at any sample."""
    right = _volume_ratios(nodes[:, :4])[:, 0] > 0
    if nodes.shape[1] == 10:
        # Straight tets, as all are at rest, have one determinant.
        bent = _bent(nodes)
        right[bent] = (_volume_ratios(nodes[bent]) > 0).all(axis=1)
    return not right.all()


def _overlaps(softer: _Body, stiffer: _Body) -> list[Intersection]:
    """Overlaps of two bodies in the order of their ids."""
    crossing = Intersection(IntersectionKind.CROSSING, stiffer.name, softer.name)
    around = softer.nodes[softer.faces]
    if stiffer.kind is BodyKind.PLANE:
        height = (softer.nodes[np.unique(softer.faces)] - stiffer.nodes[0]) @ stiffer.normal
        below = Intersection(IntersectionKind.BELOW_PLANE, softer.name, stiffer.name)
        return [] if (height > 0).all() else [below]
    if stiffer.radius_m > 0:
        centre, inset = stiffer.nodes[0], ball_insets(stiffer.radius_m, softer.face_reaches_sq)
        distance = point_triangle_distances(centre, around)
        at_nodes = np.linalg.norm(around - centre, axis=2).min(axis=1)
        if ((distance <= stiffer.radius_m - inset) | (at_nodes <= stiffer.radius_m)).any():
            return [crossing]
        inside = _is_inside(centre, around)
        return [crossing._replace(kind=IntersectionKind.INSIDE)] if inside else []
    for edged, faced in ((softer, stiffer), (stiffer, softer)):
        segments = edged.nodes[unique_edges(edged.faces)]
        if len(crossing_pairs(segments, faced.nodes[faced.faces])[0]):
            return [crossing]
    # Without a crossing a component is inside as a whole.
    return [
        Intersection(IntersectionKind.INSIDE, inner.name, outer.name)
        for inner, outer in ((stiffer, softer), (softer, stiffer))
        if is_closed(outer.faces) and _any_part_inside(inner, outer.nodes[outer.faces])
    ]


def _any_part_inside(body: _Body, around: np.ndarray) -> bool:
    points = body.nodes[one_node_of_each_part(body.faces)]
    low, high = around.min(axis=(0, 1)), around.max(axis=(0, 1))
    points = points[((points >= low) & (points <= high)).all(axis=1)]
    return any(_is_inside(point, around) for point in points)


def _is_inside(point: np.ndarray, triangles: np.ndarray) -> bool:
    """Inside of a closed surface [n, 3, 3] of either orientation."""
    return abs(winding_number(point, triangles)) > 0.5
