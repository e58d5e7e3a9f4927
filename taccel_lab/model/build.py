# SPDX-License-Identifier: Apache-2.0
"""From a Scene to a Model: node numbers, masses, matrix pattern; see ``Scene.finalize``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.bodies.bodies import KinematicBody, Plane, SoftBody
from taccel_lab.bodies.element import Element
from taccel_lab.bodies.mass_properties import MassProperties
from taccel_lab.bodies.primitives import Ball, TriangleMesh
from taccel_lab.bodies.scene_description import SceneDescription
from taccel_lab.bodies.surface_topology import (
    SurfaceTopology,
    face_reaches_sq,
    surface_areas,
    surface_topology,
)
from taccel_lab.model.contact_plan import BodySurface, contact_plan
from taccel_lab.model.elastic import SoftDiscretization, build_element_groups, discretize
from taccel_lab.model.matrix_pattern import block_gather, block_pattern
from taccel_lab.model.model import AffineArrays, BodyKind, BodyRange, Model, RigidTarget
from taccel_lab.model.surface import Put, surface_arrays, surface_trees

MAX_CONTACT_COUPLES = 400
"""Surface nodes beside affine bodies up to which their contact has blocks in the matrix."""
MAX_COUPLED_AFFINE = 32
"""Up to this many affine bodies every coupling of two has a place in the matrix; beyond, what
contact adds between two of them is a list of extra blocks."""


@dataclass(frozen=True)
class _Part:
    """One body of the scene, in its own node numbers."""

    kind: BodyKind
    rest_m: np.ndarray
    """Shape [rest_count, node_count, 3]."""
    faces: np.ndarray


class _Layout:
    """Where the nodes of each body are."""

    def __init__(self, scene: SceneDescription) -> None:
        self.scene = scene
        self.soft: list[SoftDiscretization] = [discretize(body) for body in scene.soft_bodies]
        self.properties: list[MassProperties] = [
            body.mass_properties() for body in scene.affine_bodies
        ]
        self.rest_count = max([len(part.rest_m) for part in self.soft], default=1)
        parts = [_Part(BodyKind.SOFT, part.rest_m, part.faces) for part in self.soft]
        for body in scene.affine_bodies:
            parts.append(_Part(BodyKind.AFFINE, body.shape.vertices_m[None], body.shape.faces))
        for body in scene.kinematic_bodies:
            vertices, faces = _vertices_and_faces(body.shape)
            parts.append(_Part(BodyKind.KINEMATIC, vertices[None], faces))
        for plane in scene.planes:
            origin = np.asarray(plane.point_m, dtype=np.float64)[None, None]
            parts.append(_Part(BodyKind.PLANE, origin, np.zeros((0, 3), dtype=np.int32)))
        self.parts = parts
        self.affine_count = len(self.properties)
        self.soft_count = sum(part.rest_m.shape[1] for part in self.soft)
        node = 0
        self.starts: list[int] = []
        for index, part in enumerate(parts):
            if index == len(self.soft):
                node += 4 * self.affine_count
            self.starts.append(node)
            node += part.rest_m.shape[1]
        self.node_count = node
        self.first_control = self.soft_count

    def node_range(self, body: int) -> tuple[int, int]:
        start = self.starts[body]
        return start, start + self.parts[body].rest_m.shape[1]

    def control_nodes(self) -> np.ndarray:
        """Control nodes of each affine body, shape [affine_count, 4]."""
        return self.first_control + np.arange(4 * self.affine_count).reshape(-1, 4)

    def rest_positions(self) -> np.ndarray:
        """All nodes at rest [m], shape [rest_count, node_count, 3]."""
        rest = np.zeros((self.rest_count, self.node_count, 3))
        for body, part in enumerate(self.parts):
            first, last = self.node_range(body)
            rest[:, first:last] = part.rest_m
        for nodes, solid in zip(self.control_nodes(), self.properties, strict=True):
            rest[:, nodes[0]] = solid.center_m
            rest[:, nodes[1:]] = solid.radius_m * solid.axes.T
        return rest

    def free_nodes(self) -> np.ndarray:
        """Nodes with a row in the Newton system, ascending."""
        free = np.zeros(self.node_count, dtype=bool)
        for body, part in enumerate(self.soft):
            first, last = self.node_range(body)
            free[first:last] = True
            free[first + part.bonded] = False
        free[self.control_nodes().ravel()] = True
        return np.flatnonzero(free).astype(np.int32)

    def masses(self) -> np.ndarray:
        """Lumped masses [kg], shape [rest_count, node_count]."""
        masses = np.zeros((self.rest_count, self.node_count))
        for body, part in enumerate(self.soft):
            first, last = self.node_range(body)
            masses[:, first:last] = part.masses_kg
        for nodes, solid in zip(self.control_nodes(), self.properties, strict=True):
            masses[:, nodes[0]] = solid.mass_kg
            masses[:, nodes[1:]] = solid.second_moments_kg_m2 / solid.radius_m**2
        return masses

    def embedding(self) -> tuple[np.ndarray, np.ndarray]:
        """First control node of embedded vertices [node_count], and weights [node_count, 4]."""
        parents = np.full(self.node_count, -1, dtype=np.int32)
        weights = np.zeros((self.node_count, 4))
        for index, solid in enumerate(self.properties):
            body = len(self.soft) + index
            rows = slice(*self.node_range(body))
            parents[rows] = self.control_nodes()[index, 0]
            weights[rows, 0] = 1.0
            local = solid.to_principal(self.parts[body].rest_m[0])
            weights[rows, 1:] = local / solid.radius_m
        return parents, weights

    def frame_followers(self, at_start: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Nodes that follow a kinematic frame, and the kinematic index of each. ``at_start``: all
        that a frame places before the first step, whole gels that are mounted on it."""
        names = [body.name for body in self.scene.kinematic_bodies]
        nodes, frames = [], []
        for index in range(len(names)):
            body = len(self.soft) + self.affine_count + index
            nodes.append(np.arange(*self.node_range(body)))
            frames.append(np.full(len(nodes[-1]), index))
        for body, (soft, part) in enumerate(zip(self.scene.soft_bodies, self.soft, strict=True)):
            if soft.mount is not None:
                mine = np.arange(*self.node_range(body))
                nodes.append(mine if at_start else mine[part.bonded])
                frames.append(np.full(len(nodes[-1]), names.index(soft.mount)))
        if not nodes:
            return np.zeros(0), np.zeros(0)
        return np.concatenate(nodes), np.concatenate(frames)

    def frame_radii(self) -> np.ndarray:
        """Reach of each kinematic body and of what it carries from its origin [m], shape
        [rest_count, kinematic_count]: a mounted gel may have another size in each environment."""
        nodes, frames = self.frame_followers()
        reach = np.linalg.norm(self.rest_positions()[:, nodes.astype(int)], axis=-1)
        radii = np.zeros((self.rest_count, len(self.scene.kinematic_bodies)))
        for index, body in enumerate(self.scene.kinematic_bodies):
            radii[:, index] = reach[:, frames == index].max(axis=1, initial=0.0)
            if isinstance(body.shape, Ball):
                radii[:, index] = np.maximum(radii[:, index], body.shape.radius_m)
        return radii


