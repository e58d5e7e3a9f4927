# SPDX-License-Identifier: Apache-2.0
"""``Model``: everything about a scene that a step does not change, as device arrays.

Nodes are numbered through: the soft body's nodes first, then the vertices of all kinematic
bodies. Arrays of rest quantities have ``rest_count`` rows, which is 1 when all environments share
one rest shape and ``env_count`` otherwise; kernels index them with ``env % rest_count``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.geometry import Region
from taccel_lab.ipc.linear.pattern import BlockPattern, tet_block_pattern
from taccel_lab.scene.description import Scene
from taccel_lab.scene.material import MaterialModel
from taccel_lab.scene.primitives import Ball, TriangleMesh
from taccel_lab.scene.surface_topology import SurfaceTopology, surface_areas, surface_topology


@dataclass
class ElasticArrays:
    """Linear tets of the soft body."""

    tets: wp.array
    """Corners, vec4i, shape [tet_count]."""
    shape_gradients: wp.array
    """Rest gradients of the corner functions [1/m], vec3d, [rest_count, tet_count, 4]."""
    volumes: wp.array
    """Rest volumes [m^3], float64, shape [rest_count, tet_count]."""
    mu: wp.array
    """Shear modulus [Pa], float64, shape [tet_count]."""
    lam: wp.array
    """Lame's first parameter [Pa], float64, shape [tet_count]."""
    mooney_ratio: wp.array
    """c01 / (c10 + c01), float64, shape [tet_count]; empty unless Mooney-Rivlin."""
    node_tet_starts: wp.array
    """CSR of the tets around a node, int32, shape [soft_count + 1]."""
    node_tets: wp.array
    """4 * tet + corner, int32."""


@dataclass
class SurfaceArrays:
    """Collision surfaces of all bodies (see SurfaceTopology)."""

    faces: wp.array
    edges: wp.array
    face_edges: wp.array
    edge_faces: wp.array
    node_face_starts: wp.array
    node_faces: wp.array
    node_edge_starts: wp.array
    node_edges: wp.array
    node_areas: wp.array
    """float64, shape [rest_count, node_count]."""
    edge_areas: wp.array
    """float64, shape [rest_count, edge_count]."""
    face_areas: wp.array
    """float64, shape [rest_count, face_count]."""
    node_radii: wp.array
    """Radius of a ball about a node [m], 0 for nodes of meshes, float64, shape [node_count]."""
    node_bodies: wp.array
    """Kinematic body of a node, -1 for soft nodes, int32, shape [node_count]."""


@dataclass
class SurfaceTrees:
    """Search trees over the faces, edges and vertices of a mesh in its own frame."""

    faces: wp.Bvh
    edges: wp.Bvh
    vertices: wp.Bvh


@dataclass
class KinematicArrays:
    """One kinematic body: its surface in its own frame, with search trees that never change.

    A ball is a single node with a radius and has no trees.
    """

    name: str
    node_start: int
    node_count: int
    local_positions: wp.array
    """Vertices in the body frame [m], vec3d, shape [vertex_count]."""
    face_start: int
    edge_start: int
    trees: SurfaceTrees | None
    """None for a ball."""
    radius_m: float
    """Largest distance of the surface from the body frame's origin [m]."""
    friction: float


@dataclass
class Model:
    """Static data of a scene; shapes beside each field."""

    scene: Scene
    device: wp.Device
    env_count: int
    soft_count: int
    """Nodes of the soft body."""
    node_count: int
    """Soft nodes and kinematic vertices."""
    free_count: int
    rest_count: int
    rest_positions: wp.array
    """Rest positions [m], vec3d, shape [rest_count, node_count] (kinematic: body frame)."""
    free_index: wp.array
    """Row of a node in the linear system, -1 when prescribed, int32, shape [node_count]."""
    free_nodes: wp.array
    """Node of each row, int32, shape [free_count]."""
    masses: wp.array
    """Lumped mass [kg], float64, shape [rest_count, node_count]."""
    elastic: ElasticArrays
    surface: SurfaceArrays
    kinematic: list[KinematicArrays]
    pattern: BlockPattern
    row_starts: wp.array
    columns: wp.array
    diagonal: wp.array
    source_starts: wp.array
    sources: wp.array
    soft_faces: tuple[int, int]
    """Range of the soft body's collision faces in ``surface.faces``."""
    soft_edges: tuple[int, int]
    soft_surface_nodes: wp.array
    """Soft nodes that can collide, int32."""
    node_friction: wp.array
    """Friction coefficient of the kinematic body that owns a node, 0 for soft nodes, float64."""


