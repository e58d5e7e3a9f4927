# SPDX-License-Identifier: Apache-2.0
"""Elements of soft bodies, in groups that share a material law and a kind of element."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from taccel_lab.bodies.bodies import Element, SoftBody
from taccel_lab.bodies.material import MaterialModel, MaxwellBranch
from taccel_lab.errors import InputError
from taccel_lab.geometry import QuadraticMesh, Region
from taccel_lab.model.carried import CarriedBlocks
from taccel_lab.model.element_chunks import (
    ChunkTables,
    chunk_lanes,
    chunk_sums,
    corner_uses,
    edge_block_uses,
)
from taccel_lab.model.matrix_pattern import BlockGather, node_gather, pair_nodes
from taccel_lab.model.surface import Put


@dataclass(frozen=True)
class ElementChunks:
    """Chunks of the elements of a group, and what each adds up before it is written."""

    lanes: wp.array
    """Element of each lane, -1 for none, int32, shape [lane_count]."""
    blocks: ChunkTables
    """Sums of element blocks."""
    block_count: int
    """Sums of element blocks, of all chunks."""
    forces: ChunkTables
    """Sums of nodal forces."""
    force_count: int
    """Sums of nodal forces, of all chunks."""


@dataclass
class ElementArrays:
    """Elements of one law and kind, of one or several soft bodies."""

    law: MaterialModel
    element: Element
    branches: tuple[MaxwellBranch, ...]
    """Maxwell branches that its bodies share."""
    first_viscous_point: int
    """Where they begin in ``State.viscous_inverses``."""
    bodies: list[tuple[int, int, int]]
    """(soft body, first element, the one after the last) of each body in the group."""
    elements: wp.array
    """Nodes of the whole scene, int32, shape [element_count, nodes_per_element]."""
    shape_gradients: wp.array
    """Rest gradients of the barycentric coordinates [1/m], vec3d, [rest_count, element_count, 4];
    elements have straight edges at rest."""
    volumes: wp.array
    """Rest volumes [m^3], float64, shape [rest_count, element_count]."""
    mu: wp.array
    """Shear modulus [Pa], float64, shape [element_count]; once moduli differ by environment those
    of one after the other, [env_count * element_count], and ``lam`` and ``mooney_ratio`` with it.
    """
    lam: wp.array
    """Lame's first parameter [Pa], float64, the same shape."""
    mooney_ratio: wp.array
    """c01 / (c10 + c01), float64, the same shape; empty unless Mooney-Rivlin."""
    gather_nodes: wp.array
    """Nodes of the group, ascending, int32."""
    node_starts: wp.array
    """Range of each of them in ``node_entries``, int32."""
    node_entries: wp.array
    """nodes_per_element * element + local node, int32."""
    chunks: ElementChunks | None
    """Chunks of linear tets; None where each element keeps what it contributes to itself."""
    force_starts: wp.array
    """Range of each of ``gather_nodes`` in ``force_parts``, int32."""
    force_parts: wp.array
    """Forces that add up at it: sums of chunks, or ``node_entries``, int32."""
    gather: BlockGather | None = None
    """Where its parts go in the matrix of the scene, on the device; filled in with the matrix."""
    young_moduli: wp.array | None = None
    """What ``mu`` and ``lam`` come from [Pa], float64, [env_count * element_count], and Poisson's
    ratios; None until moduli differ by environment."""
    poisson_ratios: wp.array | None = None
    carried: CarriedBlocks | None = None
    """What nodes on affine bodies add to the matrix; None where there are none."""

    @property
    def element_count(self) -> int:
        return self.elements.shape[0]

    @property
    def point_count(self) -> int:
        """Points at which the material of the group is evaluated."""
        return self.element_count * self.element.point_count

    @property
    def branch_points(self) -> list[tuple[MaxwellBranch, int]]:
        """Each branch, and the first of its points in ``State.viscous_inverses``."""
        first, count = self.first_viscous_point, self.point_count
        return [(branch, first + k * count) for k, branch in enumerate(self.branches)]

    @property
    def nodes_per_element(self) -> int:
        return self.elements.shape[1]