def _vertices_and_faces(shape: TriangleMesh | Ball | None) -> tuple[np.ndarray, np.ndarray]:
    if isinstance(shape, TriangleMesh):
        return shape.vertices_m, shape.faces
    count = 0 if shape is None else 1
    return np.zeros((count, 3)), np.zeros((0, 3), dtype=np.int32)


def _surfaces(
    layout: _Layout, topology: SurfaceTopology, face_starts: np.ndarray
) -> list[BodySurface]:
    # Unique edges are sorted by node, so those of one body are contiguous.
    lowest = topology.edges[:, 0]
    surfaces = []
    for body, part in enumerate(layout.parts):
        first, last = layout.node_range(body)
        stiff = part.kind in (BodyKind.AFFINE, BodyKind.KINEMATIC)
        faces = np.arange(face_starts[body], face_starts[body + 1])
        surfaces.append(
            BodySurface(
                nodes=(np.unique(topology.faces[faces]) if len(faces) else np.arange(first, last)),
                faces=faces,
                edges=np.arange(*np.searchsorted(lowest, [first, last])),
                frame=body - len(layout.soft) if stiff else -1,
            )
        )
    return surfaces


def _targets(layout: _Layout, device: wp.Device, put: Put) -> list[RigidTarget]:
    targets = []
    radii = layout.frame_radii()
    for body, part in enumerate(layout.parts):
        if part.kind not in (BodyKind.AFFINE, BodyKind.KINEMATIC):
            continue
        frame = body - len(layout.soft)
        local = part.rest_m[0]
        if part.kind is BodyKind.AFFINE:
            solid = layout.properties[frame]
            local, radius = solid.to_principal(local), np.array([solid.radius_m])
        else:
            radius = radii[:, frame - layout.affine_count]
        edges = TriangleMesh(local, part.faces).edges() if len(part.faces) else None
        targets.append(
            RigidTarget(
                body=body,
                local_positions=put(local, wp.vec3d),
                trees=None if edges is None else surface_trees(local, part.faces, edges, device),
                radii_m=radius,
            )
        )
    return targets


