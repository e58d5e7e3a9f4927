# SPDX-License-Identifier: Apache-2.0
"""Builds a Model from a Scene: node numbers, masses, matrix pattern; see ``Scene.finalize``."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from taccel_lab.bodies.bodies import Element, KinematicBody, Plane, SoftBody
from taccel_lab.bodies.primitives import Ball, TriangleMesh
from taccel_lab.bodies.scene_description import SceneDescription
from taccel_lab.bodies.surface_topology import (
    SurfaceTopology,
    face_reaches_sq,
    surface_areas,
    surface_topology,
)
from taccel_lab.model.carried import carried_blocks
from taccel_lab.model.elastic import build_element_groups
from taccel_lab.model.launches import require_device
from taccel_lab.model.layout import Layout
from taccel_lab.model.matrix_pattern import block_gather, block_pattern
from taccel_lab.model.model import AffineArrays, BodyKind, BodyRange, Model, RigidTarget
from taccel_lab.model.surface import BodySurface, Put, contact_plan, surface_arrays, surface_trees
from taccel_lab.model.turns import TURNS

MAX_CONTACT_COUPLES = 400
"""Surface nodes beside affine bodies up to which their contact has blocks in the matrix."""
MAX_COUPLED_AFFINE = 32
"""Up to this many affine bodies every coupling of two has a place in the matrix; beyond, what
contact adds between two of them is a list of extra blocks."""


def _surfaces(
    layout: Layout, topology: SurfaceTopology, face_starts: np.ndarray
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


def _targets(layout: Layout, device: wp.Device, put: Put) -> list[RigidTarget]:
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


def _node_marks(scene: SceneDescription, layout: Layout) -> dict[str, np.ndarray]:
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


def _affine_arrays(
    scene: SceneDescription,
    layout: Layout,
    carried: np.ndarray,
    carried_starts: np.ndarray,
    put: Put,
) -> AffineArrays:
    first = len(layout.soft)
    ranges = [layout.node_range(first + i) for i in range(layout.affine_count)]
    ends = [ranges[-1][1]] if ranges else []
    solids = list(zip(scene.affine_bodies, layout.properties, strict=True))
    joined = {name for joint in scene.joints for name in (joint.first, joint.second)}
    return AffineArrays(
        control_starts=put(layout.control_nodes()[:, 0], wp.int32),
        lengths=put(np.array([s.radius_m for _, s in solids]), wp.float64),
        stiffness=put(
            np.array([body.young_modulus_pa * s.volume_m3 for body, s in solids]), wp.float64
        ),
        vertex_starts=put(np.array([r[0] for r in ranges] + ends), wp.int32),
        carried=put(carried, wp.int32),
        carried_starts=put(carried_starts, wp.int32),
        riders=put(layout.riders(), wp.vec2i),
        have_joints=put(np.array([body.name in joined for body, _ in solids]), wp.int32),
        properties=layout.properties,
        first_control=layout.first_control,
        count=layout.affine_count,
    )


def _affine_connectivity(scene: SceneDescription, layout: Layout) -> np.ndarray:
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
        or (count <= MAX_COUPLED_AFFINE and _may_meet(scene, layout, i, j))
    ]
    if not pairs:
        return control
    couples = np.array([np.concatenate([control[i], control[j]]) for i, j in pairs])
    alone = sorted(set(range(count)) - {i for pair in pairs for i in pair})
    padded = np.concatenate([control[alone], control[alone]], axis=1)
    return np.concatenate([couples, padded]) if alone else couples


def _may_meet(scene: SceneDescription, layout: Layout, i: int, j: int) -> bool:
    """Whether two affine bodies may touch, or one of them the glued face of a gel on the other."""
    bodies, soft = scene.affine_bodies, scene.soft_bodies
    return scene.may_touch(bodies[i], bodies[j]) or any(
        scene.may_touch(soft[gel], bodies[other])
        for carrier, other in ((i, j), (j, i))
        for gel in layout.carried_by(carrier)
    )


def _bond_couples(elements: np.ndarray, free_index: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """Free nodes of elements with carried nodes, each with the control nodes of the body that
    carries them, [n, 5]."""
    parent = parents[elements].max(axis=1, initial=-1)
    held = elements[parent >= 0]
    pairs = np.column_stack([held.ravel(), np.repeat(parent[parent >= 0], elements.shape[1])])
    node, first = np.unique(pairs[free_index[pairs[:, 0]] >= 0], axis=0).reshape(-1, 2).T
    return np.column_stack([node, first[:, None] + np.arange(4)])


def _contact_couples(scene: SceneDescription, layout: Layout, free_index: np.ndarray) -> np.ndarray:
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
    wp_device = require_device(device)
    TURNS.watch(wp_device)
    if contact_in_pattern is None:
        contact_in_pattern = wp_device.is_cuda

    def put(value: np.ndarray, dtype: Any) -> wp.array:
        return wp.array(np.ascontiguousarray(value), dtype=dtype, device=wp_device)

    layout = Layout(scene)
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
    parents, weights = layout.embedding()
    carried, carried_starts = layout.carried_nodes()
    coupled = free_index >= 0
    coupled[carried] = True
    groups, parts = build_element_groups(
        scene.soft_bodies,
        layout.soft,
        layout.starts[: len(layout.soft)],
        coupled,
        moving,
        put,
    )
    couples = _contact_couples(scene, layout, free_index)
    if not contact_in_pattern or len(couples) > MAX_CONTACT_COUPLES:
        couples = couples[:0]
    connectivities = [part.elements for part in parts]
    bonds = [_bond_couples(elements, free_index, parents) for elements in connectivities]
    pattern = block_pattern(
        [*connectivities, _affine_connectivity(scene, layout), *bonds, couples], free_index
    )
    for group, part in zip(groups, parts, strict=True):
        gather = block_gather(pattern, part.first, part.second, free_index, moving)
        group.gather = gather.on(put)
        group.carried = carried_blocks(pattern, part.first, part.second, free_index, parents, put)

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
        affine=_affine_arrays(scene, layout, carried, carried_starts, put),
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