def _rest_shape(scene: Scene) -> np.ndarray:
    mesh = scene.soft_body.mesh
    if scene.soft_body.rest_positions_m is None:
        return mesh.nodes_m[None]
    return np.ascontiguousarray(scene.soft_body.rest_positions_m, dtype=np.float64)


def _shape_gradients(rest: np.ndarray, tets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rest gradients [rest, tet, 4, 3] and volumes [rest, tet]; refuses flat or inverted tets."""
    p = rest[:, tets]
    edges = np.swapaxes(p[:, :, 1:] - p[:, :, :1], -1, -2)
    det = np.linalg.det(edges)
    if not (det > 0).all():
        env, tet = np.argwhere(~(det > 0))[0]
        raise InputError(f"rest tet {tet} of environment {env} is inverted or flat")
    inverse = np.linalg.inv(edges)
    first = -inverse.sum(axis=2, keepdims=True)
    return np.concatenate([first, inverse], axis=2), det / 6.0


def _bvh(lower: np.ndarray, upper: np.ndarray, device: wp.Device) -> wp.Bvh:
    """A tree over FP32 boxes rounded outwards, so that no FP64 primitive leaves its box."""
    low = np.nextafter(lower.astype(np.float32), np.float32(-np.inf))
    high = np.nextafter(upper.astype(np.float32), np.float32(np.inf))
    return wp.Bvh(
        wp.array(low, dtype=wp.vec3, device=device), wp.array(high, dtype=wp.vec3, device=device)
    )


def _surface_trees(
    vertices: np.ndarray, faces: np.ndarray, edges: np.ndarray, device: wp.Device
) -> SurfaceTrees:
    corners, ends = vertices[faces], vertices[edges]
    return SurfaceTrees(
        faces=_bvh(corners.min(1), corners.max(1), device),
        edges=_bvh(ends.min(1), ends.max(1), device),
        vertices=_bvh(vertices, vertices, device),
    )


def _vertices_and_faces(shape: TriangleMesh | Ball) -> tuple[np.ndarray, np.ndarray]:
    if isinstance(shape, Ball):
        return np.zeros((1, 3)), np.zeros((0, 3), dtype=np.int32)
    return shape.vertices_m, shape.faces


def build_model(scene: Scene, device: str) -> Model:
    """Put a scene on a device; see ``Scene.finalize``."""
    wp_device = wp.get_device(device)
    mesh = scene.soft_body.mesh
    soft_count = mesh.node_count
    soft_rest = _rest_shape(scene)
    rest_count = len(soft_rest)
    gradients, volumes = _shape_gradients(soft_rest, mesh.tets)

    bonded = scene.soft_body.bonded()
    if len(bonded) and (bonded[0] < 0 or bonded[-1] >= soft_count):
        raise InputError("bonded_nodes refers to nodes that do not exist")
    shapes = [_vertices_and_faces(body.shape) for body in scene.kinematic_bodies]
    node_starts = np.cumsum([soft_count] + [len(vertices) for vertices, _ in shapes])
    node_count = int(node_starts[-1])
    free = np.zeros(node_count, dtype=bool)
    free[:soft_count] = True
    free[bonded] = False
    free_index = np.full(node_count, -1, dtype=np.int32)
    free_nodes = np.flatnonzero(free).astype(np.int32)
    free_index[free_nodes] = np.arange(len(free_nodes))

    # Bond and window faces sit on the rigid backing: nothing can touch them.
    touchable = np.isin(mesh.face_regions, [int(Region.CONTACT), int(Region.SIDE)])
    all_faces = [mesh.faces[touchable]]
    rest = [soft_rest]
    for start, (vertices, body_faces) in zip(node_starts[:-1], shapes, strict=True):
        all_faces.append(body_faces + np.int32(start))
        rest.append(np.broadcast_to(vertices, (rest_count, *vertices.shape)))
    faces = np.concatenate(all_faces)
    rest_positions = np.concatenate(rest, axis=1)
    topology = surface_topology(faces, node_count, "collision surface")
    areas = surface_areas(rest_positions, topology)
    node_radii = np.zeros(node_count)
    node_bodies = np.full(node_count, -1)

    # Unique edges are sorted by node, so those of one body are contiguous.
    edge_body_starts = np.searchsorted(topology.edges[:, 0], node_starts)
    face_starts = np.cumsum([0] + [len(f) for f in all_faces])

    def put(value: np.ndarray, dtype: Any) -> wp.array:
        return wp.array(np.ascontiguousarray(value), dtype=dtype, device=wp_device)

    kinematic = []
    for i, body in enumerate(scene.kinematic_bodies):
        local, body_faces = shapes[i]
        node_bodies[node_starts[i] : node_starts[i + 1]] = i
        local_edges = topology.edges[edge_body_starts[i] : edge_body_starts[i + 1]] - node_starts[i]
        if isinstance(body.shape, Ball):
            node_radii[node_starts[i]] = body.shape.radius_m
        kinematic.append(
            KinematicArrays(
                name=body.name,
                node_start=int(node_starts[i]),
                node_count=len(local),
                local_positions=put(local, wp.vec3d),
                face_start=int(face_starts[i + 1]),
                edge_start=int(edge_body_starts[i]),
                trees=(
                    None
                    if isinstance(body.shape, Ball)
                    else _surface_trees(local, body_faces, local_edges, wp_device)
                ),
                radius_m=(
                    body.shape.radius_m
                    if isinstance(body.shape, Ball)
                    else float(np.linalg.norm(local, axis=1).max())
                ),
                friction=body.friction_coefficient,
            )
        )

    material = scene.soft_body.material
    masses = np.zeros((rest_count, node_count))
    for row in range(rest_count):
        share = np.repeat(volumes[row] * material.density_kg_m3 / 4.0, 4)
        masses[row, :soft_count] = np.bincount(mesh.tets.ravel(), share, minlength=soft_count)
    node_friction = np.zeros(node_count)
    for body in kinematic:
        node_friction[body.node_start : body.node_start + body.node_count] = body.friction

    order = np.argsort(mesh.tets.ravel(), kind="stable")
    node_tet_starts = np.searchsorted(mesh.tets.ravel()[order], np.arange(soft_count + 1))
    pattern = tet_block_pattern(mesh.tets, free_index)
    return Model(
        scene=scene,
        device=wp_device,
        env_count=scene.env_count,
        soft_count=soft_count,
        node_count=node_count,
        free_count=len(free_nodes),
        rest_count=rest_count,
        rest_positions=put(rest_positions, wp.vec3d),
        free_index=put(free_index, wp.int32),
        free_nodes=put(free_nodes, wp.int32),
        masses=put(masses, wp.float64),
        elastic=ElasticArrays(
            tets=put(mesh.tets, wp.vec4i),
            shape_gradients=put(gradients, wp.vec3d),
            volumes=put(volumes, wp.float64),
            mu=put(np.full(mesh.tet_count, material.shear_modulus_pa), wp.float64),
            lam=put(np.full(mesh.tet_count, material.lame_lambda_pa), wp.float64),
            mooney_ratio=put(
                np.full(mesh.tet_count, material.mooney_ratio)
                if material.model is MaterialModel.MOONEY_RIVLIN
                else np.zeros(0),
                wp.float64,
            ),
            node_tet_starts=put(node_tet_starts.astype(np.int32), wp.int32),
            node_tets=put(order.astype(np.int32), wp.int32),
        ),
        surface=_surface_arrays(topology, areas, node_radii, node_bodies, put),
        kinematic=kinematic,
        pattern=pattern,
        row_starts=put(pattern.row_starts, wp.int32),
        columns=put(pattern.columns, wp.int32),
        diagonal=put(pattern.diagonal, wp.int32),
        source_starts=put(pattern.source_starts, wp.int32),
        sources=put(pattern.sources, wp.int32),
        soft_faces=(0, int(face_starts[1])),
        soft_edges=(0, int(edge_body_starts[0])),
        soft_surface_nodes=put(np.unique(all_faces[0]), wp.int32),
        node_friction=put(node_friction, wp.float64),
    )


def _surface_arrays(
    topology: SurfaceTopology,
    areas: tuple[np.ndarray, np.ndarray, np.ndarray],
    node_radii: np.ndarray,
    node_bodies: np.ndarray,
    put: Callable[[np.ndarray, Any], wp.array],
) -> SurfaceArrays:
    return SurfaceArrays(
        faces=put(topology.faces, wp.vec3i),
        edges=put(topology.edges, wp.vec2i),
        face_edges=put(topology.face_edges, wp.vec3i),
        edge_faces=put(topology.edge_faces, wp.vec2i),
        node_face_starts=put(topology.node_face_starts, wp.int32),
        node_faces=put(topology.node_faces, wp.int32),
        node_edge_starts=put(topology.node_edge_starts, wp.int32),
        node_edges=put(topology.node_edges, wp.int32),
        node_areas=put(areas[0], wp.float64),
        edge_areas=put(areas[1], wp.float64),
        face_areas=put(areas[2], wp.float64),
        node_radii=put(node_radii, wp.float64),
        node_bodies=put(node_bodies, wp.int32),
    )