def _node_marks(scene: SceneDescription, layout: _Layout) -> dict[str, np.ndarray]:
    """Body, radius, ball flag and plane normal of each node."""
    marks = {
        "bodies": np.full(layout.node_count, -1),
        "radii": np.zeros(layout.node_count),
        "is_ball": np.zeros(layout.node_count),
        "normals": np.zeros((layout.node_count, 3)),
    }
    for body_id, body in enumerate(scene.bodies):
        rows = slice(*layout.node_range(body_id))
        marks["bodies"][rows] = body_id
        marks["radii"][rows] = body.surface.thickness_m
        if isinstance(body, KinematicBody) and isinstance(body.shape, Ball):
            marks["radii"][rows] += body.shape.radius_m
            marks["is_ball"][rows] = 1
        if isinstance(body, Plane):
            marks["normals"][rows] = body.normal
    for index, nodes in enumerate(layout.control_nodes()):
        marks["bodies"][nodes] = len(layout.soft) + index
    return marks


def _affine_arrays(scene: SceneDescription, layout: _Layout, put: Put) -> AffineArrays:
    first = len(layout.soft)
    ranges = [layout.node_range(first + i) for i in range(layout.affine_count)]
    ends = [ranges[-1][1]] if ranges else []
    return AffineArrays(
        control_starts=put(layout.control_nodes()[:, 0], wp.int32),
        lengths=put(np.array([s.radius_m for s in layout.properties]), wp.float64),
        stiffness=put(
            np.array(
                [
                    body.young_modulus_pa * solid.volume_m3
                    for body, solid in zip(scene.affine_bodies, layout.properties, strict=True)
                ]
            ),
            wp.float64,
        ),
        vertex_starts=put(np.array([r[0] for r in ranges] + ends), wp.int32),
        have_joints=put(
            np.array(
                [
                    any(body.name in (joint.first, joint.second) for joint in scene.joints)
                    for body in scene.affine_bodies
                ],
                dtype=np.int32,
            ),
            wp.int32,
        ),
        properties=layout.properties,
        first_control=layout.first_control,
        count=layout.affine_count,
    )


def _affine_connectivity(scene: SceneDescription, layout: _Layout) -> np.ndarray:
    """Which control nodes may couple: groups of eight (two bodies) or four."""
    control = layout.control_nodes()
    count = layout.affine_count
    bodies = scene.affine_bodies
    joined = {frozenset((joint.first, joint.second)) for joint in scene.joints}
    pairs = [
        (i, j)
        for i in range(count)
        for j in range(i + 1, count)
        if frozenset((bodies[i].name, bodies[j].name)) in joined
        or (count <= MAX_COUPLED_AFFINE and scene.may_touch(bodies[i], bodies[j]))
    ]
    if not pairs:
        return control
    couples = np.array([np.concatenate([control[i], control[j]]) for i, j in pairs])
    alone = sorted(set(range(count)) - {i for pair in pairs for i in pair})
    padded = np.concatenate([control[alone], control[alone]], axis=1)
    return np.concatenate([couples, padded]) if alone else couples


def _contact_couples(
    scene: SceneDescription, layout: _Layout, free_index: np.ndarray
) -> np.ndarray:
    """Surface nodes of gels, each with the control nodes of an affine body to touch, [n, 5]."""
    control = layout.control_nodes()
    couples = [np.zeros((0, 5), dtype=np.int64)]
    for i, soft in enumerate(scene.soft_bodies):
        nodes = np.unique(layout.parts[i].faces + layout.starts[i])
        nodes = nodes[free_index[nodes] >= 0]
        for j, body in enumerate(scene.affine_bodies):
            if scene.may_touch(soft, body):
                row = np.broadcast_to(control[j], (len(nodes), 4))
                couples.append(np.column_stack([nodes, row]))
    return np.concatenate(couples)