def shape_gradients(rest: np.ndarray, tets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rest gradients [rest, tet, 4, 3] and volumes [rest, tet] of the corners of tets; refuses flat
    or inverted ones."""
    p = rest[:, tets[:, :4]]
    edges = np.swapaxes(p[:, :, 1:] - p[:, :, :1], -1, -2)
    det = np.linalg.det(edges)
    if not (det > 0).all():
        env, tet = np.argwhere(~(det > 0))[0]
        raise InputError(f"rest tet {tet} of environment {env} is inverted or flat")
    inverse = np.linalg.inv(edges)
    first = -inverse.sum(axis=2, keepdims=True)
    return np.concatenate([first, inverse], axis=2), det / 6.0


@dataclass(frozen=True)
class SoftDiscretization:
    """The nodes and elements of one soft body, its own node numbers."""

    rest_m: np.ndarray
    """Rest positions [m], shape [rest_count, node_count, 3]."""
    elements: np.ndarray
    """Nodes of each element, int, shape [element_count, n]."""
    bonded: np.ndarray
    """Nodes without degrees of freedom, int64, shape [bonded_count]."""
    faces: np.ndarray
    """Collision faces, all of the boundary: what a face is called says nothing about whether it is
    held, and a glued one, too, stops a body that comes from behind or through the gel."""
    face_shares: np.ndarray
    """Part of its area that each corner of a collision face stands for, shape [face_count, 3]."""
    contact_faces: np.ndarray
    """Whether a collision face belongs to the contact region, bool, shape [face_count]."""
    masses_kg: np.ndarray
    """Lumped masses [kg], shape [rest_count, node_count]."""


_CORNER_SHARE = 0.05
"""Part of the area of a quadratic face's corners that they keep. The load of a uniform pressure on
a straight-sided quadratic face is zero at its corners; the rest keeps them from getting through."""


def _face_shares(faces: np.ndarray, corner_count: int) -> np.ndarray:
    """Shares of the corners of faces in the area; nodes from ``corner_count`` on are middles."""
    is_corner = faces < corner_count
    quadratic = is_corner.sum(axis=1) == 1
    kept = np.where(is_corner, _CORNER_SHARE, 1 + 0.5 * (1 - _CORNER_SHARE)) / 3
    return np.where(quadratic[:, None], kept, 1 / 3)


def discretize(body: SoftBody) -> SoftDiscretization:
    """Nodes and elements of a soft body; refuses flat and inverted tets."""
    rest = body.nodal_rest_m
    _, volumes = shape_gradients(rest[:, : body.mesh.node_count], body.mesh.tets)
    tet_masses = volumes * body.material.density_kg_m3
    mesh = body.nodal_mesh
    if isinstance(mesh, QuadraticMesh):
        # The edges of bond faces, or what the user's corners enclose.
        given = body.bonded_nodes is not None
        bonded = mesh.held_with(body.bonded()) if given else mesh.bonded_nodes()
        masses = np.stack([mesh.lumped_masses(row) for row in tet_masses])
    else:
        bonded = body.bonded()
        corners = body.mesh.tets.ravel()
        count = mesh.node_count
        masses = np.stack(
            [np.bincount(corners, np.repeat(row / 4.0, 4), minlength=count) for row in tet_masses]
        )
    corner_count = body.mesh.node_count if isinstance(mesh, QuadraticMesh) else mesh.node_count
    return SoftDiscretization(
        rest_m=rest,
        elements=mesh.tets,
        bonded=bonded,
        faces=mesh.faces,
        face_shares=_face_shares(mesh.faces, corner_count),
        contact_faces=mesh.face_regions == int(Region.CONTACT),
        masses_kg=masses,
    )


@dataclass(frozen=True)
class BlockParts:
    """What a group adds to a matrix: its connectivity, and what it writes of it."""

    elements: np.ndarray
    """Nodes of each element in the scene, int, shape [element_count, nodes_per_element]."""
    first: np.ndarray
    """The part ``first[i], second[i]`` of the matrix is written as one block, by an element or a
    chunk: node numbers of the scene, int, shape [part_count]."""
    second: np.ndarray


def build_element_groups(
    bodies: Sequence[SoftBody],
    parts: Sequence[SoftDiscretization],
    starts: Sequence[int],
    free: np.ndarray,
    moving: np.ndarray,
    put: Put,
) -> tuple[list[ElementArrays], list[BlockParts]]:
    """Element groups and what they add to the matrix.

    ``starts``: first node of each body. ``free``, ``moving``: nodes that have a row in the matrix
    or follow rows of an affine body, and nodes that are prescribed to move, bool, [node_count].
    ``ElementArrays.gather`` comes later, with the matrix.
    """
    members: dict[tuple[MaterialModel, Element, tuple[MaxwellBranch, ...]], list[int]] = {}
    for index, body in enumerate(bodies):
        solid = body.material
        kind = (solid.model, body.element, solid.branches)
        members.setdefault(kind, []).append(index)
    groups, written = [], []
    for (law, element, branches), indices in members.items():
        connectivity = np.concatenate([parts[i].elements + starts[i] for i in indices])
        ends = np.cumsum([0] + [len(parts[i].elements) for i in indices])
        rests = [shape_gradients(parts[i].rest_m, parts[i].elements) for i in indices]
        rest_count = max(len(volumes) for _, volumes in rests)

        def spread(values: np.ndarray, rows: int = rest_count) -> np.ndarray:
            return np.broadcast_to(values, (rows, *values.shape[1:]))

        def by_element(name: str, indices: Sequence[int] = indices) -> np.ndarray:
            return np.concatenate(
                [
                    np.broadcast_to(getattr(bodies[i].material, name), len(parts[i].elements))
                    for i in indices
                ]
            )

        mooney = law is MaterialModel.MOONEY_RIVLIN
        nodes, node_starts, entries = node_gather(connectivity)
        whole = [(int(first), int(end)) for first, end in itertools.pairwise(ends)]
        first, second = pair_nodes(connectivity)
        chunks, force_starts, force_parts = None, node_starts, entries
        if element is Element.LINEAR:
            # Of the mesh, not of an environment: what an environment gives to the last bit does not
            # depend on which others there are.
            corners = [bodies[i].mesh.nodes_m[parts[i].elements] for i in indices]
            lanes = chunk_lanes(np.concatenate(corners).mean(axis=1), whole)
            chunks, (first, second), force_nodes = _element_chunks(
                lanes, connectivity, free, moving, put
            )
            _, force_starts, force_parts = node_gather(force_nodes[:, None])
        groups.append(
            ElementArrays(
                law=law,
                element=element,
                branches=branches,
                first_viscous_point=sum(len(g.branches) * g.point_count for g in groups),
                bodies=[(i, *ranged) for i, ranged in zip(indices, whole, strict=True)],
                elements=put(connectivity, wp.int32),
                shape_gradients=put(
                    np.concatenate([spread(g) for g, _ in rests], axis=1), wp.vec3d
                ),
                volumes=put(np.concatenate([spread(v) for _, v in rests], axis=1), wp.float64),
                mu=put(by_element("shear_modulus_pa"), wp.float64),
                lam=put(by_element("lame_lambda_pa"), wp.float64),
                mooney_ratio=put(by_element("mooney_ratio") if mooney else np.zeros(0), wp.float64),
                gather_nodes=put(nodes, wp.int32),
                node_starts=put(node_starts, wp.int32),
                node_entries=put(entries, wp.int32),
                chunks=chunks,
                force_starts=put(force_starts, wp.int32),
                force_parts=put(force_parts, wp.int32),
            )
        )
        written.append(BlockParts(connectivity, first, second))
    return groups, written


def _element_chunks(
    lanes: np.ndarray, elements: np.ndarray, free: np.ndarray, moving: np.ndarray, put: Put
) -> tuple[ElementChunks, tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Chunks, the two nodes of each of their sums of blocks, and the node of each sum of forces."""
    count = len(free)
    blocks = chunk_sums(lanes, edge_block_uses(elements, free, free | moving), size=9)
    forces = chunk_sums(lanes, corner_uses(elements), size=3)
    chunks = ElementChunks(
        lanes=put(lanes, wp.int32),
        blocks=blocks.tables(put),
        block_count=len(blocks.keys),
        forces=forces.tables(put),
        force_count=len(forces.keys),
    )
    return chunks, np.divmod(blocks.keys, count), forces.keys