def build_model(
    scene: SceneDescription, device: str, contact_in_pattern: bool | None = None
) -> Model:
    """Put a scene on a device; see ``Scene.finalize``.

    ``contact_in_pattern``: whether what contact of gels and affine bodies adds to the matrix has
    blocks of its own, unless that would be very many. When None on GPUs only, where it saves
    sorting a list; the sweeps of the CPU take half as long again over all the zeros.
    """
    wp_device = wp.get_device(device)
    if contact_in_pattern is None:
        contact_in_pattern = wp_device.is_cuda

    def put(value: np.ndarray, dtype: Any) -> wp.array:
        return wp.array(np.ascontiguousarray(value), dtype=dtype, device=wp_device)

    layout = _Layout(scene)
    rest_positions = layout.rest_positions()
    free_nodes = layout.free_nodes()
    free_index = np.full(layout.node_count, -1, dtype=np.int32)
    free_index[free_nodes] = np.arange(len(free_nodes))

    numbered = zip(layout.parts, layout.starts, strict=True)
    face_parts = [part.faces + start for part, start in numbered]
    faces = np.concatenate(face_parts).astype(np.int32)
    face_starts = np.cumsum([0] + [len(part) for part in face_parts])
    shares = np.full(faces.shape, 1 / 3)
    preferred = np.zeros(len(faces), dtype=bool)
    curved = np.zeros(len(faces), dtype=bool)
    softs = zip(scene.soft_bodies, layout.soft, face_starts, strict=False)
    for body, part, start in softs:
        own = slice(start, start + len(part.faces))
        shares[own], preferred[own] = part.face_shares, part.contact_faces
        curved[own] = body.element is Element.QUADRATIC
    topology = surface_topology(faces, layout.node_count, "collision surface")
    surfaces = _surfaces(layout, topology, face_starts)
    marks = _node_marks(scene, layout)

    moving = np.zeros(layout.node_count, dtype=bool)
    moving[layout.frame_followers()[0].astype(int)] = True
    groups, parts = build_element_groups(
        scene.soft_bodies,
        layout.soft,
        layout.starts[: len(layout.soft)],
        free_index >= 0,
        moving,
        put,
    )
    couples = _contact_couples(scene, layout, free_index)
    if not contact_in_pattern or len(couples) > MAX_CONTACT_COUPLES:
        couples = couples[:0]
    connectivities = [part.elements for part in parts]
    pattern = block_pattern(
        [*connectivities, _affine_connectivity(scene, layout), couples], free_index
    )
    for group, part in zip(groups, parts, strict=True):
        group.set_gather(block_gather(pattern, part.first, part.second, free_index, moving), put)

    bodies = scene.bodies
    plan = contact_plan(scene, surfaces, put)
    moduli = [
        body.material.largest_young_modulus_pa if isinstance(body, SoftBody) else 0.0
        for body in bodies
    ]
    friction = np.array([[scene.friction_between(a, b) for b in bodies] for a in bodies])
    present = np.ones((scene.env_count, len(bodies)), dtype=np.int32)
    for index, body in enumerate(bodies):
        if body.surface.environments is not None:
            present[:, index] = 0
            present[list(body.surface.environments), index] = 1
    parents, weights = layout.embedding()
    followers, frames = layout.frame_followers()
    started, start_frames = layout.frame_followers(at_start=True)
    gravity_scale = np.ones(layout.node_count)
    gravity_scale[layout.control_nodes()[:, 1:].ravel()] = 0.0
    return Model(
        scene=scene,
        device=wp_device,
        env_count=scene.env_count,
        bodies=[
            BodyRange(
                name=body.name,
                kind=part.kind,
                nodes=layout.node_range(index),
                faces=(int(face_starts[index]), int(face_starts[index + 1])),
                edges=_extent(surfaces[index].edges),
            )
            for index, (body, part) in enumerate(zip(bodies, layout.parts, strict=True))
        ],
        soft_count=layout.soft_count,
        node_count=layout.node_count,
        free_count=len(free_nodes),
        rest_count=layout.rest_count,
        rest_positions=put(rest_positions, wp.vec3d),
        free_index=put(free_index, wp.int32),
        free_nodes=put(free_nodes, wp.int32),
        masses=put(layout.masses(), wp.float64),
        gravity_scale=put(gravity_scale, wp.float64),
        parents=put(parents, wp.int32),
        weights=put(weights, wp.vec4d),
        frame_nodes=put(followers, wp.int32),
        frame_ids=put(frames, wp.int32),
        start_nodes=put(started, wp.int32),
        start_frames=put(start_frames, wp.int32),
        elastic=groups,
        surface=surface_arrays(
            topology,
            surface_areas(rest_positions, topology, shares, preferred),
            np.where(curved, face_reaches_sq(rest_positions, faces), 0.0),
            marks["radii"],
            marks["is_ball"],
            marks["bodies"],
            marks["normals"],
            put,
        ),
        affine=_affine_arrays(scene, layout, put),
        targets=_targets(layout, wp_device, put),
        contact_plan=plan,
        present=put(present, wp.int32),
        pair_friction=put(friction[None], wp.float64),
        largest_moduli=put(np.array([[*moduli, max(moduli)]]), wp.float64),
        largest_thickness_m=max(
            (bodies[i].surface.thickness_m + bodies[j].surface.thickness_m for i, j in plan.pairs),
            default=0.0,
        ),
        rubs=any(friction[i, j] > 0 for i, j in plan.pairs),
        contact_in_pattern=len(couples) > 0,
        pattern=pattern,
        row_starts=put(pattern.row_starts, wp.int32),
        columns=put(pattern.columns, wp.int32),
        diagonal=put(pattern.diagonal, wp.int32),
    )


def _extent(items: np.ndarray) -> tuple[int, int]:
    return (int(items[0]), int(items[-1]) + 1) if len(items) else (0, 0)
